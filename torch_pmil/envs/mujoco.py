"""Any MuJoCo robot as a TorchRL environment: float64, zero-order hold, seeded starts."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypedDict

import mujoco
import numpy as np
import torch
from mujoco import rollout
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.data import Bounded, TensorSpec, Unbounded

from torch_pmil.checks import check_tensor
from torch_pmil.envs.actuators import actuator_names
from torch_pmil.envs.joint_torques import ModelledRobot
from torch_pmil.envs.mujoco_model import (
    FULL_PHYSICS,
    at_rest,
    limited_models,
    open_renderer,
    state_columns,
    whole_substeps,
)
from torch_pmil.envs.robot import Array, check_num_envs


class RobotSettings(TypedDict, total=False):
    """Settings of a :class:`MujocoRobotEnv` that each of its subclasses takes."""

    initial_mean: Sequence[float] | Tensor
    initial_std: Sequence[float] | Tensor
    observation_std: Sequence[float] | Tensor | None
    control_period: float
    targets: Tensor | None
    num_envs: int | None
    from_pixels: bool
    pixel_size: tuple[int, int]
    seed: int | None


class MujocoRobotEnv(ModelledRobot):
    """A MuJoCo robot, simulated in float64 by ``mujoco.rollout``.

    Actions are what the model's actuators take, within their ctrlrange: torques of motors (N·m),
    targets of position servos (rad) or velocity servos (rad/s); for linear joints N, m and m/s. A
    step holds the action for ``control_period`` seconds; the physics clips what is out of range.
    The state vector is ``[q1, dq1, q2, dq2, ...]`` of the observed joints, or ``[q1, q2, ..., dq1,
    dq2, ...]`` (rad, rad/s). The reward is zero and an episode never ends by itself.

    The rest of the simulation is hidden: a reset derives it from the state
    (``_physics_from_state``), then it follows from the motion. Subclasses add further measurements
    in ``_measure``.

    Keys: ``"observation"`` (*batch, D), ``"action"`` (*batch, F), ``"reward"`` (*batch, 1), all
    float64, and with ``from_pixels`` also ``"pixels"`` (*batch, height, width, 3), uint8. ``reset``
    draws x_0 ~ N(initial_mean, diag(initial_std²)) from the generator of this environment, no joint
    beyond its stops, or starts at the ``"observation"`` it is given. With ``targets`` each
    observation also holds ``"target"`` (*batch, K), float64. With ``observation_std`` each
    ``"observation"`` is the true state plus noise from the same generator, and ``"state"``
    (*batch, D) is the true one.
    ``state_dict`` holds the physics and the generator, so a checkpoint resumes bit for bit.

    Args:
        model: the robot, with one actuator per action; or one model for each robot, all of one
            structure. Models are copied. Pictures are taken by the camera ``"front"``.
        joints: names of the D/2 observed hinge or slide joints, in the order of the state vector.
        initial_mean, initial_std: mean and standard deviations of the start state, length D.
        positions_first: whether the state vector has all positions before all velocities.
        observation_std: standard deviations of the sensors' noise, length D; None for exact
            sensors.
        torque_limit: largest absolute torque (N·m) or force (N) of the motors, one for all or one
            each; None for the ctrlrange of the model.
        control_period: seconds between two actions; a whole number of simulation time steps.
        actuators: numbers of the actuators that are actions, by the actions' names; None for all.
        whole_start: maps state vectors to full simulation states at a reset. If None, whatever they
            do not hold starts in the default pose.
        targets: what each robot is to do, such as the place of its ball, (num_envs, K) or (K,) for
            one robot.
        num_envs: None for one robot with batch size (), N for N robots with batch size (N,).
        from_pixels: whether to draw a picture at each step; needs OpenGL (headless:
            ``MUJOCO_GL=egl``).
        pixel_size: height and width of a picture.
        seed: of the generator of starts and noise; None takes entropy from the system.

    Raises:
        ValueError: a setting has the wrong shape or range.
        RuntimeError: pictures were asked for and OpenGL is not available.
    """

    camera = "front"
    _physics: Tensor

    def __init__(
        self,
        model: mujoco.MjModel | Sequence[mujoco.MjModel],
        joints: Sequence[str],
        *,
        initial_mean: Sequence[float] | Tensor,
        initial_std: Sequence[float] | Tensor,
        positions_first: bool = False,
        observation_std: Sequence[float] | Tensor | None = None,
        torque_limit: float | Sequence[float] | None = None,
        control_period: float = 0.1,
        actuators: Mapping[str, int] | None = None,
        whole_start: Callable[[Tensor], Tensor] | None = None,
        targets: Tensor | None = None,
        num_envs: int | None = None,
        from_pixels: bool = False,
        pixel_size: tuple[int, int] = (240, 240),
        seed: int | None = None,
    ) -> None:
        check_num_envs(num_envs)
        super().__init__(() if num_envs is None else (num_envs,), control_period, from_pixels, seed)
        self._models = limited_models(model, torque_limit, num_envs or 1)
        self.model = self._models[0]
        self.substeps = whole_substeps(control_period, self.model.opt.timestep)
        self.pixel_size, self._whole_start = pixel_size, whole_start
        own = actuator_names(self.model)
        self._actuators = dict(actuators or zip(own, range(len(own)), strict=True))
        self._data = mujoco.MjData(self.model)
        self._renderer: mujoco.Renderer | None = None
        self._joints = tuple(joints)
        self._state_columns = state_columns(self.model, joints, positions_first)
        dim = 2 * len(joints)
        self.initial_mean = _state_vector("initial_mean", initial_mean, dim)
        self.initial_std = _deviations("initial_std", initial_std, dim)
        self.observation_std = None
        if observation_std is not None:
            self.observation_std = _deviations("observation_std", observation_std, dim)
        self.targets = None
        if targets is not None:
            self.targets = torch.as_tensor(targets, dtype=torch.float64).clone()
            check_tensor("targets", self.targets, (*self.batch_size, "entries"))
        starts = self.initial_mean.expand(num_envs or 1, -1)
        self.register_buffer("_physics", self._physics_from_state(starts, self._models))
        self._make_specs()
        if from_pixels:
            self._open_renderer()

    def simulate(self, state: Tensor, action: Tensor, robot: int = 0) -> Tensor:
        """State vectors (N, D), float64, one control period later.

        The environment's own state does not change.

        Args:
            state: state vectors (N, D); hidden physics is as after a reset.
            action: actions (N, F), held for the period and clipped to their range.
            robot: number of the robot whose model is simulated.

        Raises:
            ValueError: a shape is wrong.
            RuntimeError: a simulation diverged.
        """
        models = self._models[robot : robot + 1]
        check_tensor("state", state, (len(state), self._state_columns.numel()), finite=False)
        check_tensor("action", action, (len(state), len(self._actuators)), finite=False)
        physics, _ = self._integrate(self._physics_from_state(state, models), action, models)
        return self.state_of(physics[:, -1])

    def substates(self, state: Tensor, action: Tensor, count: int, robot: int = 0) -> Tensor:
        """State vectors (count, D), float64, at equal steps inside one control period.

        The last one is that of :meth:`simulate`. Arguments and errors are those of :meth:`replay`,
        with one action (F,).
        """
        return self.state_of(self.replay(state, action[None], count, robot)[1:])

    def replay(self, start: Tensor, actions: Tensor, count: int, robot: int = 0) -> Tensor:
        """Full simulation states (T · count + 1, P) along a rollout from a reset, float64.

        The environment's own state does not change. The first state is that of the reset;
        :meth:`state_of` and :meth:`draw` take such states.

        Args:
            start: state vector (D,) of the reset.
            actions: actions (T, F), each held for a control period and clipped to their range.
            count: states in each control period; a divisor of ``substeps``, the number of time
                steps in a period.
            robot: number of the robot whose model is simulated.

        Raises:
            ValueError: the period does not split into ``count`` steps.
            RuntimeError: the simulation diverged.
        """
        if count < 1 or self.substeps % count:
            raise ValueError(
                f"count must divide the {self.substeps} time steps of a control period, got {count}"
            )
        stride, models = self.substeps // count, self._models[robot : robot + 1]
        physics = [self._physics_from_state(start[None], models)]
        for action in actions:
            after, _ = self._integrate(physics[-1][-1:], action[None], models)
            physics.append(after[0, stride - 1 :: stride])
        return torch.cat(physics)

    def state_of(self, physics: Tensor) -> Tensor:
        """State vectors (*batch, D) of full simulation states (*batch, P)."""
        return physics[..., self._state_columns]

    def render(self, state: Tensor, robot: int = 0) -> Array:
        """Picture (height, width, 3), uint8, of a robot in a state (D,), without shadows.

        Raises:
            ValueError: the state has another shape or is not finite.
            RuntimeError: OpenGL is not available.
        """
        state = _state_vector("state", state, self._state_columns.numel())
        physics = self._physics_from_state(state[None], self._models[robot : robot + 1])
        return self.draw(physics[0], robot)

    def draw(self, physics: Tensor, robot: int = 0) -> Array:
        """A picture (height, width, 3), uint8, of a robot in a full simulation state (P,).

        Raises RuntimeError without OpenGL.
        """
        renderer = self._open_renderer()
        mujoco.mj_setState(self._models[robot], self._data, physics.numpy(), FULL_PHYSICS)
        mujoco.mj_forward(self._models[robot], self._data)
        renderer.update_scene(self._data, camera=self.camera)
        return renderer.render()

    def close(self, **kwargs: Any) -> None:
        """Release the OpenGL context, if pictures were drawn."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        super().close(**kwargs)

    def _physics_from_state(self, state: Tensor, models: Sequence[mujoco.MjModel]) -> Tensor:
        """Full simulation states (N, P) at time 0 of robots in states (N, D), others at rest.

        There are N models, or one for all.
        """
        if self._whole_start is not None:
            return self._whole_start(state)
        rest = {model: at_rest(model) for model in set(models)}
        physics = torch.stack([rest[model] for model in models])
        physics = physics.expand(state.shape[0], -1).clone()
        physics[:, self._state_columns] = state.to(torch.float64)
        return physics

    def _make_specs(self) -> None:
        batch = self.batch_size
        ranges = torch.from_numpy(self.model.actuator_ctrlrange[list(self._actuators.values())])
        low, high = ranges.expand(*batch, -1, -1).unbind(-1)
        dim, more = self._state_columns.numel(), dict[str, TensorSpec]()
        if self.observation_std is not None:
            more["state"] = Unbounded((*batch, dim), dtype=torch.float64)
        if self.targets is not None:
            more["target"] = Unbounded(self.targets.shape, dtype=torch.float64)
        if self.from_pixels:
            more["pixels"] = Bounded(0, 255, (*batch, *self.pixel_size, 3), dtype=torch.uint8)
        self._set_specs(dim, low, high, more)

    def _reset(self, tensordict: TensorDictBase | None, **kwargs: Any) -> TensorDictBase:
        given = None if tensordict is None else tensordict.get("observation", None)
        mask = None if tensordict is None else tensordict.get("_reset", None)
        self.cut_short = ""
        start = self._draw_starts() if given is None else self._rows("start observation", given)
        physics = self._physics_from_state(start, self._models)
        if mask is not None:
            physics = torch.where(mask.reshape(-1, 1), physics, self._physics)
        self._physics = physics
        _, sensors = self._simulate(physics, torch.zeros(1, len(self._actuators)), 1, self._models)
        return self._measure(sensors)

    def _step(self, tensordict: TensorDictBase) -> TensorDictBase:
        action = self._rows("action", tensordict["action"])
        physics, sensors = self._integrate(self._physics, action, self._models)
        self._physics = physics[:, -1].clone()
        return self._without_reward(self._measure(sensors))

    def _measure(self, sensors: Tensor) -> TensorDictBase:
        """The observation now, given all sensor values (N, K, S) since the last measurement."""
        state = self.state_of(self._physics).reshape(*self.batch_size, -1)
        measured = {"observation": state}
        if self.observation_std is not None:
            noise = torch.randn(state.shape, generator=self._generator, dtype=torch.float64)
            measured = {"observation": state + self.observation_std * noise, "state": state}
        if self.targets is not None:
            measured["target"] = self.targets.clone()
        if self.from_pixels:
            pictures = [self.draw(physics, robot) for robot, physics in enumerate(self._physics)]
            pixels = torch.from_numpy(np.stack(pictures))
            measured["pixels"] = pixels.reshape(*self.batch_size, *self.pixel_size, 3)
        return TensorDict(measured, batch_size=self.batch_size)

    def _draw_starts(self) -> Tensor:
        shape = (self._physics.shape[0], self.initial_mean.numel())
        noise = torch.randn(shape, generator=self._generator, dtype=torch.float64)
        starts, places = self.initial_mean + self.initial_std * noise, self._position_entries
        starts[:, places] = starts[:, places].clamp(*self._stops)
        return starts

    def _rows(self, name: str, values: Tensor) -> Tensor:
        """Actions or starts (*batch, n) as (N, n), float64. Raises ValueError if they misfit."""
        length = len(self._actuators) if name == "action" else self._state_columns.numel()
        check_tensor(name, values, (*self.batch_size, length))
        return values.detach().to(torch.float64).reshape(self._physics.shape[0], -1)

    def _integrate(
        self, physics: Tensor, action: Tensor, models: Sequence[mujoco.MjModel]
    ) -> tuple[Tensor, Tensor]:
        """Simulate a control period under actions (N, F), with N models or one.

        Returns states (N, substeps, P) after each time step, and sensor values (N, substeps + 1, S)
        at both ends of each.
        """
        # MuJoCo senses before a step: one more step senses at the end
        after, sensors = self._simulate(physics, action, self.substeps + 1, models)
        self._check_physics(physics, after[:, -2])
        return after[:, :-1], sensors

    def _simulate(
        self, physics: Tensor, action: Tensor, steps: int, models: Sequence[mujoco.MjModel]
    ) -> tuple[Tensor, Tensor]:
        """States (N, steps, P) after each time step, and sensor values (N, steps, S) before it."""
        control = np.zeros((len(action), 1, self.model.nu))
        control[:, 0, list(self._actuators.values())] = action.numpy()
        states, sensors = rollout.rollout(models, self._data, physics.numpy(), control, nstep=steps)
        return torch.from_numpy(states), torch.from_numpy(sensors)

    def _check_physics(self, before: Tensor, after: Tensor) -> None:
        # mujoco.rollout stops early, with its clock behind, where the numbers grow out of range.
        late = after[:, 0] - before[:, 0] < self.control_period - self.model.opt.timestep / 2
        failed = (late | ~after.isfinite().all(-1)).nonzero().flatten()
        if len(failed):
            step = round(before[failed[0], 0].item() / self.control_period) + 1
            raise RuntimeError(
                f"simulation diverged in env {failed[0]} at step {step}: its state is not finite"
            )

    def _open_renderer(self) -> mujoco.Renderer:
        if self._renderer is None:
            self._renderer = open_renderer(self.model, self.pixel_size)
        return self._renderer


def _state_vector(name: str, values: Sequence[float] | Tensor, dim: int) -> Tensor:
    vector = torch.as_tensor(values, dtype=torch.float64)
    if vector.shape != (dim,) or not vector.isfinite().all():
        raise ValueError(f"{name} must be {dim} finite numbers, got {vector.tolist()}")
    return vector


def _deviations(name: str, values: Sequence[float] | Tensor, dim: int) -> Tensor:
    deviations = _state_vector(name, values, dim)
    if (deviations < 0).any():
        raise ValueError(f"{name} must not be negative, got {deviations.tolist()}")
    return deviations
