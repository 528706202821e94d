"""The file of a learned policy: its parameters, and the state space and period they are for.

==================  ==============================================================================
entry               holds
==================  ==============================================================================
``format``          ``"torch_pmil policy"``
``version``         version of the format, 2
``torch_pmil``      version of the package that wrote the file
``names``           names of the D entries of the state; ``units`` holds their units
``angles``          indices of the entries that are angles (rad)
``action_names``    names of the F actions; ``action_units`` holds their units, "" if not known
``control_period``  time for which the robot holds an action, s
``target_names``    names of the K entries of a target; absent if it has none
``module``          a module of a user's own in words; absent for policies of the package
``parameters``      float64 tensors of :class:`RBFPolicy`: ``centres`` (m, D' + K) and
                    ``log_widths`` (F, D' + K) in multiples of ``scale`` (D' + K,), ``weights``
                    (m, F), ``u_middle`` (F,) and ``u_max`` (F,) in the units of the actions;
                    ``gains`` (F, D') and ``offsets`` (F,) in place of the first three for a
                    :class:`LinearPolicy`; or the state of a :class:`ModulePolicy`
==================  ==============================================================================

A file of version 1 has no names and units of actions and no ``u_middle``: its actions are torques
in N·m around zero.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from torch_pmil.checks import check_finite_entries
from torch_pmil.control.action_space import ActionSpace
from torch_pmil.control.linear_policy import LinearPolicy
from torch_pmil.control.module_policy import AnyPolicy, MakeModule, ModulePolicy, check_maker
from torch_pmil.control.rbf_policy import RBFPolicy
from torch_pmil.control.state_policy import StatePolicy
from torch_pmil.control.state_space import StateSpace, joint_match
from torch_pmil.control.tensor_file import is_whole, load_tensors
from torch_pmil.files import FileError, LineError, replacing, short

FORMAT, FORMAT_VERSION = "torch_pmil policy", 2
OF_TORQUES = 1  # version that knows torques alone
OPTIONAL = "target_names"
LISTS = dict.fromkeys(("names", "units", "action_names", "action_units", OPTIONAL), str)


class PolicyFileError(LineError):
    """A file does not hold a policy that can be used."""


def save_policy(
    path: Path | str,
    policy: AnyPolicy,
    space: StateSpace,
    control_period: float,
    target_names: Sequence[str] = (),
    actions: ActionSpace | None = None,
) -> None:
    """Write a policy and the data that it needs to act, wholly or not at all.

    Args:
        path: the file to write; an existing file is replaced.
        policy, space, control_period, target_names, actions: as in :class:`StatePolicy`. The match
            space is not saved.

    Raises:
        ValueError: as :class:`StatePolicy`.
        OSError: the file cannot be written.

    Example: see :func:`load_policy`.
    """
    actions = StatePolicy(policy, space, control_period, target_names, actions).actions
    content = {
        "format": FORMAT,
        "version": FORMAT_VERSION,
        "torch_pmil": version("torch_pmil"),
        "names": list(space.names),
        "units": list(space.units),
        "angles": list(space.angles),
        "action_names": list(actions.names),
        "action_units": list(actions.units),
        "control_period": float(control_period),
        **({"target_names": list(target_names)} if target_names else {}),
        **({"module": str(policy.module)} if isinstance(policy, ModulePolicy) else {}),
        "parameters": {name: tensor.detach().cpu() for name, tensor in policy.state_dict().items()},
    }
    with replacing(path) as temporary, temporary.open("wb") as file:
        torch.save(content, file)


def load_policy(path: Path | str, policy: MakeModule | None = None) -> StatePolicy:
    """Load a policy that :func:`save_policy` or ``pmil train`` wrote, without executing anything.

    Args:
        path: the file.
        policy: makes the module of a policy of your own, as for :class:`PMIL`: the file holds its
            parameters alone.

    Returns:
        The policy on the CPU, without gradient. Its match space is the state itself.

    Raises:
        PolicyFileError: the file is damaged, of another kind or version, or its entries do not fit
            each other or the module.
        TypeError: ``policy`` cannot be called so.
        OSError: the file cannot be read.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "policy.pt"
        >>> names, units = ("q", "dq"), ("rad", "rad/s")
        >>> space = StateSpace(names, units, (0,), joint_match(names, units))
        >>> policy = RBFPolicy(torch.zeros(5, 3), torch.ones(1), torch.ones(3))
        >>> save_policy(path, policy, space, control_period=0.1)
        >>> load_policy(path)(torch.zeros(2))
        tensor([0.], dtype=torch.float64)
    """
    try:
        content = _as_present(_loaded(path))
        _check_entries(content)
        names, units = tuple(content["names"]), tuple(content["units"])
        space = StateSpace(names, units, tuple(content["angles"]), joint_match(names, units))
        targets = content.get(OPTIONAL, [])
        inputs = len(space.feature_names) + len(targets)
        network = _network(content, inputs, policy)
        limits = network.u_middle, network.u_max
        actions = ActionSpace.around(*limits, content["action_names"], content["action_units"])
        return StatePolicy(network, space, content["control_period"], targets, actions)
    except ValueError as error:
        raise PolicyFileError(f"{path}: {error}") from error


def _network(content: Mapping[str, Any], inputs: int, make: MakeModule | None) -> AnyPolicy:
    """The policy of a file's entries, which sees ``inputs`` features, without gradient."""
    parameters, words = _entries(content["parameters"]), content.get("module")
    if words is None:
        return policy_of(parameters, inputs)
    if make is None:
        raise PolicyFileError(
            "its policy is a module of your own, so load_policy(path, policy=...) needs the "
            f"function that makes it: {short(words)}"
        )
    check_maker(make)
    u_max = parameters.get("u_max")
    if not (isinstance(u_max, Tensor) and u_max.ndim == 1 and is_whole(u_max)):
        raise PolicyFileError(f"parameter u_max must be a tensor (F,), got {short(u_max)}")
    F, like = len(u_max), torch.ones(inputs, dtype=torch.float64)
    network = ModulePolicy(make(inputs, F), like, torch.ones(F), torch.zeros(F))
    fresh = network.state_dict()
    if parameters.keys() != fresh.keys():
        raise PolicyFileError(
            f"parameters must be those of the module, {_listed(fresh)}, got "
            f"{_listed(parameters) or 'none'}"
        )
    for name, tensor in fresh.items():
        _check_parameter(name, parameters[name], tuple(tensor.shape), tensor.dtype)
    network.load_state_dict(parameters)
    return network.requires_grad_(False)


