"""The findings and the overview of all objects of a run, read from its tables some pairs at a time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...schemas.columns import Row
from ...schemas.record import MetricsSummary
from ...schemas.results import Findings, Overview
from ...stages.statistics.comparison import blocks_of
from ...stages.statistics.findings import summarise_objects
from ..storage.folder import RunFolder
from .object_frame import STATISTICS_COLUMNS, arrays_of, object_parts
from .overview import OVERVIEW_COLUMNS, Tally, largest_pieces


def describe_objects(
    store: RunFolder,
    rows: Sequence[Row],
    timestamps_s: Mapping[str, float | None],
    hashes: Mapping[str, Mapping[str, str]],
    *,
    by_reference: bool,
) -> tuple[Findings, Overview, MetricsSummary]:
    """The findings, the overview and the states of unmatched objects, of all scored pairs.

    Parameters
    ----------
    rows : of `pairs`, the scored ones; at least one
    timestamps_s : by pair
    hashes : by pair, content hash of its real scan (`real`)
    by_reference : True if the real side fixes the objects
    """
    pair_ids = [row["pair_id"] for row in rows]
    tally, kept = Tally(), []
    columns = {*STATISTICS_COLUMNS, *OVERVIEW_COLUMNS}
    for part in object_parts(store, pair_ids, columns, by_reference=by_reference):
        tally.add(part)
        kept.append(part[["pair", "side", "fate", *STATISTICS_COLUMNS]])
    objects = arrays_of(kept)
    times = [timestamps_s.get(pair_id) for pair_id in pair_ids]
    n_independent = len(np.unique(blocks_of([hashes[pair_id]["real"] for pair_id in pair_ids], times)))
    findings = Findings(n_independent=n_independent, **vars(summarise_objects(*objects, pair_ids, times)))
    return findings, tally.overview(rows, largest_pieces(store, pair_ids)), tally.unmatched()
