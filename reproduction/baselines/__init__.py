"""Baselines of Section 5.1, and the peers that see no actions either."""
