"""Stage pieces: connected parts of either side's surface that the other side lacks, and which of them moved."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...schemas.tables import TABLES
from ...stages.objects import majority_labels
from ...stages.pieces import Pieces, count_pieces, find_pieces
from ..stage import OF_PAIR, Grain, Inputs, JobResult, Stage
from .points_job import CUT_COLUMNS, cut_scan, nulls_for_nan

_PLACE = (
    "cx",
    "cy",
    "cz",
    "extent_x",
    "extent_y",
    "extent_z",
    "range_m",
    "bearing_deg",
    "height_m",
)
_MOVED = ("moved_x_m", "moved_y_m", "moved_z_m")


def make_pieces(inputs: Inputs) -> JobResult:
    """Find the missing and the invented pieces, one row for each."""
    tables = [inputs.table("ground", side) for side in SIDES]
    real, sim = map(cut_scan, tables)
    with inputs.step("pieces"):
        both = find_pieces(real, sim, inputs.settings.pieces)
    rows: list[Row] = []
    for side, pieces, table in zip(SIDES, both, tables, strict=True):
        inside = pieces.labels >= 0
        known = table.column("label").filter(pa.array(inside)).to_pylist()
        labels = majority_labels(pieces.labels[inside], known, len(pieces.partner)) if known else []
        for row, label in zip(_rows(pieces), labels, strict=True):
            rows.append({"pair_id": inputs.pair_id, "side": side} | row | {"label": label})
    return JobResult({"pieces": TABLES["pieces"].from_rows(rows)}, {OF_PAIR: count_pieces(*both)})


def _rows(pieces: Pieces) -> list[Row]:
    """One row per piece, without the columns that name its side and its class."""
    objects = pieces.objects
    places = np.column_stack(
        [
            objects.centroid,
            objects.extent,
            objects.range_m,
            pieces.bearing_deg,
            pieces.height_m,
        ]
    ).tolist()
    partners = pieces.partner.tolist()
    moves = pieces.moved_m.tolist()
    rows = []
    for piece_id, n_points in enumerate(objects.n_points.tolist()):
        has_moved = partners[piece_id] >= 0
        row: Row = {
            "piece_id": piece_id,
            "n_points": n_points,
            "fate": "moved" if has_moved else "gone",
            "partner_id": partners[piece_id] if has_moved else None,
        }
        row |= zip(_PLACE, places[piece_id], strict=True)
        row |= zip(_MOVED, nulls_for_nan(moves[piece_id]), strict=True)
        rows.append(row)
    return rows


STAGE = Stage(
    name="pieces",
    takes={"ground": (*CUT_COLUMNS, "label")},
    gives=("pieces",),
    settings=("pieces",),
    grain=Grain.PAIR,
    make=make_pieces,
)
