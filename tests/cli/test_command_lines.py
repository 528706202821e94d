"""Command lines that make no sense: each ends with one line, and leaves the folder as it was."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from tests.helpers.draws import Draws
from tests.helpers.losses import SPACE, make_parts
from tests.helpers.run_script import run_command
from tests.runs.report.test_report import OLD, run_of
from torch_pmil import cli
from torch_pmil.control.policy_file import save_policy
from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.errors import TIME_STEP
from torch_pmil.runs.run_folder import write_origin

LONGEST = 800  # characters of a line, in which all settings and all shapes of the LASA set fit
RECORDED = "demonstration,time,x,y\n"
COMMANDS = "the command must be one of play, new, "
SEED = "seed must be a whole number from 0 to 2147483647, got "
TRIALS = "trials must be a whole number from 1 to 1000, got "
OUT = "out must be text that is not empty, got "
KINDS = (
    "demonstrations must be a .npz, .csv, .mat, .hdf5, .h5 or .parquet file, or a folder of them"
)
NO_ZIP = "must be a whole ZIP archive, got: File is not a zip file"
FOLDER = "a folder of demonstrations must hold one of meta/info.json"
NOISE = "noise_std must be a number or one for each of x1, y1, x2, y2, got "
TRUTH = " must be true or false, got "
RANDOM = "random_action must be a finite number, above 0, at most 1, got "
ITERATIONS = "search.final_iterations must be a whole number of at least 0, got "
FLAGS = ("--nope", "--config-dir", "--config-name=nothing", "--config-dir=nowhere", "--cfg")
FLAGS += ("--experimental-rerun=a", "--info", "-p")
WITHIN = "time_step must be positive and at most the duration, 0.8 s, got "


def samples(*demonstrations: int, still: bool = False) -> str:
    """Rows of a CSV file, nine for each demonstration."""
    return "".join(
        f"{n},{0.1 * k:.1f},{0 if still else 0.1 * k * k + n:.3f},{0 if still else k + n}\n"
        for n in demonstrations
        for k in range(9)
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Holds files and runs, good and bad ones."""
    folder = tmp_path_factory.mktemp("lines")
    for name in ("folder", "folder.pt2", "stopped", "other", "broken", "binary", "piped", "gone"):
        (folder / name).mkdir()
    make_recordings(folder)
    make_policies(folder)
    run_of(folder / "run", OLD)
    write_origin(folder / "run", {"command": "pmil train out=run"})
    write_origin(folder / "stopped", {"command": "pmil train out=stopped trials=1"})
    write_origin(folder / "other", {"command": "python other.py"})
    (folder / "broken" / "run.json").write_text("{")
    (folder / "broken" / "summary.json").write_text("[1")
    (folder / "binary" / "run.json").write_bytes(bytes(range(256)))
    os.mkfifo(folder / "piped" / "run.json")
    return folder


def make_recordings(folder: Path) -> None:
    targeted = (f"{row},{row[0]}" for row in samples(1, 2).split())
    texts = {
        "file": "old",
        "empty.csv": "",
        "own.csv": RECORDED + samples(1, 2),
        "single.csv": RECORDED + samples(1),
        "milliseconds.csv": "demonstration,time,x1,y1,x2,y2\n"
        + "".join(f"{n},{10 * k},{k},{n},1,2\n" for n in (1, 2) for k in range(200)),
        "targets.csv": "\n".join([f"{RECORDED[:-1]},target place", *targeted]),
        "still.csv": RECORDED + samples(1, 2, still=True),
        "columns.csv": f"{RECORDED}1,0,1,2,3\n",
        "headless.csv": "1,2,3\n4,5,6\n",
        **dict.fromkeys(("picture.png", "film.gif", "old.pt2"), ""),
        "wrong.yaml": "sede: 1\n",
        "empty.npz": "",
    }
    for name, text in texts.items():
        (folder / name).write_text(text)
    (folder / "latin.csv").write_bytes("demonstration,time,größe\n1,0,1\n".encode("latin-1"))
    (folder / "binary.npz").write_bytes(bytes(range(256)) * 4)
    (folder / "dangling.npz").symlink_to("nothing.npz")
    (folder / "loop.npz").symlink_to("loop.npz")
    os.mkfifo(folder / "pipe.csv")
    strokes = Draws(0).normal(2, 31, 2)
    for name in ("strokes.npz", "ready.npz"):
        Demonstrations(strokes, 0.1, ("x", "y")).save(folder / name)


