"""Scores of a pair by direction from the sensor: what neighbouring frames of one place have in independent parts.

Ten neighbouring frames see one street, so that a defect which is fixed in the world counts ten times; but a defect on
the left says nothing about the right. Simulators that are equal but for such defects differ by chance in each sector.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES
from ...schemas.metric_catalogue import COVERAGE_REACHES, METRIC, metrics_in
from ...stages.arrays import FloatArray
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
    weighted = {}
    for side, kind in zip(SIDES, ("missing", "invented"), strict=True):
        of_side = objects[objects["side"] == side]
        for reach in COVERAGE_REACHES:
            covered = of_side["n_points"] * of_side[f"covered_{reach}"]
            weighted[f"covered_{side}_{reach}"] = of_side.assign(weight=covered)
        alone = pieces[pieces["side"] == side]
        weighted[f"n_{kind}_pieces"] = alone.assign(weight=1.0)
        weighted[f"{kind}_pieces_share"] = alone.assign(weight=alone["n_points"])
    matched = objects[(objects["side"] == "real") & (objects["fate"] == "matched")]
    for name in _SCORES:
        weighted[METRIC[name].mean_column] = matched.assign(weight=matched[name])
    weighted["found"] = weighted["match_rate"] = matched.assign(weight=1.0)
    scores = run.scores.loc[[*pair_ids]]
    return pd.DataFrame({name: _parts(rows, scores[name]) for name, rows in weighted.items()})


def _parts(rows: pd.DataFrame, values: pd.Series[float]) -> FloatArray:
    """The values of pairs divided among their sectors by weight, times the number of sectors, (n_pairs * 8,).

    Parameters
    ----------
    rows : objects or pieces with their `weight`, NaN for 0
    values : by pair, NaN for 0
    """
    y, x = rows[["cy", "cx"]].fillna(0.0).to_numpy().T
    sector = np.floor(np.arctan2(y, x) / (2 * np.pi) * N_SECTORS).astype(np.intp) % N_SECTORS
    bins = rows["pair"].to_numpy() * N_SECTORS + sector
    weights = np.bincount(bins, rows["weight"].fillna(0.0), len(values) * N_SECTORS)
    weights = weights.reshape(-1, N_SECTORS)
    totals = weights.sum(axis=1)
    parts = weights * (values.fillna(0.0).to_numpy() / np.where(totals, totals, 1.0))[:, None]
    return np.asarray(N_SECTORS * parts.ravel(), dtype=np.float64)
