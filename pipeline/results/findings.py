"""The findings of a run: reads the objects and scores of its pairs, and keeps what they say together in `run.json`.

Reads a few columns of three small files a pair, about a millisecond, and only when the results have changed.
Leaves to others: the numbers (`stages.findings`), the paper's claims (`stages.claims`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.columns import SIDES
from ...stages.arrays import IntArray
from ...stages.statistics.claims import check_claims
from ...stages.statistics.findings import MatchedObjects, SideObjects, summarise_objects
from ..storage.files import key_of
from ..storage.tables import TableFolder

#: Raised by hand whenever the numbers below come out otherwise from the same tables.
_VERSION = 2


def run_findings(
    folder: TableFolder,
    pair_ids: list[str],
    timestamps_s: Mapping[str, float | None],
    summary: Mapping[str, Any],
    tables_key: str,
    before: Mapping[str, Any],
) -> dict[str, Any]:
    """What the scored pairs say together, {} where there are none.

    Taken from the last record where tables and timestamps are the same.

    Parameters
    ----------
    folder : the run
    pair_ids : the scored pairs
    timestamps_s : by pair
    summary : mean and std over pairs by score
    tables_key : hash of all that the tables were made of
    before : `findings` of the last record, or {}
    """
    if not pair_ids:
        return {}
    times = [timestamps_s.get(pair_id) for pair_id in pair_ids]
    key = key_of(_VERSION, tables_key, pair_ids, times)
    if before.get("key") == key:
        return dict(before)
    real, sim, matched = read_objects(folder, pair_ids)
    findings = summarise_objects(real, sim, matched, times)
    for scan in findings["scans"]["scans"]:
        scan["pair"] = pair_ids[scan["pair"]]
    claims = [claim.as_dict() for claim in check_claims(summary, findings)]
    return {"key": key, **findings, "claims": claims}


def read_objects(folder: TableFolder, pair_ids: list[str]) -> tuple[SideObjects, SideObjects, MatchedObjects]:
    """All objects of either side, and the matched ones, of the pairs; indices of pairs are places in `pair_ids`."""
    paths = [folder.path("metrics", pair_id) for pair_id in pair_ids]
    metrics, pair = _read(paths, ["real_id", "sim_id", "n_real", "n_sim", "cdc", "r_lambda", "r_gap"])
    sides, rows_of = [], []
    for side in SIDES:
        paths = [folder.path("objects", pair_id, side) for pair_id in pair_ids]
        objects, of_pair = _read(paths, ["range_m", "label"])
        # The objects of a side are numbered from 0 in each pair, so that pair and id say the row.
        first = np.concatenate([[0], np.cumsum(np.bincount(of_pair, minlength=len(pair_ids)))])
        rows = first[pair] + metrics[f"{side}_id"]
        is_matched = np.zeros(len(of_pair), dtype=np.bool_)
        is_matched[rows] = True
        label = np.array([label or "" for label in objects["label"].tolist()], dtype=np.str_)
        sides.append(SideObjects(of_pair, objects["range_m"], label, is_matched))
        rows_of.append(rows)
    real, sim = sides
    scores = {name: metrics[name] for name in ("n_real", "n_sim", "cdc", "r_lambda", "r_gap")}
    return real, sim, MatchedObjects(pair, real.range_m[rows_of[0]], real.label[rows_of[0]], **scores)


def _read(paths: Iterable[Path], columns: list[str]) -> tuple[dict[str, Any], IntArray]:
    """Columns of some files one after the other, nulls of numbers as NaN, and which file each row is of."""
    files = (pa.BufferReader(path.read_bytes()) for path in paths)  # in one read each: there are many, and small
    parts = [pq.ParquetFile(file).read(columns=columns, use_threads=False) for file in files]
    table = pa.concat_tables(parts)
    pair = np.repeat(np.arange(len(parts), dtype=np.int32), [part.num_rows for part in parts])
    return {name: table.column(name).to_numpy(zero_copy_only=False) for name in columns}, pair
