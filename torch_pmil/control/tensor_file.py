"""Tensors from untrusted files: nothing is executed, and memory is bounded by the file's size.

:func:`load_tensors` reads the files of ``torch.save``, :func:`load_archive` the checkpoints of
TorchRL, which would itself load classes that read a pickle. In an archive ``manifest.json`` holds
the metadata and names the components. Each has ``state.json`` (mappings, lists, numbers, text and
keys of tensors), ``state/meta.json`` (shape and type of each tensor) and a member for the bytes of
each tensor. Anything else is refused.
"""

from __future__ import annotations

import io
import math
import pickletools
import zipfile
from collections import OrderedDict
from pathlib import Path
from typing import Any
from urllib.parse import quote

import torch
from torch import Tensor

from torch_pmil.files import MIB, TEXT_BYTES, FileError, parse_json, read_bytes, read_zip, short

TENSOR_BYTES = 64 * MIB  # of policy.pt and dynamics.pt, some 50 kB
ARCHIVE_BYTES = 128 * MIB  # of a checkpoint, some 0.2 MiB; reading takes about five times as much
# of data.pkl in policy.pt, some 2 kB; reading keys of one hash takes the square of their number
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
KINDS = ("float64", "float32", "float16", "bfloat16", "int64", "int32", "int16", "int8", "uint8")
DTYPES = {f"torch.{kind}": getattr(torch, kind) for kind in (*KINDS, "bool")}
LISTS, MAPPINGS = {"list": list, "tuple": tuple}, {"dict": dict, "ordered_dict": OrderedDict}
FORMAT = {"format": "torchrl.checkpoint", "format_version": 1}
ADAPTER = {"adapter": "torchrl.state_dict", "adapter_version": 1}
TENSOR_DICT = {"shape": [], "device": "cpu", "_type": "<class 'tensordict._td.TensorDict'>"}


def load_tensors(path: Path | str) -> Any:
    """What ``torch.save`` wrote of tensors, numbers, text, lists and dictionaries, on the CPU.

    The pickle in the file may name no function but those that make such tensors, and no tensor is
    larger than its bytes in the file.

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
        raise FileError(
            f"must be tensors, got what torch.load cannot read: {short(error)}"
        ) from error


def load_archive(path: Path | str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Metadata of a checkpoint, and the state of each component by name.

    Raises:
        FileError: the archive is damaged, larger than ``ARCHIVE_BYTES``, or holds anything that a
            trainer does not write; the message names the member.
        OSError: it cannot be opened.
    """
    members = read_zip(read_bytes(path, ARCHIVE_BYTES), ARCHIVE_BYTES)
    text = sum(len(content) for name, content in members.items() if name.endswith(".json"))
    if text > TEXT_BYTES:
        raise FileError(f"members of JSON must have at most {TEXT_BYTES} bytes, got {text}")
    manifest = _json(members, "manifest.json", FORMAT, finite=True)
    for entry in ("metadata", "components"):
        _check(f"manifest.json, {entry}", manifest.get(entry), {})
    states = {}
    for index, (name, record) in enumerate(sorted(manifest["components"].items())):
        path = f"components/{index:04d}-{quote(name, safe='._-')}"
        _check(f"manifest.json, component {short(name)}", record, {**ADAPTER, "path": path})
        states[name] = _state(path, members)
    for member in members:  # all others have been taken out
        raise FileError(f"members must be those of the components, got {short(member)}")
    return manifest["metadata"], states


def is_whole(tensor: Tensor) -> bool:
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
    try:
        operations = list(pickletools.genops(content))
    except Exception as error:  # pickletools fails at other bytes with any type
        raise FileError(f"{name} must be a pickle, got {short(error)}") from error
    tuples: set[object] = set()
    last = ""
    for opcode, argument, _ in operations:
        if opcode.name in CALLS or (opcode.name == "GLOBAL" and argument not in GLOBALS):
            raise FileError(f"{name} must name tensors alone, got {argument or opcode.name}")
        if opcode.name in PUTS and last.startswith("TUPLE"):
            tuples.add(argument)
        if opcode.name in GETS and argument in tuples:
            raise FileError(f"{name} must hold each tuple once, got one twice")
        last = opcode.name


