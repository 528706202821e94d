"""Algorithm 1 on TorchRL: the trainer, its steppers, its collector of rollouts, and its
checkpoints.
"""
