"""Tensors come back from their files, and nothing is executed."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import torch

from tests.helpers.hostile import Trap
from torch_pmil.control.tensor_file import load_tensors
from torch_pmil.files import FileError


def test_tensors_come_back(tmp_path: Path) -> None:
    kinds = (torch.float64, torch.float32, torch.int64, torch.uint8, torch.bool, torch.bfloat16)
    saved = {str(kind): torch.ones(2, 3).to(kind).mT for kind in kinds} | {"n": [1, 2.5, "x", None]}
    torch.save(saved, tmp_path / "saved.pt")
    loaded = load_tensors(tmp_path / "saved.pt")
    assert loaded.pop("n") == saved.pop("n")
    assert all(torch.equal(loaded[name], saved[name]) for name in saved)


def test_parameters_of_a_module_come_back(tmp_path: Path) -> None:
    module = torch.nn.Linear(2, 3)
    torch.save(module.state_dict(), tmp_path / "saved.pt")
    module.load_state_dict(load_tensors(tmp_path / "saved.pt"))


@pytest.mark.parametrize("protocol", [2, 4, 5])
def test_code_among_tensors_is_refused_and_not_executed(tmp_path: Path, protocol: int) -> None:
    torch.save([Trap(tmp_path / "sprung")], tmp_path / "a.pt", pickle_protocol=protocol)
    with pytest.raises(FileError, match=r"data\.pkl must name tensors alone, got"):
        load_tensors(tmp_path / "a.pt")
    assert os.listdir(tmp_path) == ["a.pt"]
