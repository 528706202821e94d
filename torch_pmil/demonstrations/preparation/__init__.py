"""What makes demonstrations of recordings: alignment, smoothing, jumps, a camera's view, drawings."""
