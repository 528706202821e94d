"""Robots on which nothing was tuned, learned with defaults alone: how many, and at what price.

The robots are those of :mod:`benchmarks.stranger_robots`, or of a file given by ``--robots`` that
has a dictionary ``STRANGERS``: by name, a gymnasium environment, the file of its recordings, and
what a person would say to :class:`~torch_pmil.PMIL`. A run that is finished, of the same sources,
is not made again.

Example:
    python -m benchmarks.strangers --seeds 100-102 --json strangers.json
    python -m benchmarks.strangers --robots ../shared/strangers/robots.py --seeds 110-112
"""

from __future__ import annotations

import argparse
import json
import resource
import shutil
import signal
import statistics
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

import torch

from benchmarks.absolute import with_fixed_criteria, with_limits
from benchmarks.command_line import add_json, row_of_own_process, source_of, write_summary
from benchmarks.stranger_robots import STRANGERS
from reproduction.reproduction import root_of_runs
from torch_pmil import PMIL
from torch_pmil.control.recovered_states import rates_of
from torch_pmil.files import write_json
from torch_pmil.runs.summaries import count_trials
from torch_pmil.tasks.registry import module_of
from torch_pmil.tasks.task import Task
from torch_pmil.trainer.ending import LIMIT

OUT, JOBS, LEARNED = root_of_runs() / "strangers", 2, 0.95
OUT_OF_TIME = "out of time"
Made = Callable[[], tuple[Any, Any, dict[str, Any]]]  # robot, recordings, and what is said
ROW = "{robot:>14} {seed:>5} {success:>8.0%} {experience_s:>9.4g} {trials:>7} {cpu_s:>6.0f}  {end}"
Said = dict[str, Any]
FURTHER: dict[str, Callable[[Said], Said]] = {  # what is said besides
    "own step": lambda said: {"step": said["control_period"]},
    "no past": lambda said: {"past": None},
    "samples": lambda said: {"search.sample_steps": 500},
}
CHANGES: dict[str, Callable[[Task], Task]] = {
    "limits": with_limits,
    "fixed criteria": with_fixed_criteria,
    "velocities": lambda task: (
        task.with_settings(velocities_alone=True) if rates_of(task.space.names) else task
    ),
}
VARIATIONS = (*FURTHER, *CHANGES)


def main() -> None:
    """Read the command line, learn, and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--robots", type=Path, help="file with other robots")
    parser.add_argument("--names", default="", help="of the robots, by commas; all by default")
    parser.add_argument("--seeds", default="100", help="of the runs, FIRST-LAST")
    parser.add_argument(
        "--variations",
        default="",
        help=f"by commas, of {', '.join(VARIATIONS)}; none by default",
    )
    parser.add_argument("--patience", type=int, help="CPU seconds after which a run is stopped")
    parser.add_argument("--alone", action="store_true", help=argparse.SUPPRESS)
    add_json(parser, "own_strangers")
    arguments = parser.parse_args()
    known = robots(arguments.robots)
    names = arguments.names.split(",") if arguments.names else list(known)
    first, _, last = arguments.seeds.partition("-")
    seeds = range(int(first), int(last or first) + 1)
    variations = arguments.variations.split(",")
    if unknown := set(variations) - {"", *VARIATIONS}:
        parser.error(f"--variations must be of {', '.join(VARIATIONS)}, got {', '.join(unknown)}")
    if arguments.alone:
        torch.set_num_threads(1)
        if arguments.patience:
            _stop_after(arguments.patience)
        print(json.dumps(learned(names[0], known[names[0]], seeds[0], variations[0])))
        return
    source = source_of("strangers")
    runs = [(each, name, seed) for each in variations for seed in seeds for name in names]
    with ThreadPoolExecutor(JOBS) as pool:
        alone = partial(_in_own_process, arguments.robots, arguments.patience)
        rows = list(pool.map(alone, *zip(*runs, strict=True)))
    of_each = {each: [row for row in rows if row["variation"] == each] for each in variations}
    headlines = {each: headline(found) for each, found in of_each.items()}
    write_summary(
        arguments.json,
        {
            "experiment": "strangers",
            **source,
            "headline": headlines[""] if variations == [""] else headlines,
            "rows": rows,
        },
    )
    for each, found in of_each.items():
        print(f"\n{each}", table(found), sep="\n")


def robots(path: Path | None) -> dict[str, Made]:
    """The robots of a file, or those of this package's benchmark, by name."""
    if path is None:
        return {
            name: lambda each=each: (  # type: ignore[misc]
                each.robot(),
                each.recordings(),
                {"control_period": each.dt, "state": each.state, **each.said},
            )
            for name, each in STRANGERS.items()
        }
    return {
        name: lambda each=each: (each[0](), path.parent / each[1], each[2])  # type: ignore[misc]
        for name, each in module_of(str(path)).STRANGERS.items()
    }


