"""A learned policy as the robot needs it: from the measured state to the action."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from tensordict.nn import TensorDictModule
from torch import Tensor, nn

from torch_pmil.checks import check_positive
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.module_policy import AnyPolicy
from torch_pmil.control.policy import Act
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace, with_unit
from torch_pmil.files import replacing
from torch_pmil.gp.kernel_expansion import KernelExpansion

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
        check_positive("control_period (s)", control_period)
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
        """Write a program for ``torch.export.load``, which needs nothing but PyTorch.

        Its inputs, state and target, are finite float64 tensors on the CPU; it raises an error at
        others.

        Args:
            path: the file to write, ending in .pt2.
            batch: whether it takes states (N, D) and targets (N, K), any N, or (D,) and (K,).

        Raises:
            ValueError: the file has another ending.
            OSError: the file cannot be written.

        Example: see ``docs/how_to/deploy.md``.
        """
        path = Path(path)
        if path.suffix != ".pt2":
            raise ValueError(f"an exported policy must be a .pt2 file, got {path}")
        program = _Program(_constant(self.policy.controller), self.space)
        dims = [self.space.dim, *([len(self.target_names)] if self.target_names else [])]
        shape = (2,) if batch else ()
        examples = tuple(torch.zeros(*shape, dim, dtype=torch.float64) for dim in dims)
        # the first call caches tensors, which must not come from the tracer
        program(*examples)
        shapes = tuple({0: torch.export.Dim("N", min=0)} for _ in dims) if batch else None
        exported = torch.export.export(program, examples, dynamic_shapes=shapes)
        with replacing(path) as temporary, temporary.open("wb") as file:
            torch.export.save(exported, file)

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


def _constant(controller: Act) -> Act:
    """This controller with tensors on the CPU that are neither parameters nor views."""
    if isinstance(controller, nn.Module):
        return copy.deepcopy(controller).cpu().requires_grad_(False)
    assert isinstance(controller, Controller)

    def constant(tensor: Tensor) -> Tensor:
        return tensor.detach().cpu().clone(memory_format=torch.contiguous_format)

    parameters = *controller.parameters, controller.network.signal_variance
    network = KernelExpansion(*map(constant, parameters))
    return Controller(network, constant(controller.u_max), constant(controller.u_middle))


def _same_range(actions: ActionSpace, others: ActionSpace) -> bool:
    one, other = (torch.stack([each.low, each.high]).cpu().double() for each in (actions, others))
    return one.shape == other.shape and torch.allclose(one, other)


class _Program(nn.Module):
    """The exported program: no Python decides, so the checks are operations of the graph."""

    def __init__(self, controller: Act, space: StateSpace) -> None:
        super().__init__()
        self.controller, self.space = controller, space

    def forward(self, state: Tensor, target: Tensor | None = None) -> Tensor:
        inputs = self.space.features(_finite("state", state))
        if target is not None:
            inputs = torch.cat([inputs, _finite("target", target)], -1)
        return self.controller(inputs)


def _finite(what: str, given: Tensor) -> Tensor:
    # the view leaves checks of the dtype and of the number of dimensions in the graph
    given = given.double().view(given.shape)
    torch._assert_async(given.isfinite().all(), f"{what} must be finite")
    return given
