"""The drop-ins for TorchRL against the plain loop, GPyTorch, and TorchRL's own pieces."""

from __future__ import annotations

import itertools
import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import mujoco
import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torch.autograd import gradcheck
from torchrl.collectors import Collector
from torchrl.data import Categorical, Unbounded
from torchrl.envs import EnvBase, model_based
from torchrl.envs.utils import RandomPolicy, check_env_specs

from benchmarks.workloads import make_dynamics, rbf_controller, world_model
from examples import torchrl_pilco
from tests.helpers.draws import Draws
from torch_pmil import Gaussian, GPDynamics, KnownPart, RBFPolicy, StateSpace, joint_match
from torch_pmil.envs import DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.gp.gaussian import joint, symmetric
from torch_pmil.model.rollout import predict_step
from torch_pmil.torchrl_interop import BeliefPolicy, GPWorldModel, ImaginedEnv
from torch_pmil.torchrl_interop.keys import (
    ACTION_BELIEF,
    FEATURE_CROSS_COVARIANCE,
    STATE_BELIEF,
    raw_space,
)

NAMES, UNITS = ("q1", "dq1", "q2", "dq2"), ("rad", "rad/s") * 2
ANGLES = StateSpace(NAMES, UNITS, (0, 2), joint_match(NAMES, UNITS))
CART = """<mujoco>
  <option timestep="0.02" gravity="0 0 0"/>
  <worldbody>
    <camera name="front" pos="0 -3 0"/>
    <body>
      <joint name="slide" type="slide" axis="1 0 0" damping="0.5"/><geom size="0.1" mass="1"/>
    </body>
  </worldbody>
  <actuator><motor joint="slide"/></actuator>
</mujoco>"""
HORIZON = 4
# TorchRL's, which it adds to the raw action's variance, times the largest action squared, each step
JITTER = 1e-6 * 3**2 * HORIZON

raw_or_angles = pytest.mark.parametrize("space", [None, ANGLES], ids=["raw", "angles"])


def robot(num_envs: int | None = None) -> DoublePendulumEnv:
    """Four state entries and two actions."""
    return DoublePendulumEnv(num_envs=num_envs, seed=0)


def cart() -> MujocoRobotEnv:
    """Two state entries and one action, which is what TorchRL's ``ImaginedEnv`` takes."""
    model = mujoco.MjModel.from_xml_string(CART)
    initial = {"initial_mean": [0.0, 0.0], "initial_std": [0.5, 0.5]}
    return MujocoRobotEnv(model, ["slide"], **initial, torque_limit=2.0, seed=0)


def transitions(draws: Draws, n: int = 20, D: int = 4, F: int = 2) -> TensorDictBase:
    """Of a smooth system."""
    x, u = draws.uniform(-1, 1, n, D), draws.uniform(-2, 2, n, F)
    change = 0.1 * torch.sin(x @ draws.normal(D, D) + u @ draws.normal(F, D))
    after = {"observation": x + change + 0.003 * draws.normal(n, D)}
    return TensorDict({"observation": x, "action": u, "next": after}, [n])


def world(draws: Draws, space: StateSpace | None = None, D: int = 4, F: int = 2) -> GPWorldModel:
    """A model with data and hyper-parameters by hand."""
    data, model = transitions(draws, D=D, F=F), GPWorldModel(D, F, space=space)
    inputs = torch.cat([model.space.features(data["observation"]), data["action"]], -1)
    model.dynamics = make_dynamics(inputs, data["next", "observation"] - data["observation"])
    return model


def rbf_policy(
    draws: Draws, space: StateSpace | None = None, D: int = 4, F: int = 2
) -> BeliefPolicy:
    inputs = len((space or raw_space(D)).feature_names)
    centres, scale = draws.normal(6, inputs), draws.uniform(0.8, 1.5, inputs)
    policy = RBFPolicy(centres, torch.linspace(2, 3, F), scale)
    policy.weights.data.copy_(0.5 * draws.normal(6, F))
    return BeliefPolicy(policy, space)


def as_observation(belief: Gaussian) -> TensorDictBase:
    observation = {"mean": belief.mean, "var": belief.cov}
    return TensorDict({"observation": observation}, belief.batch_shape)


def joint_belief(draws: Draws, *batch: int, scale: float = 0.05) -> TensorDictBase:
    """A belief over state and action, as a world model reads it."""
    both = draws.belief(*batch, 6, scale=scale)
    state, action = both.marginal(torch.arange(4)), both.marginal(torch.arange(4, 6))
    slope = torch.linalg.solve(state.cov, both.cov[..., :4, 4:])
    written = {"mean": action.mean, "var": action.cov, "cross_covariance": slope}
    return as_observation(state).update({"action": written})


