"""Algorithm 1 as a trainer, on four steps of the double pendulum."""

from __future__ import annotations

import ast
import inspect
import io
import math
import sys
import textwrap
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, replace
from functools import partial
from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.testing import assert_close
from tqdm import tqdm

from tests.helpers.short_run import PD_MOVEMENTS, short_experiment
from torch_pmil.control.exploration import RandomActions
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.envs.rollouts import rollout_of, states_of, without_sensor_noise
from torch_pmil.gp.lbfgs import minimise_function
from torch_pmil.model.dynamics import GPDynamics
from torch_pmil.model.rollout import PredictionError
from torch_pmil.runs.training import make_trainer
from torch_pmil.search import policy_search
from torch_pmil.search.promise import SAMPLES, PredictedSuccess
from torch_pmil.seeds import Stream, generator_of
from torch_pmil.tasks.method import Method
from torch_pmil.trainer.collector import RobotActor
from torch_pmil.trainer.trainer import PMILTrainer
from torch_pmil.trainer.trials import Candidate, Trial, own_error as judge

HORIZON, STARTS = 4, 20


def ignore(_: Trial) -> None:
    pass


def make(
    trials: int,
    seed: int = 0,
    progress_bar: bool = False,
    report: Callable[[Trial], None] = ignore,
    **changes: object,
) -> PMILTrainer:
    task = short_experiment(HORIZON, **changes)
    return make_trainer(task, seed, trials, progress_bar, report)


def learned(trials: int, **options: object) -> PMILTrainer:
    """A trainer, when it has trained."""
    trainer = make(trials, **options)
    trainer.train()
    return trainer


def own_errors(*errors: float) -> Callable[[TensorDictBase], Tensor]:
    """Own rollouts have these errors, one after the other; a quarter of the starts succeed."""
    script, starts = iter(errors), torch.arange(STARTS) % 4
    return lambda rollout: torch.tensor(next(script)) if rollout.ndim == 1 else 1.0 * starts


@pytest.fixture(scope="module")
def trained() -> PMILTrainer:
    """Two trials, without success."""
    return learned(trials=2)


def rollouts_of(trainer: PMILTrainer) -> list[TensorDict]:
    return trainer.experience.transitions.split(HORIZON)


def test_experience_is_the_random_rollout_and_one_of_each_trial(trained: PMILTrainer) -> None:
    assert len(trained.experience) == trained.collected_frames == 3 * HORIZON
    assert [trial.trial for trial in trained.trials] == [1, 2]
    assert [trial.experience_s for trial in trained.trials] == pytest.approx([0.4, 0.8])


def test_each_rollout_is_one_motion_from_a_start_of_its_own(trained: PMILTrainer) -> None:
    """So that no measurement from other starts is among them."""
    rollouts = rollouts_of(trained)
    for rollout in rollouts:
        assert torch.equal(rollout["next", "observation"][:-1], rollout["observation"][1:])
    starts = torch.stack([rollout["observation"][0] for rollout in rollouts])
    assert ((starts - trained.initial.mean).abs() < 5 * trained.initial.std).all()
    assert len(starts.unique(dim=0)) == 3


def test_first_rollout_is_random_within_a_fraction_of_the_limit() -> None:
    trainer = learned(trials=1, random_action=0.1)
    actions, u_max = rollouts_of(trainer)[0]["action"], trainer.actor.policy.u_max
    assert (actions.abs() <= 0.1 * u_max).all()
    assert actions.abs().max() > 0.02 * u_max.max()
    assert len(actions.unique()) == actions.numel()


def test_first_motion_may_be_several_rollouts_of_another_length() -> None:
    trainer = make(trials=2, exploration=PD_MOVEMENTS)
    sizes: list[int] = []
    dynamics = trainer.loss_module.dynamics
    trainer.register_op("post_optim", lambda: sizes.append(len(dynamics.train_inputs)))
    trainer.train()
    whole = 2 * 7 + 2 * HORIZON
    assert len(trainer.experience) == trainer.collected_frames == trainer.total_frames == whole
    assert sizes == [14, 14 + HORIZON]
    assert [trial.experience_s for trial in trainer.trials] == pytest.approx(
        [1.4, 1.4 + 0.1 * HORIZON]
    )
    transitions = trainer.experience.transitions
    for rollout in transitions.split([7, 7, HORIZON, HORIZON]):
        assert torch.equal(rollout["next", "observation"][:-1], rollout["observation"][1:])
    assert not torch.equal(transitions["next", "observation"][6], transitions["observation"][7])


