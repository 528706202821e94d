"""Learn an experiment from its demonstrations and show what was learned.

Example:
    pmil train experiment=double_pendulum seed=0 trials=12 out=runs/double_pendulum/seed_0
    pmil train noise_std=0.03 search.final_iterations=60
    pmil train settings=mine.yaml seed=1
    pmil train -m "seed=range(10)"

A run that was stopped goes on with the same command and resume=true; one that has ended is replaced
with overwrite=true.
"""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import NoReturn

import hydra
import torch
from hydra.core.hydra_config import HydraConfig
from hydra.errors import CompactHydraException, HydraException
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from torch_pmil.cli import Parser, lasting_output, lost_output
from torch_pmil.envs.operator import RobotError, RunStopped
from torch_pmil.files import bounded_line, in_words
from torch_pmil.runs.diagnosis.before_a_run import check
from torch_pmil.runs.lock import alone_in
from torch_pmil.runs.overrides import as_text, check_overrides
from torch_pmil.runs.pictures import tell_all
from torch_pmil.runs.printing import (
    making_the_rest,
    print_trial,
    say,
    warn_incomplete,
    warn_of,
    warnings_in_one_line,
)
from torch_pmil.runs.run_folder import FinishedRunError
from torch_pmil.runs.settings import (
    RunSettings,
    first_line,
    help_lines,
    settings_of,
    with_file,
    word_of,
)
from torch_pmil.runs.summaries import is_finished
from torch_pmil.runs.sweep import register_launchers
from torch_pmil.runs.training import RunResult, train
from torch_pmil.tasks.registry import EXPERIMENTS, demonstrations_from, load_experiment
from torch_pmil.tasks.task import Task

CONFIG = Path(__file__).parent / "config"
HELP = """\
usage: pmil train [settings=FILE] [NAME=VALUE ...]

Learn an experiment from its demonstrations. The experiments:

{}

The settings, as they would be now:

{}

FILE is YAML with NAME: VALUE in each line, like settings.yaml in the folder of a run. Settings on
the command line override it. The value null means the experiment's own setting.

pmil train -m "seed=range(10)" learns several runs, as many at once as there are cores."""
FULL_ERROR = "HYDRA_FULL_ERROR"  # the variable with which Hydra raises its errors


def main() -> None:
    """Read the command line and learn."""
    parser = Parser(prog="pmil train", add_help=False)
    parser.add_argument("overrides", nargs="*")
    parser.add_argument("-m", "--multirun", action="store_true")
    parser.add_argument("-h", "--help", action="store_true")
    try:
        given = parser.parse_intermixed_args(with_file(sys.argv[1:]))
        overrides = [as_text(word) for word in given.overrides]
        check_overrides(overrides, given.multirun)
        if given.help:
            with hydra_errors():
                print(help_of(overrides))
            return
    except (ImportError, ValueError, OSError) as error:
        sys.exit(f"error: {in_words(error)}")
    sys.argv[1:] = [*(["--multirun"] if given.multirun else []), *overrides]
    register_launchers(CONFIG / "launcher")
    command = ["pmil", "train", *sys.argv[1:]]
    if given.multirun:  # else joblib warns, after Ctrl-C, of what ended processes left
        os.environ.setdefault("PYTHONWARNINGS", "ignore:resource_tracker")
    try:
        with hydra_errors():
            learn()
    except KeyboardInterrupt:  # of a sweep: a run alone ends by itself
        if not given.multirun:
            raise
        stop("", command)


def help_of(overrides: list[str]) -> str:
    """What ``pmil train --help`` says: all settings, with their values on this command line."""
    with hydra.initialize_config_dir(str(CONFIG), version_base="1.3"):
        settings = settings_of(hydra.compose("train", overrides))
    values = settings.adjustable | task_of(settings).adjustable
    words = {name: word_of(name, value) for name, value in values.items()}
    wide = max(map(len, EXPERIMENTS))
    known = (f"  {name:{wide}}  {shipped.sentence}" for name, shipped in EXPERIMENTS.items())
    return HELP.format("\n".join(known), "\n".join(help_lines(words)))