def next_belief(tensordict: TensorDictBase) -> Gaussian:
    following = tensordict["next", "observation"]
    return Gaussian(following["mean"], following["var"])


def posterior(model: GPDynamics, x: Tensor) -> tuple[Tensor, Tensor]:
    """GPyTorch's own mean and noisy variance of the change, (N, D) both."""
    model.gp.eval()
    with torch.no_grad():
        prediction = model.gp.likelihood(model.gp(x.expand(model.num_outputs, *x.shape)))
    return prediction.mean.mT, prediction.variance.mT


def close(a: Tensor, b: Tensor, tolerance: float = 1e-8) -> bool:
    return a.shape == b.shape and bool((a - b).abs().max() <= tolerance * (1 + b.abs().max()))


# the world model


def test_certain_belief_gives_the_gp_posterior(draws: Draws) -> None:
    model, x, u = GPWorldModel(4, 2), draws.uniform(-1, 1, 7, 4), draws.uniform(-2, 2, 7, 2)
    model.fit(transitions(draws))
    mean, variance = posterior(model.dynamics, torch.cat([x, u], -1))
    certain = as_observation(Gaussian(x, torch.zeros(7, 4, 4).double()))
    belief = next_belief(model(certain.update({"action": {"mean": u}})))
    assert close(belief.mean, x + mean, 1e-10)
    assert close(belief.cov, torch.diag_embed(variance), 1e-9)


@raw_or_angles
def test_missing_covariances_are_zero(draws: Draws, space: StateSpace | None) -> None:
    model, x, u = world(draws, space), draws.normal(3, 4), draws.normal(3, 2)
    short = TensorDict({"observation": {"mean": x}, "action": {"mean": u}}, [3])
    whole = as_observation(Gaussian(x, torch.zeros(3, 4, 4).double()))
    var, slope = torch.zeros(3, 2, 2).double(), torch.zeros(3, 4, 2).double()
    zeros = {"mean": u, "var": var, "cross_covariance": slope}
    short, whole = next_belief(model(short)), next_belief(model(whole.update({"action": zeros})))
    assert torch.equal(short.mean, whole.mean) and torch.equal(short.cov, whole.cov)


def test_plain_observation_gives_the_posterior_mean_with_gradients(draws: Draws) -> None:
    model, x, u = world(draws), draws.uniform(-1, 1, 3, 4), draws.uniform(-2, 2, 3, 2)

    def successor(x: Tensor, u: Tensor) -> Tensor:
        return model(TensorDict({"observation": x, "action": u}, [3]))["next", "observation"]

    assert close(successor(x, u), x + posterior(model.dynamics, torch.cat([x, u], -1))[0], 1e-10)
    assert gradcheck(successor, (x.requires_grad_(), u.requires_grad_()))


@raw_or_angles
def test_belief_is_differentiable_in_all_that_is_read(
    draws: Draws, space: StateSpace | None
) -> None:
    model, belief = world(draws, space), joint_belief(draws)
    keys = model.in_keys[:5]

    def successor(*values: Tensor) -> tuple[Tensor, Tensor]:
        values = [
            value + value.mT if key[1] == "var" else value
            for key, value in zip(keys, values, strict=True)
        ]
        result = next_belief(model(TensorDict(dict(zip(keys, values, strict=True)))))
        return result.mean, result.cov

    halves = [belief[key] / 2 if key[1] == "var" else belief[key] for key in keys]
    assert gradcheck(successor, [value.requires_grad_() for value in halves])


def test_velocities_alone_are_learned_where_positions_follow(draws: Draws) -> None:
    """Beside a model of all differences, to which the positions are no surprise."""
    known = KnownPart.of_velocities(NAMES, {"q1": "dq1", "q2": "dq2"}, 2, 0.1)
    x, u = draws.normal(40, 4), draws.normal(40, 2)
    after = known.successors(x, u, torch.stack([x[:, 0].sin() - u[:, 0], u[:, 1] - x[:, 3]], -1))
    data = TensorDict({"observation": x, "action": u, "next": {"observation": after}}, [40])
    alone = GPWorldModel(4, 2, targets=known)
    alone.fit(data)
    plain = GPWorldModel(4, 2)
    plain.fit(data)
    belief = joint_belief(draws, scale=0.05)
    ours, theirs = (next_belief(model(belief.clone())) for model in (alone, plain))
    torch.testing.assert_close(ours.mean, theirs.mean, rtol=0, atol=0.02)
    torch.testing.assert_close(ours.cov, theirs.cov, rtol=0.1, atol=0.01)


