"""Places in a plane, in metres, from the pixels of a camera."""

from __future__ import annotations

import torch
from torch import Tensor

from torch_pmil.demonstrations.preparation.alignment import AlignmentError

FEWEST_MARKERS = 4  # that determine a homography
# ratio of the 8th to the first singular value below which three markers lie on one line
LEAST_AREA = 1e-3


def plane_coordinates(pixels: Tensor, markers: Tensor, places: Tensor) -> Tensor:
    r"""Places in the plane of a motion, in m, (*batch, 2), by a homography.

    .. math:: w\,[x, y, 1]^\top = H\,[p_x, p_y, 1]^\top

    H is fitted to four or more markers at known places, such as the corners of a sheet of paper in
    the plane (Hartley and Zisserman 2004, Algorithm 4.2). H includes a tilt of the camera and the
    direction of the pixels. The lens must show straight lines as straight.

    Args:
        pixels: (*batch, 2).
        markers: of the markers in the picture, (K, 2), K >= 4, no three of four on a line.
        places: of the markers in the plane, in m, (K, 2).

    Raises:
        AlignmentError: a shape is wrong, or the markers do not determine the plane.

    Example:
        >>> corners = torch.tensor([[100.0, 900.0], [500.0, 900.0], [500.0, 500.0], [100.0, 500.0]])
        >>> sheet = torch.tensor([[0.0, 0.0], [0.2, 0.0], [0.2, 0.2], [0.0, 0.2]])
        >>> plane_coordinates(torch.tensor([[300.0, 700.0]]), corners, sheet)
        tensor([[0.1000, 0.1000]], dtype=torch.float64)
    """
    if markers.shape[1:] != (2,) or markers.shape != places.shape or len(markers) < FEWEST_MARKERS:
        raise AlignmentError(
            f"markers and places must be (K, 2) with K >= {FEWEST_MARKERS}, got "
            f"{tuple(markers.shape)} and {tuple(places.shape)}"
        )
    if pixels.shape[-1:] != (2,):
        raise AlignmentError(f"pixels must be (*batch, 2), got {tuple(pixels.shape)}")
    for name, numbers in (("pixels", pixels), ("markers", markers), ("places", places)):
        if not (finite := numbers.isfinite()).all():
            raise AlignmentError(f"{name} must be finite, got {numbers[~finite][0].item()}")
    markers, places = markers.double(), places.double()
    seen, known = _normalisation(markers), _normalisation(places)
    normalised = _homography(_applied(seen, markers), _applied(known, places))
    H = torch.linalg.solve(known, normalised @ seen)
    return _applied(H, pixels.double())


def _homography(seen: Tensor, known: Tensor) -> Tensor:
    """Least squares H (3, 3) from seen to known (K, 2): two linear equations for each marker."""
    p = torch.cat([seen, torch.ones_like(seen[:, :1])], -1)
    zeros = torch.zeros_like(p)
    first = torch.cat([p, zeros, -known[:, :1] * p], -1)
    second = torch.cat([zeros, p, -known[:, 1:] * p], -1)
    rows = torch.cat([first, second])  # (2 K, 9)
    _, spread, directions = torch.linalg.svd(rows)
    if spread[7] < LEAST_AREA * spread[0]:
        raise AlignmentError("markers must determine the plane: no three of the four on one line")
    return directions[-1].reshape(3, 3)


def _normalisation(points: Tensor) -> Tensor:
    """Similarity (3, 3) that centres points (K, 2) and gives them unit spread."""
    centre, tiny = points.mean(0), torch.finfo(torch.float64).tiny
    scale = 1 / (points - centre).norm(dim=-1).mean().clamp_min(tiny)
    upper = torch.cat([scale * torch.eye(2).double(), -scale * centre[:, None]], 1)
    return torch.cat([upper, torch.eye(3).double()[2:]])


def _applied(H: Tensor, points: Tensor) -> Tensor:
    homogeneous = points @ H[:, :2].mT + H[:, 2]
    return homogeneous[..., :2] / homogeneous[..., 2:]
