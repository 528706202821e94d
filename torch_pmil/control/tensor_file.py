"""Files of tensors by ``torch.save``, from strangers too: read without executing anything."""

from __future__ import annotations

import io
import pickletools
import zipfile
from pathlib import Path
from typing import Any

import torch

from torch_pmil.files import MIB, FileError, read_bytes, read_zip

TENSOR_BYTES = 64 * MIB  # of policy.pt and dynamics.pt, some 50 kB
# of their data.pkl, some 2 kB; keys of one hash take the square of their number
PICKLE_BYTES = 64 * 2**10
STORAGES = ["Double", "Float", "Half", "BFloat16", "Long", "Int", "Short", "Char", "Byte", "Bool"]
# all that the pickle of a dictionary of tensors, lists and numbers names; torch.load takes more, as
# bytearray(10**12)
GLOBALS = {
    "collections OrderedDict",
    "torch._utils _rebuild_tensor_v2",
    *(f"torch {kind}Storage" for kind in STORAGES),
}
# pickle's ways to call something else, and to repeat what is on its stack
CALLS = {"INST", "OBJ", "NEWOBJ", "NEWOBJ_EX", "STACK_GLOBAL", "DUP", "MEMOIZE"}
PUTS, GETS = {"BINPUT", "LONG_BINPUT", "PUT"}, {"BINGET", "LONG_BINGET", "GET"}


def load_tensors(path: Path | str) -> Any:
    """What ``torch.save`` wrote of tensors, numbers, text, lists and dictionaries, on the CPU.

    Nothing is executed: the pickle may name no function but those that make such tensors. No tensor
    is larger than what the file holds of it.

    Raises:
        FileError: the file is damaged, of another kind, or larger than ``TENSOR_BYTES``.
        OSError: it cannot be opened.

    Example:
        >>> import tempfile
        >>> path = Path(tempfile.mkdtemp()) / "numbers.pt"
        >>> torch.save({"weights": torch.zeros(2)}, path)
        >>> load_tensors(path)
        {'weights': tensor([0., 0.])}
    """
    members = read_zip(read_bytes(path, TENSOR_BYTES), TENSOR_BYTES)
    for name, content in members.items():
        if name.endswith("data.pkl"):
            _check_pickle(name, content)
    copy = io.BytesIO()  # of what was checked, as torch.load has a reader of archives of its own
    with zipfile.ZipFile(copy, "w") as archive:
        for name, content in members.items():
            archive.writestr(name, content)
    copy.seek(0)
    try:
        return torch.load(copy, weights_only=True, map_location="cpu")
    except Exception as error:  # other files can make the reader fail with any type
        raise FileError(f"must be tensors, got what torch.load cannot read ({_line(error)})") from (
            error
        )


def is_whole(tensor: torch.Tensor) -> bool:
    """Whether there is memory for each number of a tensor: a view may repeat one without end.

    Example:
        >>> is_whole(torch.zeros(2)), is_whole(torch.zeros(1).expand(10**12))
        (True, False)
    """
    return tensor.numel() * tensor.element_size() <= tensor.untyped_storage().nbytes()


def _check_pickle(name: str, content: bytes) -> None:
    """Refuse a pickle that names more than tensors, or puts a tuple into several places.

    Tuples of tuples, each twice, have 2^depth parts, and as a key a tuple is hashed part by part.
    """
    if len(content) > PICKLE_BYTES:
        raise FileError(f"{name} must have at most {PICKLE_BYTES} bytes, got {len(content)}")
    tuples: set[object] = set()
    last = ""
    try:
        for opcode, argument, _ in pickletools.genops(content):
            if opcode.name in CALLS or (opcode.name == "GLOBAL" and argument not in GLOBALS):
                raise FileError(f"{name} must name tensors alone, got {argument or opcode.name}")
            if opcode.name in PUTS and last.startswith("TUPLE"):
                tuples.add(argument)
            if opcode.name in GETS and argument in tuples:
                raise FileError(f"{name} must hold each tuple once, got one twice")
            last = opcode.name
    except FileError:
        raise
    except Exception as error:  # pickletools fails at other bytes with any type
        raise FileError(f"{name} must be a pickle, got {_line(error)}") from error


def _line(error: Exception) -> str:
    """An error's type and what it says, in one short line."""
    return f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