def test_known_part_of_other_sizes_is_refused() -> None:
    known = KnownPart.of_velocities(NAMES, {}, num_actions=1, time_step=0.1)
    with pytest.raises(ValueError, match="targets must be of 3 entries, got those of 4"):
        GPWorldModel(3, 1, targets=known)
    with pytest.raises(ValueError, match="known part must be of the 2 actions, got one of 1"):
        GPDynamics(6, 4, known).known_part(raw_space(4))


@raw_or_angles
def test_batch_equals_loop(draws: Draws, space: StateSpace | None) -> None:
    model, beliefs = world(draws, space), joint_belief(draws, 2, 3)
    batch = next_belief(model(beliefs.clone()))
    for index in itertools.product(range(2), range(3)):
        one = next_belief(model(beliefs[index]))
        assert close(batch[index].mean, one.mean, 1e-12) and close(batch[index].cov, one.cov, 1e-12)


def test_features_of_a_state_jointly_gaussian_with_the_action_covary_as_samples_do(
    draws: Draws,
) -> None:
    model, belief = world(draws, ANGLES), joint_belief(draws, scale=0.3)
    cross_cov = belief["observation", "var"] @ belief["action", "cross_covariance"]
    state, action = (
        Gaussian(belief[part, "mean"], belief[part, "var"]) for part in ("observation", "action")
    )
    samples = joint(state, action, cross_cov).sample(400_000, draws.generator)
    features = ANGLES.feature_moments(state)[0]
    deviation = ANGLES.features(samples[:, :4]) - features.mean
    products = deviation[..., None] * (samples[:, None, 4:] - action.mean)
    slopes = [torch.linalg.solve(features.cov, chunk.mean(0)) for chunk in products.chunk(20)]
    estimates = torch.stack([successor_given(model, belief, slope) for slope in slopes])
    exact = next_belief(model(belief.clone()))
    error = 4 * estimates.std(0) / len(estimates) ** 0.5
    difference = estimates.mean(0) - torch.cat([exact.mean[None], exact.cov])
    assert (difference.abs() <= error + 1e-7).all()
    assert error.max() < 1e-3


def successor_given(model: GPWorldModel, belief: TensorDictBase, feature_slope: Tensor) -> Tensor:
    result = next_belief(model(belief.clone().set(FEATURE_CROSS_COVARIANCE, feature_slope)))
    return torch.cat([result.mean[None], result.cov])


def test_keys_can_be_renamed(draws: Draws) -> None:
    keys = ["u", "U", "G", ("state", "m"), ("state", "V")]
    renamed, model = GPWorldModel(4, 2, in_keys=keys, out_keys=["m1", "V1"]), world(draws)
    renamed.load_state_dict(model.state_dict())
    belief = joint_belief(draws)
    pairs = zip(keys, model.in_keys, strict=True)
    result = renamed(TensorDict({key: belief[old] for key, old in pairs}))
    assert torch.equal(result["V1"], next_belief(model(belief)).cov) and "m1" in result


@pytest.mark.parametrize("fitted", [False, True], ids=["fresh", "of other data"])
def test_state_dict_loads(draws: Draws, tmp_path: Path, fitted: bool) -> None:
    """Of other data: in float32, of another batch."""
    model, other = world(draws, ANGLES), GPWorldModel(4, 2, space=ANGLES)
    if fitted:
        other.fit(transitions(draws, 8).float().reshape(4, 2))
        assert other.dynamics.train_inputs.shape == (8, 8)
    torch.save(model.state_dict(), tmp_path / "model.pt")
    other.load_state_dict(torch.load(tmp_path / "model.pt", weights_only=True))
    belief = joint_belief(draws).float()
    ours, loaded = (next_belief(each(belief.clone())) for each in (model, other))
    assert torch.equal(ours.cov, loaded.cov) and ours.cov.dtype == torch.float64


AFTER = ("next", "observation")


def drop(key: str) -> Callable[[TensorDictBase], TensorDictBase]:
    return lambda data: data.exclude(key)


