"""The public names of the package, which are imported on their first use."""

from . import envs as envs
from .control.known_part import KnownPart as KnownPart
from .control.linear_policy import LinearPolicy as LinearPolicy
from .control.module_policy import ModulePolicy as ModulePolicy
from .control.policy_file import (
    PolicyFileError as PolicyFileError,
    load_policy as load_policy,
    save_policy as save_policy,
)
from .control.rbf_policy import RBFPolicy as RBFPolicy
from .control.state_policy import StatePolicy as StatePolicy
from .control.state_space import (
    MatchSpace as MatchSpace,
    StateSpace as StateSpace,
    joint_match as joint_match,
)
from .demonstrations import (
    DemonstrationError as DemonstrationError,
    Demonstrations as Demonstrations,
    load_demonstrations as load_demonstrations,
    load_recordings as load_recordings,
    shipped_demonstrations as shipped_demonstrations,
)
from .demonstrations.distribution import expert_distribution as expert_distribution
from .demonstrations.preparation.alignment import (
    AlignmentError as AlignmentError,
    align as align,
)
from .gp.gaussian import (
    Gaussian as Gaussian,
    Moments as Moments,
    NotPositiveDefiniteError as NotPositiveDefiniteError,
)
from .gp.kernel_expansion import KernelExpansion as KernelExpansion
from .gp.moment_accuracy import (
    InaccurateMomentsError as InaccurateMomentsError,
    rounding_errors as rounding_errors,
)
from .gp.moment_matching import moment_match as moment_match
from .model.dynamics import GPDynamics as GPDynamics
from .model.experience import Experience as Experience
from .model.own_dynamics import OwnDynamics as OwnDynamics
from .model.particles import (
    ParticlePrediction as ParticlePrediction,
    sample_trajectories as sample_trajectories,
)
from .model.rollout import (
    PredictionError as PredictionError,
    predict_step as predict_step,
    predict_trajectory as predict_trajectory,
)
from .model.sampled_rollouts import SampledPrediction as SampledPrediction
from .runs.pmil import PILCO as PILCO, PMIL as PMIL
from .search.improving_loss import ImprovingKLLoss as ImprovingKLLoss
from .search.kl import gaussian_kl as gaussian_kl, trajectory_kl as trajectory_kl
from .search.losses import TrajectoryKLLoss as TrajectoryKLLoss
from .search.multi_target_loss import MultiTargetKLLoss as MultiTargetKLLoss
from .search.policy_search import (
    SearchResult as SearchResult,
    SearchSettings as SearchSettings,
    search_policy as search_policy,
)
from .search.sampled_cost import ExpectedSampledCost as ExpectedSampledCost
from .search.saturating_cost import (
    expected_saturating_cost as expected_saturating_cost,
)
from .search.target_costs import (
    FunctionCost as FunctionCost,
    QuadraticCost as QuadraticCost,
    SaturatingCost as SaturatingCost,
)
from .search.target_losses import (
    ExpectedQuadraticCost as ExpectedQuadraticCost,
    ExpectedSaturatingCost as ExpectedSaturatingCost,
)
from .tasks.cost_task import CostTask as CostTask
from .tasks.improving_task import ImprovingTask as ImprovingTask
from .tasks.method import Method as Method, PolicySettings as PolicySettings
from .tasks.own_cost import own_cost as own_cost
from .tasks.own_robot import own_robot as own_robot
from .tasks.registry import load_experiment as load_experiment
from .tasks.task import Task as Task
from .trainer.ending import Ending as Ending
from .trainer.problem import Problem as Problem
from .trainer.trainer import PMILTrainer as PMILTrainer
from .trainer.trials import Trial as Trial

__version__: str
