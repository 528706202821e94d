"""Probabilistic model-based imitation learning in PyTorch.

The method is that of Englert, Paraschos, Peters and Deisenroth (2013). Each room imports only from
those above it in this table:

===================  ===========================================================================
``envs``             robots as environments of TorchRL
``gp``               Gaussian beliefs, GPs, RBF networks: exact moments (Eqs. 5-7, 14-18)
``control``          state space, policy, its file, exploration (Eqs. 25-27)
``demonstrations``   readers of files, preparation, the demonstrated distribution (Eqs. 9-12)
``model``            the learned forward model and its predicted trajectories (Eqs. 2-4, 13)
``search``           KL and costs, losses, policy search (Eqs. 19-24, 28, 31)
``torchrl_interop``  drop-ins for TorchRL's world model, policy and imagined environment
``trainer``          Algorithm 1 on TorchRL: trainer, collector, checkpoints
``plotting``         figures and videos
``tasks``            tasks, and the settings of the method by which they are learned
``runs``             runs with their folders, diagnosis and reports
``cli``              the commands of ``pmil``
===================  ===========================================================================

Every public name is imported on its first use, so that a part costs no more than what it uses.
"""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

import lazy_loader

_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> Any:
    """Import a public name, listed in ``__init__.pyi``, on its first use."""
    return version("torch_pmil") if name == "__version__" else _named(name)
