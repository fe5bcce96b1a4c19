"""The charts of many objects: plain dictionaries of data and layout that a page holds as JSON and plotly.js draws.

Each chart of a run has a sentence with its main numbers, for those who do not see it.

Colours that depend on the theme are properties of the style sheet, such as var(--ink), which the page replaces by their
values. The charts of one pair are drawn by the page.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import orjson
import pandas as pd

from ...schemas.metric_catalogue import METRIC
from ...schemas.results import Evidence
from ...stages.statistics.findings import evenly
from ..results.families import ScoreChange
from ..results.object_frame import CDC_LIMIT, QUADRANTS, R_LAMBDA_LIMIT
from ..terminal import shown
from .look import (
    BLUE,
    FATE_COLOURS,
    GREY,
    OUTCOME_COLOURS,
    OUTCOME_WORDS,
    QUADRANT_COLOURS,
    SCORE_COLOURS,
    VERMILION,
    in_chart,
    of_theme,
    on_page,
)
from .run_frames import FEWEST_IN_BOX, SCORES, RunResults, axis_title, quadrants

Chart = dict[str, Any]  #: data and layout
CaptionedChart = tuple[Chart, str]  #: a chart, and a sentence with its main numbers

#: More dots than these would make a page slow; the texts next to the charts then name the part that they show.
MOST_DOTS = 3000
MOST_CLASSES, _MOST_CHANGES = 10, 300
_RANGE_BIN_M, _MOST_RANGE_BINS = 10.0, 12
_QUARTILES = {"q1": 0.25, "median": 0.5, "q3": 0.75}

_INK, _SOFT, _LINE = map(of_theme, ("ink", "soft", "line"))
_CLEAR = "rgba(0,0,0,0)"
_GRID = {"gridcolor": _LINE, "zerolinecolor": _LINE}
_AXIS = {**_GRID, "linecolor": _SOFT, "showline": True, "showgrid": True, "automargin": True}
_AXIS_3D = {**_GRID, "color": _SOFT, "showbackground": False, "showspikes": False}
_ROUND_AXIS = {"gridcolor": _LINE, "linecolor": _SOFT}
#: Axes and margins of a strip of dots that cannot be zoomed.
_FIXED = {"showgrid": False, "fixedrange": True}

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
        "polar": {"bgcolor": _CLEAR, "radialaxis": _ROUND_AXIS, "angularaxis": _ROUND_AXIS},
        "scene": {"aspectmode": "data", "dragmode": "orbit", **dict.fromkeys(("xaxis", "yaxis", "zaxis"), _AXIS_3D)},
    }
}


def run_charts(results: RunResults) -> dict[str, CaptionedChart]:
    """The charts of a whole run with their sentences, by the id of their place in the page."""
    matched = results.matched
    ranges, range_of = range_bins(matched)
    classes = matched.group.value_counts().index[:MOST_CLASSES].tolist()
    return {
        "quadrants": _quadrants(results),
        "scores_range": _spread("distance", score_spread(matched, range_of, ranges)),
        "scores_class": _spread(results.class_is, score_spread(matched, matched.group, classes)),
        "sequence": _sequence(*along_the_sequence(results, results.run.record.times_s)),
        "polar": _polar(results.unmatched),
        **({"rays_range": _rays(rays)} if len(rays := ray_outcomes(results)) else {}),
    }


def ray_outcomes(results: RunResults) -> pd.DataFrame:
    """Shares of the outcomes of rays (columns) by range (rows, near to far), and `n_rays`, over the scored pairs."""
    outcomes = {f"rays_{name}": name for name in OUTCOME_COLOURS}
    part = {("ray_scores", ""): ["by", "band", "n_rays", *outcomes]}
    table, _ = results.run.store.read_pairs(results.pairs.pair_id.tolist(), part)["ray_scores", ""]
    rows = table.to_pandas().query("by == 'range'").set_index("band").rename(columns=outcomes)
    rows[[*OUTCOME_COLOURS]] = rows[[*OUTCOME_COLOURS]].mul(rows.n_rays, axis=0)
    total: pd.DataFrame = rows.drop(columns="by").groupby(level=0, sort=False).sum()
    total = total.loc[sorted(total.index, key=lambda band: float(band.removeprefix("over ").split()[0]))]
    total[[*OUTCOME_COLOURS]] = total[[*OUTCOME_COLOURS]].div(total.n_rays, axis=0)
    return total


def range_bins(objects: pd.DataFrame) -> tuple[list[str], pd.Series]:
    """Names of bins of the distance from the sensor, and the bin of each object.

    Bins of 10 m from 0 to the farthest object; of 20, 30 ... m where those were more than twelve.
    """
    farthest_m = float(objects.range_m.max()) if len(objects) else 0.0
    width = _RANGE_BIN_M * max(1, math.ceil(farthest_m / (_RANGE_BIN_M * _MOST_RANGE_BINS)))
    lows = [width * i for i in range(math.floor(farthest_m / width) + 1)]
    names = [f"{low:g} to {low + width:g} m" for low in lows]
    return names, (objects.range_m // width).astype(int).map(dict(enumerate(names)))


def score_spread(matched: pd.DataFrame, group: pd.Series, names: list[str]) -> dict[str, pd.DataFrame]:
    """By score, for each named group of objects: how many have the score (n), and its q1, median and q3.

    Fewer than three have no quartiles (NaN), none have no median.
    """
    by_score = {}
    for score in SCORES:
        values = matched[score].astype(float).groupby(group)
        rows = pd.DataFrame({"n": values.count()} | {q: values.quantile(at) for q, at in _QUARTILES.items()})
        rows = rows.reindex(names)
        rows["n"] = rows.n.fillna(0).astype(int)
        rows.loc[rows.n < FEWEST_IN_BOX, ["q1", "q3"]] = np.nan
        by_score[score] = rows
    return by_score


def along_the_sequence(results: RunResults, times_s: Mapping[str, float]) -> tuple[bool, pd.DataFrame]:
    """The scored pairs by the time of their real scans if known of each (then True), else by name.

    Their `place` is the number of seconds since the first one, or their number from 1.
    """
    rows = results.pairs.assign(time_s=results.pairs.pair_id.map(times_s).astype(float))
    has_times = bool(rows.time_s.notna().all())
    rows = rows.sort_values(["time_s", "pair_id"] if has_times else "pair_id", ignore_index=True)
    return has_times, rows.assign(place=rows.time_s - rows.time_s[0] if has_times else np.arange(1.0, len(rows) + 1))


def _quadrants(results: RunResults) -> CaptionedChart:
    """r_lambda over CDC, one dot per object, evenly over the order from worst to best where too many; histograms."""
    scored = results.matched[results.matched.r_lambda.notna()]
    dots = scored.iloc[evenly(len(scored), MOST_DOTS)]
    counted = quadrants(results)
    data: list[Chart] = [
        {"x": dots.cdc.to_numpy(np.float32), "yaxis": "y2", "xbins": {"start": 0, "end": 2, "size": 0.08}},
        {"y": dots.r_lambda.to_numpy(np.float32), "xaxis": "x2", "ybins": {"start": 0, "end": 1, "size": 0.04}},
    ]
    histogram = {"type": "histogram", "marker": {"color": GREY}, "showlegend": False, "hoverinfo": "skip"}
    data = [histogram | values for values in data]
    for key in QUADRANTS:
        own = dots[dots.quadrant == key]
        data.append(
            {
                "mode": "markers",
                "name": f"{key}: {counted[key]['n']} ({100 * counted[key]['share']:.0f} %)",
                "x": own.cdc.to_numpy(np.float32),
                "y": own.r_lambda.to_numpy(np.float32),
                **_opening(own, "object", own.real_id),
                "hovertemplate": "%{text}<br>CDC %{x:.3f}<br>r_lambda %{y:.3f}<extra></extra>",
                "marker": {"color": on_page(QUADRANT_COLOURS[key]), "size": 6, "opacity": 0.8},
                "cliponaxis": False,
            }
        )
    layout = {
        "xaxis": {"range": [0, 2.02], "domain": [0, 0.84], "title": {"text": axis_title("cdc")}},
        "yaxis": {"range": [0, 1.02], "domain": [0, 0.84], "title": {"text": axis_title("r_lambda")}},
        **{axis: {"domain": [0.86, 1], "visible": False} for axis in ("xaxis2", "yaxis2")},
        "bargap": 0.1,
        "shapes": [_line(x=CDC_LIMIT, width=1), _line(y=R_LAMBDA_LIMIT, width=1)],
        "legend": {"font": {"size": 11}},
    }
    counts = _listed(f"{title} {counted[key]['n']:,}" for key, title in QUADRANTS.items())
    medians = _both({score: results.matched[score].median() for score in SCORES})
    return _chart(data, layout), f"r_lambda over CDC of each object: {counts} Medians: {medians}."


def _polar(unmatched: pd.DataFrame) -> CaptionedChart:
    """Unmatched objects around the sensor, seen from above, the largest first where they are too many."""
    drawn, data = unmatched.head(MOST_DOTS), []
    for fate, symbol in (("missing", "circle-open"), ("hallucinated", "x-thin")):
        own, colour = drawn[drawn.status == fate], on_page(FATE_COLOURS[fate])
        data.append(
            {
                "type": "scatterpolar",
                "mode": "markers",
                "name": f"{fate} ({(unmatched.status == fate).sum():,})",
                "r": own.range_m.to_numpy(np.float32),
                "theta": own.bearing_deg.to_numpy(np.float32),
                **_opening(own, f"{fate} object", own.community_id),
                "hovertemplate": "%{text}<br>%{r:.1f} m, %{theta:.0f}°<extra></extra>",
                "marker": {"color": colour, "size": 6, "symbol": symbol, "line": {"width": 1.5, "color": colour}},
            }
        )
    ticks = ["ahead", "", "left", "", "behind", "", "right", ""]
    layout = {
        "polar": {
            "radialaxis": {"ticksuffix": " m", "angle": 45, "tickangle": 45, "nticks": 5},
            "angularaxis": {"rotation": 90, "tickvals": list(range(0, 360, 45)), "ticktext": ticks},
        },
        "margin": {"l": 45, "r": 45, "t": 65, "b": 30},
        "legend": {"y": 1.1},
    }
    missing, invented = ((unmatched.status == fate).sum() for fate in ("missing", "hallucinated"))
    median = f", median distance {unmatched.range_m.median():.0f} m" if len(unmatched) else ""
    return _chart(data, layout), (
        f"Map of the {missing:,} missing and {invented:,} hallucinated objects around the sensor{median}."
    )


def _rays(rays: pd.DataFrame) -> CaptionedChart:
    """Shares of the outcomes of rays by range, stacked."""
    data = [
        {
            "type": "bar",
            "name": OUTCOME_WORDS[name],
            "x": rays.index.tolist(),
            "y": 100 * rays[name].to_numpy(),
            "customdata": rays.n_rays.to_numpy(),
            "marker": {"color": on_page(colour)},
            "hovertemplate": f"%{{y:.1f}} % {OUTCOME_WORDS[name]} of %{{customdata:,}} rays<extra></extra>",
        }
        for name, colour in OUTCOME_COLOURS.items()
    ]
    layout = {
        "barmode": "stack",
        "margin": {"t": 60},
        "xaxis": {"type": "category", "showgrid": False},
        "yaxis": {"title": {"text": "share of the rays (%)"}},
    }
    counts = _listed(
        f"{band} {', '.join(f'{row[name]:.0%} {OUTCOME_WORDS[name]}' for name in OUTCOME_COLOURS)}"
        for band, row in rays.iterrows()
    )
    return _chart(data, layout), f"Outcomes of the rays by range: {counts}"


def _spread(what: str, scores: dict[str, pd.DataFrame]) -> CaptionedChart:
    """Median and quartiles of both scores in each group, above the number of objects that they are of."""
    data: list[Chart] = []
    for offset, (score, rows) in zip((-0.1, 0.1), scores.items(), strict=True):
        colour = on_page(SCORE_COLOURS[score])
        data.append(
            {
                "mode": "markers",
                "name": f"{METRIC[score].label}, median and quartiles",
                "x": np.arange(len(rows)) + offset,
                "y": rows["median"].to_numpy(),
                "error_y": {
                    "array": (rows.q3 - rows["median"]).fillna(0).to_numpy(),
                    "arrayminus": (rows["median"] - rows.q1).fillna(0).to_numpy(),
                    **{"symmetric": False, "thickness": 1.5, "width": 3, "color": colour},
                },
                "customdata": [f"{in_chart(str(name))}, {n:,} objects" for name, n in rows.n.items()],
                "hovertemplate": f"%{{customdata}}<br>{METRIC[score].label} %{{y:.2f}}<extra></extra>",
                "marker": {"color": colour, "size": 7},
            }
        )
    highest = max(np.nanmax(rows[["median", "q3"]].to_numpy(), initial=0.0) for rows in scores.values())
    n = max((rows.n for rows in scores.values()), key=sum)
    medians = _listed(
        f"{shown(name)} {_both({score: rows['median'][name] for score, rows in scores.items()})} of {n[name]}"
        for name in n.index[n > 0]
    )
    places = np.arange(len(n))
    bars = {"type": "bar", "name": "number of objects", "x": places, "y": n.to_numpy(), "yaxis": "y2"}
    data.append({**bars, "marker": {"color": _SOFT}, "hovertemplate": "%{y} objects<extra></extra>"})
    ticks = {"tickvals": places, "ticktext": [in_chart(str(name), 14) for name in n.index]}
    layout = {
        "xaxis": {"anchor": "y2", "range": [-0.6, len(n) - 0.4], "showgrid": False, **ticks},
        "yaxis": {"domain": [0.34, 1], "range": [0, 1.08 * highest or 1], "title": {"text": "score"}},
        "yaxis2": {"domain": [0, 0.22], "rangemode": "tozero", "nticks": 3},
        "margin": {"t": 30},
    }
    return _chart(data, layout), f"Medians by {what}: {medians}"


def _sequence(has_times: bool, pairs: pd.DataFrame) -> CaptionedChart:
    """Match rate and the means of both scores of each pair, one after the other."""
    data, ends, rows = [], [], pairs.iloc[evenly(len(pairs), MOST_DOTS)]
    names = [f"pair {in_chart(name)}, {n:,} matched" for name, n in zip(rows.pair_id, rows.n_matched, strict=True)]
    colours = {"match_rate": GREY, **{METRIC[score].mean_column: SCORE_COLOURS[score] for score in SCORES}}
    for (column, colour), symbol in zip(colours.items(), ("square", "circle", "diamond"), strict=True):
        metric, values = METRIC[column.removesuffix("_mean")], pairs[column].dropna()
        if len(values):
            ends.append(f"{metric.label} {values.min():.2f} to {values.max():.2f}")
        data.append(
            {
                "mode": "lines+markers" if len(rows) > 1 else "markers",
                "name": f"{metric.label} ({metric.scale})",
                "x": rows.place.to_numpy(),
                "y": rows[column].to_numpy(dtype=float),
                "text": names,
                "hovertemplate": f"%{{text}}<br>{metric.label} %{{y:.3f}}<extra></extra>",
                "line": {"color": on_page(colour), "width": 1},
                "marker": {"color": on_page(colour), "size": 6, "symbol": symbol},
            }
        )
    along = "time since the first scan (s)" if has_times else "number of the pair, by name"
    layout = {
        "xaxis": {"title": {"text": along}, "dtick": 1 if len(rows) <= 10 and not has_times else None},
        "yaxis": {"rangemode": "tozero", "title": {"text": "match rate, means of scores"}},
        "margin": {"t": 30},
    }
    order = "time" if has_times else "name"
    return _chart(data, layout), f"Each of {len(pairs)} pairs by {order}, lowest to highest: {_listed(ends)}"


def evidence_chart(evidence: Evidence) -> CaptionedChart:
    """Curves of the evidence of a cause where they are not all 0."""
    looks = {
        "real": (evidence.real, BLUE, "solid"),
        "simulated": (evidence.sim, VERMILION, "solid"),
        "corrected": (evidence.corrected, VERMILION, "dot"),
    }
    known = {name: (np.array(values), colour, dash) for name, (values, colour, dash) in looks.items() if values}
    places = np.flatnonzero(np.max([values for values, *_ in known.values()], axis=0))
    own = slice(max(0, places[0] - 1), places[-1] + 2) if len(places) else slice(None)
    x = np.array(evidence.x)[own]
    data = [
        {"mode": "lines", "name": name, "x": x, "y": values[own], "line": {"color": on_page(colour), "dash": dash}}
        for name, (values, colour, dash) in known.items()
    ]
    small = {"size": 9}
    layout = {
        "xaxis": {"nticks": 6},
        "yaxis": {"nticks": 4, "title": {"text": evidence.y_label, "font": small}},
        **{"showlegend": False, "margin": {"l": 36, "r": 8, "t": 8, "b": 18}, "font": small},
    }
    return _chart(data, layout), f"{evidence.y_label} over {evidence.x_label}, {x[0]:.3g} to {x[-1]:.3g}"


def change_chart(scores: Sequence[ScoreChange]) -> Chart:
    """One strip per score of a comparison: its change in each pair, their mean, and the mean's interval.

    Zero is in the middle; each strip has its own scale, which is written at its end.
    """
    data: list[Chart] = []
    notes: list[Chart] = []
    for i, score in enumerate(scores):
        change = score.difference
        known = {name: value for name, value in score.of_pairs.items() if value is not None}
        ends = [change.low or 0.0, change.high or 0.0]
        reach = float(np.abs([*known.values(), *ends]).max()) or 1.0
        colour = of_theme(score.verdict) if score.verdict in ("better", "worse") else _SOFT
        dots = [list(known.items())[place] for place in evenly(len(known), _MOST_CHANGES)]
        data.append(
            {
                "mode": "markers",
                "x": [value / reach for _, value in dots],
                "y": [i] * len(dots),
                "text": [f"pair {in_chart(name)}: {value:+.3f}" for name, value in dots],
                "hovertemplate": "%{text}<extra></extra>",
                "marker": {"color": colour, "size": 7, "opacity": 0.35, "line": {"width": 0}},
            }
        )
        if change.difference is not None and change.low is not None:
            low, middle, high = (np.array([ends[0], change.difference, ends[1]]) / reach).tolist()
            bar = {"array": [high - middle], "arrayminus": [middle - low], "symmetric": False, "thickness": 3}
            mark = {"symbol": "line-ns", "size": 16, "line": {"width": 3, "color": colour}}
            error = {"error_x": {**bar, "color": colour, "width": 0}}
            data.append({"mode": "markers", "x": [middle], "y": [i], **error, "hoverinfo": "skip", "marker": mark})
        end = {"x": 1.03, "xref": "paper", "xanchor": "left", "y": i, "yref": "y", "showarrow": False}
        notes.append({**end, "text": f"±{reach:.2g}"})
    names, n = [f"{score.name} {score.mark}" for score in scores], len(scores)
    layout = {
        "shapes": [_line(x=0, color=_SOFT, width=1)],
        "annotations": notes,
        "xaxis": {**_FIXED, "range": [-1.05, 1.05], "visible": False},
        "yaxis": {
            **_FIXED, "tickvals": list(range(n)), "ticktext": names, "range": [n - 0.5, -0.5],
            "showline": False, "zeroline": False,
        },
        "showlegend": False,
        "height": 34 * n + 24,
        "margin": {"l": 10, "r": 85, "t": 12, "b": 12},
    }  # fmt: skip
    return _chart(data, layout)


def _line(x: float | None = None, y: float | None = None, **look: Any) -> Chart:
    """A line across a chart at a value of x, or of y."""
    along, across = ("x", "y") if y is None else ("y", "x")
    at = x if y is None else y
    ends = {f"{along}0": at, f"{along}1": at, f"{across}0": 0, f"{across}1": 1, f"{across}ref": f"{across} domain"}
    return {"type": "line", "line": look, **ends}


def _listed(parts: Iterable[str]) -> str:
    return ("; ".join(parts) or "nothing") + "."


def _both(values: dict[str, float | None]) -> str:
    """Both scores as text."""
    return ", ".join(
        f"{METRIC[score].label} {'not known' if value is None or pd.isna(value) else f'{value:.2f}'}"
        for score, value in values.items()
    )


def _opening(objects: pd.DataFrame, what: str, ids: Iterable[int]) -> dict[str, Any]:
    """Target of a click on a dot (index of its pair in the run, name of the object), and its title."""
    titles = [f"pair {in_chart(pair_id)}, {what} {i}" for pair_id, i in zip(objects.pair_id, ids, strict=True)]
    return {"customdata": objects[["pair", "name"]].to_numpy().tolist(), "text": titles}


def _chart(data: Sequence[Mapping[str, Any]], layout: Chart) -> Chart:
    """Traces (dots and lines by default) and their layout as JSON has them: arrays as lists, NaN as null."""
    traces = [{"type": "scatter", **trace} for trace in data]
    text = orjson.dumps({"data": traces, "layout": layout}, np.ndarray.tolist, orjson.OPT_SERIALIZE_NUMPY)
    chart: Chart = orjson.loads(text)
    return chart
