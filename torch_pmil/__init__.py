"""Probabilistic model-based imitation learning (Englert, Paraschos, Peters, Deisenroth 2013) in PyTorch."""

import ctypes.util
import os
from importlib.metadata import version

if "DISPLAY" not in os.environ and ctypes.util.find_library("EGL"):
    os.environ.setdefault("MUJOCO_GL", "egl")  # headless pictures; MuJoCo reads it when it is first imported

from torch_pmil import envs
from torch_pmil.alignment import AlignmentError, align
from torch_pmil.demonstrations import DemonstrationError, Demonstrations, load_demonstrations, load_recordings, shipped_demonstrations
from torch_pmil.dynamics import GPDynamics
from torch_pmil.experience import Experience
from torch_pmil.experiments import Experiment, load_experiment
from torch_pmil.expert import expert_distribution
from torch_pmil.gaussian import Gaussian, NotPositiveDefiniteError
from torch_pmil.kernel_expansion import KernelExpansion
from torch_pmil.kl import gaussian_kl, trajectory_kl
from torch_pmil.lbfgs_stepper import LBFGSStepper
from torch_pmil.moment_matching import Moments, moment_match
from torch_pmil.multi_target import MultiTargetKLLoss
from torch_pmil.objective import ExpectedSaturatingCost, TrajectoryKLLoss
from torch_pmil.particles import ParticlePrediction, sample_trajectories
from torch_pmil.policy import RBFPolicy
from torch_pmil.policy_search import SearchResult, SearchSettings, search_policy
from torch_pmil.rollout import PredictionError, predict_step, predict_trajectory
from torch_pmil.sampling_frequency import FrequencyScore, Recording, score_frequencies
from torch_pmil.saturating_cost import expected_saturating_cost
from torch_pmil.saved_policy import PolicyFileError, load_policy, save_policy
from torch_pmil.state_policy import StatePolicy
from torch_pmil.state_space import MatchSpace, StateSpace, joint_match
from torch_pmil.trainer import PMILTrainer
from torch_pmil.trials import Trial

__version__ = version("torch_pmil")  # that of setup.cfg

__all__ = [
    "AlignmentError",
    "DemonstrationError",
    "Demonstrations",
    "ExpectedSaturatingCost",
    "Experience",
    "Experiment",
    "FrequencyScore",
    "GPDynamics",
    "Gaussian",
    "KernelExpansion",
    "LBFGSStepper",
    "MatchSpace",
    "Moments",
    "MultiTargetKLLoss",
    "NotPositiveDefiniteError",
    "PMILTrainer",
    "ParticlePrediction",
    "PolicyFileError",
    "PredictionError",
    "RBFPolicy",
    "Recording",
    "SearchResult",
    "SearchSettings",
    "StatePolicy",
    "StateSpace",
    "TrajectoryKLLoss",
    "Trial",
    "align",
    "envs",
    "expected_saturating_cost",
    "expert_distribution",
    "gaussian_kl",
    "joint_match",
    "load_demonstrations",
    "load_experiment",
    "load_policy",
    "load_recordings",
    "moment_match",
    "predict_step",
    "predict_trajectory",
    "sample_trajectories",
    "save_policy",
    "score_frequencies",
    "search_policy",
    "shipped_demonstrations",
    "trajectory_kl",
]
