"""Teachers that demonstrate in simulation: planned, tracked and hand-led motions."""
