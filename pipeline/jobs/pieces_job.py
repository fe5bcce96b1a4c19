"""Stage pieces: connected parts of either side's surface that the other side lacks, and which of them moved."""

from __future__ import annotations

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...stages.objects import majority_labels
from ...stages.pieces import Pieces, count_pieces, find_pieces
from ..stage import OF_PAIR, Inputs, JobResult, Stage
from .points_job import by_axis, cut_scan, object_columns


def make_pieces(inputs: Inputs) -> JobResult:
    """Find the missing and the invented pieces, one row for each."""
    tables = [inputs.table("ground", side) for side in SIDES]
    real, sim = map(cut_scan, tables)
    with inputs.step("pieces"):
        both = find_pieces(real, sim, inputs.settings.pieces)
    parts = []
    for side, pieces, table in zip(SIDES, both, tables, strict=True):
        inside = pieces.labels >= 0
        known = table.column("label").filter(pa.array(inside)).to_pylist()
        labels = (
            majority_labels(pieces.labels[inside], known, len(pieces.partner)) if known else []
        )
        parts.append(_columns(pieces) | {"side": side, "label": labels})
    return JobResult(inputs.columns("pieces", *parts), {OF_PAIR: count_pieces(*both)})


def _columns(pieces: Pieces) -> Row:
    """One row per piece, without its side and its class."""
    has_moved = pieces.partner >= 0
    columns = {
        "piece_id": np.arange(len(has_moved)),
        "bearing_deg": pieces.bearing_deg,
        "height_m": pieces.height_m,
        "fate": np.where(has_moved, "moved", "gone"),
        "partner_id": np.where(has_moved, pieces.partner, np.nan),
    }
    return columns | object_columns(pieces.objects) | by_axis("moved_{}_m", pieces.moved_m)


STAGE = Stage(
    name="pieces",
    takes=("ground",),
    gives=("pieces",),
    settings=("pieces",),
    make=make_pieces,
)
