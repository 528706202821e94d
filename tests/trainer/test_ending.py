"""Why a run whose own rollouts succeed reaches its limit of trials all the same."""

from __future__ import annotations

from types import SimpleNamespace

import pytest
from torch import Tensor

from torch_pmil.search.promise import Promise
from torch_pmil.trainer.ending import AGAIN, LIMIT, Ending


def error(states: Tensor) -> Tensor:
    return states[..., 0, 0]


@pytest.mark.parametrize("measured", [None, 0.95])
@pytest.mark.parametrize(("confirmations", "needed"), [(1, AGAIN), (5, 5)])
def test_own_successes_again_and_again_end_a_run_whatever_is_promised(
    confirmations: int, needed: int, measured: float | None
) -> None:
    ending = Ending(9, confirmations, Promise(0.95, error, 0.1))
    poor = SimpleNamespace(own_success=True, promised_success_rate=0.5, success_rate=measured)
    failed = SimpleNamespace(own_success=False, promised_success_rate=None)
    assert ending.reason([failed, *[poor] * (needed - 1)]) == ""
    assert "trials in a row succeeded" in ending.reason([failed, *[poor] * needed])
    assert ending.reason([*[poor] * (needed - 1), failed]) == ""


def test_own_successes_end_no_run_whose_policies_were_measured_to_fail_too_often() -> None:
    poor = SimpleNamespace(own_success=True, promised_success_rate=0.5, success_rate=0.9)
    good = SimpleNamespace(**{**vars(poor), "success_rate": 1.0})
    ending = Ending(9, 1, Promise(0.95, error, 0.1))
    assert ending.reason([good, poor, poor, good]) == ""  # 28 of 30, by the last three
    assert "three trials in a row" in ending.reason([poor, poor, good, good])


@pytest.mark.parametrize(
    ("promised", "ends"), [((0.96, 0.95), True), ((0.96, 0.94), False), ((0.94, 0.96), False)]
)
def test_two_successes_of_models_that_predict_the_promised_rate_end_a_run(
    promised: tuple[float, float], ends: bool
) -> None:
    trials = [SimpleNamespace(own_success=True, promised_success_rate=rate) for rate in promised]
    reason = Ending(9, 1, Promise(0.95, error, 0.1)).reason(trials)
    assert bool(reason) == ends
    assert not ends or reason.endswith("both models predict success from 95.0% of the starts")


@pytest.mark.parametrize(
    ("confirmations", "rate", "promised", "unmet"),
    [
        (1, 0.95, (None, None), ""),
        (1, 0.95, (None, 0.99), ""),
        (
            1,
            0.95,
            (0.93, None, 0.957, None, 0.96),
            "the own rollout succeeded in 3 of 5 trials, but the model promises success from 96.0% "
            "of the starts at most, where promise=0.95 asks 97.5%; more trials may reach that, and "
            "promise=0.91 would have ended the run at trial 3",
        ),
        (
            1,
            0.8,
            (0.4,),
            "the own rollout succeeded in 1 of 1 trials, but the model promises success from 40.0% "
            "of the starts at most, where promise=0.8 asks 90.0%; more trials may reach that",
        ),
        (
            2,
            0.95,
            (0.97, None, 0.6, 0.9),
            "the own rollout succeeded in 3 of 4 trials, but the model promises success from 90.0% "
            "of the starts at most, where promise=0.95 asks 97.5%; more trials may reach that, and "
            "promise=0.79 would have ended the run at trial 4",
        ),
        (
            3,
            None,
            (0.9, 0.9, None),
            "the own rollout succeeded in 2 of 3 trials, but confirmations=3 asks for that many in "
            "a row",
        ),
    ],
)
def test_run_says_what_it_lacked_at_its_limit(
    confirmations: int, rate: float | None, promised: tuple[float | None, ...], unmet: str
) -> None:
    promise = None if rate is None else Promise(rate, error, 0.1)
    trials = [
        SimpleNamespace(own_success=least is not None, promised_success_rate=least)
        for least in promised
    ]
    ending = Ending(len(trials), confirmations, promise)
    assert ending.unmet(trials) == unmet
    assert not unmet or ending.reason(trials) == LIMIT
    named = unmet.partition("and promise=")[2].partition(" would have ended the run at trial ")
    if named[2]:
        sooner = Ending(len(trials), confirmations, Promise(float(named[0]), error, 0.1))
        ends = [sooner.reason(trials[: n + 1]) for n in range(int(named[2]))]
        assert not any(ends[:-1]) and ends[-1] not in ("", LIMIT)
