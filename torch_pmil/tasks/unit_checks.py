"""Whether recordings are in the robot's units, as far as robot and recordings show it."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping

import torch
from torch import Tensor

from torch_pmil.demonstrations import DemonstrationError, Demonstrations, Recordings
from torch_pmil.demonstrations.turns import values_of

DEGREES = 180 / math.pi
CENTI = 100.0  # too near to 57.3 and 1000 where a ratio is known roughly
FACTORS = {
    "rad": {DEGREES: "degrees"},
    "m": {CENTI: "centimetres", 1e3: "millimetres"},
    "": {DEGREES: "degrees"},
}
THOUSANDTHS = {1e3: "thousandths of its unit", 1e6: "millionths of its unit"}
ALIKE = 0.05  # relative difference of two numbers that count as equal
ROUGHLY = 7.0  # the same of a ratio that says little more than the order of magnitude
FAR = 10.0  # standard deviations from 0 of a start whose unit shows
OUTSIDE = 0.05  # of the recorded range, by which noise may exceed limits
BEYOND = 3.0  # times the largest value that a robot allows: no person would show that
SMALL = 50.0  # by which a motion is smaller than the limits allow, at most
MOVED = 20.0  # times the motion of a robot that was tried: a larger motion is doubted
FEW_TURNS = 8 * math.pi  # up to which an angle whose unit is known may be in rad
TURNS, MOVED_ANGLE = 4 * math.pi, 5.0  # the same of what turns so far, if it may be an angle


def check_units(
    recorded: Demonstrations | Recordings,
    units: Mapping[str, str],
    starts: Mapping[str, Tensor],
    limits: Mapping[str, tuple[float, float]],
) -> None:
    """Compare recorded entries with what the robot says of the entries of the same names.

    Args:
        recorded: as read.
        units: of the state's entries; "" if unknown.
        starts: values of each entry in the robot's starts, (S,).
        limits: lowest and highest value of each entry, infinite if unknown.

    Warns of an entry that begins at a known multiple of the robot's start, and of one that goes
    beyond its limits, unless these are a turn.

    Raises:
        DemonstrationError: an entry goes far beyond its limits, or an entry dNAME is a known
            multiple of the rate at which NAME changes.

    Example:
        >>> shown = 57.3 * torch.linspace(0, 1, 21).expand(3, 21)[..., None]
        >>> try:
        ...     check_units(Demonstrations(shown, 0.1, ("q",)), {"q": "rad"}, {}, {"q": (-3, 3)})
        ... except DemonstrationError as error:
        ...     print(str(error).partition(",")[0])
        q looks like degrees
    """
    for name in recorded.names:
        values = [each[:, recorded.names.index(name)] for each in values_of(recorded)]
        unit = units.get(name, "")
        if name in limits:
            _check_limits(name, torch.cat(values), limits[name], unit)
        if name in starts:
            _check_starts(name, torch.stack([each[0] for each in values]), starts[name], unit)
        if f"d{name}" in recorded.names:
            _check_rate(recorded, name, units.get(f"d{name}", ""))


def looks_like(name: str, factor: float, unit: str, roughly: bool = False) -> str:
    """The unit of numbers that are ``factor`` times too large, as ``"q looks like degrees"``.

    Empty if the factor is not, or not even roughly, that of a unit.

    Example:
        >>> looks_like("q", 57.3, "rad"), looks_like("x", 0.001, "mm"), looks_like("x", 2.0, "m")
        ('q looks like degrees', 'x looks like a unit 1000 times larger', '')
    """
    of, _, per = unit.partition("/")
    known = {CENTI: "hundredths of its unit"} | THOUSANDTHS | FACTORS.get(of, {})
    if roughly:
        del known[CENTI]
    apart = {times: abs(abs(math.log(factor)) - math.log(times)) for times in known}
    times = min(apart, key=lambda one: apart[one])
    if apart[times] > math.log1p(ROUGHLY if roughly else ALIKE):
        return ""
    if factor < 1:
        return f"{name} looks like a unit {times:.4g} times larger"
    return f"{name} looks like {known[times]}" + (f" per {per}" if per else "")


def check_motion(
    recorded: Mapping[str, tuple[float, float]],
    moved: Mapping[str, float],
    units: Mapping[str, str],
    times: float = 1.0,
) -> list[str]:
    """Doubts of entries that were recorded over far more than the robot moved when it was tried.

    Example:
        >>> check_motion({"q": (0.0, 57.3)}, {"q": 0.6}, {"q": "rad"})[0][:40]
        'q looks like degrees: recorded from 0 to'
    """
    doubts = []
    for name, (low, high) in recorded.items():
        may_be_an_angle = units[name] in ("", "rad") and high - low > TURNS
        least = MOVED_ANGLE if may_be_an_angle else MOVED
        if not 0 < least * times * moved[name] < high - low:
            continue
        larger = (high - low) / moved[name]
        what = (
            looks_like(name, larger, units[name], roughly=True) or f"{name} may be in another unit"
        )
        doubts.append(
            f"{what}: recorded from {low:.3g} to {high:.3g}, where the robot moved within "
            f"{moved[name]:.3g} {units[name]}".rstrip()
            + " when it was tried with slow actions"
        )
    return doubts


def _check_limits(name: str, values: Tensor, limits: tuple[float, float], unit: str) -> None:
    low, high = values.min().item(), values.max().item()
    where = (
        f"recorded from {low:.3g} to {high:.3g}, where the robot moves within {limits[0]:.3g} to "
        f"{limits[1]:.3g} {unit}"
    ).rstrip()
    largest, allowed = max(abs(low), abs(high)), max(map(abs, limits))
    width, noise = limits[1] - limits[0], OUTSIDE * (high - low)
    one_turn = math.isclose(width, 2 * math.pi, rel_tol=ALIKE)  # of an angle that may go on
    if 0 < BEYOND * allowed < largest:
        what = _other_unit(largest, allowed, unit)
        if not (one_turn and unit and largest < FEW_TURNS):
            raise DemonstrationError(f"{name} {what}, or is out of reach: {where}; convert it")
        warnings.warn(f"{name} {what}, or turns round: {where}", UserWarning, stacklevel=6)
    if not (one_turn or limits[0] - noise <= low <= high <= limits[1] + noise):
        warnings.warn(f"{name} is out of reach: {where}", UserWarning, stacklevel=6)


def _other_unit(largest: float, allowed: float, unit: str) -> str:
    """What an entry looks like whose largest value is beyond what a robot allows."""
    least = allowed / SMALL
    known = [
        {times: what for times, what in factors.items() if least <= largest / times <= allowed}
        for factors in (FACTORS.get(unit, {}), THOUSANDTHS)
    ]
    fits = " or ".join((known[0] or known[1]).values())
    return f"looks like {fits}" if fits else "is in another unit"


def _check_starts(name: str, first: Tensor, starts: Tensor, unit: str) -> None:
    ours, theirs = starts.mean().item(), first.mean().item()
    spread = starts.std().item() if len(starts) > 1 else 0.0
    if ours == 0 or abs(ours) < FAR * spread or not 0 < theirs / ours < math.inf:
        return
    if first.std() > ALIKE * abs(theirs):
        return
    if what := looks_like(name, theirs / ours, unit):
        warnings.warn(  # or it happens to be so
            f"{what}: recordings begin at {theirs:.4g}, where the robot starts at {ours:.4g} "
            f"{unit}".rstrip()
            + "; if so, convert the recordings",
            UserWarning,
            stacklevel=6,
        )


def _check_rate(recorded: Demonstrations | Recordings, name: str, unit: str) -> None:
    """Refuse a recorded velocity that is a known multiple of its position's changes."""
    at, rate = recorded.names.index(name), recorded.names.index(f"d{name}")
    changes, sums = [], []
    for number, values in enumerate(values_of(recorded)):
        if isinstance(recorded, Demonstrations):
            steps: Tensor | float = recorded.time_step
        else:
            steps = recorded.times[number].diff()
        changes.append(values[:, at].diff())
        sums.append(steps * (values[:-1, rate] + values[1:, rate]) / 2)
    change, summed = torch.cat(changes), torch.cat(sums)
    if not (change.any() and summed.any()):
        return
    factor = ((summed @ summed) / (summed @ change)).item()
    explained = (change * factor - summed).square().sum() < ALIKE * summed.square().sum()
    if explained and factor > 0 and (what := looks_like(f"d{name}", factor, unit)):
        raise DemonstrationError(
            f"{what}: it is {factor:.4g} times the recorded change of {name}; convert the "
            "recordings"
        )
