"""Table of the beams of a run: what each of them returned, and its errors of range and elevation."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import scipy

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ..report.view import Note, Table, View
from ..results.causes import size_words
from ..results.finished import FinishedRun

_BEAMS = 5
_RAYS = ["beam", "outcome", "real_range_m", "sim_range_m", "real_point_id", "sim_point_id"]
#: Errors: column of half the interval, unit, words above and below 0, and the least that stands out.
_ERRORS = {
    "range_error_m": ("range_half_m", "m", ("too far", "too near"), 0.01),
    "elevation_error_deg": ("elevation_half_deg", "degrees", ("too high", "too low"), 0.02),
}
#: A beam stands out by an error of which the interval lies beyond both: this many standard deviations of the errors of
#: the beams around it (from their median absolute error), and the least error.
_DEVIATIONS, _AROUND = 3.0, 9
_HEADINGS = ("beam", "pairs", "at °", "rays", "only real", "only sim", "range cm", "±", "angle °", "±")


def beam_table(folder: Path, floor: Path | None = None, pattern: str | None = None) -> pd.DataFrame:
    """Means over the pairs by beam of the real sensor, from the lowest up.

    Parameters
    ----------
    floor : run on the same real scans whose errors are subtracted
    pattern : only these pairs

    Returns
    -------
    n_pairs : in which the beam returned
    elevation_deg : of its real returns, median
    n_rays : with a return on either side, per pair
    lost, added : shares of them that only the real and only the simulated side returned
    range_error_m, elevation_error_deg : medians of simulated minus real over the rays that both returned (minus that of
        the floor), minus the running median over five beams: flaws of the world change neighbouring beams equally
    range_half_m, elevation_half_deg : half of the 95 % interval over pairs, Student's t

    Raises
    ------
    RunError
        A folder is not a finished run, or no pair has rays (also in the floor).
    """
    runs = [FinishedRun(path) for path in (folder, floor) if path]
    scored = set.intersection(*({row["pair_id"] for row in run.scored} for run in runs))
    found = {name: [_of_pair(run, name) for run in runs] for name in runs[0].select(pattern) if name in scored}
    found = {name: parts for name, parts in found.items() if all(map(len, parts))}
    if not found:
        where = f" here and in {floor}" if floor else ""
        raise RunError(f"run {folder}: no pair has rays{where}; fidpipe show {folder} PAIR says why")
    errors = [*_ERRORS]
    for own, *base in found.values():
        if base:
            own[errors] -= base[0][errors]
        own[errors] -= own[errors].rolling(_BEAMS, center=True, min_periods=_BEAMS // 2 + 1).median()
    by_beam = pd.concat({name: parts[0] for name, parts in found.items()}).groupby("beam")
    table: pd.DataFrame = by_beam.mean()
    table.insert(0, "n_pairs", by_beam.size())
    reach = scipy.stats.t.ppf(0.975, table.n_pairs - 1) / np.sqrt(table.n_pairs)
    for error, (half, *_) in _ERRORS.items():
        table.insert([*table].index(error) + 1, half, by_beam[error].std() * reach)
    return table


def _of_pair(run: FinishedRun, pair_id: str) -> pd.DataFrame:
    """Quantities of the beams of one pair, without rows if it has no rays."""
    rays = run.read_table("rays", pair_id, columns=_RAYS).to_pandas()
    for side in SIDES:
        points = run.read_table("ground", pair_id, side, ["point_id", "x", "y", "z"]).to_pandas()
        elevation = np.degrees(np.arctan2(points.z, np.hypot(points.x, points.y)))
        rays[side] = rays[f"{side}_point_id"].map(pd.Series(elevation.to_numpy(), points.point_id))
    rays = rays[rays.outcome != "none"].assign(
        range_error_m=rays.sim_range_m - rays.real_range_m, elevation_error_deg=rays.sim - rays.real
    )
    by_beam = rays.groupby("beam")
    return pd.DataFrame(
        {
            "elevation_deg": by_beam.real.median(),
            "n_rays": by_beam.size(),
            "lost": rays.sim_range_m.isna().groupby(rays.beam).mean(),
            "added": rays.real_range_m.isna().groupby(rays.beam).mean(),
        }
    ).join(by_beam[[*_ERRORS]].median())


def beam_view(table: pd.DataFrame, has_floor: bool) -> View:
    """A row per beam, and the beams that stand out."""
    shown = table.assign(range_error_m=100 * table.range_error_m, range_half_m=100 * table.range_half_m)
    notes = [
        "range, angle: errors, simulated minus real, over the rays that both returned"
        f"{', minus those of the floor' * has_floor}, minus the running median over {_BEAMS} beams"
    ]
    notes += outstanding(table) or ["no beam stands out"]
    plain = shown.astype(object).where(shown.notna(), None).reset_index().to_numpy().tolist()
    beams = Table("Beams, mean over pairs", _HEADINGS, plain, words=(), digits={2: 1, 3: 0, 6: 1, 7: 1})
    return [beams, *map(Note, notes)]


def outstanding(table: pd.DataFrame) -> list[str]:
    """Sentences on the beams that stand out by an error, largest first; none with fewer than three pairs.

    The intervals hold for all beams and both errors at once (Bonferroni).
    """
    found, df = [], table.n_pairs - 1
    wider = scipy.stats.t.ppf(1 - 0.025 / (2 * len(table)), df) / scipy.stats.t.ppf(0.975, df)
    for error, (half, unit, words, least) in _ERRORS.items():
        size = table[error].abs()
        spread = 1.4826 * size.rolling(_AROUND, center=True, min_periods=1).median()
        is_out = (df > 1) & (size - wider * table[half] > (_DEVIATIONS * spread).clip(lower=least))
        for beam in size[is_out].sort_values(ascending=False).index:
            direction = words[int(table[error][beam] < 0)]
            own, reach = size_words(size[beam], unit), size_words(table[half][beam], unit)
            found.append(f"beam {beam}: {own} {direction} (± {reach})")
    return found
