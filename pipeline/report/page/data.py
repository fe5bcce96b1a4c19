"""What a page holds: of a whole run data for its JavaScript and words for its template, of a pair points and spectra.

Points are whole numbers of a small step, spectra 32-bit floats, both in base64: the page stays small and needs no other
file.
"""

from __future__ import annotations

import base64
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from ....schemas.columns import SIDES
from ....schemas.metrics import METRIC, metric_of
from ....stages.arrays import IndexArray
from ....stages.coverage import COVERAGE_DISTANCES_M
from ....stages.sensing.sensor import differences, sensor_lines
from ...datasets.frame_checks import frames_summary
from ...results.floor import RunExcess
from ..aggregates import SCORES, plain_rows
from ..charts import MOST_DOTS, MOST_SCANS, run_charts
from ..look import FATE_COLOURS, GREY, RAMPS, SIDE_COLOURS, STEERING, on_page
from ..results import OBJECT_COVERAGE, PairTables, RunResults, Spectra
from ..terminal.floor import EXCESS_NOTE, excess_notes, excess_table, excess_title
from ..terminal.run import preset_line
from ..verdict import limits_in_words, verdict_of

#: More rows would make the page slow; the table then says what part it shows.
_MOST_ROWS = 5000
_MOST_FAILURES = 5
_NOT_IN_TABLES = "for each point"  # rings and times
_DIGITS = 6  # of the tables; the panel of an object has all

_WORDS = ("pair_id", "object", "group", "quadrant", "status")
_SCORES = (
    "cdc", "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "alignment_rms_m", "centroid_distance_m",
)  # fmt: skip
_PAIR_COLUMNS = (
    *("pair_id", "n_matched", "n_missing", "n_hallucinated", "match_rate"),
    *(METRIC[score].mean_column for score in _SCORES),
    *OBJECT_COVERAGE,
)
_OBJECT_COLUMNS = (
    *("object", "pair_id", "group", "quadrant", "status", "range_m", "n_real", "n_sim", "n_keep"),
    *(*_SCORES, *OBJECT_COVERAGE),
)
#: About so many points of a side are drawn at most, and of each object at least `_FEWEST`, if it has them.
_POINTS_PER_SIDE = 9000
_FEWEST = 80
_CURVE_POINTS = 200
#: The distance of a point to the other side is a byte, the largest for this many metres and more.
_FAR_M, _FAR = COVERAGE_DISTANCES_M[-1], 255
_STEPS = 32767

#: Headings of the columns that are no scores; other words stand for themselves.
_HEADINGS = {
    "pair_id": "pair", "range_m": "range (m)", "bearing_deg": "bearing (°, left positive)", "n_points": "points",
    "n_real": "points, real", "n_sim": "points, simulated", "n_keep": "nodes kept",
    **{name: name for name in ("object", "quadrant", "status", "reason")},
}  # fmt: skip
#: What is told of a chosen object.
_FACTS = (
    "quadrant", "status", "reason", "group", "range_m", "bearing_deg", "n_points", "n_real", "n_sim", "n_keep", "cdc",
    "r_lambda", "r_gap", "max_eigenvalue_shift", "laplacian_change", "eigenspectrum_distance", "gap_real", "gap_sim",
    "alignment_rms_m", "centroid_distance_m", *OBJECT_COVERAGE,
)  # fmt: skip
#: Columns of the objects, in the order of their rows in the page.
_MATCHED_COLUMNS = ("real_id", "sim_id", *(name for name in _FACTS if name != "n_points"))
_UNMATCHED_COLUMNS = (
    *("side", "community_id", "group", "status", "range_m", "bearing_deg", "n_points"),
    *OBJECT_COVERAGE,
)


def page_data(results: RunResults) -> dict[str, Any]:
    """What the page's JavaScript reads of the whole run: charts, colours, tables; no points."""
    pairs_note = "Worst first, by the mean of the ranks in match rate, CDC and r_lambda."
    return {
        "steering": STEERING,
        "names": results.pairs.pair_id.tolist(),
        "charts": run_charts(results),
        "colours": {
            "sides": {side: on_page(colour) for side, colour in SIDE_COLOURS.items()},
            "fates": {fate: on_page(colour) for fate, colour in FATE_COLOURS.items()},
            "ramps": RAMPS,
            "none": GREY,
        },
        "far_m": _FAR_M,
        "scores": {score: {"name": METRIC[score].label, "bound": METRIC[score].high} for score in SCORES},
        "pairs": _table(results, results.pairs, _PAIR_COLUMNS, pairs_note),
        "objects": _objects(results),
        "facts": _headings(results, _FACTS),
        "matched_columns": _MATCHED_COLUMNS,
        "unmatched_columns": _UNMATCHED_COLUMNS,
    }


