"""The findings of a run: reads the objects and scores of its pairs, and keeps what they say together in `run.json`.

Reads a few columns of three small files per pair, about a millisecond, and only when the results have changed.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from ...schemas.columns import SIDES
from ...schemas.results import Findings
from ...stages.arrays import IntArray
from ...stages.statistics.claims import check_claims
from ...stages.statistics.findings import MatchedObjects, SideObjects, summarise_objects
from ..storage.files import key_of
from ..storage.tables import TableFolder

#: Raised by hand whenever the numbers below come out otherwise from the same tables.
_VERSION = 4
_FILES_AT_ONCE = 200


def run_findings(
    folder: TableFolder,
    pair_ids: list[str],
    timestamps_s: Mapping[str, float | None],
    hashes: Mapping[str, Mapping[str, str]],
    tables_key: str,
    before: Findings | None,
    *,
    by_reference: bool = False,
) -> Findings | None:
    """What the scored pairs say together, None where there are none.

    Taken from the last record where tables and timestamps are the same.

    Parameters
    ----------
    folder : the run
    pair_ids : the scored pairs
    timestamps_s : by pair
    hashes : by pair, what it comes from: of its real scan (`real`) and of all (`content`)
    tables_key : hash of all that the tables were made of
    before : the findings of the last record
    by_reference : whether the real side fixed the objects
    """
    if not pair_ids:
        return None
    times = [timestamps_s.get(pair_id) for pair_id in pair_ids]
    key = key_of(_VERSION, tables_key, pair_ids, times)
    if before is not None and before.key == key:
        return before
    objects = read_objects(folder, pair_ids, by_reference=by_reference)
    contents, real_scans = ([hashes[pair_id][name] for pair_id in pair_ids] for name in ("content", "real"))
    claims = check_claims(*objects, contents, real_scans, times)
    return Findings(key=key, **vars(summarise_objects(*objects, pair_ids, times)), claims=tuple(claims))


def read_objects(
    folder: TableFolder, pair_ids: list[str], *, by_reference: bool = False
) -> tuple[SideObjects, SideObjects, MatchedObjects]:
    """All objects of either side, and the matched ones, of the pairs; indices of pairs are places in `pair_ids`.

    Where the real side fixed the objects, what little is simulated of a missing object is no simulated object.
    """
    paths = [folder.path("metrics", pair_id) for pair_id in pair_ids]
    metrics, pair = read_columns(paths, ["real_id", "sim_id", "n_real", "n_sim", "cdc", "r_lambda", "r_gap"])
    sides, matched_rows = [], []
    for side in SIDES:
        paths = [folder.path("objects", pair_id, side) for pair_id in pair_ids]
        objects, pair_of_object = read_columns(paths, ["range_m", "label"])
        # The objects of a side are numbered from 0 in each pair, so that pair and id say the row.
        first = np.concatenate([[0], np.cumsum(np.bincount(pair_of_object, minlength=len(pair_ids)))])
        rows = first[pair] + metrics[f"{side}_id"]
        is_matched = np.zeros(len(pair_of_object), dtype=np.bool_)
        is_matched[rows] = True
        label = np.array([label or "" for label in objects["label"].tolist()], dtype=np.str_)
        sides.append(SideObjects(pair_of_object, objects["range_m"], label, is_matched))
        matched_rows.append(rows)
    real, sim = sides
    if by_reference:
        n_real, n_sim = (np.bincount(side.pair, minlength=len(pair_ids)) for side in sides)
        ids = np.arange(len(sim.pair)) - np.repeat(np.cumsum(n_sim) - n_sim, n_sim)
        own = sim.is_matched | (ids >= n_real[sim.pair])
        sim = SideObjects(sim.pair[own], sim.range_m[own], sim.label[own], sim.is_matched[own])
    scores = {name: metrics[name] for name in ("n_real", "n_sim", "cdc", "r_lambda", "r_gap")}
    return real, sim, MatchedObjects(pair, real.range_m[matched_rows[0]], real.label[matched_rows[0]], **scores)


def read_columns(paths: list[Path], columns: list[str]) -> tuple[dict[str, NDArray[Any]], IntArray]:
    """Columns of some files one after the other, nulls of numbers as NaN, and which file each row comes from."""
    chunks, n_rows = [], []
    for start in range(0, len(paths), _FILES_AT_ONCE):  # a table of few rows is larger than they are
        files = (pa.BufferReader(path.read_bytes()) for path in paths[start : start + _FILES_AT_ONCE])
        parts = [pq.ParquetFile(file).read(columns=columns, use_threads=False) for file in files]
        n_rows += [part.num_rows for part in parts]
        chunks.append(pa.concat_tables(parts).combine_chunks())
    table = pa.concat_tables(chunks)
    pair = np.repeat(np.arange(len(n_rows), dtype=np.int32), n_rows)
    return {name: table.column(name).to_numpy(zero_copy_only=False) for name in columns}, pair
