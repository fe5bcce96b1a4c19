"""Charts of many objects: plain dictionaries of data and layout, which plotly.js draws.

Each chart of a run has a sentence with its main numbers, for those who do not see it.

Colours that depend on the theme are properties of the style sheet, such as var(--ink), which the
page replaces by their values. The charts of one pair are drawn by the page.
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

#: More dots would make a page slow; the texts next to the charts then name the part that is shown.
MOST_DOTS = 3000
_MOST_CHANGES = 300
_MOST_CLASSES = 10
_RANGE_BIN_M = 10.0
_MOST_RANGE_BINS = 12
#: Scores along the sequence.
_SYMBOLS = {"match_rate": "square", "r_lambda": "circle", "cdc": "diamond"}
_QUARTILES = {"q1": 0.25, "median": 0.5, "q3": 0.75}

_INK = of_theme("ink")
_SOFT = of_theme("soft")
_LINE = of_theme("line")
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
        "scene": {
            "aspectmode": "data",
            "dragmode": "orbit",
            **dict.fromkeys(("xaxis", "yaxis", "zaxis"), _AXIS_3D),
        },
    }
}


def run_charts(results: RunResults) -> dict[str, CaptionedChart]:
    """The charts of a whole run with their sentences, by the id of their place in the page."""
    matched = results.matched
    ranges, range_of = range_bins(matched)
    classes = matched.group.value_counts().index[:_MOST_CLASSES].tolist()
    charts = {
        "quadrants": _quadrants(results),
        "scores_range": _spread("distance", score_spread(matched, range_of, ranges)),
        "scores_class": _spread(results.class_is, score_spread(matched, matched.group, classes)),
        "sequence": _sequence(*along_the_sequence(results, results.run.record.times_s)),
        "polar": _polar(results.unmatched),
    }
    rays = ray_outcomes(results)
    if len(rays):
        charts["rays_range"] = _rays(rays)
    return charts


def ray_outcomes(results: RunResults) -> pd.DataFrame:
    """Shares of the outcomes of rays by range, over the scored pairs.

    Rows are ranges, near to far; columns the outcomes, and `n_rays`.
    """
    outcomes = [*OUTCOME_COLOURS]
    stored = {f"rays_{name}": name for name in outcomes}
    part = {("ray_scores", ""): ["by", "band", "n_rays", *stored]}
    table, _ = results.run.store.read_pairs(results.pairs.pair_id.tolist(), part)["ray_scores", ""]
    rows = table.to_pandas().query("by == 'range'").set_index("band").rename(columns=stored)
    rows[outcomes] = rows[outcomes].mul(rows.n_rays, axis=0)
    total = rows.drop(columns="by").groupby(level=0, sort=False).sum()
    total = total.loc[sorted(total.index, key=_band_start)]
    total[outcomes] = total[outcomes].div(total.n_rays, axis=0)
    return total


def _band_start(band: str) -> float:
    return float(band.removeprefix("over ").split()[0])


def range_bins(objects: pd.DataFrame) -> tuple[list[str], pd.Series]:
    """Names of bins of the distance from the sensor, and the bin of each object.

    Bins of 10 m from 0 to the farthest object; of 20, 30 ... m where those were more than twelve.
    """
    farthest_m = float(objects.range_m.max()) if len(objects) else 0.0
    n_steps = max(1, math.ceil(farthest_m / (_RANGE_BIN_M * _MOST_RANGE_BINS)))
    width = _RANGE_BIN_M * n_steps
    lows = [width * i for i in range(math.floor(farthest_m / width) + 1)]
    names = [f"{low:g} to {low + width:g} m" for low in lows]
    return names, (objects.range_m // width).astype(int).map(dict(enumerate(names)))


def score_spread(
    matched: pd.DataFrame, group: pd.Series, names: list[str]
) -> dict[str, pd.DataFrame]:
    """By score, for each named group of objects: how many have the score (n), q1, median and q3.

    Fewer than three have no quartiles (NaN), none have no median.
    """
    by_score = {}
    for score in SCORES:
        values = matched[score].astype(float).groupby(group)
        columns = {name: values.quantile(share) for name, share in _QUARTILES.items()}
        rows = pd.DataFrame({"n": values.count(), **columns}).reindex(names)
        rows["n"] = rows.n.fillna(0).astype(int)
        rows.loc[rows.n < FEWEST_IN_BOX, ["q1", "q3"]] = np.nan
        by_score[score] = rows
    return by_score


def along_the_sequence(
    results: RunResults, times_s: Mapping[str, float]
) -> tuple[bool, pd.DataFrame]:
    """The scored pairs by the time of their real scans if known of each (then True), else by name.

    Their `place` is the number of seconds since the first one, or their number from 1.
    """
    rows = results.pairs.assign(time_s=results.pairs.pair_id.map(times_s).astype(float))
    if rows.time_s.notna().all():
        rows = rows.sort_values(["time_s", "pair_id"], ignore_index=True)
        return True, rows.assign(place=rows.time_s - rows.time_s[0])
    rows = rows.sort_values("pair_id", ignore_index=True)
    return False, rows.assign(place=np.arange(1.0, len(rows) + 1))


def _quadrants(results: RunResults) -> CaptionedChart:
    """r_lambda over CDC, one dot per object, and histograms of both.

    Of too many objects those evenly over the order from worst to best.
    """
    scored = results.matched[results.matched.r_lambda.notna()]
    dots = scored.iloc[evenly(len(scored), MOST_DOTS)]
    counted = quadrants(results)
    histogram = {
        "type": "histogram",
        "marker": {"color": GREY},
        "showlegend": False,
        "hoverinfo": "skip",
    }
    data: list[Chart] = [
        {
            **histogram,
            "x": dots.cdc.to_numpy(np.float32),
            "yaxis": "y2",
            "xbins": {"start": 0, "end": 2, "size": 0.08},
        },
        {
            **histogram,
            "y": dots.r_lambda.to_numpy(np.float32),
            "xaxis": "x2",
            "ybins": {"start": 0, "end": 1, "size": 0.04},
        },
    ]
    for key in QUADRANTS:
        rows = dots[dots.quadrant == key]
        share = 100 * counted[key]["share"]
        data.append(
            {
                "mode": "markers",
                "name": f"{key}: {counted[key]['n']} ({share:.0f} %)",
                "x": rows.cdc.to_numpy(np.float32),
                "y": rows.r_lambda.to_numpy(np.float32),
                **_opening(rows, "object", rows.real_id),
                "hovertemplate": "%{text}<br>CDC %{x:.3f}<br>r_lambda %{y:.3f}<extra></extra>",
                "marker": {"color": on_page(QUADRANT_COLOURS[key]), "size": 6, "opacity": 0.8},
                "cliponaxis": False,
            }
        )
    main = {"domain": [0, 0.84]}
    side = {"domain": [0.86, 1], "visible": False}
    layout = {
        "xaxis": {**main, "range": [0, 2.02], "title": {"text": axis_title("cdc")}},
        "yaxis": {**main, "range": [0, 1.02], "title": {"text": axis_title("r_lambda")}},
        "xaxis2": side,
        "yaxis2": side,
        "bargap": 0.1,
        "shapes": [_line("x", CDC_LIMIT), _line("y", R_LAMBDA_LIMIT)],
        "legend": {"font": {"size": 11}},
    }
    counts = _listed(f"{title} {counted[key]['n']:,}" for key, title in QUADRANTS.items())
    medians = _both({score: results.matched[score].median() for score in SCORES})
    caption = f"r_lambda over CDC of each object: {counts} Medians: {medians}."
    return _chart(data, layout), caption


def _polar(unmatched: pd.DataFrame) -> CaptionedChart:
    """Unmatched objects around the sensor, seen from above; of too many the largest."""
    drawn = unmatched.head(MOST_DOTS)
    data = []
    counts = []
    for fate, symbol in (("missing", "circle-open"), ("hallucinated", "x-thin")):
        rows = drawn[drawn.status == fate]
        colour = on_page(FATE_COLOURS[fate])
        n = f"{(unmatched.status == fate).sum():,}"
        counts.append(f"{n} {fate}")
        data.append(
            {
                "type": "scatterpolar",
                "mode": "markers",
                "name": f"{fate} ({n})",
                "r": rows.range_m.to_numpy(np.float32),
                "theta": rows.bearing_deg.to_numpy(np.float32),
                **_opening(rows, f"{fate} object", rows.community_id),
                "hovertemplate": "%{text}<br>%{r:.1f} m, %{theta:.0f}°<extra></extra>",
                "marker": {
                    "color": colour,
                    "size": 6,
                    "symbol": symbol,
                    "line": {"width": 1.5, "color": colour},
                },
            }
        )
    layout = {
        "polar": {
            "radialaxis": {"ticksuffix": " m", "angle": 45, "tickangle": 45, "nticks": 5},
            "angularaxis": {
                "rotation": 90,
                "tickvals": list(range(0, 360, 45)),
                "ticktext": ["ahead", "", "left", "", "behind", "", "right", ""],
            },
        },
        "margin": {"l": 45, "r": 45, "t": 65, "b": 30},
        "legend": {"y": 1.1},
    }
    median = f", median distance {unmatched.range_m.median():.0f} m" if len(unmatched) else ""
    caption = f"Map of the {' and '.join(counts)} objects around the sensor{median}."
    return _chart(data, layout), caption


def _rays(rays: pd.DataFrame) -> CaptionedChart:
    """Shares of the outcomes of rays by range, stacked."""
    data = []
    for name, colour in OUTCOME_COLOURS.items():
        words = OUTCOME_WORDS[name]
        data.append(
            {
                "type": "bar",
                "name": words,
                "x": rays.index.tolist(),
                "y": 100 * rays[name].to_numpy(),
                "customdata": rays.n_rays.to_numpy(),
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
    shares = []
    for band, row in rays.iterrows():
        of_band = [f"{row[name]:.0%} {words}" for name, words in OUTCOME_WORDS.items()]
        shares.append(f"{band} {', '.join(of_band)}")
    return _chart(data, layout), f"Outcomes of the rays by range: {_listed(shares)}"


def _spread(what: str, scores: dict[str, pd.DataFrame]) -> CaptionedChart:
    """Median and quartiles of both scores in each group, above its number of objects."""
    data: list[Chart] = []
    highest = 0.0
    for offset, (score, rows) in zip((-0.1, 0.1), scores.items(), strict=True):
        colour = on_page(SCORE_COLOURS[score])
        label = METRIC[score].label
        median = rows["median"]
        highest = np.nanmax(rows[["median", "q3"]].to_numpy(), initial=highest)
        above = (rows.q3 - median).fillna(0).to_numpy()
        below = (median - rows.q1).fillna(0).to_numpy()
        data.append(
            {
                "mode": "markers",
                "name": f"{label}, median and quartiles",
                "x": np.arange(len(rows)) + offset,
                "y": median.to_numpy(),
                "error_y": _error(above, below, colour, thickness=1.5, width=3),
                "customdata": [
                    f"{in_chart(str(name))}, {n:,} objects" for name, n in rows.n.items()
                ],
                "hovertemplate": f"%{{customdata}}<br>{label} %{{y:.2f}}<extra></extra>",
                "marker": {"color": colour, "size": 7},
            }
        )
    n = max((rows.n for rows in scores.values()), key=sum)
    places = np.arange(len(n))
    data.append(
        {
            "type": "bar",
            "name": "number of objects",
            "x": places,
            "y": n.to_numpy(),
            "yaxis": "y2",
            "marker": {"color": _SOFT},
            "hovertemplate": "%{y} objects<extra></extra>",
        }
    )
    layout = {
        "xaxis": {
            "anchor": "y2",
            "range": [-0.6, len(n) - 0.4],
            "showgrid": False,
            "tickvals": places,
            "ticktext": [in_chart(str(name), 14) for name in n.index],
        },
        "yaxis": {
            "domain": [0.34, 1],
            "range": [0, 1.08 * highest or 1],
            "title": {"text": "score"},
        },
        "yaxis2": {"domain": [0, 0.22], "rangemode": "tozero", "nticks": 3},
        "margin": {"t": 30},
    }
    medians = []
    for name in n.index[n > 0]:
        of_group = _both({score: rows["median"][name] for score, rows in scores.items()})
        medians.append(f"{shown(name)} {of_group} of {n[name]}")
    return _chart(data, layout), f"Medians by {what}: {_listed(medians)}"


def _sequence(has_times: bool, pairs: pd.DataFrame) -> CaptionedChart:
    """Match rate and the means of both scores of each pair, one after the other."""
    rows = pairs.iloc[evenly(len(pairs), MOST_DOTS)]
    names = [f"pair {in_chart(name)}" for name in rows.pair_id]
    texts = [f"{name}, {n:,} matched" for name, n in zip(names, rows.n_matched, strict=True)]
    data = []
    ends = []
    for score, symbol in _SYMBOLS.items():
        colour = SCORE_COLOURS.get(score, GREY)
        metric = METRIC[score]
        values = pairs[metric.pair_column].dropna()
        if len(values):
            ends.append(f"{metric.label} {values.min():.2f} to {values.max():.2f}")
        data.append(
            {
                "mode": "lines+markers" if len(rows) > 1 else "markers",
                "name": f"{metric.label} ({metric.scale})",
                "x": rows.place.to_numpy(),
                "y": rows[metric.pair_column].to_numpy(dtype=float),
                "text": texts,
                "hovertemplate": f"%{{text}}<br>{metric.label} %{{y:.3f}}<extra></extra>",
                "line": {"color": on_page(colour), "width": 1},
                "marker": {"color": on_page(colour), "size": 6, "symbol": symbol},
            }
        )
    along = "time since the first scan (s)" if has_times else "number of the pair, by name"
    is_countable = len(rows) <= 10 and not has_times
    layout = {
        "xaxis": {"title": {"text": along}, "dtick": 1 if is_countable else None},
        "yaxis": {"rangemode": "tozero", "title": {"text": "match rate, means of scores"}},
        "margin": {"t": 30},
    }
    order = "time" if has_times else "name"
    caption = f"Each of {len(pairs)} pairs by {order}, lowest to highest: {_listed(ends)}"
    return _chart(data, layout), caption


def evidence_chart(evidence: Evidence) -> CaptionedChart:
    """Curves of the evidence of a cause where they are not all 0."""
    curves = []
    for name, values, colour, dash in (
        ("real", evidence.real, BLUE, "solid"),
        ("simulated", evidence.sim, VERMILION, "solid"),
        ("corrected", evidence.corrected, VERMILION, "dot"),
    ):
        if values:
            curves.append((name, np.array(values), on_page(colour), dash))
    places = np.flatnonzero(np.max([curve for _, curve, _, _ in curves], axis=0))
    part = slice(None)
    if len(places):
        part = slice(max(0, places[0] - 1), places[-1] + 2)
    x = np.array(evidence.x)[part]
    data = []
    for name, curve, colour, dash in curves:
        line = {"color": colour, "dash": dash}
        data.append({"mode": "lines", "name": name, "x": x, "y": curve[part], "line": line})
    small = {"size": 9}
    layout = {
        "xaxis": {"nticks": 6},
        "yaxis": {"nticks": 4, "title": {"text": evidence.y_label, "font": small}},
        "showlegend": False,
        "margin": {"l": 36, "r": 8, "t": 8, "b": 18},
        "font": small,
    }
    caption = f"{evidence.y_label} over {evidence.x_label}, {x[0]:.3g} to {x[-1]:.3g}"
    return _chart(data, layout), caption


def change_chart(scores: Sequence[ScoreChange]) -> Chart:
    """One strip per score of a comparison: its change in each pair, their mean, and its interval.

    Zero is in the middle; each strip has its own scale, which is written at its end.
    """
    data: list[Chart] = []
    notes: list[Chart] = []
    for i, score in enumerate(scores):
        reach = _reach(score)
        data += _strip(score, i, reach)
        notes.append(
            {
                **{"text": f"±{reach:.2g}", "x": 1.03, "xref": "paper", "xanchor": "left"},
                **{"y": i, "yref": "y", "showarrow": False},
            }
        )
    n = len(scores)
    layout = {
        "shapes": [_line("x", 0, color=_SOFT)],
        "annotations": notes,
        "xaxis": {**_FIXED, "range": [-1.05, 1.05], "visible": False},
        "yaxis": {
            **_FIXED,
            "tickvals": list(range(n)),
            "ticktext": [f"{score.name} {score.mark}" for score in scores],
            "range": [n - 0.5, -0.5],
            "showline": False,
            "zeroline": False,
        },
        "showlegend": False,
        "height": 34 * n + 24,
        "margin": {"l": 10, "r": 85, "t": 12, "b": 12},
    }
    return _chart(data, layout)


def _reach(score: ScoreChange) -> float:
    """The largest change of a strip: of a pair, or an end of the interval; 1 if nothing changed."""
    ends = [score.difference.low, score.difference.high, *score.of_pairs.values()]
    return max((abs(value) for value in ends if value is not None), default=0.0) or 1.0


def _strip(score: ScoreChange, place: int, reach: float) -> list[Chart]:
    """Dots of the pairs, and a bar of the interval of their mean."""
    colour = of_theme(score.verdict) if score.verdict in ("better", "worse") else _SOFT
    known = [(name, value) for name, value in score.of_pairs.items() if value is not None]
    drawn = [known[i] for i in evenly(len(known), _MOST_CHANGES)]
    dots = {
        "mode": "markers",
        "x": [value / reach for _, value in drawn],
        "y": [place] * len(drawn),
        "text": [f"pair {in_chart(name)}: {value:+.3f}" for name, value in drawn],
        "hovertemplate": "%{text}<extra></extra>",
        "marker": {"color": colour, "size": 7, "opacity": 0.35, "line": {"width": 0}},
    }
    change = score.difference
    if change.difference is None or change.low is None or change.high is None:
        return [dots]
    middle = change.difference / reach
    above = [change.high / reach - middle]
    below = [middle - change.low / reach]
    interval = {
        "mode": "markers",
        "x": [middle],
        "y": [place],
        "error_x": _error(above, below, colour, thickness=3, width=0),
        "hoverinfo": "skip",
        "marker": {"symbol": "line-ns", "size": 16, "line": {"width": 3, "color": colour}},
    }
    return [dots, interval]


def _error(above: Any, below: Any, colour: str, *, thickness: float, width: int) -> Chart:
    """Bars from a dot to both sides."""
    return {
        "array": above,
        "arrayminus": below,
        "symmetric": False,
        "thickness": thickness,
        "width": width,
        "color": colour,
    }


def _line(axis: str, value: float, **look: Any) -> Chart:
    """A line across a chart at a value of an axis."""
    across = "y" if axis == "x" else "x"
    return {
        "type": "line",
        f"{axis}0": value,
        f"{axis}1": value,
        f"{across}0": 0,
        f"{across}1": 1,
        f"{across}ref": f"{across} domain",
        "line": {"width": 1, **look},
    }


def _listed(texts: Iterable[str]) -> str:
    return ("; ".join(texts) or "nothing") + "."


def _both(values: dict[str, float | None]) -> str:
    """Both scores as text."""
    texts = []
    for score, value in values.items():
        text = "not known" if value is None or pd.isna(value) else f"{value:.2f}"
        texts.append(f"{METRIC[score].label} {text}")
    return ", ".join(texts)


def _opening(objects: pd.DataFrame, what: str, ids: Iterable[int]) -> dict[str, Any]:
    """Target of a click on a dot (index of its pair in the run, name of the object), and title."""
    titles = []
    for pair_id, object_id in zip(objects.pair_id, ids, strict=True):
        titles.append(f"pair {in_chart(pair_id)}, {what} {object_id}")
    return {"customdata": objects[["pair", "name"]].to_numpy().tolist(), "text": titles}


def _chart(data: Sequence[Mapping[str, Any]], layout: Chart) -> Chart:
    """Traces (dots and lines by default) and their layout as JSON: arrays as lists, NaN as null."""
    traces = [{"type": "scatter", **trace} for trace in data]
    content = {"data": traces, "layout": layout}
    text = orjson.dumps(content, np.ndarray.tolist, orjson.OPT_SERIALIZE_NUMPY)
    chart: Chart = orjson.loads(text)
    return chart
