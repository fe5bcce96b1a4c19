"""How the figures look: sizes, colours of many, names that cannot break a drawing; and how they are saved.

matplotlib is imported by its first use here, with a backend that needs no display.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import BytesIO
from pathlib import Path
from typing import Any

from ...storage.files import write_whole
from ..colours import RAMPS

_STYLE = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.labelsize": 9,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.6,
    "axes.axisbelow": True,
    "grid.linewidth": 0.4,
    "grid.color": "#dddddd",
    "legend.frameon": False,
    "savefig.dpi": 200,
    "svg.fonttype": "none",
    "svg.hashsalt": "fidpipe",
    "text.parse_math": False,
}


#: Formats in which each figure is written, each with what its file says of itself.
KINDS: dict[str, dict[str, None]] = {"png": {}, "svg": {"Date": None}}


@contextmanager
def new_figure(width_in: float, height_in: float, **layout: Any) -> Iterator[Any]:
    """A figure in our style that needs no display and is let go of at the end."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with rc_context(_STYLE):
        figure = Figure(figsize=(width_in, height_in), layout="constrained", **layout)
        FigureCanvasAgg(figure)
        yield figure


def save(figure: Any, folder: Path, name: str) -> list[Path]:
    """Writes a figure as PNG and as SVG, in which clouds of points are pictures; `RunError` if it cannot."""
    paths = []
    for kind, metadata in KINDS.items():
        content = BytesIO()
        figure.savefig(content, format=kind, metadata=metadata)
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
    import numpy as np
    from matplotlib import colormaps

    wheel = np.concatenate([colormaps[name](np.arange(20))[:, :3] for name in ("tab20", "tab20b")])
    wheel = wheel[np.ptp(wheel, axis=1) > 0.1]
    return wheel[np.arange(n) % len(wheel)]


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
    return text if len(text) <= most else f"{text[: most - 1]}…"