def page_words(results: RunResults, excess: RunExcess | None = None) -> dict[str, Any]:
    """What the page's template shows of the whole run; versions by group, what made it; scores over a floor if any."""
    record = results.run.record
    n_pairs = len(results.pairs) + len(results.failures)
    return {
        "title": results.run.folder.resolve().name,
        "preset": preset_line(record),
        "verdict": verdict_of(results),
        "n_failures": len(results.failures),
        "failures": list(results.failures.items())[:_MOST_FAILURES],
        "frames": frames_summary(record.frames, n_pairs) if record.frames else "",
        "notes": _notes(results),
        "floor": excess
        and {
            "title": excess_title(excess),
            "rows": excess_table(excess),
            "notes": [EXCESS_NOTE, *excess_notes(excess)],
        },
        "sensors": _sensors(results),
        "settings": record.settings,
        "versions": {
            "": {name: getattr(record, name) for name in ("fidpipe", "written", "dataset", "seed", "workers")}
            | {"seconds": round(record.wall_s["total"], 1)},
            "stage version": record.stages,
            "library": record.libraries,
            "machine": record.machine.as_dict(),
        },
    }


def _sensors(results: RunResults) -> dict[str, Any]:
    """What one pair tells of the sensors of both sides: its first by name."""
    pair_id = results.pairs.pair_id.min()
    facts = PairTables(results, pair_id).sensors
    lines = {
        side: [line for line in sensor_lines(facts[side]) if not line.startswith(_NOT_IN_TABLES)] for side in SIDES
    }
    return {"pair_id": pair_id, "lines": lines, "differences": differences(facts["real"], facts["sim"])}


def pair_view(results: RunResults, pair_id: str) -> dict[str, Any]:
    """One pair for the page: points of both sides, objects, spectra; `RunError` if one of its tables is damaged."""
    tables = PairTables(results, pair_id)
    step_m = max(float(np.abs(cloud.points).max()) for cloud in tables.clouds.values()) / _STEPS
    return {
        "step_m": step_m,
        "sides": {side: _encoded(tables, side, step_m) for side in SIDES},
        "matched": plain_rows(tables.matched, _MATCHED_COLUMNS),
        "unmatched": plain_rows(tables.unmatched, _UNMATCHED_COLUMNS),
        "spectra": {str(real_id): _curve(spectra) for real_id, spectra in tables.spectra()},
    }


def thinned(community: Iterable[int], most: int) -> IndexArray:
    """Indices of about `most` points, of each object the same share but at least `_FEWEST`; for display only.

    Examples
    --------
    >>> import numpy as np
    >>> kept = thinned(np.repeat([0, 1], [10_000, 50]), most=1000)
    >>> np.bincount(np.repeat([0, 1], [10_000, 50])[kept]).tolist()
    [996, 50]
    """
    ids = np.asarray(community)
    share = min(1.0, most / max(1, len(ids)))
    rng, chosen = np.random.default_rng(0), []
    for members in np.split(np.argsort(ids, kind="stable"), np.cumsum(np.bincount(ids))[:-1]):
        n = min(len(members), max(_FEWEST, int(np.ceil(share * len(members)))))
        chosen.append(rng.choice(members, n, replace=False))
    kept: IndexArray = np.sort(np.concatenate(chosen))
    return kept


def _headings(results: RunResults, columns: Iterable[str]) -> dict[str, str]:
    """By column of a table of pairs or objects, its heading: of scores that of the catalogue, class or shape by run."""
    known = {**_HEADINGS, "group": results.class_is}
    headings = {column: known.get(column) or metric_of(column).label for column in columns}
    return {column: re.sub(r"(?<=\d) (?=m\b)", "\N{NO-BREAK SPACE}", heading) for column, heading in headings.items()}


