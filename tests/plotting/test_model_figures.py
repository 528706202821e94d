"""The figures that take a run apart: the model, its calibration, the KL and the policy."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from matplotlib.axes import Axes
from torch import Tensor

from tests.helpers.draws import Draws
from tests.helpers.figures import assert_edge
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.plotting import (
    Plane,
    plot_calibration,
    plot_gp_slices,
    plot_kl_per_step,
    plot_policy,
    save_figure,
)
from torch_pmil.search.kl import gaussian_kl, gaussian_kl_terms

NAMES, UNITS = ("q", "dq"), ("rad", "rad/s")
INPUTS = ("dq (rad/s)", "sin q", "cos q", "u (N·m)")
PLANE = Plane(0, 1, 0, ((-3.0, 3.0), (-8.0, 4.0)))


def model_of(draws: Draws, targets: str = "difference") -> GPDynamics:
    model = GPDynamics(4, 2, targets)
    model.set_data(draws.normal(12, 4), draws.normal(12, 2))
    return model


def policy_of(draws: Draws) -> StatePolicy:
    middle, half = torch.tensor([0.0, 1.0]), torch.tensor([2.0, 3.0])
    network = RBFPolicy(draws.normal(5, 3), half, torch.ones(3), middle)
    network.weights.data.copy_(draws.normal(5, 2))
    actions = ActionSpace.around(middle, half, ("tau", "angle"), ("N·m", "rad"))
    space = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))
    return StatePolicy(network, space, 0.1, actions=actions)


def panels_of(
    draws: Draws, model: GPDynamics, over: list[int] | None = None
) -> tuple[list[Axes], Tensor]:
    point = draws.normal(4)
    return plot_gp_slices(model, point, INPUTS, NAMES, UNITS, over).axes, point


def test_slices_have_a_row_for_each_output_and_a_column_for_each_chosen_input(draws: Draws) -> None:
    model = model_of(draws)
    assert len(panels_of(draws, model)[0]) == 2 * 4
    panels, _ = panels_of(draws, model, [3, 0])
    assert [panel.get_xlabel() for panel in panels] == ["", "", "u (N·m)", "dq (rad/s)"]
    labels = ["change of\nq (rad)", "", "change of\ndq (rad/s)", ""]
    assert [panel.get_ylabel() for panel in panels] == labels
    assert panels_of(draws, model_of(draws, "successor"))[0][0].get_ylabel() == "next\nq (rad)"


def test_slice_is_the_models_mean_and_two_standard_deviations_of_the_next_observation(
    draws: Draws,
) -> None:
    model = model_of(draws)
    panels, point = panels_of(draws, model, [1, 2])
    x, y = next(line for line in panels[3].lines if line.get_label() == "mean").get_xydata().T
    inputs = point.repeat(len(x), 1)
    inputs[:, 2] = torch.tensor(x)
    mean, variance = model.expansion.predict(inputs)
    np.testing.assert_allclose(y, mean[:, 1], atol=1e-12)
    upper = mean[:, 1] + 2 * (variance[:, 1] + model.expansion.noise_variance[1]).sqrt()
    assert_edge(panels[3].collections[0], x, upper)


def test_data_stand_off_the_slice_by_their_residual_and_are_as_opaque_as_correlated(
    draws: Draws,
) -> None:
    model = model_of(draws)
    panels, point = panels_of(draws, model, [3])
    (dots,) = (drawn for drawn in panels[1].collections if drawn.get_label().startswith("data"))
    on_slice = point.repeat(12, 1)
    on_slice[:, 3] = model.train_inputs[:, 3]
    expansion, inputs = model.expansion, model.train_inputs
    means = expansion.mean(on_slice)[:, 1] - expansion.mean(inputs)[:, 1]
    expected = np.stack([inputs[:, 3], model.train_targets[:, 1] + means], -1)
    np.testing.assert_allclose(dots.get_offsets(), expected, atol=1e-12)
    correlation = expansion.kernel(on_slice)  # of each datum with all; with itself on the diagonal
    own = torch.stack([correlation[i, 1, i] for i in range(12)]) / expansion.signal_variance[1]
    np.testing.assert_allclose(dots.get_alpha(), own, atol=1e-12)


def test_calibration_is_the_coverage_in_percent_and_the_size_of_errors_at_each_time(
    draws: Draws,
) -> None:
    residuals = draws.normal(50, 8, 2) * torch.tensor([1.0, 4.0]).double()
    coverage, course = plot_calibration(NAMES, 0.1, residuals).axes
    lines = {line.get_label(): line.get_xydata() for line in coverage.lines}
    for entry, name in enumerate(NAMES):
        inside = (residuals[..., entry].abs() < 0.67449).double().mean().item()
        assert lines[name][25] == pytest.approx([50, 100 * inside])
    drawn = [line for line in course.lines if len(line.get_xdata()) == 8]
    np.testing.assert_allclose([line.get_xdata() for line in drawn], 2 * [0.1 * np.arange(1, 9)])
    sizes = residuals.square().mean(0).sqrt().T
    np.testing.assert_allclose([line.get_ydata() for line in drawn], sizes)
    assert len({(line.get_color(), line.get_marker()) for line in drawn}) == 2


def test_errors_of_many_standard_deviations_stay_readable(draws: Draws, tmp_path: Path) -> None:
    figure = plot_calibration(NAMES, 0.1, 100 * draws.normal(5, 8, 2))
    assert figure.axes[1].get_yscale() == "symlog"
    save_figure(figure, tmp_path / "calibration.png")


def stacks_of(panel: Axes) -> np.ndarray:
    """Bottoms and heights of the bars, (parts, T, 2)."""
    return np.array(
        [[(bar.get_y(), bar.get_height()) for bar in container] for container in panel.containers]
    )


def test_kl_is_stacked_by_its_terms_at_each_step_up_to_the_kl(draws: Draws) -> None:
    demonstrated, predicted = draws.belief(7, 3), draws.belief(7, 3)
    upper, lower = plot_kl_per_step(("x", "y", "z"), 0.1, demonstrated, predicted).axes
    terms = gaussian_kl_terms(demonstrated, predicted)
    expected = {
        upper: torch.stack([terms.mean.sum(-1), terms.spread.sum(-1)]),
        lower: (terms.mean + terms.spread).mT,
    }
    for panel, heights in expected.items():
        stacks = stacks_of(panel)
        np.testing.assert_allclose(stacks[..., 1], heights, atol=1e-12)
        np.testing.assert_allclose(stacks[1:, :, 0], heights.cumsum(0)[:-1], atol=1e-12)
        whole = gaussian_kl(demonstrated, predicted)
        np.testing.assert_allclose(stacks[-1].sum(-1), whole, atol=1e-10)
    assert [container.get_label() for container in lower.containers] == ["x", "y", "z"]
    centres = [bar.get_x() + bar.get_width() / 2 for bar in lower.containers[0]]
    np.testing.assert_allclose(centres, 0.1 * np.arange(1, 8))
    total = gaussian_kl(demonstrated, predicted).sum().item()
    assert upper.get_title(loc="left") == f"KL of the trajectory: {total:.1f} nats"


def test_more_entries_than_colours_are_told_apart_by_hatches(draws: Draws) -> None:
    belief = draws.belief(3, 8)
    lower = plot_kl_per_step("abcdefgh", 0.1, belief, draws.belief(3, 8)).axes[1]
    looks = {(bars[0].get_facecolor(), bars[0].get_hatch()) for bars in lower.containers}
    assert len(looks) == 8


def test_colour_is_the_action_at_the_state_on_the_scale_of_its_range(draws: Draws) -> None:
    policy, states = policy_of(draws), draws.normal(2, 2)
    figure = plot_policy(policy, [PLANE, Plane(1, 0, 1, ((-8, 8), (-3, 3)))], states, ["a", "b"])
    panels = figure.axes[:4]
    mesh = panels[2].collections[0]
    actions = mesh.get_array()
    x, y = -8 + 16 * (10 + 0.5) / 61, -3 + 6 * (50 + 0.5) / 61
    assert actions[50, 10] == pytest.approx(policy(torch.tensor([y, x]).double())[1].item())
    assert (mesh.norm.vmin, mesh.norm.vmax) == (-2, 4)
    assert [panel.get_title() for panel in panels] == ["a", "b", "", ""]
    assert (panels[2].get_xlabel(), panels[2].get_ylabel()) == ("dq (rad/s)", "q (rad)")
    marked = next(line for line in panels[1].lines).get_xydata()
    np.testing.assert_allclose(marked[0], states[1])
    labels = [axes.get_ylabel() for axes in figure.axes[4:]]
    assert labels == ["action tau (N·m)", "action angle (rad)"]


def test_arrows_point_to_where_the_robot_is_next(draws: Draws) -> None:
    def turned(states: Tensor) -> Tensor:
        return states + torch.tensor([0.3, -1.2]).double()

    figure = plot_policy(policy_of(draws), [PLANE], draws.normal(1, 2), ["a"], turned)
    (arrows,) = (drawn for drawn in figure.axes[0].collections if hasattr(drawn, "U"))
    np.testing.assert_allclose(arrows.U, 0.3 / 6)
    np.testing.assert_allclose(arrows.V, -1.2 / 12)


def test_robot_at_rest_everywhere_has_arrows_without_length(draws: Draws, tmp_path: Path) -> None:
    state = draws.normal(1, 2)
    figure = plot_policy(policy_of(draws), [PLANE], state, ["a"], lambda states: states)
    save_figure(figure, tmp_path / "rest.png")


def test_beliefs_of_a_search_are_drawn_without_their_graph(draws: Draws) -> None:
    belief = draws.belief(4, 2)
    plot_kl_per_step(NAMES, 0.1, belief, Gaussian(belief.mean.requires_grad_(), belief.cov))