@contextmanager
def hydra_errors() -> Iterator[None]:
    """End the command with one line where Hydra would print pages, unless its variable is set."""
    if FULL_ERROR in os.environ:
        yield
        return
    os.environ[FULL_ERROR] = "1"
    try:
        yield
    except (HydraException, OmegaConfBaseException) as error:
        line = first_line(error)
        sys.exit(line if "error: " in line else f"error: {line}")
    finally:
        del os.environ[FULL_ERROR]


@hydra.main(version_base="1.3", config_path=str(CONFIG), config_name="train")
def learn(config: DictConfig) -> None:
    """Learn, then show: one run of a sweep, or the only one."""
    with lasting_output():  # a sweep's run may be in a process of its own
        run(config)


def run(config: DictConfig) -> None:
    """Learn, save, show."""
    torch.set_num_threads(1)  # the matrices are small: more threads wait for each other
    job = HydraConfig.get()
    alone = job.mode == RunMode.RUN
    label = "" if alone else f"{name_of(config)}: "
    given = sys.argv[1:]
    if not alone:  # Hydra escapes braces
        given = [override.replace("\\", "") for override in job.overrides.task]
    command = ["pmil", "train", *given]
    try:
        settings = settings_of(config)
        os.chdir(job.runtime.cwd)  # of the sweep's start: a cluster's worker may be elsewhere
        with warnings_in_one_line(label):
            task = task_of(settings)
            warn_of(label, check(task))
            with alone_in(settings.folder):
                result = learned(label, alone, task, settings, command)
                show(label, result.task, result, settings.folder)
    except (KeyboardInterrupt, RunStopped):
        stop(label, command)
    except RobotError as error:
        further = again(command, "resume=true")
        fail(f"{label}error: {in_words(error)}; go on with: {further}", label)
    except FinishedRunError as error:
        fail(f"{label}error: {error}, as {again(command, 'overwrite=true')}", label)
    except (ImportError, ValueError, OSError, RuntimeError) as error:
        fail(f"{label}error: {in_words(error)}", label)


def learned(
    label: str, alone: bool, task: Task, settings: RunSettings, command: list[str]
) -> RunResult:
    """Learn and save."""
    if len(command) == 2:
        command = [*command, f"experiment={settings.experiment}"]
    return train(
        task,
        settings.seed,
        settings.trials,
        settings.folder,
        shlex.join(command),
        progress_bar=alone,
        on_trial=partial(print_trial, label, task),
        resume=settings.resume,
        logger=settings.logger,
        overwrite=settings.overwrite,
        settings=settings.repeated,
        announce=partial(say, label),
    )


def again(command: list[str], setting: str) -> str:
    """The command line with ``setting`` in place of any ``resume`` or ``overwrite``."""
    kept = [word for word in command if word.partition("=")[0] not in ("resume", "overwrite")]
    return shlex.join([*kept, setting])


def name_of(config: DictConfig) -> str:
    """Name of a run of a sweep: its folder, if that can be read."""
    try:
        return str(config.out)
    except OmegaConfBaseException:
        return "a run"


def show(label: str, task: Task, result: RunResult, out: Path) -> None:
    """Report, print, draw and film a saved run; it is an error only if it is no longer there."""
    failures = tell_all(label, task, result, out)
    if lost := lost_output():
        failures.append(f"standard output: {bounded_line(lost)}")
    if not is_finished(out):
        fail(f"{label}error: {out} was removed or renamed: what was learned is not there", label)
    warn_incomplete(label, failures, making_the_rest(out))


def task_of(settings: RunSettings) -> Task:
    """The task that the settings name, with their demonstrations if they have some."""
    source = settings.demonstrations
    demonstrations = None if source is None else demonstrations_from(source)
    return load_experiment(settings.experiment, demonstrations).with_settings(**settings.changes)


def stop(label: str, command: list[str]) -> NoReturn:
    """End a run that was stopped, or a sweep, with the command that goes on with it."""
    print(f"\n{label}stopped; go on with: {again(command, 'resume=true')}", file=sys.stderr)
    sys.exit(130)


def fail(message: str, label: str) -> NoReturn:
    """End the run with a message; the others of a sweep, which has labels, continue."""
    if not label:
        sys.exit(message)
    print(message, file=sys.stderr, flush=True)
    raise CompactHydraException(message)
