"""Drop-ins for TorchRL's belief-space pieces: world model, policy and imagined environment, on
TorchRL's keys.
"""

from torch_pmil.torchrl_interop.belief_policy import BeliefPolicy
from torch_pmil.torchrl_interop.imagined_env import ImaginedEnv
from torch_pmil.torchrl_interop.world_model import GPWorldModel

__all__ = ["BeliefPolicy", "GPWorldModel", "ImaginedEnv"]
