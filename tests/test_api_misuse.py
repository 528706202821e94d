"""What callers may get wrong: every public name says so in one line, and returns no number."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from tensordict import TensorDict
from torch import Tensor, ones, zeros

from reproduction.baselines.dmp import DMP
from reproduction.baselines.learned_inverse_dynamics import InverseDynamics, Reference
from reproduction.plots.frequencies import plot_frequencies
from reproduction.plots.photos import plot_photo_series
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
    Ending,
    ExpectedSaturatingCost,
    Experience,
    Gaussian,
    GPDynamics,
    KernelExpansion,
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
from torch_pmil.checks import check_positive
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exploration import PDMovements, RandomActions
from torch_pmil.control.trigonometric_polynomial import cosine, match_of
from torch_pmil.demonstrations import Recordings
from torch_pmil.demonstrations.distribution import demonstration_spread, rms_error
from torch_pmil.demonstrations.preparation.alignment import resample
from torch_pmil.demonstrations.preparation.camera import plane_coordinates
from torch_pmil.demonstrations.preparation.jumps import without_jumps
from torch_pmil.envs import AdaptedEnv, CosSin, DoublePendulumEnv
from torch_pmil.model.calibration import observed_coverage, two_sigma_coverage
from torch_pmil.plotting.video import write_video
from torch_pmil.runs.training import train
from torch_pmil.torchrl_interop import BeliefPolicy, GPWorldModel, ImaginedEnv

Misuse = tuple[Callable[[], object], str, type[Exception]]

LONGEST = 500  # characters of a message
NAN, INF = math.nan, math.inf


def numbers(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def full(value: float, *shape: int) -> Tensor:
    return torch.full(shape, value, dtype=torch.float64)


def eye(size: int) -> Tensor:
    return torch.eye(size, dtype=torch.float64)


def sure(*mean: float) -> Gaussian:
    """A belief of that mean and unit variances."""
    return Gaussian(numbers(*mean), eye(len(mean)))


def covered(cov: list[list[float]]) -> Gaussian:
    """A belief of that covariance."""
    return Gaussian(full(0, len(cov)), torch.tensor(cov).double())


UPPER_NAN = [[1.0, NAN], [0.0, 1.0]]
ASYMMETRIC = [[1.0, 0.5], [0.0, 1.0]]
INDEFINITE = [[1.0, 2.0], [2.0, 1.0]]
SINGLE = Gaussian(zeros(2), torch.eye(2))
INTEGERS = Gaussian(zeros(2).long(), eye(2).long())
START = Gaussian(full(0, 2), 0.01 * eye(2))
FIVE, THREE = (Gaussian(full(0, T, 2), eye(2).expand(T, 2, 2)) for T in (5, 3))
NAN_FIVE = Gaussian(FIVE.mean * NAN, FIVE.cov)
STEPS = Gaussian(zeros(5, 2), torch.eye(2).expand(5, 2, 2))
NAMED = ("q", "dq"), ("rad", "rad/s")
DRAWS = Draws(0)
ONE = full(1, 1)
ACTION_SPACE = ActionSpace(("u",), ("N·m",), -ONE, ONE)
GP_MODEL = DRAWS.gp(6, 2, 2)
POLICY, DYNAMICS = make_parts(DRAWS)
OTHER_DYNAMICS = GPDynamics(4, 3)
OTHER_DYNAMICS.set_data(DRAWS.normal(4, 4), DRAWS.normal(4, 3))
STATE_POLICY = StatePolicy(POLICY, SPACE, 0.1)
LINE = StateSpace(("q",), ("rad",), (), joint_match(("q",), ("rad",)))
WORLD = GPWorldModel(2, 1)
TIMES = torch.arange(5.0)
WALK = TIMES[:, None]
TWO = np.zeros(2)
POSITIONS = zeros(2, 5, 1)
WEIGHTS, PATHS = full(0, 5, 3), zeros(1, 8, 2)
PLAN = SearchSettings(1, 1, 1)
FRAMES = [np.zeros((16, 16, 3), dtype=np.uint8)]
PHASES = torch.linspace(0, 6, 121, dtype=torch.float64)
STATES, ACTIONS = PHASES.sin()[:, None], PHASES.cos()[:-1, None]


@cache
def experiment() -> Task:
    return short_experiment(4)


@cache
def robot() -> DoublePendulumEnv:
    return DoublePendulumEnv(seed=0)


def moments(
    belief: Gaussian = START, model: object = GP_MODEL, observation_noise: bool = False
) -> Moments:
    return moment_match(model, belief, observation_noise)


def expansion(**changes: Tensor) -> KernelExpansion:
    network = {"weights": full(1, 1, 3), "inputs": full(0, 3, 2), "lengthscales": full(1, 1, 2)}
    return KernelExpansion(**(network | {"signal_variance": ONE} | changes))


def expanded(**changes: Tensor) -> Moments:
    return moments(model=expansion(**changes))


def from_data(**changes: object) -> KernelExpansion:
    data = {"inputs": full(0, 5, 2), "targets": full(0, 1, 5), "noise_variance": 0.1 * ONE}
    kernel = {"lengthscales": full(1, 1, 2), "signal_variance": ONE}
    return KernelExpansion.from_data(**(data | kernel | changes))


def network(**changes: object) -> RBFPolicy:
    return RBFPolicy(**({"centres": zeros(3, 2), "u_max": ones(1), "scale": ones(2)} | changes))


def fitted_network(**changes: object) -> None:
    network().fit_weights(**({"features": zeros(3, 2), "actions": zeros(3, 1)} | changes))


def state_policy(control_period: object = 0.1, **options: object) -> StatePolicy:
    return StatePolicy(POLICY, SPACE, control_period, **options)


def match_space(**changes: object) -> MatchSpace:
    plane = {"names": ("x",), "units": ("m",), "angles": zeros(0, 2), "weights": torch.eye(2)[:1]}
    return MatchSpace(**(plane | changes))


def space_of(**changes: object) -> StateSpace:
    pendulum = {"names": NAMED[0], "units": NAMED[1], "angles": (0,), "match": joint_match(*NAMED)}
    return StateSpace(*(pendulum | changes).values())


def action_space(**changes: object) -> ActionSpace:
    return replace(ACTION_SPACE, **changes)


def random_actions(**changes: object) -> RandomActions:
    return RandomActions(**({"actions": ACTION_SPACE, "fraction": 0.5, "steps": 5} | changes))


def movements(**changes: object) -> PDMovements:
    body = {"pose": zeros(2), "reach": torch.tensor([0.4, 0.0]), "u_max": ones(1)}
    plan = {"gain": torch.tensor([[5.0, 1.0]]), "hold": 5, "rollouts": 3, "steps": 20}
    return PDMovements(**(body | plan | {"feedforward": lambda state: state} | changes))


def fitted(data: tuple[Any, Any]) -> object:
    return GPDynamics(2, 1).fit(*data)


def transitions(count: int = 4, **changes: object) -> TensorDict:
    states, actions = zeros(count, 2), zeros(count, 1)
    whole = {"observation": states, "action": actions, "next": {"observation": states}}
    return TensorDict(whole | changes, [count])


def training_data(filled: bool = True, targets: str = "difference") -> object:
    experience = Experience(9)
    if filled:
        experience.extend(transitions())
    return experience.training_data(SPACE, targets)


def predicted(
    initial: Gaussian = START, dynamics: GPDynamics = DYNAMICS, horizon: int = 3
) -> Gaussian:
    return predict_trajectory(initial, POLICY, dynamics, SPACE, horizon)


def sampled(initial: Gaussian = START, horizon: int = 3, count: int = 10) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return sample_trajectories(initial, POLICY, DYNAMICS, SPACE, horizon, count, generator)


def scores(**changes: object) -> object:
    recordings = [Recording(STATES, ACTIONS)]
    study = {"recordings": recordings, "time_step": 0.05, "frequencies": [4.0], "space": LINE}
    return score_frequencies(**(study | changes))


def primitive(weights: Tensor = WEIGHTS, goal: Tensor = WEIGHTS[0], duration: float = 1.0) -> DMP:
    return DMP(full(0, 3), full(0, 3), goal, weights, duration)


def imitated(positions: Tensor = PATHS, num_basis: int = 5) -> DMP:
    return DMP.from_demonstrations(positions, 0.1, num_basis)


def divergence(p: object = START, q: object = START) -> Tensor:
    return gaussian_kl(p, q)


def aimed(predicted: Gaussian) -> Tensor:
    return trajectory_kl(FIVE, predicted)


def kl_loss(demonstrated: Gaussian = FIVE, noise_std: object = 0.1) -> TrajectoryKLLoss:
    return TrajectoryKLLoss(POLICY, DYNAMICS, SPACE, demonstrated, noise_std)


def cost(**changes: object) -> ExpectedSaturatingCost:
    return make_cost(0, **changes)


def multi_target(targets: Tensor) -> MultiTargetKLLoss:
    policy = RBFPolicy(zeros(5, 4), ONE, ones(4))
    shown = Gaussian(full(0, 3, 5, 2), eye(2).expand(3, 5, 2, 2))
    return MultiTargetKLLoss(policy, DYNAMICS, SPACE, shown, targets, 0.1)


def searched(initial: Gaussian = START, settings: object = PLAN) -> object:
    return search_policy(make_kl(0), initial, settings)


def trainer(
    search: object = None,
    seed: object = 0,
    trials: object = 1,
    confirmations: object = 1,
    **of_problem: object,
) -> PMILTrainer:
    """The trainer of a short run, with other arguments."""
    task = experiment()
    problem = replace(task.problem(0), **of_problem)
    search = task.method.search if search is None else search
    return PMILTrainer(problem, Ending(trials, confirmations), search, seed, progress_bar=False)


def trained(task: object = None, seed: int = 0, trials: int = 1, **options: object) -> object:
    return train(task or experiment(), seed, trials, "r", "x", **options)


def shown(positions: object = POSITIONS, **changes: object) -> Demonstrations:
    return Demonstrations(positions, **({"time_step": 0.1, "names": ("x",)} | changes))


def expert(noise_std: object = 0.1, demonstrations: object = None) -> Gaussian:
    return expert_distribution(shown() if demonstrations is None else demonstrations, noise_std)


def loaded(time_step: float) -> Demonstrations:
    shown().save("shown.npz")
    return load_demonstrations("shown.npz", time_step)


def lines(*lengths: int) -> list[Tensor]:
    return [torch.linspace(0, 1, length).double()[:, None] for length in lengths]


def resampled(values: Tensor = WALK, time_step: float = 1.0) -> Tensor:
    return resample(values, TIMES, time_step)


def recordings(
    labels: object = ("1",), times: object = (TIMES,), values: object = (WALK,)
) -> Recordings:
    return Recordings(labels, times, values, ("x",))


def changed(**changes: object) -> Task:
    return replace(experiment(), **changes)


def with_settings(**settings: object) -> Task:
    return experiment().with_settings(**settings)


def acted(action: Tensor) -> TensorDict:
    return robot().step(robot().reset().set("action", action))


def adapted(make_env: object = DoublePendulumEnv, **options: object) -> AdaptedEnv:
    return AdaptedEnv(make_env, 0.1, **options)


def believed(observation: object) -> TensorDict:
    return BeliefPolicy(network())(TensorDict({"observation": observation}))


def imagined(base_env: object, **options: object) -> ImaginedEnv:
    return ImaginedEnv(WORLD, base_env, **options)


def distributions(**changes: object) -> plotting.Figure:
    beliefs = {"demonstrated": STEPS, "predicted": STEPS}
    paths = {"demonstrations": zeros(2, 6, 2), "executed": zeros(3, 6, 2)}
    labels = {"names": NAMED[0], "units": NAMED[1], "time_step": 0.1}
    return plotting.plot_distributions(**(beliefs | paths | labels | changes))


def video(frames: list[np.ndarray] = FRAMES, fps: float = 50) -> None:
    write_video("v.mp4", frames, fps)


def wrong(
    call: Callable[..., object],
    said: str,
    *values: object,
    error: type[Exception] = ValueError,
    **named: list[Any],
) -> list[Misuse]:
    """A call with one wrong argument at a time, what the message holds beside what came, and its
    type. Without arguments the call itself is wrong.
    """
    calls = [partial(call, value) for value in values]
    calls += [partial(call, **{name: value}) for name, ones in named.items() for value in ones]
    return [(one, said, error) for one in calls or [call]]


not_positive = partial(wrong, error=NotPositiveDefiniteError)
of_wrong_type = partial(wrong, error=TypeError)
ill_shown = partial(wrong, error=DemonstrationError)
not_aligned = partial(wrong, error=AlignmentError)


MISUSES: list[Misuse] = [
    # gp
    *of_wrong_type(
        lambda: Gaussian([0.0], [[1.0]]), "mean and cov must be tensors, got list and list"
    ),
    *of_wrong_type(lambda: Gaussian(TWO, np.eye(2)), "mean and cov must be tensors, got"),
    *wrong(lambda: Gaussian(zeros(3), ones(3)), "cov must have shape (*batch, D, D) = (3, 3)"),
    *wrong(lambda: Gaussian(zeros(3, 2), eye(2)), "cov must have shape (*batch, D, D) = (3,"),
    *wrong(sure(0.0).sample, "count must be a whole number of at least 0, got -1", -1),
    *wrong(
        sure(0.0, 0).add_noise, "variance must be finite, not negative, and one number", -1.0, NAN
    ),
    *wrong(sure(0.0, 0).add_noise, "variance must be finite, not negative, and", ones(3)),
    *wrong(moments, "mean of belief must be finite, got nan in", sure(NAN, 0.0)),
    *not_positive(moments, "covariance of belief must be", *map(covered, (UPPER_NAN, INDEFINITE))),
    *wrong(moments, "belief must have mean and", SINGLE, INTEGERS),
    *wrong(moments, "belief must have the model's 2 inputs, got 1", sure(0.0)),
    *of_wrong_type(moments, "belief must be a Gaussian, got", zeros(2)),
    *of_wrong_type(moments, "model must be an ExactGP or a", model=[None]),
    *wrong(
        lambda: moments(model=DRAWS.network(3, 2, 1), observation_noise=True),
        "observation_noise must be",
    ),
    *wrong(expanded, "signal_variance must be positive, got -1", signal_variance=[-ONE]),
    *wrong(expanded, "weights must be finite, got", weights=[full(NAN, 1, 3)]),
    *wrong(expanded, "inputs must be finite, got", inputs=[full(NAN, 3, 2)]),
    *wrong(
        lambda: expanded(inputs=full(0, 0, 2), weights=full(0, 1, 0)),
        "inputs, weights, lengthscales",
    ),
    *wrong(
        expansion,
        "inputs, weights, lengthscales and signal_variance",
        weights=[full(1, 1, 4)],
        lengthscales=[full(1, 2)],
        signal_variance=[ones(2)],
        inputs=[zeros(3)],
        gram_inverse=[eye(3)],
    ),
    *wrong(expansion().mean, "points must have the 2 inputs of the", full(0, 3)),
    *wrong(expansion().predict, "points must have the 2 inputs of the", full(0, 3)),
    *wrong(from_data, "lengthscales must be positive, got 0", lengthscales=[full(0, 1, 2)]),
    *wrong(from_data, "lengthscales must be positive, got -1", lengthscales=[full(-1, 1, 2)]),
    *wrong(from_data, "signal_variance must be positive, got -1", signal_variance=[-ONE]),
    *wrong(from_data, "noise_variance must not be negative, got -1", noise_variance=[-ONE]),
    *wrong(
        lambda: from_data(inputs=full(0, 0, 2), targets=full(0, 1, 0)),
        "targets must have shape (E, n), got (1, 0)",
    ),
    *wrong(from_data, "targets must be finite, got nan", targets=[full(NAN, 1, 5)]),
    *wrong(
        from_data, "targets must be a float like inputs (torch.float64),", targets=[zeros(1, 5)]
    ),
    *wrong(from_data, "inputs must have shape (1, D), got (5, 2)", targets=[full(0, 5, 1)]),
    *wrong(from_data, "offset must be finite, and a number or (1,),", offset=[full(0, 3)]),
    *of_wrong_type(from_data, "inputs must be a tensor, got list", inputs=[[[0.0]]]),
    # control
    *wrong(network, "centres must be finite, got nan in entry", centres=[full(NAN, 3, 2)]),
    *wrong(network, "centres must have shape (m, inputs), got (0, 2)", centres=[zeros(0, 2)]),
    *wrong(network, "centres must hold real numbers, got", centres=[zeros(3, 2).cdouble()]),
    *wrong(network, "centres must hold real numbers, got torch.bool", centres=[zeros(3, 2).bool()]),
    *of_wrong_type(network, "centres must be a tensor, got list", centres=[[[0.0, 0.0]]]),
    *wrong(network, "u_max must be positive, got -1", u_max=[-ones(1)]),
    *wrong(network, "u_max must be finite, got nan in entry (0,)", u_max=[full(NAN, 1)]),
    *of_wrong_type(network, "u_max must be a tensor, got float", u_max=[3.5]),
    *wrong(network, "scale must be finite, got nan in entry (1,)", scale=[numbers(1, NAN)]),
    *wrong(network(), "features must have shape (*batch, 2), got (3,)", zeros(3)),
    *wrong(network(), "features must be finite, got nan in entry (0,)", full(NAN, 2)),
    *wrong(fitted_network, "actions must have shape (3,", actions=[zeros(4, 1), zeros(3, 2)]),
    *wrong(fitted_network, "actions must be finite, got", actions=[full(NAN, 3, 1)]),
    *wrong(fitted_network, "ridge must be a positive", ridge=[-1.0]),
    *wrong(
        lambda: fitted_network(features=zeros(0, 2), actions=zeros(0, 1)),
        "features must have shape (S,",
    ),
    *wrong(network().for_target, "target must be finite, got nan in entry (0,)", full(NAN, 1)),
    *wrong(STATE_POLICY, "state must have shape (*batch, 2) for q, dq, got (3,)", np.zeros(3)),
    *wrong(STATE_POLICY, "state must be finite, got dq = nan", numbers(0, NAN)),
    *of_wrong_type(STATE_POLICY, "state must be a NumPy array, a PyTorch tensor or", {0.0}),
    *of_wrong_type(STATE_POLICY, "state must hold real numbers, got <U1", np.array(["a", "b"])),
    *of_wrong_type(lambda: STATE_POLICY(TWO, np.zeros(1)), "policy must be called with a"),
    *wrong(state_policy, "control_period (s) must be a positive finite", 0, NAN, "0.1"),
    *wrong(
        load_policy, "must be a file of save_policy: must be a regular", ".", error=PolicyFileError
    ),
    *wrong(
        STATE_POLICY.export, "an exported policy must be a .pt2 or .onnx file, got p.txt", "p.txt"
    ),
    *wrong(match_space, "names must be different, got", names=[("x", "x")]),
    *wrong(match_space, "weights must have shape (1,", weights=[ones(1, 1)]),
    *wrong(lambda: MatchSpace((), (), zeros(0, 1), zeros(0, 1)), "names must be those of one"),
    *wrong(match_space, "weights must hold real", weights=[torch.eye(1).cdouble()]),
    *wrong(joint_match(*NAMED), "states must have shape (*batch, 2), got (3,)", zeros(3)),
    *wrong(
        lambda: joint_match(("q",), ("a", "b")),
        "weights must have shape (1, 1) and units 1 entries,",
    ),
    *wrong(space_of, "names must be different, got", names=[("q", "q")]),
    *wrong(space_of, "angles must be indices below 2, got (2,)", angles=[(2,)]),
    *wrong(space_of, "angles must be different indices, got (0, 0)", angles=[(0, 0)]),
    *wrong(space_of, "angles must be indices below 2, got (0.0,)", angles=[(0.0,)]),
    *wrong(space_of, "angles must be indices below 2, got 0", angles=[0]),
    *wrong(
        space_of, "units and the match space must be for", match=[joint_match(("q",), ("rad",))]
    ),
    *wrong(SPACE.features, "states must have shape (*batch, 2), got (3,)", zeros(3)),
    *wrong(SPACE.observe, "states must have shape (*batch, 2), got (3,)", zeros(3)),
    *wrong(
        lambda: match_of([cosine((1,))], ("x",), ("m",), 2, (5,)),
        "angles must be entries below 2, as",
    ),
    *wrong(
        lambda: match_of([cosine((1, 1))], ("x",), ("m",), 2, (0,)),
        "angles must be entries below 2, as",
    ),
    *wrong(random_actions, "fraction must be above 0 and at most 1, got", fraction=[NAN, -0.5]),
    *wrong(random_actions, "steps must be a whole number of at least 1,", steps=[0]),
    *wrong(random_actions, "rollouts must be a whole number of at", rollouts=[0]),
    *wrong(random_actions, "around must have shape (1,), got (2,)", around=[zeros(2)]),
    *wrong(action_space, "low must be below high, got [1.0] and [1.0]", low=[ONE]),
    *wrong(
        action_space,
        "high must be finite, got inf in entry (0,)",
        high=[INF * ONE],
    ),
    *wrong(
        action_space,
        "actions must have a name and a unit each, got ('u',)",
        units=[()],
    ),
    *wrong(
        state_policy,
        "actions must be those of the policy, 0 from ",
        actions=[action_space(low=-9 * ONE)],
    ),
    *wrong(movements, "rollouts must be a whole number of at least 1, got 0", rollouts=[0]),
    *wrong(movements, "exploration.gain must have shape (1, 2), got (2, 2)", gain=[ones(2, 2)]),
    *wrong(
        movements,
        "exploration.gain must be a row of numbers for each torque",
        gain=[full(NAN, 1, 2)],
    ),
    *wrong(
        movements, "exploration.pose must be numbers, one for each entry", pose=[numbers(NAN, 0)]
    ),
    # model
    *wrong(lambda: GPDynamics(0, 1), "num_inputs must be a whole number of at least 1, got 0"),
    *wrong(
        partial(GPDynamics, 1, 1),
        'targets must be "difference" or "successor", got \'delta\'',
        "delta",
    ),
    *wrong(
        fitted,
        "expected inputs (n, 2) and targets (n,",
        (zeros(5, 2), zeros(4, 1)),
        (zeros(1, 2), zeros(1, 1)),
        (zeros(0, 2), zeros(0, 1)),
        (torch.tensor(0.0), torch.tensor(0.0)),
    ),
    *wrong(fitted, "inputs must be finite, got nan in", (full(NAN, 5, 2), zeros(5, 1))),
    *wrong(fitted, "inputs must hold real numbers,", (zeros(5, 2).bool(), zeros(5, 1))),
    *of_wrong_type(fitted, "inputs must be a tensor, got", (np.zeros((5, 2)), np.zeros((5, 1)))),
    *wrong(Experience, "capacity must be a whole number of at least 1, got 0", 0),
    *wrong(Experience, "capacity must be a whole number of at least 1, got 2.5", 2.5),
    *wrong(Experience, "capacity must be a whole number of at least 1, got nan", NAN),
    *wrong(Experience(2).extend, "experience holds at most 2 transitions, got 4", transitions()),
    *wrong(
        Experience(9).extend,
        "must be finite, got nan in entry",
        transitions(observation=full(NAN, 4, 2)),
    ),
    *wrong(
        Experience(9).extend,
        "transitions must have",
        transitions().exclude("action"),
        error=KeyError,
    ),
    *wrong(
        Experience(9).extend,
        "transitions must have",
        transitions(next={"observation": zeros(4, 3)}),
    ),
    *wrong(training_data, "experience must hold a", filled=[False]),
    *wrong(training_data, 'targets must be "difference"', targets=["delta"]),
    *wrong(predicted, "horizon must be a whole number of at least 1, got 0", horizon=[0]),
    *wrong(predicted, "horizon must be a whole number of at least 1, got 2.5", horizon=[2.5]),
    *wrong(predicted, "initial must be over the 2 entries of the state, like the ", sure(0.0)),
    *wrong(predicted, "mean of initial must be finite, got nan in entry (1,)", sure(0.0, NAN)),
    *wrong(predicted, "initial must have mean and", SINGLE),
    *wrong(predicted, "prediction of step 1 of 3", covered(INDEFINITE), error=PredictionError),
    *wrong(
        predicted,
        "initial must be over the 2 entries of the state, like",
        dynamics=[OTHER_DYNAMICS],
    ),
    *wrong(
        lambda: predict_step(sure(0.0), POLICY.controller, DYNAMICS, SPACE),
        "state must be over the 2",
    ),
    *wrong(sampled, "horizon must be a whole number of at least 1, got 0", horizon=[0]),
    *wrong(sampled, "count must be a whole number of at least 1, got 0", count=[0]),
    *wrong(sampled, "mean of initial must be finite, got nan in entry (1,)", sure(0.0, NAN)),
    *wrong(sampled, "initial must be over the 2 entries of the state, like the ", sure(0.0)),
    *not_positive(sampled, "covariance of initial must be", covered(INDEFINITE)),
    *wrong(sampled, "initial must have mean and", SINGLE),
    *wrong(ParticlePrediction, "count must be a whole number of at least 2, got 1", 1),
    *wrong(ParticlePrediction, "count must be a whole number of at least 2, got nan", NAN),
    *wrong(
        partial(ParticlePrediction, 10), "seed must be a whole number from 0 to", -1, seed=[10**30]
    ),
    *wrong(scores, "recordings must hold one at least, got none", recordings=[[]]),
    *wrong(scores, "frequencies must be positive and finite, in Hz, got 0.0", frequencies=[[0.0]]),
    *wrong(scores, "frequencies must be positive and finite, in Hz, got nan", frequencies=[[NAN]]),
    *wrong(scores, "frequencies must hold one at least, got none", frequencies=[[]]),
    *wrong(scores, "time_step must be positive and finite, in s, got 0.0", time_step=[0.0]),
    *wrong(scores, "folds must be a whole number of at least 2, got 1", folds=[1]),
    *wrong(
        scores, "max_iterations must be a whole number of at least 1, got 0", max_iterations=[0]
    ),
    *wrong(
        scores, "states of recording 0 must be", recordings=[[Recording(STATES * NAN, ACTIONS)]]
    ),
    *wrong(
        scores, "4 Hz must leave at least 10", recordings=[[Recording(STATES[:5], ACTIONS[:4])]]
    ),
    *of_wrong_type(scores, "recording 0 must be a", recordings=[[(STATES, ACTIONS)]]),
    *wrong(
        scores,
        "recording 0 must have states (T + 1, 1) and actions (T, 1), got (9, 1) and (9, 1)",
        recordings=[[Recording(STATES[:9], ACTIONS[:9])]],
    ),
    *wrong(
        scores,
        "recording 1 must have states (T + 1, 1) and actions (T, 1), got (9, 1) and (8, 2)",
        recordings=[[Recording(STATES, ACTIONS), Recording(STATES[:9], zeros(8, 2))]],
    ),
    *wrong(
        scores,
        "the interval of 8 Hz must be a whole number of time steps of 0.05 s, got 2.5",
        frequencies=[[4.0, 8.0]],
    ),
    *wrong(
        scores,
        "every entry of the state must change, got none at 4 Hz in q",
        recordings=[[Recording(ones(121, 1), ACTIONS)]],
    ),
    *wrong(
        lambda: observed_coverage(zeros(3, 1), torch.tensor([2.0])), "probabilities must be from 0"
    ),
    *wrong(
        lambda: two_sigma_coverage(STEPS, zeros(3, 5, 2)), "executed must have shape (N, 6, 2),"
    ),
    # movement primitives and inverse dynamics
    *wrong(primitive, "weights must be of at least two basis functions, got 1", full(0, 1, 3)),
    *wrong(
        primitive,
        "start, start_rate and goal must be (D,) and weights (K, D)",
        weights=[zeros(5, 2)],
        goal=[zeros(2)],
    ),
    *wrong(primitive, "duration must be positive and finite, in seconds, got 0.0", duration=[0.0]),
    *wrong(
        imitated,
        "positions must be finite, (N, T + 1, D) with at least four samples, got (1, 3, 2)",
        zeros(1, 3, 2),
    ),
    *wrong(
        imitated,
        "positions must be finite, (N, T + 1, D) with at least four samples, got (8, 2)",
        zeros(8, 2),
    ),
    *wrong(imitated, "positions must be finite", full(NAN, 1, 8, 2)),
    *wrong(imitated, "num_basis must be at least 2, got 1", num_basis=[1]),
    *wrong(
        primitive(),
        "times must be a vector of finite seconds from 0 on",
        *(torch.tensor([-0.1]), torch.tensor([INF]), zeros(0), torch.tensor(1.0)),
    ),
    *wrong(
        InverseDynamics, "a state must hold a position and a velocity of each joint, got ", LINE
    ),
    *wrong(
        partial(Reference, zeros(9, 4)),
        "states must be (T * hold + 1, D) and accelerations (T + 1, D / 2), got (9, 4)",
        *(zeros(4, 2), zeros(3, 1), zeros(1, 2)),
    ),
    # search
    *wrong(divergence, "p and q must have the same entries, and", sure(0.0)),
    *wrong(
        lambda: gaussian_kl(FIVE, THREE), "p and q must have the same entries, and batches that "
    ),
    *wrong(divergence, "mean of p must be finite, got nan in", sure(NAN, 0.0)),
    *wrong(divergence, "mean of q must be finite, got inf in", q=[sure(INF, 0.0)]),
    *not_positive(
        divergence,
        "covariance of q must be",
        q=[covered(UPPER_NAN), covered([[1.0, 0], [0, 0]])],
    ),
    *not_positive(divergence, "covariance of p must be", *map(covered, (ASYMMETRIC, INDEFINITE))),
    *wrong(divergence, "q must have mean and", SINGLE),
    *wrong(lambda: gaussian_kl(INTEGERS, INTEGERS), "p must have mean and"),
    *of_wrong_type(divergence, "p must be a Gaussian, got", zeros(2)),
    *wrong(
        lambda: trajectory_kl(FIVE, THREE), "p and q must have the same entries, and batches that "
    ),
    *wrong(aimed, "demonstrated and predicted must be over the same", FIVE[:1]),
    *wrong(
        lambda: trajectory_kl(sure(0.0), sure(0.0)), "demonstrated and predicted must be over the"
    ),
    *wrong(aimed, "mean of q must be finite, got", NAN_FIVE),
    *wrong(expected_saturating_cost, "mean of residual must be finite, got nan in", sure(NAN)),
    *not_positive(
        expected_saturating_cost,
        "covariance of residual must",
        *map(covered, (UPPER_NAN, ASYMMETRIC, [[-0.5]], [[INF]])),
    ),
    *wrong(
        expected_saturating_cost,
        "residual must have mean and",
        INTEGERS,
        Gaussian(zeros(2), eye(2)),
    ),
    *of_wrong_type(expected_saturating_cost, "residual must be a Gaussian,", zeros(2)),
    *wrong(
        SearchSettings,
        "search.trust_threshold must be a finite number, at least 0, got -1.0",
        trust_threshold=[-1.0],
    ),
    *wrong(
        SearchSettings,
        "search.trust_threshold must be a finite number, at least 0, got '3'",
        trust_threshold=["3"],
    ),
    *wrong(
        SearchSettings, "search.mean_iterations must be a whole number of at least 0, got '5'", "5"
    ),
    *wrong(
        SearchSettings,
        "search.mean_iterations must be a whole number of at least 0",
        mean_iterations=[None],
    ),
    *wrong(
        partial(make_kl, 0),
        'reduction must be "none", "mean" or "sum", got \'max\'',
        reduction=["max"],
    ),
    *wrong(kl_loss, "noise_std must not be negative, got -0.1", noise_std=[-0.1]),
    *wrong(kl_loss, "noise_std must not be negative, got nan", noise_std=[NAN]),
    *wrong(kl_loss, "noise_std must be a number or one for each of x, y, got inf", noise_std=[INF]),
    *wrong(
        kl_loss, "noise_std must be a number or one for each of x, y, got '0.1'", noise_std=["0.1"]
    ),
    *wrong(kl_loss, "demonstrated must be marginals at one step at least,", sure(0.0, 0.0)),
    *wrong(kl_loss, "demonstrated must be marginals at one step at least, mean", FIVE[:0]),
    *wrong(kl_loss, "mean of demonstrated must be finite,", NAN_FIVE),
    *not_positive(kl_loss, "covariance of demonstrated", Gaussian(FIVE.mean, -FIVE.cov)),
    *wrong(make_kl(0), "TrajectoryKLLoss reads ('observation',", TensorDict({}), error=KeyError),
    *wrong(make_kl(0), "('observation', 'mean') must hold the 2 entries ('q',", start(sure(0.0))),
    *wrong(
        partial(make_kl(0).per_step, START),
        "horizon must be a whole number from 1 to 4, got 99",
        99,
    ),
    *wrong(
        cost,
        "target must be finite, got nan in entry (0,)",
        target=[numbers(NAN, 0)],
    ),
    *wrong(cost, "width must be a positive finite number, got 0.0", width=[0.0]),
    *wrong(cost, "width must be a positive finite number, got inf", width=[INF]),
    *wrong(
        cost,
        "horizon must be a whole number of at least 1, got 2.5",
        horizon=[2.5],
    ),
    *wrong(
        cost,
        "weight must be symmetric and positive",
        weight=[torch.tensor(INDEFINITE)],
    ),
    *wrong(cost, "weight must be finite, got nan in entry", weight=[full(NAN, 2, 2)]),
    *wrong(multi_target, "targets must have shape (S, K) and the demonstrated ", zeros(3)),
    *wrong(multi_target, "targets must be finite, got nan in entry (0, 0)", full(NAN, 3, 1)),
    *wrong(searched, "mean of initial must be", sure(0.0, NAN)),
    *wrong(searched, "initial must be one belief,", THREE),
    *of_wrong_type(searched, "settings must be", settings=[{"mean_iterations": 1}]),
    # trainer
    *wrong(trainer, "trials must be a whole number of at least 1, got 0", trials=[0]),
    *wrong(trainer, "trials must be a whole number of at least 1, got 1.5", trials=[1.5]),
    *wrong(trainer, "confirmations must be a whole number of at least 1, got 0", confirmations=[0]),
    *wrong(
        trainer,
        "tolerance must be a finite number that is not negative, got",
        tolerance=[NAN, -1.0],
    ),
    *wrong(trainer, "initial must be over the 4 entries of the state, like", initial=[sure(0.0)]),
    *wrong(
        trainer, "mean of initial must be finite, got nan in entry", initial=[sure(NAN, 0, 0, 0)]
    ),
    *of_wrong_type(trainer, "env must be an EnvBase, got NoneType", env=[None]),
    *of_wrong_type(trainer, "env must be an EnvBase, got str", env=["Pendulum-v1"]),
    *of_wrong_type(trainer, "measured must be an EnvBase, got int", measured=[20]),
    *of_wrong_type(trainer, "expected SearchSettings, got dict", search=[{}]),
    *wrong(trainer, "seed must be a whole number from 0 to 2147483647, got -1", seed=[-1]),
    *wrong(
        lambda: trainer().resume(),
        "resume must be given a checkpoint or a checkpoint_rotation, got",
    ),
    *wrong(
        lambda: trainer().best_policy(),
        "a policy must have run to be the best, got",
        error=RuntimeError,
    ),
    *wrong(trained, "seed must be a whole number from 0 to 2147483647,", seed=[-1]),
    *wrong(trained, "trials must be a whole number from 1 to 1000, got 0", trials=[0]),
    *wrong(trained, "logger must be one of csv,", logger=["log"]),
    *of_wrong_type(trained, "task must be a Task,", "double_pendulum"),
    # demonstrations
    *ill_shown(shown, "positions must hold at least two", zeros(1, 5, 1), zeros(2, 1, 1)),
    *ill_shown(
        shown, "time_step must be positive and finite, in", time_step=[0.0, NAN, "fast", None]
    ),
    *ill_shown(
        partial(shown, zeros(2, 5, 2)),
        "names must be different, one per column",
        names=[("x", "x")],
    ),
    *ill_shown(shown, "positions must be finite, got", full(NAN, 2, 5, 1)),
    *ill_shown(shown, "positions must be an array of numbers, got new():", "abc"),
    *ill_shown(shown, "positions must hold real", zeros(2, 5, 1).cdouble()),
    *ill_shown(
        lambda: shown(targets=torch.tensor([[0.0], [1.0]]), target_names=("y",)),
        "each target must have at",
    ),
    *wrong(expert, "noise_std must be positive, got 0.0", 0.0),
    *wrong(expert, "noise_std must be a number or one for each of x,", INF),
    *wrong(expert, "noise_std must be a number or one for each of", "0.1"),
    *of_wrong_type(expert, "demonstrations must be", demonstrations=[zeros(2, 5, 1)]),
    *wrong(
        partial(rms_error, shown()),
        "executed must have shape (N, 5, 1), got (3,",
        zeros(3, 5, 2),
        zeros(3, 2, 1),
    ),
    *wrong(
        partial(rms_error, shown()), "executed must have shape (N, 5, 1), got (0,", zeros(0, 5, 1)
    ),
    *wrong(partial(rms_error, shown()), "executed must be finite, got nan in", full(NAN, 3, 5, 1)),
    *of_wrong_type(demonstration_spread, "demonstrations must be", zeros(2, 5, 1)),
    *ill_shown(loaded, "time_step must be nan s, got 0.1 s", NAN),
    *ill_shown(shipped_demonstrations, "shipped demonstrations must be", "../x"),
    *not_aligned(align, "at least two trajectories are needed, got 1", lines(9)),
    *not_aligned(partial(align, lines(9, 9)), "window must be in (0, 1], a fraction", window=[NAN]),
    *not_aligned(partial(align, lines(9, 9)), "reference must be the number of a", reference=[0.5]),
    *not_aligned(
        align,
        "trajectory 0 must be a tensor",
        [zeros(9, 1).cdouble(), zeros(9, 1)],
        [np.zeros((9, 1)), np.zeros((9, 1))],
    ),
    *not_aligned(resampled, "time_step must be positive and", time_step=[NAN]),
    *not_aligned(resampled, "time_step must leave at most", time_step=[1e-12]),
    *not_aligned(resampled, "values and times must be", WALK * NAN),
    *not_aligned(lambda: without_jumps(WALK, TIMES * 0, 1.0), "times must increase, got 0 s"),
    *not_aligned(
        lambda: plane_coordinates(zeros(1, 2), full(NAN, 4, 2), zeros(4, 2)),
        "markers must be finite, got",
    ),
    *ill_shown(recordings, "labels, times and values must", labels=[("1", "2")]),
    *ill_shown(recordings, "demonstration 1, sample 1,", times=[(TIMES.flip(0),)]),
    *ill_shown(recordings, "time must be a finite number, got inf", times=[(full(INF, 5),)]),
    *ill_shown(recordings, "must hold 1 entries at each of at least one", values=[(TIMES,)]),
    # experiments
    *wrong(
        load_experiment,
        "experiment must be one of acrobot, biorob, biorob_targets, ",
        "triple",
        ["a"],
    ),
    *ill_shown(
        load_experiment, "handwriting needs strokes (demonstrations=lasa:Angle, ", "handwriting"
    ),
    *ill_shown(
        lambda: load_experiment("double_pendulum", shown()), "demonstrations must be of x1,"
    ),
    *of_wrong_type(
        lambda: load_experiment("double_pendulum", zeros(2, 5, 4)), "demonstrations must be"
    ),
    *wrong(changed, "demonstrated_states must have", demonstrated_states=[zeros(3, 2)]),
    *wrong(changed, "demonstrated_states must have shape (S, 2), got", space=[SPACE]),
    *wrong(with_settings, "a setting of double_pendulum must be one of ", serach=[1]),
    *of_wrong_type(with_settings, "search must be Settings, got int", search=[1]),
    *wrong(with_settings, "input_widths must have shape (6,),", input_widths=[[1.0]]),
    *wrong(with_settings, "noise_std must be numbers, got ['a']", noise_std=[["a"]]),
    *wrong(
        with_settings,
        "search.restarts must be a whole number of at least 0, got '2'",
        **{"search.restarts": ["2"]},
    ),
    *wrong(
        SearchSettings,
        "search.trust_threshold must be a finite number, at least 0, got inf",
        trust_threshold=[INF],
    ),
    *wrong(
        with_settings,
        "random_action must be a finite number, above 0, at most 1, got 1.5",
        random_action=[1.5],
    ),
    *wrong(with_settings, "num_centres must be a whole number from", num_centres=[2.5]),
    # robots
    *wrong(DoublePendulumEnv, "link_masses must be two positive finite numbers in", (0.5, NAN)),
    *wrong(DoublePendulumEnv, "torque_limit must be one or 2", torque_limit=[(1.0, 1.0, 1.0)]),
    *wrong(
        DoublePendulumEnv, "control_period must be positive and finite,", control_period=[NAN, INF]
    ),
    *wrong(DoublePendulumEnv, "num_envs must be None or at least 1, got 1.5", num_envs=[1.5]),
    *wrong(DoublePendulumEnv, "seed must be None or a whole number from 0 to ", seed=[-1, 10**30]),
    *wrong(
        lambda: robot().reset(TensorDict({"observation": full(NAN, 4)})),
        "start observation must be",
    ),
    *wrong(acted, "action must be finite, got", full(NAN, 2)),
    *wrong(acted, "action must hold real", zeros(2).cdouble()),
    *wrong(
        lambda: robot().simulate(zeros(1, 3), zeros(1, 2)),
        "state must have shape (1, 4), got (1, 3)",
    ),
    *wrong(adapted, "the environment must have", observation=["state"]),
    *wrong(adapted, "angles must be of different", angles=[[CosSin(0, 0)]]),
    *of_wrong_type(adapted, "make_env must make an EnvBase, got int", lambda: 3),
    *of_wrong_type(lambda: adapted(robot()), "make_env must make the environment, got"),
    *wrong(
        partial(GPWorldModel, 2, 1),
        "expected five or six in_keys and two out_keys, got",
        in_keys=[["a"]],
    ),
    *wrong(
        WORLD, "expected observation (*batch, 2), got the keys []", TensorDict({}), error=KeyError
    ),
    *wrong(believed, "('observation', 'var') must", {"mean": zeros(2), "var": ones(2)}),
    *not_positive(
        believed,
        "covariance of belief must be",
        {"mean": zeros(2), "var": torch.tensor(INDEFINITE)},
    ),
    *wrong(believed, "features must be finite, got", full(NAN, 2)),
    *of_wrong_type(imagined, "base_env must be an EnvBase, got NoneType", None),
    *of_wrong_type(imagined, "base_env must be an EnvBase, got str", "Pendulum-v1"),
    *wrong(
        lambda: imagined(robot(), batch_size=(-1,)),
        "batch_size must hold positive numbers,",
    ),
    # plotting
    *wrong(
        lambda: distributions(demonstrated=STEPS[:0], predicted=STEPS[:0]),
        "demonstrated.mean must hold one at least, got none",
    ),
    *wrong(
        distributions,
        "predicted must be (5, 2), demonstrations and executed (N, 6, 2) for",
        executed=[zeros(3, 5, 2)],
    ),
    *wrong(
        lambda: plotting.plot_demonstrations(*NAMED, 0.1, zeros(0, 6, 2), STEPS),
        "demonstrations must hold one",
    ),
    *wrong(
        lambda: plotting.plot_learning_curve([], [], []),
        "experience_s must hold one at least, got",
    ),
    *wrong(
        lambda: plotting.plot_learning_curve([1.0], [1.5], [1.0]),
        "success_rate must be between 0 and",
    ),
    *wrong(
        lambda: plotting.plot_success_over_experience(TWO, np.zeros((0, 2)), TWO, TWO),
        "rates must hold one at least,",
    ),
    *wrong(plotting.plot_success_of_methods, "curves must hold one at least, got none", {}),
    *wrong(plotting.plot_success_of_methods, "experience, mean and interval of", {"a": (TWO, TWO)}),
    *wrong(
        lambda: plot_success_over_mass([], {}, np.zeros((1, 0)), 3.5, 0.5),
        "masses must hold one at",
    ),
    *wrong(
        lambda: plot_success_over_settings({}, []),
        "panels must hold one at least, got none",
    ),
    *wrong(
        lambda: plot_success_over_settings({"a": ([0.0], np.ones((1, 1)))}, []),
        "plain must hold 1 levels, one",
    ),
    *wrong(
        lambda: plot_variants([], np.zeros((0, 1)), np.zeros((0, 1))), "labels must hold one at"
    ),
    *wrong(plotting.plot_writing, "panels must hold one at least, got none", {}),
    *wrong(
        plotting.plot_writing,
        "strokes of a must be (N, 6,",
        {"a": (zeros(1, 5, 3), STEPS, zeros(1, 5, 2))},
    ),
    *wrong(lambda: plotting.plot_poses(zeros(0, 4), 0.1), "joints must have shape (N, P, 2), got"),
    *wrong(
        lambda: list(plotting.pendulum_frames(zeros(0, 4), 0.1)),
        "joints must have shape (N, P, 2),",
    ),
    *wrong(
        lambda: plotting.plot_recordings([], [], [], ["x"]),
        "0 labels and 1 names must be those of 0",
    ),
    *wrong(
        lambda: plotting.plot_recordings(["1"], [TIMES], [WALK], ["x"], ["m", "m"]),
        "units must be those of the 1",
    ),
    *wrong(
        lambda: plotting.plot_recordings(["1"], [TIMES[:0]], [TIMES[:0, None]], ["x"]),
        "1 labels and 1 names must be",
    ),
    *wrong(
        lambda: plotting.plot_before_after(["x"], ["m"], [], []),
        "there must be a trajectory before",
    ),
    *wrong(lambda: plot_frequencies([1.0], {}), "scores must hold one at least, got none"),
    *wrong(lambda: plot_photo_series({}, []), "rows must hold one at least, got none"),
    *wrong(
        lambda: plotting.plot_policy(STATE_POLICY, [], full(0, 1, 2), ["a"]),
        "planes must hold one at",
    ),
    *wrong(video, "a video needs at least one frame, got none", []),
    *wrong(video, "frame 0 must be uint8 of shape (16, 16, 3),", [FRAMES[0] * 1.0]),
    *wrong(video, "fps must be a positive finite number, got 0", fps=[0]),
    *wrong(video, "fps must be a positive finite number, got nan", fps=[NAN]),
    *wrong(video, "frames must have shape", [np.zeros((0, 0, 3), dtype=np.uint8)]),
]


@pytest.mark.parametrize(("call", "said", "error"), MISUSES, ids=[said for _, said, _ in MISUSES])
def test_misuse_is_one_line_that_says_what_was_expected_and_what_came(
    call: Callable[[], object],
    said: str,
    error: type[Exception],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error) as caught:
        call()
    (message,) = caught.value.args[:1]
    assert type(caught.value) is error
    assert said in message and re.search(r"\bgot\b", message)
    assert "\n" not in message and len(message) < LONGEST


@pytest.mark.parametrize("kind", [float, np.float32, np.int64, np.array, torch.tensor, Fraction])
def test_positive_number_may_be_of_any_kind_but_bool(kind: Callable[[int], object]) -> None:
    found = check_positive("width", kind(3))
    assert found == 3 and type(found) is float
    for truth in (True, np.bool_(True), np.array(True), torch.tensor(True)):
        with pytest.raises(ValueError, match="width must be a positive finite number, got "):
            check_positive("width", truth)


def test_table_has_at_least_300_rows() -> None:
    assert len(MISUSES) >= 300
