"""Archives of checkpoints, read without executing anything that they carry.

TorchRL unpacks an archive and lets TensorDict load its folders, which may name classes that read a
pickle. What our trainers write needs none of that, and is all that is read here:

==========================================  ===================================================
member                                      holds
==========================================  ===================================================
``manifest.json``                           the run's ``metadata``, and the members of each
                                            component
``components/NNNN-NAME/state.json``         the state of a component: mappings, lists, numbers
                                            and text, and the keys of its tensors
``components/NNNN-NAME/state/meta.json``    shape and type of each tensor
``.../state/tensor_NNNNNNNN.memmap``        its bytes
==========================================  ===================================================

Anything else is refused. All members are stored, none is compressed; they are measured before one
is read, and never unpacked to a disk.
"""

from __future__ import annotations

import math
import re
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import torch
from torch import Tensor
from torchrl.checkpoint import CheckpointError

from torch_pmil.files import MIB, TEXT_BYTES, FileError, parse_json, read_bytes, read_zip, short

ARCHIVE_BYTES = 128 * MIB  # those of the tasks here have 0.2 MiB; reading takes some five times it
ADAPTER = {"adapter": "torchrl.state_dict", "adapter_version": 1}
TENSOR_DICT = {"shape": [], "device": "cpu", "_type": "<class 'tensordict._td.TensorDict'>"}
TENSOR_NAME = re.compile(r"tensor_[0-9]{8}")
KINDS = ("float64", "float32", "float16", "bfloat16", "int64", "int32", "int16", "int8", "uint8")
DTYPES = {f"torch.{kind}": getattr(torch, kind) for kind in (*KINDS, "bool")}
LISTS = {"list": list, "tuple": tuple}


@dataclass(frozen=True, eq=False)
class SavedRun:
    """What an undamaged checkpoint holds.

    Args:
        path: of its archive.
        metadata: entries about the run.
        states: state dictionary of each component.
    """

    path: Path
    metadata: dict[str, Any]
    states: dict[str, Any]


def read_archive(path: Path) -> SavedRun:
    """All of a checkpoint, checked.

    Raises:
        CheckpointError: the archive is damaged, or holds anything that no trainer writes; the
            message names the member.
        OSError: it cannot be opened.
    """
    try:
        members = read_zip(read_bytes(path, ARCHIVE_BYTES), ARCHIVE_BYTES)
        _check_text(members)
        manifest = read_manifest(members)
        states = {
            name: _state(record["path"], members) for name, record in manifest["components"].items()
        }
    except FileError as error:
        raise CheckpointError(str(error)) from error
    return SavedRun(path, manifest["metadata"], states)


def read_manifest(members: dict[str, bytes]) -> dict[str, Any]:
    """The manifest of an archive, which lists each of its other members once.

    Raises FileError.
    """
    manifest = _json(members, "manifest.json", finite=True)
    if (manifest.get("format"), manifest.get("format_version")) != ("torchrl.checkpoint", 1):
        raise FileError("manifest.json must be of format torchrl.checkpoint, version 1")
    for entry in ("metadata", "components"):
        _check_kind(f"manifest.json, {entry}", manifest.get(entry), dict)
    listed = ["manifest.json"]
    for index, (name, record) in enumerate(sorted(manifest["components"].items())):
        listed += _listed(name, record, f"components/{index:04d}-{quote(name, safe='._-')}")
    for member in sorted(members.keys() ^ set(listed)):
        held = "holds" if member in members else "lacks"
        raise FileError(f"members must be those of manifest.json, but it {held} {short(member)}")
    return manifest


def _listed(name: str, record: object, path: str) -> list[str]:
    """The members of a component; raise FileError at files that no state dictionary has."""
    _check_kind(f"manifest.json, component {short(name)}", record, dict)
    assert isinstance(record, dict)
    for key, wanted in {**ADAPTER, "path": path}.items():
        if record.get(key) != wanted or isinstance(record[key], bool):
            raise FileError(
                f"manifest.json, {key} of component {short(name)} must be {wanted}, got "
                f"{short(record.get(key))}"
            )
    files = record.get("files")
    _check_kind(f"manifest.json, files of component {short(name)}", files, list)
    assert isinstance(files, list)
    for file in files:
        tensor = isinstance(file, str) and re.fullmatch(r"state/tensor_[0-9]{8}\.memmap", file)
        if not tensor and file not in ("state.json", "state/meta.json"):
            raise FileError(
                f"{path} must hold state.json, state/meta.json and tensors, got {short(file)}"
            )
    return [f"{path}/{file}" for file in files]


def _check_text(members: dict[str, bytes]) -> None:
    text = sum(len(content) for name, content in members.items() if name.endswith(".json"))
    if text > TEXT_BYTES:
        raise FileError(f"members of JSON must have at most {TEXT_BYTES} bytes, got {text}")


