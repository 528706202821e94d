"""From a state to a torque, in NumPy, PyTorch, TensorDict and where there is PyTorch alone."""

from __future__ import annotations

import copy
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor
from torch.testing import assert_close
from torchrl.envs.utils import check_env_specs

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.tasks.registry import load_experiment

STEP_SECONDS = 1e-3
BLOCKED = ["torch_pmil", "gpytorch", "linear_operator", "torchrl", "tensordict", "mujoco", "scipy"]
BLOCKED += ["hydra", "matplotlib", "numpy"]
LINE = StateSpace(("x", "v"), ("m", "m/s"), (), joint_match(("x", "v"), ("m", "m/s")))


def on_a_line(draws: Draws, centres: int = 3) -> StatePolicy:
    """A policy of two plain entries that still learns."""
    return StatePolicy(RBFPolicy(draws.normal(centres, 2), torch.ones(1), torch.ones(2)), LINE, 0.1)


@pytest.fixture(scope="module")
def policy() -> StatePolicy:
    """Of the double pendulum, with weights that are not small."""
    experiment = load_experiment("double_pendulum")
    network = experiment.make_policy(torch.Generator().manual_seed(0))
    with torch.no_grad():
        network.weights.mul_(10)
    network.requires_grad_(False)
    return StatePolicy(network, experiment.space, 0.1, actions=experiment.actions)


