"""Figures of many runs of several tasks: what they promise, and what they need."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from reproduction.plots.calibration import draw_success_calibration
from torch_pmil.plotting.calibration import draw_rates
from torch_pmil.plotting.style import BLUE, DARK, VERMILLION, WIDTH, check_some, style

COLOURS = (BLUE, VERMILLION)
Pairs = Sequence[tuple[float, float]]  # promised and measured rates


def plot_promises(
    forecasts: Mapping[str, Sequence[Sequence[float]]], claimed: Pairs, others: Pairs
) -> Figure:
    """Predicted success rates beside measured ones.

    The left panel shows trials, as predicted before their rollouts. The right one shows the lower
    bounds promised for the saved policies at the end of their runs; its axes begin below the
    smallest rate. A promise is kept on and above the dashed diagonal.

    Args:
        forecasts: "trials" and "bins" of
            :func:`~reproduction.plots.calibration.plot_success_calibration`.
        claimed: promised and measured rate of the runs that ended because they had learned.
        others: promised and measured rate of the other runs.

    Raises:
        ValueError: there is no trial, or no run.

    Example:
        >>> forecasts = {"trials": [(0.95, 0.9)], "bins": [(0.95, 0.9, 0.7, 1.0)]}
        >>> figure = plot_promises(forecasts, [(0.96, 1.0)], [(0.3, 0.5)])
        >>> [panel.get_xlabel() for panel in figure.axes]
        ['predicted before the rollout (%)', 'promised, as a lower bound (%)']
    """
    check_some("trials", forecasts["trials"])
    check_some("claimed and others", [*claimed, *others])
    figure = Figure(figsize=(WIDTH, 4.7), layout="constrained")
    left, right = figure.subplots(1, 2)
    draw_success_calibration(left, forecasts)
    draw_rates(right, 10 * min(int(10 * np.min([*claimed, *others])), 9))
    if claimed:
        _scatter(right, claimed, BLUE, "o", f"called itself learned ({len(claimed)})")
    if others:
        _scatter(right, others, VERMILLION, "x", f"out of trials ({len(others)})")
    left.set(xlabel="predicted before the rollout (%)", ylabel="measured (%)")
    right.set(xlabel="promised, as a lower bound (%)")
    for panel in (left, right):
        panel.legend(loc="lower left", bbox_to_anchor=(0, 1), frameon=False)
    return figure


def _scatter(panel: Axes, pairs: Pairs, colour: str, marker: str, label: str) -> None:
    x, y = 100 * np.transpose(pairs)
    panel.plot(x, y, marker, color=colour, alpha=0.5, mew=1.2, clip_on=False, label=label)


def plot_experience_by_task(
    experience_s: Mapping[str, Mapping[str, Sequence[float]]],
) -> Figure:
    """How much experience each run of each task took, with the median as a bar.

    Args:
        experience_s: seconds of each run by task, of one or two methods by label; the tasks of the
            first one are drawn.

    Raises:
        ValueError: there is no method, or its first one has no task.

    Example:
        >>> figure = plot_experience_by_task({"ours": {"biorob": [13.2, 15.0]}})
        >>> [tick.get_text() for tick in figure.axes[0].get_yticklabels()]
        ['biorob']
    """
    check_some("experience_s", experience_s)
    tasks = list(next(iter(experience_s.values())))
    check_some("tasks", tasks)
    figure = Figure(figsize=(WIDTH, 1.6 + 0.5 * len(tasks)), layout="constrained")
    panel, places = figure.subplots(), np.arange(len(tasks))
    lanes = (0.17, -0.17) if len(experience_s) > 1 else (0.0,)
    for (label, of_task), lane, colour in zip(experience_s.items(), lanes, COLOURS, strict=False):
        for place, task in zip(places[::-1], tasks, strict=True):
            values = of_task.get(task, ())
            panel.plot(values, np.full(len(values), place + lane), "o", color=colour, alpha=0.35)
            if len(values):
                panel.plot(np.median(values), place + lane, "|", color=DARK, markersize=15, mew=2)
        panel.plot([], [], "o", color=colour, label=label)
    panel.plot([], [], "|", color=DARK, markersize=12, mew=2, label="median")
    panel.set_yticks(places[::-1], [task.replace("_", " ") for task in tasks])
    panel.set(xlabel="experience (s)", ylim=(-0.6, len(tasks) - 0.4))
    panel.set_xlim(left=0)
    style(panel)
    figure.legend(loc="outside upper center", ncols=len(experience_s) + 1, frameon=False)
    return figure
