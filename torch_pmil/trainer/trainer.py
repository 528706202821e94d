"""Algorithm 1 as a TorchRL trainer: fit the model, search the policy on it, run it on the robot.

:class:`PMILTrainer` is the loop; its optimisation step is in ``search_stepper.py``.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torch import Tensor
from torchrl.checkpoint import CheckpointRotation
from torchrl.envs import EnvBase
from torchrl.record.loggers import Logger
from torchrl.trainers import Trainer

from torch_pmil.checks import check_positive, check_whole
from torch_pmil.control.cautious_motion import CautiousMotion
from torch_pmil.control.exploration import Exploration
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_box import StateBox
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.model.experience import (
    FEWEST_TRANSITIONS,
    Experience,
    check_limits_of_state,
)
from torch_pmil.model.rollout import PredictionError, check_start_belief
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.promise import PredictedSuccess, Promise
from torch_pmil.search.trajectory_loss import TrajectoryLoss
from torch_pmil.trainer.admission import Admission, admit
from torch_pmil.trainer.checkpoints import (
    GeneratorState,
    SavedRun,
    new_checkpoint,
    newest_undamaged,
    restore,
)
from torch_pmil.trainer.collector import RobotActor, RolloutCollector
from torch_pmil.trainer.ending import why_ended
from torch_pmil.trainer.plan_tracking import PlanTracking
from torch_pmil.trainer.search_stepper import PolicySearchStepper
from torch_pmil.trainer.trials import Candidate, Trial, own_error, success_rate


class PMILTrainer(Trainer):
    """Probabilistic model-based imitation learning (Algorithm 1).

    A batch is a rollout. The first ones are the robot's exploration. After the last of them, and
    after each later one, the model is fitted to all experience, the policy is searched on it and,
    with an ``evaluation_env``, measured from fresh starts (which decides nothing, and is no
    experience); the next batch is that policy's rollout on the robot. Training ends when the own
    rollout succeeded and the model that learned from it predicts the promised success rate, or at
    the limit of trials. :meth:`best_policy` then chooses among the policies that ran.

    A rollout that the robot cuts short is a failure, and what was recorded of it is experience.

    With a ``checkpoint_rotation`` everything is written down as soon as the robot has moved, before
    anything is learned from the motion. :meth:`resume` goes on from there, and ends with the very
    same parameters.

    Args:
        env: a single robot; or, for a policy of targets, one robot for each target, which it gives
            under ``"target"``.
        evaluation_env: a batch of robots for the measurement; None for none: then the robot makes
            no motion but its own rollouts, and these alone say what succeeds.
        loss_module: the objective with policy and model.
        initial: p(x_0).
        limits: limits of the state (D,); transitions beyond are experience, but no data of the
            model. They are widened where the exploration would leave it fewer than it has inputs
            (:func:`~torch_pmil.model.experience.widened`).
        error: maps rollouts (*batch, T) of the environment to their errors, (*batch).
        tolerance: error up to which a rollout is a success.
        confirmations: number of successes in a row without which the training does not end.
        trials: largest number of trials.
        search: budget and horizon of each policy search.
        make_policy: returns a new random policy, drawn from a generator.
        exploration: how the robot moves before anything is learned.
        policy_generator: generator of new policies.
        generator: generator of the exploration, and of the states at which policies are refitted.
        promise: success rate from fresh starts that the policy shall keep; None where no success
            can be predicted, and the confirmations alone end the training.
        tracking: how to plan on the mean of the model, which is another start of each search; None
            for none.
        box: limits of the motion. ``env`` stops where it leaves them, the exploration begins small
            (:class:`CautiousMotion`), and a policy that is likely to leave them is refused, or runs
            for its first steps alone (:func:`admit`). None for no limits.
        on_trial: called with each trial when its own rollout is done.
        progress_bar: whether to show progress where standard error is a terminal.
        logger: TorchRL's logger for the numbers of every trial; None for none.
        checkpoint_rotation: rotation of the checkpoints; None for none.
        checkpoint_metadata: entries about the run in a checkpoint's manifest, in JSON's types.

    Raises:
        TypeError: an environment, the generators or the settings of the search are of another kind.
        RuntimeError: in :meth:`train`, when the exploration is cut short before it gave the
            transitions of which a model can be made.
        RunStopped, RolloutDiscarded, RobotError: in :meth:`train`, raised by the robot's reset.
        ValueError: a number is out of range, or start or limits are not over the state.

    Example: see ``torch_pmil/runs/training.py``.
    """

    def __init__(
        self,
        *,
        env: EnvBase,
        evaluation_env: EnvBase | None,
        loss_module: TrajectoryLoss,
        initial: Gaussian,
        limits: Tensor,
        error: Callable[[TensorDictBase], Tensor],
        tolerance: float,
        confirmations: int,
        trials: int,
        search: SearchSettings,
        make_policy: Callable[[torch.Generator], RBFPolicy],
        exploration: Exploration,
        policy_generator: torch.Generator,
        generator: torch.Generator,
        promise: Promise | None = None,
        tracking: PlanTracking | None = None,
        box: StateBox | None = None,
        on_trial: Callable[[Trial], None] = lambda trial: None,
        progress_bar: bool = True,
        logger: Logger | None = None,
        checkpoint_rotation: CheckpointRotation | None = None,
        checkpoint_metadata: Mapping[str, object] | None = None,
    ) -> None:
        check_whole("trials", trials, 1)
        check_whole("confirmations", confirmations, 1)
        check_positive("tolerance", tolerance, zero=True)
        _check_kind("env", env, EnvBase)
        if evaluation_env is not None:
            _check_kind("evaluation_env", evaluation_env, EnvBase)
        _check_kind("search", search, SearchSettings)
        _check_kind("policy_generator", policy_generator, torch.Generator)
        _check_kind("generator", generator, torch.Generator)
        check_start_belief(initial, "initial", loss_module.dynamics, loss_module.space)
        check_limits_of_state(limits, loss_module.space.dim)
        horizon = loss_module.horizon
        self.num_robots, self.most_trials = env.batch_size.numel(), trials
        frames = self.num_robots * (exploration.rollouts * exploration.steps + trials * horizon)
        motion = exploration.motion(generator)
        if box is not None:
            motion, env.guard = CautiousMotion(motion, box), box.guard
        actor = RobotActor(loss_module.actor_network, loss_module.space, motion)
        in_keys = [key for key in ("observation", "target") if key in env.observation_spec]
        self.robot_policy = TensorDictModule(actor, in_keys=in_keys, out_keys=["action"])
        super().__init__(
            collector=RolloutCollector(
                env, self.robot_policy, actor, exploration.steps, evaluation_env is not None
            ),
            total_frames=frames,
            frame_skip=1,
            optim_steps_per_batch=1,
            loss_module=loss_module,
            optimization_stepper=PolicySearchStepper(
                search,
                promise,
                lambda: make_policy(policy_generator),
                generator,
                self._report,
                tracking,
            ),
            progress_bar=progress_bar and sys.stderr.isatty(),
            logger=logger,
            log_interval=0,
            checkpoint=new_checkpoint(),
        )
        self.actor, self.evaluation_env = actor, evaluation_env
        self.initial, self.limits, self.box = initial, limits, box
        self.error, self.tolerance = error, tolerance
        self.promise, self.confirmations, self.on_trial = promise, confirmations, on_trial
        self.control_period = env.control_period
        self.experience = Experience(capacity=frames)
        self.explorations = exploration.rollouts
        self.rollouts, self.explored = 0, 0  # rollouts, and transitions of the exploration, so far
        self._fitted = 0  # transitions of the newest model's experience
        self.trials: list[Trial] = []
        self.candidates: list[Candidate] = []
        self.rotation, self.metadata = checkpoint_rotation, checkpoint_metadata
        self._pending: Trial | None = None
        self._begun = time.perf_counter()
        self._register_state(policy_generator, generator)
        self._register_hooks()

    @property
    def stop_reason(self) -> str:
        """Reason why training ended, "" before its end."""
        return self._stop_reason or ""

    @property
    def seconds(self) -> float:
        """Wall time since the run began, including the time before a resumption, s."""
        return time.perf_counter() - self._begun

    def resume(self, saved: SavedRun | None = None) -> Path | None:
        """Go on from a checkpoint and return its path, or None if there is none.

        Nothing that it carries is executed, and all of it is checked before it is loaded. From one
        that does not fit it goes on to the one before, if that is of the same run, with a warning.

        Args:
            saved: what it holds; None for the newest undamaged one. There is a warning for a
                damaged one.

        Raises:
            ValueError: there is neither a checkpoint nor a rotation to look for one.
            CheckpointError: all checkpoints are damaged or do not fit; the message is of the
                newest.
        """
        if saved is None and self.rotation is None:
            raise ValueError("resume must be given a checkpoint or a checkpoint_rotation, got none")
        saved = saved or newest_undamaged(self.rotation)
        if saved is None:
            return None
        env, components = self.collector.env, self._sync_checkpoint_components().components
        widths = env.observation_spec["observation"].shape[-1], env.action_spec.shape[-1]
        loaded = restore(components, saved, self.rotation, widths)
        self.collector.update_policy_weights_()
        return loaded.path

    def train(self) -> None:
        """Run Algorithm 1 to its end."""
        super().train()
        if self.progress_bar:
            self._end_bar()

    def _end_bar(self) -> None:
        """Bring the bar to its end, which comes early where the robot learned early."""
        self._pbar.total = self._pbar.n = self.collected_frames
        self._say(self.stop_reason)
        self._pbar.close()

    def optim_steps(self, batch: TensorDictBase) -> None:
        """Fit and search, unless the robot explores on, or training is over."""
        if self._next_is_a_trial():
            super().optim_steps(batch)

    def _next_is_a_trial(self) -> bool:
        return not (self._stop_training or self.actor.exploring)

    def fit_dynamics(self) -> None:
        """Fit the forward model to all experience within the limits, unless it is already."""
        if self._fitted == len(self.experience):
            return
        dynamics, experience = self.loss_module.dynamics, self.experience
        space = self.loss_module.space
        data = experience.data_for(dynamics, space, self.limits, self.explored)
        self._say(f"fitting the model to {len(data[0])} transitions")
        was_exact = not dynamics.sparse
        self._fit, self._fitted = dynamics.fit(*data), len(experience)
        if was_exact and dynamics.sparse:
            warnings.warn(
                f"the model learned from {len(data[0])} transitions, more than the "
                f"{dynamics.most_exact} of an exact posterior: from now on its posterior is sparse,"
                f" of {dynamics.num_inducing} inducing inputs",
                RuntimeWarning,
                stacklevel=2,
            )

    def best_policy(self) -> Candidate:
        """Best of the policies that ran, by a model of all experience.

        Of those whose own rollout was not cut short it has the highest predicted success rate, as
        far as :attr:`Promise.aim`. Of several alike, or where no success can be predicted, it has
        the least error of the own rollout, of which all successes are alike; then the longest own
        rollout; then the least predicted loss. The policy of the loss then holds its parameters.

        Raises:
            RuntimeError: no policy ran yet.
        """
        if not self.candidates:
            why = self.stop_reason or "call train first"
            raise RuntimeError(f"a policy must have run to be the best, got none: {why}")
        self.fit_dynamics()
        chosen = max(self.candidates, key=self._merit)
        self.loss_module.actor_network.load_state_dict(chosen.parameters)
        return chosen

    def _merit(self, candidate: Candidate) -> tuple[float, ...]:
        self.loss_module.actor_network.load_state_dict(candidate.parameters)
        promise, alike = self.promise, 0.0
        if promise is not None:
            alike = min(promise.predicted(self.loss_module, self.initial).least, promise.aim)
        error = max(candidate.own_error, self.tolerance)
        steps = self.trials[candidate.trial - 1].steps
        return error < math.inf, alike, -error, steps, -self._predicted_loss()

    def _predicted_success(self) -> PredictedSuccess | None:
        """Success of the loss's policy under the newest model, None where it is not predicted."""
        if self.promise is None:
            return None
        return self.promise.predicted(self.loss_module, self.initial)

    def promised_success_rate(self) -> float | None:
        """Success rate of the loss's policy that the model predicts at least, if it does.

        The confidence is 95 %. None where no success can be predicted.
        """
        predicted = self._predicted_success()
        return None if predicted is None else predicted.least

    def own_rollout(self, candidate: Candidate) -> TensorDictBase:
        """The rollout of a policy that became experience, (robots, steps)."""
        return self._rollout_of(candidate, self.experience.transitions)

    def own_rollouts(self) -> list[TensorDictBase]:
        """Those of all policies that ran, (robots, steps) each, without those cut short."""
        transitions = self.experience.transitions
        return [
            self._rollout_of(candidate, transitions)
            for candidate in self.candidates
            if self.trials[candidate.trial - 1].steps == self.loss_module.horizon
        ]

    def _rollout_of(self, candidate: Candidate, transitions: TensorDictBase) -> TensorDictBase:
        """The part (robots, steps) of all transitions that a policy's rollout gave."""
        steps = [trial.steps for trial in self.trials[: candidate.trial]]
        begin = self.explored + self.num_robots * sum(steps[:-1])
        own = transitions[begin : begin + self.num_robots * steps[-1]]
        return own.reshape(self.num_robots, steps[-1])

    @torch.no_grad()
    def _predicted_loss(self) -> float:
        try:
            return self.loss_module.per_step(self.initial).sum().item()
        except PredictionError:
            return float("inf")

    def _register_state(
        self, policy_generator: torch.Generator, generator: torch.Generator
    ) -> None:
        """Register all that a checkpoint holds besides TorchRL's own parts."""
        if self.evaluation_env is not None:
            self.register_module("evaluation_env", self.evaluation_env)
        self.register_module("policy_generator", GeneratorState(policy_generator))
        self.register_module("generator", GeneratorState(generator))
        self.register_module("experience", self.experience)
        self.register_module("progress", _Progress(self))

    def _register_hooks(self) -> None:
        """Register the hooks of TorchRL's loop: checkpoints, Algorithm 1 and its logs.

        A checkpoint is written before anything is learned from a batch.
        """
        self.register_op("setup", self._show_progress)
        self.register_op("batch_process", self._check_exploration)
        self.register_op("batch_process", self._save)
        self.register_op("batch_process", self._learn_from_rollout)
        self.register_op("pre_steps_log", self._log_own_rollout)
        self.register_op("pre_optim_steps", self.fit_dynamics)
        self.register_op("process_optim_batch", self._start_belief)
        self.register_op("post_steps_log", self._begin_trial)
        self.register_op("post_steps_log", self._log_search)

    def _check_exploration(self, batch: TensorDictBase) -> TensorDictBase:
        """Raise RuntimeError at the exploration's last rollout if there are too few transitions."""
        found = len(self.experience) + batch.batch_size.numel()
        if self.rollouts + 1 == self.explorations and found < FEWEST_TRANSITIONS:
            raise RuntimeError(
                f"the first motion must give {FEWEST_TRANSITIONS} transitions at least, got "
                f"{found}: {self.collector.cut_short}"
            )
        return batch

    def _save(self, batch: TensorDictBase) -> TensorDictBase:
        """Write a checkpoint: its collector holds ``batch``, its other parts are from before it."""
        if self.rotation is not None:
            self.rotation.save(
                self._sync_checkpoint_components(),
                step=self.rollouts,
                metadata=self.metadata,
            )
        return batch

    def _show_progress(self) -> None:
        if self.progress_bar:
            self._pbar.update(self.collected_frames)
        self._say("the robot moves")

    def _learn_from_rollout(self, batch: TensorDictBase) -> TensorDictBase:
        """Add the rollout to the experience, and complete the trial whose policy ran."""
        self.experience.extend(batch)
        self.rollouts += 1
        if self.actor.exploring:
            self.explored += batch.batch_size.numel()
            self.actor.exploring = self.rollouts < self.explorations
        else:
            self._complete(batch)
        return batch

    def _complete(self, batch: TensorDictBase) -> None:
        """Complete the pending trial with its own rollout, and end the training if it is time."""
        assert self._pending is not None  # the search before the rollout left it
        cut_short = self.collector.cut_short
        error = own_error(batch, cut_short, self.loss_module.horizon, self.error)
        success, promised = error <= self.tolerance, None
        if success and self.promise is not None:
            self.fit_dynamics()
            promised = self.promised_success_rate()
        trial = replace(
            self._pending,
            own_error=error,
            own_success=success,
            promised_success_rate=promised,
            steps=batch.shape[-1],
            cut_short=cut_short or self._pending.cut_short,
        )
        parameters = {k: v.clone() for k, v in self.loss_module.actor_network.state_dict().items()}
        self.trials.append(trial)
        self._pending = None
        self.candidates.append(Candidate(trial.trial, parameters, error))
        self.on_trial(trial)
        if ended := why_ended(self.trials, self.confirmations, self.promise, self.most_trials):
            self.request_stop(ended)

    def _start_belief(self, batch: TensorDictBase) -> TensorDictBase:
        return TensorDict({"observation": {"mean": self.initial.mean, "var": self.initial.cov}})

    def _begin_trial(self, batch: TensorDictBase) -> dict[str, float | bool] | None:
        """Note what the search came to, measure its policy; return the numbers to show."""
        if not self._next_is_a_trial():
            return None
        admission = self._admit()
        self.collector.steps = admission.steps
        if not admission.steps:
            self.request_stop("no policy was admitted: its first step may already leave the box")
            return None
        rate, count = self._measure()
        search, predicted = admission.result, self._predicted_success()
        self._pending = Trial(
            trial=len(self.trials) + 1,
            experience_s=len(self.experience) * self.control_period,
            success_rate=rate,
            n_eval=count,
            own_error=float("nan"),
            own_success=False,
            predicted_success_rate=None if predicted is None else predicted.rate,
            promised_success_rate=None,
            loss=search.loss,
            horizon=search.horizon,
            refitted=self.optimization_stepper.refitted,
            gp_seconds=self._fit.seconds,
            search_seconds=search.seconds,
            evaluations=search.evaluations,
            stop_reason=search.stop_reason,
            steps=0,
            cut_short="" if admission.complete else "it was likely to leave the box",
            leaving_probability=admission.leaving_probability,
            refused=admission.refused,
        )
        keys = ("trial", "experience_s", "loss", *(("success_rate",) if count else ()))
        return {**{key: getattr(self._pending, key) for key in keys}, "log_pbar": True}

    def _admit(self) -> Admission:
        """What the robot may do with the policy that was found."""
        stepper = self.optimization_stepper
        return admit(
            self.loss_module, self.initial, self.box, stepper.settings, stepper.result, self._report
        )

    def _measure(self) -> tuple[float | None, int]:
        """Success rate of the policy from fresh starts and their number, if there are any."""
        if self.evaluation_env is None:
            return None, 0
        rollouts = self.evaluation_env.rollout(self.loss_module.horizon, self.robot_policy)
        errors = self.error(rollouts)
        return success_rate(errors, self.tolerance), len(errors)

    def _log_search(self, batch: TensorDictBase) -> dict[str, float | bool] | None:
        """Numbers of the search for the logger, besides those that the progress bar shows."""
        if self._pending is None:
            return None
        keys = ("horizon", "refitted", "gp_seconds", "search_seconds", "evaluations")
        return {key: getattr(self._pending, key) for key in keys}

    def _log_own_rollout(self, batch: TensorDictBase) -> dict[str, float | bool] | None:
        if not self.trials:
            return None
        return {key: getattr(self.trials[-1], key) for key in ("own_error", "own_success")}

    def _report(self, stage: str, loss: float) -> None:
        self._say(f"search: {stage} = {loss:.1f} {self.loss_module.unit}".rstrip())

    def _say(self, text: str) -> None:
        """Show what is being done beside the progress bar."""
        if self.progress_bar:
            self._pbar.set_postfix_str(text)


