"""What the repeats of `fidpipe perturb` say together: mean and standard deviation of each metric at each level.

Leaves to others: the repeats themselves (`perturb_jobs`), whether the paper's claims hold (`perturb_claims`).
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from ....schemas.experiment_tables import PERTURB_SUMMARY
from ....schemas.metrics import DATASET_SCORES, OBJECT_METRICS
from ....schemas.tables import TABLES
from ....stages.summary import mean_and_std
from ...storage.ledger import JobRecord
from ...storage.store import key_of
from ..sweep import Sweep

SUMMARY = "perturb_summary"
_BASELINES = "perturb_baselines"
_METRICS_OF = {"perturb_global": DATASET_SCORES, "perturb_objects": OBJECT_METRICS}
_LEVEL = ("kind", "amount", "shift_m")


def summarise(sweep: Sweep) -> pa.Table:
    """Writes and returns the rows of `perturb_summary`, over the repeats of all scans."""
    records = [of for of in sweep.store.records.values() if of.stage in _METRICS_OF or of.stage == _BASELINES]
    rows: list[dict[str, Any]] = []
    for scope, found in _by_metric(sweep, records):
        for name, values in found.groupby(["object", *_LEVEL, "metric"], dropna=False, sort=False)["value"]:
            mean, std = mean_and_std(values.to_numpy(dtype=np.float64))
            labels = dict(zip(("object", *_LEVEL, "metric"), name, strict=True))
            labels["object"] = labels["object"] if scope == "object" else None
            rows.append(labels | {"scope": scope, "n": int(values.notna().sum()), "mean": mean, "std": std})
    summary = PERTURB_SUMMARY.from_rows(rows)
    key = key_of(sorted(record.key for record in records))
    path = sweep.out / f"{SUMMARY}.parquet"
    stored = sweep.store.write_at(path, SUMMARY, summary, key)
    sweep.store.take(JobRecord(SUMMARY, "", "", key, {path.name: stored}))
    sweep.store.compact()
    return summary


def _by_metric(sweep: Sweep, records: list[JobRecord]) -> Iterator[tuple[str, pd.DataFrame]]:
    """The repeats, a row a metric, with the scope of each table."""
    for table, metrics in _METRICS_OF.items():
        found = _read(sweep, records, table)
        scope = "object" if "object" in found else "global"
        labels = found.assign(object=found["object"] if scope == "object" else None)[["object", *_LEVEL]]
        for metric in metrics:
            yield scope, labels.assign(metric=metric, value=found[metric])
    yield "object", _read(sweep, records, _BASELINES).rename(columns={"baseline": "metric"})


def _read(sweep: Sweep, records: list[JobRecord], table: str) -> pd.DataFrame:
    parts = [pq.read_table(sweep.out / name) for of in records if of.stage == table for name in of.files]
    found: pd.DataFrame = pa.concat_tables([TABLES[table].schema.empty_table(), *parts]).to_pandas()
    return found
