"""Learn many runs of eight tasks unattended, and say how many ended and learned.

Example:
    python scripts/soak.py
    python scripts/soak.py --runs 240 --against results/soak/summary.json

The runs go seed by seed through the tasks, each in a process of its own, as many at once as there
are cores. What has ended is not learned again, and what was stopped goes on. A run that crashes,
hangs or fills the disk is counted, and stops no other; it is tried again by the next call.
"""

from __future__ import annotations

import argparse
import shlex
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

import joblib
from tqdm import tqdm

from reproduction.reproduction import ends_in_one_line, root_of_runs
from reproduction.soak.comparison import Outcomes, compared, outcomes_in
from reproduction.soak.figures import figures_of
from reproduction.soak.processes import Attempt, End, Job, Limits, attempt_all, has_ended
from reproduction.soak.results import Row, details_of, headline_of, row_of
from reproduction.soak.tasks import SoakRun, first_runs
from torch_pmil.files import write_json
from torch_pmil.plotting import save_figure
from torch_pmil.runs.run_folder import provenance
from torch_pmil.runs.summaries import read_summary


def main() -> None:
    """Learn, write, say what came of it; the exit code is 1 unless all runs ended."""
    options = options_of_command_line()
    command = shlex.join(["python", "scripts/soak.py", *sys.argv[1:]])
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    with ends_in_one_line(command):
        theirs = outcomes_in(options.against) if options.against else {}
        source = provenance(command)
        runs = first_runs(options.runs, options.first_seed, options.folder)
        learn(runs)
        rows = rows_of(runs)
        write(options.out, rows, theirs, source)
    report(options.out, rows)


def options_of_command_line() -> argparse.Namespace:
    """Read the command line, or end with what is wrong with it."""
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n")[0],
        epilog=__doc__.partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--runs", type=int, default=100, help="number of runs (100)")
    parser.add_argument("--first-seed", type=int, default=0, help="of each task (0)")
    parser.add_argument("--folder", type=Path, default=root_of_runs() / "soak", help="of the runs")
    parser.add_argument("--out", type=Path, default=Path("results/soak"), help="of the results")
    parser.add_argument(
        "--against",
        type=Path,
        metavar="PATH",
        help="folder of other runs, or their summary.json, with which those of the same task and "
        "seed are compared",
    )
    options = parser.parse_args()
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, got {options.runs}")
    return options


def learn(runs: Sequence[SoakRun]) -> None:
    """Try each run that has not ended once.

    Raises:
        OSError: there is too little space on the disk.
    """
    missing = [run.job for run in runs if not has_ended(run.folder)]
    with tqdm(total=len(missing), unit="run", disable=not missing) as bar:

        def report_attempt(job: Job, attempt: Attempt) -> None:
            tqdm.write(line_of(job, attempt))
            bar.update()

        attempt_all(missing, Limits(), joblib.cpu_count(), report_attempt)


def line_of(job: Job, attempt: Attempt) -> str:
    """What came of an attempt."""
    line = f"{job.folder}: {attempt.end} after {attempt.wall_seconds:.0f} s"
    if attempt.end != End.ENDED:
        return f"{line}: {attempt.said}"
    summary = read_summary(job.folder)
    return (
        f"{line}, {summary['experience_s']:.1f} s of experience, success rate "
        f"{summary['saved_success_rate']:.0%}, {summary['stop_reason']}"
    )


def rows_of(runs: Sequence[SoakRun]) -> list[Row]:
    """What came of each run, its saved policy measured anew; as many at once as there are cores."""
    return joblib.Parallel(n_jobs=joblib.cpu_count())(joblib.delayed(row_of)(run) for run in runs)


def write(out: Path, rows: Sequence[Row], theirs: Outcomes, source: dict[str, object]) -> None:
    """Write numbers and figures.

    Raises:
        OSError: they cannot be written.
    """
    out.mkdir(parents=True, exist_ok=True)
    ours = {(row["task"], row["seed"]): row for row in rows if row["ended"]}
    for name, figure in figures_of(rows, theirs).items():
        save_figure(figure, out / f"{name}.png")
    comparison = {"compared": compared(ours, theirs)} if theirs else {}
    summary = {"experiment": "soak", **source, "headline": headline_of(rows)}
    write_json(out / "summary.json", {**summary, **comparison, **details_of(rows)})


def report(out: Path, rows: Sequence[Row]) -> None:
    """Print the main numbers, and end with an error that names the runs that did not end."""
    for name, value in headline_of(rows).items():
        print(f"{name}: {'none' if value is None else f'{value:.4g}'}")
    print(f"see {out}/summary.json")
    missing = [row["folder"] for row in rows if not row["ended"]]
    if missing:
        sys.exit(f"error: {len(missing)} of {len(rows)} runs did not end: {', '.join(missing)}")


if __name__ == "__main__":
    main()
