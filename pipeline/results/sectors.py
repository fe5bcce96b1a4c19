"""Scores of a pair by direction from the sensor: what neighbouring frames of one place have in independent parts.

Ten neighbouring frames see one street, so that a defect which is fixed in the world counts ten times; but a defect on
the left says nothing about the right. Simulators that are equal but for such defects differ by chance in each sector.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import COVERAGE_REACHES, METRIC, metrics_in
from ...stages.arrays import FloatArray, IndexArray
from .finished import FinishedRun

#: Number of sectors of direction, the first one from straight ahead to the left.
N_SECTORS = 8
#: Compared scores of objects.
_SCORES = tuple(metric.column for metric in metrics_in("compare") if metric.group == "object")
_COLUMNS = ("cx", "cy", *(f"covered_{reach}" for reach in COVERAGE_REACHES), *_SCORES)
_PIECES = ["side", "n_points", "cx", "cy"]


def sector_rows(run: FinishedRun, pair_ids: Sequence[str]) -> list[Row]:
    """One row per pair and sector with columns of `pairs`: coverage, pieces, objects.

    An object or a piece belongs to the sector of its centroid. Each value is the sector's part of the pair's times the
    number of sectors, so that the mean over the sectors is the value of the pair.

    Parameters
    ----------
    run : a finished run
    pair_ids : scored pairs

    Raises
    ------
    RunError
        A table of a pair is damaged.
    """
    objects = run.objects_of(pair_ids, _COLUMNS)
    table, n_rows = run.store.read_pairs(pair_ids, {("pieces", ""): _PIECES})["pieces", ""]
    pieces = table.to_pandas().assign(pair=np.repeat(np.arange(len(pair_ids)), n_rows))
    n_pairs = len(pair_ids)
    columns: dict[str, FloatArray] = {}
    for side, kind in zip(SIDES, ("missing", "invented"), strict=True):
        of_side = objects[objects["side"] == side]
        pieces_of_side = pieces[pieces["side"] == side]
        n_points = np.maximum(1, np.bincount(of_side["pair"], of_side["n_points"], n_pairs))
        for reach in COVERAGE_REACHES:
            n_covered = of_side["n_points"] * of_side[f"covered_{reach}"].fillna(0.0)
            parts: Any = n_covered / n_points[of_side["pair"]]
            columns[f"covered_{side}_{reach}"] = _parts(of_side, parts, n_pairs)
        share: Any = pieces_of_side["n_points"] / n_points[pieces_of_side["pair"]]
        ones = np.ones(len(pieces_of_side))
        columns[f"n_{kind}_pieces"] = _parts(pieces_of_side, ones, n_pairs)
        columns[f"{kind}_pieces_share"] = _parts(pieces_of_side, share, n_pairs)
    columns |= _object_parts(objects, [run.row(name) for name in pair_ids])
    rows: Any = pd.DataFrame(columns).to_dict("records")
    return list(rows)


def _object_parts(objects: pd.DataFrame, rows: Sequence[Row]) -> dict[str, FloatArray]:
    """Scores of objects, and shares of objects that are matched, by pair and sector."""
    n_pairs = len(rows)
    columns = {}
    matched = objects[(objects["side"] == "real") & (objects["partner"] >= 0)]
    for name in _SCORES:
        known = matched.dropna(subset=name)
        n_known = np.bincount(known["pair"], minlength=n_pairs)
        parts = known[name] / n_known[known["pair"]]
        columns[METRIC[name].mean_column] = _parts(known, parts, n_pairs)
    n_real = np.array([row["n_matched"] + row["n_not_found"] for row in rows])
    n_sim = np.array([row["n_matched"] + row["n_extra"] for row in rows])
    n_larger = np.maximum(n_real, n_sim)
    columns["found"] = _parts(matched, 1 / n_real[matched["pair"]], n_pairs)
    columns["match_rate"] = _parts(matched, 1 / n_larger[matched["pair"]], n_pairs)
    return columns


def _parts(rows: pd.DataFrame, values: Any, n_pairs: int) -> FloatArray:
    """Sums of values by pair and sector, (n_pairs * 8,), times the number of sectors."""
    y, x = rows[["cy", "cx"]].fillna(0.0).to_numpy().T
    bearing = np.arctan2(y, x)
    sector: IndexArray = np.floor(bearing / (2 * np.pi) * N_SECTORS).astype(np.intp) % N_SECTORS
    place = rows["pair"].to_numpy() * N_SECTORS + sector
    totals: Any = np.bincount(place, values, n_pairs * N_SECTORS)
    return np.asarray(N_SECTORS * totals, dtype=np.float64)
