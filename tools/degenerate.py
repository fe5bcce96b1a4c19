"""Outcomes of degenerate scans, and checks that every result passes: docs/faults.md.

`python tools/degenerate.py` rewrites tests/degenerate_outcomes.md.
"""

import re
import sys
import warnings
from pathlib import Path

import numpy as np

from fidpipe import evaluate_pair
from fidpipe.schemas.errors import FidpipeError
from fidpipe.schemas.metric_catalogue import METRIC
from fidpipe.schemas.tables import TABLES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from scenes import cloud, degenerate

PAGE = Path(__file__).parents[1] / "tests" / "degenerate_outcomes.md"
SCENES = degenerate()
#: Every point is kept that is finite: nothing that a later stage could stumble over is dropped before.
OPEN = {"input": {"min_range_m": 0, "max_range_m": 1e9}, "ground": {"method": "none"}}
SETTINGS = {
    "preset `paper`": {},
    "`paper`, every finite point kept": OPEN,
    "`reference`, every finite point kept": {"preset": "reference"} | OPEN,
}
#: What a scene is about only under further settings.
FURTHER = {"2025 tiny communities": {"graph": {"edges": "intersection"}}}
_POINTS = cloud()
#: By what they are: arrays of other kinds than (n, 3) float64.
ARRAYS = {
    "float16": _POINTS.astype(np.float16),
    "float32": _POINTS.astype(np.float32),
    "long double": _POINTS.astype(np.longdouble),
    "big-endian": _POINTS.astype(">f8"),
    "whole numbers": (9 * _POINTS).astype(np.int32),
    "unsigned bytes": np.abs(9 * _POINTS).astype(np.uint8),
    "every second row and column of a larger array": np.repeat(np.repeat(_POINTS, 2, axis=0), 2, axis=1)[::2, ::2],
    "columns one after the other": np.asfortranarray(_POINTS),
    "nested lists": _POINTS.tolist(),
    "a masked array, every third row masked": np.ma.masked_array(_POINTS, np.repeat(np.arange(60) % 3 == 0, 3)),
    "complex numbers": _POINTS + 1j,
    "truth values": _POINTS > 9,
    "objects": _POINTS.astype(object),
    "text": _POINTS.astype(str),
    "dates": _POINTS.astype("M8[s]"),
    "rows of unequal lengths": [[1.0, 2.0, 3.0], [1.0]],
    "shape (0, 3)": np.empty((0, 3)),
    "shape (3,)": np.ones(3),
    "shape (n, 5)": np.ones((20, 5)),
    "a number": 5.0,
}
_MATCHES = ("n_matched", "n_communities_real", "n_communities_sim")


def outcome(real, sim, settings):
    """Outcome of a pair as text; a result must have none of the problems that `faults_of` finds."""
    try:
        result = evaluated(real, sim, settings)
    except FidpipeError as error:
        assert str(error).isprintable(), error  # one line
        return f"error: {str(error).partition(';')[0]}"
    assert not (faults := faults_of(result)), faults
    summary = result.summary
    n_matched, *n_objects = (summary[name] for name in _MATCHES)
    kinds = ((summary[f"n_{kind}"], kind.replace("_", " ")) for kind in ("scored", "identical", "too_small"))
    words = ", ".join(f"{n} {kind}" for n, kind in kinds if n)
    scores = ", ".join(f"{name} {_number(summary[f'{name}_mean'])}" for name in ("cdc", "r_lambda"))
    return f"{n_matched} of {max(n_objects)} matched{words and f' ({words})'}; {scores}"


def evaluated(real, sim, settings):
    """The result of a pair, without our own warning that the sides lie in two frames."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "the simulated scan")
        return evaluate_pair(real, sim, settings)


def faults_of(result):
    """Problems of a result: a value that is not a number, is out of its bounds, or is null without a reason."""
    tables = {"pairs": {name: [value] for name, value in result.summary.items()}}
    for name in ("metrics", "matching", "coverage", "surface", "selection", "baselines", "seeds"):
        if (frame := getattr(result, name)) is not None:
            tables[name] = frame.to_dict("list")
    for name, kind in (("ground", "points"), ("graph", "edges"), ("objects", "objects")):
        for frame in getattr(result, kind).values():
            tables[name] = frame.to_dict("list")
    if "baselines" in tables:
        rows = tables["baselines"]
        for name, value, reason in zip(rows["baseline"], rows["value"], rows["reason"], strict=True):
            tables.setdefault("value of a baseline", {}).setdefault(name, []).append(value)
            if value != value and not reason:
                tables["null without a reason"] = {name: [np.inf]}
    rows = tables["metrics"]
    if any(value != value and not reason for value, reason in zip(rows["r_lambda"], rows["reason"], strict=True)):
        tables["null without a reason"] = {"r_lambda": [np.inf]}
    return [
        f"{table}.{name}: {fault}"
        for table, columns in tables.items()
        for name, values in columns.items()
        if (fault := fault_of(table, name, values))
    ]


def fault_of(table, name, values):
    """Problem of the values of a column, "" if they are valid; null is None or, in a frame, NaN."""
    numbers = np.array([value for value in values if isinstance(value, int | float)], dtype=np.float64)
    known = numbers[~np.isnan(numbers)]
    metric = METRIC.get(name) or METRIC.get(name.removesuffix("_mean"))
    low, high = (metric.low, metric.high) if metric else (None, None)
    if np.isinf(known).any():
        return "infinite"
    if len(known) and ((low is not None and known.min() < low) or (high is not None and known.max() > high)):
        return f"expected {low} to {high}, got {known.min()} to {known.max()}"
    if table in TABLES and name in TABLES[table].schema.names and len(known) < len(numbers):
        return "" if TABLES[table].schema.field(name).nullable else "NaN"
    return ""


def row(scene):
    """The row of a scene."""
    return (
        f"| {scene} | "
        + " | ".join(outcome(*SCENES[scene], settings | FURTHER.get(scene, {})) for settings in SETTINGS.values())
        + " |"
    )


def array_row(name):
    """The row of a kind of array."""
    return f"| {name} | {outcome(ARRAYS[name], ARRAYS[name], OPEN)} |"


def with_tables(text):
    """The page's text with both tables between their marks."""
    header = ("scene", *SETTINGS)
    scenes = [f"| {' | '.join(header)} |", "|---" * len(header) + "|", *map(row, SCENES)]
    arrays = ["| array | outcome |", "|---|---|", *map(array_row, ARRAYS)]
    for name, lines in (("scenes", scenes), ("arrays", arrays)):
        marks = re.compile(rf"(<!-- {name}: .*? -->\n).*?(<!-- end of {name} -->)", re.DOTALL)
        text, n = marks.subn(lambda found, lines=lines: found[1] + "\n".join(lines) + "\n" + found[2], text)
        if n != 1:
            raise ValueError(f"{PAGE}: expected one table marked {name!r}, got {n}")
    return text


def _number(value):
    return "null" if value is None else f"{value:.2f}"


if __name__ == "__main__":
    PAGE.write_text(with_tables(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
