"""Small pictures of one object on both sides, for the first screen of a page."""

from __future__ import annotations

from collections.abc import Sequence
from io import BytesIO

import numpy as np

from ....stages.arrays import FloatArray
from ..look import GREY
from . import style

_WIDTH_IN, _HEIGHT_IN, _DPI = 3.4, 2.0, 110
#: More points in one colour look alike and take time.
_MOST_POINTS = 4000
_MARGIN_M = 0.3
_SCALE_BARS_M = (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50)


def thumbnail(clouds: Sequence[tuple[FloatArray, str]]) -> bytes:
    """A PNG of points in space, seen obliquely without perspective, with a bar that tells its scale; transparent.

    Parameters
    ----------
    clouds : points, (n, 3) metres, and their colour, the first one lowest; at least one point
    """
    from matplotlib.lines import Line2D

    seen = [points @ _screen_axes().T for points, _ in clouds]
    low, high = (reach(np.concatenate(seen), axis=0) for reach in (np.min, np.max))
    rng = np.random.default_rng(0)
    with style.new_figure(_WIDTH_IN, _HEIGHT_IN) as figure:
        figure.set_layout_engine("none")
        axis = figure.add_axes((0.02, 0.12, 0.96, 0.84))
        for places, (_, colour) in zip(seen, clouds, strict=True):
            shown = places if len(places) <= _MOST_POINTS else rng.choice(places, _MOST_POINTS, replace=False)
            style.dots(axis, shown, min(9.0, 60 / max(1, len(shown)) ** 0.4), colour, alpha=0.75)
        centre = (low + high) / 2
        per_inch = float(np.max((high - low) / [0.92 * _WIDTH_IN, 0.78 * _HEIGHT_IN])) or 0.1
        half = per_inch * np.array([0.96 * _WIDTH_IN, 0.84 * _HEIGHT_IN]) / 2
        axis.set(xlim=(centre[0] - half[0], centre[0] + half[0]), ylim=(centre[1] - half[1], centre[1] + half[1]))
        axis.set_axis_off()
        bar_m = max((bar for bar in _SCALE_BARS_M if bar <= per_inch), default=_SCALE_BARS_M[0])
        share = bar_m / per_inch / _WIDTH_IN
        figure.add_artist(Line2D([0.03, 0.03 + share], [0.06, 0.06], color=GREY, linewidth=2))
        figure.text(0.05 + share, 0.06, f"{bar_m:g} m", va="center", fontsize=8, color=GREY)
        content = BytesIO()
        figure.savefig(content, format="png", dpi=_DPI, transparent=True)
    return content.getvalue()


def around(points: FloatArray, of: FloatArray) -> FloatArray:
    """Those of some points that lie in the box around an object, with a margin of 0.3 m."""
    low, high = of.min(axis=0) - _MARGIN_M, of.max(axis=0) + _MARGIN_M
    inside: FloatArray = points[np.all((points >= low) & (points <= high), axis=1)]
    return inside


def _screen_axes() -> FloatArray:
    """(2, 3) unit vectors to the right and upwards, of an eye that looks as the pictures in space do."""
    elevation, azimuth = np.radians([style.VIEW["elev"], style.VIEW["azim"]])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    up = np.array([-np.sin(elevation) * np.cos(azimuth), -np.sin(elevation) * np.sin(azimuth), np.cos(elevation)])
    return np.stack([right, up])
