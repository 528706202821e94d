"""The tasks that can be learned, one file each, and what a task is."""
