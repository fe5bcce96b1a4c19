"""Scores by direction: the parts of a pair add up to the pair."""

import numpy as np
import pytest

from fidpipe.pipeline.results.finished import FinishedRun
from fidpipe.pipeline.results.sectors import N_SECTORS, sector_frame


@pytest.mark.parametrize("preset", ["paper", "reference"])
def test_the_mean_over_the_sectors_is_the_value_of_the_pair(preset, report_run, by_reference):
    run = FinishedRun({"paper": report_run, "reference": by_reference}[preset])
    every = sector_frame(run, [pair["pair_id"] for pair in run.scored])
    means = every.groupby(np.repeat(np.arange(len(run.scored)), N_SECTORS)).mean()
    for i, pair in enumerate(run.scored):
        for column in every:
            assert means[column][i] == pytest.approx(pair[column] or 0.0, abs=1e-9), column
