"""Physical robots in real time: what a robot must be able to do, the loop, and when it stops."""
