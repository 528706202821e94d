"""What figures show, as numbers and words."""

from __future__ import annotations

import numpy as np
from matplotlib.collections import FillBetweenPolyCollection
from matplotlib.figure import Figure


def corners_of(band: FillBetweenPolyCollection) -> np.ndarray:
    return band.get_paths()[0].vertices


def assert_edge(band: FillBetweenPolyCollection, x: np.ndarray, y: np.ndarray) -> None:
    """The points (x, y) are corners of the band."""
    distances = np.abs(corners_of(band)[None] - np.stack([x, y], -1)[:, None]).max(-1)
    np.testing.assert_allclose(distances.min(1), 0, atol=1e-12)


def legend_of(figure: Figure) -> list[str]:
    return [text.get_text() for text in figure.legends[0].get_texts()]
