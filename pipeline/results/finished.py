"""A finished run as it is read again: its record, its pairs, and the objects of one pair; nothing is computed.

What is read is checked against the run's index, so that a damaged table is reported and not used. The values
that `fidpipe show` prints for a run, a pair or an object are defined here, for the terminal and for JSON.
"""

from __future__ import annotations

import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ...schemas.cause_catalogue import UNEVEN
from ...schemas.columns import SIDES, Row
from ...schemas.errors import RunError
from ...schemas.record import RunRecord
from ...schemas.results import Cause, Diagnosis, Overview, Unknown
from ...schemas.tables import PAIR_TABLES, TABLES
from ...stages.arrays import IntArray
from ..storage.files import path_exists
from ..storage.folder import RunFolder
from ..storage.run_record import RUN_JSON, command_again, read_run
from ..storage.urls import url_or_path
from .causes import mean_amount, read_causes
from .diagnosis import diagnosis_of
from .object_frame import WITH_UNITS, object_frame, plain_rows

if TYPE_CHECKING:
    import pandas as pd

#: Tables of the whole run, in one file each.
_OF_RUN = ("pairs", "timings")


def record_of_run(folder: Path) -> dict[str, Any]:
    """The record of a run; raises `RunError` with the next step if the folder holds none."""
    shown = url_or_path(folder)
    quoted = shlex.quote(shown)
    if not path_exists(folder / RUN_JSON):
        problem = "no such folder"
        hint = f"make a run: fidpipe run DATASET --out {quoted}"
        if folder.exists():
            problem = f"no {RUN_JSON} found"
            hint = (
                "if it holds a dataset, evaluate it: "
                f"fidpipe run {quoted} --out runs/{folder.resolve().name}; "
                f"if it holds scans, evaluate them: fidpipe run {quoted} SIM"
            )
        raise RunError(
            f"run {shown}: {problem}, expected a folder written by fidpipe run; {hint}"
        )
    record = read_run(folder)
    if not record:
        again = command_again(folder, "DATASET")
        raise RunError(
            f"run {shown}: {RUN_JSON} is damaged; run it again with: {again} "
            "(intact results are reused)"
        )
    if made_by := record.get("experiment"):
        raise RunError(
            f"run {shown}: expected a folder written by fidpipe run, got one of fidpipe "
            f"{made_by}; its tables are {shown}/{made_by}*.parquet"
        )
    return record


