"""The page on deployment gives the times of the benchmark."""

from __future__ import annotations

import json
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how_to" / "deploy.md").read_text()


def test_table_holds_the_benchmarks_numbers_and_no_median_reaches_a_millisecond() -> None:
    rows = json.loads(
        (ROOT / "results" / "benchmarks" / "policy_step" / "summary.json").read_text()
    )["rows"]
    for row in rows:
        numbers = [
            row[name]
            for name in ("cpu_us_min", "cpu_us_median", "wall_us_median", "wall_us_99_percent")
        ]
        assert f"| {row['form']} | {' | '.join(f'{number:.0f}' for number in numbers)} |" in PAGE
        assert row["cpu_us_median"] < 1000 and row["wall_us_median"] < 1000
