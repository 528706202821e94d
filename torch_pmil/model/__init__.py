"""The learned forward model: its experience, its fit, and the trajectories that it predicts (Eqs.
2-4, 13).
"""