def make_policies(folder: Path) -> None:
    policy, _ = make_parts(Draws(0))
    save_policy(folder / "policy.pt", policy, SPACE, 0.1)
    (folder / "cut.pt").write_bytes((folder / "policy.pt").read_bytes()[:400])
    content = torch.load(folder / "policy.pt", weights_only=True)
    parameters = content["parameters"]
    wide = {**parameters, "log_widths": torch.full_like(parameters["log_widths"], 1e4)}
    none = {**parameters, **{name: parameters[name][:0] for name in ("centres", "weights")}}
    torch.save({**content, "parameters": wide}, folder / "wide.pt")
    torch.save({**content, "parameters": none}, folder / "none.pt")


def wrong(name: str, must: str, *values: str) -> Iterator[tuple[str, str]]:
    """Command lines with a value each, and what is said of it; "VALUE SHOWN" is shown otherwise."""
    for value in values:
        given, _, shown = value.partition(" ")
        yield f"train {name}={given}", f"{must}{shown or given}"


def contents(folder: Path) -> dict[str, tuple[int, int]]:
    """Size and time of all files, and the names of all folders."""
    return {
        str(path.relative_to(folder)): (0, 0)
        if path.is_dir() and not path.is_symlink()
        else (path.lstat().st_size, path.lstat().st_mtime_ns)
        for path in folder.rglob("*")
    }


