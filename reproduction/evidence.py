"""Make anew each summary.json in results/ that other sources made, one command after the other.

Example:
    make evidence
    make evidence ARGS=--list

prints which results are of other sources (a hash of the package's code, see ``sources`` in each
summary) and runs the commands that make them, on all cores. What was learned with the present
sources is not learned again, and what was stopped goes on, so a second call does nothing. A command
that fails is named in the end, and stops no other. ``--list`` runs none. Times of a
GPU are taken only where there is one.
"""

from __future__ import annotations

import argparse
import shlex
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path

import torch

from reproduction import PAPER, shipped_tasks
from reproduction.reproduction import ends_in_one_line
from torch_pmil.files import read_json
from torch_pmil.runs.sources import hash_of_sources

BENCHMARKS = (  # timings first
    "prediction",
    "breakdown",
    "gp_fit --sizes 100 200 300",
    "kernels",
    "dimensions",
    "targets",
    "tied",
    "sparse",
    "torchrl_model",
    "policy_step",
    "run",
    "samples",
    "past_evidence",
    "quiet_motions",
    "front_door",
    "failures",
)
OF_A_GPU = "benchmarks/device"
STRANGERS = "python -m benchmarks.strangers"
THEIRS = "--robots ../shared/strangers/robots.py --seeds 110-112"
CHANGES = "',no past,fixed criteria,limits,own step'"
COMMANDS: dict[str, str] = {  # by the folder of the result, in order
    **{f"benchmarks/{words.split()[0]}": f"python -m benchmarks.{words}" for words in BENCHMARKS},
    OF_A_GPU: "python -m benchmarks.device",
    **{f"tasks/{name}": shipped_tasks.COMMAND for name in shipped_tasks.SEEDS},
    **{f"paper/{name}": f"python scripts/reproduce.py {name}" for name in PAPER},
    "soak": "python scripts/soak.py --runs 240",
    # strangers and failures also depend on tasks/sampling_choice.py, which the hash leaves out
    "benchmarks/own_strangers": STRANGERS,
    "benchmarks/strangers": f"{STRANGERS} {THEIRS} "
    "--json results/benchmarks/strangers/summary.json",
    "benchmarks/ablation": f"{STRANGERS} {THEIRS} --variations {CHANGES} --patience 250 "
    "--json results/benchmarks/ablation/summary.json",
    # reads the runs of all others
    "benchmarks/diagnosis": "python -m benchmarks.diagnosis",
}


def sources_of(name: str, results: Path) -> str:
    """By which sources a result was made: their hash, or why it has none."""
    path = results / name / "summary.json"
    if not path.exists():
        return "missing"
    return str(read_json(path).get("sources", "unknown"))


def old_results(results: Path) -> dict[str, str]:
    """The results that the present sources did not make, in order, with what made them."""
    names = [name for name in COMMANDS if name != OF_A_GPU or torch.cuda.is_available()]
    made = {name: sources_of(name, results) for name in names}
    return {name: sources for name, sources in made.items() if sources != hash_of_sources()}


def run(command: str) -> bool:
    """Run a command of the repository, and say whether it ended well."""
    first, *words = shlex.split(command)
    program = sys.executable if first == "python" else first
    return subprocess.run([program, *words], check=False).returncode == 0


def run_all(old: Mapping[str, str]) -> list[str]:
    """Run what makes these results, each command once; return those that failed."""
    failed = []
    for command in dict.fromkeys(COMMANDS[name] for name in old):
        begun = time.monotonic()
        ended = "ended" if run(command) else "failed"
        print(f"{ended} after {(time.monotonic() - begun) / 60:.0f} min: {command}", flush=True)
        failed += [command] if ended == "failed" else []
    return failed


def main() -> None:
    """Print what is old, make it anew; the exit code is 1 if a command failed."""
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n")[0],
        epilog=__doc__.partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--list", action="store_true", help="say what is old, and run nothing")
    arguments, old = parser.parse_args(), old_results(Path("results"))
    for name, sources in old.items():
        print(f"{name:32} {sources:12}  {COMMANDS[name]}")
    print(
        f"{len(old)} of {len(COMMANDS)} results are not of the sources {hash_of_sources()}",
        flush=True,
    )
    if arguments.list:
        return
    with ends_in_one_line("make evidence"):
        failed = run_all(old)
    if failed:
        sys.exit(f"error: {len(failed)} commands failed: {'; '.join(failed)}")


if __name__ == "__main__":
    main()
