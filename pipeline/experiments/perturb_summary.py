"""What the repeats of `fidpipe perturb` say together: mean and standard deviation of each metric at each level.

Leaves to others: the repeats themselves (`perturb_jobs`), whether the paper's claims hold (`perturb_claims`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.tables import OBJECT_METRICS, PERTURB_SUMMARY, TABLES
from ...stages.perturbations import Perturbation
from ...stages.summary import mean_and_std
from ..store import JobRecord, key_of
from .sweep import Sweep

GLOBAL_METRICS = ("match_rate", *(f"{metric}_mean" for metric in OBJECT_METRICS))
SUMMARY = "perturb_summary"


def summarise(sweep: Sweep, levels: Sequence[Perturbation]) -> pa.Table:
    """Writes and returns the rows of `perturb_summary`, over the repeats of all scans."""
    records = [of for of in sweep.store.records.values() if of.stage in ("perturb_global", "perturb_objects")]
    rows: list[dict[str, Any]] = []
    for table, scope, metrics in (
        ("perturb_global", "global", GLOBAL_METRICS),
        ("perturb_objects", "object", OBJECT_METRICS),
    ):
        found = _read(sweep, [record for record in records if record.stage == table], table)
        if "object" not in found:
            found["object"] = None
        order = {(of.kind, of.amount, of.shift_m): i for i, of in enumerate(levels)}
        for name, group in found.groupby(["object", "kind", "amount", "shift_m"], dropna=False, sort=False):
            of_object, *level = name
            if tuple(level) not in order:
                continue
            for metric in metrics:
                values = group[metric].to_numpy(dtype=np.float64)
                mean, std = mean_and_std(values)
                rows.append(
                    dict(zip(("kind", "amount", "shift_m"), level, strict=True))
                    | {"scope": scope, "object": of_object if isinstance(of_object, str) else None}
                    | {"metric": metric, "n": int(np.count_nonzero(~np.isnan(values))), "mean": mean, "std": std}
                )
    summary = PERTURB_SUMMARY.from_rows(rows)
    key = key_of(sorted(record.key for record in records))
    path = sweep.out / f"{SUMMARY}.parquet"
    stored = sweep.store.write_at(path, SUMMARY, summary, key)
    sweep.store.records[SUMMARY, "", ""] = JobRecord(SUMMARY, "", "", key, {path.name: stored})
    sweep.store.compact()
    return summary


def _read(sweep: Sweep, records: list[JobRecord], table: str) -> pd.DataFrame:
    parts = [pq.read_table(sweep.out / name) for record in records for name in record.files]
    found: pd.DataFrame = pa.concat_tables([TABLES[table].schema.empty_table(), *parts]).to_pandas()
    return found
