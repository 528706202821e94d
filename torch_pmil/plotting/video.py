"""Videos: pictures of a rollout, an H.264 file made of them, and a GIF made of the file."""

from __future__ import annotations

import itertools
import subprocess
from collections.abc import Iterable, Iterator
from contextlib import closing
from pathlib import Path

import imageio_ffmpeg
import numpy as np
import torch
from torch import Tensor

from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace
from torch_pmil.envs import AdaptedEnv, MujocoRobotEnv
from torch_pmil.files import replacing

# an MP4, whatever the file is called, with its index first, so that a browser plays at once
MP4 = ["-f", "mp4", "-movflags", "+faststart"]
# a GIF counts in hundredths of a second; the last picture stays; colours are those of this video,
# not mixed from dots, which flicker
GIF = (
    "fps=25,tpad=stop_mode=clone:stop_duration=1,split[a][b];"
    "[a]palettegen[p];[b][p]paletteuse=dither=none"
)


def render_rollout(
    env: MujocoRobotEnv, start: Tensor, actions: Tensor, frames_per_step: int = 5
) -> Iterator[np.ndarray]:
    """Pictures of a rollout, ``frames_per_step`` in each control period, from its start on.

    The control period of 0.1 s is too coarse for the eye; five pictures in it make 50 Hz. The
    motion is simulated anew from the start, and the environment itself stays where it is.

    Args:
        env: the robot; its ``pixel_size`` is the size of the pictures.
        start: state vector (D,).
        actions: torques (T, F) in N·m, each held for a control period.
        frames_per_step: a divisor of ``env.substeps``.

    Returns:
        T · frames_per_step + 1 pictures (height, width, 3), uint8.

    Raises:
        ValueError: the period does not split into that many steps.
        RuntimeError: OpenGL is not available, or the simulation diverged.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> env = DoublePendulumEnv()
        >>> actions = torch.zeros(25, 2, dtype=torch.float64)
        >>> pictures = render_rollout(env, env.initial_mean, actions)
        >>> write_video("hanging.mp4", pictures, fps=50)  # doctest: +SKIP
    """
    return map(env.draw, env.replay(start, actions, frames_per_step))


def dense_states(
    env: MujocoRobotEnv, start: Tensor, actions: Tensor, states_per_step: int = 5
) -> Tensor:
    """States of a rollout within its control periods too, (T · states_per_step + 1, D).

    The first one is the start.

    Args:
        env: the robot; it stays where it is.
        start: state vector (D,).
        actions: torques (T, F) in N·m, each held for a control period.
        states_per_step: a divisor of ``env.substeps``.

    Raises:
        ValueError: the period does not split into that many steps.
        RuntimeError: the simulation diverged.

    Example:
        >>> from torch_pmil.envs import DoublePendulumEnv
        >>> env = DoublePendulumEnv()
        >>> dense_states(env, env.initial_mean, torch.zeros(25, 2, dtype=torch.float64)).shape
        torch.Size([126, 4])
    """
    return env.state_of(env.replay(start, actions, states_per_step))


@torch.no_grad()
def film_rollout(
    env: AdaptedEnv, policy: RBFPolicy, space: StateSpace, steps: int
) -> Iterator[np.ndarray]:
    """Pictures of a policy's rollout from a fresh start, one a step, as the environment shows them.

    Args:
        env: one robot, made with ``from_pixels=True``.
        policy: a policy that sees the features of the state.
        space: the robot's state space, which gives the features.
        steps: control steps of the rollout.

    Returns:
        ``steps`` + 1 pictures (height, width, 3), uint8, the first one of the start.
    """
    actor = StatePolicy(policy, space, env.control_period).as_tensordict_module()
    rollout = env.rollout(steps, actor)
    pictures = itertools.chain(rollout["pixels"][:1], rollout["next", "pixels"])
    return (picture.numpy() for picture in pictures)


