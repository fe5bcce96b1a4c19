"""A finished run as it is read again: its record, its pairs, and the objects of one pair; nothing is computed.

What is read is checked against the run's index, so that a damaged table is reported and not used. The values
that `fidpipe show` prints for a run, a pair or an object are defined here, for the terminal and for JSON.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ...schemas.cause_catalogue import UNEVEN
from ...schemas.columns import SIDES, Row
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import METRIC, QUADRANT_SCORES, metric_of
from ...schemas.record import RunRecord, TaskSummary
from ...schemas.results import Cause, Diagnosis, JsonObject, Overview, Unknown
from ...schemas.tables import PAIR_TABLES, TABLES
from ...stages.arrays import IntArray
from ..datasets.pairs import MANIFEST
from ..storage.files import path_exists
from ..storage.folder import RunFolder
from ..storage.run_record import RUN_JSON, command_again, finished_record
from ..storage.urls import url_or_path
from .causes import mean_amount, read_causes
from .diagnosis import diagnosis_of, with_gains
from .object_frame import ALL_COLUMNS, COLUMNS_OF, WITH_UNITS, object_parts, plain_rows

if TYPE_CHECKING:
    import pandas as pd

#: Tables of the whole run, in one file each.
_OF_RUN = ("pairs", "timings")
#: Scores that are shown with their spread over partitions.
_BY_CHANCE = ("match_rate", *(METRIC[score].mean_column for score in QUADRANT_SCORES))


def record_of_run(folder: Path) -> dict[str, Any]:
    """The record of a run; raises `RunError` with the next step if the folder holds none."""
    shown = url_or_path(folder)
    if folder.is_file() or path_exists(folder / RUN_JSON):
        return finished_record(folder)
    names = {path.name for path in folder.iterdir()} if folder.is_dir() else set[str]()
    runs = [
        shlex.quote(str(folder / name))
        for name in sorted(names)
        if path_exists(folder / name / RUN_JSON)
    ]
    if names & {*SIDES, MANIFEST}:
        command = f"fidpipe run {shlex.quote(shown)} --out runs/{folder.resolve().name}"
        hint = f"it holds a dataset, evaluate it: {command}"
    elif runs:
        hint = f"it holds runs: {', '.join(runs[:3])}{', ...' if len(runs) > 3 else ''}"
    elif names:
        hint = f"if it holds scans, evaluate them: fidpipe run {shlex.quote(shown)} SIM"
    else:
        hint = f"make a run: fidpipe run DATASET --out {shlex.quote(shown)}"
    problem = f"no {RUN_JSON} found" if folder.is_dir() else "no such folder"
    raise RunError(f"run {shown}: {problem}, expected a folder written by fidpipe run; {hint}")


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
        if made_by := record.get("experiment"):
            raise RunError(
                f"run {folder}: expected a folder written by fidpipe run, got one of fidpipe "
                f"{made_by}; its tables are "
                f"{folder}/{made_by}*.parquet"
            )
        self.store = RunFolder(folder)
        try:
            self.record = RunRecord.from_dict(record)
        except ValueError as error:
            if self.store.is_locked:
                raise RunError(
                    f"run {folder}: another fidpipe is working on this run; wait until it ends"
                ) from error
            command = command_again(folder, record.get("dataset"))
            raise RunError(
                f"run {folder}: the run has not ended; finish it with: {command}"
            ) from error
        self.rows: list[Row] = self.read_table("pairs").to_pylist()
        self.rows_by_name: dict[str, Row] = {row["pair_id"]: row for row in self.rows}

    def __repr__(self) -> str:
        counts = self.record.pairs
        states = f"{counts.scored} pairs scored, {counts.failed} failed"
        return f"<fidpipe run {self.folder}: {states}, preset {self.preset}>"

    @property
    def pairs(self) -> pd.DataFrame:
        """One row per pair, failed ones with their reason; its columns are in `schemas/tables.csv`."""
        return _frame(self.table("pairs"))

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
        frame = self.objects_of(self.select()).rename(columns=WITH_UNITS)
        first = ["pair_id", "side", "community_id", "fate", "partner", "label", "shape"]
        others = frame.columns.difference([*first, "pair", "band"], sort=False)
        return frame[[*first, *others]]

    @property
    def metrics(self) -> pd.DataFrame:
        """One row per matched object of all scored pairs; its columns are in `schemas/tables.csv`."""
        return _frame(self.table("metrics"))

    @property
    def tasks(self) -> pd.DataFrame:
        """One row per pair, task, measure and group of obstacles; raises `RunError` without tasks."""
        self._refuse_without_tasks()
        return _frame(self.table("tasks"))

    @property
    def task_gaps(self) -> pd.DataFrame:
        """(pairs, measures) the gap over everything, by names such as `objects.lost`; `RunError` without tasks."""
        rows = self.tasks.query("group == 'all'")
        rows = rows.assign(name=rows["task"] + "." + rows["measure"])
        return rows.pivot(index="pair_id", columns="name", values="gap")

    @property
    def task_summaries(self) -> tuple[TaskSummary, ...]:
        """Means over pairs of the measures of the tasks; raises `RunError` without tasks."""
        self._refuse_without_tasks()
        return self.record.tasks

    def _refuse_without_tasks(self) -> None:
        if not self.record.tasks:
            raise RunError(f"run {self.folder}: it has no tasks; add them with fidpipe run --tasks")

    def points(self, pair_id: str, side: str) -> pd.DataFrame:
        """The clean points of a side, (x, y, z) in metres in the real sensor's frame, and the object of each.

        Columns of the table `ground`, and `community_id`, which is null for ground.
        """
        points = _frame(self._of_side("ground", pair_id, side))
        labels = _frame(self._of_side("communities", pair_id, side))[["point_id", "community_id"]]
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
            return self.read_table(name)
        if name not in PAIR_TABLES:
            raise RunError(
                f"run {self.folder}: no table {name!r}; it has "
                f"{', '.join((*_OF_RUN, *PAIR_TABLES))}"
            )
        names = [row["pair_id"] for row in self.scored] if pairs is None else list(pairs)
        sides = SIDES if "side" in TABLES[name].of_file else ("",)
        parts = []
        for pair_id in names:
            parts += [self.read_table(name, self._scored(pair_id), side) for side in sides]
        if not parts:
            return TABLES[name].schema.empty_table()
        return pa.concat_tables(
            parts
        ).replace_schema_metadata()  # that of the first file says which job wrote it

    @property
    def causes(self) -> pd.DataFrame:
        """One row per named cause, in the order in which to fix them; `table("causes")` has the amounts of each pair.

        Columns are the fields of `schemas.results.Cause`, without its curves.
        """
        import pandas as pd

        columns = [name for name in Cause.model_fields if name not in ("evidence", "limbs")]
        causes = self.overview.causes if self.overview else ()
        return pd.DataFrame([vars(cause) for cause in causes], columns=columns)

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """The gains of correcting each cause; None if the run was not diagnosed since its causes changed."""
        return diagnosis_of(self.store, self.record, [row["pair_id"] for row in self.scored])

    @property
    def overview(self) -> Overview | None:
        """The first answer of the run, with the causes of its diagnosis if it has one; None if no pair is scored."""
        return with_gains(self.record.overview, self.diagnosis)

    @cached_property
    def mean_amounts(self) -> dict[str, Cause | Unknown]:
        """Every cause of the catalogue with its mean amount over the scored pairs, also those that are not named."""
        names = [row["pair_id"] for row in self.scored]
        values = read_causes(self.store, names)
        del values[UNEVEN]
        blocks = self.places(names)
        return {name: mean_amount(name, values[name], blocks) for name in values}

    @property
    def preset(self) -> str:
        """The preset whose objects the run has; see `schemas.settings.PRESETS`."""
        return self.record.preset

    @property
    def scored(self) -> list[Row]:
        """The rows of the scored pairs, by name."""
        return [row for row in self.rows if row["status"] == "scored"]

    def select(self, pattern: str | None = None) -> list[str]:
        """Names of the scored pairs that match a pattern (shell style); `RunError` if none does."""
        names = [row["pair_id"] for row in self.scored]
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
            near = (
                sorted(get_close_matches(pair_id, self.rows_by_name, 3)) or [*self.rows_by_name][:3]
            )
            raise RunError(
                f"run {self.folder}: no pair {pair_id!r} among its {len(self.rows)}; "
                f"it has {', '.join(repr(name) for name in near)} ..."
            )
        return self.rows_by_name[pair_id]

    def objects_of(
        self,
        pairs: Sequence[str],
        columns: Collection[str] = ALL_COLUMNS,
        sides: Sequence[str] = SIDES,
    ) -> pd.DataFrame:
        """The objects of scored pairs with coverage, fate and scores; see `object_frame.object_parts`.

        Raises
        ------
        RunError
            A pair failed, or a table is damaged or gone.
        """
        import pandas as pd

        names = [self._scored(name) for name in pairs]
        parts = object_parts(
            self.store, names, columns, by_reference=self.is_by_reference, sides=sides
        )
        return pd.concat(parts, ignore_index=True)

    @property
    def is_by_reference(self) -> bool:
        """True if the real side fixes the objects."""
        return self.preset == "reference"

    def read_table(
        self, table: str, pair_id: str = "", side: str = "", columns: list[str] | None = None
    ) -> pa.Table:
        """A table of one pair (of one side where each side has its own), or of the whole run where `pair_id` is "".

        Parameters
        ----------
        columns : only these; by default all

        Raises
        ------
        RunError
            The file is damaged or gone.
        """
        return self.store.read_table(table, pair_id, side, columns)

    def _of_side(self, table: str, pair_id: str, side: str) -> pa.Table:
        if side not in SIDES:
            raise RunError(f"run {self.folder}: expected side {' or '.join(SIDES)}, got {side!r}")
        return self.read_table(table, self._scored(pair_id), side)

    def _scored(self, pair_id: str) -> str:
        """The name of a pair that is scored; `RunError` if it failed or is not there."""
        row = self.row(pair_id)
        if row["status"] != "scored":
            raise RunError(
                f"run {self.folder}, pair {pair_id}: it failed and has no objects ({row['reason']})"
            )
        return pair_id

    def check_tables(self, pair_id: str) -> None:
        """Raises `RunError` if any table of a scored pair is damaged or gone."""
        for record in self.store.finished_jobs(pair_id).values():
            for name, stored in record.files.items():
                self.store.content(stored, name)


def _frame(table: pa.Table) -> pd.DataFrame:
    frame: pd.DataFrame = table.to_pandas(ignore_metadata=True)
    return frame


#: How the files of the simulated side are read: runs that differ in these alone can be compared.
_OF_SIM_FILES = ("sim_columns", "sim_flip_y", "sim_frame")


def settings_changes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Settings of the stages that every run has and that differ, as text; not how simulated files are read."""
    from ..jobs import STAGES  # with all libraries of the stages

    groups: dict[str, None] = {}
    for stage in STAGES:
        groups |= dict.fromkeys(stage.settings)
    changes = []
    for group in groups:
        settings = [run.record.settings.get(group, {}) for run in (base, other)]
        for name, before, after in differences(*settings):
            if name not in _OF_SIM_FILES:
                changes.append(f"{group}.{name} is {before} and {after}")
    return changes