@pytest.fixture(scope="module")
def exported(policy: StatePolicy, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the programs of one state and of a batch."""
    folder = tmp_path_factory.mktemp("exported")
    policy.export(folder / "policy.pt2")
    policy.export(str(folder / "batch.pt2"), batch=True)
    return folder


@pytest.fixture(scope="module")
def program(exported: Path) -> Callable[[Tensor], Tensor]:
    return torch.export.load(exported / "policy.pt2").module()


@pytest.fixture(scope="module")
def batch_program(exported: Path) -> Callable[[Tensor], Tensor]:
    return torch.export.load(exported / "batch.pt2").module()


def test_torque_is_that_of_the_network_at_the_features(policy: StatePolicy, draws: Draws) -> None:
    q1, dq1, q2, dq2 = states = draws.normal(4)
    features = torch.stack([dq1, dq2, q1.sin(), q2.sin(), q1.cos(), q2.cos()])
    assert_close(policy(states), policy.policy(features), rtol=0, atol=1e-14)


def test_torque_does_not_change_by_a_full_turn_and_stays_within_the_limits(
    policy: StatePolicy, draws: Draws
) -> None:
    states = 3 * draws.normal(500, 4)
    turn = 2 * torch.pi * torch.tensor([1.0, 0.0, -2.0, 0.0], dtype=torch.float64)
    assert_close(policy(states + turn), policy(states), rtol=0, atol=1e-10)
    assert policy(states).abs().max() > 1
    assert (policy(states).abs() <= 3.5).all()


@pytest.mark.parametrize("shape", [(4,), (0, 4), (1, 4), (5, 4), (2, 3, 4)])
def test_arrays_make_arrays_and_tensors_make_tensors_of_any_batch(
    policy: StatePolicy, draws: Draws, shape: tuple[int, ...]
) -> None:
    states = draws.normal(*shape)
    torque, array = policy(states), policy(states.numpy())
    assert isinstance(torque, Tensor) and isinstance(array, np.ndarray)
    assert (torque.dtype, array.dtype) == (torch.float64, np.float64)
    assert torque.shape == array.shape == (*shape[:-1], 2)
    assert (torque.numpy() == array).all()


def test_batch_is_its_states_one_by_one(policy: StatePolicy, draws: Draws) -> None:
    states = draws.normal(6, 4)
    alone = torch.stack([policy(state) for state in states])
    assert_close(policy(states), alone, rtol=0, atol=1e-13)


@pytest.mark.parametrize("dtype", [np.float32, np.float16, np.int64, np.uint8, ">f8"])
def test_real_numbers_of_any_dtype_count_as_they_are(
    policy: StatePolicy, dtype: str | type
) -> None:
    state = np.array([3, 1, 2, 5], dtype=dtype)
    expected = policy(np.array([3.0, 1.0, 2.0, 5.0]))
    assert (policy(state) == expected).all()
    if dtype != ">f8":
        assert (policy(torch.from_numpy(state)).numpy() == expected).all()


def test_arrays_with_reversed_strides_or_write_protection_are_taken_and_left_alone(
    policy: StatePolicy, draws: Draws
) -> None:
    states = draws.normal(3, 4).numpy()
    reverse, protected = states[:, ::-1], states.copy()
    protected.flags.writeable = False
    assert (policy(reverse) == policy(reverse.copy())).all()
    torque = policy(protected)
    torque += 1.0
    assert (protected == states).all()


def test_gradient_by_the_state_passes(policy: StatePolicy, draws: Draws) -> None:
    assert torch.autograd.gradcheck(policy, draws.normal(2, 4).requires_grad_())


def test_policy_that_still_learns_gives_arrays_too(draws: Draws) -> None:
    learning = on_a_line(draws)
    assert learning(torch.zeros(2)).requires_grad
    assert isinstance(learning(np.zeros(2)), np.ndarray)


@pytest.mark.parametrize("kind", [np.asarray, torch.as_tensor], ids=["numpy", "torch"])
@pytest.mark.parametrize(
    ("state", "error", "complaint"),
    [
        (0.0, ValueError, "state must have shape (*batch, 4) for q1, dq1, q2, dq2, got ()"),
        (
            [[0.0] * 4, [0.0, 0.0, 0.0, -float("inf")]],
            ValueError,
            "state must be finite, got dq2 = -inf at batch element (1,)",
        ),
        ([True] * 4, TypeError, "state must hold real numbers, got {}bool"),
        ([1j] * 4, TypeError, "state must hold real numbers, got {}complex"),
    ],
)
def test_wrong_state_is_one_line(
    policy: StatePolicy, kind: Callable, state: list, error: type[Exception], complaint: str
) -> None:
    with pytest.raises(error) as raised:
        policy(kind(state))
    line = complaint.format("torch." if kind is torch.as_tensor else "")
    assert str(raised.value).startswith(line) and "\n" not in str(raised.value)


@pytest.mark.parametrize("kind", [list, tuple])
def test_lists_are_taken_as_arrays(policy: StatePolicy, kind: type) -> None:
    torque = policy(kind([3.14, 0, 0, 0]))
    assert isinstance(torque, np.ndarray)
    np.testing.assert_array_equal(torque, policy(np.array([3.14, 0, 0, 0])))
    assert policy([[3.14, 0, 0, 0]] * 3).shape == (3, 2)


def test_ragged_list_is_one_line(policy: StatePolicy) -> None:
    with pytest.raises(ValueError, match=r"state must hold numbers, as many in each row, got \[\["):
        policy([[0.0] * 4, [0.0]])


def test_tensor_on_another_device_is_an_error(policy: StatePolicy) -> None:
    with pytest.raises(ValueError, match="state must be on cpu like the policy, got meta"):
        policy(torch.zeros(4, device="meta"))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no GPU")
def test_policy_on_a_gpu_acts_as_on_the_cpu_and_is_exported_for_the_cpu(
    policy: StatePolicy, tmp_path: Path, draws: Draws
) -> None:
    states, there = draws.normal(5, 4), copy.deepcopy(policy).cuda()
    close = {"rtol": 0, "atol": 1e-12}
    assert_close(there(states.cuda()).cpu(), policy(states), **close)
    assert_close(torch.from_numpy(there(states.numpy())), policy(states), **close)
    there.export(tmp_path / "policy.pt2")
    assert there.policy.u_max.is_cuda
    program = torch.export.load(tmp_path / "policy.pt2").module()
    assert_close(program(states[0]), policy(states[0]), **close)


def test_policy_says_what_it_is_for(policy: StatePolicy) -> None:
    expected = (
        "state q1 (rad), dq1 (rad/s), q2 (rad), dq2 (rad/s); actions tau1 (N·m) from -3.5 to 3.5, "
        "tau2 (N·m) from -3.5 to 3.5; every 0.1 s"
    )
    assert policy.extra_repr() == expected
    assert expected in repr(policy)


def test_tensordict_module_acts_in_an_environment_as_the_policy_does(policy: StatePolicy) -> None:
    env = load_experiment("double_pendulum").make_env(num_envs=3, seed=0)
    check_env_specs(env)
    rollout = env.rollout(5, policy.as_tensordict_module())
    assert torch.equal(rollout["action"], policy(rollout["observation"]))
    assert env.action_spec.is_in(rollout["action"][:, 0])


def test_exported_program_takes_batches_of_any_size(
    policy: StatePolicy, batch_program: Callable[[Tensor], Tensor], draws: Draws
) -> None:
    for count in (0, 1, 2, 100):
        states = 3 * draws.normal(count, 4)
        assert_close(batch_program(states), policy(states), rtol=0, atol=1e-12)


def test_export_leaves_the_policy_and_its_state_space_as_they_were(
    policy: StatePolicy, exported: Path, draws: Draws
) -> None:
    assert type(policy(draws.normal(4))) is Tensor
    assert type(policy.space.augmentation.rows) is Tensor
    assert sorted(os.listdir(exported)) == ["batch.pt2", "policy.pt2"]


def test_first_use_of_a_state_space_may_be_an_export(tmp_path: Path, draws: Draws) -> None:
    space = StateSpace(("q", "dq"), ("", ""), (0,), joint_match(("q", "dq"), ("", "")))
    fresh = StatePolicy(RBFPolicy(draws.normal(3, 3), torch.ones(1), torch.ones(3)), space, 0.1)
    fresh.export(tmp_path / "policy.pt2")
    assert type(fresh.space.augmentation.rows) is Tensor
    assert fresh(np.zeros(2)) == 0


def test_policy_that_still_learns_is_exported_as_it_is_then(tmp_path: Path, draws: Draws) -> None:
    learning, state = on_a_line(draws), draws.normal(2)
    weights = learning.policy.weights
    weights.data.copy_(draws.normal(3, 1))
    learning.export(tmp_path / "policy.pt2")
    expected = learning(state).detach()
    weights.data.zero_()
    assert weights.requires_grad
    program = torch.export.load(tmp_path / "policy.pt2").module()
    assert_close(program(state), expected, rtol=0, atol=1e-12)


def test_exported_program_needs_pytorch_alone(
    policy: StatePolicy, exported: Path, tmp_path: Path, draws: Draws
) -> None:
    states = 3 * draws.normal(50, 4)
    torch.save(states, tmp_path / "states.pt")
    script = f"""
import sys
sys.modules.update(dict.fromkeys({BLOCKED}))
import torch
one, batch = (
    torch.export.load(f"{exported}/{{name}}.pt2").module() for name in ("policy", "batch")
)
states = torch.load("states.pt", weights_only=True)
torch.save([torch.stack([one(state) for state in states]), batch(states)], "torques.pt")
try:
    import torch_pmil
except ImportError:
    print("no torch_pmil")
"""
    command = [sys.executable, "-c", script]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stderr
    assert process.stdout == "no torch_pmil\n"
    for torques in torch.load(tmp_path / "torques.pt", weights_only=True):
        assert_close(torques, policy(states), rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("state", "error", "complaint"),
    [
        (torch.zeros(3).double(), AssertionError, r"Guard failed: state.size\(\)\[0\] == 4"),
        (torch.zeros(2, 4).double(), AssertionError, "Guard failed: state"),
        (torch.zeros(4, 1).double(), RuntimeError, r"input.dim\(\) = 2 is not equal to"),
        (torch.tensor(0.0).double(), IndexError, "tuple index out of range"),
        (torch.zeros(4), RuntimeError, "dtype mismatch! Expected: Double, Got: float"),
        (torch.tensor([0.0, torch.nan, 0.0, 0.0]).double(), RuntimeError, "state must be finite"),
        (torch.tensor([0.0, torch.inf, 0.0, 0.0]).double(), RuntimeError, "state must be finite"),
    ],
)
def test_exported_program_refuses_wrong_states(
    program: Callable[[Tensor], Tensor], state: Tensor, error: type[Exception], complaint: str
) -> None:
    with pytest.raises(error, match=complaint):
        program(state)


def test_exported_batch_program_refuses_one_state_and_other_sizes(
    batch_program: Callable[[Tensor], Tensor],
) -> None:
    for shape in ((4,), (2, 3), (2, 3, 4), (2, 4, 3), (2, 4, 1)):
        with pytest.raises((AssertionError, IndexError, RuntimeError)):
            batch_program(torch.zeros(shape, dtype=torch.float64))


def test_exported_program_refuses_batches_even_where_sizes_would_fit(
    tmp_path: Path, draws: Draws
) -> None:
    """As many centres as features, and as many states as entries."""
    on_a_line(draws, centres=2).export(tmp_path / "policy.pt2")
    with pytest.raises(RuntimeError, match=r"input.dim\(\) = 2 is not equal to len\(dims\) = 1"):
        torch.export.load(tmp_path / "policy.pt2").module()(torch.zeros(2, 2, dtype=torch.float64))


def test_export_to_a_missing_folder_is_an_error(policy: StatePolicy, tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        policy.export(tmp_path / "nowhere" / "policy.pt2")
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("form", ["numpy", "torch", "exported"])
def test_step_takes_less_than_a_millisecond(
    policy: StatePolicy, program: Callable[[Tensor], Tensor], form: str
) -> None:
    """CPU time, which other work does not lengthen much, in the median of many."""
    state = torch.ones(4, dtype=torch.float64)
    step = {
        "numpy": lambda: policy(state.numpy()),
        "torch": lambda: policy(state),
        "exported": lambda: program(state),
    }[form]
    times = []
    for _ in range(300):
        start = time.process_time()
        step()
        times.append(time.process_time() - start)
    assert statistics.median(times) < STEP_SECONDS
