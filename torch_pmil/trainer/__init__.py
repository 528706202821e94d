"""Algorithm 1 on TorchRL: the trainer, its steppers, its rollout collector and its checkpoints."""
