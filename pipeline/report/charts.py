"""Every chart of the pages as a plotly figure: plain dictionaries that a page holds as JSON and plotly.js draws.

Colours that depend on the theme stand as properties of the style sheet, such as var(--ink); the page puts in what they
are. What the charts of one pair show is chosen on the page: they are made here without their points.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd
import plotly.graph_objects as go

from ..results.compare import ScoreChange
from .aggregates import SCORES, boxes, evenly, groups_by_size, histograms, quadrants, range_bands, stage_times
from .colours import FATE_COLOURS, QUADRANT_COLOURS, SCORE_COLOURS, SERIES, SIDE_COLOURS, of_theme, on_page
from .names import in_chart
from .quadrants import CDC_LIMIT, R_LAMBDA_LIMIT, UNKNOWN
from .results import RunResults

Chart = dict[str, Any]  #: data and layout

#: More dots than these would make a page slow; the texts beside the charts then say what part they show.
MOST_DOTS = 3000
MOST_SCANS, MOST_CLASSES = 16, 10
_MOST_CHANGES = 300

_INK, _SOFT, _LINE = map(of_theme, ("ink", "soft", "line"))
_CLEAR = "rgba(0,0,0,0)"
_AXIS = {
    "gridcolor": _LINE, "zerolinecolor": _LINE, "linecolor": _SOFT, "showline": True, "showgrid": True,
    "automargin": True,
}  # fmt: skip
_AXIS_3D = {"gridcolor": _LINE, "zerolinecolor": _LINE, "color": _SOFT, "showbackground": False, "showspikes": False}
_LEGEND = {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0}

#: The look that all charts of a page share.
TEMPLATE: Chart = go.layout.Template(
    layout={
        "paper_bgcolor": _CLEAR,
        "plot_bgcolor": _CLEAR,
        "font": {"color": _INK, "family": "system-ui, sans-serif", "size": 12},
        "modebar": {"bgcolor": _CLEAR, "color": _SOFT, "activecolor": _INK},
        "margin": {"l": 55, "r": 15, "t": 30, "b": 45},
        "hoverlabel": {"align": "left"},
        "legend": _LEGEND,
        "shapedefaults": {"line": {"color": _INK}},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "polar": {
            "bgcolor": _CLEAR,
            "radialaxis": {"gridcolor": _LINE, "linecolor": _SOFT},
            "angularaxis": {"gridcolor": _LINE, "linecolor": _SOFT},
        },
        "scene": {"aspectmode": "data", "dragmode": "orbit", **dict.fromkeys(("xaxis", "yaxis", "zaxis"), _AXIS_3D)},
    }
).to_plotly_json()


def run_charts(results: RunResults) -> dict[str, Chart]:
    """The charts of a whole run, by the id of their place in the page."""
    names = results.pairs.pair_id.tolist()
    scans = [names[i] for i in evenly(len(names), MOST_SCANS)]
    classes = groups_by_size(results)[:MOST_CLASSES]
    return {
        **{f"hist_{score}": _histogram(score, counted) for score, counted in histograms(results).items()},
        "quadrants": _quadrants(results),
        "box_scan": _boxes(boxes(results, "pair_id", scans)),
        "box_class": _boxes(boxes(results, "group", classes)),
        "polar": _polar(results.unmatched),
        "bands": _bands(range_bands(results)),
        "times": _times(stage_times(results)),
    }


def _histogram(score: str, counted: dict[str, Any]) -> Chart:
    edges = np.array(counted["edges"])
    median = counted["median"]
    title = f"{counted['name']}, {counted['n']:,} objects{'' if median is None else f', median {median:.2f}'}"
    figure = go.Figure(
        go.Bar(
            x=(edges[:-1] + edges[1:]) / 2,
            y=counted["counts"],
            width=edges[1] - edges[0],
            marker_color=on_page(SCORE_COLOURS[score]),
            hovertemplate="%{x:.2f}: %{y} objects<extra></extra>",
        )
    )
    if median is not None:
        figure.add_vline(median, line_dash="dash", line_width=1.5)
    figure.update_layout(title={"text": title, "font_size": 13}, margin_t=40)
    figure.update_xaxes(range=[0, counted["bound"]], title_text=f"{counted['name']} (no unit)")
    figure.update_yaxes(title_text="objects")
    return _plain(figure)


def _quadrants(results: RunResults) -> Chart:
    """r_lambda over CDC, one dot per object; evenly over the order from worst to best where they are too many."""
    scored = results.matched[results.matched.r_lambda.notna()]
    dots = scored.iloc[evenly(len(scored), MOST_DOTS)]
    figure = go.Figure()
    for key, counted in quadrants(results).items():
        if key == UNKNOWN:
            continue
        own = dots[dots.quadrant == key]
        figure.add_scatter(
            mode="markers",
            name=f"{counted['title']}: {counted['n']} ({100 * counted['share']:.0f} %)",
            x=own.cdc.to_numpy(np.float32),
            y=own.r_lambda.to_numpy(np.float32),
            customdata=_objects(own.pair, "real", own.real_id),
            text=_titles(own.pair_id, "object", own.real_id),
            hovertemplate="%{text}<br>CDC %{x:.3f}<br>r_lambda %{y:.3f}<extra></extra>",
            marker={"color": on_page(QUADRANT_COLOURS[key]), "size": 6, "opacity": 0.8},
            cliponaxis=False,
        )
    figure.add_vline(CDC_LIMIT, line_width=1)
    figure.add_hline(R_LAMBDA_LIMIT, line_width=1)
    figure.update_xaxes(range=[0, 2.02], title_text="geometry: CDC (no unit)")
    figure.update_yaxes(range=[0, 1.02], title_text="structure: r_lambda (no unit)")
    figure.update_layout(margin_t=40, legend_font_size=11)
    return _plain(figure)


def _boxes(groups: Sequence[dict[str, Any]]) -> Chart:
    """Both scores of each group side by side; names can be alike when shortened, so that boxes stand at numbers."""
    figure = go.Figure()
    for offset, (score, (name, _)) in zip((-0.2, 0.2), SCORES.items(), strict=True):
        known = [(i + offset, group[score]) for i, group in enumerate(groups) if group[score]]
        colour = on_page(SCORE_COLOURS[score])
        numbers = {key: [box[key] for _, box in known] for key in ("q1", "median", "q3", "low", "high")}
        figure.add_box(
            name=name,
            x=[x for x, _ in known],
            width=0.34,
            lowerfence=numbers.pop("low"),
            upperfence=numbers.pop("high"),
            **numbers,
            marker_color=colour,
            line_width=1.2,
            hoverinfo="y",
        )
        figure.add_scatter(
            mode="markers",
            showlegend=False,
            x=[x for x, box in known for _ in box["outside"]],
            y=[value for _, box in known for value in box["outside"]],
            marker={"color": colour, "size": 3},
            hovertemplate="%{y:.3f}<extra></extra>",
        )
    ticks = [f"{in_chart(group['name'], 14)} ({group['n']})" for group in groups]
    figure.update_xaxes(
        tickvals=list(range(len(groups))), ticktext=ticks, range=[-0.6, len(groups) - 0.4], showgrid=False
    )
    figure.update_yaxes(range=[0, 2.05], title_text="score of an object")
    figure.update_layout(boxmode="overlay")
    return _plain(figure)


def _polar(unmatched: pd.DataFrame) -> Chart:
    """Unmatched objects around the sensor, seen from above, the largest first where they are too many."""
    figure = go.Figure()
    shown = unmatched.head(MOST_DOTS)
    for fate, side, symbol in (("missing", "real", "circle-open"), ("hallucinated", "sim", "x-thin")):
        own = shown[shown.status == fate]
        colour = on_page(FATE_COLOURS[fate])
        figure.add_scatterpolar(
            mode="markers",
            name=f"{fate} ({(unmatched.status == fate).sum():,})",
            r=own.range_m.to_numpy(np.float32),
            theta=own.bearing_deg.to_numpy(np.float32),
            customdata=_objects(own.pair, side, own.community_id),
            text=_titles(own.pair_id, f"{fate} object", own.community_id),
            hovertemplate="%{text}<br>%{r:.1f} m, %{theta:.0f}°<extra></extra>",
            marker={"color": colour, "size": 6, "symbol": symbol, "line": {"width": 1.5, "color": colour}},
        )
    ticks = {0: "ahead", 90: "left", 180: "behind", 270: "right"}
    degrees = list(range(0, 360, 45))
    figure.update_polars(
        radialaxis={"ticksuffix": " m", "angle": 45, "tickangle": 45, "nticks": 5},
        angularaxis={"rotation": 90, "tickvals": degrees, "ticktext": [ticks.get(degree, "") for degree in degrees]},
    )
    figure.update_layout(margin={"l": 45, "r": 45, "t": 65, "b": 30}, legend_y=1.1)
    return _plain(figure)


def _bands(bands: Sequence[dict[str, Any]]) -> Chart:
    figure = go.Figure()
    for fate, shape, others, side in (
        ("matched", "", "missing", "real"),
        ("missing", "/", "missing", "real"),
        ("hallucinated", "x", "hallucinated", "simulated"),
    ):
        shares = [100 * band[fate] / max(1, band["matched"] + band[others]) for band in bands]
        figure.add_bar(
            name=fate,
            x=[band["name"] for band in bands],
            y=[band[fate] for band in bands],
            marker={"color": on_page(FATE_COLOURS[fate]), "pattern": {"shape": shape, "solidity": 0.25}},
            hovertext=[f"{band[fate]} {fate}, {share:.0f} %" for band, share in zip(bands, shares, strict=True)],
            hovertemplate=f"%{{hovertext}} of the {side} objects<extra></extra>",
        )
    figure.update_layout(barmode="group", yaxis_title_text="objects")
    figure.update_xaxes(type="category", showgrid=False)
    return _plain(figure)


def _times(times: Sequence[dict[str, Any]]) -> Chart:
    figure = go.Figure()
    for i, step in enumerate(dict.fromkeys(row["step"] for row in times)):
        own = [row for row in times if row["step"] == step]
        figure.add_bar(
            orientation="h",
            name=step,
            x=[row["seconds"] for row in own],
            y=[row["stage"] for row in own],
            marker={"color": SERIES[i % len(SERIES)], "pattern": {"shape": "/" if i >= len(SERIES) else ""}},
            hovertemplate=f"%{{y}}, {in_chart(step)}: %{{x:.3f}} s<extra></extra>",
        )
    stages = list(dict.fromkeys(row["stage"] for row in times))
    figure.update_layout(barmode="stack", showlegend=False, xaxis_title_text="seconds per pair")
    figure.update_yaxes(categoryorder="array", categoryarray=stages[::-1])
    return _plain(figure)


def outlines() -> dict[str, Chart]:
    """The charts of one pair and of one object, without points: the page puts these in as pairs are chosen."""
    dots = [_dots(side, on_page(colour), 1.8) for side, colour in SIDE_COLOURS.items()]
    pair = go.Figure([*dots, _dots("chosen", _INK, 3.6, opacity=0.9, hoverinfo="skip")])
    place = "%{x:.2f}, %{y:.2f}, %{z:.2f} m<extra></extra>"
    charts = {"scene": _in_space(pair)}
    for side, colour in SIDE_COLOURS.items():
        left_out = _dots("left out", _SOFT, 3, symbol="cross", hovertemplate=place)
        kept = _dots("kept", on_page(colour), 2.4, hovertemplate=f"kept: {place}")
        charts[f"object_{side}"] = _in_space(go.Figure([left_out, kept]))
    spectrum = go.Figure()
    for side, name, dash in (("real", "real", "solid"), ("sim", "simulated", "dash")):
        line = {"color": on_page(SIDE_COLOURS[side]), "width": 2, "dash": dash}
        spectrum.add_scatter(
            mode="lines", name=name, line=line, hovertemplate="eigenvalue %{x}: %{y:.4f}<extra></extra>"
        )
    marker = {"size": 7, "color": _INK}
    spectrum.add_scatter(mode="lines+markers", line={"color": _INK, "width": 3}, marker=marker)
    spectrum.update_xaxes(title_text="number of the eigenvalue, in ascending order")
    spectrum.update_yaxes(title_text="eigenvalue (0 to 2)")
    return {**charts, "spectrum": _plain(spectrum)}


def change_chart(scores: Iterable[ScoreChange]) -> Chart:
    """One strip per score of a comparison: its change in each pair, their mean, and the mean's interval.

    Zero is in the middle; each strip has its own scale, which is written at its end.
    """
    figure = go.Figure()
    strips = list(scores)
    for i, score in enumerate(strips):
        known = [(name, value) for name, value in score.of_pairs.items() if value is not None]
        change = score.difference
        ends = (change.low or 0.0, change.high or 0.0)
        reach = max((abs(value) for value in (*(value for _, value in known), *ends)), default=0.0) or 1.0
        colour = of_theme(score.verdict) if score.verdict in ("better", "worse") else _SOFT
        dots = known[:: -(-len(known) // _MOST_CHANGES) or 1]
        figure.add_scatter(
            mode="markers",
            x=[value / reach for _, value in dots],
            y=[i] * len(dots),
            text=[f"pair {in_chart(name)}: {value:+.3f}" for name, value in dots],
            hovertemplate="%{text}<extra></extra>",
            marker={"color": colour, "size": 7, "opacity": 0.35, "line_width": 0},
        )
        if change.difference is not None and change.low is not None and change.high is not None:
            figure.add_scatter(
                mode="markers",
                x=[change.difference / reach],
                y=[i],
                error_x={
                    "array": [(change.high - change.difference) / reach],
                    "arrayminus": [(change.difference - change.low) / reach],
                    **{"symmetric": False, "color": colour, "thickness": 3, "width": 0},
                },
                hoverinfo="skip",
                marker={"symbol": "line-ns", "size": 16, "line": {"width": 3, "color": colour}},
            )
        figure.add_annotation(x=1.03, xref="paper", xanchor="left", y=i, text=f"±{reach:.2g}", showarrow=False)
    figure.add_vline(0, line={"color": _SOFT, "width": 1})
    figure.update_xaxes(range=[-1.05, 1.05], visible=False, fixedrange=True)
    names = [score.name for score in strips]
    figure.update_yaxes(
        tickvals=list(range(len(strips))), ticktext=names, range=[len(strips) - 0.5, -0.5], showgrid=False,
        showline=False, zeroline=False, fixedrange=True,
    )  # fmt: skip
    figure.update_layout(showlegend=False, height=34 * len(strips) + 24, margin={"l": 10, "r": 75, "t": 12, "b": 12})
    return _plain(figure)


def _dots(name: str, colour: str, size: float, *, symbol: str = "circle", opacity: float = 1, **more: Any) -> Any:
    """Points in space that have no places yet."""
    marker = {"color": colour, "size": size, "symbol": symbol, "opacity": opacity, "line_width": 0}
    return go.Scatter3d(mode="markers", name=name, marker=marker, **more)


def _in_space(figure: Any) -> Chart:
    titles = {"x": "x forward (m)", "y": "y left (m)", "z": "z up (m)"}
    figure.update_scenes({f"{axis}axis": {"title_text": title} for axis, title in titles.items()})
    figure.update_layout(margin={"l": 0, "r": 0, "t": 0, "b": 0}, showlegend=False)
    return _plain(figure)


def _objects(pairs: pd.Series[Any], side: str, ids: pd.Series[Any]) -> list[list[Any]]:
    """What a click on a dot opens: the place of its pair among the run's pairs, and the object's name."""
    return [[int(pair), f"{side} {i}"] for pair, i in zip(pairs, ids, strict=True)]


def _titles(pair_ids: pd.Series[Any], what: str, ids: pd.Series[Any]) -> list[str]:
    return [f"pair {in_chart(pair_id)}, {what} {i}" for pair_id, i in zip(pair_ids, ids, strict=True)]


def _plain(figure: Any) -> Chart:
    """A figure as JSON has it, without plotly's own template; arrays of numbers are in base64."""
    chart: Chart = json.loads(figure.to_json())
    del chart["layout"]["template"]
    return chart
