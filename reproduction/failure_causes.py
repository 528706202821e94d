"""What went wrong in a trial, and at the end of a run: decided by numbers, one cause each.

Of a trial whose policy succeeds from fewer than 95 % of fresh starts, the first that applies:

===========================  =====================================================================
cause                        applies if
===========================  =====================================================================
first motion too small       the policy was searched on the first motion alone, which went less
                             than 25 % of the demonstrated way
sure and wrong               95 % or more were predicted, and significantly fewer measured
chance of 20 starts          95 % or more were predicted, and not significantly fewer measured
criterion asks for more      the search was complete and the measured rate is the predicted one:
                             the median failure misses by up to twice the tolerance ...
tail not seen                ... or by more: some starts lead elsewhere
search stopped early         the model was right as far as the search trusted it, and the next step
                             differs from the demonstrations in the mean more than in the spread
model not right, and unsure  all others: fewer than 95 % were predicted, by a model that was wrong
                             or vague
===========================  =====================================================================
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from scipy.stats import fisher_exact

from torch_pmil.runs.diagnosis.measures import COVERED, FOLLOWED, LEARNED, MOVED, UNKNOWN
from torch_pmil.trainer.ending import LIMIT

SIGNIFICANCE = 0.05  # of Fisher's exact test of two success rates
FAR = 2.0  # tolerances: a narrower spread would not mend a failure beyond
UNSURE = "model not right, and unsure"
CAUSES = (
    "first motion too small",
    UNSURE,
    "sure and wrong",
    "search stopped early",
    "tail not seen",
    "criterion asks for more",
    "chance of 20 starts",
)
ENDS = (
    "learned",
    "ended by luck, and the model knew",
    "ended by luck, and the model did not know",
    LIMIT,
)


@dataclass(frozen=True)
class ReplayedTrial:
    """What was expected of a trial's policy before its own rollout, and what came.

    Args:
        trial: 1, 2, ...
        success_rate: measured from ``n_eval`` fresh starts.
        n_eval: their number.
        own_success: whether the own rollout succeeded.
        complete: whether the search trusted the prediction up to the last step.
        predicted_before: success rate of imagined rollouts, by the model it was searched on.
        predicted_after: the same once the model has learned from the own rollout.
        samples: number of imagined rollouts.
        loss: predicted loss of the whole trajectory, by the model it was searched on, nats; None
            where the model could not predict.
        miss: median error of their failures before, in tolerances; None where there is none.
        covered: least share, over the entries of the state, of one-step errors within two standard
            deviations, up to the step to which the search trusted the prediction.
        followed: share of executed states within two of the predicted p(x_1..T), up to there; None
            as for the loss.
        known: share of the steps, up to there, at which the model knows something; None likewise.
        spread_share: share of the spread in the KL of the first step that was not trusted; None
            where all were.
        coverage_ahead: share of executed states within two standard deviations of the prediction
            from an earlier state, by the number of steps ahead.
    """

    trial: int
    success_rate: float
    n_eval: int
    own_success: bool
    complete: bool
    predicted_before: float
    predicted_after: float
    samples: int
    loss: float | None
    miss: float | None
    covered: float
    followed: float | None
    known: float | None
    spread_share: float | None
    coverage_ahead: Mapping[str, float]


def cause_of(trial: ReplayedTrial, moved: float) -> str | None:
    """Why the policy of a trial fails from more than 5 % of fresh starts; None if it does not.

    Args:
        trial: as it was replayed.
        moved: fraction of the demonstrated way that the first motion went.

    Returns:
        One of ``CAUSES``.

    Example:
        >>> numbers = dict(trial=4, success_rate=0.4, n_eval=20, own_success=True, complete=True,
        ...     predicted_before=1.0, predicted_after=0.5, samples=100, loss=1.0, miss=None,
        ...     covered=0.9, followed=0.9, known=1.0, spread_share=None, coverage_ahead={})
        >>> cause_of(ReplayedTrial(**numbers), moved=1.0)
        'sure and wrong'
    """
    if trial.success_rate >= LEARNED:
        return None
    if trial.trial == 1 and moved < MOVED:
        return "first motion too small"
    if trial.predicted_before >= LEARNED:
        return "sure and wrong" if _p_value(trial, "less") < SIGNIFICANCE else "chance of 20 starts"
    if trial.complete and _p_value(trial, "two-sided") >= SIGNIFICANCE:
        far = trial.miss is not None and trial.miss > FAR
        return "tail not seen" if far else "criterion asks for more"
    if not trial.complete and _stuck(trial):
        return "search stopped early"
    return UNSURE


def _p_value(trial: ReplayedTrial, alternative: str) -> float:
    """Of Fisher's exact test that the measured rate is the predicted one."""
    table = [
        [round(rate * count), round((1 - rate) * count)]
        for rate, count in (
            (trial.success_rate, trial.n_eval),
            (trial.predicted_before, trial.samples),
        )
    ]
    return fisher_exact(table, alternative).pvalue


def _stuck(trial: ReplayedTrial) -> bool:
    """Whether the model was right as far as it was trusted, and sure of the step beyond."""
    if trial.followed is None or trial.known is None or trial.spread_share is None:
        return False
    right = trial.covered >= COVERED and trial.followed >= FOLLOWED and 1 - trial.known <= UNKNOWN
    return right and trial.spread_share < 0.5


def end_of(saved_success_rate: float, predicted: float, stop_reason: str) -> str:
    """How a run ended.

    Args:
        saved_success_rate: of its saved policy, from fresh starts.
        predicted: success rate of that policy by the newest model.
        stop_reason: why the run ended.

    Returns:
        One of ``ENDS``.

    Example:
        >>> end_of(0.8, 0.83, "the own rollouts of two trials in a row succeeded")
        'ended by luck, and the model knew'
    """
    if saved_success_rate >= LEARNED:
        return "learned"
    if stop_reason == LIMIT:
        return LIMIT
    knew = "knew" if predicted < LEARNED else "did not know"
    return f"ended by luck, and the model {knew}"


def trials_not_needed(trials: Sequence[ReplayedTrial]) -> int:
    """Trials after one that succeeded, and whose policy the model then promised to succeed."""
    needed = next(
        (t.trial for t in trials if t.own_success and t.predicted_after >= LEARNED), len(trials)
    )
    return len(trials) - needed
