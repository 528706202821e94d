"""Baselines of Section 5.1, and the peers that are told no actions either."""