def _table(results: RunResults, rows: pd.DataFrame, columns: Sequence[str], note: str) -> dict[str, Any]:
    """A table with its columns; `up` is set where the lowest values are the worst, `about` what a score tells."""
    described = []
    for key, title in _headings(results, columns).items():
        metric = METRIC.get(key.removesuffix("_mean"))
        described.append(
            {
                "key": key,
                "title": title,
                "about": f"{key}: {metric.reading or metric.meaning}" if metric else "",
                "text": key in _WORDS,
                "up": metric is not None and metric.higher_is_better,
                "digits": 1 if key == "range_m" else 3,
            }
        )
    return {"columns": described, "rows": plain_rows(rows.round(_DIGITS), columns), "note": note}


def _objects(results: RunResults) -> dict[str, Any]:
    """Rows of matched objects, worst first, then of unmatched ones, largest first."""
    matched, lone = results.matched, results.unmatched
    matched = matched.assign(object=matched.name + ", sim " + matched.sim_id.astype(str))
    counts = {f"n_{side}": lone.n_points.where(lone.side == side) for side in SIDE_COLOURS}
    both = pd.concat([matched, lone.assign(object=lone.name, **counts)])
    order = "matched objects by the mean of their ranks in CDC and r_lambda, then unmatched ones, largest first"
    note = f"Worst first: {order}."
    if len(both) > _MOST_ROWS:
        note += f" The page holds {_MOST_ROWS:,} of {len(both):,}; the rest is in the run's tables."
    return _table(results, both.head(_MOST_ROWS), _OBJECT_COLUMNS, note)


def _notes(results: RunResults) -> dict[str, str]:
    """What stands under those charts that may show a part only."""
    n_pairs, n_matched, n_unmatched = len(results.pairs), len(results.matched), len(results.unmatched)
    n_scored = int(results.matched.r_lambda.notna().sum())
    kind = "class (label)" if results.class_is == "class" else "shape of the real object (the scans have no labels)"
    whiskers = (
        "Boxes: quartiles and median; whiskers to 1.5 times the quartile distance; in brackets, how many objects."
    )
    chosen = f"{MOST_SCANS} of {n_pairs}, evenly from worst to best" if n_pairs > MOST_SCANS else "worst first"
    dots = " objects are drawn, evenly over the order from worst to best; the counts are of all"
    seen = "Unmatched objects of all pairs around the sensor, at their centroids, seen from above."
    return {
        "quadrants": f"Limits: {limits_in_words()}.{_part(min(n_scored, MOST_DOTS), n_matched, dots)}",
        "polar": f"{seen}{_part(MOST_DOTS, n_unmatched, ' are drawn, largest first')}",
        "box_scan": f"By scan, {chosen}. {whiskers}",
        "box_class": f"By {kind}, the most frequent first. {whiskers}",
    }


def _part(most: int, n_all: int, how: str) -> str:
    """Which part is shown, "" if all is."""
    return f" {most:,} of {n_all:,}{how}." if most < n_all else ""


def _encoded(tables: PairTables, side: str, step_m: float) -> dict[str, Any]:
    cloud = tables.clouds[side]
    shown = thinned(cloud.community, _POINTS_PER_SIDE)
    is_kept = np.isin(cloud.point_ids[shown], tables.selection[f"{side}_point_id"])
    return {
        "n": len(cloud.points),
        "n_shown": len(shown),
        "xyz": _base64(np.rint(cloud.points[shown].T / step_m), "<i2"),
        "community": _base64(cloud.community[shown], "<i4"),
        "kept": _base64(is_kept, "u1"),
        "distance": _base64(np.rint(np.minimum(tables.distances_m[side][shown] / _FAR_M, 1) * _FAR), "u1"),
    }


def _curve(spectra: Spectra) -> dict[str, Any]:
    if spectra.real is None or spectra.sim is None:
        return {"reason": spectra.reason}
    worst = int(np.argmax(np.abs(spectra.sim - spectra.real)))
    n = len(spectra.real)
    index = np.unique(np.append(np.linspace(0, n - 1, min(n, _CURVE_POINTS)).round(), worst)).astype(np.intp)
    return {
        "n": n,
        "worst": int(np.searchsorted(index, worst)),
        "index": _base64(index, "<i4"),
        "real": _base64(spectra.real[index], "<f4"),
        "sim": _base64(spectra.sim[index], "<f4"),
    }


def _base64(values: Any, dtype: str) -> str:
    """Numbers as base64 of a little-endian type."""
    return base64.b64encode(np.ascontiguousarray(values).astype(dtype).tobytes()).decode("ascii")
