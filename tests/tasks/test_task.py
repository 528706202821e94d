"""What an experiment says of the robot and its first policy."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from reproduction.learned import load_learned
from tests.helpers.draws import Draws
from tests.helpers.refusal import refused
from tests.helpers.short_run import PD_MOVEMENTS, changed, short_experiment, shortened
from torch_pmil.control.exploration import RandomActions
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.runs.training import train
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.tasks.task import Task

WIDTHS = torch.tensor([2.0, 3.0, 0.5, 0.6, 0.7, 0.8], dtype=torch.float64)


# demonstrated with a spread of sin q2, or of the cart, below the least width; or by others
UNLIKE = {"acrobot", "cart_pole", "pendubot", "handwriting", "handwriting_biorob"}


@pytest.fixture(scope="module")
def experiment() -> Task:
    return load_experiment("double_pendulum")


def policy_of(task: Task, **changes: object) -> RBFPolicy:
    """Drawn with the same numbers each time."""
    return changed(task, **changes).make_policy(torch.Generator().manual_seed(0))


def lifting(states: Tensor) -> Tensor:
    """Any torques that depend on the state."""
    return torch.stack([1.5 + 0.3 * states[..., 1], -0.8 + 0.2 * states[..., 3]], -1)


def test_exploration_is_one_random_rollout_unless_it_is_said(experiment: Task) -> None:
    exploration = experiment.exploration
    assert isinstance(exploration, RandomActions) and exploration.actions is experiment.actions
    assert exploration.settings == {"rollouts": 1, "steps": 25, "random_action": 0.4}
    assert experiment.with_settings(exploration=PD_MOVEMENTS).exploration is PD_MOVEMENTS


def test_new_policy_holds_the_robot_at_its_starts(experiment: Task) -> None:
    """To 5 % rms of the torques, at starts that the fit did not see."""
    starts = experiment.initial.sample(500, torch.Generator().manual_seed(1))
    policy = policy_of(experiment, holding_actions=lifting)
    error = (policy(experiment.space.features(starts)) - lifting(starts)).detach()
    assert (error.square().mean(0).sqrt() < 0.05 * lifting(starts).abs().amax(0)).all()


def test_policy_that_holds_is_random_elsewhere_as_any_other(experiment: Task) -> None:
    """Far from the start, where no basis function that acts at the start reaches."""
    plain, holding = policy_of(experiment), policy_of(experiment, holding_actions=lifting)
    far = experiment.space.features(torch.tensor([0.0, 6.0, 2.0, -6.0], dtype=torch.float64))
    assert_close(holding(far), plain(far), rtol=0, atol=0.02)
    assert torch.equal(holding.centres, plain.centres)


def test_widths_may_be_said_in_the_units_of_the_features(experiment: Task) -> None:
    plain, wide = policy_of(experiment), policy_of(experiment, input_widths=WIDTHS)
    assert torch.equal(wide.controller.network.lengthscales, WIDTHS.expand(2, 6))
    assert_close(wide.centres * wide.scale, plain.centres * plain.scale)


def test_settings_say_what_the_first_policy_and_motion_are(experiment: Task) -> None:
    noise_std = torch.tensor([0.1, 0.2, 0.3, 0.4], dtype=torch.float64)
    first = {"holding_actions": lifting, "exploration": PD_MOVEMENTS}
    other = changed(experiment, noise_std=noise_std, input_widths=WIDTHS, **first).settings
    assert other["noise_std"] == noise_std.tolist() and other["input_widths"] == WIDTHS.tolist()
    assert other["holds_start"] and not experiment.settings["holds_start"]
    assert other["exploration"]["gain"] == PD_MOVEMENTS.gain.tolist()


@pytest.mark.parametrize("name", ["double_pendulum", "double_pendulum_targets", "biorob"])
def test_columns_in_another_order_are_the_same_demonstrations(name: str) -> None:
    shipped = load_experiment(name).demonstrations
    backwards = shipped.in_order(shipped.names[::-1])
    assert not torch.equal(backwards.positions, shipped.positions)
    learned = load_experiment(name, backwards).demonstrations
    assert learned.names == shipped.names
    assert torch.equal(learned.positions, shipped.positions)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("x1", "y1", "x2", "z"), "; pmil align RECORDED OUT.npz --names x1 y1 x2 y2 renames them"),
        (("z", "y2", "x2", "y1", "x1"), "; pmil align RECORDED OUT.npz --keys x1 y1 x2 y2 leaves"),
        (("x1", "y1"), ""),
    ],
)
def test_columns_of_other_names_are_refused_with_what_mends_it(
    names: tuple[str, ...], said: str
) -> None:
    shown = Demonstrations(torch.zeros(2, 26, len(names)), 0.1, names)
    line = f"demonstrations must be of x1, y1, x2, y2, got {', '.join(names)}{said}"
    assert refused(load_experiment, "double_pendulum", shown).startswith(line)


def still(name: str, samples: int, tremor: float = 0.0) -> Task:
    """A task whose robot stays at its mean start, or within some tremors of it."""
    task = load_experiment(name)
    states = task.initial.mean.expand(3, samples, -1)
    shown = task.space.observe(states + tremor * Draws(0).normal(*states.shape))
    return load_experiment(name, replace(task.demonstrations, positions=shown))


@pytest.mark.parametrize("tremor", [0.0, 1e-12, 1e-3])
@pytest.mark.parametrize("name", ["double_pendulum", "gym_pendulum", "inverted_pendulum", "biorob"])
def test_robot_that_stays_where_it_is_has_a_policy_of_some_width(name: str, tremor: float) -> None:
    """No narrower than the robot's starts are apart, so that it acts at all of them."""
    if "gym" in name or "inverted" in name:
        pytest.importorskip("gymnasium")
    task = still(name, 20, tremor)
    widths = policy_of(task).controller.network.lengthscales
    plain, angles = list(task.space.plain), list(task.space.angles)
    std = task.initial.std
    starts = torch.cat([std[plain], std[angles], std[angles]])
    assert widths.isfinite().all() and (widths >= starts * (1 - 1e-12)).all()


