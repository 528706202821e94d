"""Captions of a run's pictures: what they show, and how to read them."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Title of a picture, and what it looks like when all is right."""

    title: str
    text: str


BANDS = (
    "Blue is the demonstrated distribution, orange the outline of the predicted one, both from the "
    "first step that is compared."
)
SIDES = (
    "Left: lines below the diagonal mean that the model is too sure. Right: values above 1 mean "
    "that errors at that time are larger than predicted."
)
CAPTIONS = {  # in the order of the page
    "trajectories": Caption(
        "Demonstrated, predicted and executed",
        f"{BANDS} Dashed lines are the first five rollouts of the robot "
        "from fresh starts. When all is right, the outline lies on the edges of the band and the "
        "rollouts run inside both. Rollouts outside the outline mean that the model is wrong "
        "there. An outline beside the band means that the search did not get further.",
    ),
    "writing": Caption(
        "In the plane",
        "Strokes of people, the prediction for the robot's tip (an ellipse of two standard "
        "deviations at each step), and the first five strokes that it wrote.",
    ),
    "robot": Caption("The robot", "At its start; a film of it would have taken too long."),
    "poses": Caption(
        "Poses of one rollout", "The robot from the start (bright) to the end (dark)."
    ),
    "learning_curve": Caption(
        "Learning curve",
        "Above is the success rate from fresh starts after each trial, below the objective that "
        "each search reached. A cross is a policy that the model could not predict, and the star "
        "is the saved policy, measured again. The rate rises once the objective is low over the "
        "whole horizon. A dip, as from 100 % to 0 % and back, is one trial whose search ended in "
        "another optimum or was misled by a wrong model. The saved policy is the best that ran "
        "by what was measured and promised, so a dip costs it nothing.",
    ),
    "kl_per_step": Caption(
        "Where the KL comes from",
        "The KL of each time step: above, the parts due to different means and to different "
        "spreads; below, the part of each observed entry, given those below it in the legend. "
        "When all is right, no step stands out. A sudden rise that stays shows where the search is "
        "stuck. Blue alone means that the prediction is too wide or too narrow around the right "
        "mean.",
    ),
    "calibration": Caption(
        "Calibration of the model",
        "One-step predictions along rollouts from fresh starts, which the model has not learned "
        f"from. {SIDES}",
    ),
    "model": Caption(
        "Slices through the model",
        "Each output over the actions and the other inputs on which the model depends most, "
        "through the robot's state halfway. The band should be narrow where there are data and "
        "widen elsewhere. Dots outside it are transitions that the model does not explain.",
    ),
    "policy": Caption(
        "The policy",
        "The action (colour) over position and velocity of a joint, with the other joints at their "
        "predicted state of that time; the white dot is that state. Arrows show where the model "
        "predicts the robot to go. Around the dot they should lead along the motion or, at its "
        "end, towards the dot. Full red or blue there is an action at the end of its range.",
    ),
}
ALONE = {  # of runs that are judged by the robot's own rollouts alone
    "trajectories": Caption(
        CAPTIONS["trajectories"].title,
        f"{BANDS} The dashed line is the saved policy's own rollout, "
        "complete or up to where it was cut short. When all is right, the outline lies on the "
        "edges of the band and the rollout runs inside both.",
    ),
    "learning_curve": Caption(
        "Learning curve",
        "Above is the success of the own rollout of each trial, each with a new policy; below is "
        "the objective that each search reached. A cross is a policy that the model could not "
        "predict, and the star is the saved policy by its own rollout.",
    ),
    "calibration": Caption(
        "Calibration of the model",
        "One-step predictions along the saved policy's own rollout. The model has learned from it, "
        f"so this shows less than new rollouts would. {SIDES}",
    ),
}


def caption_of(name: str, targets: list[str], alone: bool = False) -> Caption:
    """The caption of a figure by its name; ``..._target_0`` names a figure of the first target.

    ``alone`` is for a run that is judged by the robot's own rollouts alone.

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
    found = number.isdecimal() and int(number) < len(targets)
    target = targets[int(number)] if found else f"target {number}"
    return Caption(f"{caption.title}, {target}", caption.text)


def place_of(name: str) -> tuple[int, str]:
    """The key that sorts figures: the order of ``CAPTIONS``, then their names."""
    kind = name.partition("_target_")[0]
    return list(CAPTIONS).index(kind) if kind in CAPTIONS else len(CAPTIONS), name