def _check_kind(place: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise FileError(f"{place} must be a {kind.__name__}, got {short(value)}")


def _json(members: dict[str, bytes], name: str, finite: bool = False) -> dict[str, Any]:
    """A member that is a JSON object."""
    if name not in members:
        raise FileError(f"{name} is missing")
    try:
        content = parse_json(members[name], finite)
    except FileError as error:
        raise FileError(f"{name} {error}") from error
    _check_kind(name, content, dict)
    return content


def _state(path: str, members: dict[str, bytes]) -> Any:
    """The state dictionary of a component."""
    tensors = _tensors(f"{path}/state", members)
    schema = _json(members, f"{path}/state.json")
    try:
        return _decoded(schema, tensors)
    except FileError as error:
        raise FileError(f"{path}/state.json: {error}") from error
    except (LookupError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise FileError(f"{path}/state.json must be a state, got {type(error).__name__}") from error


def _tensors(folder: str, members: dict[str, bytes]) -> dict[str, Tensor]:
    """The tensors of a component; members that meta.json does not list are refused."""
    place = f"{folder}/meta.json"
    meta = _json(members, place)
    for key, wanted in TENSOR_DICT.items():
        if key not in meta or meta[key] != wanted:
            raise FileError(f"{place}, {key} must be {wanted}, got {short(meta.get(key))}")
    listed = {key: entry for key, entry in meta.items() if key not in TENSOR_DICT}
    held = {f"{folder}/{key}.memmap" for key in listed}
    for member in members:
        if member.startswith(f"{folder}/") and member not in held | {place}:
            raise FileError(f"{place} must list all tensors, lacks {member}")
    return {key: _tensor(folder, key, entry, members) for key, entry in listed.items()}


def _tensor(folder: str, key: str, entry: object, members: dict[str, bytes]) -> Tensor:
    place = f"{folder}/meta.json, {short(key)}"
    _check_kind(place, entry, dict)
    assert isinstance(entry, dict)
    shape, kind = entry.get("shape"), entry.get("dtype")
    plain = entry.keys() == {"device", "shape", "dtype", "is_nested"}
    if not (plain and TENSOR_NAME.fullmatch(key) and entry["is_nested"] is False):
        raise FileError(f"{place} must be a plain tensor, got {short(entry)}")
    if not isinstance(kind, str) or kind not in DTYPES or entry["device"] != "cpu":
        raise FileError(f"{place} must have numbers of a plain type, got {short(kind)}")
    if not isinstance(shape, list) or any(type(n) is not int or n < 0 for n in shape):
        raise FileError(
            f"{place}, shape must be a list of whole numbers from 0, got {short(shape)}"
        )
    content = members.get(f"{folder}/{key}.memmap", b"")  # none is written of an empty tensor
    strides = math.prod(max(n, 1) for n in shape[:64])  # of an empty tensor they may be endless
    numbers = 0 if 0 in shape else strides
    endless = len(shape) > 64 or strides > ARCHIVE_BYTES
    if endless or len(content) != numbers * DTYPES[kind].itemsize:
        raise FileError(
            f"{folder}/{key}.memmap must have the bytes of {short(shape)} numbers of {kind}, got "
            f"{len(content)}"
        )
    if not content:
        return torch.zeros(shape, dtype=DTYPES[kind])
    return torch.frombuffer(bytearray(content), dtype=DTYPES[kind]).reshape(shape)


def _key(node: Any) -> str:
    """A key is text: among numbers of one hash, a mapping would search for each of them."""
    if node["kind"] != "value" or not isinstance(node["value"], str):
        raise FileError(f"keys must be text, got {short(node)}")
    return node["value"]


def _decoded(node: Any, tensors: dict[str, Tensor]) -> Any:
    """What a node of state.json stands for: kinds of TorchRL's that state dictionaries hold."""
    kind = node["kind"]
    if kind == "value":
        if isinstance(node["value"], list | dict):
            raise FileError(f"values must be numbers or text, got {short(node['value'])}")
        return node["value"]
    if kind == "tensor":
        return tensors.pop(node["key"]).clone()  # of one key only one
    if kind in LISTS:
        return LISTS[kind](_decoded(item, tensors) for item in node["items"])
    if kind in ("dict", "ordered_dict"):
        pairs = [(_key(key), _decoded(value, tensors)) for key, value in node["items"]]
        if kind == "dict":
            return dict(pairs)
        mapping = OrderedDict(pairs)
        if "metadata" in node:
            mapping._metadata = _decoded(node["metadata"], tensors)  # type: ignore[attr-defined]
        return mapping
    raise FileError(f"kinds must be those of numbers, text and tensors, got {short(kind)}")
