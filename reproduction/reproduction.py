"""Experiments of the paper: their parts, and how they run in parallel and go on after a stop."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import joblib
import torch
from tqdm import tqdm

from torch_pmil.files import in_words, read_json, write_json
from torch_pmil.plotting import Figure, save_figure
from torch_pmil.runs.run_folder import provenance
from torch_pmil.runs.sources import hash_of_sources
from torch_pmil.runs.summaries import RunError, is_finished
from torch_pmil.runs.training import train
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.ending import LIMIT
from torch_pmil.trainer.trials import Measurement

# entries of each run's summary that results repeat
OF_RUN = (
    "experiment",
    "seed",
    "command",
    "date",
    "commit",
    "sources",
    "experience_s",
    "wall_seconds",
)


@dataclass(frozen=True)
class Run:
    """One run that an experiment needs.

    Args:
        out: its folder; it is finished when there is a ``summary.json``.
        learn: called with the folder and a command to say in the summary, perhaps in another
            process. It goes on from where it was stopped, and writes ``summary.json`` last.
        trials: largest number of trials, if there is one; a run that ended at a smaller one goes
            on.
    """

    out: Path
    learn: Callable[[Path, str], object]
    trials: int = 0

    @property
    def finished(self) -> bool:
        """Whether nothing is left to learn."""
        if not is_finished(self.out):
            return False
        summary = read_json(self.out / "summary.json")
        at_limit = summary.get("stop_reason") == LIMIT
        return not (at_limit and len(summary.get("trials", ())) < self.trials)


@dataclass(frozen=True)
class Results:
    """Numbers and figures of an experiment.

    Args:
        headline: main numbers, flat; None for what never came about.
        figures: by name.
        details: other numbers for the summary, as JSON can say them.
    """

    headline: Mapping[str, float | None]
    figures: dict[str, Figure]
    details: Mapping[str, object] = field(default_factory=dict)


@dataclass(frozen=True)
class PaperExperiment:
    """An experiment of the paper.

    Args:
        name: as on the command line.
        shows: what, in one line.
        runs: what must be learned, below a folder of runs; smaller ones if quick.
        results: makes numbers and figures from the folders of those runs, in that order; from
            fewer samples if quick.

    Example:
        >>> from torch_pmil.tasks.registry import load_experiment
        >>> from torch_pmil.runs.summaries import read_summary
        >>> def runs(root: Path, quick: bool) -> list[Run]:
        ...     experiment, trials = load_experiment("double_pendulum"), 3 if quick else 12
        ...     return [learning_run(root, experiment, seed, trials) for seed in range(2)]
        >>> def results(folders: Sequence[Path], quick: bool) -> Results:
        ...     rates = [read_summary(folder)["saved_success_rate"] for folder in folders]
        ...     return Results({"mean_success_rate": sum(rates) / len(rates)}, figures={})
        >>> PaperExperiment("two_seeds", "success of two runs", runs, results).name
        'two_seeds'
    """

    name: str
    shows: str
    runs: Callable[[Path, bool], Sequence[Run]]
    results: Callable[[Sequence[Path], bool], Results]


@contextmanager
def ends_in_one_line(command: str) -> Iterator[None]:
    """End the process with one line where what it does fails, or is interrupted (code 130)."""
    try:
        yield
    except KeyboardInterrupt:
        print(f"\nstopped; go on with: {command}", file=sys.stderr)
        sys.exit(130)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        sys.exit(f"error: {in_words(error)}")


def root_of_runs() -> Path:
    """Folder of the runs with the present sources, which those of others never enter."""
    return Path("runs", hash_of_sources())


def learning_run(root: Path, experiment: Task, seed: int, trials: int = 12) -> Run:
    """A run of an experiment, in its folder below ``root``.

    Args:
        root: folder of runs.
        experiment: what to learn; those that differ have names that differ.
        seed: of the run.
        trials: largest number of trials.

    Example:
        >>> from torch_pmil.tasks.registry import load_experiment
        >>> str(learning_run(Path("runs"), load_experiment("double_pendulum"), seed=3).out)
        'runs/double_pendulum/seed_3'
    """
    learn = partial(_learn, experiment=experiment, seed=seed, trials=trials)
    return Run(root / experiment.name / f"seed_{seed}", learn, trials)


def reproduce(experiment: PaperExperiment, quick: bool, command: str) -> tuple[Path, Results]:
    """Learn what is not learned yet, then write numbers and figures to results/paper/NAME.

    Runs of other sources do not count. A quick reproduction has runs and results of its own, in
    ``quick`` below the folder of the runs, and in ``results/quick``.

    Args:
        experiment: which one.
        quick: whether minutes must do.
        command: said in the summary.

    Returns:
        The folder of the results, and what they are.

    Raises:
        RunError: runs failed, or their folders do not hold what a run leaves.
        OSError: the results cannot be written.
    """
    source = provenance(command)
    root = root_of_runs()
    runs = experiment.runs(root / "quick" if quick else root, quick)
    finish(runs, command)
    results = experiment.results([run.out for run in runs], quick)
    out = Path("results", "quick" if quick else "paper", experiment.name)
    out.mkdir(parents=True, exist_ok=True)
    for name, figure in results.figures.items():
        save_figure(figure, out / f"{name}.png")
    summary = {
        "experiment": experiment.name,
        **source,
        "quick": quick,
        "headline": results.headline,
        **results.details,
    }
    write_json(out / "summary.json", {**summary, "runs": [_origin(run.out) for run in runs]})
    return out, results


def finish(runs: Sequence[Run], command: str) -> None:
    """Learn those runs that are not finished, as many at once as there are cores.

    Each goes on from where it was stopped.

    Args:
        runs: some may be finished.
        command: said in their summaries.

    Raises:
        RunError: some failed, after the others were given their time; the message names each.
    """
    missing = [run for run in runs if not run.finished]
    if not missing:
        return
    jobs = min(joblib.cpu_count(), len(missing))
    attempts = (joblib.delayed(_attempt)(run, command) for run in missing)
    ended = joblib.Parallel(n_jobs=jobs, return_as="generator_unordered")(attempts)
    complaints = list(filter(None, tqdm(ended, total=len(missing), unit="run")))
    if complaints:
        raise RunError("; ".join(sorted(complaints)))


def _attempt(run: Run, command: str) -> str | None:
    """Learn a run; return what went wrong, or None."""
    logging.getLogger("torchrl").setLevel(logging.WARNING)
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    try:
        run.learn(run.out, command)
    except (ImportError, OSError, RuntimeError, ValueError) as error:
        return f"{run.out}: {in_words(error)}"
    return None


def _learn(out: Path, command: str, experiment: Task, seed: int, trials: int) -> None:
    told = partial(tell_trial, out)
    train(experiment, seed, trials, out, command, progress_bar=False, on_trial=told, resume=True)


def tell_trial(out: Path, trial: Measurement) -> None:
    """Say how a trial of a run went, above the progress bar of all runs."""
    tqdm.write(
        f"{out}: trial {trial.trial}, {trial.experience_s:.1f} s of experience, success rate "
        f"{trial.success_rate:.0%}"
    )


def _origin(folder: Path) -> dict[str, object]:
    """The folder of a run and the entries of its summary that results repeat."""
    summary = read_json(folder / "summary.json")
    return {"folder": str(folder), **{key: summary[key] for key in OF_RUN if key in summary}}
