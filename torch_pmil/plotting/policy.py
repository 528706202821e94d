"""Figure of a policy's actions in planes of the state space."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
import torch
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from torch import Tensor

from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import with_unit
from torch_pmil.plotting.style import DARK, WIDTH, check_some

# white at the middle of the range, without the darkest colours, on which arrows fade
COLOURS = ListedColormap(mpl.colormaps["RdBu_r"](np.linspace(0.1, 0.9, 21)))
CELLS, ARROWS = 61, 13  # numbers on each axis
Successor = Callable[[Tensor], Tensor]


@dataclass(frozen=True)
class Plane:
    """A plane of the state space, and the action that is shown in it.

    Args:
        x, y: entries of the state that vary, such as a joint's position and velocity.
        action: index of its entry.
        span: ranges of x and y, ((low, high), (low, high)), in their units.
    """

    x: int
    y: int
    action: int
    span: tuple[tuple[float, float], tuple[float, float]]


@torch.no_grad()
def plot_policy(
    policy: StatePolicy,
    planes: Sequence[Plane],
    states: Tensor,
    titles: Sequence[str],
    successor: Successor | None = None,
) -> Figure:
    """A policy's action in planes of the state space as colour, and the robot's motion as arrows.

    There is a row for each plane and a column for each state. This state is marked, and gives the
    entries that do not vary.

    Args:
        policy: a policy without targets; :meth:`RBFPolicy.for_target` fixes those of another one.
        planes: the planes, one for each row.
        states: K states, such as those of a motion at some times, (K, D).
        titles: titles of the K columns.
        successor: maps states (N, D) to the states a control period later under this policy, (N,
            D), by a model or a simulator. An arrow shows the change in the plane; all arrows of a
            panel have one scale.

    Raises:
        ValueError: states and titles do not fit each other or the policy, or the robot does not
            have the entries of a plane.

    Example:
        >>> from torch_pmil.control.rbf_policy import RBFPolicy
        >>> from torch_pmil.control.state_space import StateSpace, joint_match
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> network = RBFPolicy(torch.zeros(5, 3), torch.ones(1), torch.ones(3))
        >>> policy = StatePolicy(network, space, control_period=0.1)
        >>> plane = Plane(0, 1, 0, ((-3, 3), (-8, 8)))
        >>> figure = plot_policy(policy, [plane], torch.zeros(1, 2), ["t = 0"])
        >>> figure.axes[0].get_xlabel(), figure.axes[0].get_ylabel()
        ('q (rad)', 'dq (rad/s)')
    """
    _check(policy, planes, states, titles)
    actions, labels = policy.actions, list(map(with_unit, policy.space.names, policy.space.units))
    figure = Figure(figsize=(WIDTH, 0.6 + 1.9 * len(planes)), layout="constrained")
    rows = figure.subplots(len(planes), len(states), sharex="row", sharey="row", squeeze=False)
    for row, plane in zip(rows, planes, strict=True):
        scale = Normalize(actions.low[plane.action].item(), actions.high[plane.action].item())
        for panel, state in zip(row, states.double(), strict=True):
            _draw_action(panel, policy, plane, state, scale)
            if successor is not None:
                _draw_flow(panel, successor, plane, state)
            at = state[plane.x], state[plane.y]
            panel.plot(*at, "o", markersize=7, color="white", markeredgecolor=DARK, zorder=4)
            panel.set_xlabel(labels[plane.x])
        row[0].set_ylabel(labels[plane.y])
        colours = ScalarMappable(scale, COLOURS)
        figure.colorbar(colours, ax=list(row), label=actions.labels[plane.action])
    for panel, title in zip(rows[0], titles, strict=True):
        panel.set_title(title, fontsize="medium")
    return figure


def _draw_action(
    panel: Axes, policy: StatePolicy, plane: Plane, state: Tensor, scale: Normalize
) -> None:
    x, y, states = _grid(plane, state, CELLS)
    action = policy(states)[..., plane.action].numpy()
    panel.pcolormesh(x, y, action, cmap=COLOURS, norm=scale, shading="nearest", rasterized=True)
    panel.set(xlim=plane.span[0], ylim=plane.span[1])


def _draw_flow(panel: Axes, successor: Successor, plane: Plane, state: Tensor) -> None:
    """Draw arrows of the change in a control period; the longest spans their distance."""
    x, y, states = _grid(plane, state, ARROWS)
    following = successor(states.flatten(0, 1)).view_as(states)
    change = (following - states)[..., [plane.x, plane.y]].numpy()
    widths = np.ptp(np.asarray(plane.span), axis=1)
    right, up = (change / widths).transpose(2, 0, 1)
    longest = np.hypot(right, up).max() or 1.0
    look: dict[str, Any] = {"color": DARK, "alpha": 0.85, "width": 0.007, "headwidth": 4}
    lengths: dict[str, Any] = {"scale_units": "width", "scale": ARROWS * longest}
    panel.quiver(x, y, right, up, angles="uv", pivot="mid", **lengths, **look)


def _grid(plane: Plane, state: Tensor, count: int) -> tuple[np.ndarray, np.ndarray, Tensor]:
    """Middles of count x count equal cells of the plane, and states (count, count, D) there.

    The first axis of the states is y.
    """
    x, y = (
        low + (high - low) * (torch.arange(count, dtype=torch.float64) + 0.5) / count
        for low, high in plane.span
    )
    states = state.repeat(count, count, 1)
    states[..., plane.x], states[..., plane.y] = x[None], y[:, None]
    return x.numpy(), y.numpy(), states


def _check(
    policy: StatePolicy, planes: Sequence[Plane], states: Tensor, titles: Sequence[str]
) -> None:
    D, F = policy.space.dim, len(policy.actions.names)
    if not len(titles) or states.shape != (len(titles), D):
        raise ValueError(
            f"states must be (K, {D}) with K titles, got {tuple(states.shape)} and {len(titles)} "
            "titles"
        )
    check_some("planes", planes)
    for plane in planes:
        if not (plane.x in range(D) and plane.y in range(D) and plane.action in range(F)):
            raise ValueError(
                f"planes must be of entries below {D} and actions below {F}, got {plane}"
            )
