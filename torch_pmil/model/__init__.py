"""The learned forward model: experience, fit, and predicted trajectories (Eqs. 2-4, 13)."""