def test_first_motion_is_that_of_the_pd_controller_from_the_robots_starts() -> None:
    """The collector tries out robot and motion when it is made."""
    trainer = learned(trials=1, exploration=PD_MOVEMENTS)
    env = short_experiment().make_env(seed=0)
    motion = PD_MOVEMENTS.motion(generator_of(Stream.MOTION, 0))
    motion(env.reset()["observation"])
    for rollout in trainer.experience.transitions[:14].split(7):
        motion.begin()
        state = env.reset()["observation"]
        for step in rollout:
            action = motion(state)
            assert_close((step["observation"], step["action"]), (state, action), rtol=0, atol=1e-12)
            state = env.step(TensorDict({"action": action}))["next", "observation"]


def test_later_rollouts_are_the_searched_policies(trained: PMILTrainer) -> None:
    policy = RBFPolicy(torch.zeros(5, 6), torch.ones(2), torch.ones(6))
    for candidate, rollout in zip(trained.candidates, rollouts_of(trained)[1:], strict=True):
        policy.load_state_dict(candidate.parameters)
        expected = policy(trained.actor.space.features(rollout["observation"]))
        assert_close(rollout["action"], expected.detach(), rtol=0, atol=1e-12)


def test_own_error_is_that_of_the_rollout_that_became_experience(trained: PMILTrainer) -> None:
    for trial, rollout in zip(trained.trials, rollouts_of(trained)[1:], strict=True):
        assert trial.own_error == trained.error(rollout).item()


def test_training_is_the_algorithm_on_one_screen() -> None:
    lines = ast.unparse(ast.parse(textwrap.dedent(inspect.getsource(PMILTrainer.train))))
    assert len(lines.splitlines()) <= 25
    assert len(inspect.signature(PMILTrainer).parameters) <= 9


def test_hooks_of_a_user_are_called() -> None:
    trainer = make(trials=2)
    calls: list[str] = []
    of_batches = {"batch_process": 3, "pre_steps_log": 3, "post_steps_log": 3}
    of_searches = {"process_optim_batch": 2, "post_optim_log": 2}
    alone = {"setup": 1, "pre_optim_steps": 2, "post_optim": 2, "post_steps": 3, "shutdown": 1}
    for place in of_batches | of_searches:
        trainer.register_op(place, lambda batch, place=place: calls.append(place))
    for place in alone:
        trainer.register_op(place, lambda place=place: calls.append(place))
    trainer.train()
    assert Counter(calls) == of_batches | of_searches | alone
    assert (calls[0], calls[-1]) == ("setup", "shutdown")


def test_rate_is_that_of_the_fresh_starts_and_decides_nothing() -> None:
    trials = learned(trials=2, error=own_errors(9.0, 9.0), tolerance=0.5).trials
    assert [(trial.success_rate, trial.n_eval) for trial in trials] == [(0.25, STARTS)] * 2
    assert not any(trial.own_success for trial in trials)


def test_error_is_of_the_rollout_as_the_environment_gives_it() -> None:
    """What the states do not say: here, how fast the torques were."""
    fastest = lambda rollout: rollout["action"].norm(dim=-1).amax(-1)  # noqa: E731
    trainer = learned(trials=1, error=fastest, tolerance=0.0)
    assert trainer.trials[0].own_error == fastest(rollouts_of(trainer)[1]).item()


@pytest.mark.parametrize("judged", [states_of, lambda rollout: states_of(rollout).norm() < 1])
def test_own_rollout_is_judged_by_one_number(judged: Callable) -> None:
    with pytest.raises(
        ValueError, match=r"^error must return a real tensor \(\), how far .*, got "
    ):
        judge(rollout_of(torch.zeros(HORIZON + 1, 4)), "", HORIZON, judged)


class ScriptedPromise:
    """A promise with a rate of 0.9, for which the models predict these rates, one by one."""

    rate, aim, tolerance = 0.9, 0.95, 0.5

    def __init__(self, *rates: float) -> None:
        self._rates = iter(rates)
        self.fitted: list[int] = []  # data of the models that were asked

    def predicted(self, loss: torch.nn.Module, _: object) -> PredictedSuccess:
        self.fitted.append(len(loss.dynamics.train_inputs))
        return PredictedSuccess(round(next(self._rates) * SAMPLES))


