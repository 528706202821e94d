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

from importlib import import_module
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from torch_pmil import envs as envs
    from torch_pmil.control.known_part import KnownPart as KnownPart
    from torch_pmil.control.policy_file import (
        PolicyFileError as PolicyFileError,
        load_policy as load_policy,
        save_policy as save_policy,
    )
    from torch_pmil.control.rbf_policy import RBFPolicy as RBFPolicy
    from torch_pmil.control.state_policy import StatePolicy as StatePolicy
    from torch_pmil.control.state_space import (
        MatchSpace as MatchSpace,
        StateSpace as StateSpace,
        joint_match as joint_match,
    )
    from torch_pmil.demonstrations import (
        DemonstrationError as DemonstrationError,
        Demonstrations as Demonstrations,
        load_demonstrations as load_demonstrations,
        load_recordings as load_recordings,
        shipped_demonstrations as shipped_demonstrations,
    )
    from torch_pmil.demonstrations.distribution import expert_distribution as expert_distribution
    from torch_pmil.demonstrations.preparation.alignment import (
        AlignmentError as AlignmentError,
        align as align,
    )
    from torch_pmil.gp.gaussian import (
        Gaussian as Gaussian,
        Moments as Moments,
        NotPositiveDefiniteError as NotPositiveDefiniteError,
    )
    from torch_pmil.gp.kernel_expansion import KernelExpansion as KernelExpansion
    from torch_pmil.gp.moment_accuracy import (
        InaccurateMomentsError as InaccurateMomentsError,
        rounding_errors as rounding_errors,
    )
    from torch_pmil.gp.moment_matching import moment_match as moment_match
    from torch_pmil.model.dynamics import GPDynamics as GPDynamics
    from torch_pmil.model.experience import Experience as Experience
    from torch_pmil.model.particles import (
        ParticlePrediction as ParticlePrediction,
        sample_trajectories as sample_trajectories,
    )
    from torch_pmil.model.rollout import (
        PredictionError as PredictionError,
        predict_step as predict_step,
        predict_trajectory as predict_trajectory,
    )
    from torch_pmil.runs.pmil import PMIL as PMIL
    from torch_pmil.search.kl import gaussian_kl as gaussian_kl, trajectory_kl as trajectory_kl
    from torch_pmil.search.losses import (
        ExpectedSaturatingCost as ExpectedSaturatingCost,
        TrajectoryKLLoss as TrajectoryKLLoss,
    )
    from torch_pmil.search.multi_target_loss import MultiTargetKLLoss as MultiTargetKLLoss
    from torch_pmil.search.policy_search import (
        SearchResult as SearchResult,
        SearchSettings as SearchSettings,
        search_policy as search_policy,
    )
    from torch_pmil.search.saturating_cost import (
        expected_saturating_cost as expected_saturating_cost,
    )
    from torch_pmil.tasks.method import Method as Method, PolicySettings as PolicySettings
    from torch_pmil.tasks.own_robot import own_robot as own_robot
    from torch_pmil.tasks.registry import load_experiment as load_experiment
    from torch_pmil.tasks.task import Task as Task
    from torch_pmil.trainer.ending import Ending as Ending
    from torch_pmil.trainer.problem import Problem as Problem
    from torch_pmil.trainer.trainer import PMILTrainer as PMILTrainer
    from torch_pmil.trainer.trials import Trial as Trial

MODULES = {
    "AlignmentError": "demonstrations.preparation.alignment",
    "DemonstrationError": "demonstrations",
    "Demonstrations": "demonstrations",
    "Ending": "trainer.ending",
    "ExpectedSaturatingCost": "search.losses",
    "Experience": "model.experience",
    "GPDynamics": "model.dynamics",
    "Gaussian": "gp.gaussian",
    "InaccurateMomentsError": "gp.moment_accuracy",
    "KernelExpansion": "gp.kernel_expansion",
    "KnownPart": "control.known_part",
    "MatchSpace": "control.state_space",
    "Method": "tasks.method",
    "Moments": "gp.gaussian",
    "MultiTargetKLLoss": "search.multi_target_loss",
    "NotPositiveDefiniteError": "gp.gaussian",
    "PMIL": "runs.pmil",
    "PMILTrainer": "trainer.trainer",
    "ParticlePrediction": "model.particles",
    "PolicyFileError": "control.policy_file",
    "PolicySettings": "tasks.method",
    "PredictionError": "model.rollout",
    "Problem": "trainer.problem",
    "RBFPolicy": "control.rbf_policy",
    "SearchResult": "search.policy_search",
    "SearchSettings": "search.policy_search",
    "StatePolicy": "control.state_policy",
    "StateSpace": "control.state_space",
    "Task": "tasks.task",
    "TrajectoryKLLoss": "search.losses",
    "Trial": "trainer.trials",
    "align": "demonstrations.preparation.alignment",
    "expected_saturating_cost": "search.saturating_cost",
    "expert_distribution": "demonstrations.distribution",
    "gaussian_kl": "search.kl",
    "joint_match": "control.state_space",
    "load_demonstrations": "demonstrations",
    "load_experiment": "tasks.registry",
    "load_policy": "control.policy_file",
    "load_recordings": "demonstrations",
    "moment_match": "gp.moment_matching",
    "own_robot": "tasks.own_robot",
    "predict_step": "model.rollout",
    "predict_trajectory": "model.rollout",
    "rounding_errors": "gp.moment_accuracy",
    "sample_trajectories": "model.particles",
    "save_policy": "control.policy_file",
    "search_policy": "search.policy_search",
    "shipped_demonstrations": "demonstrations",
    "trajectory_kl": "search.kl",
}
__all__ = ["envs", *MODULES]


def __getattr__(name: str) -> Any:
    """Import a public name on its first use."""
    if name == "__version__":
        return version("torch_pmil")
    if name == "envs":
        return import_module("torch_pmil.envs")
    if name not in MODULES:
        raise AttributeError(f"module 'torch_pmil' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"torch_pmil.{MODULES[name]}"), name)
    return value


def __dir__() -> list[str]:
    """Names of the package, with the public names that were not asked for yet."""
    return sorted({*globals(), *__all__, "__version__"})