def _json(
    members: dict[str, bytes], name: str, wanted: dict[str, Any], finite: bool = False
) -> dict[str, Any]:
    """Take a JSON object out of the members."""
    if name not in members:
        raise FileError(f"{name} is missing")
    try:
        content = parse_json(members.pop(name), finite)
    except FileError as error:
        raise FileError(f"{name} {error}") from error
    _check(name, content, wanted)
    return content


def _check(place: str, content: Any, wanted: dict[str, Any]) -> None:
    """Raise FileError unless this is a JSON object with the wanted entries."""
    if not isinstance(content, dict):
        raise FileError(f"{place} must be a dict, got {short(content)}")
    for key, value in wanted.items():
        found = content.get(key)
        if type(found) is not type(value) or found != value:
            raise FileError(f"{place}, {key} must be {value}, got {short(found)}")


def _state(path: str, members: dict[str, bytes]) -> Any:
    """The state of a component, whose members are taken out."""
    meta = _json(members, f"{path}/state/meta.json", TENSOR_DICT)
    keys = sorted(meta.keys() - TENSOR_DICT.keys())
    tensors = {key: _tensor(f"{path}/state/{key}.memmap", meta[key], members) for key in keys}
    schema = _json(members, f"{path}/state.json", {})
    try:
        return _decoded(schema, tensors)
    except FileError as error:
        raise FileError(f"{path}/state.json: {error}") from error
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise FileError(f"{path}/state.json must be a state, got {type(error).__name__}") from error


def _tensor(name: str, entry: Any, members: dict[str, bytes]) -> Tensor:
    """The tensor of a member, with the shape and type of its entry in meta.json."""
    _check(name, entry, {"device": "cpu", "is_nested": False})
    shape, dtype = entry.get("shape"), DTYPES.get(str(entry.get("dtype")))
    whole = isinstance(shape, list) and all(type(n) is int and n >= 0 for n in shape)
    if not whole or len(shape) > 64 or dtype is None:
        raise FileError(f"{name} must have a plain type and a shape, got {short(entry)}")
    content = members.pop(name, b"")  # an empty tensor has no member
    strides = math.prod(max(n, 1) for n in shape)  # those of an empty tensor may be endless
    size = 0 if 0 in shape else strides * dtype.itemsize
    if strides > ARCHIVE_BYTES or len(content) != size:
        found = f"of {short(shape)} numbers of {dtype}, got {len(content)}"
        raise FileError(f"{name} must have the bytes {found}")
    tensor = torch.empty(shape, dtype=dtype)
    if content:  # copied, to be aligned as other tensors: sums keep their last bits
        tensor.view(-1).copy_(torch.frombuffer(bytearray(content), dtype=dtype))
    return tensor


def _decoded(node: Any, tensors: dict[str, Tensor]) -> Any:
    """The value of a node of state.json, of the kinds that state dictionaries hold."""
    kind = node["kind"]
    if kind == "value":
        if isinstance(node["value"], list | dict):
            raise FileError(f"values must be numbers or text, got {short(node['value'])}")
        return node["value"]
    if kind == "tensor":
        return tensors.pop(node["key"])  # each once: in many places it would take more memory
    if kind in LISTS:
        return LISTS[kind](_decoded(item, tensors) for item in node["items"])
    if kind in MAPPINGS:
        items = [(_decoded(key, {}), _decoded(value, tensors)) for key, value in node["items"]]
        for key, _ in items:
            if not isinstance(key, str):  # a mapping compares all numbers of one hash
                raise FileError(f"keys must be text, got {short(key)}")
        mapping: Any = MAPPINGS[kind](items)
        if "metadata" in node:
            mapping._metadata = _decoded(node["metadata"], tensors)
        return mapping
    raise FileError(f"kinds must be those of numbers, text and tensors, got {short(kind)}")
