"""The baselines of Section 5.1: behavioural cloning, movement primitives, separate policies."""
