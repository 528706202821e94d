"""Combine several runs of one experiment: table, main numbers, learning curve.

Example:
    pmil summarize runs/double_pendulum --out results/tasks/double_pendulum
"""

from __future__ import annotations

import os
import shlex
import statistics
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path

from torch_pmil.cli import errors_in_one_line, parser_of
from torch_pmil.files import MIB, read_json, write_json
from torch_pmil.plotting import plot_success_over_experience, save_figure
from torch_pmil.runs import summaries
from torch_pmil.runs.run_folder import provenance
from torch_pmil.runs.summaries import COVERAGE, RunError

SUCCESS_RATE = 0.95  # paper
EXPERIENCE_S = 33.0  # paper
INTERVAL = "95 %, Wilson, over runs; runs that ended are carried forward with their saved policy"
MERGED_BYTES = 1024 * MIB  # of an earlier summary of many runs
IN_JSON = ("experience_s", "mean", "lower", "upper")  # the rates of each run are in its trials
HEADER = "experience (s)  trials  saved  success rate  computing (s)  ended because"


def headline(runs: list[dict]) -> dict[str, float]:
    """Main numbers over runs; the experience is that of all rollouts of the robot.

    Runs of a method that predicts nothing have no coverage.
    """
    experience = [run["experience_s"] for run in runs]
    coverage = [run[COVERAGE] for run in runs if COVERAGE in run]
    return {
        "seeds": len(runs),
        "learned_within_33s": sum(
            run["saved_success_rate"] >= SUCCESS_RATE and run["experience_s"] <= EXPERIENCE_S
            for run in runs
        ),
        "median_experience_s": statistics.median(experience),
        "max_experience_s": max(experience),
        "mean_saved_success_rate": statistics.mean(run["saved_success_rate"] for run in runs),
        "median_wall_seconds": statistics.median(run["wall_seconds"] for run in runs),
        "max_wall_seconds": max(run["wall_seconds"] for run in runs),
    } | ({COVERAGE: statistics.mean(coverage)} if coverage else {})


def summarize(folders: list[Path], out: Path | None, command: str) -> None:
    """Print the table; write ``summary.json`` and ``success_over_experience.png``.

    Raises:
        RunError: a folder is not a run, is damaged or of another experiment, or no run has ended.
        OSError: the results cannot be written.
    """
    paths = summaries.find_runs(folders)
    finished = {path: summaries.read_summary(path) for path in paths if summaries.is_finished(path)}
    finished = dict(sorted(finished.items(), key=lambda item: item[1]["seed"]))
    unfinished = {path: summaries.count_trials(path) for path in paths if path not in finished}
    print(table(finished, unfinished))
    runs = list(finished.values())
    if not runs:
        raise RunError(f"none of the runs has ended: {', '.join(map(str, paths))}")
    names = sorted({run["experiment"] for run in runs})
    if len(names) > 1:
        raise RunError(f"runs must be of one experiment, got {', '.join(names)}")
    curve = summaries.success_over_experience(runs)
    parents = [path.parent for path in paths]
    if any(parent.is_absolute() for parent in parents):
        parents = [parent.absolute() for parent in parents]
    out = out or Path(os.path.commonpath(parents))
    if out.resolve() in [path.resolve() for path in paths]:
        raise RunError(f"{out} is a run: the results would replace its summary.json")
    _check_ours(out)
    merged = {
        "experiment": names[0],
        **provenance(command),
        "headline": headline(runs),
        "success_over_experience": {"interval": INTERVAL}
        | {name: getattr(curve, name).tolist() for name in IN_JSON},
        "runs": runs,
    }
    out.mkdir(parents=True, exist_ok=True)
    write_json(out / "summary.json", merged)
    figure = plot_success_over_experience(curve.experience_s, curve.rates, curve.lower, curve.upper)
    save_figure(figure, out / "success_over_experience.png")
    print("\n".join(f"{name}: {value:g}" for name, value in merged["headline"].items()))
    print(f"see {out}/summary.json, {out}/success_over_experience.png")


def _check_ours(out: Path) -> None:
    """Raise RunError if the results would replace files that pmil summarize did not write."""
    names, earlier = ("summary.json", "success_over_experience.png"), None
    with suppress(OSError, ValueError):
        earlier = read_json(out / names[0], most=MERGED_BYTES)
    there = [out / name for name in names if os.path.lexists(out / name)]
    if there and not (isinstance(earlier, dict) and "success_over_experience" in earlier):
        raise RunError(
            f"{there[0]} was not written by pmil summarize: move it, or choose another --out"
        )


def table(finished: dict[Path, dict], unfinished: dict[Path, int]) -> str:
    """A line for each run; those that have not ended come last and are not counted in any mean."""
    width = max(len(str(path)) for path in (*finished, *unfinished))
    lines = [f"{'run':{width}}  {HEADER}"]
    for path, run in finished.items():
        lines.append(
            f"{path!s:{width}}  {run['experience_s']:14.1f}  {len(run['trials']):6d}  "
            f"{run['saved_trial']:5d}  {run['saved_success_rate']:12.0%}  "
            f"{run['wall_seconds']:13.0f}  {run['stop_reason']}"
        )
    lines += [
        f"{path!s:{width}}  {'':14}  {trials:6d}  not ended: left out"
        for path, trials in unfinished.items()
    ]
    return "\n".join(lines)


def main() -> None:
    """Read the command line, write."""
    parser = parser_of(__doc__)
    folder = partial(parser.add_argument, metavar="DIR", type=Path)
    folder("folders", nargs="+", help="a run, or a folder of runs")
    folder("--out", help="where to write (default: the folder that holds the runs)")
    arguments = parser.parse_args()
    command = shlex.join(["pmil", "summarize", *sys.argv[1:]])
    with errors_in_one_line(OSError, RunError):
        summarize(arguments.folders, arguments.out, command)
