"""Preparation of demonstrations: alignment, smoothing, jumps, camera pixels, drawings."""
