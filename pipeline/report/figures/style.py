"""Style of the figures: sizes, colours, names that cannot break a drawing; and how figures are saved.

matplotlib is imported by its first use here, with a backend that needs no display.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from ....stages.arrays import FloatArray
from ...storage.files import write_whole
from ..look import GREY, RAMPS, clipped

#: Where points in space are seen from.
VIEW = {"elev": 20, "azim": -60}

#: Formats in which each figure is written, each with the metadata of its file.
KINDS: dict[str, dict[str, None]] = {"png": {}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}


@contextmanager
def new_figure(width_in: float, height_in: float, title: str = "", kind: Any = None) -> Iterator[Any]:
    """A figure in our style that needs no display; `kind` is its class, by default that of matplotlib."""
    from matplotlib import style
    from matplotlib.figure import Figure

    with style.context(f"{__package__}.look"):
        figure = (kind or Figure)(figsize=(width_in, height_in))
        if title:
            figure.suptitle(title)
        yield figure


def save(figure: Any, folder: Path, name: str) -> list[Path]:
    """Writes a figure as PNG, SVG and PDF; in the last two clouds of points are pictures; `RunError` if it cannot."""
    paths = []
    for kind, metadata in KINDS.items():
        content = BytesIO()
        figure.savefig(content, format=kind, metadata=metadata, bbox_inches="tight", pad_inches=0.08)
        figure.set_layout_engine("none")  # all is in its place now; finding it took half of the time
        paths.append(folder / f"{name}.{kind}")
        write_whole(paths[-1], content.getvalue())
    return paths


def fidelity_colours() -> Any:
    """Colours of r_lambda from 0 (dark blue) to 1 (orange)."""
    from matplotlib.colors import LinearSegmentedColormap

    return LinearSegmentedColormap.from_list("fidelity", RAMPS["light"])


def community_colours(n: int) -> Any:
    """(n, 3) colours in which neighbours in number differ; they repeat. No grey, which means no object."""
    from matplotlib import colormaps

    wheel = np.concatenate([colormaps[name](np.arange(20))[:, :3] for name in ("tab20", "tab20b")])
    wheel = wheel[np.ptp(wheel, axis=1) > 0.1]
    return wheel[np.arange(n) % len(wheel)]


def dots(axis: Any, points: FloatArray, size: float, colour: Any, **look: Any) -> Any:
    """Draws points, (n, 3) metres, from above or in space; in an SVG they are a picture."""
    places = points.T if axis.name == "3d" else points.T[:2]
    return axis.scatter(*places, s=size, c=colour, linewidths=0, rasterized=True, **look)


def frame_of(*clouds: FloatArray) -> FloatArray:
    """(2, 2) corners of the area shown from above: all but the farthest hundredth of the points, and the sensor."""
    low, high = np.quantile(np.concatenate(clouds)[:, :2], [0.005, 0.995], axis=0)
    low, high = np.minimum(low, 0), np.maximum(high, 0)
    margin = 0.04 * (high - low).max()
    return np.stack([low - margin, high + margin])


#: Points in one look: (n, 3) metres, size, colour or one value each, and more for `dots`.
Layer = tuple[FloatArray, float, Any, dict[str, Any]]


@contextmanager
def new_maps(
    frame: FloatArray, panels: Mapping[str, Sequence[Layer]], title: str, kind: Any = None, **bar: str
) -> Iterator[tuple[Any, Any]]:
    """A figure of maps side by side, and their axes: each panel has a title, and layers seen from above.

    Parameters
    ----------
    bar : of the colour bar of the last layer, such as its label
    """
    width, height = frame[1] - frame[0]
    panel_in = {2: 4.0, 3: 3.2}[len(panels)]
    figure_in = (panel_in * len(panels) + 1.4, float(np.clip(panel_in * height / width, 1.5, 6)) + 1.25)
    with new_figure(*figure_in, title, kind) as figure:
        axes = figure.subplots(1, len(panels), sharex=True, sharey=True)
        for axis, (words, layers) in zip(axes, panels.items(), strict=True):
            for points, size, colour, look in layers:
                drawn = dots(axis, points, size, colour, **look)
            axis.set_title(words)
            from_above(axis, frame)
        if bar:
            figure.colorbar(drawn, cax=axis.inset_axes((1.03, 0, 0.04, 1)), **bar)
        yield figure, axes


def from_above(axis: Any, frame: FloatArray) -> None:
    """Sets an axis to a frame in metres, with a cross at the sensor, and a legend if the dots have names."""
    axis.set(xlim=frame[:, 0], ylim=frame[:, 1])
    axis.set_aspect("equal")
    axis.plot(0, 0, marker="+", color="black", markersize=8, markeredgewidth=1.2)
    axis.set_xlabel("x, forward (m)")
    if axis.get_subplotspec().is_first_col():
        axis.set_ylabel("y, left (m)")
    if axis.get_legend_handles_labels()[0]:  # a fixed way under the axis, clear of its label
        legend = axis.legend(loc="upper center", bbox_to_anchor=(0.5, 0), borderaxespad=4.3, ncols=3, handletextpad=0.1)
        for handle in legend.legend_handles:
            handle.set(sizes=[22], alpha=1)


def box_of(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Lowest corner and size, (3,) each, of a box around all points, no side shorter than a third of the longest."""
    low, high = points.min(axis=0), points.max(axis=0)
    size = np.maximum(high - low, (high - low).max() / 3)
    return (low + high - size) / 2, size


def metres(axis: Any, size: FloatArray, zoom: float) -> None:
    """Sets an axis in space to a box that begins at 0, true to scale."""
    from matplotlib.ticker import MaxNLocator

    axis.set(xlim=(0, size[0]), ylim=(0, size[1]), zlim=(0, size[2]))
    axis.set_box_aspect(tuple(size), zoom=zoom)  # an array would be changed
    for name, pad, own, length in zip("xyz", (-4, -6, -4), (axis.xaxis, axis.yaxis, axis.zaxis), size, strict=True):
        own.set_major_locator(MaxNLocator(4 if length > 0.6 * size.max() else 2))
        own.set_tick_params(labelsize=6, pad=-2)
        getattr(axis, f"set_{name}label")(f"{name} (m)", fontsize=7, labelpad=pad)
        own.pane.set(facecolor="none", edgecolor=GREY)


def draw_band(axis: Any, x: FloatArray, mean: FloatArray, std: FloatArray, **look: Any) -> None:
    """A line of means with a band of one standard deviation to either side, not below 0; `look` is of the line."""
    axis.plot(x, mean, markersize=4, linewidth=1.2, **look)
    axis.fill_between(x, np.maximum(mean - std, 0), mean + std, color=look["color"], alpha=0.2, linewidth=0)


def mark_amounts(axis: Any, amounts: Iterable[float]) -> None:
    """Ticks at the amounts that were tried, and nowhere else."""
    axis.set_xticks(list(amounts), [f"{amount:g}" for amount in amounts])
    axis.minorticks_off()
    axis.grid(axis="y")


def shown_name(name: str, most: int = 28) -> str:
    r"""A name as a figure can show it: shortened, and with escapes in place of signs that the font does not have.

    Examples
    --------
    >>> shown_name("street 5"), shown_name("雪")
    ('street 5', '\\u96ea')
    """
    from matplotlib.font_manager import findfont, get_font

    known = get_font(findfont("DejaVu Sans")).get_charmap()
    text = "".join(
        sign if ord(sign) in known and sign.isprintable() else sign.encode("unicode_escape").decode() for sign in name
    )
    return clipped(text, most)
