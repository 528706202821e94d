"""Small demonstrations in every format that is read, each written as its own writers do."""

from __future__ import annotations

import importlib
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from scipy.io import savemat

from torch_pmil.demonstrations import Demonstrations

COUNT, SAMPLES, STEP = 4, 20, 0.1
TIME = STEP * np.arange(SAMPLES)
WALKS = np.random.default_rng(0).normal(size=(COUNT, SAMPLES, 2)).cumsum(1)


def write_npz(folder: Path) -> Path:
    """With two targets."""
    targets = torch.tensor([[0.0], [0.0], [1.0], [1.0]])
    shown = Demonstrations(torch.from_numpy(WALKS), STEP, ("x", "y"), targets, ("place",))
    shown.save(folder / "walks.npz")
    return folder / "walks.npz"


def write_packed_npz(folder: Path) -> Path:
    """As ``numpy.savez_compressed`` does."""
    np.savez_compressed(
        folder / "walks.npz", positions=WALKS, time_step=STEP, names=np.array(["x", "y"])
    )
    return folder / "walks.npz"


def write_csv(folder: Path) -> Path:
    """One file for all."""
    rows = [
        f"{number},{t:.3f},{x:.6f},{y:.6f},{number // 2}"
        for number, walk in enumerate(WALKS)
        for t, (x, y) in zip(TIME, walk, strict=True)
    ]
    (folder / "walks.csv").write_text("\n".join(["demonstration,time,x,y,target place", *rows]))
    return folder / "walks.csv"


def write_csv_folder(folder: Path) -> Path:
    """One file for each."""
    for number, walk in enumerate(WALKS):
        rows = [f"{t:.3f},{x:.6f},{y:.6f}" for t, (x, y) in zip(TIME, walk, strict=True)]
        (folder / f"walk_{number}.csv").write_text("\n".join(["time,x,y", *rows]))
    return folder


def write_lasa(folder: Path) -> Path:
    """A shape."""
    demos = np.empty((1, COUNT), dtype=object)
    demos[0] = [{"pos": walk.T, "t": TIME[None], "vel": walk.T, "dt": STEP} for walk in WALKS]
    savemat(folder / "shape.mat", {"demos": demos}, do_compression=True)
    return folder / "shape.mat"


def write_robomimic(folder: Path) -> Path:
    """Numbers packed by gzip, and pictures beside them."""
    h5py = importlib.import_module("h5py")
    with h5py.File(folder / "low_dim.hdf5", "w") as file:
        for number, walk in enumerate(WALKS):
            observed = file.create_group(f"data/demo_{number}/obs")
            observed.create_dataset("hand", data=walk, compression="gzip", shuffle=True)
            observed.create_dataset("gap", data=walk[:, 0])
            observed.create_dataset("image", data=np.zeros((SAMPLES, 2, 2, 3), np.uint8))
        settings = {"env_name": "Lift", "env_kwargs": {"control_freq": 20}}
        file["data"].attrs["env_args"] = json.dumps(settings)
    return folder / "low_dim.hdf5"


def write_minari(folder: Path) -> Path:
    """A folder with one HDF5 file."""
    h5py = importlib.import_module("h5py")
    (folder / "data").mkdir()
    (folder / "data" / "metadata.json").write_text(json.dumps({"data_format": "hdf5"}))
    with h5py.File(folder / "data" / "main_data.hdf5", "w") as file:
        for number, walk in enumerate(WALKS):
            file.create_dataset(f"episode_{number}/observations", data=walk, chunks=(7, 2))
    return folder


def write_lerobot_2(folder: Path) -> Path:
    """One file for each episode, with lists of no fixed size."""
    parquet = importlib.import_module("pyarrow.parquet")
    for number in range(COUNT):
        path = _lerobot(folder) / f"episode_{number:06d}.parquet"
        parquet.write_table(_frames([number], fixed=False), path)
    return folder


def write_lerobot_3(folder: Path) -> Path:
    """One file for all."""
    parquet = importlib.import_module("pyarrow.parquet")
    path = _lerobot(folder) / "file-000.parquet"
    parquet.write_table(_frames(list(range(COUNT)), fixed=True), path)
    return folder


def _lerobot(folder: Path) -> Path:
    (folder / "meta").mkdir(exist_ok=True)
    feature = {"dtype": "float32", "shape": [2], "names": ["x", "y"]}
    info = {"fps": 10, "features": {"observation.state": feature}}
    (folder / "meta" / "info.json").write_text(json.dumps(info))
    (folder / "data" / "chunk-000").mkdir(parents=True, exist_ok=True)
    return folder / "data" / "chunk-000"


def _frames(episodes: list[int], fixed: bool) -> object:
    pyarrow = importlib.import_module("pyarrow")
    kind = pyarrow.list_(pyarrow.float32(), *((2,) if fixed else ()))
    rows = len(episodes)
    return pyarrow.table(
        {
            "episode_index": np.repeat(episodes, SAMPLES),
            "timestamp": np.tile(TIME, rows).astype(np.float32),
            "observation.state": pyarrow.array(WALKS[episodes].reshape(-1, 2).tolist(), kind),
        }
    )


WRITERS: dict[str, tuple[Callable[[Path], Path], str, dict[str, object]]] = {
    "npz": (write_npz, "", {}),  # writer, library that it needs, options of loading
    "packed npz": (write_packed_npz, "", {}),
    "csv": (write_csv, "", {}),
    "csv folder": (write_csv_folder, "", {}),
    "lasa": (write_lasa, "", {}),
    "robomimic": (write_robomimic, "h5py", {"keys": ["hand"]}),
    "minari": (write_minari, "h5py", {"time_step": STEP}),
    "lerobot 2": (write_lerobot_2, "pyarrow", {}),
    "lerobot 3": (write_lerobot_3, "pyarrow", {}),
}
