"""A run's folder that a stranger made executes nothing, takes no long, and is refused in a line."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.helpers.bounded import measured
from tests.helpers.finished_run import SUMMARY, TRIAL
from tests.helpers.run_script import run_command
from torch_pmil.cli.resume import overrides
from torch_pmil.runs.report import write_report
from torch_pmil.runs.summaries import RunError, count_trials, read_summary


def run_of(folder: Path, **changes: object) -> Path:
    """A run whose summary and origin have other entries."""
    (folder / "summary.json").write_text(json.dumps(SUMMARY | changes))
    (folder / "run.json").write_text(json.dumps({"command": "pmil train"} | changes))
    (folder / "metrics.csv").write_text("trial\n1\n")
    return folder


@pytest.mark.parametrize("command", ["x" * 3_000_000, "pmil train seed='1", 5, None, ["pmil"]])
def test_command_that_no_shell_takes_is_refused_at_once(tmp_path: Path, command: object) -> None:
    folder = run_of(tmp_path, command=command)
    (load,) = measured([lambda: overrides(folder, [])], RunError)
    assert load.refusal is not None, load.failure
    assert load.refusal.startswith(f"{folder}: run.json is damaged: ")


def test_page_of_a_run_with_a_long_command_is_written_at_once(tmp_path: Path) -> None:
    folder = run_of(tmp_path, command="x" * 3_000_000)
    (load,) = measured([lambda: write_report(folder)], RunError)
    assert not load.failure and load.refusal is None


EVIL = "hydra.callbacks.evil._target_=os.mkdir"


@pytest.mark.parametrize(
    "word", [EVIL, f"+{EVIL}", "hydra/launcher=evil", "--config-dir=/tmp", "-m", "seed", "~seed"]
)
def test_resumed_command_has_no_settings_but_ours(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, word: str
) -> None:
    """Hydra calls what its own settings name, and its flags lead to other folders."""
    folder = run_of(tmp_path, command=f"pmil train seed=3 '{word}'")
    with pytest.raises(SystemExit) as stop:
        run_command(monkeypatch, "resume", folder)
    complaint = f"run.json is damaged: a setting must be NAME=VALUE, got '{word}'"
    assert stop.value.code == f"error: {folder}: {complaint}"


@pytest.mark.parametrize(
    "changes",
    [
        {"settings": [1]},
        {"saved_n_eval": "many"},
        {"versions": 5},
        {"saved_success_rate_by_target": [1, 2]},
        {"diagnosis": [5]},
        {"rms_error": {"x": 1.0}, "demonstration_spread": {}},
        {"trials": [TRIAL | {"gp_seconds": "long"}]},
    ],
    ids=lambda changes: next(iter(changes)),
)
def test_entry_of_another_type_is_damage(tmp_path: Path, changes: dict) -> None:
    with pytest.raises(RunError, match=r"summary\.json is damaged: ") as error:
        write_report(run_of(tmp_path, **changes))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("number", ["1" + 400 * "0", "1e300", "1e999", "Infinity", "NaN"])
@pytest.mark.parametrize("entry", ["experience_s", "wall_seconds", "seed"])
def test_number_beyond_all_bounds_is_damage(tmp_path: Path, entry: str, number: str) -> None:
    summary = run_of(tmp_path, **{entry: "NUMBER"}) / "summary.json"
    summary.write_text(summary.read_text().replace('"NUMBER"', number))
    with pytest.raises(RunError, match=r"summary\.json is damaged: ") as error:
        read_summary(tmp_path)
    assert len(str(error.value)) <= 1000
    if number == "1e999":
        assert "must be JSON, got 1e999, which is not finite" in str(error.value)


def test_rows_of_a_large_table_are_counted_at_once(tmp_path: Path) -> None:
    (tmp_path / "metrics.csv").write_text("trial\n" + "1\n" * 2_000_000)
    (load,) = measured([lambda: count_trials(tmp_path)], RunError)
    assert not load.failure and load.megabytes < 100
    assert count_trials(tmp_path) == 2_000_000
