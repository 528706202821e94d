"""A checkpoint that somebody changed executes nothing, fills no memory and makes nothing wait."""

from __future__ import annotations

import json
import os
import re
import resource
import shutil
import time
import warnings
import zipfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import torch
from tensordict import NonTensorData, TensorDict
from torchrl.checkpoint import Checkpoint, CheckpointError, GlobalRNGState

from tests.helpers.hostile import Trap, members_of, write_members
from tests.helpers.short_run import SEED, TRIALS, run, short_experiment, stopped_run
from torch_pmil.runs.own_files import LIST, ForeignFileError
from torch_pmil.runs.training import make_trainer
from torch_pmil.trainer.checkpoints import (
    newest_undamaged,
    read_checkpoint,
    rotation_in,
    saved_checkpoints,
)
from torch_pmil.trainer.trainer import PMILTrainer

Members = dict[str, bytes]
RNG, LOSS, POLICY = "components/0003-rng", "components/0001-loss_module", "components/0002-policy"
COLLECTOR, PROGRESS = "components/0000-collector", "components/0009-trainer_module.progress"
EXPERIENCE = "components/0005-trainer_module.experience"
SECONDS = 5


@pytest.fixture(scope="module")
def stopped(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that was stopped in the search of its second trial."""
    return stopped_run(tmp_path_factory.mktemp("runs") / "stopped", "search", 7)


@pytest.fixture
def folder(stopped: Path, tmp_path: Path) -> Path:
    return shutil.copytree(stopped, tmp_path / "run")


@pytest.fixture
def path(folder: Path) -> Path:
    """The newest checkpoint."""
    return saved_checkpoints(rotation_in(folder / "checkpoints"))[0]


def new_trainer(folder: Path) -> PMILTrainer:
    rotation = rotation_in(folder / "checkpoints")
    return make_trainer(short_experiment(), SEED, TRIALS, False, lambda trial: None, None, rotation)


def problem_of(path: Path) -> str:
    """The one line with which an archive is refused."""
    with pytest.raises(CheckpointError) as error:
        read_checkpoint(path)
    assert "\n" not in str(error.value)
    return str(error.value)


def misfit_of(path: Path) -> str:
    """The one line with which a trainer refuses a readable archive that does not fit it.

    The trainer takes the one before; where there is none, the line is an error.
    """
    trainer, saved = new_trainer(path.parents[1]), read_checkpoint(path)
    older = saved_checkpoints(trainer.rotation)[1]
    with pytest.warns(RuntimeWarning, match="the one before it is taken") as warned:
        assert trainer.resume(saved) == older
    older.unlink()
    with pytest.raises(CheckpointError) as error:
        new_trainer(path.parents[1]).resume(saved)
    assert "\n" not in str(error.value)
    assert str(warned[0].message) == f"{error.value}: the one before it is taken"
    return str(error.value).removeprefix(f"checkpoint {path}: ")


def changed(path: Path, change: Callable[[Members], object]) -> None:
    members = members_of(path)
    change(members)
    write_members(path, members)


def edit(members: Members, name: str, change: Callable[[dict], object]) -> None:
    """Change a member of JSON."""
    content = json.loads(members[name])
    change(content)
    members[name] = json.dumps(content).encode()


def edits(name: str, change: Callable[[dict], object]) -> Callable[[Members], None]:
    return lambda members: edit(members, name, change)


def member(name: str, content: bytes) -> Callable[[Members], None]:
    return lambda members: members.update({name: content})


def add(members: Members, component: str, name: str, content: bytes) -> None:
    """Add a member, in the manifest too."""
    members[f"{component}/{name}"] = content

    def list_it(manifest: dict) -> None:
        for record in manifest["components"].values():
            if record["path"] == component and name not in record["files"]:
                record["files"].append(name)

    edit(members, "manifest.json", list_it)


def saved_by_tensordict(data: TensorDict, folder: Path) -> Members:
    data.memmap_(folder)
    return {
        file.relative_to(folder).as_posix(): file.read_bytes()
        for file in folder.rglob("*")
        if file.is_file()
    }


@pytest.mark.parametrize("place", ["sidecar", "top", "unlisted"])
def test_pickle_in_a_checkpoint_is_refused_and_not_executed(
    place: str, folder: Path, path: Path, tmp_path: Path
) -> None:
    """TorchRL executes it, unless the manifest does not list it."""
    mark, top = tmp_path / "sprung", NonTensorData(Trap(tmp_path / "sprung"))
    trap = top if place == "top" else TensorDict({"extra": top}, [])
    files = saved_by_tensordict(trap, tmp_path / "trap")
    assert any(name.endswith("other.pickle") for name in files)

    def spring(members: Members) -> None:
        for name, content in files.items():
            if place == "unlisted":
                members[f"{RNG}/state/{name}"] = content
            elif name != "meta.json" or place == "top":
                add(members, RNG, f"state/{name}", content)
        if place == "sidecar":
            entry = json.loads(files["meta.json"])["extra"]
            edit(members, f"{RNG}/state/meta.json", lambda meta: meta.update(extra=entry))

    changed(path, spring)
    if place != "unlisted":
        with warnings.catch_warnings(), suppress(CheckpointError):  # executed in any case
            warnings.simplefilter("ignore")
            Checkpoint(rng=GlobalRNGState()).load(path, components=["rng"])
        assert mark.exists()
        mark.rmdir()
    assert RNG in problem_of(path)
    with pytest.warns(RuntimeWarning, match=f"{path.name} is damaged .*: the one before it"):
        run(folder, resume=True)
    assert not mark.exists()


def shape_of(shape: object, content: bytes | None = None) -> Callable[[Members], None]:
    """Another shape, and other bytes, of the state of PyTorch's generator."""

    def change(members: Members) -> None:
        edit(members, f"{RNG}/state/meta.json", lambda m: m["tensor_00000000"].update(shape=shape))
        if content is not None:
            members[f"{RNG}/state/tensor_00000000.memmap"] = content

    return change


def adapter_of(adapter: str | None) -> Callable[[Members], None]:
    return edits("manifest.json", lambda m: m["components"]["rng"].update(adapter=adapter))


def repeat_a_tensor(schema: dict) -> None:
    """Memory would grow with the places."""
    schema["items"] = [schema["items"][1]] * 2


NON_TENSOR = "<class 'tensordict.tensorclass.NonTensorData'>"
DAMAGES = [
    (
        edits(f"{RNG}/state/meta.json", lambda meta: meta.update(_type=NON_TENSOR)),
        rf"{RNG}/state/meta\.json, _type must be <class 'tensordict\._td",
    ),
    (
        lambda members: add(members, RNG, "state.pt", b"pickle"),
        rf"members must be those of the components, got '{RNG}/state\.pt'$",
    ),
    *(
        (adapter_of(adapter), ".*component 'rng', adapter must be torchrl.state_dict, got")
        for adapter in ("torchrl.dump_load", "torchrl.json", None)
    ),
    *(
        (edits(f"{RNG}/state.json", lambda s, kind=kind: s.update(kind=kind)), f"{RNG}/state.json")
        for kind in ("numpy", "path", "bytes", "range", "class", ["dict"], None)
    ),
    (edits(f"{RNG}/state.json", repeat_a_tensor), rf"{RNG}/state\.json must be a state, got Key"),
    *(
        (shape_of(shape), ".*tensor_00000000")
        for shape in ([-1], [10**12] * 2, [5055], [1.5], [True], "5056", [[5056]], [1] * 100)
    ),
    *(  # PyTorch cannot count their strides
        (shape_of(shape, b""), r".* must have the bytes of \[0, ")
        for shape in ([0, 2**62, 2**62], [0, 2**64], [0] + [10] * 30)
    ),
    (member("manifest.json", b"[" * 100_000), "manifest.json must be JSON, got lists in lists wit"),
    *(
        (member("manifest.json", content), "manifest.json")
        for content in (b"null", b"[]", b'"text"', b"NaN", b"{}", b"", b"\xff")
    ),
    (edits("manifest.json", lambda manifest: manifest.pop("metadata")), "manifest.json"),
    *(
        (edits("manifest.json", lambda manifest, m=m: manifest.update(metadata=m)), "manifest.json")
        for m in (None, [], "text", 5, float("nan"), {"seed": float("nan")})
    ),
]


@pytest.mark.parametrize(("change", "problem"), DAMAGES, ids=[wanted for _, wanted in DAMAGES])
def test_what_no_trainer_writes_is_damage_in_one_line(
    change: Callable[[Members], object], problem: str, path: Path
) -> None:
    changed(path, change)
    assert re.match(problem, problem_of(path))


def test_endless_member_is_refused_before_it_is_unpacked(path: Path) -> None:
    members = members_of(path)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, content in members.items():
            archive.writestr(name, content)
        with archive.open(f"{RNG}/state/tensor_00000002.memmap", "w") as file:
            for _ in range(600):
                file.write(bytes(2**20))
    assert path.stat().st_size < 4 * 2**20
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert problem_of(path).startswith("members must be stored as they are, got 'components/")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 64 * 2**10  # KiB


def test_members_that_share_their_bytes_are_refused(path: Path) -> None:
    """A directory that lists one place of the file many times."""
    members = members_of(path)
    with zipfile.ZipFile(path, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
        largest = max(archive.infolist(), key=lambda member: member.file_size)
        for number in range(100):
            twin = zipfile.ZipInfo(f"{RNG}/state/tensor_{number + 2:08d}.memmap")
            for field in ("header_offset", "CRC", "file_size", "compress_size"):
                setattr(twin, field, getattr(largest, field))
            archive.filelist.append(twin)
    assert problem_of(path).startswith("members must have at most")


def test_member_of_the_same_name_is_refused(path: Path) -> None:
    with zipfile.ZipFile(path, "a") as archive, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        archive.writestr("manifest.json", b"{}")
    assert problem_of(path) == "must hold each member once, got 'manifest.json' twice"


def make_huge(path: Path) -> None:
    path.touch()
    os.truncate(path, 2**40)


UNREADABLE = {
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "a folder": Path.mkdir,
    "1048576 MiB": make_huge,
}


@pytest.mark.parametrize("came", UNREADABLE)
def test_what_is_no_file_is_refused_at_once_and_the_run_goes_on(came: str, path: Path) -> None:
    path.unlink()
    UNREADABLE[came](path)
    begun = time.monotonic()
    assert problem_of(path) == f"must be a regular file of at most 128 MiB, got {came}"
    assert time.monotonic() - begun < SECONDS
    rotation = rotation_in(path.parent)
    with pytest.warns(RuntimeWarning, match=f"{path.name} is damaged .*{came}.*: the one before"):
        saved = newest_undamaged(rotation)
    assert saved is not None and saved.path == saved_checkpoints(rotation)[1]


def test_pipe_beside_the_checkpoints_does_not_stop_a_run(folder: Path) -> None:
    """Old checkpoints are removed, for which TorchRL would open all."""
    pipe = folder / "checkpoints" / "checkpoint-999999999999.torchrl"
    os.mkfifo(pipe)
    with pytest.raises(ForeignFileError, match=f"{pipe} is not of a run here: move it"):
        run(folder, resume=True)
    own_files = folder / LIST
    content = json.loads(own_files.read_text())["files"]
    own_files.write_text(json.dumps({"files": [*content, f"checkpoints/{pipe.name}"]}))
    with pytest.warns(RuntimeWarning, match="a pipe"):
        run(folder, resume=True)
    rotation = rotation_in(folder / "checkpoints")
    assert len(saved_checkpoints(rotation)) == 1 + rotation.keep_last


def test_link_to_a_checkpoint_is_one(path: Path, tmp_path: Path) -> None:
    shutil.move(path, tmp_path / "elsewhere")
    path.symlink_to(tmp_path / "elsewhere")
    assert read_checkpoint(path).metadata["seed"] == SEED


def test_keys_that_are_numbers_are_refused(path: Path) -> None:
    """Those of one hash take their number squared: thirty seconds in four MiB."""
    key = {"kind": "value", "value": 2**61 - 1}
    items = [[key | {"value": n * key["value"]}, key] for n in range(40_000)]
    content = json.dumps({"kind": "dict", "items": items}).encode()
    changed(path, member(f"{RNG}/state.json", content))
    begun = time.process_time()
    assert f"{RNG}/state.json: keys must be text, got " in problem_of(path)
    assert time.process_time() - begun < SECONDS


def numbers(*values: float) -> bytes:
    return np.array(values).tobytes()


def put(component: str, tensor: int, content: bytes, shape: list[int] | None = None) -> Callable:
    """A change of a tensor, which may have another shape."""

    def change(members: Members) -> None:
        key = f"tensor_{tensor:08d}"
        name = f"{component}/state/{key}.memmap"
        members[name] = content if shape else content + members[name][len(content) :]
        if shape:
            edit(members, f"{component}/state/meta.json", lambda m: m[key].update(shape=shape))

    return change


def put_text(component: str, old: str, new: str) -> Callable:
    def change(members: Members) -> None:
        text = members[f"{component}/state.json"].decode()
        assert old in text
        members[f"{component}/state.json"] = text.replace(old, new, 1).encode()

    return change


NAN = numbers(float("nan"))
MISFITS = [
    (put(POLICY, 0, NAN), "policy.centres must be finite, got nan"),
    (
        put(POLICY, 0, bytes(4 * 6 * 8), [4, 6]),
        "policy.centres must be torch.float64 of shape (5, 6), got torch.float64 of shape (4, 6)",
    ),
    (put(POLICY, 2, numbers(1e4)), "widths must have squares that are positive and finite"),
    (put(POLICY, 5, numbers(-1.0)), "scale must be positive, got -1"),
    (put(LOSS, 4, numbers(float("inf"))), "loss_module.actor_network.log_widths must be finite"),
    (put(LOSS, 8, NAN), "loss_module.dynamics.train_inputs must be finite, got nan"),
    (
        put(LOSS, 8, bytes(4 * 7 * 8), [4, 7]),
        "loss_module.dynamics.train_inputs must be torch.float64 of shape ('n', 8), got",
    ),
    (put(COLLECTOR, 0, NAN), "collector.policy_state_dict.module.policy.centres must be finite"),
    (put(EXPERIENCE, 0, NAN), "experience.observation must be finite, got nan"),
    (
        put(EXPERIENCE, 0, bytes(4 * 5 * 8), [4, 5]),
        "experience.observation must be torch.float64 of shape (8, 4), got torch.float64 of shape",
    ),
    (put_text(COLLECTOR, '"action"', '"force"'), "collector.latest must hold observation, action"),
    (put_text(POLICY, '"weights"', '"heights"'), "policy must hold centres, weights, log_widths"),
    (put_text(PROGRESS, '"exploring"', '"x"'), "trainer_module.progress must hold exploring"),
    (
        put_text(PROGRESS, '"own_error"', '"error"'),
        "progress.trials[0] must hold trial, experience_s",
    ),
    (
        put_text(PROGRESS, '"value":false', '"value":"no"'),
        "trainer_module.progress.exploring must be",
    ),
]


@pytest.mark.parametrize(("change", "complaint"), MISFITS, ids=[text for _, text in MISFITS])
def test_what_does_not_fit_the_experiment_is_named(
    path: Path, change: Callable, complaint: str
) -> None:
    changed(path, change)
    assert misfit_of(path).startswith(complaint)


def test_part_that_cannot_take_its_state_is_named(path: Path) -> None:
    changed(path, put_text(RNG, '"value":3}', '"value":9}'))
    with pytest.raises(CheckpointError, match=r"component rng does not fit: state with version 9"):
        new_trainer(path.parents[1]).resume()


def test_generator_that_would_read_beyond_its_memory_is_refused(path: Path) -> None:
    def beyond(schema: dict) -> None:
        numpy = next(item for item in schema["items"] if item[0]["value"] == "numpy")
        numpy[1]["items"][2]["value"] = 10**6

    changed(path, edits(f"{RNG}/state.json", beyond))
    assert misfit_of(path) == "rng.numpy[2] must be 0 to 624, got 1000000"


def test_run_goes_on_from_the_checkpoint_before_one_that_does_not_fit(
    folder: Path, path: Path
) -> None:
    changed(path, put(POLICY, 0, NAN))
    with pytest.warns(RuntimeWarning, match=r"centres must be finite, got nan: the one before it"):
        assert run(folder, resume=True).summary["experience_s"] > 0


def test_checkpoint_of_another_run_is_not_taken_for_one_that_does_not_fit(path: Path) -> None:
    older = saved_checkpoints(rotation_in(path.parent))[1]
    changed(path, put(POLICY, 0, NAN))
    changed(older, edits("manifest.json", lambda manifest: manifest["metadata"].update(seed=99)))
    with pytest.raises(CheckpointError, match=r"policy\.centres must be finite, got nan$"):
        new_trainer(path.parents[1]).resume()


def test_newest_undamaged_of_no_folder_is_none(tmp_path: Path) -> None:
    assert newest_undamaged(rotation_in(tmp_path / "nowhere")) is None


def test_saved_state_is_what_was_saved(stopped: Path) -> None:
    """Bit for bit what TorchRL reads."""
    path = saved_checkpoints(rotation_in(stopped / "checkpoints"))[0]
    ours, theirs = new_trainer(stopped), new_trainer(stopped)
    assert ours.resume() == path
    theirs.load_from_file(path)
    read, expected = ours.loss_module.state_dict(), theirs.loss_module.state_dict()
    assert read.keys() == expected.keys()
    assert all(torch.equal(read[name], expected[name]) for name in read)
    assert torch.equal(
        ours.experience.transitions["observation"], theirs.experience.transitions["observation"]
    )
