"""Environments driven by given actions from given starts."""

from __future__ import annotations

import io
import os
import subprocess
import sys

import mujoco
import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.envs import EnvBase

FULL_PHYSICS = mujoco.mjtState.mjSTATE_FULLPHYSICS


def start_at(env: EnvBase, state: object) -> TensorDictBase:
    state = torch.as_tensor(state, dtype=torch.float64)
    return env.reset(TensorDict({"observation": state}, env.batch_size))


def step(env: EnvBase, action: Tensor) -> TensorDictBase:
    return env.step(TensorDict({"action": action}, env.batch_size))["next"]


def run(env: EnvBase, start: object, actions: Tensor) -> TensorDictBase:
    """What is measured (T+1, *batch) under actions (T, *batch, F)."""
    measured = [start_at(env, start), *(step(env, action) for action in actions)]
    return torch.stack([each.exclude("reward", "done", "terminated") for each in measured])


def resumed(env: EnvBase, other: EnvBase) -> EnvBase:
    """The other environment, with the state of this one as a checkpoint holds it."""
    file = io.BytesIO()
    torch.save(env.state_dict(), file)
    file.seek(0)
    other.load_state_dict(torch.load(file, weights_only=True))
    return other


def physics(model: mujoco.MjModel, state: Tensor) -> mujoco.MjData:
    """MuJoCo's data in a full state."""
    data = mujoco.MjData(model)
    mujoco.mj_setState(model, data, state.numpy(), FULL_PHYSICS)
    mujoco.mj_forward(model, data)
    return data


def drawn(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A script that draws without a screen, in a process of its own."""
    screens = ("DISPLAY", "WAYLAND_DISPLAY")
    kept = {name: value for name, value in os.environ.items() if name not in screens}
    command = [sys.executable, "-W", "ignore", "-c", script]
    return subprocess.run(
        command, env=kept | environment, capture_output=True, text=True, check=False
    )