def promised(trainer: PMILTrainer, *rates: float) -> ScriptedPromise:
    """The promise that a trainer must keep from now on."""
    trainer.promise = promise = ScriptedPromise(*rates)
    trainer.ending = replace(trainer.ending, promise=promise)
    return promise


def test_training_ends_when_the_model_that_learned_from_a_success_predicts_the_rate() -> None:
    trainer = make(trials=6, error=own_errors(0.1, 0.9, 0.1), tolerance=0.5)
    # before the rollout of each trial, and after those that succeeded
    promise = promised(trainer, 0.99, 0.8, 0.99, 0.7, 1.0)
    trainer.train()
    rates = [
        (trial.predicted_success_rate, trial.promised_success_rate) for trial in trainer.trials
    ]
    least = [PredictedSuccess(round(rate * SAMPLES)).least for rate in (0.8, 1.0)]
    assert rates == [(0.99, least[0]), (0.99, None), (0.7, least[1])]
    assert trainer.stop_reason == (
        "the own rollout succeeded, and the model predicts success from 99.4% of the starts at "
        "least"
    )
    assert promise.fitted == [HORIZON, 2 * HORIZON, 2 * HORIZON, 3 * HORIZON, 4 * HORIZON]


def test_optimiser_of_the_method_does_every_search(monkeypatch: pytest.MonkeyPatch) -> None:
    adam, given = partial(torch.optim.Adam, lr=0.02), []

    def recorded(*arguments: object, optimizer: object, **options: object) -> object:
        given.append(optimizer)
        return minimise_function(*arguments, optimizer=optimizer, **options)

    monkeypatch.setattr(policy_search, "minimise_function", recorded)
    learned(trials=1, method=Method(optimizer=adam))
    assert given == [adam] * len(given) and len(given) > 1


