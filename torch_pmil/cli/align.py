"""Make demonstrations of recordings: one time step, one length, one timing.

Example:
    pmil align recorded.csv demonstrations.npz --time-step 0.1 --velocities dq1 dq2
    pmil align tracked.csv demonstrations.npz --fastest 5 --smooth 0.2 --draw steps.png

The recording is a file or folder of NPZ, CSV, LASA, Minari, robomimic or LeRobot data. A CSV file
has the columns demonstration,time,NAME,... and, if there are several targets, "target NAME",... for
what each demonstration was for. Its demonstrations may differ in length, and their samples may be
uneven. In this order, and only as told: pixels become metres, jumps are left out, the rest is
smoothed, velocities are derived, rests are cut off. All are sampled at the median time step that
was recorded, aligned by dynamic time warping, and then sampled at the time step of the robot.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from torch_pmil.cli import Parser
from torch_pmil.demonstrations import (
    DemonstrationError,
    Demonstrations,
    Recordings,
    load_recordings,
)
from torch_pmil.demonstrations.preparation.alignment import AlignmentError, crop, resample
from torch_pmil.demonstrations.preparation.camera import plane_coordinates
from torch_pmil.demonstrations.preparation.jumps import without_jumps
from torch_pmil.demonstrations.preparation.smoothing import smooth, velocities
from torch_pmil.demonstrations.preparation.synchronisation import synchronise
from torch_pmil.files import in_words
from torch_pmil.plotting import plot_before_after, save_figure

Timed = tuple[Tensor, Tensor]  # times (T_n,) in s and values (T_n, M)


def align_recordings(recordings: Recordings, options: argparse.Namespace) -> Demonstrations:
    """Demonstrations made of recordings: prepared, aligned and resampled as the options say.

    Args:
        recordings: of any lengths.
        options: of the command line.

    Raises:
        DemonstrationError, AlignmentError: the recordings or an option are not as they must be.
    """
    names = [*recordings.names, *(velocity for velocity, _ in options.derive)]
    rates = [*options.velocities, *names[len(recordings.names) :]]
    derived_from = [position for _, position in options.derive]
    check_names(recordings.names, [*options.velocities, *derived_from])
    preprocessed = [
        preprocessed_one(*one, recordings.names, options)
        for one in zip(recordings.times, recordings.values, strict=True)
    ]
    if options.crop:
        derived = range(len(recordings.names), len(names))
        preprocessed = [cropped(*one, derived) for one in preprocessed]
    times, values = zip(*preprocessed, strict=True)
    prepared = replace(recordings, times=times, values=values, names=tuple(names), places=())
    reference = None
    if options.reference is not None:
        reference = number_of(options.reference, recordings.labels)
    return synchronise(prepared, options.time_step, rates, options.window, reference)


def cropped(times: Tensor, values: Tensor, velocities: Sequence[int]) -> Timed:
    """The part of a recording that moves, at its median time step."""
    step = times.diff().median().item()
    kept = crop(resample(values, times, step), velocities=velocities)
    return step * torch.arange(len(kept), dtype=torch.float64), kept


def preprocessed_one(
    times: Tensor, values: Tensor, names: tuple[str, ...], options: argparse.Namespace
) -> Timed:
    """One recording, prepared: in metres, without jumps, smoothed, with velocities.

    Steps that were not asked for are left out.
    """
    positions = torch.tensor([name not in options.velocities for name in names])
    if options.marker:
        markers = torch.tensor(options.marker, dtype=torch.float64)
        values = values.clone()
        values[:, positions] = in_metres(values[:, positions], markers)
    if options.fastest is not None:
        limits = torch.where(positions, options.fastest, torch.inf).double()
        values, times = without_jumps(values, times, limits)
    if options.smooth is None:
        return times, values
    columns = [names.index(position) for _, position in options.derive]
    derived = velocities(values[:, columns], times, options.smooth)
    return times, torch.cat([smooth(values, times, options.smooth), derived], -1)


def in_metres(values: Tensor, markers: Tensor) -> Tensor:
    """Points (T, 2 P), x and y of each in turn, from pixels to m.

    Markers are rows [pixel x, pixel y, x, y], (K, 4).
    """
    if values.shape[1] % 2:
        raise AlignmentError(
            "with markers the columns must be x and y of each point in turn, got "
            f"{values.shape[1]} columns"
        )
    points = values.unflatten(-1, (-1, 2))
    return plane_coordinates(points, markers[:, :2], markers[:, 2:]).flatten(-2)


def check_names(known: tuple[str, ...], told: list[str]) -> None:
    """Raise AlignmentError unless all that were told are columns."""
    if unknown := sorted(set(told) - set(known)):
        raise AlignmentError(
            f"velocities must be columns of {', '.join(known)}, got {', '.join(unknown)}"
        )


def number_of(label: str, labels: tuple[str, ...]) -> int:
    """Number of the demonstration that is called so."""
    if label not in labels:
        raise AlignmentError(
            f"reference must be one of the demonstrations {', '.join(labels)}, got {label}"
        )
    return labels.index(label)


def draw(recordings: Recordings, demonstrations: Demonstrations, path: Path) -> None:
    """Draw recordings beside the demonstrations that were made of them."""
    before = [
        (times - times[0], values)
        for times, values in zip(recordings.times, recordings.values, strict=True)
    ]
    samples = torch.arange(demonstrations.positions.shape[1], dtype=torch.float64)
    after = [(demonstrations.time_step * samples, values) for values in demonstrations.positions]
    names, title = demonstrations.names, f"every {demonstrations.time_step:g} s"
    save_figure(plot_before_after(names, [""] * len(names), before, after, title), path)


def pair(text: str) -> tuple[str, str]:
    """The two names of VELOCITY=POSITION."""
    velocity, equals, position = text.partition("=")
    if not (velocity and equals and position):
        raise argparse.ArgumentTypeError(f"must be VELOCITY=POSITION, as dq=q, got {text}")
    return velocity, position


def options_of_command_line() -> argparse.Namespace:
    """Read the command line, or end with what is wrong with it."""
    parser = Parser(
        description=__doc__.partition("\n")[0],
        epilog=__doc__.partition("\n\n")[2],
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("recorded", type=Path, metavar="RECORDED", help="file or folder")
    parser.add_argument("out", type=Path, metavar="OUT.npz")
    parser.add_argument(
        "--time-step",
        type=float,
        default=0.1,
        help="of the demonstrations, the robot's control period, in s (0.1)",
    )
    parser.add_argument(
        "--velocities",
        nargs="+",
        default=[],
        metavar="NAME",
        help="columns that are velocities, not positions",
    )
    _add_steps(parser)
    _add_timing(parser)
    _add_reading(parser)
    parser.add_argument(
        "--draw",
        type=Path,
        metavar="PICTURE.png",
        help="what was recorded beside what became of it",
    )
    parser.add_argument(
        "--overwrite", action="store_true", help="replace OUT.npz and PICTURE.png if they are there"
    )
    return parser.parse_args()


def _add_steps(parser: argparse.ArgumentParser) -> None:
    """Add the options that prepare each recording by itself."""
    parser.add_argument(
        "--marker",
        nargs=4,
        type=float,
        action="append",
        metavar=("PX", "PY", "X", "Y"),
        help="pixel and place, m; four times or more",
    )
    parser.add_argument(
        "--fastest",
        type=float,
        metavar="SPEED",
        help="leave out jumps: what no motion of this speed passes, unit/s",
    )
    parser.add_argument(
        "--smooth",
        type=float,
        metavar="PERIOD",
        help="smooth: of what oscillates with this period half is left, s",
    )
    parser.add_argument(
        "--derive",
        nargs="+",
        default=[],
        type=pair,
        metavar="DQ=Q",
        help="velocities of smoothed positions, appended",
    )
    parser.add_argument(
        "--crop",
        action="store_true",
        help="keep only the part that moves of each, not the rest before and after it",
    )


def _add_timing(parser: argparse.ArgumentParser) -> None:
    """Add the options of the alignment."""
    parser.add_argument(
        "--reference",
        metavar="DEMONSTRATION",
        help="whose timing all take over, in place of the mean timing",
    )
    parser.add_argument(
        "--window",
        type=float,
        default=0.2,
        help="largest shift in time, as a fraction of the longest recording (0.2)",
    )


def _add_reading(parser: argparse.ArgumentParser) -> None:
    """Add the options that say how the recording is read."""
    parser.add_argument(
        "--keys",
        nargs="+",
        default=[],
        metavar="KEY",
        help="what to read of the recording: keys, columns or entries",
    )
    parser.add_argument(
        "--names",
        nargs="+",
        default=[],
        metavar="NAME",
        help="of the entries, in place of the recording's",
    )
    parser.add_argument(
        "--recorded-time-step",
        type=float,
        metavar="S",
        help="of the recording, in s, where it has no times",
    )


def main() -> None:
    """Read, align, write, say what came of it."""
    options = options_of_command_line()
    if options.out.suffix != ".npz":
        sys.exit(f"error: {options.out}: demonstrations are written to a .npz file")
    if options.derive and options.smooth is None:
        sys.exit(
            "error: --derive needs --smooth PERIOD: velocities are those of smoothed positions"
        )
    for path in filter(None, (options.out, options.draw)):
        if path.exists() and not options.overwrite:
            sys.exit(f"error: {path} is there already: --overwrite replaces it")
        if not path.parent.is_dir():
            sys.exit(f"error: {path}: there is no folder {path.parent}")
    try:
        recordings = load_recordings(
            options.recorded,
            keys=options.keys,
            names=options.names,
            time_step=options.recorded_time_step,
        )
        demonstrations = align_recordings(recordings, options)
        demonstrations.save(options.out)
        if options.draw:
            draw(recordings, demonstrations, options.draw)
    except (AlignmentError, DemonstrationError, ImportError, OSError) as error:
        sys.exit(f"error: {in_words(error)}")
    count, samples, _ = demonstrations.positions.shape
    print(
        f"wrote {options.out}: {count} demonstrations of {samples} samples, "
        f"{demonstrations.duration:g} s"
    )
