"""Make demonstrations from recordings: one time step, one length, one timing.

Example:
    pmil align recorded.csv demonstrations.npz --time-step 0.1 --velocities dq1 dq2
    pmil align tracked.csv demonstrations.npz --fastest 5 --smooth 0.2 --draw steps.png

The recording is a file or folder of NPZ, CSV, LASA, Minari, robomimic or LeRobot data. A CSV file
has the columns demonstration,time,NAME,... If there are several targets, "target NAME",... follow:
the target of each demonstration. Demonstrations may differ in length, and samples may be uneven.

If their options are given, these steps run in this order: angles are unwrapped (rad, or degrees if
they exceed 4 pi), pixels become metres, jumps are removed, all entries are smoothed, velocities are
derived, and rests at both ends are cut off. Then all are sampled as often as they were recorded,
aligned by dynamic time warping, and sampled at the robot's time step. Recordings of one duration
whose stamps jitter or are at the robot's time step are not aligned, unless --window or
--reference is given.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch
from torch import Tensor

from torch_pmil import plotting
from torch_pmil.cli import (
    add_reading,
    check_out,
    check_picture,
    errors_in_one_line,
    parser_of,
    print_written,
)
from torch_pmil.demonstrations import (
    DemonstrationError,
    Demonstrations,
    Recordings,
    load_recordings,
)
from torch_pmil.demonstrations.clock import clock
from torch_pmil.demonstrations.preparation.alignment import AlignmentError, crop, resample
from torch_pmil.demonstrations.preparation.camera import plane_coordinates
from torch_pmil.demonstrations.preparation.jumps import without_jumps
from torch_pmil.demonstrations.preparation.smoothing import smooth, velocities
from torch_pmil.demonstrations.preparation.synchronisation import synchronise
from torch_pmil.demonstrations.time_unit import check_times
from torch_pmil.demonstrations.turns import jumps_by_turns, turns_of, unwrapped
from torch_pmil.files import replacing
from torch_pmil.runs.printing import warnings_in_one_line

Timed = tuple[Tensor, Tensor]  # times (T_n,) in s and values (T_n, M)


def align_recordings(recordings: Recordings, options: argparse.Namespace) -> Demonstrations:
    """Demonstrations from recordings, prepared, aligned and resampled as the options say.

    Raises:
        DemonstrationError, AlignmentError: the recordings or an option are not as they must be.
    """
    known = recordings.names
    names = [*known, *(velocity for velocity, _ in options.derive)]
    rates = [*options.velocities, *names[len(known) :]]
    check_columns("velocities", options.velocities, known)
    check_columns("positions of --derive", [position for _, position in options.derive], known)
    check_columns("angles", options.angles, known)
    if not recordings.in_seconds:
        check_times(recordings.times, options.time_step, recordings.labels)
    recordings = unwrapped(recordings, turns_of(recordings, options.angles), {})
    preprocessed = [
        preprocessed_one(*one, known, options)
        for one in zip(recordings.times, recordings.values, strict=True)
    ]
    times, values = zip(*preprocessed, strict=True)
    prepared = replace(recordings, times=times, values=values, names=tuple(names), places=())
    for doubt in [*prepared.holes(), *jumps_by_turns(recordings, options.angles)]:
        print(f"warning: {doubt}", file=sys.stderr)
    if options.crop:
        columns = [names.index(rate) for rate in rates]
        preprocessed = [cropped(*one, columns) for one in preprocessed]
        times, values = zip(*preprocessed, strict=True)
        prepared = replace(prepared, times=times, values=values)
    reference, labels = options.reference, recordings.labels
    if reference is not None and reference not in labels:
        raise AlignmentError(
            f"reference must be one of the demonstrations {', '.join(labels)}, got {reference}"
        )
    number = None if reference is None else labels.index(reference)
    return synchronise(prepared, options.time_step, rates, options.window, number)


def check_columns(what: str, names: Sequence[str], known: tuple[str, ...]) -> None:
    """Raise AlignmentError if a name is not that of a column."""
    if unknown := sorted(set(names) - set(known)):
        raise AlignmentError(
            f"{what} must be columns of {', '.join(known)}, got {', '.join(unknown)}"
        )


def cropped(times: Tensor, values: Tensor, velocities: Sequence[int]) -> Timed:
    """The part of a recording that moves, at its median time step."""
    step = clock(times).step
    kept = crop(resample(values, times, step), velocities=velocities)
    return step * torch.arange(len(kept), dtype=torch.float64), kept


def preprocessed_one(
    times: Tensor, values: Tensor, names: tuple[str, ...], options: argparse.Namespace
) -> Timed:
    """One recording after those steps whose options are given, up to the derived velocities."""
    positions = torch.tensor([name not in options.velocities for name in names])
    if options.marker:
        values = values.clone()
        values[:, positions] = in_metres(values[:, positions], options.marker)
    if options.fastest is not None:
        limits = torch.where(positions, options.fastest, torch.inf).double()
        values, times = without_jumps(values, times, limits)
    if options.smooth is None:
        return times, values
    columns = [names.index(position) for _, position in options.derive]
    derived = velocities(values[:, columns], times, options.smooth)
    return times, torch.cat([smooth(values, times, options.smooth), derived], -1)


def in_metres(values: Tensor, markers: Sequence[Sequence[float]]) -> Tensor:
    """Points (T, 2 P), x and y of each in turn, from pixels to m, by [pixel x, pixel y, x, y]."""
    if values.shape[1] % 2:
        raise AlignmentError(
            "with markers the columns must be x and y of each point in turn, got "
            f"{values.shape[1]} columns"
        )
    pixels, places = torch.tensor(markers, dtype=torch.float64).split(2, dim=1)
    return plane_coordinates(values.unflatten(-1, (-1, 2)), pixels, places).flatten(-2)


def draw(recordings: Recordings, demonstrations: Demonstrations, path: Path) -> None:
    """Draw recordings beside the demonstrations made from them."""
    recorded = zip(recordings.times, recordings.values, strict=True)
    before = [(times - times[0], values) for times, values in recorded]
    samples = torch.arange(demonstrations.positions.shape[1], dtype=torch.float64)
    after = [(demonstrations.time_step * samples, values) for values in demonstrations.positions]
    names, title = demonstrations.names, f"every {demonstrations.time_step:g} s"
    figure = plotting.plot_before_after(names, [""] * len(names), before, after, title)
    plotting.save_figure(figure, path)


def pair(text: str) -> tuple[str, str]:
    """The two names of VELOCITY=POSITION."""
    velocity, equals, position = text.partition("=")
    if not (velocity and equals and position):
        raise argparse.ArgumentTypeError(f"must be VELOCITY=POSITION, as dq=q, got {text}")
    return velocity, position


def options_of_command_line() -> argparse.Namespace:
    """Read the command line."""
    parser = parser_of(__doc__)
    option = parser.add_argument
    number = partial(option, type=float)
    words = partial(option, nargs="+", default=[])
    option("recorded", type=Path, metavar="RECORDED", help="file or folder")
    option("out", type=Path, metavar="OUT.npz")
    number("--time-step", default=0.1, metavar="S", help="the robot's control period (default 0.1)")
    words("--velocities", metavar="NAME", help="columns that are velocities, not positions")
    words("--angles", metavar="NAME", help="columns that are angles: jumps by a turn are removed")
    corners = ("PX", "PY", "X", "Y")
    places = "pixel and place (m) of a marker; four times or more"
    number("--marker", nargs=4, action="append", metavar=corners, help=places)
    number("--fastest", metavar="SPEED", help="remove jumps, which are faster than this, unit/s")
    number("--smooth", metavar="PERIOD", help="filter: half is left of what has this period, s")
    words("--derive", type=pair, metavar="DQ=Q", help="append velocities of smoothed positions")
    option("--crop", action="store_true", help="cut off the rests before and after the motion")
    option("--reference", metavar="DEMONSTRATION", help="use its timing, not the mean timing")
    shift = "largest shift in time, as a fraction of the longest recording; 0: sampled alone"
    number(
        "--window",
        help=f"{shift} (default 0.2, or see above)",
        metavar="FRACTION",
    )
    add_reading(parser, "--recorded-time-step")
    option("--draw", type=Path, metavar="PICTURE.png", help="draw recordings beside the result")
    option("--overwrite", action="store_true", help="replace OUT.npz and PICTURE.png if they exist")
    return parser.parse_args()


def main() -> None:
    """Read, align, write, print what was written."""
    options = options_of_command_line()
    out, picture = options.out, options.draw
    check_out(out)
    if options.derive and options.smooth is None:
        sys.exit("error: --derive needs --smooth PERIOD")
    for path in filter(None, (out, picture)):
        if path.exists() and options.recorded.exists() and path.samefile(options.recorded):
            sys.exit(f"error: {path} is the recording itself: choose another name")
        if os.path.lexists(path) and not options.overwrite:
            sys.exit(f"error: {path} is there already: --overwrite replaces it")
        if not path.parent.is_dir():
            sys.exit(f"error: {path}: there is no folder {path.parent}")
    if picture:
        check_picture(picture)
    with errors_in_one_line(AlignmentError, DemonstrationError, ImportError, OSError):
        reading = {"keys": options.keys, "names": options.names}
        step = options.recorded_time_step
        recordings = load_recordings(options.recorded, time_step=step, **reading)
        with warnings_in_one_line(""):
            demonstrations = align_recordings(recordings, options)
        with replacing(picture) if picture else nullcontext() as drawn:  # both files or neither
            if drawn:
                draw(recordings, demonstrations, drawn)
            demonstrations.save(out)
    print_written(out, demonstrations)