def policy_of(parameters: Mapping[str, Tensor], inputs: int) -> RBFPolicy | LinearPolicy:
    """The policy with the given parameters, which sees ``inputs`` features, without gradient.

    Raises PolicyFileError where parameters are missing, do not fit, or give no finite action.
    """
    policy = (_linear_policy if "gains" in parameters else _rbf_policy)(parameters, inputs)
    policy.load_state_dict(parameters)
    if isinstance(policy, LinearPolicy):
        gains = policy.controller.gains
        check_finite_entries("gains / scale", gains, lambda message, _: PolicyFileError(message))
    else:
        _check_magnitudes(policy)
    return policy.requires_grad_(False)


def _linear_policy(parameters: Mapping[str, Tensor], inputs: int) -> LinearPolicy:
    outputs = (*getattr(parameters.get("gains"), "shape", ()), 0)[0]
    ranges = {"u_max": (outputs,), "u_middle": (outputs,), "scale": (inputs,)}
    _check_parameters(parameters, {"gains": (outputs, inputs), "offsets": (outputs,), **ranges})
    if not (inputs and outputs):
        raise PolicyFileError(f"a policy must have inputs and actions, got {inputs} and {outputs}")
    return LinearPolicy(*(parameters[name] for name in ("scale", "u_max", "u_middle")))


def _rbf_policy(parameters: Mapping[str, Tensor], inputs: int) -> RBFPolicy:
    m, outputs = (*getattr(parameters.get("weights"), "shape", ()), 0, 0)[:2]
    shapes = {
        "centres": (m, inputs),
        "weights": (m, outputs),
        "log_widths": (outputs, inputs),
        "u_max": (outputs,),
        "u_middle": (outputs,),
        "scale": (inputs,),
    }
    _check_parameters(parameters, shapes)
    if not (m and inputs and outputs):
        raise PolicyFileError(
            f"a policy must have centres, inputs and actions, got {m}, {inputs} and {outputs}"
        )
    return RBFPolicy(*(parameters[name] for name in ("centres", "u_max", "scale")))


