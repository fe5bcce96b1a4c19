"""The class of all figures; it is apart because matplotlib loads at its first use."""

from __future__ import annotations

from io import BytesIO

from matplotlib.figure import Figure


class ShownFigure(Figure):
    """A figure that notebooks show without pyplot, which would keep it."""

    def _repr_png_(self) -> bytes:
        content = BytesIO()
        self.savefig(content, format="png", bbox_inches="tight", dpi=110)
        return content.getvalue()
