"""The policy search: KL divergence, costs, losses and their minimisation (Eqs. 19-24, 28, 31)."""
