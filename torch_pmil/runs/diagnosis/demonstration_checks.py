"""Checks for demonstrations that break what the method assumes, made before a robot learns.

This module knows no particular robot. ``sets`` are the demonstrations of each target, and
``numbers`` what messages call them. ``noise_std`` is the observation noise, () or (M,), the unit in
which entries are compared.
"""

from __future__ import annotations

from collections.abc import Sequence

import scipy
import torch
from torch import Tensor

from torch_pmil.demonstrations import Demonstrations
from torch_pmil.demonstrations.turns import jumps_by_turns
from torch_pmil.gp.gaussian import Gaussian
from torch_pmil.runs.diagnosis.findings import CONTRADICTORY, FEW, WRAPS, Finding
from torch_pmil.runs.diagnosis.modes import Split, split_in_two

SIGNIFICANCE = 0.01  # of two modes: false alarms
LEAST_EXPLAINED = 0.75  # of all scatter, by two modes
UNTESTED = 3  # demonstrations, up to which two modes are no surprise
PARTED = 3.0  # standard deviation between demonstrations over that of their starts
START_SIGNIFICANCE = 1e-3  # of a start beside p(x_0), for all demonstrations together
# largest difference of two that are one, in standard deviations of the observation noise
SAME = 0.01
WIDER = 3.0  # standard deviation of a start over that of what is shown there
LEAST_JUMP = 6.0  # second difference of a jump, in standard deviations of the observation noise
LONE_JUMP = 3.0  # second difference of a jump, over the largest one of other demonstrations
NEARBY = 2  # samples before and after, in which the others are compared
WINDOW = 0.1  # of the duration, in which a change is motion
MOVES = 0.05  # such a change, over the largest one
SHORT_REST = 3  # steps: a rest up to this is not named
SHORT_SHARE = 0.1  # of the duration, likewise
LONG = 500  # steps, whose trials may take an hour: the work grows with the cube of all experience
ENDLESS = 5000  # steps, of which the model of the exploration alone would take hours


def check_agreement(
    sets: Sequence[Demonstrations], numbers: Sequence[Sequence[int]], noise_std: Tensor
) -> list[Finding]:
    """Find demonstrations of one target that show different motions.

    Of two or three, these have less in common than keeps them apart. Of more, these have two modes,
    or one of them is unlike the others.
    """
    found = [
        (_parted if len(each.positions) <= UNTESTED else _modes)(each, known, noise_std)
        for each, known in zip(sets, numbers, strict=True)
    ]
    return [finding for finding in found if finding is not None]


def _modes(
    demonstrations: Demonstrations, known: Sequence[int], noise_std: Tensor
) -> Finding | None:
    split = split_in_two(demonstrations.positions / noise_std)
    if split is None or split.p_value >= SIGNIFICANCE or split.explained <= LEAST_EXPLAINED:
        return None
    lone = min(split.parts, key=len)
    if len(lone) > 1:
        return _two_ways(split, known)
    return _unlike(demonstrations, lone[0], known[lone[0]], noise_std)


def _two_ways(split: Split, known: Sequence[int]) -> Finding:
    first, second = (", ".join(str(known[member]) for member in part) for part in split.parts)
    return Finding(
        CONTRADICTORY,
        f"demonstrations {first} and {second} show two different ways "
        f"({100 * split.explained:.0f} % of the spread is between them, p = {split.p_value:.4f}); "
        "their mean is neither: train on one of them alone",
    )


def _unlike(demonstrations: Demonstrations, lone: int, number: int, noise_std: Tensor) -> Finding:
    """One demonstration beside the others, where it is farthest from their mean."""
    positions = demonstrations.positions
    others = torch.cat([positions[:lone], positions[lone + 1 :]])
    mean, std = others.mean(0), others.std(0)
    step, entry = place(((positions[lone] - mean) / noise_std).abs())
    return Finding(
        "one demonstration unlike the others",
        f"demonstration {number} is unlike the others: at {step * demonstrations.time_step:.2f} s "
        f"its {demonstrations.names[entry]} is {positions[lone, step, entry]:.3g}, theirs "
        f"{mean[step, entry]:.3g} ± {std[step, entry]:.2g}; look at it: leave it out if it went "
        "wrong, align it (pmil align) if it is late",
    )


