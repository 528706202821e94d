"""A learned policy as the robot needs it: from the measured state to the action."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from torch_pmil.checks import check_positive
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.exported_policy import write_program
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.state_space import StateSpace, with_unit

State = TypeVar("State", np.ndarray, Tensor)


class StatePolicy(nn.Module):
    """Policy that maps states (*batch, D) to actions (*batch, F), in the units of the robot.

    It returns float64 tensors for tensors, and NumPy arrays for arrays and lists, of integers or
    floats. A tensor must be on the device of the policy; its gradient passes. A policy of targets
    (*batch, K) is called as ``policy(state, target)``.

    Args:
        policy: a policy that sees the features of the state, then the target if there is one.
        space: names, units and angles of the state.
        control_period: time for which the robot holds an action, s.
        target_names: names of the K entries of a target.
        actions: names, units and range of the actions; numbers without units if None.

    Raises:
        ValueError: the policy sees another number of inputs, has other actions, or the control
            period is not positive. When called: the state or the target has another shape or
            device, or is not finite.
        TypeError: when called: the state or the target does not hold real numbers, or a target is
            missing or too much.

    Example:
        >>> from torch_pmil import RBFPolicy, joint_match
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> network = RBFPolicy(torch.zeros(5, 3), torch.ones(1), torch.ones(3))
        >>> policy = StatePolicy(network, space, control_period=0.1)
        >>> policy([3.14, 0])
        array([0.])
    """

    def __init__(
        self,
        policy: AnyPolicy,
        space: StateSpace,
        control_period: float,
        target_names: Sequence[str] = (),
        actions: ActionSpace | None = None,
    ) -> None:
        super().__init__()
        inputs = (*space.feature_names, *target_names)
        if policy.num_inputs != len(inputs):
            raise ValueError(
                f"policy must see the features {', '.join(inputs)}, got one of {policy.num_inputs} "
                "features"
            )
        control_period = check_positive("control_period (s)", control_period)
        own = ActionSpace.around(policy.u_middle, policy.u_max, (), ())
        if actions is not None and not _same_range(actions, own):
            raise ValueError(f"actions must be those of the policy, {own}, got {actions}")
        self.policy, self.space = policy, space
        self.actions = own if actions is None else actions
        self.control_period, self.target_names = control_period, tuple(target_names)

    def extra_repr(self) -> str:
        """State, actions and control period, in their units."""
        state = ", ".join(map(with_unit, self.space.names, self.space.units))
        target = f"; target {', '.join(self.target_names)}" if self.target_names else ""
        return f"state {state}{target}; actions {self.actions}; every {self.control_period:g} s"

    def forward(self, state: State, target: State | None = None) -> State:
        """Actions (*batch, F) at states (*batch, D) and, if any, for targets (*batch, K)."""
        state, target = _as_array("state", state), _as_array("target", target)
        if self.target_names and target is None:
            raise TypeError("policy must be called with a state and a target, got a state alone")
        if target is not None and not self.target_names:
            raise TypeError("policy must be called with a state alone, got a target too")
        inputs = self.space.features(self._checked("state", state, self.space.names))
        if target is not None:
            known = self._checked("target", target, self.target_names)
            inputs = torch.cat([inputs, known.expand(*inputs.shape[:-1], -1)], -1)
        action = self.policy(inputs)
        return action.detach().cpu().numpy() if isinstance(state, np.ndarray) else action

    def as_tensordict_module(self) -> TensorDictModule:
        """A module that reads ``"observation"`` (and ``"target"``), and writes ``"action"``.

        Example: see ``docs/how_to/deploy.md``.
        """
        in_keys = ["observation", "target"] if self.target_names else ["observation"]
        return TensorDictModule(self, in_keys=in_keys, out_keys=["action"])

    def export(self, path: Path | str, batch: bool = False) -> None:
        """Write a program that needs only PyTorch (.pt2), or a runtime of ONNX (.onnx).

        Its inputs, state and target, are finite float64 tensors on the CPU. A .pt2 file is for
        ``torch.export.load``. Its program raises an error at other inputs, in PyTorch's words: at
        another size, "Guard failed" with the expected size; at too few dimensions, an IndexError
        without a shape.

        A .onnx file holds the same float64 program, with inputs ``state`` and ``target`` and output
        ``action``. ONNX has no checks of values, so that it is up to the caller that inputs are
        finite. Writing it needs the extra ``onnx``.

        Args:
            path: the file to write, ending in .pt2 or .onnx.
            batch: whether it takes states (N, D) and targets (N, K), any N, or (D,) and (K,).

        Raises:
            ValueError: the file has another ending.
            ModuleNotFoundError: the extra ``onnx`` is not installed.
            OSError: the file cannot be written.

        Example: see ``docs/how_to/deploy.md``.
        """
        write_program(path, self.policy.controller, self.space, len(self.target_names), batch)

    def _checked(self, what: str, state: np.ndarray | Tensor, names: Sequence[str]) -> Tensor:
        """The argument ``what``, after checks, as float64 tensor on the policy's device."""
        dim, device = len(names), self.policy.u_max.device
        if not isinstance(state, np.ndarray | Tensor):
            found = type(state).__name__
            raise TypeError(
                f"{what} must be a NumPy array, a PyTorch tensor or a list, got {found}"
            )
        if not _is_real(state):
            raise TypeError(f"{what} must hold real numbers, got {state.dtype}")
        if state.ndim == 0 or state.shape[-1] != dim:
            wanted = f"(*batch, {dim}) for {', '.join(names)}"
            raise ValueError(f"{what} must have shape {wanted}, got {tuple(state.shape)}")
        if isinstance(state, np.ndarray):
            state = torch.from_numpy(np.array(state, dtype=np.float64, order="C")).to(device)
        elif state.device != device:
            raise ValueError(f"{what} must be on {device} like the policy, got {state.device}")
        finite = state.isfinite()
        if not finite.all():
            *element, entry = (~finite).nonzero()[0].tolist()
            found = f"{names[entry]} = {state[*element, entry].item()}"
            where = f" at batch element {tuple(element)}" if element else ""
            raise ValueError(f"{what} must be finite, got {found}{where}")
        return state.double()


def _as_array(what: str, values: Any) -> Any:
    """A list or tuple as an array; anything else as it is."""
    if not isinstance(values, list | tuple):
        return values
    try:
        return np.array(values)
    except ValueError as error:
        message = f"{what} must hold numbers, as many in each row, got {values!r:.80}"
        raise ValueError(message) from error


def _is_real(state: np.ndarray | Tensor) -> bool:
    if isinstance(state, np.ndarray):
        return state.dtype.kind in "fiu"
    return not (state.is_complex() or state.dtype == torch.bool)


def _same_range(actions: ActionSpace, others: ActionSpace) -> bool:
    one, other = (torch.stack([each.low, each.high]).cpu().double() for each in (actions, others))
    return one.shape == other.shape and torch.allclose(one, other)
