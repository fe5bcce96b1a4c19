"""Charts of a run: plain dictionaries of data and layout, which plotly.js draws.

Colours that depend on the theme are properties of the style sheet, such as var(--ink), which the
page replaces by their values. The charts of one pair are drawn by the page.
"""

from __future__ import annotations

from typing import Any

from .look import OUTCOME_COLOURS, OUTCOME_WORDS, of_theme, on_page
from .run_frames import RunResults

Chart = dict[str, Any]  #: data and layout

_INK = of_theme("ink")
_SOFT = of_theme("soft")
_LINE = of_theme("line")
_CLEAR = "rgba(0,0,0,0)"
_GRID = {"gridcolor": _LINE, "zerolinecolor": _LINE}
_AXIS = {**_GRID, "linecolor": _SOFT, "showline": True, "showgrid": True, "automargin": True}
_AXIS_3D = {**_GRID, "color": _SOFT, "showbackground": False, "showspikes": False}

#: The look that all charts of a page share.
TEMPLATE: Chart = {
    "layout": {
        "paper_bgcolor": _CLEAR,
        "plot_bgcolor": _CLEAR,
        "font": {"color": _INK, "family": "system-ui, sans-serif", "size": 12},
        "modebar": {"bgcolor": _CLEAR, "color": _SOFT, "activecolor": _INK},
        "margin": {"l": 55, "r": 15, "t": 40, "b": 45},
        "hoverlabel": {"align": "left"},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "shapedefaults": {"line": {"color": _INK}},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "scene": {
            "aspectmode": "data",
            "dragmode": "orbit",
            **dict.fromkeys(("xaxis", "yaxis", "zaxis"), _AXIS_3D),
        },
    }
}


def rays_chart(results: RunResults) -> Chart | None:
    """Shares of the outcomes of rays by range, stacked, over the scored pairs; None without rays.

    Ranges are in the order of their names and so from near to far.
    """
    names = results.pairs.pair_id.tolist()
    rows = results.run.table("ray_scores", names).to_pandas().query("by == 'range'")
    n_rays = rows.n_rays.groupby(rows.band).sum()
    if n_rays.empty:
        return None
    data = []
    for name, colour in OUTCOME_COLOURS.items():
        words = OUTCOME_WORDS[name]
        counts = (rows[f"rays_{name}"] * rows.n_rays).groupby(rows.band).sum()
        data.append(
            {
                "type": "bar",
                "name": words,
                "x": n_rays.index.tolist(),
                "y": (100 * counts / n_rays).tolist(),
                "customdata": n_rays.tolist(),
                "marker": {"color": on_page(colour)},
                "hovertemplate": f"%{{y:.1f}} % {words} of %{{customdata:,}} rays<extra></extra>",
            }
        )
    layout = {
        "barmode": "stack",
        "margin": {"t": 60},
        "xaxis": {"type": "category", "showgrid": False},
        "yaxis": {"title": {"text": "share of the rays (%)"}},
    }
    return {"data": data, "layout": layout}