def _parted(
    demonstrations: Demonstrations, known: Sequence[int], noise_std: Tensor
) -> Finding | None:
    """Demonstrations that begin alike and part; others come together from different starts."""
    scaled = demonstrations.positions / noise_std
    mean = scaled.mean(0)
    apart = (scaled - mean).square().mean(0)  # (T + 1, M)
    common = (mean - mean[0]).square().mean()
    begun = apart[0].mean().clamp(min=1.0)  # at least the noise
    if apart.mean() <= max(common.item(), PARTED**2 * begun.item()):
        return None
    step, entry = place(apart)
    values = ", ".join(f"{value:.3g}" for value in demonstrations.positions[:, step, entry])
    message = (
        f"demonstrations {', '.join(map(str, known))} show different motions: at "
        f"{step * demonstrations.time_step:.2f} s their {demonstrations.names[entry]} is "
        f"{values}, and all that lies between counts as a success; show one way of moving"
    )
    return Finding(CONTRADICTORY, message)


def check_count(sets: Sequence[Demonstrations]) -> list[Finding]:
    """Find too few demonstrations to estimate their spread (Eq. 11)."""
    count = sum(len(each.positions) for each in sets)
    if count - len(sets) >= 2:
        return []
    message = (
        f"{count} demonstrations show the spread in one direction only, and the observation noise "
        "stands for the others; three to five are better"
    )
    return [Finding(FEW, message)]


def check_length(demonstrations: Demonstrations, held: int = 1) -> list[Finding]:
    """Find motions of so many steps that their model would not be fitted in a day.

    A step may be as long as ``held`` time steps of the demonstrations.
    """
    period = held * demonstrations.time_step
    steps = (demonstrations.positions.shape[1] - 1) // held
    if steps <= LONG:
        return []
    message = (
        f"demonstrations have {steps} steps ({steps * period:g} s), and in every rollout the model "
        f"learns from each step; up to {LONG} are learned in reasonable time: show less, or use a "
        "longer control period"
    )
    return [Finding("long demonstrations", message, fatal=steps > ENDLESS)]


def check_duplicates(demonstrations: Demonstrations, noise_std: Tensor) -> list[Finding]:
    """Find demonstrations that are copies of one another: they show less spread than there is.

    Only those that begin alike are compared as a whole. A copy is named with its first original.
    """
    scaled = demonstrations.positions / noise_std
    copies: dict[int, int] = {}
    for first, one in enumerate(scaled):
        alike = ((scaled[:, 0] - one[0]).abs().amax(-1) < SAME).nonzero().flatten()
        later = alike[alike > first]
        same = later[(scaled[later] - one).abs().amax((-2, -1)) < SAME]
        copies = {second: first for second in same.tolist()} | copies
    return [
        Finding(FEW, f"demonstrations {first} and {second} are the same; leave one of them out")
        for second, first in sorted(copies.items(), key=lambda copy: copy[::-1])
    ]


def check_start(
    demonstrations: Demonstrations, start: Gaussian, noise_std: Tensor
) -> list[Finding]:
    r"""Find demonstrations that begin where the robot does not start, p(x_0) in the match space.

    The bound is the :math:`\chi^2` quantile of the observed start.
    """
    belief = start.add_noise(noise_std**2)
    deviation = demonstrations.positions[:, 0] - belief.mean
    factor = torch.linalg.cholesky(belief.cov)
    white = torch.linalg.solve_triangular(factor, deviation.mT, upper=False)
    # of chi-squared
    bound = scipy.special.chdtri(len(belief.mean), START_SIGNIFICANCE / len(deviation))
    findings = []
    for number in (white.square().sum(0) > bound).nonzero().flatten().tolist():
        entry = int((deviation[number] / belief.std).abs().argmax())
        off, std = deviation[number, entry].item(), belief.std[entry].item()
        message = (
            f"demonstration {number} starts at {demonstrations.names[entry]} = "
            f"{demonstrations.positions[number, 0, entry]:.3g}, {off:+.3g} from where the robot "
            f"starts (standard deviation {std:.3g}); cut it, shift it, or start the robot there"
        )
        findings.append(Finding("demonstrations start elsewhere", message))
    return findings


