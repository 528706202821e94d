"""Make demonstrations of what people recorded: one time step, one length, the same moment at the same time.

Example:
    python scripts/align_demonstrations.py recorded.csv demonstrations.npz --time-step 0.1 --velocities dq1 dq2

The recording is of any format that docs/demonstrations.md lists; a CSV file has the columns demonstration,time,NAME,... and, if there are
several targets, "target NAME",... for what each demonstration was for. Its demonstrations may differ in length, and their samples may be
uneven. All are sampled at the median time step that was recorded, aligned by dynamic time warping, and then sampled at the time step of
the robot.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import torch

from torch_pmil.alignment import AlignmentError, align, crop, resample
from torch_pmil.demonstrations import DemonstrationError, Demonstrations, Recordings, load_recordings


def align_recordings(recordings: Recordings, time_step: float, velocities: list[str], moving: bool, window: float) -> Demonstrations:
    """The demonstrations of a file, aligned.

    Args:
        recordings: of the file.
        time_step: of the result, in s.
        velocities: names of the columns that are rates of change.
        moving: whether only the part that moves is kept of each.
        window: how far times may be shifted, as in ``align``.

    Raises:
        DemonstrationError, AlignmentError: the recordings or an argument are not as they must be.
    """
    unknown = sorted(set(velocities) - set(recordings.names))
    if unknown:
        raise AlignmentError(f"velocities must be columns of {', '.join(recordings.names)}, got {', '.join(unknown)}")
    recorded_step = torch.cat([times.diff() for times in recordings.times]).median().item()
    even = [resample(values, times, recorded_step) for values, times in zip(recordings.values, recordings.times, strict=True)]
    kept = [crop(values) for values in even] if moving else even
    aligned = align(kept, [recordings.names.index(name) for name in velocities], window)
    times = recorded_step * torch.arange(aligned.shape[1], dtype=torch.float64)
    positions = resample(aligned, times, time_step)
    return Demonstrations(positions, time_step, recordings.names, recordings.targets, recordings.target_names)


def main() -> None:
    """Read, align, write, say what came of it."""
    parser = argparse.ArgumentParser(
        description=__doc__.partition("\n")[0], epilog=__doc__.partition("\n\n")[2], formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("recorded", type=Path, metavar="RECORDED", help="file or folder")
    parser.add_argument("out", type=Path, metavar="OUT.npz")
    parser.add_argument("--time-step", type=float, default=0.1, help="of the demonstrations, the robot's control period, in s (0.1)")
    parser.add_argument("--velocities", nargs="+", default=[], metavar="NAME", help="columns that are velocities, not positions")
    parser.add_argument("--crop", action="store_true", help="keep only the part that moves of each, not the rest before and after it")
    parser.add_argument("--window", type=float, default=0.2, help="largest shift in time, as a fraction of the longest recording (0.2)")
    parser.add_argument("--keys", nargs="+", default=[], metavar="KEY", help="what to read of the recording: keys, columns or entries")
    parser.add_argument("--names", nargs="+", default=[], metavar="NAME", help="of the entries, in place of the recording's")
    parser.add_argument("--recorded-time-step", type=float, metavar="S", help="of the recording, in s, where it has no times")
    arguments = parser.parse_args()
    if arguments.out.suffix != ".npz":
        sys.exit(f"error: {arguments.out}: demonstrations are written to a .npz file")
    try:
        given = {"keys": arguments.keys, "names": arguments.names, "time_step": arguments.recorded_time_step}
        recordings = load_recordings(arguments.recorded, **given)
        demonstrations = align_recordings(recordings, arguments.time_step, arguments.velocities, arguments.crop, arguments.window)
        demonstrations.save(arguments.out)
    except (AlignmentError, DemonstrationError, ImportError, OSError) as error:
        sys.exit(f"error: {error}")
    count, samples, _ = demonstrations.positions.shape
    print(f"wrote {arguments.out}: {count} demonstrations of {samples} samples, {demonstrations.duration:g} s")


if __name__ == "__main__":
    main()
