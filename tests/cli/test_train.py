"""The training script: what it leaves, what it says, and that it fails in one line."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import NoReturn
from unittest.mock import Mock

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser
from matplotlib.figure import Figure

from tests.helpers.run_script import ROOT, run_command
from tests.helpers.short_run import quick_fits, replace_task, short_experiment
from tests.runs.report.test_report import OLD
from torch_pmil.cli import train
from torch_pmil.cli.resume import overrides
from torch_pmil.demonstrations import Demonstrations, shipped_demonstrations
from torch_pmil.envs import DoublePendulumEnv, MujocoRobotEnv
from torch_pmil.envs.operator import RobotError, RunStopped
from torch_pmil.runs import pictures, settings
from torch_pmil.runs.diagnosis.findings import Finding
from torch_pmil.runs.own_files import LIST
from torch_pmil.runs.settings import word_of
from torch_pmil.runs.training import RunResult, train as learn
from torch_pmil.search import sample_search, trial_search
from torch_pmil.tasks.outcome import Outcome
from torch_pmil.tasks.registry import EXPERIMENTS
from torch_pmil.tasks.task import Task

COMMAND = "train"
UNKNOWN = (
    f"experiment must be one of {', '.join(EXPERIMENTS)}, or FILE.py:FUNCTION or MODULE:FUNCTION "
    "of your own"
)
FILES = {"run.json", "metrics.csv", "settings.yaml", "summary.json", "policy.pt", "dynamics.pt"}
FILES |= {"video.mp4", "video.gif", "report.html"}
FIGURES = {"trajectories", "learning_curve", "kl_per_step", "calibration", "model", "policy"}
FIGURES |= {"poses"}
SUMMARY = OLD | {
    "saved_n_eval": 20,
    "two_sigma_coverage": 0.9,
    "two_sigma_coverage_by_entry": {"q1": 0.9},
    "units": {"demonstrations": {"q1": "rad"}},
    "rms_error": {"q1": 0.03},
    "demonstration_spread": {"q1": 0.02},
    "diagnosis": [{"cause": "search stuck", "message": "predicted 0.14 ± 0.06 m"}],
}
Script = Callable[..., None]


@pytest.fixture
def script(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Script:
    """The script, run with command-line overrides in an empty folder."""
    monkeypatch.chdir(tmp_path)
    return partial(run_command, monkeypatch, COMMAND)


@pytest.fixture
def short_double_pendulum(monkeypatch: pytest.MonkeyPatch) -> None:
    """The double pendulum is its first six steps, and a search a few evaluations."""
    replace_task(monkeypatch, short_experiment(6))


@pytest.mark.slow
@pytest.mark.usefixtures("short_double_pendulum")
def test_run_leaves_numbers_policy_figures_and_a_video(
    script: Script, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    script("trials=1", "seed=2", "out=run")
    files = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    figures = {f"run/figures/{name}.png" for name in FIGURES}
    scalars = "run/logs/double_pendulum_seed_2/scalars/"
    logged = {name for name in files if name.startswith(("run/checkpoints/", scalars))}
    assert len([name for name in logged if name.endswith(".torchrl")]) == 2
    assert {f"{scalars}loss.csv", f"{scalars}own_error.csv"} <= logged
    assert files - logged == {f"run/{name}" for name in (*FILES, LIST)} | figures
    summary = json.loads((tmp_path / "run" / "summary.json").read_text())
    assert (summary["command"], summary["seed"]) == ("pmil train trials=1 seed=2 out=run", 2)
    printed = capsys.readouterr().out
    assert "trial  1:   0.6 s of experience" in printed
    assert "policy of trial 1: success rate" in printed
    assert "see run/report.html, run/figures, run/video.mp4, run/summary.json" in printed


@pytest.mark.slow
def test_run_of_the_baseline_tells_of_its_cost_and_draws_the_same(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    short = short_experiment(6, name="double_pendulum_pilco")
    replace_task(monkeypatch, short, "double_pendulum_pilco")
    script("experiment=double_pendulum_pilco", "trials=1", "seed=2", "logger=null")
    line = r"trial  1:   0.6 s of experience \(\d+ transitions\), cost +\d\.\d, own rollout"
    assert re.search(line, capsys.readouterr().out)
    run = Path("runs/double_pendulum_pilco/seed_2")
    assert {path.name for path in (run / "figures").iterdir()} == {
        f"{name}.png" for name in FIGURES - {"kl_per_step"}
    }
    settings = json.loads((run / "summary.json").read_text())["settings"]
    target = {"x1": 0.0, "y1": 0.5, "x2": 0.0, "y2": 1.0}
    assert settings["cost"] == {"cost": "SaturatingCost", "target": target, "width": 2.0}


def test_robot_that_has_no_sketch_has_no_video_without_opengl_and_the_script_says_so(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(self: object) -> None:
        raise RuntimeError("pictures need OpenGL")

    replace_task(monkeypatch, replace(short_experiment(4), sketch=None))
    monkeypatch.setattr(MujocoRobotEnv, "_open_renderer", broken)
    quick_fits(monkeypatch)
    script("trials=1", "seed=2", "out=run")
    printed, complained = capsys.readouterr()
    assert complained.endswith(
        "the report is incomplete: video: pictures need OpenGL; pmil resume run makes the rest "
        "later, pmil report the page alone\n"
    )
    assert "see run/report.html, run/figures, run/summary.json" in printed
    assert re.search(
        r"within two predicted standard deviations: q1 \d+%, dq1 \d+%, q2 \d+%, dq2 \d+%\n", printed
    )


@pytest.fixture
def finished(short_double_pendulum: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Training is over at once: what it would return and leave is there."""
    experiment = short_experiment(6)
    outcome = Outcome("", experiment.demonstrations, experiment.demonstrated, None, None, None)
    result = RunResult(SUMMARY, [], [outcome], None, None, experiment)

    def saved(experiment: object, seed: int, trials: int, out: Path, *rest: object, **_: object):
        (out / "figures").mkdir(parents=True)
        (out / "policy.pt").touch()
        (out / "summary.json").write_text(json.dumps(SUMMARY))
        return result

    monkeypatch.setattr(train, "train", saved)