def check_spread(
    sets: Sequence[Demonstrations], start: Gaussian, noise_std: Tensor
) -> list[Finding]:
    """Find entries whose start varies more than demonstrations do, with the noise of both."""
    shown = torch.cat([each.positions[:, 0] for each in sets])
    spread = start.add_noise(noise_std**2).std
    narrow = (shown.var(0, correction=0) + noise_std**2).sqrt()
    entry = int((spread / narrow).argmax())
    if spread[entry] <= WIDER * narrow[entry]:
        return []
    message = (
        f"the robot's starts vary by {spread[entry]:.3g} in {sets[0].names[entry]}, and those of "
        f"demonstrations by {narrow[entry]:.3g}: no policy matches these from there. If readings "
        "are noisy, filter them or hold actions longer; if the robot starts so, show such starts; "
        "if robot and recordings are in different units, convert one of them; or allow more "
        "(noise_std)"
    )
    return [Finding("starts vary more than demonstrations", message)]


def check_rest(demonstrations: Demonstrations, noise_std: Tensor) -> list[Finding]:
    """Find a rest before the motion, in the median of demonstrations.

    It ends with the first window over which the means of half windows change noticeably. So neither
    noise nor the slow start of a smooth motion matters much.
    """
    steps = demonstrations.positions.shape[1] - 1
    window = max(1, int(WINDOW * steps))
    half = max(1, window // 2)
    scaled = (demonstrations.positions / noise_std).mT
    smooth = torch.nn.functional.avg_pool1d(scaled, half, 1)  # (N, M, ·)
    change = (smooth[..., window:] - smooth[..., :-window]).norm(dim=1)
    moves = change >= MOVES * change.amax(1, keepdim=True)
    rest = half + int(moves.int().argmax(1).median())
    if rest <= max(SHORT_REST, SHORT_SHARE * steps):
        return []
    message = (
        f"the demonstrations rest for {rest * demonstrations.time_step:.2g} s before they move, "
        "and a policy knows the state, not the time: cut the rest off, as pmil align --crop does "
        "(with --smooth if recordings are noisy)"
    )
    return [Finding("rest before the motion", message)]


def check_jumps(
    sets: Sequence[Demonstrations], numbers: Sequence[Sequence[int]], noise_std: Tensor
) -> list[Finding]:
    """Find jumps from sample to sample, as from a tracker that lost its point.

    A jump is a second difference that no other demonstration has near that time.
    """
    findings = []
    for demonstrations, known in zip(sets, numbers, strict=True):
        differences = (demonstrations.positions / noise_std).diff(n=2, dim=1)  # (N, T - 1, M)
        if not differences.shape[1]:
            continue
        size = differences.norm(dim=-1)
        near = torch.nn.functional.max_pool1d(size[:, None], 2 * NEARBY + 1, 1, NEARBY)[:, 0]
        largest, next_largest = near.topk(2, 0).values
        others = torch.where(near == largest, next_largest, largest)  # of all but each
        excess = torch.where(size > LONE_JUMP * others, size, 0.0)
        for number, at in enumerate(excess.argmax(1).tolist()):
            if excess[number, at] > LEAST_JUMP:
                entry = demonstrations.names[int(differences[number, at].abs().argmax())]
                message = (
                    f"demonstration {known[number]} jumps in {entry} at "
                    f"{(at + 1) * demonstrations.time_step:.2f} s; pmil align --fastest SPEED "
                    "leaves jumps out of a recording"
                )
                findings.append(Finding("jumps in demonstrations", message))
    return findings


def check_turns(demonstrations: Demonstrations) -> list[Finding]:
    """Find entries that jump by a turn, as angles that are recorded within one turn do."""
    return [Finding(WRAPS, message) for message in jumps_by_turns(demonstrations)]


def place(sizes: Tensor) -> tuple[int, int]:
    """Step and entry of the largest of sizes (T, K)."""
    return divmod(int(sizes.argmax()), sizes.shape[1])