def write_video(path: Path | str, frames: Iterable[np.ndarray], fps: float) -> None:
    """Write pictures as an H.264 video that every player shows, wholly or not at all.

    The format is MP4 with yuv420p.

    Args:
        path: the file to write; an existing file is replaced.
        frames: pictures (height, width, 3), uint8, all of one size. An odd height or width, which
            the format cannot hold, grows by repeating the last row or column.
        fps: pictures per second.

    Raises:
        ValueError: there are no frames, or one has another shape or type.
        OSError: the folder is missing or not writable, or ffmpeg did not write every frame.

    Example:
        >>> import tempfile
        >>> black = np.zeros((16, 16, 3), dtype=np.uint8)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_video(f"{folder}/black.mp4", [black] * 3, fps=50)
        ...     imageio_ffmpeg.count_frames_and_secs(f"{folder}/black.mp4")[0]
        3
    """
    frames = iter(frames)
    first = next(frames, None)
    if first is None:
        raise ValueError("a video needs at least one frame, got none")
    with replacing(path) as temporary:
        temporary.touch()  # raises where ffmpeg would only print
        _encode(temporary, itertools.chain([first], frames), first.shape, fps)


def write_gif(path: Path | str, video: Path | str) -> None:
    """Write a video as a GIF that repeats for ever, wholly or not at all.

    It is for pages that show no videos. It is as large and as fast as the video, at 25 pictures per
    second, and rests on the last one for a second.

    Args:
        path: the file to write; an existing file is replaced.
        video: a file that :func:`write_video` wrote.

    Raises:
        OSError: the video is missing or is none, or the folder is missing or not writable.

    Example:
        >>> import tempfile
        >>> black = np.zeros((16, 16, 3), dtype=np.uint8)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     write_video(f"{folder}/black.mp4", [black] * 25, fps=50)
        ...     write_gif(f"{folder}/black.gif", f"{folder}/black.mp4")
        ...     Path(f"{folder}/black.gif").read_bytes()[:6]
        b'GIF89a'
    """
    with replacing(path) as temporary:
        temporary.touch()  # raises where ffmpeg would only print
        ffmpeg = [imageio_ffmpeg.get_ffmpeg_exe(), "-y", "-loglevel", "error"]
        command = [*ffmpeg, "-i", str(video), "-filter_complex", GIF, "-f", "gif", str(temporary)]
        encoded = subprocess.run(command, capture_output=True, text=True, check=False)
        if encoded.returncode:
            raise OSError(
                f"ffmpeg made no GIF of {video}: {encoded.stderr.strip().splitlines()[-1]}"
            )


def _encode(path: Path, frames: Iterable[np.ndarray], shape: tuple[int, ...], fps: float) -> None:
    if len(shape) != 3 or shape[2] != 3:
        raise ValueError(f"frames must have shape (height, width, 3), got {shape}")
    margin = [(0, shape[0] % 2), (0, shape[1] % 2), (0, 0)]
    size = shape[1] + shape[1] % 2, shape[0] + shape[0] % 2
    count = 0
    encoder = imageio_ffmpeg.write_frames(
        path,
        size,
        fps=fps,
        codec="libx264",
        quality=8,
        macro_block_size=2,
        ffmpeg_log_level="error",
        output_params=MP4,
    )
    with closing(encoder):
        encoder.send(None)
        for frame in frames:
            if frame.shape != shape or frame.dtype != np.uint8:
                raise ValueError(
                    f"frame {count} must be uint8 of shape {shape}, got {frame.dtype} of shape "
                    f"{frame.shape}"
                )
            encoder.send(np.pad(frame, margin, mode="edge"))
            count += 1
    # ffmpeg's exit status cannot be seen from here
    written, _ = imageio_ffmpeg.count_frames_and_secs(path)
    if written != count:
        raise OSError(f"ffmpeg wrote {written} of {count} frames to {path}")
