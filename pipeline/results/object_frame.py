"""The objects of a run as one data frame: size, place, class, coverage, fate, and the scores of matched objects.

Everything that describes many objects reads this frame: findings, overview, measures, comparisons, exports, reports.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import QUADRANT_LIMITS
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
from ...stages.statistics.bands import BAND_EDGES_M
from ..storage.folder import RunFolder

if TYPE_CHECKING:
    import pandas as pd

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

#: The shape features of objects, and the name of an object of that shape.
SHAPES = {"linearity": "linear", "planarity": "planar", "scattering": "scattered"}
CDC_LIMIT = QUADRANT_LIMITS["cdc"]
R_LAMBDA_LIMIT = QUADRANT_LIMITS["r_lambda"]

#: The quadrants by geometry and structure, best first. The paper names their meaning and gives examples, no limits:
#: these are fidpipe's, fixed so that runs compare, with reasons in the metric catalogue.
QUADRANTS = ("faithful", "structure lost", "displaced", "failed")
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


def shape_of(
    linearity: FloatArray, planarity: FloatArray, scattering: FloatArray
) -> NDArray[np.str_]:
    """Shape of objects among `SHAPES`: the largest of the three, (n,) strings; "linear" if all are null.

    Examples
    --------
    >>> shape_of(np.array([0.2]), np.array([0.7]), np.array([0.1])).tolist()
    ['planar']
    """
    largest = np.nan_to_num(np.column_stack([linearity, planarity, scattering])).argmax(axis=1)
    shapes: NDArray[np.str_] = np.array([*SHAPES.values()])[largest]
    return shapes


#: Fate of an object that only one side has.
_ALONE = {"real": "not_found", "sim": "extra"}
#: Scores that are counts.
_COUNTS = [field.name for field in TABLES["metrics"].schema if pa.types.is_integer(field.type)]
_EXTENTS = ("extent_x", "extent_y", "extent_z")
#: Computed columns, with the columns that they are computed from.
_COMPUTED: dict[str, tuple[tuple[str, ...], Callable[..., NDArray[Any]]]] = {
    "shape": (tuple(SHAPES), shape_of),
    "band": (("range_m",), lambda range_m: np.digitize(range_m, BAND_EDGES_M) - 1),
    "bearing_deg": (("cx", "cy"), lambda x, y: np.degrees(np.arctan2(y, x))),
    "diagonal_m": (
        _EXTENTS,
        lambda *extents: np.sqrt(np.sum([extent**2 for extent in extents], axis=0)),
    ),
    "quadrant": (("cdc", "r_lambda"), quadrant_of),
}
ALL_COLUMNS = (*(name for names in COLUMNS_OF.values() for name in names), *_COMPUTED)
#: Names with units, for Python users.
WITH_UNITS = {f"c{axis}": f"{axis}_m" for axis in "xyz"} | {
    f"extent_{axis}": f"extent_{axis}_m" for axis in "xyz"
}


def object_frame(
    store: RunFolder,
    pair_ids: Sequence[str],
    columns: Collection[str],
    *,
    by_reference: bool,
    sides: Sequence[str] = SIDES,
) -> pd.DataFrame:
    """The objects of scored pairs: one row per object, ordered by side, pair and id.

    The frame has these columns, and the requested ones:

    - pair_id, side, community_id, n_points
    - pair : index in `pair_ids`
    - fate : matched, not_found, extra, or remnant (the few simulated points of an unmatched object where the real
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

    needed = set(columns)
    for name in _COMPUTED.keys() & needed:
        needed.update(_COMPUTED[name][0])
    sources: dict[tuple[str, str], list[str]] = {}
    for table, known in COLUMNS_OF.items():
        stored = [name for name in known if name in needed]
        if stored or table != "coverage":
            for side in sides if table == "objects" else ("",):
                sources[table, side] = [*_KEYS[table], *stored]
    tables = store.read_pairs(pair_ids, sources)
    objects = pd.concat([_of_side(side, tables) for side in sides], ignore_index=True)
    if by_reference:
        n_real = tables["objects", "real"].groupby("pair").size()
        has_real_id = objects["community_id"] < objects["pair"].map(n_real)
        objects.loc[(objects["fate"] == "extra") & has_real_id, "fate"] = "remnant"
    for name in columns:
        if name in _COMPUTED:
            of_columns, compute = _COMPUTED[name]
            objects[name] = compute(*(objects[column].to_numpy() for column in of_columns))
    objects.insert(0, "pair_id", np.array(pair_ids, dtype=object)[objects["pair"]])
    return objects


def _of_side(side: str, tables: Mapping[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """The objects of one side of some pairs, with `partner` and `fate`."""
    other = "sim" if side == "real" else "real"
    scores = tables["metrics", ""].rename(
        columns={f"{side}_id": "community_id", f"{other}_id": "partner"}
    )
    objects = tables["objects", side].assign(side=side)
    objects = objects.merge(scores, how="left", on=["pair", "community_id"])
    if ("coverage", "") in tables:
        of_objects = tables["coverage", ""].dropna(subset="community_id")
        objects = objects.merge(of_objects, how="left", on=["pair", "side", "community_id"])
    objects["fate"] = np.where(objects["partner"].notna(), "matched", _ALONE[side])
    counts = [name for name in _COUNTS if name in objects]
    objects[counts] = objects[counts].fillna(0)
    objects["partner"] = objects["partner"].fillna(-1)
    return objects.astype(dict.fromkeys([*counts, "partner"], np.int32))


def plain_rows(rows: pd.DataFrame) -> list[Row]:
    """The rows of a frame as dictionaries of Python's values, None for null."""
    objects = rows.astype(object)
    records: Any = objects.where(objects.notna(), None).to_dict("records")
    return list(records)
