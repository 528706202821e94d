"""What records demonstrations in simulation: planned and tracked motions, and kinesthetic teaching."""
