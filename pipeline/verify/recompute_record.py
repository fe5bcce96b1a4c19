"""The values of `run.json` that the tables determine, once more, by pandas and `stages.literal`."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.metric_catalogue import DISTRIBUTED, METRIC, RUN_SCORES
from ...schemas.record import OF_OBJECTS, OF_SCAN, BaselineSummary
from ...schemas.settings import Settings
from ..results.finished import FinishedRun
from ..storage.run_record import unmatched_worst
from .compare_frames import Tally
from .recompute import UNMATCHED

_LEVEL = ["baseline", "level"]


def compare_unmatched(run: FinishedRun, settings: Settings, tally: Tally) -> None:
    """Number of unmatched objects that the other side has, has partly, or lacks, and of those that are road there."""
    matching, coverage = (run.table(name).to_pandas() for name in ("matching", "coverage"))
    stored = run.record.metrics and run.record.metrics.unmatched
    for side, word in UNMATCHED.items():
        unmatched = matching[matching["status"] == word].rename(columns={f"{side}_id": "community_id"})
        rows = unmatched.merge(coverage[coverage["side"] == side], on=["pair_id", "community_id"])
        share, states = rows["covered_0p3m"], getattr(stored, word)
        expected = {
            "there": (share > 0.8).sum(),
            "partly": ((share > 0.2) & (share <= 0.8)).sum(),
            "absent": (share <= 0.2).sum(),
            "road": (rows["road_share"] > 0.5).sum(),
        }
        for state, n in expected.items():
            column = f"metrics.unmatched.{word}.{state}"
            tally.compare_values("run.json", {column: getattr(states, state)}, {column: n})


def compare_baselines(run: FinishedRun, settings: Settings, tally: Tally) -> None:
    """Means and deviations over pairs of the baseline metrics, of objects and of whole scans."""
    if settings.metrics.baselines:
        rows = run.table("baselines").to_pandas()
        rows["level"] = np.where(rows["real_id"].isna(), OF_SCAN, OF_OBJECTS)
        _compare_summaries(run.record.baselines, _over_pairs(rows), tally)


def compare_scores(run: FinishedRun, settings: Settings, tally: Tally) -> None:
    """Counts of pairs, means and deviations over pairs in `run.json`, from the rows of `pairs`."""
    pairs, counts = run.pairs[run.pairs["status"] == "scored"], run.record.pairs
    stored: Row = {"pairs.scored": counts.scored, "pairs.failed": counts.failed}
    expected: Row = {"pairs.scored": len(pairs), "pairs.failed": len(run.rows) - len(pairs)}
    values = pairs[[*RUN_SCORES]].astype(float)
    unmatched = pairs["n_missing"] + pairs["n_hallucinated"]
    for name in DISTRIBUTED:
        n = pairs["n_matched"] - (0 if "required" in METRIC[name].flags else pairs["n_too_small"])
        total = values[METRIC[name].mean_column].fillna(0.0) * n + (METRIC[name].high or 0.0) * unmatched
        values[unmatched_worst(name)] = total / (n + unmatched).replace(0, np.nan)
    for name in map(str, values):
        summary, own = run.record.summary.get(name), values[name]
        for key, value in {"mean": own.mean(), "std": own.std(), "n_pairs": own.count()}.items():
            stored[f"summary.{name}.{key}"], expected[f"summary.{name}.{key}"] = getattr(summary, key, None), value
    tally.compare_values("run.json", stored, expected)


def _over_pairs(rows: pd.DataFrame) -> pd.DataFrame:
    """Mean and deviation over pairs of their means of `value`, with the number of known values and of nulls."""
    of_pairs = rows.groupby([*_LEVEL, "pair_id"])["value"].mean().groupby(_LEVEL)
    n, size = (getattr(rows.groupby(_LEVEL)["value"], what)() for what in ("count", "size"))
    return pd.DataFrame({"mean": of_pairs.mean(), "std": of_pairs.std(), "n": n, "n_null": size - n}).astype(float)


def _compare_summaries(stored: Iterable[BaselineSummary], recomputed: pd.DataFrame, tally: Tally) -> None:
    frame = pd.DataFrame([vars(own) for own in stored], columns=[*_LEVEL, *recomputed.columns])
    tally.compare("run.json", frame.set_index(_LEVEL), recomputed)


#: Comparisons of `run.json` by subject.
RECORD: dict[str, Callable[[FinishedRun, Settings, Tally], None]] = {
    "unmatched objects": compare_unmatched,
    "baselines": compare_baselines,
    "scores": compare_scores,
}
