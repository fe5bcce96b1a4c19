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
from .object_frame import PAIRS_AT_ONCE, object_parts

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
    rows: list[Row] = []
    for part in object_parts(run.store, pair_ids, _COLUMNS, by_reference=run.is_by_reference):
        names = pair_ids[len(rows) // N_SECTORS :][:PAIRS_AT_ONCE]
        part["pair"] -= len(rows) // N_SECTORS
        table, n_rows = run.store.read_pairs(names, {("pieces", ""): _PIECES})["pieces", ""]
        pieces = table.to_pandas().assign(pair=np.repeat(np.arange(len(names)), n_rows))
        found = _surface_parts(part, pieces, len(names)) | _object_parts(part, [run.row(name) for name in names])
        values = np.stack([*found.values()], axis=-1).reshape(-1, len(found))
        rows += [dict(zip(found, own, strict=True)) for own in values.tolist()]
    return rows


def _surface_parts(objects: pd.DataFrame, pieces: pd.DataFrame, n_pairs: int) -> dict[str, FloatArray]:
    """Coverage and pieces by pair and sector."""
    found = {}
    for side, kind in zip(SIDES, ("missing", "invented"), strict=True):
        own = objects[objects["side"] == side]
        of_side = pieces[pieces["side"] == side]
        n_all = np.maximum(1, np.bincount(own["pair"], own["n_points"], n_pairs))
        for reach in COVERAGE_REACHES:
            covered = own["n_points"] * own[f"covered_{reach}"].fillna(0.0)
            found[f"covered_{side}_{reach}"] = _parts(own, covered / n_all[own["pair"]], n_pairs)
        found[f"n_{kind}_pieces"] = _parts(of_side, np.ones(len(of_side)), n_pairs)
        found[f"{kind}_pieces_share"] = _parts(of_side, of_side["n_points"] / n_all[of_side["pair"]], n_pairs)
    return found


def _object_parts(objects: pd.DataFrame, rows: Sequence[Row]) -> dict[str, FloatArray]:
    """Scores of objects, and shares of objects that are matched, by pair and sector."""
    n_pairs = len(rows)
    found = {}
    matched = objects[(objects["side"] == "real") & (objects["partner"] >= 0)]
    for name in _SCORES:
        known = matched.dropna(subset=name)
        n_known = np.bincount(known["pair"], minlength=n_pairs)
        found[METRIC[name].mean_column] = _parts(known, known[name] / n_known[known["pair"]], n_pairs)
    n_real = np.array([row["n_matched"] + row["n_missing"] for row in rows])
    n_sim = np.array([row["n_matched"] + row["n_hallucinated"] for row in rows])
    found["found"] = _parts(matched, 1 / n_real[matched["pair"]], n_pairs)
    found["match_rate"] = _parts(matched, 1 / np.maximum(n_real, n_sim)[matched["pair"]], n_pairs)
    return found


def _parts(objects: pd.DataFrame, values: Any, n_pairs: int) -> FloatArray:
    """(n_pairs, 8) sums over the objects of each sector times the number of sectors; without a place: the first."""
    bearing = np.arctan2(*(objects[axis].fillna(0.0).to_numpy() for axis in ("cy", "cx")))
    sector: IndexArray = np.floor(bearing / (2 * np.pi) * N_SECTORS).astype(np.intp) % N_SECTORS
    place = objects["pair"].to_numpy() * N_SECTORS + sector
    totals = np.bincount(place, np.asarray(values, dtype=np.float64), n_pairs * N_SECTORS)
    return np.asarray(N_SECTORS * totals, dtype=np.float64).reshape(n_pairs, N_SECTORS)
