"""Scores of a pair by direction from the sensor: what neighbouring frames of one place have in independent parts.

Ten neighbouring frames see one street, so that a defect which is fixed in the world counts ten times; but a defect on
the left says nothing about the right. Simulators that are equal but for such defects differ by chance in each sector.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import COVERAGE_REACHES, METRIC, metrics_in
from ...stages.arrays import FloatArray, IndexArray
from .finished import FinishedRun

#: Number of sectors of direction, the first one from straight ahead to the left.
N_SECTORS = 8
#: Compared scores of objects.
_SCORES = tuple(metric.column for metric in metrics_in("compare") if metric.group == "object")
_COLUMNS = ("cx", "cy", *(f"covered_{reach}" for reach in COVERAGE_REACHES), *_SCORES)
_PIECES = ["side", "n_points", "cx", "cy"]


def sector_frame(run: FinishedRun, pair_ids: Sequence[str]) -> pd.DataFrame:
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
    pieces = run.store.read_pairs(pair_ids, {("pieces", ""): _PIECES})["pieces", ""]
    n_pairs = len(pair_ids)
    columns: dict[str, FloatArray] = {}
    for side, kind in zip(SIDES, ("missing", "invented"), strict=True):
        of_side = objects[objects["side"] == side]
        alone = pieces[pieces["side"] == side]
        n_points = np.maximum(1, np.bincount(of_side["pair"], of_side["n_points"], n_pairs))
        for reach in COVERAGE_REACHES:
            covered = of_side["n_points"] * of_side[f"covered_{reach}"].fillna(0.0)
            columns[f"covered_{side}_{reach}"] = _parts(of_side, covered, n_points)
        columns[f"n_{kind}_pieces"] = _parts(alone, 1.0, np.ones(n_pairs))
        columns[f"{kind}_pieces_share"] = _parts(alone, alone["n_points"], n_points)
    matched = objects[(objects["side"] == "real") & (objects["fate"] == "matched")]
    for name in _SCORES:
        known = matched.dropna(subset=name)
        n_known = np.bincount(known["pair"], minlength=n_pairs)
        columns[METRIC[name].mean_column] = _parts(known, known[name], n_known)
    counted = objects[objects["fate"] != "remnant"]
    n_real, n_sim = [
        np.bincount(counted.loc[counted["side"] == side, "pair"], minlength=n_pairs)
        for side in SIDES
    ]
    columns["found"] = _parts(matched, 1.0, n_real)
    columns["match_rate"] = _parts(matched, 1.0, np.maximum(n_real, n_sim))
    return pd.DataFrame(columns)


def _parts(rows: pd.DataFrame, values: Any, totals: Any) -> FloatArray:
    """Sums of values by pair and sector over the total of the pair, (n_pairs * 8,), times the number of sectors.

    Parameters
    ----------
    rows : objects or pieces
    values : one per row, or the same for all
    totals : (n_pairs,)
    """
    y, x = rows[["cy", "cx"]].fillna(0.0).to_numpy().T
    bearing = np.arctan2(y, x)
    sector: IndexArray = np.floor(bearing / (2 * np.pi) * N_SECTORS).astype(np.intp) % N_SECTORS
    pair = rows["pair"].to_numpy()
    sums = np.bincount(pair * N_SECTORS + sector, values / totals[pair], len(totals) * N_SECTORS)
    return np.asarray(N_SECTORS * sums, dtype=np.float64)
