"""The objects of a run as one data frame: size, place, class, coverage, fate, and the scores of matched objects.

Everything that describes many objects reads this frame: findings, overview, measures, comparisons, exports, reports.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import DISTRIBUTED, QUADRANT_LIMITS
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray, IntArray
from ...stages.statistics.findings import BAND_EDGES_M, Objects
from ...stages.statistics.typical_objects import SHAPES
from ..storage.folder import RunFolder

if TYPE_CHECKING:
    import pandas as pd

PAIRS_AT_ONCE = 200
#: Columns that identify rows; they are always read.
_KEYS = {
    "objects": ("community_id", "n_points"),
    "coverage": ("side", "community_id"),
    "metrics": ("real_id", "sim_id"),
}
#: Stored columns of the frame, by their table. Scores are those of the matched object on both sides.
COLUMNS_OF: dict[str, tuple[str, ...]] = {}
for _table, _keys in _KEYS.items():
    _known = {"pair_id", "side", "n_points", *_keys}
    COLUMNS_OF[_table] = tuple(name for name in TABLES[_table].schema.names if name not in _known)

CDC_LIMIT = QUADRANT_LIMITS["cdc"]
R_LAMBDA_LIMIT = QUADRANT_LIMITS["r_lambda"]

#: Keys of the quadrants by geometry and structure, best first, and how they are called. The paper names their meaning
#: and gives examples, no limits: these are fidpipe's, fixed so that runs compare, with reasons in the metric catalogue.
QUADRANTS = {
    "faithful": "faithful",
    "structure lost": "shape right but structure lost",
    "displaced": "structure right but displaced",
    "failed": "failed",
}
UNKNOWN = "no score"


def quadrant_of(cdc: FloatArray, r_lambda: FloatArray) -> NDArray[np.str_]:
    """The quadrant of each object, (n,) strings; "no score" where r_lambda is null.

    Parameters
    ----------
    cdc, r_lambda : (n,) float64; NaN if a score is null

    Examples
    --------
    >>> import numpy as np
    >>> quadrant_of(np.array([0.1, 0.1, 0.9, 0.9, 0.1]), np.array([0.1, 0.7, 0.1, 0.7, np.nan])).tolist()
    ['faithful', 'structure lost', 'displaced', 'failed', 'no score']
    """
    names = np.array([*QUADRANTS, UNKNOWN])
    index = (r_lambda > R_LAMBDA_LIMIT) + 2 * (cdc > CDC_LIMIT)
    return names[np.where(np.isnan(r_lambda), len(QUADRANTS), index)]


def shape_of(linearity: FloatArray, planarity: FloatArray, scattering: FloatArray) -> NDArray[np.str_]:
    """Shape of objects among `SHAPES`: the largest of the three, (n,) strings; "linear" if all are null.

    Examples
    --------
    >>> shape_of(np.array([0.2]), np.array([0.7]), np.array([0.1])).tolist()
    ['planar']
    """
    largest = np.nan_to_num(np.column_stack([linearity, planarity, scattering])).argmax(axis=1)
    shapes: NDArray[np.str_] = np.array([*SHAPES.values()])[largest]
    return shapes


_EXTENTS = ("extent_x", "extent_y", "extent_z")
#: Computed columns, with the columns that they are computed from.
_COMPUTED: dict[str, tuple[tuple[str, ...], Callable[..., NDArray[Any]]]] = {
    "shape": (tuple(SHAPES), shape_of),
    "band": (("range_m",), lambda range_m: np.digitize(range_m, BAND_EDGES_M) - 1),
    "bearing_deg": (("cx", "cy"), lambda x, y: np.degrees(np.arctan2(y, x))),
    "diagonal_m": (_EXTENTS, lambda *extents: np.sqrt(np.sum([extent**2 for extent in extents], axis=0))),
    "quadrant": (("cdc", "r_lambda"), quadrant_of),
}
ALL_COLUMNS = (*(name for names in COLUMNS_OF.values() for name in names), *_COMPUTED)
#: Names with units, for Python users.
WITH_UNITS = {f"c{axis}": f"{axis}_m" for axis in "xyz"} | {f"extent_{axis}": f"extent_{axis}_m" for axis in "xyz"}


def object_parts(
    store: RunFolder,
    pair_ids: Sequence[str],
    columns: Collection[str],
    *,
    by_reference: bool,
    sides: Sequence[str] = SIDES,
) -> Iterator[pd.DataFrame]:
    """The objects of scored pairs, 200 pairs at a time: one row per object, ordered by side, pair and id.

    Each part has these columns, and the requested ones:

    - pair_id, side, community_id, n_points
    - pair : index in `pair_ids`
    - fate : matched, missing, hallucinated, or remnant (the few simulated points of a missing object where the real
      side fixes the objects; it does not count as a simulated object)
    - partner : id of the matched object of the other side, -1 without one

    Parameters
    ----------
    columns : of `objects`, `coverage` and `metrics`, and shape (of `SHAPES`), band (index in `BAND_EDGES_M`),
        bearing_deg (0 ahead, 90 left), diagonal_m (of the bounding box), quadrant. Scores of unmatched objects are
        NaN, their counts 0
    by_reference : True if the real side fixes the objects
    sides : both, or only "real"

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    import pandas as pd

    computed = {name: sources for name, (sources, _) in _COMPUTED.items() if name in columns}
    needed = {*columns, *chain.from_iterable(computed.values())}
    stored = {}
    for table, known in COLUMNS_OF.items():
        stored[table] = [name for name in known if name in needed]
    wanted = {("objects", side): [*_KEYS["objects"], *stored["objects"]] for side in sides}
    wanted["metrics", ""] = [*_KEYS["metrics"], *stored["metrics"]]
    if stored["coverage"]:
        wanted["coverage", ""] = [*_KEYS["coverage"], *stored["coverage"]]
    for first in range(0, len(pair_ids), PAIRS_AT_ONCE):
        names = pair_ids[first : first + PAIRS_AT_ONCE]
        tables = store.read_pairs(names, wanted)
        n_real = tables["objects", "real"][1]
        frames = []
        for side in sides:
            found = _side_columns(side, tables, stored)
            pair = found["pair"]
            is_matched = found["partner"] >= 0
            found["fate"] = np.where(is_matched, "matched", "missing" if side == "real" else "hallucinated")
            if by_reference and side == "sim":
                found["fate"][~is_matched & (found["community_id"] < n_real[pair])] = "remnant"
            for name, sources in computed.items():
                inputs = [found[source] for source in sources]
                found[name] = _COMPUTED[name][1](*inputs)
            frames.append(pd.DataFrame({"pair_id": np.array(names, dtype=object)[pair], "side": side} | found))
        part = pd.concat(frames, ignore_index=True)
        part["pair"] += first
        yield part


