"""What learns the task of one's own robot, in a few lines."""

from __future__ import annotations

import os
import shlex
import sys
from functools import partial
from pathlib import Path
from typing import Self

from torch_pmil.checks import check_whole
from torch_pmil.control.policy_file import save_policy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.files import short
from torch_pmil.runs.diagnosis.before_a_run import check
from torch_pmil.runs.pictures import tell_all
from torch_pmil.runs.printing import print_trial, say, warn_incomplete, warn_of
from torch_pmil.runs.report import write_report
from torch_pmil.runs.training import RunResult, train
from torch_pmil.seeds import SEEDS, Stream
from torch_pmil.tasks.task import MEASURED_STARTS, Task
from torch_pmil.trainer.trials import success_rate


class Learner:
    """Learns a task: base class of :class:`PMIL` and :class:`PILCO`.

    ``task`` holds robot and settings. After :meth:`learn` it is the task as the run saw it,
    ``result`` is the finished run, and ``policy`` a function from the robot's state to its action.
    """

    def __init__(self, task: Task) -> None:
        self.task = self._given = task
        self._learned: tuple[RunResult, Path] | None = None

    def learn(
        self,
        trials: int = 12,
        seed: int = 0,
        out: Path | str | None = None,
        resume: bool | Path | str = False,
        overwrite: bool = False,
    ) -> Self:
        """Learn, print the trials and their results, and write a report with figures.

        Args:
            trials: largest number of trials.
            seed: of the robot's starts, its first motion and the policy; same seed, same run.
            out: folder of the run; runs/NAME/seed_SEED of the environment's name if None.
            resume: whether to continue the run that is there. The folder of another run begins a
                new one with its experience and its newest policy, as for a robot that has changed.
            overwrite: whether to replace the finished run that is there.

        Raises:
            RunStopped, RobotError: the operator ended the run, or the robot cannot be reached;
                ``learn(resume=True)`` continues. A run that begins with another run's experience
                can be continued that way after its first rollout; until then, repeat the same call.
            OSError: the folder cannot be written to.
            TypeError, ValueError: an argument is of another kind or out of range, or the folder
                holds another run.
        """
        if not isinstance(overwrite, bool):
            raise TypeError(f"overwrite must be True or False, got {short(overwrite)}")
        of_run = isinstance(resume, str | os.PathLike) and Path(resume, "run.json").is_file()
        if not (isinstance(resume, bool) or of_run):
            raise ValueError(
                f"resume must be True, False or the folder of a run, got {short(resume)}"
            )
        trials, seed = check_whole("trials", trials, 1), check_whole("seed", seed, *SEEDS)
        if not (out is None or isinstance(out, str | os.PathLike)) or out == "":
            raise TypeError(f"out must be the path of a folder, or None, got {short(out)}")
        out = Path("runs", self.task.name, f"seed_{seed}") if out is None else Path(out)
        warn_of("", check(self._given))
        result = train(
            self._given,
            seed,
            trials,
            out,
            _command(),
            on_trial=partial(print_trial, "", self._given),
            resume=resume,
            logger="csv",
            overwrite=overwrite,
            announce=partial(say, ""),
        )
        self._learned, self.task = (result, out), result.task
        warn_incomplete("", tell_all("", result.task, result, out), "learn(resume=True)")
        return self

    @property
    def result(self) -> RunResult:
        """The finished run; raises RuntimeError before :meth:`learn`."""
        return self._done()[0]

    @property
    def policy(self) -> StatePolicy:
        """The learned policy; raises RuntimeError before :meth:`learn`."""
        return self.result.policy

    def save(self, path: Path | str) -> None:
        """Write the policy into a file that :func:`load_policy` reads."""
        learned = self.policy
        meaning = learned.space, learned.control_period, learned.target_names, learned.actions
        save_policy(path, learned.policy, *meaning)

    def export(self, path: Path | str, batch: bool = False) -> None:
        """Write the policy as a program of PyTorch or ONNX, see :meth:`StatePolicy.export`."""
        self.policy.export(path, batch)

    def evaluate(self, starts: int = MEASURED_STARTS, seed: int = Stream.EVALUATED_STARTS) -> float:
        """Success rate of the policy on the robot, from fresh starts.

        The operator of a physical robot is asked before each rollout; one that is cut short is a
        failure.
        """
        starts, seed = check_whole("starts", starts, 1), check_whole("seed", seed, *SEEDS)
        errors = self.task.errors(self.policy, starts, seed)
        return success_rate(errors, self.task.tolerance)

    def report(self) -> Path:
        """Path of the report, an HTML page, written anew from the folder of the run."""
        return write_report(self._done()[1])

    def _done(self) -> tuple[RunResult, Path]:
        if self._learned is None:
            raise RuntimeError("there is no policy yet: call learn() first")
        return self._learned


def _command() -> str:
    """The command line of the script that learns; of a notebook or a prompt, Python alone."""
    script = Path(sys.argv[0])
    return shlex.join(["python", *sys.argv]) if script.suffix == ".py" else "python"
