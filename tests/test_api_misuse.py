"""What callers may get wrong: every public name says so in one line, and returns no number."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from reproduction.plots.errors import plot_errors_over_data
from reproduction.plots.frequencies import plot_frequencies
from reproduction.plots.success import plot_success_over_mass, plot_success_over_settings
from reproduction.plots.variants import plot_variants
from reproduction.sampling_frequency import Recording, score_frequencies
from tests.helpers.draws import Draws
from tests.helpers.losses import SPACE, make_cost, make_kl, make_parts, start
from tests.helpers.short_run import short_experiment
from torch_pmil import (
    AlignmentError,
    DemonstrationError,
    Demonstrations,
    Experience,
    Gaussian,
    GPDynamics,
    KernelExpansion,
    LBFGSStepper,
    MatchSpace,
    Moments,
    MultiTargetKLLoss,
    NotPositiveDefiniteError,
    ParticlePrediction,
    PMILTrainer,
    PolicyFileError,
    PredictionError,
    RBFPolicy,
    SearchSettings,
    StatePolicy,
    StateSpace,
    Task,
    TrajectoryKLLoss,
    align,
    expected_saturating_cost,
    expert_distribution,
    gaussian_kl,
    joint_match,
    load_demonstrations,
    load_experiment,
    load_policy,
    moment_match,
    plotting,
    predict_step,
    predict_trajectory,
    sample_trajectories,
    search_policy,
    shipped_demonstrations,
    trajectory_kl,
)
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exploration import PDMovements, RandomActions
from torch_pmil.control.trigonometric_polynomial import cosine, match_of
from torch_pmil.demonstrations import Recordings
from torch_pmil.demonstrations.distribution import demonstration_spread, rms_error
from torch_pmil.demonstrations.preparation.alignment import resample
from torch_pmil.demonstrations.preparation.camera import plane_coordinates
from torch_pmil.demonstrations.preparation.jumps import without_jumps
from torch_pmil.envs import AdaptedEnv, CosSin, DoublePendulumEnv
from torch_pmil.model.calibration import (
    observed_coverage,
    two_sigma_coverage,
)
from torch_pmil.plotting.video import write_video
from torch_pmil.runs.training import train
from torch_pmil.torchrl_interop import BeliefPolicy, GPWorldModel, ImaginedEnv

Misuse = tuple[Callable[[], object], str, type[Exception]]

LONGEST = 500  # characters of a message
NAN, INF = math.nan, math.inf
UPPER_NAN = [[1.0, NAN], [0.0, 1.0]]
ASYMMETRIC = [[1.0, 0.5], [0.0, 1.0]]
INDEFINITE = [[1.0, 2.0], [2.0, 1.0]]
NAMED = ("q", "dq"), ("rad", "rad/s")
DRAWS = Draws(0)
ONE = torch.ones(1, dtype=torch.float64)
ACTIONS = ActionSpace(("u",), ("N·m",), -ONE, ONE)
GP_MODEL = DRAWS.gp(6, 2, 2)
POLICY, DYNAMICS = make_parts(DRAWS)
OTHER_DYNAMICS = GPDynamics(4, 3)
OTHER_DYNAMICS.set_data(DRAWS.normal(4, 4), DRAWS.normal(4, 3))
STATE_POLICY = StatePolicy(POLICY, SPACE, 0.1)
LINE = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
WORLD = GPWorldModel(2, 1)
TIMES = torch.arange(5.0)
TWO = np.zeros(2)
FRAME = np.zeros((16, 16, 3), dtype=np.uint8)
PHASES = torch.linspace(0, 6, 121, dtype=torch.float64)
RECORDING = Recording(PHASES.sin()[:, None], PHASES.cos()[:-1, None])


def misuse(call: Callable[[], object], said: str, error: type[Exception] = ValueError) -> Misuse:
    """What a caller does, what the message holds beside what came, and its type."""
    return call, said, error


def numbers(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def eye(size: int) -> Tensor:
    return torch.eye(size, dtype=torch.float64)


def sure(*mean: float) -> Gaussian:
    """A belief of that mean and unit variances."""
    return Gaussian(numbers(*mean), eye(len(mean)))


def covered(cov: list[list[float]]) -> Gaussian:
    """A belief of that covariance."""
    return Gaussian(torch.zeros(len(cov), dtype=torch.float64), torch.tensor(cov).double())


START = Gaussian(numbers(0.0, 0.0), 0.01 * eye(2))
FIVE, THREE = (Gaussian(torch.zeros(T, 2).double(), eye(2).expand(T, 2, 2)) for T in (5, 3))
STEPS = Gaussian(torch.zeros(5, 2), torch.eye(2).expand(5, 2, 2))


@cache
def experiment() -> Task:
    return short_experiment(4)


@cache
def robot() -> DoublePendulumEnv:
    return DoublePendulumEnv(seed=0)


def expansion(**changes: Tensor) -> KernelExpansion:
    one = {"weights": torch.ones(1, 3).double(), "signal_variance": ONE}
    centres = {"inputs": torch.zeros(3, 2).double(), "lengthscales": torch.ones(1, 2).double()}
    return KernelExpansion(**(one | centres | changes))


def matched(function: KernelExpansion) -> Moments:
    return moment_match(function, sure(0.0, 0.0))


def from_data(**changes: object) -> KernelExpansion:
    data = {"inputs": torch.zeros(5, 2).double(), "targets": torch.zeros(1, 5).double()}
    kernel = {"lengthscales": torch.ones(1, 2).double(), "signal_variance": ONE}
    return KernelExpansion.from_data(**(data | kernel | {"noise_variance": 0.1 * ONE} | changes))


def network(**changes: object) -> RBFPolicy:
    shapes = {"centres": torch.zeros(3, 2), "u_max": torch.ones(1), "scale": torch.ones(2)}
    return RBFPolicy(**(shapes | changes))


def space_of(
    names: tuple[str, ...] = NAMED[0],
    units: tuple[str, ...] = NAMED[1],
    angles: object = (0,),
    match: MatchSpace | None = None,
) -> StateSpace:
    return StateSpace(names, units, angles, match or joint_match(names, units))


def movements(**changes: object) -> PDMovements:
    body = {"pose": torch.zeros(2), "reach": torch.tensor([0.4, 0.0]), "u_max": torch.ones(1)}
    plan = {"gain": torch.tensor([[5.0, 1.0]]), "hold": 5, "rollouts": 3, "steps": 20}
    return PDMovements(**(body | plan | {"feedforward": lambda state: state} | changes))


def fitted(inputs: object, targets: object, **options: int) -> object:
    return GPDynamics(2, 1).fit(inputs, targets, **options)


def transitions(count: int = 4, **changes: object) -> TensorDict:
    states, actions = torch.zeros(count, 2), torch.zeros(count, 1)
    whole = {"observation": states, "action": actions, "next": {"observation": states}}
    return TensorDict(whole | changes, [count])


def filled() -> Experience:
    experience = Experience(9)
    experience.extend(transitions())
    return experience


def predicted(**changes: object) -> Gaussian:
    parts = {"policy": POLICY, "dynamics": DYNAMICS, "space": SPACE}
    return predict_trajectory(**({"initial": START, "horizon": 3} | parts | changes))


def sampled(initial: Gaussian = START, horizon: int = 3, count: int = 10) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return sample_trajectories(initial, POLICY, DYNAMICS, SPACE, horizon, count, generator)


def scores(**changes: object) -> object:
    told = {"recordings": [RECORDING], "time_step": 0.05, "frequencies": [4.0], "space": LINE}
    return score_frequencies(**(told | changes))


def kl_loss(demonstrated: Gaussian, noise_std: object) -> TrajectoryKLLoss:
    return TrajectoryKLLoss(POLICY, DYNAMICS, SPACE, demonstrated, noise_std)


def multi_target(targets: Tensor) -> MultiTargetKLLoss:
    policy = RBFPolicy(torch.zeros(5, 4), ONE, torch.ones(4))
    shown = Gaussian(torch.zeros(3, 5, 2).double(), eye(2).expand(3, 5, 2, 2))
    return MultiTargetKLLoss(policy, DYNAMICS, SPACE, shown, targets, 0.1)


def trainer(**changes: object) -> PMILTrainer:
    """The trainer of a short run, with other arguments."""
    task, generators = experiment(), [torch.Generator().manual_seed(i) for i in (0, 1)]
    made = task.make_policy(generators[0])
    names = ("initial", "limits", "error", "tolerance", "search", "make_policy", "exploration")
    arguments = {
        **{name: getattr(task, name) for name in names},
        "env": task.robot(0),
        "evaluation_env": task.robots(2, 1),
        "loss_module": task.make_loss(made, task.make_dynamics()),
        "confirmations": 1,
        "trials": 1,
        "policy_generator": generators[0],
        "generator": generators[1],
        "progress_bar": False,
    }
    return PMILTrainer(**(arguments | changes))


def shown(positions: object = None, **changes: object) -> Demonstrations:
    positions = torch.zeros(2, 5, 1) if positions is None else positions
    return Demonstrations(positions, **({"time_step": 0.1, "names": ("x",)} | changes))


def loaded(time_step: float) -> Demonstrations:
    shown().save("shown.npz")
    return load_demonstrations("shown.npz", time_step)


def lines(*lengths: int) -> list[Tensor]:
    return [torch.linspace(0, 1, length).double()[:, None] for length in lengths]


def distributions(**changes: object) -> plotting.Figure:
    beliefs = {"demonstrated": STEPS, "predicted": STEPS}
    paths = {"demonstrations": torch.zeros(2, 6, 2), "executed": torch.zeros(3, 6, 2)}
    labels = {"names": NAMED[0], "units": NAMED[1], "time_step": 0.1}
    return plotting.plot_distributions(**(beliefs | paths | labels | changes))


GP = {
    "Gaussian of lists": misuse(
        lambda: Gaussian([0.0], [[1.0]]),
        "mean and cov must be tensors, got list and list",
        TypeError,
    ),
    "Gaussian of NumPy arrays": misuse(
        lambda: Gaussian(np.zeros(2), np.eye(2)), "mean and cov must be tensors, got", TypeError
    ),
    "Gaussian of variances in place of a covariance": misuse(
        lambda: Gaussian(torch.zeros(3), torch.ones(3)),
        "cov must have shape (*batch, D, D) = (3, 3)",
    ),
    "Gaussian of a batch with one covariance": misuse(
        lambda: Gaussian(torch.zeros(3, 2), torch.eye(2)),
        "cov must have shape (*batch, D, D) = (3,",
    ),
    "Gaussian.sample, a negative count": misuse(
        lambda: sure(0.0).sample(-1), "count must be a whole number of at least 0, got -1"
    ),
    "Gaussian.add_noise, a negative variance": misuse(
        lambda: sure(0.0, 0).add_noise(-1.0),
        "variance must be finite, not negative, and one number",
    ),
    "Gaussian.add_noise, a variance of NaN": misuse(
        lambda: sure(0.0, 0).add_noise(NAN), "variance must be finite, not negative, and one number"
    ),
    "Gaussian.add_noise, variances of other entries": misuse(
        lambda: sure(0.0, 0).add_noise(torch.ones(3)), "variance must be finite, not negative, and"
    ),
    "moment_match, a mean of NaN": misuse(
        lambda: moment_match(GP_MODEL, sure(NAN, 0.0)), "mean of belief must be finite, got nan in"
    ),
    "moment_match, NaN above the diagonal": misuse(
        lambda: moment_match(GP_MODEL, covered(UPPER_NAN)),
        "covariance of belief must be",
        NotPositiveDefiniteError,
    ),
    "moment_match, an indefinite covariance": misuse(
        lambda: moment_match(GP_MODEL, covered(INDEFINITE)),
        "covariance of belief must be",
        NotPositiveDefiniteError,
    ),
    "moment_match, float32 into float64": misuse(
        lambda: moment_match(GP_MODEL, Gaussian(torch.zeros(2), torch.eye(2))),
        "belief must have mean and",
    ),
    "moment_match, integers": misuse(
        lambda: moment_match(GP_MODEL, Gaussian(torch.zeros(2).long(), eye(2).long())),
        "belief must have mean and",
    ),
    "moment_match, a belief over other entries": misuse(
        lambda: moment_match(GP_MODEL, sure(0.0)), "belief must have the model's 2 inputs, got 1"
    ),
    "moment_match, no model": misuse(
        lambda: moment_match(None, sure(0.0)), "model must be an ExactGP or a", TypeError
    ),
    "moment_match, a tensor for a belief": misuse(
        lambda: moment_match(GP_MODEL, torch.zeros(2)), "belief must be a Gaussian, got", TypeError
    ),
    "moment_match, the noise of a network": misuse(
        lambda: moment_match(DRAWS.network(3, 2, 1), sure(0.0, 0.0), observation_noise=True),
        "observation_noise must be",
    ),
    "moment_match, a negative signal variance": misuse(
        lambda: matched(expansion(signal_variance=-ONE)), "signal_variance must be positive, got -1"
    ),
    "moment_match, weights of NaN": misuse(
        lambda: matched(expansion(weights=torch.full((1, 3), NAN).double())),
        "weights must be finite, got",
    ),
    "moment_match, centres of NaN": misuse(
        lambda: matched(expansion(inputs=torch.full((3, 2), NAN).double())),
        "inputs must be finite, got",
    ),
    "KernelExpansion without centres": misuse(
        lambda: matched(
            expansion(inputs=torch.zeros(0, 2).double(), weights=torch.zeros(1, 0).double())
        ),
        "inputs, weights, lengthscales",
    ),
    "KernelExpansion, weights for other centres": misuse(
        lambda: expansion(weights=torch.ones(1, 4).double()), "inputs, weights, lengthscales and"
    ),
    "KernelExpansion, lengthscales of one row": misuse(
        lambda: expansion(lengthscales=torch.ones(2).double()), "inputs, weights, lengthscales and"
    ),
    "KernelExpansion, signal variances of other outputs": misuse(
        lambda: expansion(signal_variance=torch.ones(2)), "inputs, weights, lengthscales and"
    ),
    "KernelExpansion, inputs in a vector": misuse(
        lambda: expansion(inputs=torch.zeros(3)),
        "inputs, weights, lengthscales and signal_variance",
    ),
    "KernelExpansion, one inverse for all outputs": misuse(
        lambda: expansion(gram_inverse=eye(3)), "inputs, weights, lengthscales and signal_variance"
    ),
    "KernelExpansion.mean, a point of other inputs": misuse(
        lambda: expansion().mean(torch.zeros(3).double()), "points must have the 2 inputs of the"
    ),
    "KernelExpansion.predict, a point of other inputs": misuse(
        lambda: expansion().predict(torch.zeros(3).double()), "points must have the 2 inputs of the"
    ),
    "from_data, lengthscales of zero": misuse(
        lambda: from_data(lengthscales=torch.zeros(1, 2).double()),
        "lengthscales must be positive, got 0",
    ),
    "from_data, negative lengthscales": misuse(
        lambda: from_data(lengthscales=-torch.ones(1, 2).double()),
        "lengthscales must be positive, got -1",
    ),
    "from_data, a negative signal variance": misuse(
        lambda: from_data(signal_variance=-ONE), "signal_variance must be positive, got -1"
    ),
    "from_data, a negative noise variance": misuse(
        lambda: from_data(noise_variance=-ONE), "noise_variance must not be negative, got -1"
    ),
    "from_data, no data": misuse(
        lambda: from_data(inputs=torch.zeros(0, 2).double(), targets=torch.zeros(1, 0).double()),
        "targets must have shape (E, n), got (1, 0)",
    ),
    "from_data, targets of NaN": misuse(
        lambda: from_data(targets=torch.full((1, 5), NAN).double()),
        "targets must be finite, got nan",
    ),
    "from_data, targets of float32": misuse(
        lambda: from_data(targets=torch.zeros(1, 5)),
        "targets must be a float like inputs (torch.float64),",
    ),
    "from_data, targets transposed": misuse(
        lambda: from_data(targets=torch.zeros(5, 1).double()),
        "inputs must have shape (1, D), got (5, 2)",
    ),
    "from_data, offsets of other outputs": misuse(
        lambda: from_data(offset=torch.zeros(3).double()),
        "offset must be finite, and a number or (1,),",
    ),
    "from_data, a list": misuse(
        lambda: from_data(inputs=[[0.0]]), "inputs must be a tensor, got list", TypeError
    ),
}
CONTROL = {
    "RBFPolicy, centres of NaN": misuse(
        lambda: network(centres=torch.full((3, 2), NAN)),
        "centres must be finite, got nan in entry",
    ),
    "RBFPolicy, no centre": misuse(
        lambda: network(centres=torch.zeros(0, 2)),
        "centres must have shape (m, inputs), got (0, 2)",
    ),
    "RBFPolicy, complex centres": misuse(
        lambda: network(centres=torch.zeros(3, 2).cdouble()), "centres must hold real numbers, got"
    ),
    "RBFPolicy, truth values for centres": misuse(
        lambda: network(centres=torch.zeros(3, 2).bool()),
        "centres must hold real numbers, got torch.bool",
    ),
    "RBFPolicy, a list": misuse(
        lambda: network(centres=[[0.0, 0.0]]), "centres must be a tensor, got list", TypeError
    ),
    "RBFPolicy, negative limits": misuse(
        lambda: network(u_max=-torch.ones(1)),
        "u_max must be positive, got -1",
    ),
    "RBFPolicy, limits of NaN": misuse(
        lambda: network(u_max=numbers(NAN)),
        "u_max must be finite, got nan in entry (0,)",
    ),
    "RBFPolicy, a number for limits": misuse(
        lambda: network(u_max=3.5), "u_max must be a tensor, got float", TypeError
    ),
    "RBFPolicy, a scale of NaN": misuse(
        lambda: network(scale=numbers(1.0, NAN)),
        "scale must be finite, got nan in entry (1,)",
    ),
    "RBFPolicy called with other features": misuse(
        lambda: network()(torch.zeros(3)), "features must have shape (*batch, 2), got (3,)"
    ),
    "RBFPolicy called with NaN": misuse(
        lambda: network()(torch.full((2,), NAN)), "features must be finite, got nan in entry (0,)"
    ),
    "fit_weights, other rows of actions": misuse(
        lambda: network().fit_weights(torch.zeros(3, 2), torch.zeros(4, 1)),
        "actions must have shape (3,",
    ),
    "fit_weights, other columns of actions": misuse(
        lambda: network().fit_weights(torch.zeros(3, 2), torch.zeros(3, 2)),
        "actions must have shape (3,",
    ),
    "fit_weights, actions of NaN": misuse(
        lambda: network().fit_weights(torch.zeros(3, 2), torch.full((3, 1), NAN)),
        "actions must be finite, got",
    ),
    "fit_weights, a negative penalty": misuse(
        lambda: network().fit_weights(torch.zeros(3, 2), torch.zeros(3, 1), ridge=-1.0),
        "ridge must be a positive",
    ),
    "fit_weights, no data": misuse(
        lambda: network().fit_weights(torch.zeros(0, 2), torch.zeros(0, 1)),
        "features must have shape (S,",
    ),
    "for_target, a target of NaN": misuse(
        lambda: network().for_target(numbers(NAN)), "target must be finite, got nan in entry (0,)"
    ),
    "StatePolicy called with three entries of two": misuse(
        lambda: STATE_POLICY(np.zeros(3)), "state must have shape (*batch, 2) for q, dq, got (3,)"
    ),
    "StatePolicy called with NaN": misuse(
        lambda: STATE_POLICY(numbers(0.0, NAN)), "state must be finite, got dq = nan"
    ),
    "StatePolicy called with a set": misuse(
        lambda: STATE_POLICY({0.0}), "state must be a NumPy array, a PyTorch tensor or", TypeError
    ),
    "StatePolicy called with text": misuse(
        lambda: STATE_POLICY(np.array(["a", "b"])),
        "state must hold real numbers, got <U1",
        TypeError,
    ),
    "StatePolicy called with a target that it has not": misuse(
        lambda: STATE_POLICY(np.zeros(2), np.zeros(1)), "policy must be called with a", TypeError
    ),
    "StatePolicy, a period of zero": misuse(
        lambda: StatePolicy(POLICY, SPACE, 0), "control_period (s) must be a positive finite"
    ),
    "StatePolicy, a period of NaN": misuse(
        lambda: StatePolicy(POLICY, SPACE, NAN), "control_period (s) must be a positive finite"
    ),
    "StatePolicy, a period in words": misuse(
        lambda: StatePolicy(POLICY, SPACE, "0.1"), "control_period (s) must be a positive finite"
    ),
    "load_policy of a folder": misuse(
        lambda: load_policy("."),
        "must be a file of save_policy: must be a regular",
        PolicyFileError,
    ),
    "export to a text file": misuse(
        lambda: STATE_POLICY.export("p.txt"), "an exported policy must be a .pt2 file, got p.txt"
    ),
    "MatchSpace, a name twice": misuse(
        lambda: MatchSpace(("x", "x"), ("m", "m"), torch.zeros(0, 2), torch.eye(2)),
        "names must be different, got",
    ),
    "MatchSpace, weights of another shape": misuse(
        lambda: MatchSpace(("x",), ("m",), torch.ones(1, 1), torch.ones(1, 2)),
        "weights must have shape (1,",
    ),
    "MatchSpace of nothing": misuse(
        lambda: MatchSpace((), (), torch.zeros(0, 1), torch.zeros(0, 1)),
        "names must be those of one",
    ),
    "MatchSpace, complex weights": misuse(
        lambda: MatchSpace(("x",), ("m",), torch.zeros(0, 1), torch.eye(1).cdouble()),
        "weights must hold real",
    ),
    "MatchSpace called with other entries": misuse(
        lambda: joint_match(*NAMED)(torch.zeros(3)), "states must have shape (*batch, 2), got (3,)"
    ),
    "joint_match, units of other entries": misuse(
        lambda: joint_match(("q",), ("a", "b")),
        "weights must have shape (1, 1) and units 1 entries,",
    ),
    "StateSpace, a name twice": misuse(
        lambda: StateSpace(("q", "q"), ("a", "b"), (), joint_match(*NAMED)),
        "names must be different, got",
    ),
    "StateSpace, an angle beyond the entries": misuse(
        lambda: space_of(angles=(2,)), "angles must be indices below 2, got (2,)"
    ),
    "StateSpace, an angle twice": misuse(
        lambda: space_of(angles=(0, 0)), "angles must be different indices, got (0, 0)"
    ),
    "StateSpace, an angle that is no index": misuse(
        lambda: space_of(angles=(0.0,)), "angles must be indices below 2, got (0.0,)"
    ),
    "StateSpace, a number for angles": misuse(
        lambda: space_of(angles=0), "angles must be indices below 2, got 0"
    ),
    "StateSpace, a match space of other entries": misuse(
        lambda: space_of(match=joint_match(("q",), ("rad",))),
        "units and the match space must be for",
    ),
    "features of other entries": misuse(
        lambda: SPACE.features(torch.zeros(3)), "states must have shape (*batch, 2), got (3,)"
    ),
    "observations of other entries": misuse(
        lambda: SPACE.observe(torch.zeros(3)), "states must have shape (*batch, 2), got (3,)"
    ),
    "match_of, an angle beyond the entries": misuse(
        lambda: match_of([cosine((1,))], ("x",), ("m",), 2, (5,)),
        "angles must be entries below 2, as",
    ),
    "match_of, too few angles": misuse(
        lambda: match_of([cosine((1, 1))], ("x",), ("m",), 2, (0,)),
        "angles must be entries below 2, as",
    ),
    "RandomActions, a fraction of NaN": misuse(
        lambda: RandomActions(ACTIONS, NAN, 5), "fraction must be above 0 and at most 1, got"
    ),
    "RandomActions, a negative fraction": misuse(
        lambda: RandomActions(ACTIONS, -0.5, 5), "fraction must be above 0 and at most 1, got"
    ),
    "RandomActions without steps": misuse(
        lambda: RandomActions(ACTIONS, 0.5, 0), "steps must be a whole number of at least 1,"
    ),
    "RandomActions without rollouts": misuse(
        lambda: RandomActions(ACTIONS, 0.5, 5, 0), "rollouts must be a whole number of at"
    ),
    "RandomActions around two of one action": misuse(
        lambda: RandomActions(ACTIONS, 0.5, 5, around=torch.zeros(2)),
        "around must have shape (1,), got (2,)",
    ),
    "ActionSpace without room": misuse(
        lambda: replace(ACTIONS, low=ONE), "low must be below high, got [1.0] and [1.0]"
    ),
    "ActionSpace, an endless action": misuse(
        lambda: replace(ACTIONS, high=INF * ONE), "high must be finite, got inf in entry (0,)"
    ),
    "ActionSpace without units": misuse(
        lambda: replace(ACTIONS, units=()), "actions must have a name and a unit each, got ('u',)"
    ),
    "StatePolicy, actions of another robot": misuse(
        lambda: StatePolicy(POLICY, SPACE, 0.1, actions=replace(ACTIONS, low=-9 * ONE)),
        "actions must be those of the policy, 0 from ",
    ),
    "PDMovements without rollouts": misuse(
        lambda: movements(rollouts=0),
        "rollouts must be a whole number of at least 1, got 0",
    ),
    "PDMovements, gains of other torques": misuse(
        lambda: movements(gain=torch.ones(2, 2)), "gain must have shape (1, 2), got (2, 2)"
    ),
    "PDMovements, gains of NaN": misuse(
        lambda: movements(gain=torch.full((1, 2), NAN)),
        "gain must be finite, got nan in entry (0, 0)",
    ),
    "PDMovements, a pose of NaN": misuse(
        lambda: movements(pose=numbers(NAN, 0.0)), "pose must be finite, got nan in entry (0,)"
    ),
}
MODEL = {
    "GPDynamics without inputs": misuse(
        lambda: GPDynamics(0, 1), "num_inputs must be a whole number of at least 1, got 0"
    ),
    "GPDynamics, unknown targets": misuse(
        lambda: GPDynamics(1, 1, "delta"),
        'targets must be "difference" or "successor", got \'delta\'',
    ),
    "fit, other rows of targets": misuse(
        lambda: fitted(torch.zeros(5, 2), torch.zeros(4, 1)),
        "expected inputs (n, 2) and targets (n,",
    ),
    "fit, one transition": misuse(
        lambda: fitted(torch.zeros(1, 2), torch.zeros(1, 1)),
        "expected inputs (n, 2) and targets (n,",
    ),
    "fit, no data": misuse(
        lambda: fitted(torch.zeros(0, 2), torch.zeros(0, 1)),
        "expected inputs (n, 2) and targets (n,",
    ),
    "fit, inputs of NaN": misuse(
        lambda: fitted(torch.full((5, 2), NAN), torch.zeros(5, 1)),
        "inputs must be finite, got nan in",
    ),
    "fit, truth values": misuse(
        lambda: fitted(torch.zeros(5, 2).bool(), torch.zeros(5, 1)),
        "inputs must hold real numbers,",
    ),
    "fit, NumPy arrays": misuse(
        lambda: fitted(np.zeros((5, 2)), np.zeros((5, 1))),
        "inputs must be a tensor, got",
        TypeError,
    ),
    "fit, numbers": misuse(
        lambda: fitted(torch.tensor(0.0), torch.tensor(0.0)),
        "expected inputs (n, 2) and targets (n,",
    ),
    "Experience for nothing": misuse(
        lambda: Experience(0), "capacity must be a whole number of at least 1, got 0"
    ),
    "Experience for half a transition": misuse(
        lambda: Experience(2.5), "capacity must be a whole number of at least 1, got 2.5"
    ),
    "Experience for NaN": misuse(
        lambda: Experience(NAN), "capacity must be a whole number of at least 1, got nan"
    ),
    "Experience that is full": misuse(
        lambda: Experience(2).extend(transitions()), "experience holds at most 2 transitions, got 4"
    ),
    "Experience of NaN": misuse(
        lambda: Experience(9).extend(transitions(observation=torch.full((4, 2), NAN))),
        "must be finite, got nan in entry",
    ),
    "Experience without actions": misuse(
        lambda: Experience(9).extend(transitions().exclude("action")),
        "transitions must have",
        KeyError,
    ),
    "Experience without transitions": misuse(
        lambda: Experience(9).training_data(SPACE, "difference", torch.ones(2)),
        "experience must hold a",
    ),
    "Experience, limits of other entries": misuse(
        lambda: filled().training_data(SPACE, "difference", torch.ones(3)),
        "limits must have shape (2,),",
    ),
    "Experience, limits of NaN": misuse(
        lambda: filled().training_data(SPACE, "difference", numbers(NAN, 1.0)),
        "limits must be numbers that",
    ),
    "Experience, unknown targets": misuse(
        lambda: filled().training_data(SPACE, "delta", torch.ones(2)),
        'targets must be "difference"',
    ),
    "Experience, successors of other entries": misuse(
        lambda: Experience(9).extend(transitions(next={"observation": torch.zeros(4, 3)})),
        "transitions must have",
    ),
    "predict_trajectory, no step": misuse(
        lambda: predicted(horizon=0), "horizon must be a whole number of at least 1, got 0"
    ),
    "predict_trajectory, half a step": misuse(
        lambda: predicted(horizon=2.5), "horizon must be a whole number of at least 1, got 2.5"
    ),
    "predict_trajectory from other entries": misuse(
        lambda: predicted(initial=sure(0.0)),
        "initial must be over the 2 entries of the state, like the ",
    ),
    "predict_trajectory from NaN": misuse(
        lambda: predicted(initial=sure(0.0, NAN)),
        "mean of initial must be finite, got nan in entry (1,)",
    ),
    "predict_trajectory from float32": misuse(
        lambda: predicted(initial=Gaussian(torch.zeros(2), torch.eye(2))),
        "initial must have mean and",
    ),
    "predict_trajectory, an indefinite covariance": misuse(
        lambda: predicted(initial=covered(INDEFINITE)), "prediction of step 1 of 3", PredictionError
    ),
    "predict_trajectory, a model of other outputs": misuse(
        lambda: predicted(dynamics=OTHER_DYNAMICS),
        "initial must be over the 2 entries of the state, like",
    ),
    "predict_step from other entries": misuse(
        lambda: predict_step(sure(0.0), POLICY.controller, DYNAMICS, SPACE),
        "state must be over the 2",
    ),
    "sample_trajectories, no step": misuse(
        lambda: sampled(horizon=0), "horizon must be a whole number of at least 1, got 0"
    ),
    "sample_trajectories, no particle": misuse(
        lambda: sampled(count=0), "count must be a whole number of at least 1, got 0"
    ),
    "sample_trajectories from NaN": misuse(
        lambda: sampled(initial=sure(0.0, NAN)),
        "mean of initial must be finite, got nan in entry (1,)",
    ),
    "sample_trajectories from other entries": misuse(
        lambda: sampled(initial=sure(0.0)),
        "initial must be over the 2 entries of the state, like the ",
    ),
    "sample_trajectories, an indefinite covariance": misuse(
        lambda: sampled(initial=covered(INDEFINITE)),
        "covariance of initial must be",
        NotPositiveDefiniteError,
    ),
    "sample_trajectories from float32": misuse(
        lambda: sampled(initial=Gaussian(torch.zeros(2), torch.eye(2))),
        "initial must have mean and",
    ),
    "ParticlePrediction of one particle": misuse(
        lambda: ParticlePrediction(1), "count must be a whole number of at least 2, got 1"
    ),
    "ParticlePrediction of NaN particles": misuse(
        lambda: ParticlePrediction(NAN), "count must be a whole number of at least 2, got nan"
    ),
    "ParticlePrediction, a negative seed": misuse(
        lambda: ParticlePrediction(10, seed=-1), "seed must be a whole number from 0 to"
    ),
    "ParticlePrediction, a seed of thirty digits": misuse(
        lambda: ParticlePrediction(10, seed=10**30), "seed must be a whole number from 0 to"
    ),
    "score_frequencies without recordings": misuse(
        lambda: scores(recordings=[]), "recordings must hold one at least, got none"
    ),
    "score_frequencies at 0 Hz": misuse(
        lambda: scores(frequencies=[0.0]), "frequencies must be positive and finite, in Hz, got 0.0"
    ),
    "score_frequencies at NaN Hz": misuse(
        lambda: scores(frequencies=[NAN]), "frequencies must be positive and finite, in Hz, got nan"
    ),
    "score_frequencies at none": misuse(
        lambda: scores(frequencies=[]), "frequencies must hold one at least, got none"
    ),
    "score_frequencies, a time step of zero": misuse(
        lambda: scores(time_step=0.0), "time_step must be positive and finite, in s, got 0.0"
    ),
    "score_frequencies with one fold": misuse(
        lambda: scores(folds=1), "folds must be a whole number of at least 2, got 1"
    ),
    "score_frequencies without iterations": misuse(
        lambda: scores(max_iterations=0),
        "max_iterations must be a whole number of at least 1, got 0",
    ),
    "score_frequencies, states of NaN": misuse(
        lambda: scores(recordings=[Recording(RECORDING.states * NAN, RECORDING.actions)]),
        "states of recording 0 must be",
    ),
    "score_frequencies of a short recording": misuse(
        lambda: scores(recordings=[Recording(RECORDING.states[:5], RECORDING.actions[:4])]),
        "4 Hz must leave at least 10",
    ),
    "score_frequencies of a tuple": misuse(
        lambda: scores(recordings=[(RECORDING.states, RECORDING.actions)]),
        "recording 0 must be a",
        TypeError,
    ),
    "observed_coverage of twice as many": misuse(
        lambda: observed_coverage(torch.zeros(3, 1), torch.tensor([2.0])),
        "probabilities must be from 0",
    ),
    "two_sigma_coverage of other steps": misuse(
        lambda: two_sigma_coverage(STEPS, torch.zeros(3, 5, 2)),
        "executed must have shape (N, 6, 2),",
    ),
}
SEARCH = {
    "gaussian_kl of one and two entries": misuse(
        lambda: gaussian_kl(sure(0.0), sure(0.0, 0.0)), "p and q must have the same entries, and"
    ),
    "gaussian_kl of five and three": misuse(
        lambda: gaussian_kl(FIVE, THREE), "p and q must have the same entries, and batches that "
    ),
    "gaussian_kl, a mean of NaN": misuse(
        lambda: gaussian_kl(sure(NAN, 0.0), sure(0.0, 0.0)), "mean of p must be finite, got nan in"
    ),
    "gaussian_kl, an infinite mean": misuse(
        lambda: gaussian_kl(sure(0.0, 0.0), sure(INF, 0.0)), "mean of q must be finite, got inf in"
    ),
    "gaussian_kl, NaN above the diagonal": misuse(
        lambda: gaussian_kl(sure(0.0, 0.0), covered(UPPER_NAN)),
        "covariance of q must be",
        NotPositiveDefiniteError,
    ),
    "gaussian_kl, an asymmetric covariance": misuse(
        lambda: gaussian_kl(covered(ASYMMETRIC), sure(0.0, 0.0)),
        "covariance of p must be",
        NotPositiveDefiniteError,
    ),
    "gaussian_kl, an indefinite covariance": misuse(
        lambda: gaussian_kl(covered(INDEFINITE), sure(0.0, 0.0)),
        "covariance of p must be",
        NotPositiveDefiniteError,
    ),
    "gaussian_kl, a singular covariance": misuse(
        lambda: gaussian_kl(sure(0.0, 0.0), covered([[1.0, 0], [0, 0]])),
        "covariance of q must be",
        NotPositiveDefiniteError,
    ),
    "gaussian_kl of float32 and float64": misuse(
        lambda: gaussian_kl(Gaussian(torch.zeros(2), torch.eye(2)), sure(0.0, 0.0)),
        "q must have mean and",
    ),
    "gaussian_kl of integers": misuse(
        lambda: gaussian_kl(
            Gaussian(torch.zeros(2).long(), torch.eye(2).long()),
            Gaussian(torch.zeros(2).long(), torch.eye(2).long()),
        ),
        "p must have mean and",
    ),
    "gaussian_kl of a tensor": misuse(
        lambda: gaussian_kl(torch.zeros(2), sure(0.0, 0.0)), "p must be a Gaussian, got", TypeError
    ),
    "trajectory_kl of five and three steps": misuse(
        lambda: trajectory_kl(FIVE, THREE), "p and q must have the same entries, and batches that "
    ),
    "trajectory_kl of five steps and one": misuse(
        lambda: trajectory_kl(FIVE, FIVE[:1]), "demonstrated and predicted must be over the same"
    ),
    "trajectory_kl without time": misuse(
        lambda: trajectory_kl(sure(0.0), sure(0.0)), "demonstrated and predicted must be over the"
    ),
    "trajectory_kl of NaN": misuse(
        lambda: trajectory_kl(FIVE, Gaussian(FIVE.mean * NAN, FIVE.cov)),
        "mean of q must be finite, got",
    ),
    "expected_saturating_cost, a mean of NaN": misuse(
        lambda: expected_saturating_cost(sure(NAN)), "mean of residual must be finite, got nan in"
    ),
    "expected_saturating_cost, NaN above the diagonal": misuse(
        lambda: expected_saturating_cost(covered(UPPER_NAN)),
        "covariance of residual must",
        NotPositiveDefiniteError,
    ),
    "expected_saturating_cost, an asymmetric covariance": misuse(
        lambda: expected_saturating_cost(covered(ASYMMETRIC)),
        "covariance of residual must",
        NotPositiveDefiniteError,
    ),
    "expected_saturating_cost, a negative variance": misuse(
        lambda: expected_saturating_cost(covered([[-0.5]])),
        "covariance of residual must",
        NotPositiveDefiniteError,
    ),
    "expected_saturating_cost, an infinite variance": misuse(
        lambda: expected_saturating_cost(covered([[INF]])),
        "covariance of residual must",
        NotPositiveDefiniteError,
    ),
    "expected_saturating_cost of integers": misuse(
        lambda: expected_saturating_cost(Gaussian(torch.zeros(2).long(), torch.eye(2).long())),
        "residual must have mean and",
    ),
    "expected_saturating_cost of two dtypes": misuse(
        lambda: expected_saturating_cost(Gaussian(torch.zeros(2), eye(2))),
        "residual must have mean and",
    ),
    "expected_saturating_cost of a tensor": misuse(
        lambda: expected_saturating_cost(torch.zeros(2)), "residual must be a Gaussian,", TypeError
    ),
    "SearchSettings, a negative threshold": misuse(
        lambda: SearchSettings(trust_threshold=-1.0),
        "trust_threshold must not be negative, got -1.0",
    ),
    "SearchSettings, a threshold in words": misuse(
        lambda: SearchSettings(trust_threshold="3"), "trust_threshold must be a number, got '3'"
    ),
    "SearchSettings, iterations in words": misuse(
        lambda: SearchSettings("5"), "mean_iterations must be an integer of at least 0, got '5'"
    ),
    "SearchSettings, no number of iterations": misuse(
        lambda: SearchSettings(mean_iterations=None), "mean_iterations must be an integer of at"
    ),
    "TrajectoryKLLoss, an unknown reduction": misuse(
        lambda: make_kl(0, reduction="max"),
        'reduction must be "none", "mean" or "sum", got \'max\'',
    ),
    "TrajectoryKLLoss, negative noise": misuse(
        lambda: kl_loss(FIVE, -0.1), "noise_std must not be negative, got -0.1"
    ),
    "TrajectoryKLLoss, noise of NaN": misuse(
        lambda: kl_loss(FIVE, NAN), "noise_std must not be negative, got nan"
    ),
    "TrajectoryKLLoss, infinite noise": misuse(
        lambda: kl_loss(FIVE, INF), "noise_std must be a number or one for each of x, y, got inf"
    ),
    "TrajectoryKLLoss, noise in words": misuse(
        lambda: kl_loss(FIVE, "0.1"),
        "noise_std must be a number or one for each of x, y, got '0.1'",
    ),
    "TrajectoryKLLoss of one marginal": misuse(
        lambda: kl_loss(sure(0.0, 0.0), 0.1), "demonstrated must be marginals at one step at least,"
    ),
    "TrajectoryKLLoss, demonstrated NaN": misuse(
        lambda: kl_loss(Gaussian(FIVE.mean * NAN, FIVE.cov), 0.1),
        "mean of demonstrated must be finite,",
    ),
    "TrajectoryKLLoss, demonstrated negative variances": misuse(
        lambda: kl_loss(Gaussian(FIVE.mean, -FIVE.cov), 0.1),
        "covariance of demonstrated",
        NotPositiveDefiniteError,
    ),
    "TrajectoryKLLoss without steps": misuse(
        lambda: kl_loss(FIVE[:0], 0.1), "demonstrated must be marginals at one step at least, mean"
    ),
    "TrajectoryKLLoss without a start": misuse(
        lambda: make_kl(0)(TensorDict({})), "TrajectoryKLLoss reads ('observation',", KeyError
    ),
    "TrajectoryKLLoss from other entries": misuse(
        lambda: make_kl(0)(start(sure(0.0))),
        "('observation', 'mean') must hold the 2 entries ('q',",
    ),
    "TrajectoryKLLoss beyond its horizon": misuse(
        lambda: make_kl(0).per_step(START, 99), "horizon must be a whole number from 1 to 4, got 99"
    ),
    "ExpectedSaturatingCost, a target of NaN": misuse(
        lambda: make_cost(0, target=numbers(NAN, 0.0)),
        "target must be finite, got nan in entry (0,)",
    ),
    "ExpectedSaturatingCost, a width of zero": misuse(
        lambda: make_cost(0, width=0.0), "width must be a positive finite number, got 0.0"
    ),
    "ExpectedSaturatingCost, an infinite width": misuse(
        lambda: make_cost(0, width=INF), "width must be a positive finite number, got inf"
    ),
    "ExpectedSaturatingCost, half a step": misuse(
        lambda: make_cost(0, horizon=2.5), "horizon must be a whole number of at least 1, got 2.5"
    ),
    "ExpectedSaturatingCost, indefinite weights": misuse(
        lambda: make_cost(0, weight=torch.tensor(INDEFINITE)),
        "weight must be symmetric and positive",
    ),
    "ExpectedSaturatingCost, weights of NaN": misuse(
        lambda: make_cost(0, weight=torch.full((2, 2), NAN)),
        "weight must be finite, got nan in entry",
    ),
    "MultiTargetKLLoss, targets in a vector": misuse(
        lambda: multi_target(torch.zeros(3)), "targets must have shape (S, K) and the demonstrated "
    ),
    "MultiTargetKLLoss, targets of NaN": misuse(
        lambda: multi_target(torch.full((3, 1), NAN)),
        "targets must be finite, got nan in entry (0, 0)",
    ),
    "search_policy from NaN": misuse(
        lambda: search_policy(make_kl(0), sure(0.0, NAN), SearchSettings(1, 1, 1)),
        "mean of initial must be",
    ),
    "search_policy from three starts": misuse(
        lambda: search_policy(
            make_kl(0),
            Gaussian(torch.zeros(3, 2).double(), eye(2).expand(3, 2, 2)),
            SearchSettings(1, 1, 1),
        ),
        "initial must be one belief,",
    ),
    "search_policy, a dictionary of settings": misuse(
        lambda: search_policy(make_kl(0), START, {"mean_iterations": 1}),
        "settings must be",
        TypeError,
    ),
}
TRAINER = {
    "LBFGSStepper without iterations": misuse(
        lambda: LBFGSStepper(0), "max_iterations must be a whole number of at least 1, got 0"
    ),
    "LBFGSStepper of NaN iterations": misuse(
        lambda: LBFGSStepper(NAN), "max_iterations must be a whole number of at least 1, got nan"
    ),
    "PMILTrainer without trials": misuse(
        lambda: trainer(trials=0), "trials must be a whole number of at least 1, got 0"
    ),
    "PMILTrainer, one and a half trials": misuse(
        lambda: trainer(trials=1.5), "trials must be a whole number of at least 1, got 1.5"
    ),
    "PMILTrainer without confirmations": misuse(
        lambda: trainer(confirmations=0),
        "confirmations must be a whole number of at least 1, got 0",
    ),
    "PMILTrainer, a tolerance of NaN": misuse(
        lambda: trainer(tolerance=NAN),
        "tolerance must be a finite number that is not negative, got",
    ),
    "PMILTrainer, a negative tolerance": misuse(
        lambda: trainer(tolerance=-1.0), "tolerance must be a finite number that is not negative,"
    ),
    "PMILTrainer, limits of other entries": misuse(
        lambda: trainer(limits=torch.ones(3)), "limits must have shape (4,), got (3,)"
    ),
    "PMILTrainer, limits of NaN": misuse(
        lambda: trainer(limits=torch.full((4,), NAN)),
        "limits must be numbers that are not negative,",
    ),
    "PMILTrainer from other entries": misuse(
        lambda: trainer(initial=sure(0.0)), "initial must be over the 4 entries of the state, like"
    ),
    "PMILTrainer from NaN": misuse(
        lambda: trainer(initial=sure(NAN, 0, 0, 0)),
        "mean of initial must be finite, got nan in entry",
    ),
    "PMILTrainer without a robot": misuse(
        lambda: trainer(env=None), "env must be an instance of EnvBase, got NoneType", TypeError
    ),
    "PMILTrainer, the name of a robot": misuse(
        lambda: trainer(env="Pendulum-v1"), "env must be an instance of EnvBase, got str", TypeError
    ),
    "PMILTrainer with robots to measure on of another kind": misuse(
        lambda: trainer(evaluation_env=20), "evaluation_env must be an instance of", TypeError
    ),
    "PMILTrainer, exploration without rollouts": misuse(
        lambda: trainer(exploration=RandomActions(ACTIONS, 0.4, 5, 0)),
        "rollouts must be a whole",
    ),
    "PMILTrainer, a dictionary of settings": misuse(
        lambda: trainer(search={}), "search must be an instance of SearchSettings, got", TypeError
    ),
    "PMILTrainer, a seed for a generator": misuse(
        lambda: trainer(generator=0),
        "generator must be an instance of Generator, got int",
        TypeError,
    ),
    "PMILTrainer.resume without checkpoints": misuse(
        lambda: trainer().resume(),
        "resume must be given a checkpoint or a checkpoint_rotation, got",
    ),
    "PMILTrainer.best_policy before training": misuse(
        lambda: trainer().best_policy(), "a policy must have run to be the best, got", RuntimeError
    ),
    "train, a negative seed": misuse(
        lambda: train(experiment(), -1, 1, "r", "x"),
        "seed must be a whole number from 0 to 2147483647,",
    ),
    "train, no trial": misuse(
        lambda: train(experiment(), 0, 0, "r", "x"),
        "trials must be a whole number from 1 to 1000, got 0",
    ),
    "train, an unknown logger": misuse(
        lambda: train(experiment(), 0, 1, "r", "x", logger="log"), "logger must be one of csv,"
    ),
    "train, the name of an experiment": misuse(
        lambda: train("double_pendulum", 0, 1, "r", "x"),
        "experiment must be an Task,",
        TypeError,
    ),
}
DEMONSTRATIONS = {
    "Demonstrations, one of them": misuse(
        lambda: shown(torch.zeros(1, 5, 1)), "positions must hold at least two", DemonstrationError
    ),
    "Demonstrations of one sample": misuse(
        lambda: shown(torch.zeros(2, 1, 1)), "positions must hold at least two", DemonstrationError
    ),
    "Demonstrations, a time step of zero": misuse(
        lambda: shown(time_step=0.0),
        "time_step must be positive and finite, in",
        DemonstrationError,
    ),
    "Demonstrations, a time step of NaN": misuse(
        lambda: shown(time_step=NAN),
        "time_step must be positive and finite, in",
        DemonstrationError,
    ),
    "Demonstrations, a time step in words": misuse(
        lambda: shown(time_step="fast"),
        "time_step must be positive and finite, in",
        DemonstrationError,
    ),
    "Demonstrations without a time step": misuse(
        lambda: shown(time_step=None),
        "time_step must be positive and finite, in",
        DemonstrationError,
    ),
    "Demonstrations, a name twice": misuse(
        lambda: shown(torch.zeros(2, 5, 2), names=("x", "x")),
        "names must be 2 different",
        DemonstrationError,
    ),
    "Demonstrations of NaN": misuse(
        lambda: shown(torch.full((2, 5, 1), NAN)),
        "positions must be finite, got",
        DemonstrationError,
    ),
    "Demonstrations of text": misuse(
        lambda: shown("abc"),
        "positions must be an array of numbers, got new():",
        DemonstrationError,
    ),
    "Demonstrations of complex numbers": misuse(
        lambda: shown(torch.zeros(2, 5, 1).cdouble()),
        "positions must hold real",
        DemonstrationError,
    ),
    "Demonstrations, one for each target": misuse(
        lambda: shown(targets=torch.tensor([[0.0], [1.0]]), target_names=("y",)),
        "each target must have at",
        DemonstrationError,
    ),
    "expert_distribution without noise": misuse(
        lambda: expert_distribution(shown(), 0.0), "noise_std must be positive, got 0.0"
    ),
    "expert_distribution, infinite noise": misuse(
        lambda: expert_distribution(shown(), INF),
        "noise_std must be a number or one for each of x,",
    ),
    "expert_distribution, noise in words": misuse(
        lambda: expert_distribution(shown(), "0.1"), "noise_std must be a number or one for each of"
    ),
    "expert_distribution of a tensor": misuse(
        lambda: expert_distribution(torch.zeros(2, 5, 1), 0.1), "demonstrations must be", TypeError
    ),
    "rms_error of other entries": misuse(
        lambda: rms_error(shown(), torch.zeros(3, 5, 2)),
        "executed must have shape (N, 5, 1), got (3,",
    ),
    "rms_error of other steps": misuse(
        lambda: rms_error(shown(), torch.zeros(3, 2, 1)),
        "executed must have shape (N, 5, 1), got (3,",
    ),
    "rms_error of no rollout": misuse(
        lambda: rms_error(shown(), torch.zeros(0, 5, 1)),
        "executed must have shape (N, 5, 1), got (0,",
    ),
    "rms_error of NaN": misuse(
        lambda: rms_error(shown(), torch.full((3, 5, 1), NAN)),
        "executed must be finite, got nan in",
    ),
    "demonstration_spread of a tensor": misuse(
        lambda: demonstration_spread(torch.zeros(2, 5, 1)), "demonstrations must be", TypeError
    ),
    "load_demonstrations, a time step of NaN": misuse(
        lambda: loaded(time_step=NAN), "time_step must be nan s, got 0.1 s", DemonstrationError
    ),
    "shipped_demonstrations of a path": misuse(
        lambda: shipped_demonstrations("../x"), "shipped demonstrations must be", DemonstrationError
    ),
    "align, one trajectory": misuse(
        lambda: align(lines(9)), "at least two trajectories are needed, got 1", AlignmentError
    ),
    "align, a window of NaN": misuse(
        lambda: align(lines(9, 9), window=NAN),
        "window must be in (0, 1], a fraction",
        AlignmentError,
    ),
    "align, half a reference": misuse(
        lambda: align(lines(9, 9), reference=0.5),
        "reference must be the number of a",
        AlignmentError,
    ),
    "align, complex numbers": misuse(
        lambda: align([torch.zeros(9, 1).cdouble(), torch.zeros(9, 1)]),
        "trajectory 0 must be a tensor",
        AlignmentError,
    ),
    "align, NumPy arrays": misuse(
        lambda: align([np.zeros((9, 1)), np.zeros((9, 1))]),
        "trajectory 0 must be a tensor",
        AlignmentError,
    ),
    "resample, a time step of NaN": misuse(
        lambda: resample(TIMES[:, None], TIMES, NAN),
        "time_step must be positive and",
        AlignmentError,
    ),
    "resample, a time step of a picosecond": misuse(
        lambda: resample(TIMES[:, None], TIMES, 1e-12),
        "time_step must leave at most",
        AlignmentError,
    ),
    "resample, values of NaN": misuse(
        lambda: resample(TIMES[:, None] * NAN, TIMES, 1.0),
        "values and times must be",
        AlignmentError,
    ),
    "without_jumps, times that stand still": misuse(
        lambda: without_jumps(TIMES[:, None], TIMES * 0, 1.0),
        "times must increase, got 0 s",
        AlignmentError,
    ),
    "plane_coordinates, markers of NaN": misuse(
        lambda: plane_coordinates(torch.zeros(1, 2), torch.full((4, 2), NAN), torch.zeros(4, 2)),
        "markers must be finite, got",
        AlignmentError,
    ),
    "Recordings, more labels than recordings": misuse(
        lambda: Recordings(("1", "2"), (TIMES,), (TIMES[:, None],), ("x",)),
        "labels, times and values must",
        DemonstrationError,
    ),
    "Recordings, times that go back": misuse(
        lambda: Recordings(("1",), (TIMES.flip(0),), (TIMES[:, None],), ("x",)),
        "demonstration 1, sample 1,",
        DemonstrationError,
    ),
}
EXPERIMENTS = {
    "load_experiment, an unknown name": misuse(
        lambda: load_experiment("triple"),
        "experiment must be one of acrobot, biorob, biorob_targets, ",
    ),
    "load_experiment, a list": misuse(
        lambda: load_experiment(["a"]),
        "experiment must be one of acrobot, biorob, biorob_targets, ",
    ),
    "load_experiment, a shape of another task": misuse(
        lambda: load_experiment("biorob", shape="Sine"), "shape and robot are settings of"
    ),
    "load_experiment, an unknown robot": misuse(
        lambda: load_experiment("handwriting", shape="Sine", robot="pr2"),
        "robot must be one of biorob,",
    ),
    "load_experiment, handwriting of nothing": misuse(
        lambda: load_experiment("handwriting"), "handwriting needs a shape or demonstrations, got"
    ),
    "load_experiment, demonstrations of something else": misuse(
        lambda: load_experiment("double_pendulum", shown()),
        "demonstrations must be of x1,",
        DemonstrationError,
    ),
    "load_experiment, a tensor": misuse(
        lambda: load_experiment("double_pendulum", torch.zeros(2, 5, 4)),
        "demonstrations must be",
        TypeError,
    ),
    "Task, states of other entries": misuse(
        lambda: replace(experiment(), demonstrated_states=torch.zeros(3, 2)),
        "demonstrated_states must have",
    ),
    "Task, a space of other entries": misuse(
        lambda: replace(experiment(), space=SPACE),
        "demonstrated_states must have shape (S, 2), got",
    ),
    "Task, a setting it has not": misuse(
        lambda: experiment().with_settings(search=1),
        "must be one of num_centres, ",
    ),
    "Task, widths of other features": misuse(
        lambda: experiment().with_settings(input_widths=[1.0]),
        "input_widths must have shape (6,),",
    ),
    "Task, noise in words": misuse(
        lambda: experiment().with_settings(noise_std=["a"]), "noise_std must be numbers, got ['a']"
    ),
    "Task, iterations in words": misuse(
        lambda: experiment().with_settings(**{"search.restarts": "2"}),
        "search.restarts must be an integer of at least 0, got '2'",
    ),
    "Task, an endless threshold": misuse(
        lambda: replace(experiment(), search=SearchSettings(trust_threshold=math.inf)),
        "search.trust_threshold must be a finite number that is not negative, got inf",
    ),
    "Task, larger actions than there are": misuse(
        lambda: replace(experiment(), random_action=1.5), "random_action must be at most 1, got 1.5"
    ),
    "Task, two and a half centres": misuse(
        lambda: replace(experiment(), num_centres=2.5), "num_centres must be a whole number from"
    ),
}
ROBOTS = {
    "DoublePendulumEnv, a mass of NaN": misuse(
        lambda: DoublePendulumEnv((0.5, NAN)), "link_masses must be two positive finite numbers in"
    ),
    "DoublePendulumEnv, three limits": misuse(
        lambda: DoublePendulumEnv(torque_limit=(1.0, 1.0, 1.0)), "torque_limit must be one or 2"
    ),
    "DoublePendulumEnv, a period of NaN": misuse(
        lambda: DoublePendulumEnv(control_period=NAN), "control_period must be positive and finite,"
    ),
    "DoublePendulumEnv, an infinite period": misuse(
        lambda: DoublePendulumEnv(control_period=INF), "control_period must be positive and finite,"
    ),
    "DoublePendulumEnv, one and a half robots": misuse(
        lambda: DoublePendulumEnv(num_envs=1.5), "num_envs must be None or at least 1, got 1.5"
    ),
    "DoublePendulumEnv, a negative seed": misuse(
        lambda: DoublePendulumEnv(seed=-1), "seed must be None or a whole number from 0 to"
    ),
    "DoublePendulumEnv, a seed of thirty digits": misuse(
        lambda: DoublePendulumEnv(seed=10**30), "seed must be None or a whole number from 0 to "
    ),
    "a start of NaN": misuse(
        lambda: robot().reset(TensorDict({"observation": torch.full((4,), NAN)})),
        "start observation must be",
    ),
    "a torque of NaN": misuse(
        lambda: robot().step(robot().reset().set("action", torch.full((2,), NAN).double())),
        "action must be finite, got",
    ),
    "complex torques": misuse(
        lambda: robot().step(robot().reset().set("action", torch.zeros(2).cdouble())),
        "action must hold real",
    ),
    "simulate, a state of other entries": misuse(
        lambda: robot().simulate(torch.zeros(1, 3), torch.zeros(1, 2)),
        "state must have shape (1, 4), got (1, 3)",
    ),
    "AdaptedEnv, an observation that is not there": misuse(
        lambda: AdaptedEnv(DoublePendulumEnv, 0.1, observation="state"), "the environment must have"
    ),
    "AdaptedEnv, an entry twice": misuse(
        lambda: AdaptedEnv(DoublePendulumEnv, 0.1, angles=[CosSin(0, 0)]),
        "angles must be of different",
    ),
    "AdaptedEnv of a number": misuse(
        lambda: AdaptedEnv(lambda: 3, 0.1), "make_env must make an EnvBase, got int", TypeError
    ),
    "AdaptedEnv of an environment": misuse(
        lambda: AdaptedEnv(robot(), 0.1), "make_env must make the environment, got", TypeError
    ),
    "GPWorldModel, one key": misuse(
        lambda: GPWorldModel(2, 1, in_keys=["a"]),
        "expected five or six in_keys and two out_keys, got",
    ),
    "GPWorldModel called with nothing": misuse(
        lambda: WORLD(TensorDict({})), "expected observation (*batch, 2), got the keys []", KeyError
    ),
    "BeliefPolicy, variances in place of a covariance": misuse(
        lambda: BeliefPolicy(network())(
            TensorDict({"observation": {"mean": torch.zeros(2), "var": torch.ones(2)}})
        ),
        "('observation', 'var') must",
    ),
    "BeliefPolicy, an indefinite covariance": misuse(
        lambda: BeliefPolicy(network())(
            TensorDict({"observation": {"mean": torch.zeros(2), "var": torch.tensor(INDEFINITE)}})
        ),
        "covariance of belief must be",
        NotPositiveDefiniteError,
    ),
    "BeliefPolicy at NaN": misuse(
        lambda: BeliefPolicy(network())(TensorDict({"observation": torch.full((2,), NAN)})),
        "features must be finite, got",
    ),
    "ImaginedEnv of nothing": misuse(
        lambda: ImaginedEnv(WORLD, None), "base_env must be an EnvBase, got NoneType", TypeError
    ),
    "ImaginedEnv of a name": misuse(
        lambda: ImaginedEnv(WORLD, "Pendulum-v1"), "base_env must be an EnvBase, got str", TypeError
    ),
    "ImaginedEnv, a negative batch": misuse(
        lambda: ImaginedEnv(WORLD, robot(), batch_size=(-1,)),
        "batch_size must hold positive numbers,",
    ),
}
PICTURES = {
    "plot_distributions without steps": misuse(
        lambda: distributions(demonstrated=STEPS[:0], predicted=STEPS[:0]),
        "demonstrated.mean must hold one at least, got none",
    ),
    "plot_distributions of rollouts without their start": misuse(
        lambda: distributions(executed=torch.zeros(3, 5, 2)),
        "predicted must be (5, 2), demonstrations and executed (N, 6, 2) for",
    ),
    "plot_demonstrations of none": misuse(
        lambda: plotting.plot_demonstrations(*NAMED, 0.1, torch.zeros(0, 6, 2), STEPS),
        "demonstrations must hold one",
    ),
    "plot_learning_curve of nothing": misuse(
        lambda: plotting.plot_learning_curve([], [], []), "experience_s must hold one at least, got"
    ),
    "plot_learning_curve, a rate of 150 %": misuse(
        lambda: plotting.plot_learning_curve([1.0], [1.5], [1.0]),
        "success_rate must be between 0 and",
    ),
    "plot_success_over_experience of no run": misuse(
        lambda: plotting.plot_success_over_experience(TWO, np.zeros((0, 2)), TWO, TWO),
        "rates must hold one at least,",
    ),
    "plot_success_of_methods of none": misuse(
        lambda: plotting.plot_success_of_methods({}), "curves must hold one at least, got none"
    ),
    "plot_success_of_methods without intervals": misuse(
        lambda: plotting.plot_success_of_methods({"a": (TWO, TWO)}),
        "experience, mean and interval of",
    ),
    "plot_success_over_mass of none": misuse(
        lambda: plot_success_over_mass([], {}, np.zeros((1, 0)), 3.5, 0.5),
        "masses must hold one at",
    ),
    "plot_success_over_settings of none": misuse(
        lambda: plot_success_over_settings({}, []),
        "panels must hold one at least, got none",
    ),
    "plot_success_over_settings without a usual level": misuse(
        lambda: plot_success_over_settings({"a": ([0.0], np.ones((1, 1)))}, []),
        "plain must hold 1 levels, one",
    ),
    "plot_variants of none": misuse(
        lambda: plot_variants([], np.zeros((0, 1)), np.zeros((0, 1))),
        "labels must hold one at",
    ),
    "plot_writing of nothing": misuse(
        lambda: plotting.plot_writing({}), "panels must hold one at least, got none"
    ),
    "plot_writing in space": misuse(
        lambda: plotting.plot_writing({"a": (torch.zeros(1, 5, 3), STEPS, torch.zeros(1, 5, 2))}),
        "strokes of a must be (N, 6,",
    ),
    "plot_poses of none": misuse(
        lambda: plotting.plot_poses(torch.zeros(0, 4), 0.1), "joints must have shape (N, P, 2), got"
    ),
    "pendulum_frames of nothing": misuse(
        lambda: list(plotting.pendulum_frames(torch.zeros(0, 4), 0.1)),
        "joints must have shape (N, P, 2),",
    ),
    "plot_recordings of none": misuse(
        lambda: plotting.plot_recordings([], [], [], ["x"]),
        "0 labels and 1 names must be those of 0",
    ),
    "plot_recordings, units of other entries": misuse(
        lambda: plotting.plot_recordings(["1"], [TIMES], [TIMES[:, None]], ["x"], ["m", "m"]),
        "units must be those of the 1",
    ),
    "plot_recordings of no sample": misuse(
        lambda: plotting.plot_recordings(["1"], [TIMES[:0]], [TIMES[:0, None]], ["x"]),
        "1 labels and 1 names must be",
    ),
    "plot_before_after of nothing": misuse(
        lambda: plotting.plot_before_after(["x"], ["m"], [], []),
        "there must be a trajectory before",
    ),
    "plot_errors_over_data of none": misuse(
        lambda: plot_errors_over_data([1.0], {}), "panels must hold one at least, got none"
    ),
    "plot_frequencies of none": misuse(
        lambda: plot_frequencies([1.0], {}), "scores must hold one at least, got none"
    ),
    "plot_photo_series of none": misuse(
        lambda: plotting.plot_photo_series({}, []), "rows must hold one at least, got none"
    ),
    "plot_policy without planes": misuse(
        lambda: plotting.plot_policy(STATE_POLICY, [], torch.zeros(1, 2).double(), ["a"]),
        "planes must hold one at",
    ),
    "write_video without frames": misuse(
        lambda: write_video("v.mp4", [], 50), "a video needs at least one frame, got none"
    ),
    "write_video of floats": misuse(
        lambda: write_video("v.mp4", [FRAME * 1.0], 50),
        "frame 0 must be uint8 of shape (16, 16, 3),",
    ),
    "write_video at 0 Hz": misuse(
        lambda: write_video("v.mp4", [FRAME], 0), "fps must be a positive finite number, got 0"
    ),
    "write_video at NaN Hz": misuse(
        lambda: write_video("v.mp4", [FRAME], NAN), "fps must be a positive finite number, got nan"
    ),
    "write_video of nothing to see": misuse(
        lambda: write_video("v.mp4", [np.zeros((0, 0, 3), dtype=np.uint8)], 5),
        "frames must have shape",
    ),
}

ROOMS = (GP, CONTROL, MODEL, SEARCH, TRAINER, DEMONSTRATIONS, EXPERIMENTS, ROBOTS, PICTURES)
MISUSES = {name: row for room in ROOMS for name, row in room.items()}


@pytest.mark.parametrize("name", MISUSES)
def test_misuse_is_one_line_that_says_what_was_expected_and_what_came(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    call, said, error = MISUSES[name]
    with pytest.raises(error) as caught:
        call()
    (message,) = caught.value.args[:1]
    assert type(caught.value) is error
    assert said in message and re.search(r"\bgot\b", message)
    assert "\n" not in message and len(message) < LONGEST


def test_table_has_at_least_160_rows_of_different_names() -> None:
    assert len(MISUSES) == sum(map(len, ROOMS)) >= 160
