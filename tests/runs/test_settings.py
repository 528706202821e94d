"""All settings of a task and its method: each is documented, set, checked, written and read."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from tests.helpers.bounded import measured
from torch_pmil.runs.run_folder import write_settings
from torch_pmil.runs.settings import (
    OF_TASK,
    SETTINGS,
    SettingsError,
    documentation_rows,
    read_settings,
    with_file,
    word_of,
)
from torch_pmil.tasks.registry import EXPERIMENTS, load_experiment
from torch_pmil.tasks.task import Task

TASKS = (
    "double_pendulum",
    "biorob",
    "double_pendulum_pilco",
    "double_pendulum_servo",
    "double_pendulum_targets",
)
NO_NUMBERS = ("x", [1.0], {"a": 1.0}, None, math.nan, math.inf, 10**400, True)
OTHERS = {
    "bool": ("yes", 1, None),
    "int": (1.0, *NO_NUMBERS[:-2], True),  # of which some are large
    "float": NO_NUMBERS,
}
NO_TENSORS = ([], "x", ["x"], [[1.0, 2.0]], [math.nan] * 4, [-1e400] * 6, 10**400, True)


@cache
def task(name: str) -> Task:
    return load_experiment(name)


def task_with(setting: str) -> Task:
    """The first task that has a setting."""
    names = TASKS if setting != "explore_demonstrated" else ("double_pendulum_servo",)
    return next(task(name) for name in names if setting in task(name).adjustable)


def other(value: object) -> object:
    """Another value of that type."""
    if isinstance(value, list):
        return [other(entry) for entry in value]
    return not value if isinstance(value, bool) else value + 1


def in_summary(experiment: Task, name: str) -> object:
    """A setting as ``summary.json`` holds it."""
    group, _, entry = name.rpartition(".")
    return experiment.settings[group][entry] if group else experiment.settings[name]


def test_every_setting_of_every_task_is_known_to_a_run() -> None:
    assert {name for task_name in TASKS for name in task(task_name).adjustable} == OF_TASK.keys()


@pytest.mark.parametrize("name", sorted(name for name in EXPERIMENTS if "handwriting" not in name))
def test_experiment_with_its_own_settings_is_the_same(name: str) -> None:
    if "gym" in name or "inverted" in name:
        pytest.importorskip("gymnasium")
    own = load_experiment(name)
    given = {setting: value for setting, value in own.adjustable.items() if value is not None}
    assert own.with_settings(**given).settings == own.settings


OF_SHARES = {"random_action": 1, "promise": 0.5}
OF_SHARES |= {"search.first_horizon": 0.5, "search.horizon_step": 0.5}


@pytest.mark.parametrize("name", OF_TASK)
def test_each_setting_can_be_set_and_is_in_the_summary_and_no_other_changes(name: str) -> None:
    own = task_with(name)
    present = own.adjustable[name]
    value = other([1.0] * len(own.space.feature_names) if present is None else present)
    value = OF_SHARES.get(name, value)
    changed = own.with_settings(**{name: value})
    assert in_summary(changed, name) == value
    assert {**changed.adjustable, name: None} == {**own.adjustable, name: None}


def wrong_values(name: str) -> tuple[object, ...]:
    declared = OF_TASK[name]
    if declared.kind not in OTHERS:
        return NO_TENSORS
    outside = (
        *(bound - 1 for bound in (declared.least, declared.above) if bound is not None),
        *([] if declared.most is None else [declared.most + 0.5]),
        *([] if declared.above is None else [declared.above]),
    )
    return (*outside, *OTHERS[declared.kind])


@pytest.mark.parametrize("name", OF_TASK)
def test_value_that_is_not_as_it_must_be_is_a_line_that_names_the_setting(name: str) -> None:
    experiment, (group, _, entry) = task_with(name), name.rpartition(".")
    for value in wrong_values(name):
        with pytest.raises(ValueError, match=r"\bgot\b") as error:
            experiment.with_settings(**{name: value})
        said = str(error.value)
        assert said.startswith(group or name) and entry in said and "\n" not in said, value


def test_settings_of_a_run_are_read_as_they_were_written(tmp_path: Path) -> None:
    written = {"experiment": "biorob", "demonstrations": 'größe, it\'s \\ "1e5".npz'}
    written |= task("biorob").adjustable | {"tolerance": 1e-9}
    write_settings(tmp_path, written)
    assert read_settings(tmp_path / "settings.yaml") == written


def test_command_line_takes_the_place_of_the_file_wherever_it_stands(tmp_path: Path) -> None:
    path = tmp_path / "my settings.yaml"
    path.write_text("seed: 3  # a comment\nsearch.restarts: 2\nnoise_std: [0.1, 0.2]\n")
    words = ["-m", "noise_std=1,2", f"settings={path}", "trials=4"]
    assert with_file(words) == ["-m", "noise_std=1,2", "seed=3", "search.restarts=2", "trials=4"]
    assert with_file(["seed=1"]) == ["seed=1"]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sede: 1", "there is no setting sede in sede: 1: did you mean seed?"),
        ("settings: other.yaml", "there is no setting settings in settings: "),
        ("hydra.launcher._target_: os.mkdir", "there is no setting hydra.launcher._target_ in "),
        ('"seed=1 hydra.x": 2', "there is no setting seed=1 hydra.x in "),
        ("experiment: mine.py:arm", "experiment must be given on the command line if "),
        ("search: {restarts: 2}", "search must be one value, got entries: write search.ENTRY: "),
        ("seed: 1\nseed: 2", "must be YAML: while constructing a mapping"),
        ("out: ${oc.env:HOME}", "must hold values alone, got a reference ${...}"),
        ("out: ${oc.decode:x}", "must hold values alone, got a reference ${...}"),
        ("target: &a [1]\nnoise_std: *a", "must hold values alone, got a reference *NAME"),
        ("out: !!python/object/apply:os.mkdir [sprung]", "must be YAML: could not determine a"),
        ("- seed", "must hold NAME: VALUE in each line, got a list"),
        ("[" * 200, "must be YAML: while parsing a flow"),
        ("seed: [", "must be YAML: while parsing a flow"),
        ("\x00", "must be YAML: unacceptable character"),
        ("[" * 201, "must hold at most 200 lists, got more"),
        ("- " * 8000, "must be YAML: "),
        ("a" * 70_000, "must be a regular file of at most 16384 bytes, got 70000 bytes"),
    ],
    ids=lambda text: text[:20],
)
def test_file_that_holds_something_else_is_a_line_that_names_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str, said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.yaml").write_text(text)
    (load,) = measured([lambda: with_file(["settings=mine.yaml"])], SettingsError)
    assert not load.failure and load.refusal.startswith(f"mine.yaml: {said}"), load.refusal
    assert "\n" not in load.refusal and load.seconds < 5
    assert not Path("sprung").exists()


@pytest.mark.parametrize(
    "value", [1, 1e-9, True, None, [[1.0, 2.0], [3.0, 4.0]], "runs/a", "null", "1e5", "it's \\'"]
)
def test_word_is_read_as_the_value_that_it_was_made_of(value: object) -> None:
    assert OverridesParser.create().parse_override(word_of("out", value)).value() == value


def test_page_of_the_settings_fills_in_the_rows_of_their_declarations() -> None:
    page = Path(__file__).parents[2] / "docs" / "how_to" / "settings.md"
    assert page.read_text().endswith("```{settings}\n```\n")
    assert [row.split("`")[1] for row in documentation_rows()] == [*SETTINGS]
