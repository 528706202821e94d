"""What a sweep over runs (``python scripts/train.py -m seed=range(10)``) must fulfil before its first run starts."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from importlib.util import find_spec
from itertools import product

from hydra.core.global_hydra import GlobalHydra
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.experimental.callback import Callback
from omegaconf import DictConfig

EXTRAS = {"hydra_ray_launcher": "ray", "hydra_submitit_launcher": "slurm"}  # of setup.cfg, by the launcher's module


class SweepCheck(Callback):
    """Ends a sweep with one line if its launcher is not installed, or if two of its runs would write to one folder.

    A Hydra callback; it exits by itself, since Hydra turns an exception of a callback into a warning.
    """

    def on_multirun_start(self, config: DictConfig, **kwargs: object) -> None:
        """Check before anything is launched."""
        for complaint in (missing_launcher(config), shared_folder(config)):
            if complaint:
                sys.exit(f"error: {complaint}")


def missing_launcher(config: DictConfig) -> str | None:
    """What to install for the launcher; None if it is there."""
    module = config.hydra.launcher._target_.split(".")[1]
    if find_spec(f"hydra_plugins.{module}"):
        return None
    launcher = config.hydra.runtime.choices["hydra/launcher"]
    return f'hydra/launcher={launcher} needs {module.replace("_", "-")}: pip install "torch_pmil[{EXTRAS[module]}]"'


def shared_folder(config: DictConfig) -> str | None:
    """Which two runs would write to one folder; None if all have their own."""
    loader = GlobalHydra.instance().config_loader()
    runs: dict[str, str] = {}
    for overrides in runs_of(config):
        out, run = loader.load_sweep_config(config, overrides).out, " ".join(overrides)
        if out in runs:
            return f"two runs would write to {out}: {runs[out]} and {run}; let out name what differs, as out=runs/a_${{a}}/seed_${{seed}}"
        runs[out] = run
    return None


def runs_of(config: DictConfig) -> Iterator[list[str]]:
    """Overrides of each run, as Hydra's own sweeper makes them."""
    parser = OverridesParser.create(config_loader=GlobalHydra.instance().config_loader())
    choices = [
        [f"{override.get_key_element()}={value}" for value in override.sweep_string_iterator()]
        if override.is_sweep_override()
        else [override.input_line]
        for override in parser.parse_overrides(list(config.hydra.overrides.task))
    ]
    return (list(run) for run in product(*choices))
