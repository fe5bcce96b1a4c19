"""Charts of a run: plain dictionaries of data and layout, which plotly.js draws.

Colours that depend on the theme are properties of the style sheet, such as var(--ink), which the
page replaces by their values. The charts of one pair are drawn by the page.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import orjson
import pandas as pd

from ...schemas.results import Evidence
from ...stages.statistics.findings import evenly
from ..results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from .look import (
    BLUE,
    OUTCOME_COLOURS,
    OUTCOME_WORDS,
    QUADRANT_COLOURS,
    VERMILION,
    in_chart,
    of_theme,
    on_page,
)
from .run_frames import RunResults, axis_title, quadrants

Chart = dict[str, Any]  #: data and layout

#: More dots would make a page slow; the text next to the chart then names the part that is shown.
MOST_DOTS = 3000

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


def run_charts(results: RunResults) -> dict[str, Chart]:
    """The charts of a whole run, by the id of their place in the page."""
    charts = {"quadrants": _quadrants(results)}
    outcomes = ray_outcomes(results)
    if len(outcomes):
        charts["rays_range"] = _rays(outcomes)
    return charts


def ray_outcomes(results: RunResults) -> pd.DataFrame:
    """Shares of the outcomes of rays by range, over the scored pairs.

    Rows are ranges, by name and so near to far; columns the outcomes, and `n_rays`.
    """
    names = results.pairs.pair_id.tolist()
    rows = results.run.table("ray_scores", names).to_pandas().query("by == 'range'")
    columns = {f"rays_{name}": name for name in OUTCOME_COLOURS}
    counts = rows[[*columns]].mul(rows.n_rays, axis=0).rename(columns=columns)
    total = counts.assign(n_rays=rows.n_rays).groupby(rows.band).sum()
    return total.div(total.n_rays, axis=0).assign(n_rays=total.n_rays)


def _quadrants(results: RunResults) -> Chart:
    """r_lambda over CDC, one dot per object.

    Of too many objects those evenly over the order from worst to best.
    """
    scored = results.matched[results.matched.r_lambda.notna()]
    dots = scored.iloc[evenly(len(scored), MOST_DOTS)]
    counted = quadrants(results)
    data = []
    for key in QUADRANTS:
        rows = dots[dots.quadrant == key]
        titles = []
        for row in rows.itertuples():
            titles.append(f"pair {in_chart(str(row.pair_id))}, object {row.real_id}")
        data.append(
            {
                "mode": "markers",
                "name": f"{key}: {counted[key]['n']} ({100 * counted[key]['share']:.0f} %)",
                "x": rows.cdc.to_numpy(np.float32),
                "y": rows.r_lambda.to_numpy(np.float32),
                "customdata": rows[["pair", "name"]].to_numpy().tolist(),
                "text": titles,
                "hovertemplate": "%{text}<br>CDC %{x:.3f}<br>r_lambda %{y:.3f}<extra></extra>",
                "marker": {"color": QUADRANT_COLOURS[key], "size": 6, "opacity": 0.8},
                "cliponaxis": False,
            }
        )
    limits = []
    for x, y in (((CDC_LIMIT, CDC_LIMIT), (0, 1)), ((0, 2), (R_LAMBDA_LIMIT, R_LAMBDA_LIMIT))):
        ends = {"x0": x[0], "x1": x[1], "y0": y[0], "y1": y[1]}
        limits.append({"type": "line", "line": {"width": 1}, **ends})
    layout = {
        "xaxis": {"range": [0, 2.02], "title": {"text": axis_title("cdc")}},
        "yaxis": {"range": [0, 1.02], "title": {"text": axis_title("r_lambda")}},
        "shapes": limits,
        "legend": {"font": {"size": 11}},
    }
    return _chart(data, layout)


def _rays(outcomes: pd.DataFrame) -> Chart:
    """Shares of the outcomes of rays by range, stacked."""
    data = []
    for name, colour in OUTCOME_COLOURS.items():
        words = OUTCOME_WORDS[name]
        data.append(
            {
                "type": "bar",
                "name": words,
                "x": outcomes.index.tolist(),
                "y": 100 * outcomes[name].to_numpy(),
                "customdata": outcomes.n_rays.to_numpy(),
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
    return _chart(data, layout)


def evidence_chart(evidence: Evidence) -> Chart:
    """Curves of the evidence of a cause where they are not all 0."""
    curves = {
        "real": (evidence.real, BLUE, "solid"),
        "simulated": (evidence.sim, VERMILION, "solid"),
        "corrected": (evidence.corrected, VERMILION, "dot"),
    }
    known = [np.array(values) for values, _, _ in curves.values() if values]
    places = np.flatnonzero(np.max(known, axis=0))
    part = slice(None)
    if len(places):
        part = slice(max(0, places[0] - 1), places[-1] + 2)
    data = []
    for name, (values, colour, dash) in curves.items():
        if values:
            line = {"color": on_page(colour), "dash": dash}
            data.append({"name": name, "x": evidence.x[part], "y": values[part], "line": line})
    small = {"size": 9}
    layout = {
        "xaxis": {"nticks": 6},
        "yaxis": {"nticks": 4, "title": {"text": evidence.y_label, "font": small}},
        "showlegend": False,
        "margin": {"l": 36, "r": 8, "t": 8, "b": 18},
        "font": small,
    }
    return _chart(data, layout)


def _chart(data: Sequence[Mapping[str, Any]], layout: Chart) -> Chart:
    """Traces (lines by default) and their layout as JSON: arrays as lists, NaN as null."""
    traces = [{"type": "scatter", "mode": "lines", **trace} for trace in data]
    content = {"data": traces, "layout": layout}
    text = orjson.dumps(content, np.ndarray.tolist, orjson.OPT_SERIALIZE_NUMPY)
    chart: Chart = orjson.loads(text)
    return chart
