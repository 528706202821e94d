"""From recordings to demonstrations: alignment, smoothing, jumps, camera pixels, drawings."""