class FinishedRun:
    """A run that has ended: its record, and its tables as pandas frames or as Arrow, each checked as it is read.

    Python users open it with `fidpipe.open_run`, as the subclass `open_run.Run`, which has plots as well.

    Raises
    ------
    RunError
        The folder is not a run, the run has not ended, or its table of pairs is damaged.
    """

    def __init__(self, folder: Path | str) -> None:
        self.folder = folder = Path(folder)
        record = record_of_run(folder)
        self.store = RunFolder(folder)
        try:
            self.record = RunRecord.model_validate(record)
        except ValueError as error:
            if self.store.is_locked:
                raise RunError(
                    f"run {folder}: another fidpipe is working on this run; wait until it ends"
                ) from error
            command = command_again(folder, record.get("dataset"))
            raise RunError(
                f"run {folder}: the run has not ended; finish it with: {command}"
            ) from error
        self.rows: list[Row] = self.store.read_table("pairs").to_pylist()
        self.rows_by_name: dict[str, Row] = {row["pair_id"]: row for row in self.rows}

    def __repr__(self) -> str:
        counts = self.record.pairs
        states = f"{counts.scored} pairs scored, {counts.failed} failed"
        return f"<fidpipe run {self.folder}: {states}, preset {self.preset}>"

    @property
    def pairs(self) -> pd.DataFrame:
        """One row per pair, failed ones with their reason; its columns are in `schemas/tables.csv`."""
        return _frame(self.table("pairs"))

    @cached_property
    def scores(self) -> pd.DataFrame:
        """(scored pairs, scores) the numbers of `pairs`, and the gaps of tasks by names such as `objects.lost`."""
        scores = self.pairs.set_index("pair_id").loc[self.names]
        scores = scores.select_dtypes("number").astype(np.float64)
        if not self.record.tasks:
            return scores
        rows = self.tasks.query("group == 'all'")
        rows = rows.assign(name=rows["task"] + "." + rows["measure"])
        return scores.join(rows.pivot(index="pair_id", columns="name", values="gap"))

    @property
    def objects(self) -> pd.DataFrame:
        """One row per object of either side of all scored pairs, with place, coverage, class, fate and scores.

        Columns are those of the tables `objects`, `coverage` and `metrics` with units in their names, and `fate`
        (matched, not_found, extra; remnant: a few simulated points of an object not found), `partner` (the matched
        object of the other side, -1 without one), `shape`, `bearing_deg`, `diagonal_m` and `quadrant`. Scores are
        those of the pair of objects, on both rows; null for unmatched objects.

        Raises
        ------
        RunError
            No pair is scored, or a table is damaged.
        """
        return self.objects_of(self.select()).rename(columns=WITH_UNITS).drop(columns="pair")

    @property
    def metrics(self) -> pd.DataFrame:
        """One row per matched object of all scored pairs; its columns are in `schemas/tables.csv`."""
        return _frame(self.table("metrics"))

    @property
    def tasks(self) -> pd.DataFrame:
        """One row per pair, task, measure and group of obstacles; raises `RunError` without tasks."""
        self.refuse_without_tasks()
        return _frame(self.table("tasks"))

    def refuse_without_tasks(self) -> None:
        """Raises `RunError` without tasks."""
        if not self.record.tasks:
            raise RunError(
                f"run {self.folder}: it has no tasks; add them with fidpipe run --tasks"
            )

    def points(self, pair_id: str, side: str) -> pd.DataFrame:
        """The clean points of a side, (x, y, z) in metres in the real sensor's frame, and the object of each.

        Columns of the table `ground`, and `community_id`, which is null for ground.
        """
        points = _frame(self._of_side("ground", pair_id, side))
        labels = _frame(self._of_side("communities", pair_id, side))[
            ["point_id", "community_id"]
        ]
        return points.merge(
            labels.astype({"community_id": "Int32"}), on="point_id", how="left", validate="1:1"
        )

    def places(self, names: Sequence[str]) -> IntArray:
        """(n,) number of the place of each scored pair; copies and neighbouring frames have the same one."""
        place_of = {} if self.record.findings is None else self.record.findings.places
        return np.array([place_of[name] for name in names], dtype=np.int32)

    def edges(self, pair_id: str, side: str) -> pd.DataFrame:
        """The graph of a side, one row per edge: `src`, `dst` (ids of points), `length_m`."""
        return _frame(self._of_side("graph", pair_id, side))

    def table(self, name: str, pairs: Iterable[str] | None = None) -> pa.Table:
        """A table of all scored pairs in one, pair by pair, real before simulated; see runs/README.md for the names.

        Parameters
        ----------
        name : such as "metrics", "coverage", "selection"; "pairs" and "timings" are of the whole run
        pairs : names of pairs; by default all that are scored

        Raises
        ------
        RunError
            The table is unknown, a pair failed, or a file is damaged or gone.
        """
        if name in _OF_RUN:
            return self.store.read_table(name)
        if name not in PAIR_TABLES:
            raise RunError(
                f"run {self.folder}: no table {name!r}; it has "
                f"{', '.join((*_OF_RUN, *PAIR_TABLES))}"
            )
        names = self.names if pairs is None else list(pairs)
        sides = SIDES if "side" in TABLES[name].of_file else ("",)
        parts = []
        for pair_id in names:
            parts += [
                self.store.read_table(name, self._scored(pair_id), side) for side in sides
            ]
        if not parts:
            return TABLES[name].schema.empty_table()
        return pa.concat_tables(
            parts
        ).replace_schema_metadata()  # that of the first file says which job wrote it

    @property
    def causes(self) -> pd.DataFrame:
        """One row per named cause, in the order in which to fix them; `table("causes")` has the amounts of each pair.

        Columns are the fields of `schemas.results.Cause`.
        """
        import pandas as pd

        columns = [name for name in Cause.model_fields if name != "limbs"]
        causes = self.overview.causes if self.overview else ()
        return pd.DataFrame([vars(cause) for cause in causes], columns=columns)

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """The gains of correcting each cause; None if the run was not diagnosed since its causes changed."""
        return diagnosis_of(self.store, self.record, self.names)

    @property
    def overview(self) -> Overview | None:
        """The first answer of the run, with the causes of its diagnosis if it has one; None if no pair is scored."""
        overview = self.record.overview
        if overview is None or self.diagnosis is None:
            return overview
        return overview.model_copy(update={"causes": self.diagnosis.causes})

    @cached_property
    def mean_amounts(self) -> dict[str, Cause | Unknown]:
        """Every cause of the catalogue with its mean amount over the scored pairs, also those that are not named."""
        values = read_causes(self.store, self.names)
        del values[UNEVEN]
        blocks = self.places(self.names)
        return {name: mean_amount(name, values[name], blocks) for name in values}

    @property
    def preset(self) -> str:
        """The preset whose objects the run has; see `schemas.settings.PRESETS`."""
        return self.record.preset

    @property
    def scored(self) -> list[Row]:
        """The rows of the scored pairs, by name."""
        return [row for row in self.rows if row["status"] == "scored"]

    @property
    def names(self) -> list[str]:
        """Names of the scored pairs."""
        return [row["pair_id"] for row in self.scored]

    def select(self, pattern: str | None = None) -> list[str]:
        """Names of the scored pairs that match a pattern (shell style); `RunError` if none does."""
        names = self.names
        chosen = [name for name in names if pattern is None or fnmatchcase(name, pattern)]
        if not names:
            raise RunError(
                f"run {self.folder}: no pair is scored; fidpipe status {self.folder} says why"
            )
        if not chosen:
            known = ", ".join(sorted(names)[:5])
            raise RunError(
                f"--pairs {pattern!r} matches none of the {len(names)} scored pairs ({known} ...)"
            )
        return chosen

    def row(self, pair_id: str) -> Row:
        """The row of a pair; `RunError` if the run does not have it."""
        if pair_id not in self.rows_by_name:
            near = get_close_matches(pair_id, self.rows_by_name) or [*self.rows_by_name][:3]
            raise RunError(
                f"run {self.folder}: no pair {pair_id!r} among its {len(self.rows)}; "
                f"it has {', '.join(repr(name) for name in near)} ..."
            )
        return self.rows_by_name[pair_id]

    def objects_of(
        self,
        pairs: Sequence[str],
        columns: Collection[str] | None = None,
        sides: Sequence[str] = SIDES,
    ) -> pd.DataFrame:
        """The objects of scored pairs with coverage, fate and scores; see `object_frame.object_frame`.

        Raises
        ------
        RunError
            A pair failed, or a table is damaged or gone.
        """
        names = [self._scored(name) for name in pairs]
        by_reference = self.preset == "reference"  # the real side fixes the objects
        return object_frame(self.store, names, columns, by_reference=by_reference, sides=sides)

    def pair(self, pair_id: str) -> Row:
        """A pair as `fidpipe show RUN PAIR --json` prints it: its row of `pairs`, its objects (worst first) and rays.

        `rays` are its rows of `ray_scores`. A failed pair has no objects and rays.

        Raises
        ------
        RunError
            The run has no such pair, or a table is damaged.
        """
        row = self.row(pair_id)
        if row["status"] != "scored":
            return {"pair": row, "objects": [], "rays": []}
        rays = self.store.read_table("ray_scores", pair_id).drop_columns(["pair_id"])
        return {"pair": row, "objects": self._pair_objects(pair_id), "rays": rays.to_pylist()}

    def object(self, pair_id: str, name: str | int) -> Row:
        """The rows of an object on both sides, `real` and `sim`: 7 or "real:7" is the real object 7, or "sim:7".

        Raises
        ------
        RunError
            The pair failed, or it has no such object.
        """
        side, _, number = str(name).rpartition(":")
        for rows in self._pair_objects(pair_id):
            row = rows.get(side or "real")
            if row and str(row["community_id"]) == number:
                return rows
        raise RunError(
            f"run {self.folder}, pair {pair_id}: no object {name!r}; objects are numbered from 0: "
            "7 is a real object, sim:7 a simulated one"
        )

    def _pair_objects(self, pair_id: str) -> list[Row]:
        """The objects of a pair, each as its rows of `object_frame` on both sides: `real` and `sim`, None if absent.

        Matched objects come first, those with the largest r_lambda before the others. Of an object that is not found
        but has a number fixed by the real side, `sim` is its few simulated points.
        """
        frame = self.objects_of([pair_id]).sort_values(
            "r_lambda", ascending=False, kind="stable"
        )
        rows = {(row["side"], row["community_id"]): row for row in plain_rows(frame)}
        matched = []
        alone = []
        for (side, number), row in rows.items():
            if row["fate"] == "extra":
                alone.append({"real": None, "sim": row})
            elif row["fate"] == "not_found":
                few = rows.get(("sim", number), {"fate": None})
                alone.append({"real": row, "sim": few if few["fate"] == "remnant" else None})
            elif side == "real":
                matched.append({"real": row, "sim": rows["sim", row["partner"]]})
        return matched + alone

    def _of_side(self, table: str, pair_id: str, side: str) -> pa.Table:
        if side not in SIDES:
            raise RunError(
                f"run {self.folder}: expected side {' or '.join(SIDES)}, got {side!r}"
            )
        return self.store.read_table(table, self._scored(pair_id), side)

    def _scored(self, pair_id: str) -> str:
        """The name of a pair that is scored; `RunError` if it failed or is not there."""
        row = self.row(pair_id)
        if row["status"] != "scored":
            raise RunError(
                f"run {self.folder}, pair {pair_id}: it failed and has no objects ({row['reason']})"
            )
        return pair_id


