"""Captions of a run's pictures: what they show, and how to read them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Title and text of a picture.

    Args:
        title: a few words.
        text: what is drawn, and what it looks like when all is right.
    """

    title: str
    text: str


CAPTIONS = {  # in the order of the page
    "trajectories": Caption(
        "Demonstrated, predicted and executed",
        "Blue is what was demonstrated, orange the outline of what the model predicts, both from "
        "the first step that is compared; dashed are the first five rollouts of the robot from "
        "fresh starts. When all is right the outline lies on the edges of the band, and the "
        "rollouts run inside both. Rollouts outside the outline: the model is wrong there. An "
        "outline beside the band: the search did not get further.",
    ),
    "writing": Caption(
        "In the plane",
        "Strokes of people, what was predicted for the robot's tip (an ellipse of two standard "
        "deviations at each step), and the first five strokes that it wrote.",
    ),
    "poses": Caption(
        "Poses of one rollout", "The robot from the start (bright) to the end (dark)."
    ),
    "learning_curve": Caption(
        "Learning curve",
        "Above, the success rate from fresh starts after each trial; below, what the search made "
        "of its objective, where a cross stands for a policy that the model could not predict. The "
        "star at the end is the saved policy, measured anew. The rate comes up once the objective "
        "is low over the whole horizon. A dip, as from 100 % to 0 % and back, is one trial whose "
        "search ended in another optimum, or was misled by a model that the next rollout put "
        "right; the saved policy is the best that ran, so a dip costs it nothing.",
    ),
    "kl_per_step": Caption(
        "Where the KL comes from",
        "The KL of each time step, above by means that differ and spreads that differ, below by "
        "what is observed, each entry given those below it in the legend. When all is right no "
        "step stands out. A sudden rise that stays is where the search is stuck; blue alone is a "
        "prediction that is too wide or too narrow, though its mean is right.",
    ),
    "calibration": Caption(
        "Calibration of the model",
        "One-step predictions along rollouts from fresh starts, which the model has not learned "
        "from. Left, lines below the diagonal: the model is surer than it is right. Right, above "
        "1: errors are larger than it says, at that time.",
    ),
    "model": Caption(
        "Slices through the model",
        "Each output over the actions and the other inputs on which the model depends most, "
        "through where the robot was halfway. The band should be narrow where there are data and "
        "widen beyond; dots outside it are transitions that the model does not explain.",
    ),
    "policy": Caption(
        "The policy",
        "Action (colour) over position and velocity of a joint, the other joints held where the "
        "prediction is at that time (the white dot is the state itself), and where the model "
        "says the robot goes from there (arrows). Around the dot the arrows should lead along "
        "the motion or, at its end, towards the dot; full red or blue around it is an action "
        "at the end of its range.",
    ),
}


# of runs that are judged by the robot's own rollouts alone
ALONE = {
    "trajectories": Caption(
        CAPTIONS["trajectories"].title,
        "Blue is what was demonstrated, orange the outline of what the model predicts, both from "
        "the first step that is compared; dashed is the saved policy's own rollout, up to where "
        "it was cut short, if it was. When all is right the outline lies on the edges of the "
        "band, and the rollout runs inside both.",
    ),
    "learning_curve": Caption(
        "Learning curve",
        "Above, whether the own rollout of each trial succeeded, each of them with a new policy; "
        "below, what the search made of its objective, where a cross stands for a policy that the "
        "model could not predict. The star at the end is the saved policy by its own rollout.",
    ),
    "calibration": Caption(
        "Calibration of the model",
        "One-step predictions along the saved policy's own rollout. The model has learned from "
        "it, so this says less than it would of new rollouts. Left, lines below the diagonal: the "
        "model is surer than it is right. Right, above 1: errors are larger than it says, at that "
        "time.",
    ),
}


def caption_of(name: str, targets: list[str], alone: bool = False) -> Caption:
    """The caption of a figure by its name; ``..._target_0`` names a figure of one target.

    Args:
        name: as the figure's file is called.
        targets: what the targets are called, in their order.
        alone: whether the robot's own rollouts alone say what the run came to.

    Example:
        >>> caption_of("policy_target_1", ["y = 0", "y = 1"]).title
        'The policy, y = 1'
        >>> caption_of("my_own", []).title
        'my own'
    """
    kind, _, number = name.partition("_target_")
    known = CAPTIONS | ALONE if alone else CAPTIONS
    caption = known.get(kind, Caption(kind.replace("_", " "), ""))
    if not number:
        return caption
    target = f"target {number}"
    if number.isdecimal() and int(number) < len(targets):
        target = targets[int(number)]
    return Caption(f"{caption.title}, {target}", caption.text)


def place_of(name: str) -> tuple[int, str]:
    """The key that sorts figures: the order of ``CAPTIONS``, then their names."""
    kind = name.partition("_target_")[0]
    return list(CAPTIONS).index(kind) if kind in CAPTIONS else len(CAPTIONS), name