@pytest.fixture
def nothing_to_draw(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "figures_of", lambda *args: iter([]))
    monkeypatch.setattr(pictures, "film_outcome", lambda *args: None)


def broken(*args: object) -> None:
    raise OSError(28, "No space left on device")


def interrupted(*args: object, **options: object) -> None:
    raise KeyboardInterrupt


@pytest.mark.usefixtures("finished", "nothing_to_draw")
def test_all_that_fails_after_the_policy_is_saved_is_one_line_at_the_end(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ("figures_of", "film_outcome", "write_report"):
        monkeypatch.setattr(pictures, name, broken)
    script("out=run")  # does not exit
    printed, complained = capsys.readouterr()
    assert "policy of trial 1: success rate 50%" in printed and "see run/summary.json" in printed
    full = "[Errno 28] No space left on device"
    assert complained == (
        f"the report is incomplete: figures: {full}; video: {full}; report: {full}; "
        "pmil resume run makes the rest later, pmil report the page alone\n"
    )


@pytest.mark.usefixtures("finished", "nothing_to_draw")
def test_interruption_while_drawing_leaves_what_was_learned_and_says_what_is_missing(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pictures, "film_outcome", interrupted)
    script("out=run")
    assert "incomplete: video: stopped; report: stopped; pmil" in capsys.readouterr().err
    assert Path("run/summary.json").exists()
    assert "pmil resume run" in Path("run/report.html").read_text()


@pytest.mark.usefixtures("finished", "nothing_to_draw")
def test_report_and_results_are_there_before_anything_is_drawn(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    seen: list[str] = []

    def drawing(*args: object) -> Iterator[tuple[str, Figure]]:
        seen.extend((capsys.readouterr().out, Path("run/report.html").read_text()))
        return iter([("poses", Figure(figsize=(2, 1)))])

    monkeypatch.setattr(pictures, "figures_of", drawing)
    script("out=run")
    printed, page = seen
    assert "policy of trial 1: success rate 50%" in printed and "see " not in printed
    assert "It learned in part" in page and "<h2>Figures and video</h2>" in page
    page = Path("run/report.html").read_text()
    assert "<h2>Figures and video</h2>" not in page and "Poses of one rollout" in page
    printed, complained = capsys.readouterr()
    assert printed.startswith("see run/report.html, run/figures, ") and complained == ""


@pytest.mark.usefixtures("finished", "nothing_to_draw")
def test_run_that_was_renamed_while_it_was_drawn_is_an_error(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    def renamed(*args: object) -> None:
        Path("run").rename("elsewhere")

    monkeypatch.setattr(pictures, "film_outcome", renamed)
    assert error_of(script, "out=run").startswith("run was removed or renamed")


@pytest.mark.usefixtures("finished", "nothing_to_draw")
def test_output_that_is_ascii_or_broken_ends_nothing(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def run_into(file: str | int, out: str, encoding: str | None = None) -> str:
        """What is complained of where standard output is this file."""
        with open(file, "w", encoding=encoding) as output:
            monkeypatch.setattr(sys, "stdout", output)
            script(f"out={out}")
        return capsys.readouterr().err

    run_into("ascii", "run", "ascii")
    assert "0.14 ? 0.06 m" in Path("ascii").read_text()
    full = run_into("/dev/full", "another")
    assert "incomplete: standard output: [Errno 28] No space left" in full
    reader, writer = os.pipe()
    os.close(reader)
    assert "incomplete" not in run_into(writer, "third")


@pytest.mark.parametrize(
    "name", ["größe", "a(1)", "a=1", 'it\'s "a"', "ö/${seed}", "~/a#1", "'a=1'"]
)
def test_text_that_hydra_cannot_read_is_taken_as_it_is(
    script: Script, monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    given: list[settings.RunSettings] = []
    monkeypatch.setattr(train, "task_of", lambda settings: given.append(settings) or interrupted())
    with pytest.raises(SystemExit):
        script(f"out={name}")
    assert given[0].out == os.path.expanduser(name).strip("'").replace("${seed}", "0")


@pytest.mark.parametrize("word", ["out=a,b", "out=ö,b", "out=[", "experiment=range(2)"])
def test_text_that_may_be_several_values_is_taken_as_the_error_says(
    script: Script, word: str
) -> None:
    (advised,) = shlex.split(error_of(script, word).rpartition("; if that is its value, write ")[2])
    assert OverridesParser.create().parse_override(advised).value() == word.partition("=")[2]


@pytest.mark.usefixtures("short_double_pendulum")
@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "\nstopped; go on with: "),
        (RunStopped("q"), 130, "\nstopped; go on with: "),
        (RobotError("no answer"), "error: no answer; go on with: ", ""),
    ],
)
def test_run_that_was_ended_says_how_to_go_on(
    error: BaseException,
    code: int | str,
    said: str,
    script: Script,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(DoublePendulumEnv, "_draw_starts", Mock(side_effect=error))
    with pytest.raises(SystemExit) as stop:
        script("trials=1", "seed=2", "out=run")
    further = "pmil train trials=1 seed=2 out=run resume=true"
    assert stop.value.code == (f"{code}{further}" if isinstance(code, str) else code)
    assert capsys.readouterr().err == (f"{said}{further}\n" if said else "")


@pytest.mark.usefixtures("short_double_pendulum")
def test_stopped_run_is_not_overwritten_by_the_same_command(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as patch, pytest.raises(SystemExit):
        patch.setattr(trial_search, "search_policy", lambda *args, **options: sys.exit("power cut"))
        script("trials=1", "seed=2", "out=run")
    assert error_of(script, "trials=1", "seed=2", "out=run") == (
        "run holds a run that was stopped: go on with resume=true, choose another out, or remove "
        "run/checkpoints/checkpoint-*.torchrl"
    )


@pytest.mark.usefixtures("finished", "nothing_to_draw")
def test_finished_run_is_replaced_only_if_told_and_the_message_says_how(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    script("out=run")
    monkeypatch.setattr(train, "train", learn)
    assert error_of(script, "out=run", "seed=3", "resume=false") == (
        "run holds a run that has ended: overwrite=true replaces it, as "
        "pmil train out=run seed=3 overwrite=true"
    )
    assert json.loads(Path("run/summary.json").read_text()) == SUMMARY


NAMES = ", ".join(settings.SETTINGS)


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("sede=1", "there is no setting sede in sede=1: did you mean seed?"),
        ("++trails=1", "there is no setting trails in ++trails=1: did you mean trials?"),
        ("zzz=1", f"there is no setting zzz in zzz=1: there are {NAMES}"),
        ("overwrite=1", "overwrite must be true or false, got 1"),
        ("out=${nothing}", "out cannot be read: "),
        ("demonstrations=3", "demonstrations must be text that is not empty or null, got 3"),
        ("demonstrations=[a]", "demonstrations must be text that is not empty or null, got ['a']"),
        ("experiment=[a]", "experiment must be text that is not empty, got ['a']"),
        ("logger=stone", "logger must be one of csv, tensorboard, wandb, mlflow or null, got"),
        ("hydra.callbacks.a._target_=os.mkdir", "there is no setting hydra.callbacks."),
        ("hydra.launcher._target_=os.mkdir", "there is no setting hydra.launcher._target_ in "),
        ("hydra.launcher.ray._target_=os.mkdir", "there is no setting hydra.launcher.ray."),
        ("+hydra.launcher.a=1", "a setting must be hydra.launcher.a=VALUE, got +"),
        ("hydra.run.dir=here", "there is no setting hydra.run.dir in hydra.run.dir=here: "),
        ("hydra.sweep.dir=here", "there is no setting hydra.sweep.dir in hydra.sweep.dir=here: "),
        ("hydra/job_logging=default", "there is no setting hydra/job_logging in "),
    ],
)
def test_setting_that_is_not_as_it_must_be_is_one_line_before_anything_is_written(
    script: Script, override: str, message: str
) -> None:
    assert error_of(script, override).startswith(message)
    assert os.listdir() == []


@pytest.mark.parametrize(
    "line",
    [
        "experiment=biorob -m seed=0,1",
        "-m experiment=biorob seed=0,1",
        "experiment=biorob seed=0,1 --multirun",
    ],
)
def test_flag_of_a_sweep_stands_anywhere(
    script: Script, monkeypatch: pytest.MonkeyPatch, line: str
) -> None:
    given: list[list[str]] = []
    monkeypatch.setattr(train, "learn", lambda: given.append(sys.argv[1:]))
    script(*line.split())
    assert given == [["--multirun", "experiment=biorob", "seed=0,1"]]


def test_sweep_that_is_stopped_says_how_to_go_on(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(train, "learn", interrupted)
    with pytest.raises(SystemExit) as stop:
        script("-m", "seed=0,1")
    further = "pmil train --multirun seed=0,1 resume=true"
    assert stop.value.code == 130
    assert capsys.readouterr() == ("", f"\nstopped; go on with: {further}\n")


@pytest.mark.parametrize(
    ("swept", "got"),
    [
        ("seed=range(1000000)", "more"),
        ("seed=range(2000000000) trials=range(1,1000)", "more"),
        ("seed=range(0)", "none"),
    ],
)
def test_sweep_of_no_run_or_of_too_many_is_refused_at_once(
    script: Script, swept: str, got: str
) -> None:
    begun = time.process_time()
    message = error_of(script, "-m", *swept.split())
    assert message == f"a sweep must have from 1 to 10000 runs, got {got}"
    assert time.process_time() - begun < 2 and os.listdir() == []


def test_help_says_every_setting_with_its_value_and_what_it_means(
    script: Script, capsys: pytest.CaptureFixture[str]
) -> None:
    script("--help", "experiment=biorob", "noise_std=0.1")
    lines = capsys.readouterr().out.splitlines()
    own, others = "\n".join(lines).split("Other experiments")
    words = set(re.findall(r"^  ([a-z_.]+)=", own, re.MULTILINE))
    words |= set(re.findall(r"^      ([a-z_.]+): ", others, re.MULTILINE))
    assert words == {*settings.SETTINGS}
    assert {"  noise_std=0.1", "  num_centres=80", "  out=runs/biorob/seed_0"} < {*lines}
    for name, shipped in EXPERIMENTS.items():
        assert any(re.fullmatch(f"  {name} +{re.escape(shipped.sentence)}", each) for each in lines)


def test_help_of_a_setting_that_is_wrong_is_its_line(script: Script) -> None:
    assert error_of(script, "--help", "noise_std=-1") == "noise_std must be positive, got -1.0"


@pytest.mark.usefixtures("short_double_pendulum")
def test_settings_of_a_file_and_of_the_command_line_reach_the_run(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stop(experiment: Task, *rest: object, settings: dict, **_: object) -> NoReturn:
        learned.append((experiment, settings))
        sys.exit()

    learned: list[tuple[Task, dict]] = []
    monkeypatch.setattr(train, "train", stop)
    lines = ("seed: 3", "noise_std: [0.1, 0.2, 0.3, 0.4]", "search.restarts: 2", "input_scale: 2")
    Path("mine.yaml").write_text("\n".join(lines))
    with pytest.raises(SystemExit):
        script("settings=mine.yaml", "input_scale=3", "search.trust_threshold=2", "out=run")
    ((experiment, named),) = learned
    assert experiment.noise_std.tolist() == [0.1, 0.2, 0.3, 0.4]
    search = experiment.method.search
    assert (search.restarts, search.trust_threshold) == (2, 2)
    assert (experiment.method.policy.input_scale, named["seed"]) == (3, 3)


@pytest.mark.usefixtures("nothing_to_draw")
def test_run_leaves_the_settings_that_make_it_again(
    script: Script, monkeypatch: pytest.MonkeyPatch
) -> None:
    replace_task(monkeypatch, short_experiment(4))
    quick_fits(monkeypatch)
    script("trials=1", "seed=2", "out=run", "noise_std=0.2", "search.horizon_step=0.5")
    script("settings=run/settings.yaml", "out=again")
    script("settings=run/settings.yaml", "seed=3", "out=other")
    run, again, other = (
        json.loads(Path(name, "summary.json").read_text()) for name in ("run", "again", "other")
    )
    assert run["settings"] == again["settings"] == other["settings"]
    assert run["settings"]["noise_std"] == 0.2 and run["settings"]["search"]["horizon_step"] == 0.5
    assert run["loss_per_step"] == again["loss_per_step"] != other["loss_per_step"]
    assert Path("run/settings.yaml").read_text().startswith('experiment: "double_pend')
    folder = Path("other").resolve()
    assert overrides(folder, [])[-3:-1] == ["seed=3", word_of("out", str(folder))]
    message = error_of(script, *overrides(folder, ["noise_std=0.3"]))
    assert message.endswith("has noise_std = 0.2, got 0.3: it cannot go on so")


def test_make_passes_on_the_settings_of_its_command_line(tmp_path: Path) -> None:
    """GNU make alone runs here, and says what it would do."""
    made = shutil.which("make")
    if made is None:
        pytest.skip("no make on this machine")
    quiet = [made, "-n", "--no-print-directory", "-o", ".venv/.installed"]  # make may run this
    command = [*quiet, "train", "seed=1", "out=a b", "ARGS=trials=2"]
    told = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    command, train, *words = shlex.split(told.stdout)  # make gives its variables in any order
    assert (command, train) == (".venv/bin/pmil", "train")
    assert sorted(words) == ["out=a b", "seed=1", "trials=2"]


def error_of(script: Script, *overrides: str) -> str:
    """The one line that the script fails with, after "error: "."""
    with pytest.raises(SystemExit) as stop:
        script(*overrides)
    message = stop.value.code
    assert isinstance(message, str) and message.startswith("error: ") and "\n" not in message
    return message.removeprefix("error: ")


RENAMED = (
    "demonstrations must be of x1, y1, x2, y2, got x1, y1, x2, z2; pmil align RECORDED OUT.npz "
    "--names x1 y1 x2 y2 renames them"
)
RESAMPLED = (
    "demonstrations must have a time step of 0.1 s, the robot's control period, got 0.05 s; "
    "pmil align --time-step 0.1 resamples a recording"
)


@pytest.mark.parametrize(
    ("names", "time_step", "scale", "complaint"),
    [
        ("x1 y1 x2 z2", 0.1, 1.0, RENAMED),
        ("x1 y1 x2 y2", 0.05, 1.0, RESAMPLED),
        ("x1 y1 x2 y2", 0.1, 1.3, "demonstration 3 leaves the workspace: at "),
    ],
)
def test_demonstrations_that_the_robot_cannot_follow_are_refused(
    script: Script, names: str, time_step: float, scale: float, complaint: str
) -> None:
    positions = shipped_demonstrations().positions.clone()
    positions[3] *= scale
    Demonstrations(positions, time_step, names.split()).save("own.npz")
    assert error_of(script, "demonstrations=own.npz", "out=run").startswith(complaint)
    assert os.listdir() == ["own.npz"]


def test_doubtful_demonstrations_are_warned_of_once_and_learned_from(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shipped = shipped_demonstrations()
    replace(shipped, positions=shipped.positions[[0, 1, 2, 3, 4, 1]]).save("own.npz")
    monkeypatch.setattr(sample_search, "search_on_samples", interrupted)
    quick_fits(monkeypatch)
    with pytest.raises(SystemExit):
        script("demonstrations=own.npz", "trials=1", "out=run")
    printed = capsys.readouterr().out
    assert printed.count("warning: ") == 1
    assert "warning: demonstrations 1 and 5 are the same; leave one of them out\n" in printed


def test_warnings_of_one_cause_are_ten_at_most(capsys: pytest.CaptureFixture[str]) -> None:
    copies = [Finding("copies", f"{number} is a copy") for number in range(1000)]
    train.warn_of("run: ", [*copies, Finding("length", "long")])
    lines = capsys.readouterr().out.splitlines()
    assert lines[0] == "run: warning: 0 is a copy" and len(lines) == 12
    assert lines[-2:] == ["run: warning: long", "run: warning: 990 more of copies"]


def test_warnings_of_a_run_are_lines_like_those_of_its_demonstrations(
    script: Script, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def doubtful(settings: object) -> NoReturn:
        warnings.simplefilter("always")
        warnings.warn("q looks like degrees:\ndivide it", UserWarning, stacklevel=1)
        warnings.warn("no motion", RuntimeWarning, stacklevel=1)
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "task_of", doubtful)
    with pytest.raises(SystemExit):
        script("out=run")
    printed, complained = capsys.readouterr()
    assert printed == "warning: q looks like degrees: divide it\nwarning: no motion\n"
    assert complained == "\nstopped; go on with: pmil train out=run resume=true\n"


def test_failure_is_one_line_on_stderr_and_an_exit_code(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "torch_pmil", COMMAND, "experiment=triple", "out=run"]
    process = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert process.returncode == 1
    assert process.stdout == ""
    assert process.stderr == f"error: {UNKNOWN}, got 'triple'\n"
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("kind", ["tensorboard", "wandb", "mlflow"])
def test_missing_library_of_a_logger_is_named_before_there_is_a_folder(
    script: Script, kind: str
) -> None:
    if find_spec(kind):
        pytest.skip(f"{kind} is installed")
    said = error_of(script, f"logger={kind}", "out=run")
    assert said == f"logger={kind} needs another library: pip install {kind}"
    assert os.listdir() == []
