"""Stage pieces: connected parts of either side's surface that the other side lacks, and which of them moved."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...schemas.tables import TABLES
from ...stages.objects import majority_labels
from ...stages.pieces import CutScan, Pieces, count_pieces, find_pieces
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Stage
from .points_job import column, coordinates, nulls_for_nan

_PLACE = ("cx", "cy", "cz", "extent_x", "extent_y", "extent_z", "range_m", "bearing_deg", "height_m")
_MOVED = ("moved_x_m", "moved_y_m", "moved_z_m")


def make_pieces(own: Inputs) -> JobResult:
    """Find the missing and the invented pieces, one row for each."""
    tables = [own.table("ground", side) for side in SIDES]
    real, sim = (CutScan(coordinates(table), column(table, "is_ground"), column(table, "height_m")) for table in tables)
    with own.step("pieces"):
        both = find_pieces(real, sim, own.settings.pieces)
    rows: list[Row] = []
    for side, pieces, table in zip(SIDES, both, tables, strict=True):
        inside = pieces.labels >= 0
        known = table.column("label").filter(pa.array(inside)).to_pylist()
        labels = majority_labels(pieces.labels[inside], known, len(pieces.partner)) if known else []
        common = {"pair_id": own.pair_id, "side": side}
        rows += [common | row | {"label": label} for row, label in zip(_rows(pieces), labels, strict=True)]
    return JobResult({"pieces": TABLES["pieces"].from_rows(rows)}, {OF_PAIR: count_pieces(*both)})


def _rows(pieces: Pieces) -> list[Row]:
    """One row per piece, without the columns that name its side and its class."""
    own = pieces.objects
    place = np.column_stack([own.centroid, own.extent, own.range_m, pieces.bearing_deg, pieces.height_m]).tolist()
    moves = zip(pieces.partner.tolist(), pieces.moved_m.tolist(), strict=True)
    return [
        {"piece_id": i, "n_points": n, "fate": "gone" if partner < 0 else "moved"}
        | {"partner_id": None if partner < 0 else partner}
        | dict(zip(_PLACE, where, strict=True))
        | dict(zip(_MOVED, nulls_for_nan(vector), strict=True))
        for i, (n, where, (partner, vector)) in enumerate(zip(own.n_points.tolist(), place, moves, strict=True))
    ]


STAGE = Stage(
    name="pieces",
    takes={"ground": ("x", "y", "z", "height_m", "is_ground", "label")},
    gives=("pieces",),
    settings=("pieces",),
    grain=Grain.PAIR,
    make=make_pieces,
)