def version_changes(base: FinishedRun, other: FinishedRun) -> list[str]:
    """Versions of stages and of libraries that differ, as text."""
    a, b = base.record, other.record
    stages = [
        f"code of stage {name}: {x} and {y}" for name, x, y in differences(a.stages, b.stages)
    ]
    libraries = differences(a.libraries, b.libraries)
    return stages + [f"library {name}: {x} and {y}" for name, x, y in libraries]


def differences(a: Mapping[str, Any], b: Mapping[str, Any]) -> list[tuple[str, Any, Any]]:
    """The keys whose values differ, with both values; None if absent."""
    return [(key, a.get(key), b.get(key)) for key in {**a, **b} if a.get(key) != b.get(key)]


def partition_note(runs: Sequence[FinishedRun]) -> str:
    """Spread of the scores over partitions, in one line; "" if the real side fixes the objects."""
    if all(run.preset == "reference" for run in runs):
        return ""
    chance = (
        "how much scores vary with the partition is unknown here "
        "(measure it: fidpipe run --seeds 5)"
    )
    spreads = [run.record.seeds.dataset for run in runs if run.record.seeds]
    moved = []
    for name in _BY_CHANCE:
        least = [spread[name].least_dataset for spread in spreads]
        known = [value for value in least if value is not None]
        if len(known) == len(runs):
            moved.append(f"{metric_of(name).label} by {max(known):.3g}")
    if moved:
        chance = f"another Louvain seed alone moves {', '.join(moved)} (95 %)"
    return (
        f"objects are those of the paper, each side partitioned independently: {chance}; "
        "for comparing simulators: fidpipe run --preset reference"
    )