def _loaded(path: Path | str) -> dict:
    try:
        content = load_tensors(path)
    except FileError as error:
        raise PolicyFileError(f"must be a file of save_policy: {error}") from error
    entries = _entries(content)
    if entries.get("format") != FORMAT:
        some = f"entries {_listed(list(entries)[:5]) or 'none'}"
        found = some if isinstance(content, dict) else f"a {type(content).__name__}"
        raise PolicyFileError(
            f"must be a file of save_policy, with the entry format = {FORMAT!r}, got {found}"
        )
    return entries


def _as_present(content: dict) -> dict:
    """The entries of a file of version 1 as those of the present version."""
    if type(content.get("version")) is not int or content["version"] != OF_TORQUES:
        return content
    parameters = _entries(content.get("parameters"))
    u_max = parameters.get("u_max")
    if not isinstance(u_max, Tensor) or not is_whole(u_max):
        return content
    torques = list(map(str, range(u_max.numel())))
    return content | {
        "version": FORMAT_VERSION,
        "action_names": torques,
        "action_units": ["N·m"] * len(torques),
        "parameters": parameters | {"u_middle": torch.zeros_like(u_max)},
    }


def _entries(content: object) -> dict:
    """Entries of a dictionary, without its own methods, which a file can replace."""
    return dict(dict.items(content)) if isinstance(content, dict) else {}


def _listed(names: Iterable[object]) -> str:
    """Names in one line of a message."""
    return ", ".join(
        name if isinstance(name, str) and name.isprintable() and len(name) < 40 else short(name)
        for name in names
    )


def _check_entries(content: dict) -> None:
    found, writer = content.get("version"), _listed([content.get("torch_pmil")])
    if type(found) is not int or found != FORMAT_VERSION:
        raise PolicyFileError(
            f"format version must be {FORMAT_VERSION}, got {short(found)}, written by torch_pmil "
            f"{writer}"
        )
    for name, kind in (LISTS | {"angles": int}).items():
        value = content.get(name, [] if name == OPTIONAL else None)
        if not isinstance(value, list) or {type(item) for item in value} - {kind}:
            wanted = f"a list of {kind.__name__}"
            raise PolicyFileError(f"entry {name} must be {wanted}, got {short(value)}")
    for names, units in (("names", "units"), ("action_names", "action_units")):
        if len(content[units]) != len(content[names]):
            wanted, found = short(content[names]), short(content[units])
            raise PolicyFileError(
                f"entry {units} must hold one for each of {names} {wanted}, got {found}"
            )
    period, parameters = content.get("control_period"), content.get("parameters")
    if not isinstance(period, float):
        raise PolicyFileError(f"entry control_period must be a float, got {short(period)}")
    if not isinstance(parameters, dict):
        found = type(parameters).__name__
        raise PolicyFileError(f"entry parameters must be a dict of tensors, got {found}")


def _check_parameters(
    parameters: Mapping[str, Tensor], shapes: Mapping[str, tuple[int, ...]]
) -> None:
    if parameters.keys() != shapes.keys():
        raise PolicyFileError(
            f"parameters must be {', '.join(shapes)}, got {_listed(parameters) or 'none'}"
        )
    for name, shape in shapes.items():
        _check_parameter(name, parameters[name], shape)


def _check_parameter(
    name: str, value: object, shape: tuple[int, ...], dtype: torch.dtype = torch.float64
) -> None:
    if not isinstance(value, Tensor) or value.dtype != dtype:
        found, wanted = getattr(value, "dtype", type(value).__name__), str(dtype).split(".")[-1]
        raise PolicyFileError(f"parameter {name} must be a {wanted} tensor, got {found}")
    if value.shape != shape:
        raise PolicyFileError(f"parameter {name} must have shape {shape}, got {tuple(value.shape)}")
    if not is_whole(value):
        raise PolicyFileError(f"parameter {name} must hold its numbers, got one repeated")
    check_finite_entries(f"parameter {name}", value, lambda message, _: PolicyFileError(message))


def _check_magnitudes(policy: RBFPolicy) -> None:
    """Raise where finite numbers have squares that are not, or are zero."""
    centres, _, widths = policy.controller.parameters
    endless = ~centres.square().isfinite()
    if endless.any():
        found = centres[endless][0].item()
        raise PolicyFileError(f"centres must have finite squares, got {found:g}")
    squares = widths.square()
    endless = ~squares.isfinite() | (squares == 0)
    if endless.any():
        found = policy.log_widths[endless][0].item()
        raise PolicyFileError(
            f"widths must have squares that are positive and finite, got log_widths = {found:g}"
        )
