"""Stage nvs, an extra: scores of papers on LiDAR synthesis, of each pair and of all scans at once."""

from __future__ import annotations

import math
from base64 import b85decode, b85encode
from collections.abc import Iterable, Iterator, Sequence
from typing import Any
from zlib import compress, decompress

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import BEV_JSD, BEV_MMD, NVS_SCORES
from ...schemas.record import OF_DATASET, OF_SCAN
from ...schemas.settings import Settings
from ...schemas.tables import TABLES
from ...stages.arrays import FloatArray
from ..stage import Grain, Inputs, JobResult, Stage
from ..storage.table_files import JobRecord
from .baselines_job import summary_row
from .points_job import coordinates

#: More scans than this are represented by that many, evenly spaced, in the discrepancy of all.
MOST_SCANS = 500


def make_nvs(own: Inputs) -> JobResult:
    """Score the clean points of both sides, ground included; the metadata hold the values and the maps from above."""
    from ...stages import nvs

    tables = [own.table("ground", side) for side in SIDES]
    real, sim = points = [coordinates(table) for table in tables]
    scores = nvs.score_pair(real, sim, (_intensity(tables[0]), _intensity(tables[1])), watch=own.step)
    rows = [
        {"pair_id": own.pair_id, "score": each.name, "value": each.value, "unit": each.unit, "reason": each.reason}
        for each in scores
    ]
    maps = {side: _as_text(nvs.map_from_above(own)) for side, own in zip(SIDES, points, strict=True)}
    return JobResult(
        {"nvs": TABLES["nvs"].from_rows(rows)}, {"values": {each.name: each.value for each in scores}, "maps": maps}
    )


def summarise_nvs(records: Iterable[JobRecord], settings: Settings) -> dict[str, Any]:
    """Mean and standard deviation (n - 1) of each score over pairs, and the distances of the maps of all scans."""
    finished = sorted(records, key=lambda record: record.pair_id)
    summary = []
    for name in (metric.column for metric in NVS_SCORES):
        values = [record.metadata["values"][name] for record in finished]
        n_null = values.count(None)
        summary.append(summary_row(name, OF_SCAN, values, len(values) - n_null, n_null))
    return {"nvs": [*summary, *(_of_dataset(finished) if finished else ())]}


def _of_dataset(records: Sequence[JobRecord]) -> Iterator[Row]:
    """Distance of the sums of all maps, and discrepancy of the single maps."""
    from ...stages import nvs

    n = len(records)
    chosen = set(np.linspace(0, n - 1, min(n, MOST_SCANS)).astype(int).tolist())
    sums, single = [], []
    for side in SIDES:
        total, kept = np.zeros(()), []
        for i, record in enumerate(records):
            own = _as_map(record.metadata["maps"][side])
            total = total + own
            if i in chosen:
                kept.append(own.ravel())
        sums.append(total)
        single.append(np.array(kept))
    for metric, value, size in (
        (BEV_JSD, nvs.map_distance(*sums), n),
        (BEV_MMD, nvs.map_discrepancy(*single), len(chosen)),
    ):
        known = None if isinstance(value, str) else value
        n_null = size if known is None else 0
        yield summary_row(metric.column, OF_DATASET, [known], size - n_null, n_null)


def _intensity(table: pa.Table) -> FloatArray | None:
    intensity = table.column("intensity")
    return None if intensity.null_count else intensity.to_numpy()


def _as_text(counts: FloatArray) -> str:
    """A map as a few kilobytes of text, for the metadata."""
    return b85encode(compress(counts.astype("<u4").tobytes())).decode()


def _as_map(text: str) -> FloatArray:
    """The map of `_as_text`."""
    counts = np.frombuffer(decompress(b85decode(text)), dtype="<u4").astype(np.float64)
    return counts.reshape(math.isqrt(len(counts)), -1)


def _is_wanted(settings: Settings) -> bool:
    return settings.nvs.scores


STAGE = Stage(
    name="nvs",
    takes={"ground": ("x", "y", "z", "intensity")},
    gives=("nvs",),
    settings=("nvs",),
    grain=Grain.PAIR,
    make=make_nvs,
    libraries=("scikit-image",),
    is_wanted=_is_wanted,
    summarise=summarise_nvs,
)