def _frame(table: pa.Table) -> pd.DataFrame:
    frame: pd.DataFrame = table.to_pandas(ignore_metadata=True)
    return frame


#: Why a pair of two runs is not one.
OTHER_SCAN = "the real scans differ"
#: How the files of the simulated side are read: runs that differ in these alone can be compared.
_OF_SIM_FILES = ("sim_columns", "sim_frame")


def settings_changes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Settings that differ of all stages, and of tasks that both runs have; not how simulated files are read."""
    from ..jobs import STAGES  # with all libraries of the stages

    groups = list(chain.from_iterable(stage.settings for stage in STAGES))
    if base.record.tasks and other.record.tasks:
        groups.append("tasks")
    changes = []
    for group in dict.fromkeys(groups):
        settings = [run.record.settings.get(group, {}) for run in (base, other)]
        for name, before, after in differences(*settings):
            if name not in _OF_SIM_FILES:
                changes.append(f"{group}.{name} is {before} and {after}")
    return changes


def version_changes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Versions of stages and of libraries that differ, as text."""
    changes = []
    for what, field in (("code of stage", "stages"), ("library", "libraries")):
        versions = [getattr(run.record, field) for run in (base, other)]
        changes += [f"{what} {name}: {x} and {y}" for name, x, y in differences(*versions)]
    return changes


def differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """The keys whose values differ, with both values; None if absent."""
    return [(key, a.get(key), b.get(key)) for key in {**a, **b} if a.get(key) != b.get(key)]


def pairs_left_out(base: FinishedRun, other: FinishedRun) -> dict[str, str]:
    """Pairs that cannot be compared, and why."""
    why = {}
    for name in sorted({*base.rows_by_name, *other.rows_by_name}):
        hashes = [run.record.inputs.get(name, {}).get("real") for run in (base, other)]
        reason = _unscored(other, name) or _unscored(base, name)
        if reason:
            why[name] = reason
        elif hashes[0] is None or hashes[0] != hashes[1]:
            why[name] = OTHER_SCAN
    return why


def _unscored(run: FinishedRun, name: str) -> str:
    """The reason for which a run has no scores of a pair; "" if it has."""
    row = run.rows_by_name.get(name)
    if row is None:
        return f"not in {run.folder}"
    return "" if row["status"] == "scored" else f"failed in {run.folder} ({row['reason']})"


def partition_note(runs: Sequence[FinishedRun]) -> str:
    """That scores vary with the partition, in one line; "" if the real side fixes the objects."""
    if all(run.preset == "reference" for run in runs):
        return ""
    return (
        "objects are those of the paper, each side partitioned independently, so that scores vary "
        "with the partition (by how much: fidpipe run --seeds 5); for comparing simulators: "
        "fidpipe run --preset reference"
    )


def run_values(run: FinishedRun) -> dict[str, Any]:
    """A run as plain values: its record, and the rows of `pairs`."""
    return {"folder": str(run.folder), "record": run.record.as_dict(), "pairs": run.rows}
