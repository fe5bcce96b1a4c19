"""The findings of a run: reads the objects and scores of its pairs, and keeps what they say together in `run.json`.

Reads a few columns of five small files per pair, and only when the results have changed.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from ...schemas.columns import SIDES
from ...schemas.errors import RunError
from ...schemas.results import Findings
from ...stages.arrays import BoolArray, FloatArray, IndexArray, IntArray
from ...stages.statistics.comparison import blocks_of
from ...stages.statistics.findings import MatchedObjects, SideObjects, summarise_objects
from ..datasets.readers.scan import cause_of
from ..storage.files import key_of
from ..storage.tables import TableFolder, read_content

#: Raised by hand whenever the numbers below come out otherwise from the same tables.
_VERSION = 6
_FILES_AT_ONCE = 200

#: What an object is called by its shape, in the order of the columns that tell it.
SHAPES = ("linear", "planar", "scattered")
SHAPE_COLUMNS = ("linearity", "planarity", "scattering")
_EXTENTS = ("extent_x", "extent_y", "extent_z")
_OF_OBJECTS = ("community_id", "n_points", "range_m", "label", *_EXTENTS)
_OF_COVERAGE = ("side", "community_id", "covered_0p3m")
_OF_METRICS = ("real_id", "sim_id", "n_real", "n_sim", "cdc", "r_lambda", "r_gap", "alignment_rms_m")
_OF_PIECES = (
    *("side", "piece_id", "n_points", "range_m", "bearing_deg", *_EXTENTS, "label", "fate"),
    *("moved_x_m", "moved_y_m", "moved_z_m"),
)
_Objects = TypeVar("_Objects", SideObjects, MatchedObjects)


@dataclass(frozen=True)
class SideRows:
    """The objects of one side of some pairs, (n,) each.

    pair : place of the pair among `ObjectRows.pair_ids`
    object_id : from 0 in each pair
    label : class, "" if none
    diagonal_m : of the axis-aligned bounding box
    covered : share of its points that the other side has within 0.3 m
    is_matched : whether the other side has it too
    """

    pair: IntArray
    object_id: IntArray
    n_points: IntArray
    range_m: FloatArray
    label: NDArray[Any]
    diagonal_m: FloatArray
    covered: FloatArray
    is_matched: BoolArray


@dataclass(frozen=True)
class ObjectRows:
    """The objects of some pairs.

    real, sim : those of each side
    pair : (m,) of each matched object, its place among `pair_ids`
    scores : columns of `metrics`, (m,) each, NaN where null
    real_rows, sim_rows : (m,) places of the matched objects in `real` and `sim`
    pieces : columns of `pieces`, (p,) each, and `pair`, the place among `pair_ids`
    """

    pair_ids: list[str]
    real: SideRows
    sim: SideRows
    pair: IntArray
    scores: dict[str, NDArray[Any]]
    real_rows: IndexArray
    sim_rows: IndexArray
    pieces: dict[str, NDArray[Any]]


def run_findings(
    folder: TableFolder,
    pair_ids: list[str],
    timestamps_s: Mapping[str, float | None],
    hashes: Mapping[str, Mapping[str, str]],
    tables_key: str,
    before: Findings | None,
    *,
    by_reference: bool = False,
    watch: Callable[[ObjectRows], None] | None = None,
) -> Findings | None:
    """What the scored pairs say together, None where there are none.

    Taken from the last record where tables and timestamps are the same.

    Parameters
    ----------
    folder : the run
    pair_ids : the scored pairs
    timestamps_s : by pair
    hashes : by pair, of its real scan (`real`)
    tables_key : hash of all that the tables were made of
    before : the findings of the last record
    by_reference : whether the real side fixed the objects
    watch : called with the objects as they are read
    """
    if not pair_ids:
        return None
    times = [timestamps_s.get(pair_id) for pair_id in pair_ids]
    key = key_of(_VERSION, tables_key, pair_ids, times)
    if before is not None and before.key == key:
        return before
    objects = read_objects(folder, pair_ids, by_reference=by_reference, watch=watch)
    blocks = blocks_of([hashes[pair_id]["real"] for pair_id in pair_ids], times)
    return Findings(key=key, n_independent=len(np.unique(blocks)), **vars(summarise_objects(*objects, pair_ids, times)))


def read_objects(
    folder: TableFolder,
    pair_ids: list[str],
    *,
    by_reference: bool = False,
    watch: Callable[[ObjectRows], None] | None = None,
) -> tuple[SideObjects, SideObjects, MatchedObjects]:
    """All objects of either side, and the matched ones, of the pairs; indices of pairs are places in `pair_ids`.

    Parameters
    ----------
    by_reference : the real side fixed the objects: what little is simulated of a missing one is no simulated object
    watch : called with the objects, some pairs at a time, with further columns
    """
    reals, sims, matched = [], [], []
    for first, rows in _rows_of(folder, pair_ids, by_reference):
        if watch:
            watch(rows)
        real, sim = (
            SideObjects(first + side.pair, side.range_m, side.label.astype(np.str_), side.is_matched)
            for side in (rows.real, rows.sim)
        )
        scores = {name: rows.scores[name] for name in ("n_real", "n_sim", "cdc", "r_lambda", "r_gap")}
        own = rows.real_rows
        matched.append(MatchedObjects(first + rows.pair, real.range_m[own], real.label[own], **scores))
        reals.append(real)
        sims.append(sim)
    return _joined(reals), _joined(sims), _joined(matched)


def _rows_of(folder: TableFolder, pair_ids: list[str], by_reference: bool) -> Iterator[tuple[int, ObjectRows]]:
    """The objects of some pairs at a time, and the place of the first of these in `pair_ids`."""
    for first in range(0, len(pair_ids), _FILES_AT_ONCE):
        names = pair_ids[first : first + _FILES_AT_ONCE]
        scores, pair = read_columns([folder.path("metrics", name) for name in names], _OF_METRICS)
        coverage, _ = read_columns([folder.path("coverage", name) for name in names], _OF_COVERAGE)
        sides, rows = {}, {}
        for side in SIDES:
            objects, pair_of_object = read_columns([folder.path("objects", name, side) for name in names], _OF_OBJECTS)
            # The objects of a side are numbered from 0 in each pair, so that pair and id say the row.
            n = np.bincount(pair_of_object, minlength=len(names))
            rows[side] = (np.cumsum(n) - n)[pair] + scores[f"{side}_id"]
            own = (coverage["side"] == side) & ~np.isnan(coverage["community_id"])  # in the order of the objects
            ids = scores[f"{side}_id"]
            if (
                not np.array_equal(objects["community_id"], np.arange(n.sum()) - (np.cumsum(n) - n)[pair_of_object])
                or np.any((ids < 0) | (ids >= n[pair]))
                or np.count_nonzero(own) != len(pair_of_object)
            ):
                raise RunError(
                    f"run {folder.folder}: metrics/ or coverage/ name objects that are not in objects/; run it again"
                )
            is_matched = np.zeros(len(pair_of_object), dtype=np.bool_)
            is_matched[rows[side]] = True
            sides[side] = SideRows(
                pair=pair_of_object,
                object_id=objects["community_id"],
                n_points=objects["n_points"],
                range_m=objects["range_m"],
                label=np.array([label or "" for label in objects["label"]], dtype=object),
                diagonal_m=np.sqrt(np.sum([objects[name] ** 2 for name in _EXTENTS], axis=0)),
                covered=coverage["covered_0p3m"][own],
                is_matched=is_matched,
            )
        if by_reference:
            n_real = np.bincount(sides["real"].pair, minlength=len(names))
            is_own = sides["sim"].is_matched | (sides["sim"].object_id >= n_real[sides["sim"].pair])
            sides["sim"] = SideRows(**{name: column[is_own] for name, column in vars(sides["sim"]).items()})
            rows["sim"] = (np.cumsum(is_own) - 1)[rows["sim"]]
        pieces, pair_of_piece = read_columns([folder.path("pieces", name) for name in names], _OF_PIECES)
        pieces["pair"] = pair_of_piece
        yield first, ObjectRows(names, sides["real"], sides["sim"], pair, scores, rows["real"], rows["sim"], pieces)


def shape_of(linearity: FloatArray, planarity: FloatArray, scattering: FloatArray) -> NDArray[np.str_]:
    """Which of `SHAPES` objects are: the largest of the three, (n,) strings; "linear" where all are null.

    Examples
    --------
    >>> shape_of(np.array([0.2]), np.array([0.7]), np.array([0.1])).tolist()
    ['planar']
    """
    largest = np.nan_to_num(np.column_stack([linearity, planarity, scattering])).argmax(axis=1)
    shapes: NDArray[np.str_] = np.array(SHAPES)[largest]
    return shapes


def _joined(parts: Sequence[_Objects]) -> _Objects:
    """The objects of all parts, one after the other."""
    columns = (np.concatenate([getattr(part, name) for part in parts]) for name in vars(parts[0]))
    return type(parts[0])(*columns)


def read_columns(paths: Sequence[Path], columns: Sequence[str]) -> tuple[dict[str, NDArray[Any]], IntArray]:
    """Columns of some files one after the other, nulls of numbers as NaN, and which file each row comes from."""
    chunks, n_rows = [], []
    for start in range(0, len(paths), _FILES_AT_ONCE):  # a table of few rows is larger than they are
        some = paths[start : start + _FILES_AT_ONCE]
        try:
            parts = [read_content(path.read_bytes(), list(columns)) for path in some]
            chunks.append(pa.concat_tables(parts).combine_chunks())
        except (OSError, ValueError, KeyError, pa.ArrowException) as error:
            raise RunError(f"{some[0].parent}: a table cannot be read ({cause_of(error)}); run it again") from error
        n_rows += [part.num_rows for part in parts]
    table = pa.concat_tables(chunks)
    pair = np.repeat(np.arange(len(n_rows), dtype=np.int32), n_rows)
    return {name: table.column(name).to_numpy(zero_copy_only=False) for name in columns}, pair
