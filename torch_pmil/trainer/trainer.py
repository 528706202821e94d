"""Algorithm 1 as a TorchRL trainer: fit the model, search the policy on it, run it on the robot."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Callable
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import torch
from tensordict import TensorDict, TensorDictBase
from tensordict.nn import TensorDictModule
from torchrl.checkpoint import CheckpointRotation
from torchrl.record.loggers import Logger
from torchrl.trainers import Trainer
from tqdm import tqdm

from torch_pmil.checks import check_whole
from torch_pmil.control.exploration import CautiousMotion
from torch_pmil.envs.guards import set_guards
from torch_pmil.gp.lbfgs import MakeOptimizer
from torch_pmil.model.experience import FEWEST_TRANSITIONS, Experience
from torch_pmil.search.admission import admit
from torch_pmil.search.improving_loss import ImprovingKLLoss
from torch_pmil.search.policy_search import SearchSettings
from torch_pmil.search.promise import PredictedSuccess
from torch_pmil.search.trial_search import TrialSearch
from torch_pmil.seeds import SEEDS, Stream, generator_of
from torch_pmil.trainer.checkpoints import (
    GeneratorState,
    SavedRun,
    new_checkpoint,
    newest_undamaged,
    restore,
)
from torch_pmil.trainer.choice import best_candidate, is_settled
from torch_pmil.trainer.collector import RobotActor, RolloutCollector
from torch_pmil.trainer.ending import Ending
from torch_pmil.trainer.problem import Problem
from torch_pmil.trainer.run_state import RunState
from torch_pmil.trainer.search_stepper import SearchStepper
from torch_pmil.trainer.trials import Candidate, Trial, own_error, success_rate


class PMILTrainer(Trainer):
    """Probabilistic model-based imitation learning (Algorithm 1).

    A batch is a rollout. The first ones are the robot's exploration. After the last of them, and
    after each later one, the model is fitted to all experience and the policy is searched on it.
    The policy may then be measured from fresh starts, from which nothing is learned. The measured
    rates help to choose the best policy, and to decide whether three own successes in a row end the
    training. The next batch is the rollout of the searched policy on the robot. Training ends as
    :class:`Ending` says; :meth:`best_policy` then chooses among the policies that ran. Under an
    :class:`ImprovingKLLoss` the robot begins to improve where training would otherwise end.
    Training then ends by :meth:`Ending.improved`, once the cost hardly falls
    (:func:`~torch_pmil.trainer.choice.is_settled`).

    A rollout that the robot cuts short is a failure, and its transitions are experience. What a
    user registers by ``register_op`` runs at TorchRL's places of the loop.

    With a ``checkpoint_rotation`` everything is saved once the robot has moved. :meth:`resume`
    continues from there, and ends with the very same parameters.

    Args:
        problem: what is learned, on which robot. Its policy begins as the first that
            ``make_policy`` draws.
        ending: when the run ends.
        search: budget and horizon of each policy search.
        seed: of policies and exploration; same seed and same robot, same run.
        optimizer: see :func:`~torch_pmil.gp.lbfgs.minimise`.
        on_trial: called with each trial when its own rollout is done.
        progress_bar: whether to show progress where standard error is a terminal.
        logger: TorchRL's logger for the numbers of every trial.
        checkpoint_rotation: rotation of the checkpoints.

    ``announce`` is called with one line when the robot imitates and begins to improve.

    Raises:
        TypeError, ValueError: an argument is of another kind, or a number is out of range.
        RuntimeError: in :meth:`train`, if the exploration was cut short before it gave the
            transitions that a model needs.
        RunStopped, RolloutDiscarded, RobotError: in :meth:`train`, raised by the robot's reset.

    Example: see ``torch_pmil/runs/training.py``.
    """

    announce: Callable[[str], None] = staticmethod(lambda line: None)

    def __init__(
        self,
        problem: Problem,
        ending: Ending,
        search: SearchSettings,
        seed: int,
        *,
        optimizer: MakeOptimizer = torch.optim.LBFGS,
        on_trial: Callable[[Trial], None] = lambda trial: None,
        progress_bar: bool = True,
        logger: Logger | None = None,
        checkpoint_rotation: CheckpointRotation | None = None,
    ) -> None:
        for value, kind in ((problem, Problem), (ending, Ending), (search, SearchSettings)):
            if not isinstance(value, kind):
                raise TypeError(f"expected {kind.__name__}, got {type(value).__name__}")
        seed = check_whole("seed", seed, *SEEDS)
        self.problem, self.ending, self.promise = problem, ending, ending.promise
        self.initial, self.error, self.tolerance = problem.initial, problem.error, problem.tolerance
        self.evaluation_env, self.on_trial = problem.measured, on_trial
        policies, motions = generator_of(Stream.POLICIES, seed), generator_of(Stream.MOTION, seed)
        self.actor = _actor(problem, policies, motions)
        env = problem.env
        in_keys = [key for key in ("observation", "target") if key in env.observation_spec]
        self.robot_policy = TensorDictModule(self.actor, in_keys=in_keys, out_keys=["action"])
        of_search = motions, self.promise, self._report, optimizer
        self.search = TrialSearch(search, lambda: problem.make_policy(policies), *of_search)
        frames = problem.frames(ending.trials)
        super().__init__(
            collector=RolloutCollector(
                env,
                self.robot_policy,
                self.actor,
                problem.exploration.steps,
                tries=problem.measured is not None,
            ),
            total_frames=frames,
            frame_skip=1,
            optim_steps_per_batch=1,
            loss_module=problem.loss,
            optimization_stepper=SearchStepper(self.search),
            progress_bar=progress_bar and sys.stderr.isatty(),
            logger=logger,
            log_interval=0,
            checkpoint=new_checkpoint(),
        )
        self.control_period, self.rotation = env.control_period, checkpoint_rotation
        self.experience = Experience(capacity=frames)
        self.state = RunState(self.actor, env.batch_size.numel())
        self._fitted = 0  # transitions of the newest model's experience
        if self.evaluation_env is not None:
            self.register_module("evaluation_env", self.evaluation_env)
        self.register_module("policy_generator", GeneratorState(policies))
        self.register_module("generator", GeneratorState(motions))
        self.register_module("experience", self.experience)
        self.register_module("progress", self.state)

    def train(self) -> None:
        """Run Algorithm 1 to its end."""
        self._begin()
        for rollout in self.collector:  # the robot moves: first the exploration, then each policy
            self._save(rollout)  # before anything is learned from the motion
            self._learn_from(rollout)  # experience; completes the trial whose policy ran
            self._process_batch_hook(rollout)
            self._pre_steps_log_hook(rollout)
            if not (self._stop_training or self.actor.exploring):
                self.fit_dynamics()  # Eqs. 2-7
                self.optim_steps(self._start_belief())  # Eq. 22
                self._begin_trial()
            self._post_steps_hook()
            self._post_steps_log_hook(rollout)
            self._show(rollout)
            if self._stop_training:
                break
        self._end()

    @property
    def stop_reason(self) -> str:
        """Reason why training ended, "" before its end."""
        return self._stop_reason or ""

    @property
    def seconds(self) -> float:
        """Wall time since the run began, without interruptions, s."""
        return self.state.seconds

    @property
    def cpu_seconds(self) -> float:
        """CPU time of this process since the run began, without interruptions, s."""
        return self.state.cpu_seconds

    @property
    def trials(self) -> list[Trial]:
        """The completed trials."""
        return self.state.trials

    @property
    def candidates(self) -> list[Candidate]:
        """The policies that ran on the robot."""
        return self.state.candidates

    def fit_dynamics(self) -> None:
        """Fit the forward model to all experience, unless it already is."""
        if self._fitted == len(self.experience):
            return
        dynamics, experience = self.loss_module.dynamics, self.experience
        data = experience.data_for(dynamics, self.loss_module.space)
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
        """The best of the policies that ran, by a model of all experience; the loss then holds it.

        See :func:`~torch_pmil.trainer.choice.best_candidate`. Raises RuntimeError if none has run.
        """
        if not self.candidates:
            why = self.stop_reason or "call train first"
            raise RuntimeError(f"a policy must have run to be the best, got none: {why}")
        self.fit_dynamics()
        loss, judged = self.loss_module, (self.initial, self.promise, self.tolerance)
        return best_candidate(self.candidates, self.trials, loss, *judged)

    def promised_success_rate(self) -> float | None:
        """Success rate of the loss's policy at least, by its model, at 95 % confidence, or None."""
        predicted = self._predicted_success()
        return None if predicted is None else predicted.least

    def own_rollout(self, candidate: Candidate) -> TensorDictBase:
        """The rollout of a policy that became experience, (robots, steps)."""
        return self.state.rollout_of(candidate, self.experience.transitions)

    def own_rollouts(self) -> list[TensorDictBase]:
        """Those of all policies that ran, (robots, steps) each, without those cut short."""
        trials, horizon = self.trials, self.loss_module.horizon
        whole = [each for each in self.candidates if trials[each.trial - 1].steps == horizon]
        return [self.own_rollout(candidate) for candidate in whole]

    def resume(self, saved: SavedRun | None = None) -> Path | None:
        """Continue from a checkpoint, or the newest undamaged one; return its path, or None.

        All of it is checked before it is loaded, and nothing is executed. If it does not fit, the
        one before it of the same run is taken, with a warning.

        Raises:
            ValueError: there is neither a checkpoint nor a rotation.
            CheckpointError: all are damaged or do not fit; the message is about the newest.
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

    def begin_with(self, saved: SavedRun) -> None:
        """Begin with the experience and the newest policy of another run, from its checkpoint.

        The robot then explores, as in any run; no trial of the other run counts.

        Raises CheckpointError if it does not fit.
        """
        components = self._sync_checkpoint_components().components
        fresh = {name: deepcopy(part.state_dict()) for name, part in components.items()}
        self.resume(saved)
        self.experience.extend(self.collector._latest)  # the last one, which it had not learned
        self.experience.load_state_dict(self.experience.state_dict())  # with room for as many more
        for name in components.keys() - {"policy", "loss_module", "trainer_module.experience"}:
            components[name].load_state_dict(fresh[name])
        self.search.begin_anew()
        if isinstance(self.loss_module, ImprovingKLLoss):
            self.loss_module.improve(False)
        self.state.explored = len(self.experience)

    def _begin(self) -> None:
        if self.progress_bar:
            self._pbar = tqdm(total=self.total_frames)
            self._pbar_str: dict[str, float] = {}
            self._pbar.update(self.collected_frames)
        self._say("the robot moves")
        self._setup_hook()

    def _end(self) -> None:
        self._shutdown_hook()
        self.collector.shutdown()
        if self.progress_bar:  # which comes to its end early where the robot learned early
            self._pbar.total = self._pbar.n = self.collected_frames
            self._say(self.stop_reason)
            self._pbar.close()

    def _save(self, rollout: TensorDictBase) -> None:
        """Write a checkpoint whose collector holds the rollout, and whose other parts do not.

        Raises RuntimeError if this ends the exploration with too few transitions.
        """
        found = len(self.experience) + rollout.batch_size.numel()
        ends = self.state.rollouts + 1 == self.problem.exploration.rollouts
        if ends and found < FEWEST_TRANSITIONS:
            raise RuntimeError(
                f"the first motion must give {FEWEST_TRANSITIONS} transitions at least, got "
                f"{found}: {self.collector.cut_short or 'it was cut short'}"
            )
        if self.rotation is not None:
            self.rotation.save(self._sync_checkpoint_components(), step=self.state.rollouts)

    def _learn_from(self, rollout: TensorDictBase) -> None:
        """Add the rollout to the experience, and complete the trial whose policy ran."""
        state, transitions = self.state, rollout.batch_size.numel()
        self.experience.extend(rollout)
        self.collected_frames += transitions
        state.rollouts += 1
        if self.actor.exploring:
            state.explored += transitions
            self.actor.exploring = state.rollouts < self.problem.exploration.rollouts
        else:
            self._complete(rollout)

    def _complete(self, rollout: TensorDictBase) -> None:
        """Complete the pending trial with its own rollout, and end the training if it is time."""
        state = self.state
        assert state.pending is not None  # the search before the rollout left it
        cut_short = self.collector.cut_short
        error = own_error(rollout, cut_short, self.loss_module.horizon, self.error)
        success, promised = error <= self.tolerance, None
        if success and self.promise is not None:
            self.fit_dynamics()
            promised = self.promised_success_rate()
        trial = replace(
            state.pending,
            own_error=error,
            own_success=success,
            promised_success_rate=promised,
            steps=rollout.shape[-1],
            cut_short=cut_short or state.pending.cut_short,
        )
        parameters = {k: v.clone() for k, v in self.loss_module.actor_network.state_dict().items()}
        state.trials.append(trial)
        state.pending = None
        state.candidates.append(Candidate(trial.trial, parameters, error))
        self._log(own_error=error, own_success=success)
        self.on_trial(trial)
        if ended := self._reason_to_end():
            self.request_stop(ended)

    def _reason_to_end(self) -> str:
        """Why the run ends now; "" if it continues, perhaps to improve what it imitates."""
        loss, trials = self.loss_module, self.trials
        if not isinstance(loss, ImprovingKLLoss):
            return self.ending.reason(trials)
        ended = self.ending.improved(trials) if loss.improving else self.ending.reason(trials)
        if not ended or len(trials) >= self.ending.trials:
            return ended
        if loss.improving:
            self.fit_dynamics()
            return ended if is_settled(self.candidates, loss, self.initial) else ""
        loss.improve()
        self.search.begin_anew()
        weight = loss.imitation_weight
        self.announce(f"{ended}: from now on it improves by the cost and {weight:g} times the KL")
        return ""

    def _start_belief(self) -> TensorDictBase:
        """The batch of an optimisation step: p(x_0)."""
        succeeded = [trial.own_success for trial in self.trials[-1:]]
        return TensorDict(
            {
                "observation": {"mean": self.initial.mean, "var": self.initial.cov},
                "succeeded": torch.tensor(succeeded, dtype=torch.bool),
            }
        )

    def _begin_trial(self) -> None:
        """Admit the policy that was found to the robot, measure it, and note what is predicted."""
        search = self.search
        of_search = search.settings, search.result, self._report, search.optimizer
        admission = admit(self.loss_module, self.initial, self.problem.box, *of_search)
        self.collector.steps = admission.steps
        if not admission.steps:
            self.request_stop("no policy was admitted: its first step may already leave the box")
            return
        rate, count = self._measure()
        predicted = self._predicted_success()
        self.state.pending = trial = Trial.before_its_rollout(
            len(self.trials) + 1,
            len(self.experience) * self.control_period,
            (rate, count),
            None if predicted is None else predicted.rate,
            admission,
            search.refitted,
            self._fit.seconds,
        )
        shown = ["trial", "experience_s", "loss", *(["success_rate"] if count else [])]
        logged = ["horizon", "refitted", "gp_seconds", "search_seconds", "evaluations"]
        self._log(log_pbar=True, **{key: getattr(trial, key) for key in shown})
        self._log(**{key: getattr(trial, key) for key in logged})

    def _measure(self) -> tuple[float | None, int]:
        """Success rate of the policy from fresh starts and their number, if there are any."""
        if self.evaluation_env is None:
            return None, 0
        rollouts = self.evaluation_env.rollout(self.loss_module.horizon, self.robot_policy)
        errors = self.error(rollouts)
        return success_rate(errors, self.tolerance), len(errors)

    def _predicted_success(self) -> PredictedSuccess | None:
        if self.promise is None:
            return None
        return self.promise.predicted(self.loss_module, self.initial)

    def _report(self, stage: str, loss: float) -> None:
        self._say(f"search: {stage} = {loss:.1f} {self.loss_module.unit}".rstrip())

    def _show(self, rollout: TensorDictBase) -> None:
        """Move the progress bar on."""
        if self.progress_bar:
            self._pbar.update(rollout.batch_size.numel())
            self._pbar_description()

    def _say(self, text: str) -> None:
        """Show what is being done beside the progress bar."""
        if self.progress_bar:
            self._pbar.set_postfix_str(text)


def _actor(problem: Problem, policies: torch.Generator, motions: torch.Generator) -> RobotActor:
    """What acts on the robot: the exploration, then the loss's policy, which is drawn here."""
    loss, motion = problem.loss, problem.exploration.motion(motions)
    loss.actor_network.load_state_dict(problem.make_policy(policies).state_dict())
    if problem.box is not None:
        motion = CautiousMotion(motion, problem.box)
    set_guards(problem.env, *problem.guards)
    return RobotActor(loss.actor_network, loss.space, motion)
