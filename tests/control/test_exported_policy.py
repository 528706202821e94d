"""A policy as a file of ONNX, and files of either kind that cannot be written."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from tests.helpers.draws import Draws
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match

NAMES, UNITS, TARGET = ("q", "dq", "x"), ("rad", "rad/s", "m"), ("y", "z")
SPACE = StateSpace(NAMES, UNITS, (0,), joint_match(NAMES, UNITS))
Make = Callable[..., StatePolicy]


@pytest.fixture
def make(draws: Draws) -> Make:
    """A policy of an angle and two plain entries, with targets of these names, that moves much."""

    def make(target_names: Sequence[str] = ()) -> StatePolicy:
        inputs = 4 + len(target_names)
        u_max, u_middle = torch.tensor([3.5, 2.0]), torch.tensor([0.0, 1.0])
        network = RBFPolicy(draws.normal(9, inputs), u_max, torch.ones(inputs), u_middle)
        network.weights.data.copy_(5 * draws.normal(9, 2))
        return StatePolicy(network.requires_grad_(False), SPACE, 0.1, target_names)

    return make


@pytest.fixture
def session() -> Callable[[Path], Any]:
    """What opens a file of ONNX; without the extra, the test is skipped."""
    for library in ("onnx", "onnxscript"):
        pytest.importorskip(library, reason="needs the extra onnx")
    runtime = pytest.importorskip("onnxruntime", reason="needs the extra test")
    return lambda path: runtime.InferenceSession(path, providers=["CPUExecutionProvider"])


@pytest.mark.parametrize("target_names", [(), TARGET])
@pytest.mark.parametrize(("batch", "shapes"), [(False, [()]), (True, [(0,), (1,), (2,), (100,)])])
def test_onnx_acts_as_the_policy_does_in_float64(
    make: Make,
    session: Callable[[Path], Any],
    tmp_path: Path,
    draws: Draws,
    target_names: Sequence[str],
    batch: bool,
    shapes: list[tuple[int, ...]],
) -> None:
    policy = make(target_names)
    policy.export(tmp_path / "policy.onnx", batch)
    program = session(tmp_path / "policy.onnx")
    for shape in shapes:
        inputs = {"state": 2 * draws.normal(*shape, 3).numpy()}
        if target_names:
            inputs["target"] = draws.normal(*shape, 2).numpy()
        (action,) = program.run(["action"], inputs)
        assert action.dtype == np.float64 and action.shape == (*shape, 2)
        np.testing.assert_allclose(action, policy(*inputs.values()), rtol=0, atol=1e-12)


def test_onnx_names_its_inputs_and_the_dimension_of_a_batch(
    make: Make, session: Callable[[Path], Any], tmp_path: Path
) -> None:
    make(TARGET).export(tmp_path / "policy.onnx", batch=True)
    program = session(tmp_path / "policy.onnx")
    named = [(each.name, each.shape) for each in program.get_inputs() + program.get_outputs()]
    assert named == [("state", ["N", 3]), ("target", ["N", 2]), ("action", ["N", 2])]


def test_onnx_is_one_file_which_is_written_in_silence(
    make: Make,
    session: Callable[[Path], Any],
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    caplog: pytest.LogCaptureFixture,
    recwarn: pytest.WarningsRecorder,
) -> None:
    make().export(tmp_path / "policy.onnx")
    assert os.listdir(tmp_path) == ["policy.onnx"]
    assert not recwarn.list and capfd.readouterr() == ("", "")
    assert [record for record in caplog.records if record.levelno >= logging.WARNING] == []


def test_onnx_refuses_other_shapes_and_dtypes_but_not_nan(
    make: Make, session: Callable[[Path], Any], tmp_path: Path
) -> None:
    make().export(tmp_path / "policy.onnx")
    program = session(tmp_path / "policy.onnx")
    for state, complaint in (
        (np.zeros(4), "Got: 4 Expected: 3"),
        (np.zeros((1, 3)), "Got: 2 Expected: 1"),
        (np.zeros(3, dtype=np.float32), r"expected: \(tensor\(double\)\)"),
    ):
        with pytest.raises(Exception, match=complaint):
            program.run(None, {"state": state})
    (action,) = program.run(None, {"state": np.array([0.0, np.nan, 0.0])})
    assert np.isnan(action).all()


@pytest.mark.parametrize("library", ["onnx", "onnxscript"])
def test_missing_extra_is_one_line_that_says_how_to_get_it(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, library: str
) -> None:
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(ModuleNotFoundError) as error:
        make().export(tmp_path / "policy.onnx")
    line = "writing a .onnx file needs onnx and onnxscript: pip install 'torch_pmil[onnx]'"
    assert str(error.value) == line
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["policy.txt", "policy", "policy.pt", ".onnx", "policy.ONNX"])
def test_other_endings_are_refused(make: Make, tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"must be a \.pt2 or \.onnx file, got .*policy|onnx"):
        make().export(tmp_path / name)
    assert os.listdir(tmp_path) == []


@pytest.mark.parametrize("name", ["policy.pt2", "policy.onnx"])
def test_file_that_cannot_be_written_whole_leaves_the_old_one(
    make: Make,
    request: pytest.FixtureRequest,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    name: str,
) -> None:
    if name == "policy.onnx":
        request.getfixturevalue("session")

    def save_half(exported: object, file: Any = None, f: Path | None = None, **_: object) -> None:
        (f.write_bytes if f else file.write)(b"half")
        raise OSError("no space left")

    monkeypatch.setattr(torch.export, "save", save_half)
    monkeypatch.setattr(torch.onnx, "export", save_half)
    (tmp_path / name).write_bytes(b"old")
    with pytest.raises(OSError, match="no space left"):
        make().export(tmp_path / name)
    assert os.listdir(tmp_path) == [name]
    assert (tmp_path / name).read_bytes() == b"old"
