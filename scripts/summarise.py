"""Put the summaries of several runs of one experiment into one file, with their main numbers as ``headline``.

Example:
    python scripts/summarise.py results/double_pendulum/summary.json runs/double_pendulum/seed_*/summary.json
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from datetime import UTC, datetime
from pathlib import Path

from torch_pmil.files import write_json

SUCCESS_RATE = 0.95  # paper
EXPERIENCE_S = 33.0  # paper


def headline(runs: list[dict]) -> dict[str, float]:
    """Main numbers over runs; a run has learned if its saved policy reaches the success rate within the paper's experience.

    ``median_experience_s`` and ``max_experience_s`` count all rollouts, the two that confirm a success too.
    """
    experience = [run["experience_s"] for run in runs]
    return {
        "seeds": len(runs),
        "learned_within_33s": sum(learned(run) for run in runs),
        "median_experience_s": statistics.median(experience),
        "max_experience_s": max(experience),
        "mean_saved_success_rate": statistics.mean(run["saved_success_rate"] for run in runs),
        "median_wall_seconds": statistics.median(run["wall_seconds"] for run in runs),
        "max_wall_seconds": max(run["wall_seconds"] for run in runs),
        "two_sigma_coverage": statistics.mean(run["two_sigma_coverage"] for run in runs),
    }


def learned(run: dict) -> bool:
    """Whether the saved policy of a run reaches the paper's success rate within its experience."""
    return run["saved_success_rate"] >= SUCCESS_RATE and run["experience_s"] <= EXPERIENCE_S


def main() -> None:
    """Read, sort by seed, write."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("out", type=Path, help="file to write")
    parser.add_argument("runs", type=Path, nargs="+", help="summary.json of each run")
    arguments = parser.parse_args()
    try:
        runs = sorted((json.loads(path.read_text()) for path in arguments.runs), key=lambda run: run["seed"])
        names = sorted({run["experiment"] for run in runs})
        if len(names) > 1:
            raise ValueError(f"runs must be of one experiment, got {', '.join(names)}")
        merged = {
            "experiment": names[0],
            "command": f"make {arguments.out}",
            "date": datetime.now(UTC).isoformat(timespec="seconds"),
            "headline": headline(runs),
            "runs": runs,
        }
        arguments.out.parent.mkdir(parents=True, exist_ok=True)
        write_json(arguments.out, merged)
    except (OSError, ValueError, KeyError) as error:
        sys.exit(f"error: {error}")
    print("\n".join(f"{name}: {value:g}" for name, value in merged["headline"].items()))


if __name__ == "__main__":
    main()
