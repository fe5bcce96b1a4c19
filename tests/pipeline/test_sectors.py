"""Scores by direction: the parts of a pair add up to the pair."""

import numpy as np
import pytest

from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.sectors import N_SECTORS, sector_rows
from fidpipe.schemas.metric_catalogue import RAY_SCORES


@pytest.mark.parametrize("preset", ["paper", "reference"])
def test_the_mean_over_the_sectors_is_the_value_of_the_pair(preset, report_run, by_reference):
    run = FinishedRun({"paper": report_run, "reference": by_reference}[preset])
    every = sector_rows(run, [pair["pair_id"] for pair in run.scored])
    for i, pair in enumerate(run.scored):
        rows = every[N_SECTORS * i : N_SECTORS * (i + 1)]
        assert len(rows) == N_SECTORS
        for column in rows[0].keys() - {
            "shift_x_m",
            "shift_y_m",
            "shift_z_m",
            *(metric.column for metric in RAY_SCORES),
        }:
            assert np.mean([row[column] for row in rows]) == pytest.approx(
                pair[column] or 0.0, abs=1e-9
            ), column