MILLISECONDS = "time looks like milliseconds, not seconds: steps of 10 where the robot acts"
LINES = (
    ("nonsense", f"the command must be one of {', '.join(cli.COMMANDS)}, got 'nonsense'"),
    ("Train", COMMANDS),
    ("--nope", COMMANDS),
    ("seed=1", COMMANDS),
    ("''", COMMANDS),
    *((f"train {flag}", f"unrecognized arguments: {flag} (see pmil") for flag in FLAGS),
    ("train seed=${foo}", "seed cannot be read: Interpolation key 'foo' not found"),
    ("train out=${oc.env:NOPE}", "out cannot be read: "),
    ("train trials=${seed.x}", "trials cannot be read: "),
    ("train seed=${seed}", "seed cannot be read: Recursive interpolation detected"),
    ("train out=${no_resolver:1}", "out cannot be read: Unsupported interpolation type"),
    ("train ~seed", "a setting must be seed=VALUE, got ~seed"),
    ("train ~zzz", "there is no setting zzz in ~zzz: there are "),
    *wrong("out", OUT, "5", "null None", " ''", "true True", "[a,b] ['a', 'b']"),
    ("train out={a:1}", OUT),
    ("train \"out=' '\"", f"{OUT}' '"),
    ("train out=file", "file: File exists"),
    ("train out=file/run", "file/run: Not a directory"),
    ("train out=/dev/null/run", "/dev/null/run: Not a directory"),
    *wrong("seed", SEED, "12345678901234567890", "-1", "1.5", "nan", "[1]", "true True"),
    *wrong("seed", SEED, "1e3 1000.0", "abc 'abc'", "null None"),
    ("train seed=1,2", "seed must be one value, unless -m is given, got seed=1,2"),
    ("train 'seed=range(2)'", "seed must be one value, unless -m is given, got seed=range(2)"),
    *wrong("trials", TRIALS, "1000000000000", "1e12 1000000000000.0", "0", "-3", "two 'two'"),
    ("train seed=1 seed=2 trials=x", f"{TRIALS}'x'"),
    *wrong("resume", f"resume{TRUTH}", "1", "no 'no'", "maybe 'maybe'", "null None"),
    *wrong("overwrite", f"overwrite{TRUTH}", "[]"),
    ("train resume=true overwrite=true", "resume=true goes on with a run, and overwrite=true"),
    ("train +sede=1", "there is no setting sede in +sede=1: did you mean seed?"),
    ("train ++seed", "cannot read the setting '++seed': "),
    ("train +seed=1", "a setting must be seed=VALUE, got +seed=1"),
    ("train SEED=1", "there is no setting SEED in SEED=1: there are "),
    ("train seed.x=1", "there is no setting seed.x in seed.x=1: did you mean seed?"),
    ("train =1", "a setting must be NAME=VALUE, got =1"),
    ("train seed", "cannot read the setting 'seed': "),
    ("train own.csv", "cannot read the setting 'own.csv': "),
    ("train out=[", "cannot read the setting 'out=[': "),
    ("train 'out=\"a'", "cannot read the setting 'out=\"a': "),
    ("train 'seed=1;2'", "cannot read the setting 'seed=1;2': "),
    ("train experiment=triple", "experiment must be one of acrobot, biorob, "),
    ("train experiment=null", "experiment must be text that is not empty, got None"),
    ("train experiment=../double_pendulum", "experiment must be one of acrobot, biorob, "),
    ("train experiment=handwriting", "handwriting needs strokes (demonstrations=lasa:Angle, or a "),
    ("train shape=Sine", "there is no setting shape in shape=Sine: there are experiment, seed, "),
    ("train robot=biorob", "there is no setting robot in robot=biorob: "),
    ("train demonstrations=missing.npz", "there is no file missing.npz"),
    ("train demonstrations=folder", f"folder: {FOLDER}"),
    ("train demonstrations=empty.npz", "empty.npz: must be an NPZ file, got an empty file"),
    ("train demonstrations=latin.csv", "latin.csv: not a readable CSV file ('utf-8' codec"),
    ("train demonstrations=pipe.csv", "pipe.csv: must be a regular file of at most 64 MiB"),
    ("train demonstrations=loop.npz", "loop.npz: Too many levels of symbolic links"),
    ("train demonstrations=/dev/zero", f"/dev/zero: {KINDS}"),
    ("train demonstrations=strokes.npz", "demonstrations must be of x1, y1, x2, y2, got x, y"),
    ("train noise_std=0", "noise_std must be positive, got 0.0"),
    *wrong("noise_std", NOISE, "abc 'abc'", "true True", "[0.1,0.2] [0.1, 0.2]", "{a:1} {'a': 1}"),
    ("train noise_std=0.02,0.05", "noise_std must be one value, unless -m is given, got noise_std"),
    ("train -m noise_std=0.02,0.05", "two runs would write to runs/double_pendulum/seed_0: noise_"),
    ("train noise_std=${oc.env:NOPE}", "noise_std cannot be read: "),
    ("train tolerance=-1", "tolerance must be a finite number, at least 0, got -1"),
    ("train confirmations=0", "confirmations must be a whole number of at least 1, got 0"),
    ("train num_centres=1e12", "num_centres must be a whole number from 1 to 10000, got 1000000"),
    *wrong("random_action", RANDOM, "1.5", "much 'much'"),
    ("train input_scale=0", "input_scale must be a finite number, above 0, got 0"),
    ("train input_widths=2", "input_widths must have shape (6,), got ()"),
    ("train input_widths=[1,2]", "input_widths must have shape (6,), got (2,)"),
    ("train input_widths=[a,b]", "input_widths must be numbers, got ['a', 'b']"),
    ("train 'least_widths=[1,1,1,1,1,-1]'", "least_widths must be numbers, one for each feature"),
    *wrong("search.final_iterations", ITERATIONS, "-1", "many 'many'"),
    ("train search.trust_threshold=inf", "search.trust_threshold must be a finite number, at "),
    ("train search.skip_matched_steps=1", "search.skip_matched_steps must be true or false, got 1"),
    ("train search.iterations=1", "there is no setting search.iterations in search.iterations=1:"),
    ("train search=1", "there is no setting search in search=1: did you mean "),
    ("train final_iterations=1", "there is no setting final_iterations in final_iterations=1: did"),
    ("train +search.restarts=1", "a setting must be search.restarts=VALUE, got +search.restarts=1"),
    ("train target_scale=2", "a setting of double_pendulum must be one of noise_std, "),
    ("train exploration.hold=2", "a setting of double_pendulum must be one of noise_std, "),
    ("train experiment=biorob exploration.hold=0", "exploration.hold must be a whole number of at"),
    ("train experiment=biorob exploration.pose=[0]", "exploration.reach must have shape (1,), got"),
    ("train experiment=biorob random_action=0.5", "a setting of biorob must be one of noise_std, "),
    ("train experiment=double_pendulum_pilco cost.width=-1", "cost.width must be a finite number"),
    ("train settings=missing.yaml", "there is no file missing.yaml"),
    ("train settings=~nosuchuser/x", "there is no folder ~nosuchuser"),
    ("train settings=", ".: must be a regular file of at most 16384 bytes, got a folder"),
    ("train settings=folder", "folder: must be a regular file of at most 16384 bytes, got a"),
    ("train settings=pipe.csv", "pipe.csv: must be a regular file of at most 16384 bytes, "),
    ("train settings=/dev/zero", "/dev/zero: must be a regular file of at most 16384 bytes, got a"),
    ("train settings=binary.npz", "binary.npz: must be UTF-8, got 'utf-8' codec"),
    ("train settings=file settings=file", "settings=FILE must be given once, got settings=file"),
    ("train settings=wrong.yaml", "wrong.yaml: there is no setting sede in sede: 1: did you mean"),
    ("train +settings=wrong.yaml", "there is no setting settings in +settings=wrong.yaml: "),
    ("train logger=stone", "logger must be one of csv, tensorboard, wandb, mlflow or null"),
    ("train logger=[csv]", "logger must be text that is not empty or null, got ['csv']"),
    (
        "train hydra.nothing=1",
        "there is no setting hydra.nothing in hydra.nothing=1: ",
    ),
    ("train hydra/launcher=nothing", "In 'hydra/config': Could not find 'hydra/launcher/nothing'"),
    ("train out=run", "run holds a run that has ended: overwrite=true replaces it, as pmil train "),
    ("train -m trials=1,2", "two runs would write to runs/double_pendulum/seed_0: trials=1 and "),
    ("train -m seed=1,2 out=same", "two runs would write to same: seed=1 out=same and seed=2"),
    ("train -m seed=1,2 out=${oc.env:NOPE}", "out cannot be read: "),
    ("train -m sede=1,2", "there is no setting sede in sede=1,2: did you mean seed?"),
    ("train -m hydra/launcher=nothing", "In 'hydra/config': Could not find 'hydra/launcher/"),
    ("resume", "the following arguments are required: RUN"),
    ("resume nowhere", "there is no folder nowhere"),
    ("resume file", "file/run.json: Not a directory"),
    ("resume folder", "there is no file folder/run.json"),
    ("resume broken", "broken: run.json is damaged: must be JSON"),
    ("resume binary", "binary: run.json is damaged: must be JSON, got 'utf-8' codec"),
    ("resume piped", "piped: run.json is damaged: must be a regular file of at most 4 MiB"),
    ("resume other", "other was begun by python other.py, not by pmil train"),
    ("resume stopped sede=1", "there is no setting sede in sede=1: did you mean seed?"),
    ("resume stopped out=new resume=false", "pmil resume cannot change out, resume"),
    ("resume stopped trials=0", f"{TRIALS}0"),
    ("resume stopped --nope", "unrecognized arguments: --nope (see pmil resume --help)"),
    ("resume stopped ~seed", "a setting must be seed=VALUE, got ~seed"),
    ("report", "the following arguments are required: RUN"),
    ("report nowhere", "nowhere holds no finished run: there is no folder nowhere"),
    ("report file", "file holds no finished run: file/summary.json: Not a directory"),
    ("report folder", "folder holds no finished run: there is no file folder/summary.json"),
    ("report broken", "broken: summary.json is damaged: must be JSON"),
    ("report run extra", "unrecognized arguments: extra"),
    ("summarize", "the following arguments are required: DIR"),
    ("summarize nowhere", "nowhere is not a folder"),
    ("summarize folder", "folder holds no run: neither metrics.csv nor folders with it"),
    ("summarize run --out", "argument --out: expected one argument"),
    ("inspect", "the following arguments are required: FILE"),
    ("inspect missing.csv", "there is no file missing.csv"),
    ("inspect folder", f"folder: {FOLDER}"),
    ("inspect file", f"file: {KINDS}, got no suffix"),
    ("inspect empty.csv", "empty.csv: must be a CSV file, got an empty file"),
    ("inspect binary.npz", f"binary.npz: not a readable NPZ file without object arrays ({NO_ZIP}"),
    ("inspect latin.csv", "latin.csv: not a readable CSV file"),
    ("inspect pipe.csv", "pipe.csv: must be a regular file of at most 64 MiB, got a pipe"),
    ("inspect dangling.npz", "dangling.npz: No such file or directory"),
    ("inspect headless.csv", "headless.csv: row 1 must be demonstration,time,NAME,..., got 1,2,3"),
    ("inspect columns.csv", "columns.csv: row 2 must have 4 columns, got 5"),
    ("inspect own.csv --keys z", "own.csv: keys must be some of x, y, got z"),
    ("inspect own.csv --names x x", "own.csv: names must be different, one per column, got 'x' 2"),
    ("inspect own.csv --recorded-time-step 0.1", f"own.csv: {TIME_STEP} must be"),
    (
        "inspect own.csv --recorded-time-step fast",
        "argument --recorded-time-step: invalid float value: 'fast'",
    ),
    ("inspect own.csv --control-period 0", "--control-period must be a positive finite number"),
    ("inspect own.csv --control-period nan", "--control-period must be a positive finite number"),
    ("inspect own.csv --draw nowhere/out.png", "there is no folder nowhere"),
    ("inspect own.csv --draw new.pdf", "new.pdf: a picture is written to a .png file"),
    ("inspect own.csv --draw folder", "folder is there already: choose another name"),
    ("inspect own.csv --draw own.csv", "own.csv is there already: choose another name"),
    ("align ready.npz ready.npz --overwrite", "ready.npz is the recording itself: choose another"),
    ("play --out film.gif", "film.gif is there already: choose another name"),
    ("train out=.", "out must be a folder of its own, got '.', in which "),
    ("train out=''", "out must be text that is not empty, got ''"),
    ("play nowhere", "nowhere must be the folder of a finished run, but holds no policy.pt"),
    ("play --out a.avi", "a film must be a .gif or .mp4 file, got a.avi"),
    ("play --out nowhere/a.gif", "there is no folder nowhere"),
    ("play --starts 0", "--starts must be a whole number of at least 1, got 0"),
    ("play --seed -1", "seed must be None or a whole number from 0 to"),
    ("new car", "argument robot: invalid choice: 'car'"),
    ("new robot file/below", "file/below: Not a directory"),
    ("align own.csv", "the following arguments are required: OUT.npz"),
    ("align own.csv out.txt", "out.txt: demonstrations are written to a .npz file"),
    ("align own.csv ready.npz", "ready.npz is there already: --overwrite replaces it"),
    ("align own.csv out.npz --draw picture.png", "picture.png is there already: --overwrite"),
    ("align own.csv new.npz --draw new.npz", "new.npz: a picture is written to a .png file"),
    ("align own.csv out.npz --draw nowhere/a.png", "nowhere/a.png: there is no folder nowhere"),
    ("align own.csv nowhere/out.npz", "nowhere/out.npz: there is no folder nowhere"),
    ("align missing.csv out.npz", "there is no file missing.csv"),
    ("align single.csv out.npz", "single.csv: at least two demonstrations are needed, got 1"),
    ("align still.csv out.npz --window 0.2", "trajectories must move: every coordinate is"),
    ("align own.csv out.npz --time-step 0", f"{WITHIN}0.0 s"),
    ("align own.csv out.npz --time-step nan", f"{WITHIN}nan s"),
    ("align own.csv out.npz --time-step 1e-12", "time_step must leave at most 16777216 samples"),
    ("align own.csv out.npz --time-step fast", "argument --time-step: invalid float value: 'fast'"),
    ("align own.csv out.npz --window 2", "window must be in (0, 1], a fraction of the longest"),
    ("align own.csv out.npz --reference 9", "reference must be one of the demonstrations 1, 2"),
    ("align own.csv out.npz --velocities z", "velocities must be columns of x, y, got z"),
    ("align own.csv out.npz --derive dx=x", "--derive needs --smooth PERIOD"),
    ("align own.csv out.npz --derive dx --smooth 0.3", "argument --derive: must be VELOCITY="),
    (
        "align own.csv out.npz --derive dz=z --smooth 0.3",
        "positions of --derive must be columns",
    ),
    ("align own.csv out.npz --smooth nan", "period must be positive and at most the duration"),
    ("align own.csv out.npz --fastest -1", "fastest must be positive, got "),
    ("align own.csv out.npz --marker 1 2 3", "argument --marker: expected 4 arguments"),
    ("align own.csv out.npz --marker 1 2 3 4", "markers and places must be (K, 2) with K >= 4"),
    (
        "align own.csv out.npz --velocities y --marker 2 8 0 0",
        "with markers the columns must be x",
    ),
    (
        "align targets.csv out.npz",
        "each target must have at least two demonstrations, got one of [",
    ),
    ("align milliseconds.csv out.npz", f"{MILLISECONDS} every 0.1 s; divide it by 1000, or name "),
    ("train demonstrations=milliseconds.csv", f"{MILLISECONDS} every 0.1 s; divide it by 1000, or"),
    ("align own.csv out.npz --names a", "own.csv: names must be 2 different names"),
    ("draw out.txt", "out.txt: demonstrations are written to a .npz file"),
    ("draw nowhere/out.npz", "nowhere/out.npz: there is no folder nowhere"),
    ("draw ready.npz", "ready.npz is there already: choose another name"),
    ("draw own.npz", "own.csv is there already: choose another name"),
    ("draw out.npz --time-step 1", "the time step must be from 0.01 to 0.3 s, got 1 s"),
    ("draw out.npz --time-step nan", "the time step must be from 0.01 to 0.3 s, got nan s"),
    ("draw out.npz extra", "unrecognized arguments: extra"),
    ("export policy.pt", "the following arguments are required: out"),
    ("export policy.pt old.pt2", "old.pt2 is there already: choose another name"),
    ("export missing.pt out.pt2", "there is no file missing.pt"),
    ("export cut.pt out.pt2", f"cut.pt: must be a file of save_policy: {NO_ZIP}"),
    ("export wide.pt out.pt2", "wide.pt: widths must have squares that are positive and finite"),
    ("export none.pt out.pt2", "none.pt: a policy must have centres, inputs and actions, got 0"),
    ("export pipe.csv out.pt2", "pipe.csv: must be a file of save_policy: must be a regular file"),
    ("export /dev/zero out.pt2", "/dev/zero: must be a file of save_policy: must be a regular"),
    ("export policy.pt out.txt", "an exported policy must be a .pt2 or .onnx file, got out.txt"),
    ("export policy.pt nowhere/out.pt2", "there is no folder nowhere"),
    ("export policy.pt folder.pt2", "folder.pt2 is there already: choose another name"),
)


@pytest.mark.parametrize(("line", "message"), LINES, ids=[line for line, _ in LINES])
def test_command_line_that_makes_no_sense_is_one_line_and_leaves_nothing(
    folder: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
    line: str,
    message: str,
) -> None:
    monkeypatch.chdir(folder)
    before = contents(folder)
    with pytest.raises(SystemExit) as ended:
        run_command(monkeypatch, *shlex.split(line))
    said, code = capfd.readouterr().err, ended.value.code
    if isinstance(code, str):  # which Python prints as it exits
        said, code = f"{said}{code}\n", 1
    assert said.startswith(f"error: {message}") and said.count("\n") == 1 and said[-1] == "\n"
    assert len(said) < LONGEST and code in (1, 2)
    assert contents(folder) == before


def test_at_least_a_hundred_command_lines_are_tried_each_once() -> None:
    assert len(LINES) == len(dict(LINES)) >= 100
