"""The values of `run.json` that the tables determine, once more, by pandas and `stages.literal`."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import pandas as pd

from ...schemas.columns import SIDES, Row
from ...schemas.metric_catalogue import BEV_JSD, BEV_MMD, DISTRIBUTED, METRIC, RUN_SCORES
from ...schemas.record import OF_DATASET, OF_OBJECTS, OF_SCAN, BaselineSummary
from ...schemas.settings import Settings
from ...stages.literal import literal_nvs
from ..jobs.nvs_job import MOST_SCANS
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


def compare_nvs(run: FinishedRun, settings: Settings, tally: Tally) -> None:
    """Means and deviations over pairs of the scores of LiDAR synthesis, and the distances of the maps of all scans."""
    if not settings.nvs.scores:
        return
    rows = run.table("nvs").to_pandas().rename(columns={"score": "baseline"}).assign(level=OF_SCAN)
    pair_ids = sorted(row["pair_id"] for row in run.scored)
    n = len(pair_ids)
    chosen = sorted({int(i) for i in np.linspace(0, n - 1, min(n, MOST_SCANS))})
    sums, single = [], []
    for side in SIDES:
        maps = []
        for pair_id in pair_ids:
            table = run.read_table("ground", pair_id, side, ["x", "y", "z"])
            maps.append(literal_nvs.map_from_above(table.to_pandas().to_numpy()))
        sums.append(sum(maps, np.zeros(1)))
        single.append([maps[i] for i in chosen])
    of_all = []
    for metric, value, size in (
        (BEV_JSD, literal_nvs.map_jsd(*sums), n),
        (BEV_MMD, literal_nvs.map_mmd(*single), len(chosen)),
    ):
        n_known = 0 if value is None else size
        of_all.append((metric.column, OF_DATASET, value, None, n_known, size - n_known))
    expected = _over_pairs(rows)
    dataset = pd.DataFrame(of_all, columns=[*_LEVEL, *expected.columns]).set_index(_LEVEL)
    _compare_summaries(run.record.nvs, pd.concat([expected, dataset.astype(float)]), tally)


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
    "nvs": compare_nvs,
    "scores": compare_scores,
}
