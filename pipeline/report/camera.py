"""How a page draws one object: as dots that a camera sees, and the address at which a report shows it in 3D."""

from __future__ import annotations

from urllib.parse import quote, urlencode

import numpy as np

from ...stages.arrays import BoolArray, FloatArray
from .figures.style import VIEW

#: Width and height of a drawing, in the units of its paths.
FRAME = (300, 210)
_MARGIN = 8.0
_MOST_DOTS = 1000
_TURN_DEG = 25.0
_PAD_M = 0.3
_BARS_M = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0)


class Camera:
    """Looks at a box from the sensor's side, from above, without perspective; true to scale."""

    def __init__(self, low: FloatArray, high: FloatArray) -> None:
        centre = (low + high) / 2
        azimuth = np.arctan2(-centre[1], -centre[0]) + np.radians(_TURN_DEG)
        elevation = np.radians(VIEW["elev"])
        self._right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
        self._up = np.array(
            [
                -np.sin(elevation) * np.cos(azimuth),
                -np.sin(elevation) * np.sin(azimuth),
                np.cos(elevation),
            ]
        )
        corners = np.stack(np.meshgrid(*np.stack([low, high], axis=1)), axis=-1).reshape(-1, 3)
        u, v = corners @ self._right, corners @ self._up
        size = np.array([np.ptp(u), np.ptp(v)])
        self.scale = float(((np.array(FRAME) - 2 * _MARGIN) / size).min())
        self._middle = np.array([(u.min() + u.max()) / 2, (v.min() + v.max()) / 2])
        self.bar_m = max((m for m in _BARS_M if m * self.scale <= FRAME[0] / 3), default=_BARS_M[0])

    def path(self, points: FloatArray) -> str:
        """Points as an SVG path of dots; evenly over their order where they are too many."""
        chosen = points[np.unique(np.linspace(0, len(points) - 1, min(len(points), _MOST_DOTS)).round().astype(int))]
        x = FRAME[0] / 2 + (chosen @ self._right - self._middle[0]) * self.scale
        y = FRAME[1] / 2 - (chosen @ self._up - self._middle[1]) * self.scale
        return "".join(f"M{a:.1f} {b:.1f}h0" for a, b in zip(x, y, strict=True))


def box_around(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest corner, (3,) each, of a box around points, with 0.3 m to spare."""
    return points.min(axis=0) - _PAD_M, points.max(axis=0) + _PAD_M


def inside(points: FloatArray, low: FloatArray, high: FloatArray) -> BoolArray:
    """(n,) which points lie in a box."""
    is_outside = (points < low) | (points > high)
    return ~is_outside[:, 0] & ~is_outside[:, 1] & ~is_outside[:, 2]


def object_address(pair_id: str, name: str) -> str:
    """What a report's address ends in to open one object.

    Examples
    --------
    >>> object_address("0007", "real 3")
    '#pair=0007&object=real%203'
    """
    return f"#{urlencode({'pair': pair_id, 'object': name}, quote_via=quote)}"
