"""Drop-ins for TorchRL's world model, policy and imagined environment of beliefs, on its keys."""

from torch_pmil.torchrl_interop.belief_policy import BeliefPolicy
from torch_pmil.torchrl_interop.imagined_env import ImaginedEnv
from torch_pmil.torchrl_interop.world_model import GPWorldModel

__all__ = ["BeliefPolicy", "GPWorldModel", "ImaginedEnv"]