@dataclass(frozen=True, repr=False)
class ObjectFacts:
    """One object of a pair; without the columns that name pair and side.

    status : matched, not_found or extra
    real, sim : the rows of `objects`, each with that of `coverage`; None if the side does not have it. Of a missing
        object with a number fixed by the real side, `sim` is its few simulated points
    scores : the row of `metrics`; None if it is not matched
    row : that of the frame of objects (`object_frame`), of the real side if it has the object
    """

    status: str
    real: Row | None
    sim: Row | None
    scores: Row | None
    row: Row

    def __repr__(self) -> str:
        rows = (("real", self.real), ("sim", self.sim))
        sides = (
            f"{side} {row['community_id']} ({row['n_points']} points)" for side, row in rows if row
        )
        return f"<object {', '.join(sides)}: {self.status}>"

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        return {"status": self.status, "real": self.real, "sim": self.sim, "scores": self.scores}


@dataclass(frozen=True, repr=False)
class PairFacts:
    """A pair: its row of `pairs`, its objects, and its rows of `ray_scores`; none of both where it failed."""

    pair: Row
    objects: tuple[ObjectFacts, ...]
    rays: tuple[Row, ...] = ()

    def __repr__(self) -> str:
        return f"<pair {self.pair['pair_id']}: {self.pair['status']}, {len(self.objects)} objects>"

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        return {
            "pair": self.pair,
            "objects": [facts.as_dict() for facts in self.objects],
            "rays": [*self.rays],
        }


