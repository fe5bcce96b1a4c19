"""What the repeats of `fidpipe perturb` say together: mean and standard deviation of each metric at each level."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from ....schemas.experiment_tables import PERTURB_SUMMARY
from ....schemas.metrics import DATASET_SCORES, OBJECT_METRICS
from ....stages.summary import mean_and_std
from ..experiment import Experiment

_BASELINES = "perturb_baselines"
_METRICS = {"perturb_global": DATASET_SCORES, "perturb_objects": OBJECT_METRICS}
_LEVEL = ("kind", "amount", "shift_m")


def summarise(experiment: Experiment) -> pa.Table:
    """Writes and returns the rows of `perturb_summary`, over the repeats of all scans."""
    rows: list[dict[str, Any]] = []
    for scope, repeats in _by_metric(experiment):
        for name, values in repeats.groupby(["object", *_LEVEL, "metric"], dropna=False, sort=False)["value"]:
            mean, std = mean_and_std(values.to_numpy(dtype=np.float64))
            labels = dict(zip(("object", *_LEVEL, "metric"), name, strict=True))
            labels["object"] = labels["object"] if scope == "object" else None
            rows.append(labels | {"scope": scope, "n": int(values.notna().sum()), "mean": mean, "std": std})
    summary = PERTURB_SUMMARY.from_rows(rows)
    experiment.write_summary(PERTURB_SUMMARY, summary)
    return summary


def _by_metric(experiment: Experiment) -> Iterator[tuple[str, pd.DataFrame]]:
    """The repeats, one row per metric, with the scope of each table."""
    for table, metrics in _METRICS.items():
        repeats = experiment.rows(table).to_pandas()
        scope = "object" if "object" in repeats else "global"
        labels = repeats.assign(object=repeats["object"] if scope == "object" else None)[["object", *_LEVEL]]
        for metric in metrics:
            yield scope, labels.assign(metric=metric, value=repeats[metric])
    yield "object", experiment.rows(_BASELINES).to_pandas().rename(columns={"baseline": "metric"})
