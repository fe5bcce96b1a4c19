"""The objects of a run as one data frame: size, place, class, coverage, fate, and the scores of matched objects.

Everything that describes many objects reads this frame: findings, overview, measures, comparisons, exports, reports.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import QUADRANT_LIMITS
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
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
    COLUMNS_OF[_table] = tuple(
        name for name in TABLES[_table].schema.names if name not in _known
    )

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
EXTENTS = ("extent_x", "extent_y", "extent_z")
#: Names with units, for Python users.
WITH_UNITS = {f"c{axis}": f"{axis}_m" for axis in "xyz"} | {
    name: f"{name}_m" for name in EXTENTS
}


def object_frame(
    store: RunFolder,
    pair_ids: Sequence[str],
    columns: Collection[str] | None = None,
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
    columns : of `objects`, `coverage` and `metrics`; by default all, and shape (of `SHAPES`), bearing_deg (0 ahead, 90
        left), diagonal_m (of the bounding box) and quadrant. Scores of unmatched objects are NaN, their counts 0
    by_reference : True if the real side fixes the objects
    sides : both, or only "real"

    Raises
    ------
    RunError
        A table is damaged or gone.
    """
    import pandas as pd

    sources: dict[tuple[str, str], list[str]] = {}
    for table, known in COLUMNS_OF.items():
        stored = [name for name in known if columns is None or name in columns]
        for side in sides if table == "objects" else ("",):
            sources[table, side] = [*_KEYS[table], *stored]
    tables = store.read_pairs(pair_ids, sources)
    objects = pd.concat([_of_side(side, tables) for side in sides], ignore_index=True)
    if by_reference:
        n_real = tables["objects", "real"].groupby("pair").size()
        has_real_id = objects["community_id"] < objects["pair"].map(n_real)
        objects.loc[(objects["fate"] == "extra") & has_real_id, "fate"] = "remnant"
    objects.insert(0, "pair_id", np.array(pair_ids, dtype=object)[objects["pair"]])
    return _described(objects) if columns is None else objects


def _described(objects: pd.DataFrame) -> pd.DataFrame:
    """The objects with the columns that are computed from others."""
    x, y = objects[["cx", "cy"]].to_numpy().T
    return objects.assign(
        shape=shape_of(*objects[[*SHAPES]].to_numpy().T),
        bearing_deg=np.degrees(np.arctan2(y, x)),
        diagonal_m=np.linalg.norm(objects[[*EXTENTS]], axis=1),
        quadrant=quadrant_of(*objects[["cdc", "r_lambda"]].to_numpy().T),
    )


def _of_side(side: str, tables: Mapping[tuple[str, str], pd.DataFrame]) -> pd.DataFrame:
    """The objects of one side of some pairs, with `partner` and `fate`."""
    other = "sim" if side == "real" else "real"
    scores = tables["metrics", ""].rename(
        columns={f"{side}_id": "community_id", f"{other}_id": "partner"}
    )
    objects = tables["objects", side].assign(side=side)
    objects = objects.merge(scores, how="left", on=["pair", "community_id"])
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