def run_facts(run: FinishedRun) -> JsonObject:
    """The record and the rows of all pairs of a run, for JSON."""
    return {"folder": str(run.folder), "record": run.record.as_dict(), "pairs": list(run.rows)}


def pair_facts(run: FinishedRun, pair_id: str) -> PairFacts:
    """A pair and its objects: matched ones by r_lambda, worst first, then the others; none if it failed.

    Raises
    ------
    RunError
        The run has no such pair, or a table is damaged.
    """
    row = run.row(pair_id)
    if row["status"] != "scored":
        return PairFacts(row, ())
    objects = _facts(run.objects_of([pair_id]))
    objects.sort(key=_worst_first)
    rays = run.read_table("ray_scores", pair_id).drop_columns(["pair_id"]).to_pylist()
    return PairFacts(row, tuple(objects), tuple(rays))


def _worst_first(facts: ObjectFacts) -> tuple[bool, bool, float]:
    """Key that puts matched objects first, those with the largest r_lambda before the others."""
    r_lambda = facts.row["r_lambda"]
    return facts.scores is None, r_lambda is None, -(r_lambda or 0.0)


def object_facts(run: FinishedRun, pair_id: str, name: str) -> ObjectFacts:
    """One object of a pair: `7` or `real:7` is the real object 7 with its partner, `sim:7` the simulated one.

    Raises
    ------
    RunError
        The pair failed, or it has no such object.
    """
    side, _, number = name.rpartition(":")
    side = side or "real"
    objects = run.objects_of([pair_id])
    counts = {known: int((objects["side"] == known).sum()) for known in SIDES}
    is_number = re.fullmatch("[0-9]{1,9}", number)
    if side not in SIDES or not is_number or int(number) >= counts[side]:
        numbers = " and ".join(f"{n} {known}" for known, n in counts.items())
        raise RunError(
            f"run {run.folder}, pair {pair_id}: no object {name!r}; it has {numbers} objects, "
            "numbered from 0: "
            "7 is a real object, sim:7 a simulated one"
        )
    for facts in _facts(objects):
        row = facts.real if side == "real" else facts.sim
        if row and row["community_id"] == int(number):
            return facts
    raise AssertionError(name)  # every object has its facts


def _facts(objects: pd.DataFrame) -> list[ObjectFacts]:
    """The objects of one pair: matched ones once, remnants with the missing object that they belong to."""
    rows = {(row["side"], row["community_id"]): row for row in plain_rows(objects)}
    facts = []
    for (side, i), row in rows.items():
        fate = row["fate"]
        if fate == "remnant" or (side == "sim" and fate == "matched"):
            continue
        sim: Row | None = None
        scores: Row | None = None
        if fate == "matched":
            sim = rows["sim", row["partner"]]
            scores = {"real_id": i, "sim_id": row["partner"]}
            scores |= {name: row[name] for name in COLUMNS_OF["metrics"]}
        elif side == "sim":
            sim = row
        elif rows.get(("sim", i), row)["fate"] == "remnant":
            sim = rows["sim", i]
        real = _described(row) if side == "real" else None
        facts.append(ObjectFacts(fate, real, sim and _described(sim), scores, row))
    return facts


def _described(row: Row) -> Row:
    """The columns of `objects` and `coverage`."""
    names = ("community_id", "n_points", *COLUMNS_OF["objects"], *COLUMNS_OF["coverage"])
    return {name: row[name] for name in names}
