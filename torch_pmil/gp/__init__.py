"""Gaussian beliefs, GPs and RBF networks: exact moments and their derivatives (Eqs. 5-7, 14-18)."""