def _side_columns(
    side: str, tables: dict[tuple[str, str], tuple[pa.Table, IntArray]], stored: dict[str, list[str]]
) -> dict[str, Any]:
    """The stored columns of the objects of one side of some pairs, with `pair` and `partner`."""
    objects, n = tables["objects", side]
    metrics, n_matched = tables["metrics", ""]
    first = np.cumsum(n) - n
    pair = np.repeat(np.arange(len(n), dtype=np.int32), n)
    found = {name: _array(objects, name) for name in objects.column_names}
    pair_of_match = np.repeat(np.arange(len(n)), n_matched)
    ids = _array(metrics, f"{side}_id")
    partners = _array(metrics, "sim_id" if side == "real" else "real_id")
    if ("coverage", "") in tables:
        coverage = tables["coverage", ""][0]
        own = (_array(coverage, "side") == side) & ~np.isnan(_array(coverage, "community_id"))
        found |= {name: _array(coverage, name)[own] for name in stored["coverage"]}
    rows = first[pair_of_match] + ids
    for name, values in {"partner": partners, **{name: _array(metrics, name) for name in stored["metrics"]}}.items():
        fill = -1 if name == "partner" else {"i": 0, "f": np.nan}.get(values.dtype.kind)
        found[name] = np.full(len(pair), fill, dtype=values.dtype)
        found[name][rows] = values
    return {"pair": pair} | found


def _array(table: pa.Table, name: str) -> NDArray[Any]:
    """A column as an array; null numbers are NaN, null strings None."""
    values: NDArray[Any] = table.column(name).to_numpy()
    return values


#: Columns of the frame that the statistics over all objects use.
STATISTICS_COLUMNS = ("range_m", "label", "n_real", "n_sim", *DISTRIBUTED)


def arrays_of(objects: pd.DataFrame) -> tuple[Objects, Objects]:
    """The objects of either side for the statistics over all objects; remnants do not count."""
    counted = objects[objects["fate"] != "remnant"]
    real = _arrays_of_side(counted[counted["side"] == "real"])
    sim = _arrays_of_side(counted[counted["side"] == "sim"])
    return real, sim


def _arrays_of_side(objects: pd.DataFrame) -> Objects:
    numbers = [name for name in ("pair", *STATISTICS_COLUMNS) if name != "label"]
    return Objects(
        label=objects["label"].fillna("").to_numpy(dtype=np.str_),
        is_matched=(objects["fate"] == "matched").to_numpy(),
        **{name: objects[name].to_numpy() for name in numbers},
    )


def plain_rows(rows: pd.DataFrame) -> list[Row]:
    """The rows of a frame as dictionaries of Python's values, None for null."""
    objects = rows.astype(object)
    records: Any = objects.where(objects.notna(), None).to_dict("records")
    return list(records)
