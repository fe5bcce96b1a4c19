"""Style of the figures: sizes, colours, names that cannot break a drawing; saving figures."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib.style
import numpy as np
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure

from ....stages.arrays import FloatArray
from ...storage.files import write_whole
from ...terminal import shown
from ..look import RAMPS, clipped

#: Where points in space are seen from.
VIEW = {"elev": 20, "azim": -60}
#: Colours of r_lambda from 0 (dark blue) to 1 (orange).
FIDELITY_COLOURS = LinearSegmentedColormap.from_list("fidelity", RAMPS["light"])


class ShownFigure(Figure):
    """A figure that notebooks show without pyplot, which would keep it."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", bbox_inches="tight", dpi=110)
        return content.getvalue()


def in_our_style() -> Any:
    """A context in which matplotlib draws and saves in our style."""
    return matplotlib.style.context(f"{__package__}.look")


def save(figure: Figure, path: Path) -> None:
    """Write a figure in the format of the file's suffix."""
    content = BytesIO()
    with in_our_style():
        figure.savefig(content, format=path.suffix.removeprefix("."), bbox_inches="tight")
    write_whole(path, content.getvalue())


@contextmanager
def new_figure(width_in: float, height_in: float, title: str = "") -> Iterator[ShownFigure]:
    """A figure in our style that needs no display, and that notebooks show."""
    with in_our_style():
        figure = ShownFigure(figsize=(width_in, height_in))
        if title:
            figure.suptitle(title)
        yield figure


@contextmanager
def axes_for(ax: Any, width_in: float, height_in: float, **look: Any) -> Iterator[Any]:
    """The given axes, or those of a new figure, to be drawn into in our style.

    look : of the new axes, such as their projection
    """
    if ax is None:
        with new_figure(width_in, height_in) as figure:
            yield figure.add_subplot(**look)
    else:
        with in_our_style():
            yield ax


def dots(axis: Any, points: FloatArray, size: float, colour: Any, **look: Any) -> Any:
    """Draw points, (n, 3) metres, from above or in space; in an SVG they are a picture."""
    places = points.T if axis.name == "3d" else points.T[:2]
    return axis.scatter(*places, s=size, c=colour, linewidths=0, rasterized=True, **look)


def frame_of(*clouds: FloatArray) -> FloatArray:
    """(2, 2) corners of the area shown from above.

    It holds all but the farthest hundredth of the points, and the sensor.
    """
    places = np.concatenate(clouds)[:, :2]
    low, high = np.quantile(places, [0.005, 0.995], axis=0)
    low = np.minimum(low, 0)
    high = np.maximum(high, 0)
    margin = 0.04 * (high - low).max()
    return np.stack([low - margin, high + margin])


def colour_bar(axis: Any, dots: Any, label: str) -> None:
    """Draw the colours of some dots to the right of a map."""
    place = axis.inset_axes((1.03, 0, 0.04, 1))
    axis.figure.colorbar(dots, cax=place, label=label)


def from_above(axis: Any, frame: FloatArray) -> None:
    """Set an axis to a frame in metres: a cross at the sensor, a legend if dots have names."""
    axis.set(xlim=frame[:, 0], ylim=frame[:, 1])
    axis.set_aspect("equal")
    axis.plot(0, 0, marker="+", color="black", markersize=8, markeredgewidth=1.2)
    axis.set_xlabel("x, forward (m)")
    axis.set_ylabel("y, left (m)")
    if axis.get_legend_handles_labels()[0]:  # a fixed way under the axis, clear of its label
        below = {"loc": "upper center", "bbox_to_anchor": (0.5, 0), "borderaxespad": 4.3}
        axis.legend(ncols=3, markerscale=4, **below)


def shown_name(name: str, most: int = 28) -> str:
    r"""A name as a figure can show it: shortened, characters beyond Latin-1 as escapes.

    Examples
    --------
    >>> shown_name("street 5"), shown_name("雪")
    ('street 5', '\\u96ea')
    """
    text = shown(name).encode("latin-1", "backslashreplace").decode("latin-1")
    return clipped(text, most)
