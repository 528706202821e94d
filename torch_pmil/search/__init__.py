"""The policy search: the KL divergence and other costs, the losses made of them, and what minimises
them (Eqs. 19-24, 28, 31).
"""
