"""Figures of a soak: promises beside what was measured, experience, and causes of failures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from reproduction.plots.counts import plot_counts
from reproduction.plots.many_runs import plot_experience_by_task, plot_promises
from reproduction.replayed_runs import ALL, drawn, tables
from reproduction.soak.comparison import Outcomes
from reproduction.soak.results import Row
from reproduction.soak.tasks import TASKS
from torch_pmil.plotting import Figure

OURS, THEIRS = "now", "before"
TITLES = {task.name: task.title for task in TASKS}


def figures_of(rows: Sequence[Row], theirs: Outcomes) -> dict[str, Figure]:
    """The figures by name.

    That of promises is left out if no run promises anything, that of causes if no trial failed.

    Args:
        rows: of all runs, see :func:`~reproduction.soak.results.row_of`.
        theirs: outcomes of other runs; those of the same tasks and seeds are drawn. May be empty.
    """
    ended = {(row["task"], row["seed"]): row for row in rows if row["ended"]}
    if not ended:
        return {}
    methods = {OURS: ended}
    if theirs:
        methods[THEIRS] = {key: theirs[key] for key in ended.keys() & theirs.keys()}
    experience = {label: _experience(outcomes) for label, outcomes in methods.items()}
    return {
        "experience": plot_experience_by_task(experience),
        **_promises(ended.values()),
        **_causes(ended.values()),
    }


def _experience(outcomes: Outcomes) -> dict[str, list[float]]:
    return {
        TITLES[name]: [row["experience_s"] for (task, _), row in outcomes.items() if task == name]
        for name in dict.fromkeys(task for task, _ in outcomes)
    }


def _promises(rows: Iterable[Row]) -> dict[str, Figure]:
    promising = [row for row in rows if row["promised_success_rate"] is not None]
    forecasts = [forecast for row in promising for forecast in row["forecasts"]]
    if not forecasts:
        return {}
    of_claim = {
        claimed: [
            (row["promised_success_rate"], row["measured_success_rate"])
            for row in promising
            if row["claimed"] == claimed
        ]
        for claimed in (True, False)
    }
    return {"promises": plot_promises(drawn(forecasts), of_claim[True], of_claim[False])}


def _causes(rows: Iterable[Row]) -> dict[str, Figure]:
    counted = tables([row["replayed"] for row in rows])["counts"]
    if not counted.pop(ALL)["totals"]["trials_failed"]:
        return {}
    causes = {task: found["causes"] for task, found in counted.items()}
    return {"causes": plot_counts(causes, "trials that fail from more than 5 % of the starts")}
