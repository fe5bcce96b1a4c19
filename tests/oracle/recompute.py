"""Recompute the tables of a finished run literally; print the largest difference of each stage.

    python tests/oracle/recompute.py RUN

The dataset of the run must be in place. A pair of full scans takes many minutes: all distances,
dense matrices. The exit code is 1 if a difference is beyond its tolerance.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd

from fidpipe.pipeline.datasets.pairs import local_folder, read_dataset
from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.schemas.settings import parse
from literal_tables import STAGES
from stored_pair import StoredPair

#: Absolute and relative tolerance of numbers; texts and nulls must be equal.
TOLERANCE = 1e-9
RELATIVE_TOLERANCE = 1e-12
#: Absolute tolerances of single columns.
TOLERANCES = {
    # stored with nine decimals: two roundings may be one step apart
    "selection.real_influence": 1.5e-9,
    "selection.sim_influence": 1.5e-9,
    # a sum of squares, ill-conditioned in directions that are hardly observable
    "surface.shift_x_m": 1e-8,
    "surface.shift_y_m": 1e-8,
    "surface.shift_z_m": 1e-8,
    "surface.shift_m": 1e-8,
    # scikit-network's Louvain computes in single precision
    "communities.modularity gained by merging two communities": 1e-5,
    # the arccosine is steep where the axis is upright
    "pairs.ground_real_tilt_deg": 1e-5,
    "pairs.ground_sim_tilt_deg": 1e-5,
}


class Difference(NamedTuple):
    """The largest difference of a column; infinite for unequal texts, nulls and rows."""

    stage: str
    pair_id: str
    column: str
    largest: float
    is_too_large: bool


def recompute(folder):
    """Differences of all recomputed columns of all scored pairs of a run."""
    run = FinishedRun(folder)
    settings = parse(run.record.settings)
    dataset = read_dataset(local_folder(run.record.dataset))
    scored = {row["pair_id"] for row in run.scored}
    differences = []
    for pair in dataset.pairs:
        if pair.pair_id not in scored:
            continue
        stored_pair = StoredPair(run, pair, settings, dataset.label_names)
        for stage in STAGES:
            for recomputed in stage(stored_pair):
                differences += [
                    Difference(stage.__name__, pair.pair_id, *column)
                    for column in compare(recomputed)
                ]
    return differences


def compare(recomputed):
    """Name, largest difference, and True if that is beyond the tolerance, of each column."""
    stored = recomputed.stored
    frame = recomputed.recomputed
    has_same_rows = stored.index.equals(frame.index)
    yield f"{recomputed.table}: rows", 0.0 if has_same_rows else np.inf, not has_same_rows
    if not has_same_rows:
        return
    for name in frame.columns:
        column = f"{recomputed.table}.{name}"
        allowed = TOLERANCES.get(column, TOLERANCE)
        if pd.api.types.is_numeric_dtype(stored[name]):
            size = np.abs(stored[name].to_numpy(dtype=float, na_value=0.0))
            allowed = allowed + RELATIVE_TOLERANCE * size
        difference = _difference(stored[name], frame[name])
        yield column, float(difference.max(initial=0.0)), bool(np.any(difference > allowed))


def _difference(stored, recomputed):
    """Absolute difference of each value; infinite if one of both is null, or for unequal texts."""
    is_null = stored.isna().to_numpy()
    difference = np.where(is_null == recomputed.isna().to_numpy(), 0.0, np.inf)
    is_known = ~is_null & (difference == 0.0)
    a = stored[is_known].to_numpy()
    b = recomputed[is_known].to_numpy()
    try:
        difference[is_known] = np.abs(a.astype(float) - b.astype(float))
    except ValueError:
        difference[is_known] = np.where(a.astype(str) == b.astype(str), 0.0, np.inf)
    return difference


def main(folder):
    """Print a line per stage; return the exit code."""
    differences = recompute(folder)
    for stage in STAGES:
        name = stage.__name__
        of_stage = [difference for difference in differences if difference.stage == name]
        if of_stage:
            worst = max(of_stage, key=lambda row: (row.is_too_large, row.largest))
            verdict = "TOO LARGE" if worst.is_too_large else "ok"
            place = f"pair {worst.pair_id}, {worst.column}"
            print(f"{name:12} {worst.largest:8.1e}  {verdict:9}  {place}")
    return 1 if any(difference.is_too_large for difference in differences) else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
