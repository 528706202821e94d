"""What a run leaves in its folder, without what the clock and the machine put there."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from torch import Tensor

from torch_pmil.trainer.checkpoints import read_checkpoint

TIMES = {"date", "commit", "wall_seconds", "cpu_seconds", "seconds", "gp_seconds", "search_seconds"}


def left_in(folder: Path) -> dict[str, Any]:
    """Whatever is in a folder: its name, and what it holds that every such run must hold.

    Of a page of HTML, which shows the time, nothing is compared.
    """
    return {
        str(path.relative_to(folder)): None if path.is_dir() else _content(path)
        for path in sorted(folder.rglob("*"))
    }


def differences(ours: dict[str, Any], expected: dict[str, Any]) -> list[str]:
    """Names that only one of two folders has, or that hold something else in them."""
    names = sorted(ours.keys() | expected.keys())
    return [name for name in names if ours.get(name, "no") != expected.get(name, "no")]


def _content(path: Path) -> Any:
    if path.suffix == ".torchrl":
        saved = read_checkpoint(path)
        return _timeless([saved.metadata, saved.states])
    if path.suffix == ".json":
        return _timeless(json.loads(path.read_text()))
    if path.suffix == ".html":
        return "a page" if path.stat().st_size else "nothing"
    if path.name == "metrics.csv":
        with path.open(newline="") as file:
            return _timeless(list(csv.DictReader(file)))
    if path.stem in TIMES:  # of the logger: step, seconds
        return [line.partition(",")[0] for line in path.read_text().splitlines()]
    return path.read_bytes()


def _timeless(value: Any) -> Any:
    if isinstance(value, Tensor):
        return value.dtype, value.shape, value.numpy().tobytes()
    if isinstance(value, dict):
        return {key: _timeless(entry) for key, entry in value.items() if key not in TIMES}
    if isinstance(value, (list, tuple)):
        return [_timeless(entry) for entry in value]
    return repr(value)  # in which NaN is NaN
