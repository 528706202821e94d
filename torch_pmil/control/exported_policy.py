"""A policy as a program of PyTorch or of ONNX, which runs without this package."""

from __future__ import annotations

import copy
import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path

import torch
from torch import Tensor, nn
from torch.export import ExportedProgram

from torch_pmil.control.linear_policy import LinearController
from torch_pmil.control.policy import Act
from torch_pmil.control.rbf_policy import Controller
from torch_pmil.control.state_space import StateSpace
from torch_pmil.files import replacing
from torch_pmil.gp.kernel_expansion import KernelExpansion

INPUTS = "state", "target"
BATCH = "N"  # name of the dimension of a batch
FOR_ONNX = "onnx", "onnxscript"  # the libraries that PyTorch needs for ONNX


def write_program(
    path: Path | str, controller: Act, space: StateSpace, targets: int, batch: bool
) -> None:
    """Write the program of a controller, see :meth:`StatePolicy.export`.

    Args:
        path: the file to write, ending in .pt2 or .onnx.
        controller: of the features of the state, then the target if there is one.
        space: of the state.
        targets: number of entries of a target, or 0 for a policy without targets.
        batch: whether the program takes batches.

    Raises:
        ValueError: the file has another ending.
        ModuleNotFoundError: one of the libraries for ONNX is not installed.
        OSError: the file cannot be written.
    """
    path = Path(path)
    if path.suffix not in (".pt2", ".onnx"):
        raise ValueError(f"an exported policy must be a .pt2 or .onnx file, got {path}")
    as_onnx = path.suffix == ".onnx"
    if as_onnx:
        _check_onnx()
    program = _Program(_constant(controller), space)
    exported = _traced(program, [space.dim, targets] if targets else [space.dim], batch)
    with replacing(path) as temporary:
        if as_onnx:
            _save_onnx(exported, temporary, batch)
        else:
            with temporary.open("wb") as file:
                torch.export.save(exported, file)


def _check_onnx() -> None:
    if not all(map(find_spec, FOR_ONNX)):
        raise ModuleNotFoundError(
            f"writing a .onnx file needs {' and '.join(FOR_ONNX)}: pip install 'torch_pmil[onnx]'"
        )


def _constant(controller: Act) -> Act:
    """This controller with tensors on the CPU that are neither parameters nor views."""
    if isinstance(controller, nn.Module):
        return copy.deepcopy(controller).cpu().requires_grad_(False)

    def constant(tensor: Tensor) -> Tensor:
        return tensor.detach().cpu().clone(memory_format=torch.contiguous_format)

    if isinstance(controller, LinearController):
        return LinearController(*map(constant, vars(controller).values()))
    assert isinstance(controller, Controller)
    parameters = *controller.parameters, controller.network.signal_variance
    network = KernelExpansion(*map(constant, parameters))
    return Controller(network, constant(controller.u_max), constant(controller.u_middle))


def _traced(program: _Program, dims: Sequence[int], batch: bool) -> ExportedProgram:
    shape = (2,) if batch else ()
    examples = tuple(torch.zeros(*shape, dim, dtype=torch.float64) for dim in dims)
    # the first call caches tensors, which must not come from the tracer
    program(*examples)
    shapes = tuple({0: torch.export.Dim(BATCH, min=0)} for _ in dims) if batch else None
    return torch.export.export(program, examples, dynamic_shapes=shapes)


def _save_onnx(exported: ExportedProgram, path: Path, batch: bool) -> None:
    names = INPUTS[: len(exported.graph_signature.user_inputs)]
    named_once = ({0: BATCH}, {0: None})[: len(names)]  # PyTorch warns of a name that comes twice
    with _without_remarks():
        torch.onnx.export(
            exported,
            f=path,
            input_names=names,
            output_names=["action"],
            dynamic_shapes=named_once if batch else None,
            external_data=False,
            verbose=False,
        )


@contextmanager
def _without_remarks() -> Iterator[None]:
    """Within, PyTorch is silent on what it deprecates itself and on a missing torchvision."""
    logger = logging.getLogger("torch.onnx")
    before = logger.level
    logger.setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)
            yield
    finally:
        logger.setLevel(before)


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
    # in the graph, these check the dtype and the number of dimensions
    given = given.double().permute(*range(given.ndim))
    torch._assert_async(given.isfinite().all(), f"{what} must be finite")  # ONNX is without
    return given
