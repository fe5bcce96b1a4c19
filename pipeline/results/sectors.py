"""Scores of a pair by direction from the sensor: what neighbouring frames of one place have in independent parts.

Ten neighbouring frames see one street, so that a defect which is fixed in the world counts ten times; but a defect on
the left says nothing about the right. Simulators that are equal but for such defects differ by chance in each sector.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...schemas.columns import SIDES, Row
from ...schemas.metrics import COVERAGE_REACHES, METRIC, SHIFT_COLUMNS
from ...stages.arrays import FloatArray, IndexArray
from .finished import FinishedRun

#: Directions are divided into this number of sectors, the first one from straight ahead to the left.
N_SECTORS = 8


def sector_rows(run: FinishedRun, pair_id: str) -> list[Row]:
    """One row per sector with columns of `pairs`: coverage, pieces, displacement, scores of objects.

    An object or a piece belongs to the sector of its centroid. Each value is the sector's part of the pair's times the
    number of sectors, so that the mean over the sectors is the value of the pair. A displacement is the mean over the
    sector's points instead, and null without any.

    Parameters
    ----------
    run : a finished run
    pair_id : of a scored pair

    Raises
    ------
    RunError
        A table of the pair is damaged.
    """
    pair = run.covered_objects_of(pair_id)
    pieces = run.read_table("pieces", pair_id).to_pylist()
    found: dict[str, FloatArray] = {}
    for side, kind in zip(SIDES, ("missing", "invented"), strict=True):
        own = pair.sides[side]
        n_all = max(1, sum(row["n_points"] for row in own))
        for reach in COVERAGE_REACHES:
            shares = [row["n_points"] * (row[f"covered_{reach}"] or 0.0) / n_all for row in own]
            found[f"covered_{side}_{reach}"] = _parts(own, shares)
        of_side = [piece for piece in pieces if piece["side"] == side]
        found[f"n_{kind}_pieces"] = _parts(of_side, [1.0] * len(of_side))
        found[f"{kind}_pieces_share"] = _parts(of_side, [piece["n_points"] / n_all for piece in of_side])
    real = pair.sides["real"]
    for name in ("cdc", "r_lambda", "r_gap"):
        known = [row for row in pair.matched if row[name] is not None]
        where = [real[row["real_id"]] for row in known]
        found[METRIC[name].mean_column] = _parts(where, [row[name] / len(known) for row in known])
    n_real, n_sim = (pair.row["n_matched"] + pair.row[name] for name in ("n_missing", "n_hallucinated"))
    where = [real[row["real_id"]] for row in pair.matched]
    found["found"] = _parts(where, [1 / n_real] * len(where))
    found["match_rate"] = _parts(where, [1 / max(n_real, n_sim)] * len(where))
    surface = [row for row in run.read_table("surface", pair_id).to_pylist() if row["real_id"] is not None]
    for column in SHIFT_COLUMNS[:3]:
        known = [row for row in surface if row[column] is not None]
        where = [real[row["real_id"]] for row in known]
        with np.errstate(invalid="ignore"):
            found[column] = _parts(where, [row["n_points"] * row[column] for row in known]) / _parts(
                where, [row["n_points"] for row in known]
            )
    return [dict(zip(found, values, strict=True)) for values in np.stack([*found.values()], axis=1).tolist()]


def _parts(objects: Sequence[Row], values: Sequence[float]) -> FloatArray:
    """(8,) sums over the objects of each sector, times the number of sectors; one without points is in the first."""
    bearing = np.array([np.arctan2(row["cy"] or 0.0, row["cx"] or 0.0) for row in objects], dtype=np.float64)
    sector: IndexArray = np.floor(bearing / (2 * np.pi) * N_SECTORS).astype(np.intp) % N_SECTORS
    totals = np.bincount(sector, np.array(values, dtype=np.float64), N_SECTORS)
    return np.asarray(N_SECTORS * totals, dtype=np.float64)