def test_model_is_fitted_once_to_the_same_experience(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    fit = GPDynamics.fit

    def counted(dynamics: GPDynamics, inputs: Tensor, targets: Tensor) -> object:
        sizes.append(len(inputs))
        return fit(dynamics, inputs, targets)

    monkeypatch.setattr(GPDynamics, "fit", counted)
    trainer = make(trials=2, error=own_errors(0.1, 0.1), tolerance=0.5)
    promised(trainer, *[0.5] * 6)
    trainer.train()
    trainer.best_policy()
    assert sizes == [HORIZON, 2 * HORIZON, 3 * HORIZON]


@pytest.mark.parametrize(
    ("errors", "limit", "confirmations", "reason"),
    [
        ((0.1,), 6, 1, "the own rollout succeeded"),
        ((0.1, 0.9, 0.1, 0.5), 5, 2, "the own rollouts of two trials in a row succeeded"),
        ((0.1, 0.9, 0.1, 0.1, 0.1), 6, 3, "the own rollouts of three trials in a row succeeded"),
        ((0.1,), 1, 2, "limit of trials"),
        ((0.1, 0.9, 0.1), 3, 2, "limit of trials"),
        ((0.9, 0.9), 2, 2, "limit of trials"),
    ],
    ids=str,
)
def test_training_ends_after_own_successes_in_a_row_or_at_the_limit(
    errors: tuple[float, ...], limit: int, confirmations: int, reason: str
) -> None:
    """Trials are reported one by one when their rollout is done."""
    told: list[Trial] = []
    ending = {"tolerance": 0.5, "confirmations": confirmations}
    trainer = learned(limit, report=told.append, error=own_errors(*errors), **ending)
    assert [trial.own_error for trial in told] == pytest.approx(list(errors))
    assert [trial.own_success for trial in told] == [error <= 0.5 for error in errors]
    assert told == trainer.trials and trainer.stop_reason == reason
    assert len(trainer.experience) == (1 + len(errors)) * HORIZON


def timeless(trials: list[Trial]) -> list[dict[str, object]]:
    return [asdict(replace(trial, gp_seconds=0.0, search_seconds=0.0)) for trial in trials]


def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A terminal that is standard error from now on."""
    screen = io.StringIO()
    screen.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", screen)
    return screen


def test_same_seed_gives_the_same_trials_bit_for_bit_with_a_progress_bar_too(
    trained: PMILTrainer, monkeypatch: pytest.MonkeyPatch
) -> None:
    screen = terminal(monkeypatch)
    again = learned(trials=2, progress_bar=True)
    assert screen.getvalue()
    assert timeless(again.trials) == timeless(trained.trials)
    for key in ("observation", "action"):
        assert torch.equal(again.experience.transitions[key], trained.experience.transitions[key])


def test_what_is_done_is_shown_beside_the_progress_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[str] = []
    terminal(monkeypatch)
    trainer = make(trials=1, progress_bar=True)
    monkeypatch.setattr(tqdm, "set_postfix_str", lambda bar, text: shown.append(text))
    trainer.train()
    assert shown[:2] == ["the robot moves", f"fitting the model to {HORIZON} transitions"]
    assert shown[2].startswith("search: ")
    assert shown[-1] == "limit of trials"


def test_bar_of_a_run_that_learned_before_its_last_trial_ends_at_its_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    screen = terminal(monkeypatch)
    trainer = learned(trials=9, progress_bar=True, tolerance=1e6, confirmations=1)
    assert len(trainer.trials) == 1
    last = screen.getvalue().rstrip("\n").rpartition("\r")[-1]
    assert "100%" in last and f"{2 * HORIZON}/{2 * HORIZON}" in last
    assert trainer.stop_reason in last


def test_where_standard_error_is_no_terminal_there_is_no_bar(
    capsys: pytest.CaptureFixture[str],
) -> None:
    learned(trials=1, progress_bar=True)
    assert capsys.readouterr().err == ""


def test_other_seed_gives_another_run(trained: PMILTrainer) -> None:
    other = learned(trials=1, seed=1)
    assert timeless(other.trials) != timeless(trained.trials[:1])
    ours, theirs = rollouts_of(trained)[0], rollouts_of(other)[0]
    assert not torch.equal(ours["observation"][0], theirs["observation"][0])
    assert not torch.equal(ours["action"], theirs["action"])


# the choice of the policy


@pytest.fixture
def candidates(trained: PMILTrainer, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Candidate]:
    """Chooses among policies, numbered from 1, of these own errors and predicted KLs.

    A KL of None stands for a prediction that fails.
    """

    def choose(
        *outcomes: tuple[float, float | None],
        promise: ScriptedPromise | None = None,
        measured: tuple[float, ...] = (),
    ) -> Candidate:
        policy, made = trained.loss_module.actor_network, []
        for trial, (own_error, _) in enumerate(outcomes, start=1):
            parameters = {name: value.clone() for name, value in policy.state_dict().items()}
            parameters["weights"].fill_(trial)
            made.append(Candidate(trial, parameters, own_error))

        def per_step(_: object) -> Tensor:
            kl = outcomes[int(policy.weights[0, 0].item()) - 1][1]
            if kl is None:
                raise PredictionError("prediction of step 2 failed", 2)
            return torch.tensor([kl / 2, kl / 2])

        monkeypatch.setattr(trained.state, "candidates", made)
        count = 20 if measured else 0
        trials = [
            SimpleNamespace(steps=HORIZON, success_rate=rate, n_eval=count)
            for rate in measured or [None] * len(made)
        ]
        monkeypatch.setattr(trained.state, "trials", trials)
        monkeypatch.setattr(trained, "promise", promise)
        monkeypatch.setattr(trained, "tolerance", 0.25)
        monkeypatch.setattr(trained.loss_module, "per_step", per_step)
        return trained.best_policy()

    return choose


@pytest.mark.parametrize(
    ("outcomes", "best"),
    [
        ([(0.3, 1.0), (0.2, 9.0), (0.1, 5.0), (0.05, 7.0)], 3),
        ([(0.25, 1.0), (0.1, 5.0)], 1),
        ([(0.9, 1.0), (0.6, 9.0), (0.7, 2.0)], 2),
        ([(0.1, None), (0.2, 5.0)], 2),
        ([(0.1, None), (0.3, 5.0)], 1),
    ],
    ids=["least KL", "at the tolerance", "least error", "failed KL is worst", "success before KL"],
)
def test_best_policy(
    candidates: Callable[..., Candidate], trained: PMILTrainer, outcomes: list, best: int
) -> None:
    """It is chosen under a model of all experience."""
    assert candidates(*outcomes).trial == best
    assert (trained.loss_module.actor_network.weights == best).all()
    assert len(trained.loss_module.dynamics.train_inputs) == len(trained.experience)


@pytest.mark.parametrize(
    ("rates", "best"),
    [((0.5, 0.9, 0.7), 2), ((0.99, 1.0, 0.98), 3), ((0.0, 0.0, 0.0), 3)],
    ids=["highest rate", "alike beyond the aim", "nothing is predicted to succeed"],
)
def test_best_policy_is_predicted_to_succeed_most_often(
    candidates: Callable[..., Candidate], rates: tuple[float, ...], best: int
) -> None:
    """Own errors and KL decide among those that are alike."""
    outcomes = [(0.9, 2.0), (0.2, 3.0), (0.1, 1.0)]
    assert candidates(*outcomes, promise=ScriptedPromise(*rates)).trial == best


@pytest.mark.parametrize(
    ("own", "rates", "measured", "best"),
    [
        ((0.1, 0.1), (0.96, 0.99), (1.0, 0.8), 1),
        ((0.1, 0.1), (0.6, 0.99), (0.95, 0.95), 2),
        ((0.1, 0.1), (0.6, 0.99), (0.95, 0.9), 2),
        ((0.1, 0.1), (0.3, 1.0), (0.7, 0.1), 1),
        ((0.1, 0.9), (0.95, 0.97), (), 1),
        ((0.9, 0.1), (0.99, 0.5), (), 1),
        ((0.1, 0.1), (), (0.5, 0.6), 2),
        ((0.1, 0.9), (), (0.95, 1.0), 1),
        ((math.inf, 0.9), (0.99, 0.1), (1.0, 0.0), 2),
    ],
    ids=[
        "measured far better",
        "measured alike, predicted better",
        "one start of 20 weighs less than the prediction",
        "a model that is sure and wrong",
        "own success, predicted alike",
        "own failure, predicted far better",
        "nothing predicted",
        "own rollout counts as one start, and errors decide where all is alike",
        "cut short",
    ],
)
def test_best_policy_is_best_by_what_was_measured_and_predicted(
    candidates: Callable[..., Candidate],
    own: tuple[float, float],
    rates: tuple[float, ...],
    measured: tuple[float, ...],
    best: int,
) -> None:
    promise = ScriptedPromise(*rates) if rates else None
    outcomes = [(error, 1.0) for error in own]
    assert candidates(*outcomes, promise=promise, measured=measured).trial == best


# what the robot executes


@pytest.fixture
def actor() -> RobotActor:
    task, generator = short_experiment(HORIZON), torch.Generator().manual_seed(0)
    policy = task.make_policy(generator)
    motion = RandomActions(task.actions, 0.4, HORIZON).motion(generator)
    return RobotActor(policy, task.space, motion)


def test_exploring_robot_acts_uniformly_within_its_fraction_of_the_limit(actor: RobotActor) -> None:
    """Mean and variance of a uniform distribution, to four standard errors."""
    fractions = actor(torch.zeros(2000, 4, dtype=torch.float64)) / (0.4 * actor.policy.u_max)
    assert fractions.shape == (2000, 2)
    assert (fractions.abs() <= 1).all()
    assert (fractions.mean(0).abs() < 4 * (1 / 3 / 2000) ** 0.5).all()
    assert ((fractions.square().mean(0) - 1 / 3).abs() < 4 * (4 / 45 / 2000) ** 0.5).all()


def test_robot_that_no_longer_explores_follows_its_policy(actor: RobotActor) -> None:
    actor.exploring = False
    states = torch.linspace(-1, 1, 12, dtype=torch.float64).reshape(3, 4)
    actions = actor(states)
    assert_close(actions, actor.policy(actor.space.features(states)).detach(), rtol=1e-12, atol=0)
    assert not actions.requires_grad


def test_states_of_rollouts_are_the_start_and_all_that_followed() -> None:
    path = torch.arange(2 * 5 * 3.0).reshape(2, 5, 3)
    rollout = rollout_of(path)
    assert rollout.batch_size == (2, 4)
    assert torch.equal(rollout["next", "observation"], path[:, 1:])
    assert torch.equal(states_of(rollout), path)
    assert torch.equal(states_of(without_sensor_noise(rollout)), path)
    truth = path + 1
    rollout["state"], rollout["next", "state"] = truth[:, :-1], truth[:, 1:]
    assert torch.equal(states_of(rollout), path)
    assert torch.equal(states_of(without_sensor_noise(rollout)), truth)
    assert torch.equal(states_of(rollout), path)


def test_first_sparse_model_of_a_run_is_told_once() -> None:
    trainer = make(trials=3)
    trainer.loss_module.dynamics.most_exact = 2 * HORIZON
    trainer.loss_module.dynamics.num_inducing = HORIZON
    with pytest.warns(RuntimeWarning, match="posterior is sparse, of 4 inducing inputs") as told:
        trainer.train()
    assert len([one for one in told if "sparse" in str(one.message)]) == 1