def put(key: object, value: Tensor) -> Callable[[TensorDictBase], TensorDictBase]:
    return lambda data: data.clone().set(key, value)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (drop("action"), KeyError, r"expected action \(\*batch, 2\), got the keys"),
        (put("action", torch.zeros(20, 3)), ValueError, r"action must have shape \(\*batch, 2\)"),
        (put(AFTER, torch.full((20, 4), torch.nan)), ValueError, "targets must be finite"),
    ],
    ids=["missing", "shape", "not finite"],
)
def test_bad_transitions_are_named(
    draws: Draws, change: Callable, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        GPWorldModel(4, 2).fit(change(transitions(draws)))


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (drop("action"), KeyError, r"expected \('action', 'mean'\), got the keys"),
        (drop("observation"), KeyError, r"expected observation \(\*batch, 4\), got the keys"),
        (
            put(("observation", "var"), torch.ones(4)),
            ValueError,
            r"\('observation', 'var'\) must have shape \(\*batch, 4, 4\), got \(4,\)",
        ),
    ],
    ids=["no action", "no observation", "variances"],
)
def test_bad_beliefs_are_named(
    draws: Draws, change: Callable, error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        world(draws)(change(joint_belief(draws)))


def test_bad_settings_are_named(draws: Draws) -> None:
    with pytest.raises(ValueError, match="space must have obs_dim = 3 entries, got the 4"):
        GPWorldModel(3, 1, space=ANGLES)
    with pytest.raises(ValueError, match="five or six in_keys and two out_keys, got 1 and 2"):
        GPWorldModel(4, 1, in_keys=["u"])
    with pytest.raises(RuntimeError, match="has no data yet"):
        GPWorldModel(4, 2)(joint_belief(draws))
    with pytest.raises(ValueError, match="the policy must have the inputs"):
        BeliefPolicy(rbf_policy(draws).policy, ANGLES)


# the policy


@raw_or_angles
def test_certain_policy_acts_as_on_the_plain_observation(
    draws: Draws, space: StateSpace | None
) -> None:
    policy, x = rbf_policy(draws, space), draws.normal(5, 4)
    belief = policy(as_observation(Gaussian(x, torch.zeros(5, 4, 4).double())))
    plain = TensorDict({"observation": x}, [5])

    def act(state: Tensor) -> Tensor:
        return policy(TensorDict({"observation": state}))["action"]

    slope = torch.stack([torch.autograd.functional.jacobian(act, one) for one in x])
    assert close(belief["action", "mean"], policy(plain)["action"], 1e-12)
    assert belief["action", "var"].abs().max() < 1e-12
    assert close(belief["action", "cross_covariance"], slope.mT, 1e-10)


@raw_or_angles
def test_policy_covaries_with_the_state_as_samples_do(
    draws: Draws, space: StateSpace | None
) -> None:
    policy, state = rbf_policy(draws, space), Gaussian(draws.normal(4), draws.cov(4, scale=1e-3))
    action = policy(as_observation(state))["action"]
    x = state.sample(200_000, draws.generator)
    u = policy(TensorDict({"observation": x}))["action"].detach()
    products = (x - state.mean)[..., None] * (u - action["mean"])[:, None]
    difference = products.mean(0) - state.cov @ action["cross_covariance"]
    scale = state.std[:, None] * action["var"].diagonal().sqrt()
    assert (difference.abs() <= 4 * products.std(0) / len(x) ** 0.5 + 1e-2 * scale).all()


def test_policy_asks_for_an_observation(draws: Draws) -> None:
    with pytest.raises(KeyError, match=r"expected observation \(\*batch, 4\), got the keys"):
        rbf_policy(draws)(TensorDict({"pixels": torch.zeros(4)}))


def test_one_policy_acts_in_the_imagined_and_in_the_real_environment(draws: Draws) -> None:
    policy, env = rbf_policy(draws), robot()
    with torch.no_grad():
        real = env.rollout(3, policy)
    frames = {"frames_per_batch": 3, "total_frames": 3}
    collector = Collector(robot(), policy, **frames, auto_register_policy_transforms=False)
    collected = next(iter(collector))
    imagined = ImaginedEnv(world(draws), env).rollout(3, policy)
    assert real["action"].shape == collected["action"].shape == (3, 2)
    assert imagined["action", "mean"].shape == (1, 3, 2)
    assert not imagined["next", "reward"].any() and not imagined["next", "done"].any()


# the environment


@raw_or_angles
@pytest.mark.parametrize("batch_size", [None, (), (3,), (2, 3)], ids=str)
@pytest.mark.parametrize("num_envs", [None, 3])
def test_specs_hold(
    draws: Draws, space: StateSpace | None, batch_size: tuple[int, ...] | None, num_envs: int | None
) -> None:
    env = ImaginedEnv(world(draws, space), robot(num_envs), batch_size)
    assert env.batch_size == ((num_envs or 1,) if batch_size is None else batch_size)
    check_env_specs(env, seed=0, break_when_any_done="both")
    floats = [spec for spec in env.specs.values(True, True) if spec.dtype.is_floating_point]
    assert floats and {spec.dtype for spec in floats} == {torch.float64}


def test_random_actions_are_certain_for_torchrls_model(draws: Draws) -> None:
    pytest.importorskip("botorch")
    model, start = world(draws), as_observation(draws.belief(1, 4, scale=0.02))
    ours, theirs = (ImaginedEnv(each, robot()) for each in (model, world_model(model.dynamics)))
    torch.manual_seed(0)
    predicted = ours.rollout(2, tensordict=start)["next", "observation"]
    torch.manual_seed(0)
    reference = theirs.rollout(2, tensordict=start)["next", "observation"]
    for name in ("mean", "var"):
        assert close(predicted[name], reference[name], 1e-6)


def test_random_actions_keep_to_the_robots_limits(draws: Draws) -> None:
    torch.manual_seed(0)
    env = ImaginedEnv(world(draws), robot(), batch_size=(50,))
    actions = env.rollout(2, RandomPolicy(env.action_spec))["action", "mean"]
    limit = robot().action_spec.high
    assert (actions.abs() <= limit).all() and (actions.abs() > limit / 2).any()


@raw_or_angles
@pytest.mark.parametrize("batch", [(), (1,), (2, 3)], ids=str)
def test_rollout_is_the_plain_loop_with_its_gradients(
    draws: Draws, space: StateSpace | None, batch: tuple[int, ...]
) -> None:
    model, policy = world(draws, space), rbf_policy(draws, space)
    cov = draws.cov(*batch, 4, scale=0.02).requires_grad_()
    start = Gaussian(0.3 * draws.normal(*batch, 4).requires_grad_(), cov)
    leaves = [start.mean, start.cov, *policy.parameters()]
    weights = draws.normal(*batch, HORIZON, 4), draws.normal(*batch, HORIZON, 4, 4)

    env = ImaginedEnv(model, robot(), batch)
    imagined = env.rollout(HORIZON, policy, tensordict=as_observation(start))[AFTER]
    looped = plain_loop(start, policy, model, HORIZON)
    assert close(imagined["mean"], looped.mean) and close(imagined["var"], looped.cov)
    gradients = [
        torch.autograd.grad((mean * weights[0]).sum() + (var * weights[1]).sum(), leaves)
        for mean, var in ((imagined["mean"], imagined["var"]), (looped.mean, looped.cov))
    ]
    pairs = zip(*((mean, symmetric(cov), *rest) for mean, cov, *rest in gradients), strict=True)
    for by_env, by_loop in pairs:
        assert by_loop.abs().max() > 1e-3 and close(by_env, by_loop)


def plain_loop(
    state: Gaussian, policy: BeliefPolicy, model: GPWorldModel, horizon: int
) -> Gaussian:
    controller, states = policy.policy.controller, []
    for _ in range(horizon):
        state = predict_step(state, controller, model.dynamics, model.space)
        states.append(state)
    means, covs = [s.mean for s in states], [s.cov for s in states]
    return Gaussian(torch.stack(means, -2), torch.stack(covs, -3))


def test_rollout_starts_where_it_is_told(draws: Draws) -> None:
    env, belief = ImaginedEnv(world(draws), robot(), (2,)), draws.belief(2, 4)
    x = draws.normal(2, 4)
    given = env.reset(as_observation(belief))["observation"]
    certain = env.reset(TensorDict({"observation": x}, [2]))["observation"]
    assert torch.equal(given["var"], belief.cov) and torch.equal(given["mean"], belief.mean)
    assert torch.equal(certain["mean"], x) and not certain["var"].any()


def test_partial_reset_leaves_the_others_where_they_are(draws: Draws) -> None:
    env, belief = ImaginedEnv(world(draws), robot(), (2,)), draws.belief(2, 4)
    now = env.reset(as_observation(belief)).set("_reset", torch.tensor([[True], [False]]))
    then = env.reset(now, select_reset_only=True)["observation"]
    assert torch.equal(then["mean"][1], belief.mean[1])
    assert torch.equal(then["var"][1], belief.cov[1])
    assert not torch.equal(then["mean"][0], belief.mean[0]) and not then["var"][0].any()


class OddEnv(EnvBase):
    """An environment that only has specifications."""

    def __init__(self, **specs: object) -> None:
        super().__init__()
        self.observation_spec = specs["observation"]
        self.action_spec = specs["action"]

    def _reset(self, tensordict: TensorDictBase | None, **kwargs) -> TensorDictBase: ...

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase: ...

    def _set_seed(self, seed: int | None) -> None: ...


def test_environments_that_cannot_be_imagined_are_named(draws: Draws) -> None:
    vector = robot().observation_spec
    with pytest.raises(ValueError, match="one action that is a vector of real numbers, got Categ"):
        ImaginedEnv(world(draws), OddEnv(observation=vector, action=Categorical(3)))
    picture = type(vector)(observation=Unbounded((4, 4, 3)))
    with pytest.raises(ValueError, match='base_env must have a vector "observation"'):
        ImaginedEnv(world(draws), OddEnv(observation=picture, action=Unbounded((1,))))


# beside TorchRL's own


def torchrl_policy(policy: BeliefPolicy) -> TensorDictModule:
    return TensorDictModule(
        rbf_controller(policy.policy), in_keys=STATE_BELIEF, out_keys=ACTION_BELIEF
    )


@pytest.mark.parametrize(
    ("env", "N", "D", "F"),
    [(ImaginedEnv, 1, 2, 1), (model_based.ImaginedEnv, 1, 2, 1), (ImaginedEnv, 3, 4, 2)],
    ids=["our env", "torchrl env", "our env, several actions and starts"],
)
@pytest.mark.parametrize("our_policy", [True, False], ids=["our policy", "torchrl policy"])
@pytest.mark.parametrize("our_model", [True, False], ids=["our model", "torchrl model"])
def test_all_combinations_with_torchrls_pieces_predict_the_same(
    draws: Draws, env: type, N: int, D: int, F: int, our_model: bool, our_policy: bool
) -> None:
    pytest.importorskip("botorch")
    ours, policy = world(draws, D=D, F=F), rbf_policy(draws, D=D, F=F)
    model = ours if our_model else world_model(ours.dynamics)
    actor = policy if our_policy else torchrl_policy(policy)
    start = Gaussian(0.3 * draws.normal(N, D), draws.cov(N, D, scale=0.02))
    imagined = env(model, cart() if D == 2 else robot(N))
    predicted = imagined.rollout(HORIZON, actor, tensordict=as_observation(start))[AFTER]
    reference = plain_loop(start, policy, ours, HORIZON)
    assert close(predicted["mean"], reference.mean, JITTER)
    assert close(predicted["var"], reference.cov, JITTER)
    gradients = torch.autograd.grad(predicted["mean"].sum(), list(actor.parameters()))
    assert all(gradient.abs().max() > 0 for gradient in gradients)


# the page and the commands

ROOT = Path(__file__).parents[2]


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.mark.slow
def test_torchrls_model_misses_its_own_posterior_and_ours_does_not(tmp_path: Path) -> None:
    pytest.importorskip("botorch")
    summary = tmp_path / "summary.json"
    assert run("benchmarks.torchrl_model", "--n", "50", "--json", str(summary)).returncode == 0
    rows = {row["model"]: row for row in json.loads(summary.read_text())["rows"]}
    ours, theirs = rows["torch_pmil"], rows["torchrl"]
    assert abs(ours["variance_ratio_max"] - 1) < 1e-2 and ours["mean_error_std"] < 1e-6
    assert ours["state_dict"] == "loads" and ours["gradients"]
    assert theirs["variance_ratio_max"] > 2
    assert theirs["state_dict"] != "loads" and not theirs["gradients"]


@pytest.mark.slow
def test_the_example_balances_the_pole() -> None:
    pytest.importorskip("gymnasium")
    few = ("--epochs", "1", "--random-steps", "100", "--episodes", "3")
    result = run("examples.torchrl_pilco", *few)
    assert result.returncode == 0, result.stdout + result.stderr
    assert result.stdout.endswith("[1000, 1000, 1000] of 1000 steps; learned\n")


def test_the_example_says_what_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torchrl_pilco, "find_spec", lambda name: None)
    monkeypatch.setattr(sys, "argv", ["torchrl_pilco"])
    with pytest.raises(SystemExit):
        torchrl_pilco.parse()
    assert "needs gymnasium: pip install 'torch_pmil[gym]'" in capsys.readouterr().err
