"""A sweep over runs: what the settings come to, and what is refused before the first run."""

from __future__ import annotations

from collections.abc import Iterator
from configparser import ConfigParser
from pathlib import Path

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.hydra import Hydra
from hydra.core.global_hydra import GlobalHydra
from hydra.types import RunMode
from omegaconf import DictConfig

from torch_pmil import cli
from torch_pmil.runs import sweep
from torch_pmil.runs.sweep import (
    SweepCheck,
    missing_launcher,
    register_launchers,
    runs_of,
    shared_folder,
)

ROOT = Path(__file__).parents[2]
CONFIG = Path(cli.__file__).parent / "config"


@pytest.fixture(autouse=True)
def hydra() -> Iterator[None]:
    register_launchers(CONFIG / "launcher")
    with initialize_config_dir(str(CONFIG), version_base="1.3"):
        yield


def sweep_over(*overrides: str) -> DictConfig:
    """The configuration that Hydra gives the callbacks of a sweep."""
    instance: Hydra = GlobalHydra.instance().hydra
    return instance.compose_config(
        "train", list(overrides), run_mode=RunMode.MULTIRUN, with_log_configuration=False
    )


def test_sweeps_run_on_joblib_with_as_many_jobs_as_cores() -> None:
    launcher = sweep_over("seed=range(2)").hydra.launcher
    assert launcher._target_.endswith("JoblibLauncher")
    assert launcher.n_jobs == -1


def test_ray_starts_a_cluster_of_its_own_with_a_process_for_each_run() -> None:
    ray = sweep_over("hydra/launcher=ray").hydra.launcher.ray
    assert ray.init.address == "local"
    assert (ray.remote.num_cpus, ray.remote.max_calls) == (1, 1)


def test_ray_cluster_joins_one_that_runs_and_leaves_its_memory_alone() -> None:
    ray = sweep_over("hydra/launcher=ray_cluster").hydra.launcher.ray
    assert ray.init == {"address": "auto", "object_store_memory": None}
    assert (ray.remote.num_cpus, ray.remote.max_calls) == (1, 1)


def test_slurm_jobs_take_one_core_each_and_settings_can_be_changed() -> None:
    words = ("hydra.launcher.partition=short", "hydra.launcher.timeout_min=90")
    launcher = sweep_over("hydra/launcher=submitit_slurm", *words).hydra.launcher
    assert (launcher.tasks_per_node, launcher.cpus_per_task) == (1, 1)
    assert (launcher.partition, launcher.timeout_min) == ("short", 90)


def test_a_single_run_is_where_it_was() -> None:
    config = compose("train", ["seed=3"], return_hydra_config=True)
    assert config.out == "runs/double_pendulum/seed_3"
    assert (config.hydra.run.dir, config.hydra.output_subdir) == (".", None)


def test_runs_of_handwriting_are_apart_by_shape_and_robot() -> None:
    writing = ("experiment=handwriting,handwriting_biorob", "demonstrations=lasa:Sine,lasa:Angle")
    config = compose("train", ["experiment=handwriting", "demonstrations=lasa:Sine", "seed=3"])
    assert config.out == "runs/handwriting_Sine/seed_3"
    assert shared_folder(sweep_over(*writing, "seed=range(2)")) is None


def test_runs_are_the_product_of_what_is_swept() -> None:
    assert list(runs_of(sweep_over("seed=range(2)", "trials=3", "demonstrations=a.npz,b.npz"))) == [
        [f"seed={seed}", "trials=3", f"demonstrations={file}.npz"]
        for seed in (0, 1)
        for file in "ab"
    ]


def test_runs_with_folders_of_their_own_are_let_through() -> None:
    assert shared_folder(sweep_over("seed=range(10)")) is None
    words = ("seed=range(2)", "trials=4,8", "out=runs/trials_${trials}/seed_${seed}")
    assert shared_folder(sweep_over(*words)) is None


def test_two_runs_with_one_folder_are_refused() -> None:
    complaint = shared_folder(sweep_over("seed=range(2)", "trials=4,8"))
    assert complaint is not None
    assert complaint.startswith(
        "two runs would write to runs/double_pendulum/seed_0: seed=0 trials=4 and seed=0 trials=8; "
    )


@pytest.mark.parametrize(
    ("launcher", "module", "extra"),
    [
        ("ray", "hydra_ray_launcher", "ray"),
        ("ray_cluster", "hydra_ray_launcher", "ray"),
        ("submitit_slurm", "hydra_submitit_launcher", "slurm"),
    ],
)
def test_missing_launcher_is_named_with_its_extra(
    monkeypatch: pytest.MonkeyPatch, launcher: str, module: str, extra: str
) -> None:
    monkeypatch.setattr(sweep, "find_spec", {f"hydra_plugins.{module}": None}.__getitem__)
    complaint = missing_launcher(sweep_over(f"hydra/launcher={launcher}"))
    assert (
        complaint == f"hydra/launcher={launcher} needs {module.replace('_', '-')}: pip install "
        f'"torch_pmil[{extra}]"'
    )


def test_extras_hold_what_the_message_asks_for() -> None:
    settings = ConfigParser()
    settings.read(ROOT / "setup.cfg")
    for module, extra in sweep.EXTRAS.items():
        packages = settings["options.extras_require"][extra]
        assert packages.strip().startswith(module.replace("_", "-"))


def test_overrides_that_make_no_configuration_are_left_to_hydra() -> None:
    SweepCheck().on_multirun_start(sweep_over("sead=1,2"))
