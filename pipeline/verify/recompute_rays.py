"""The tables of rays once more: pairs, outcomes and scores by `stages.literal`, the rest by the same code."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import INTENSITY_SCORES
from ...stages.literal import literal_method
from ...stages.literal import literal_rays as literal
from ...stages.rays import find_rays
from ..jobs.rays_job import rays_result
from .stored import StoredPair

_KEYS = ["beam", "column"]
#: Rays that one side alone returned and whose distance to the other side is computed again, of a sampled pair.
_DRAWN = 200


def rays(pair: StoredPair) -> None:
    """All rays by the same code; outcomes from stored ranges, partners from all directions, scores from stored rays."""
    sensors = [pair.metadata("sensor", side)["sensor"] for side in SIDES]
    moved = pair.metadata("ground", "sim")["T_real_sim"]
    T_real_sim = np.array(moved).reshape(3, 4) if moved else None
    points = [pair.sides[side].all_points for side in SIDES]
    found = find_rays(points[0], points[1], (sensors[0], sensors[1]), T_real_sim)
    ground = [pair.run.read_table("ground", pair.pair_id, side) for side in SIDES]
    again = rays_result(pair.pair_id, found, ground, pair.settings.input)
    for name, table in again.tables.items():
        pair.compare(name, table.to_pandas().drop(columns="pair_id"))
    pair.compare_row({"rays_reason": found if isinstance(found, str) else None})
    stored = pair.table("rays")
    _compare_outcomes(pair, stored, math.hypot(*(sensor["range_noise_m"] or 0.0 for sensor in sensors)))
    if pair.whole_sides and len(stored):
        partner = literal.partners(points[0], points[1], sensors[0], sensors[1])
        real_ids, sim_ids = (pair.table("ground", side)["point_id"].to_numpy() for side in SIDES)
        ids = {real_ids[i]: sim_ids[j] for i, j in partner.items()}
        own = stored[stored["real_point_id"].notna()]
        pair.compare("rays", own[_KEYS].assign(sim_point_id=own["real_point_id"].map(ids)), is_whole=False)
    _compare_scores(pair, stored)


def _compare_outcomes(pair: StoredPair, stored: pd.DataFrame, noise_m: float) -> None:
    """Compare ranges of the real returns, and what became of each ray."""
    real, sim_points = pair.table("ground", "real").set_index("point_id"), pair.sides["sim"].all_points
    own = stored[stored["real_point_id"].notna()]
    hits = real.loc[own["real_point_id"], ["x", "y", "z"]]
    range_m = np.sqrt((hits.to_numpy() ** 2).sum(axis=1))
    pair.compare("rays", own[_KEYS].assign(real_range_m=range_m), is_whole=False)
    single = np.flatnonzero(own["sim_point_id"].isna())
    step = 1 if pair.whole_sides else max(1, len(single) // _DRAWN)
    looked_at, places = own.index[single[::step]], hits.to_numpy()[single[::step]]
    nearest = {i: literal_method.distances(sim_points, place).min() for i, place in zip(looked_at, places, strict=True)}
    known = stored.drop(index=own.index[single].difference(looked_at))
    ranges = zip(known.index, known["real_range_m"], known["sim_range_m"], strict=True)
    outcomes = [literal.outcome(a, b, noise_m, nearest.get(i, np.inf)) for i, a, b in ranges]
    pair.compare("rays", known[_KEYS].assign(outcome=outcomes), is_whole=False)


def _compare_scores(pair: StoredPair, stored: pd.DataFrame) -> None:
    """Compare the scores of all rays, of each group and of the intensities with those of the stored rays."""
    range_m = stored["real_range_m"].fillna(stored["sim_range_m"])
    n_columns = stored.groupby("beam")["column"].max().min() + 1
    azimuth = (stored["column"].clip(upper=n_columns - 1) + 0.5) * 360.0 / n_columns - 180.0
    values = {"range": range_m, "incidence": stored["incidence_deg"], "azimuth": azimuth}
    rays = _columns(stored)
    whole = literal.scores(rays)
    rows = []
    for by, band in pair.table("ray_scores")[["by", "band"]].itertuples(index=False):
        if by in values:
            words = band.split()
            low, high = (float(words[1]), np.inf) if words[0] == "over" else (float(words[0]), float(words[2]))
            own = stored[(values[by] >= low) & (values[by] < high)]
        else:
            own = stored if by == "all" else stored[stored["label"] == band]
        rows.append({"by": by, "band": band} | literal.scores(_columns(own)))
        if by not in ("all", "azimuth"):  # rays without any return have no range, incidence or class
            rows[-1]["rays_drop_f1"] = None
    pair.compare("ray_scores", pd.DataFrame(rows, columns=["by", "band", *whole]))
    expected: Row = dict.fromkeys((*whole, *(metric.column for metric in INTENSITY_SCORES), "intensity_note"))
    if len(stored):
        of_point = {side: pair.table("ground", side).set_index("point_id")["intensity"].astype(float) for side in SIDES}
        intensity = {side: own.reindex(stored[f"{side}_point_id"]).to_numpy() for side, own in of_point.items()}
        has_one_scale = pair.settings.input.intensity_scale == "same"
        expected |= whole | literal.intensity_scores(rays, intensity, has_one_scale=has_one_scale)
    pair.compare_row(expected)


def _columns(rays: pd.DataFrame) -> dict[str, Any]:
    """Columns as arrays, with None for no label."""
    labels = rays["label"].astype(object)
    return {str(name): own.to_numpy() for name, own in rays.assign(label=labels.where(labels.notna(), None)).items()}