def learned(name: str, make: Made, seed: int, variation: str = "") -> dict[str, Any]:
    """Learn one robot, and return what came of it."""
    begun, (robot, recordings, said) = time.process_time(), make()
    further = FURTHER[variation](said) if variation in FURTHER else {}
    learner = PMIL(robot, recordings, **{**said, **further})
    if variation in CHANGES:
        learner.task = CHANGES[variation](learner.task)
    out = OUT / _label(name, variation) / f"seed_{seed}"
    shutil.rmtree(out, ignore_errors=True)  # its CPU seconds are those of one process
    end = None
    try:
        learner.learn(seed=seed, out=out)
    except OutOfTime:
        end = OUT_OF_TIME
        learner.learn(trials=count_trials(out), seed=seed, out=out, resume=True)
    cpu_s, summary = time.process_time() - begun, learner.result.summary
    return {
        "robot": name,
        "seed": seed,
        "variation": variation,
        "success": learner.evaluate(),
        "experience_s": summary["experience_s"],
        "trials": len(summary["trials"]),
        "step_s": learner.policy.control_period,
        "past": learner.task.history.past_actions if learner.task.history else 0,
        "end": end or summary["stop_reason"],
        "diagnosis": [reason["cause"] for reason in summary["diagnosis"]],
        "cpu_s": round(cpu_s, 1),
    }


class OutOfTime(BaseException):
    """A run has used the CPU seconds that it was given."""


def _stop_after(cpu_seconds: int) -> None:
    """Raise OutOfTime in this process after these CPU seconds, once."""

    def stop(*_: object) -> None:
        resource.setrlimit(resource.RLIMIT_CPU, (resource.RLIM_INFINITY,) * 2)
        raise OutOfTime

    signal.signal(signal.SIGXCPU, stop)
    resource.setrlimit(resource.RLIMIT_CPU, (cpu_seconds, resource.RLIM_INFINITY))


def _in_own_process(
    path: Path | None, patience: int | None, variation: str, name: str, seed: int
) -> dict[str, Any]:
    """The row of a run in a process of its own, unless there is one."""
    file = f"{_label(name, variation)}_{patience}_{seed}.json"
    kept = OUT / "rows" / (path.stem if path else "own") / file
    if kept.exists():
        row: dict[str, Any] = json.loads(kept.read_text())
        return row
    given = ["--robots", str(path)] if path else []
    given += ["--patience", str(patience)] if patience else []
    words = ["--alone", *given, "--names", name, "--seeds", str(seed), "--variations", variation]
    row = row_of_own_process("strangers", *words)
    kept.parent.mkdir(parents=True, exist_ok=True)
    write_json(kept, row)
    print(ROW.format(**row), file=sys.stderr, flush=True)
    return row


def _label(name: str, variation: str) -> str:
    return "_".join([name, *variation.replace(",", "").split()])


def headline(rows: list[dict[str, Any]]) -> dict[str, float]:
    """The numbers of all runs that count."""
    return {
        "runs": len(rows),
        "at_95": sum(row["success"] >= LEARNED for row in rows),
        "ended": sum(row["end"] not in (LIMIT, OUT_OF_TIME) for row in rows),
        "median_experience_s": statistics.median(row["experience_s"] for row in rows),
        "max_cpu_seconds": max(row["cpu_s"] for row in rows),
    }


def table(rows: list[Mapping[str, Any]]) -> str:
    """A line for each run, and the headline."""
    head = (
        f"{'robot':>14} {'seed':>5} {'success':>8} {'robot, s':>9} {'trials':>7} {'CPU, s':>6}  end"
    )
    last = ", ".join(f"{name} {value:g}" for name, value in headline([*map(dict, rows)]).items())
    return "\n".join([head, *(ROW.format(**row) for row in rows), last])


if __name__ == "__main__":
    main()