def test_biorob_that_shall_stay_is_explored_by_small_movements() -> None:
    small = still("biorob", 26).exploration
    shipped = load_experiment("biorob").exploration
    assert small.reach.rad2deg()[:3].tolist() == pytest.approx([6.0, 6.0, 6.0])
    assert shipped.reach.rad2deg()[:3].tolist() == pytest.approx([24.0, 34.0, 39.0])


@pytest.mark.parametrize("name", sorted(EXPERIMENTS.keys() - UNLIKE - {"double_pendulum_pilco"}))
def test_least_widths_change_nothing_of_shipped_demonstrations(
    name: str, generator: torch.Generator
) -> None:
    """They are the plain formulas, bit for bit."""
    task = load_experiment(name)
    inputs, draws = task.demonstrated_inputs, Draws(0)
    policy = task.policy_near(inputs, generator)
    assert torch.equal(policy.scale, task.widths(inputs.std(0)))
    count = task.method.policy.num_centres
    chosen = torch.randint(len(inputs), (count,), generator=draws.generator)
    jitter = draws.normal(count, inputs.shape[1])
    centres = (inputs[chosen] + 0.1 * inputs.std(0) * jitter) / policy.scale
    assert torch.equal(policy.centres.detach(), centres)


def test_least_widths_are_told(experiment: Task) -> None:
    own = experiment.method.policy.least_widths
    assert own is not None and experiment.settings["least_widths"] == own.tolist()
    of_start = experiment.with_settings(least_widths=None).settings["least_widths"]
    assert of_start == pytest.approx([0.1, 0.1, 0.05, 0.05, 0.05, 0.05])


def test_two_samples_are_refused_where_they_leave_one_step_to_explore() -> None:
    assert refused(still, "double_pendulum", 2) == (
        "demonstrations must have 3 samples at least, since the robot explores for as long and its "
        "model needs 2 transitions, got 2"
    )


@pytest.mark.usefixtures("quick")
@pytest.mark.parametrize(("name", "samples"), [("biorob", 2), ("double_pendulum", 3)])
def test_shortest_demonstrations_are_learned_from(name: str, samples: int, tmp_path: Path) -> None:
    """That is, a run comes to its end."""
    task = shortened(still(name, samples, 1e-3), samples - 1)
    result = train(task, 100, 1, tmp_path, "pmil train", progress_bar=False)
    assert len(result.trials) == 1 and (tmp_path / "policy.pt").exists()


def test_velocities_alone_leave_the_positions_to_them(experiment: Task) -> None:
    alone = experiment.with_settings(velocities_alone=True)
    both = experiment.with_settings(velocities_alone=False)
    assert both.make_dynamics().targets.learned == (0, 1, 2, 3)
    dynamics = alone.make_dynamics()
    known = dynamics.known_part(experiment.space)
    assert (dynamics.num_outputs, known.learned) == (2, (1, 3))
    assert alone.settings["velocities_alone"] is True
    states = torch.tensor([[1.0, 2.0, -1.0, 0.5]], dtype=torch.float64)
    after = known.successors(
        states, torch.zeros(1, 2).double(), torch.tensor([[0.4, -1.0]]).double()
    )
    assert_close(after, torch.tensor([[1.22, 2.4, -1.0, -0.5]], dtype=torch.float64))


def test_model_of_tied_lengthscales_is_a_setting(experiment: Task) -> None:
    for alone in (False, True):
        tied = experiment.with_settings(velocities_alone=alone, tied_lengthscales=True)
        assert tied.make_dynamics().tied_lengthscales and tied.settings["tied_lengthscales"]
    assert not experiment.make_dynamics().tied_lengthscales


def test_velocities_alone_needs_velocities(experiment: Task) -> None:
    space = replace(experiment.space, names=("a", "b", "c", "d"))
    with pytest.raises(ValueError, match="dNAME beside NAME, got a, b, c, d"):
        replace(experiment, space=space).with_settings(velocities_alone=True)


@pytest.mark.usefixtures("quick")
def test_run_learns_velocities_alone(tmp_path: Path) -> None:
    """The whole way, with its figures, diagnosis and files."""
    experiment = short_experiment(velocities_alone=True)
    result = train(experiment, 0, 2, tmp_path, "", progress_bar=False)
    assert result.dynamics.num_outputs == 2
    assert result.summary["settings"]["velocities_alone"] is True
    learned = load_learned(tmp_path, experiment)
    assert torch.equal(learned.dynamics.train_targets, result.dynamics.train_targets)