def _check_kind(name: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise TypeError(
            f"{name} must be an instance of {kind.__name__}, got {type(value).__name__}"
        )


class _Progress:
    """The trainer's own state, with the state methods that a checkpoint needs."""

    def __init__(self, trainer: PMILTrainer) -> None:
        self.trainer = trainer

    def state_dict(self) -> dict[str, object]:
        trainer = self.trainer
        return {
            "exploring": trainer.actor.exploring,
            "rollouts": trainer.rollouts,
            "explored": trainer.explored,
            "seconds": trainer.seconds,
            "trials": [asdict(trial) for trial in trainer.trials],
            "pending": None if trainer._pending is None else asdict(trainer._pending),
            "candidates": [vars(candidate) for candidate in trainer.candidates],
        }

    def load_state_dict(self, state_dict: Mapping[str, Any]) -> None:
        trainer, pending = self.trainer, state_dict["pending"]
        trainer.actor.exploring = state_dict["exploring"]
        trainer.rollouts, trainer.explored = state_dict["rollouts"], state_dict["explored"]
        trainer._begun = time.perf_counter() - state_dict["seconds"]
        trainer.trials = [Trial(**trial) for trial in state_dict["trials"]]
        trainer._pending = None if pending is None else Trial(**pending)
        trainer.candidates = [Candidate(**candidate) for candidate in state_dict["candidates"]]
