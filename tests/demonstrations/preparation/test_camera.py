"""Pixels to metres: exact for a pinhole camera from anywhere; markers must determine the plane."""

from __future__ import annotations

import re

import pytest
import torch
from torch import Tensor

from torch_pmil.demonstrations.preparation.alignment import AlignmentError
from torch_pmil.demonstrations.preparation.camera import plane_coordinates

SHEET = torch.tensor(
    [[0.0, 0.0], [0.3, 0.0], [0.3, 0.2], [0.0, 0.2], [0.1, 0.15]], dtype=torch.float64
)  # m
CAMERA = torch.tensor(
    [[900.0, 250.0, 400.0], [80.0, -880.0, 900.0], [0.3, 0.2, 1.0]], dtype=torch.float64
)  # a tilted one


def seen(places: Tensor) -> Tensor:
    """Pixels, independently of the package."""
    w = [CAMERA @ torch.tensor([x, y, 1.0], dtype=torch.float64) for x, y in places.tolist()]
    return torch.stack([each[:2] / each[2] for each in w])


@pytest.mark.parametrize("count", [4, 5])
def test_tilted_camera_is_undone(count: int) -> None:
    track = torch.rand(50, 2, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    found = plane_coordinates(seen(track), seen(SHEET[:count]), SHEET[:count])
    torch.testing.assert_close(found, track, rtol=0, atol=1e-10)


def test_more_markers_average_their_errors() -> None:
    draws = torch.Generator().manual_seed(0)
    many = torch.rand(40, 2, generator=draws, dtype=torch.float64) * 0.3
    corners = torch.stack([many[:, axis].argsort()[[0, -1]] for axis in (0, 1)]).flatten()
    clicked = seen(many) + torch.randn(40, 2, generator=draws, dtype=torch.float64)
    track = torch.rand(50, 2, generator=draws, dtype=torch.float64) * 0.3
    few, all_of_them = (
        (plane_coordinates(seen(track), clicked[which], many[which]) - track).square().mean().sqrt()
        for which in (corners, slice(None))
    )
    assert all_of_them < 0.5 * few
    assert all_of_them < 1e-3  # m: a pixel is about a millimetre


@pytest.mark.parametrize(
    ("width", "markers", "places", "message"),
    [
        (2, torch.rand(3, 2), SHEET[:3], r"be (K, 2) with K >= 4, got (3, 2) and (3, 2)"),
        (3, torch.rand(4, 2), SHEET[:4], "pixels must be (*batch, 2), got (5, 3)"),
        (2, torch.arange(8.0).reshape(4, 2), SHEET[:4], "no three of the four on one line"),
        (2, torch.ones(4, 2), SHEET[:4], "markers must determine the plane"),
    ],
)
def test_what_determines_no_plane_is_refused(
    width: int, markers: Tensor, places: Tensor, message: str
) -> None:
    with pytest.raises(AlignmentError, match=re.escape(message)):
        plane_coordinates(torch.rand(5, width), markers, places)
