"""Sweeps over runs, ``pmil train -m "seed=range(10)"``: launchers, and a check before them."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import suppress
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.plugins import Plugins
from hydra.errors import CompactHydraException
from hydra.experimental.callback import Callback
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from torch_pmil.runs.settings import SETTINGS, RunSettings, first_line
from torch_pmil.tasks.registry import run_name

# the package's extra that installs a launcher, by the launcher's module
EXTRAS = {"hydra_ray_launcher": "ray", "hydra_submitit_launcher": "slurm"}

OmegaConf.register_new_resolver("run_name", run_name, replace=True)


# all settings, for Hydra: those of a run by their defaults, those of a task as null
schema = OmegaConf.create({})
for setting in SETTINGS:
    OmegaConf.update(schema, setting, getattr(RunSettings, setting, None), force_add=True)
ConfigStore.instance().store("settings", schema)


def register_launchers(folder: Path) -> None:
    """Make each YAML file of a folder a choice of ``hydra/launcher``, before that of the package.

    In Hydra's search path such a file would be taken for values of the package's own schema, with a
    warning. Registered, it can be chosen even where the package is not installed, and
    :class:`SweepCheck` says what to install.
    """
    # read by Ray when it is imported: lines that differ in numbers alone are not the same
    os.environ.setdefault("RAY_DEDUP_LOGS", "0")
    Plugins.instance()  # loads the launchers' packages, which register their own
    for path in sorted(folder.glob("*.yaml")):
        ConfigStore.instance().store(
            group="hydra/launcher", name=path.stem, node=OmegaConf.load(path), provider=str(path)
        )


class SweepCheck(Callback):
    """Ends a sweep with one line if its launcher is missing or two runs would share a folder.

    It exits by itself: Hydra turns an exception of a callback into a warning.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Check before anything is launched."""
        complaint = missing_launcher(config)
        # the sweeper itself, after this, says which overrides make no config
        try:
            with suppress(CompactHydraException):
                complaint = complaint or shared_folder(config)
        except OmegaConfBaseException as error:
            complaint = f"out cannot be read: {first_line(error)}"
        if complaint:
            sys.exit(f"error: {complaint}")


def missing_launcher(config: DictConfig) -> str | None:
    """The complaint that the launcher is not installed, with what to install; None if it is."""
    module = config.hydra.launcher._target_.split(".")[1]
    if find_spec(f"hydra_plugins.{module}"):
        return None
    launcher = config.hydra.runtime.choices["hydra/launcher"]
    package = module.replace("_", "-")
    return f'hydra/launcher={launcher} needs {package}: pip install "torch_pmil[{EXTRAS[module]}]"'


def shared_folder(config: DictConfig) -> str | None:
    """The complaint that two runs would write to one folder; None if each has its own."""
    loader = GlobalHydra.instance().config_loader()
    runs: dict[str, str] = {}
    for overrides in runs_of(config):
        out, run = loader.load_sweep_config(config, overrides).out, " ".join(overrides)
        if out in runs:
            return (
                f"two runs would write to {out}: {runs[out]} and {run}; let out name what differs, "
                f"as out=runs/a_${{a}}/seed_${{seed}}"
            )
        runs[out] = run
    return None


def runs_of(config: DictConfig) -> Iterator[list[str]]:
    """Overrides of each run, as Hydra's own sweeper makes them."""
    parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
    given: Any = OmegaConf.to_container(config.hydra.overrides.task, resolve=False)
    choices: list[list[Any]] = [
        [f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()]
        if override.is_sweep_override()
        else [override.input_line]
        for override in parser.parse_overrides(given)
    ]
    return (list(run) for run in product(*choices))
