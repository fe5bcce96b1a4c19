"""What a stage is: what it takes, what it gives, and what its job may ask for while it works.

A stage declares tables with their columns, groups of settings, and its grain. Its job receives these through a
`Context` and nothing else: asking for anything that was not declared is an error, so that a result never depends on
something that its key does not cover. Whether a job runs alone, with others of its pair, or object by object follows
from the grain and never appears in the job.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from enum import Enum
from time import perf_counter
from typing import Any, Protocol, TypeVar, cast

import pyarrow as pa

from ..schemas.columns import SIDES
from ..schemas.settings import Settings
from .datasets.readers.scan import Scan
from .storage.tables import JobRecord

SCAN = "scan"  #: among what a stage takes: the side's input file
OBJECTS = "objects"  #: the fact in which a stage lists the objects that later stages go over one by one

ROW = "row"  #: the fact in which the stage that ends a pair gives the pair's row of `pairs`

Facts = dict[str, Any]
Tables = dict[str, pa.Table]
Step = Callable[[str], AbstractContextManager[None]]
Column = tuple[str, str, str]  #: table, side and column; "" for its facts or the input file
Value = TypeVar("Value")


class Grain(Enum):
    """What one job of a stage is about."""

    SIDE = "side"  #: one side of a pair; both sides may run at the same time
    PAIR = "pair"  #: both sides of a pair
    OBJECT = "object"  #: matched objects of a pair, of which any number may be scored anywhere


class UndeclaredError(Exception):
    """A job asked for what its stage does not declare: a fault of the stage, which its first test shows."""


@dataclass(frozen=True)
class Made:
    """What a job gives.

    tables : by name, those that its stage gives; of grain OBJECT the rows of the objects that it was asked for
    facts : small results that are not a table; later stages and the run's tables read them
    """

    tables: Tables
    facts: Facts = field(default_factory=dict)


def _no_libraries(settings: Settings) -> tuple[str, ...]:
    return ()


def _never(settings: Settings) -> bool:
    return False


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """One row of the pipeline.

    name : as the command and `timings` have it
    takes : the columns that it reads, by table; `SCAN` for the input file. A table comes with the facts of its job
    gives : names of tables
    settings : the groups of settings that it reads
    grain : what one job is about
    version : of its code, raised by hand whenever its results change
    make : the job
    libraries : what it calls besides numpy and scipy, under given settings; their versions belong to its key
    needs_real : whether, under given settings, the simulated side waits for the real side's result, and may read it and
        what it was made of
    gather : of grain OBJECT, the facts of the pair once the rows of all objects are there
    is_wanted : for an extra, whether settings ask for it; None for a stage that every run has
    summarise : for an extra, what `run.json` holds of its finished jobs
    """

    name: str
    takes: Mapping[str, tuple[str, ...]]
    gives: tuple[str, ...]
    settings: tuple[str, ...] = ()
    grain: Grain
    version: int = 1
    make: Callable[[Context], Made]
    libraries: Callable[[Settings], tuple[str, ...]] = _no_libraries
    needs_real: Callable[[Settings], bool] = _never
    gather: Callable[[Context, Tables], Facts] | None = None
    is_wanted: Callable[[Settings], bool] | None = None
    summarise: Callable[[Iterable[JobRecord], Settings], Any] | None = None

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of a pair that have a job each: its sides, or "" for the whole."""
        return SIDES if self.grain is Grain.SIDE else ("",)

    @property
    def is_extra(self) -> bool:
        """Whether a pair is scored without it."""
        return self.is_wanted is not None


class PairSource(Protocol):
    """Where the tables of one pair come from: those just made, and those that are read when first asked for."""

    pair_id: str
    T_real_sim: tuple[float, ...] | None

    def table(self, name: str, side: str, columns: tuple[str, ...], step: Step) -> pa.Table:
        """Columns of a table, all where none is named; `step` is entered while a file is read."""

    def facts(self, table: str, side: str) -> Facts:
        """The facts of the job that gave a table."""

    def scan(self, side: str) -> Scan:
        """The input file of a side."""

    def memory(self) -> dict[str, tuple[Any, set[Column]]]:
        """What jobs of this pair keep for each other, each with the columns that it was made of."""

    def is_by_object(self, table: str) -> bool:
        """Whether a stage over objects gives the table, so that some of its rows may be here and others elsewhere."""


class Context:
    """What a job may ask for: the tables, columns and settings that its stage declares.

    Parameters
    ----------
    stage : whose job it is
    part : the side, the part of an experiment, or ""
    settings : in force
    source : the tables of the pair
    objects : of grain OBJECT, the ids of those that are wanted
    arguments : of a part of an experiment, what makes it another than its neighbours; plain values
    """

    def __init__(
        self,
        stage: Stage,
        part: str,
        settings: Settings,
        source: PairSource,
        objects: Sequence[int] = (),
        arguments: tuple[Any, ...] = (),
    ) -> None:
        self.part = part
        self.steps: list[tuple[str, float]] = []
        self._objects, self._arguments = tuple(objects), arguments
        self._stage, self._source = stage, source
        self._needs_real = stage.needs_real(settings)
        self._settings = _DeclaredSettings(stage, settings)
        self._asked: list[set[Column]] = []

    @property
    def pair_id(self) -> str:
        """The name of the pair."""
        return self._source.pair_id

    @property
    def side(self) -> str:
        """The side that the job is about; "" where it is about both."""
        return self.part if self._stage.grain is Grain.SIDE else ""

    @property
    def needs_real(self) -> bool:
        """Whether this job is the simulated side's and may read the real side's result."""
        return self.side == "sim" and self._needs_real

    @property
    def objects(self) -> tuple[int, ...]:
        """Of grain OBJECT, the ids of the matched objects whose rows are wanted."""
        self._refuse_in_once("objects")
        return self._objects

    @property
    def arguments(self) -> tuple[Any, ...]:
        """Of a part of an experiment, what makes it another than its neighbours."""
        self._refuse_in_once("arguments")
        return self._arguments

    @property
    def settings(self) -> Settings:
        """The settings in force, of the declared groups."""
        self._refuse_in_once("settings")
        return cast(Settings, self._settings)

    @property
    def T_real_sim(self) -> tuple[float, ...] | None:
        """The pair's motion of the simulated into the real sensor's frame, 12 numbers row by row; None if not given.

        Raises
        ------
        UndeclaredError
            The stage does not take the input files, or the job is about the real side, whose key does not cover it.
        """
        self._ask(SCAN, self.side)
        if self.side == "real":
            raise UndeclaredError(f"stage {self._stage.name}, real asks for T_real_sim, which moves the simulated side")
        return self._source.T_real_sim

    def scan(self, side: str | None = None) -> Scan:
        """The input file of a side, by default the job's own; its columns are read by the settings `input`."""
        side = self.side if side is None else side
        self._ask(SCAN, side)
        return self._source.scan(side)

    def table(self, name: str, side: str | None = None, columns: Sequence[str] | None = None) -> pa.Table:
        """Columns of a table.

        Parameters
        ----------
        name : of the table
        side : whose; by default the job's own, or "" for a table of the pair
        columns : some of those that are declared; by default all of them

        Raises
        ------
        UndeclaredError
            The stage does not declare the table or a column, or may not see that side.
        """
        side = self.side if side is None else side
        wanted = tuple(self._stage.takes.get(name, ()) if columns is None else columns)
        if name in self._stage.takes and not wanted:
            raise UndeclaredError(f"stage {self._stage.name} asks for the table {name}; it declares its facts alone")
        self._ask(name, side, *wanted)
        return self._source.table(name, side, wanted, self.step)

    def facts(self, table: str, side: str | None = None) -> Facts:
        """The facts of the job that gave a table; of the own stage those of the real side, where it waits for it.

        Raises
        ------
        UndeclaredError
            The stage does not declare the table or may not see that side; or both stages are of grain OBJECT: a
            pair's facts are gathered when all its objects are done.
        """
        side = self.side if side is None else side
        self._ask(table, side)
        if self._stage.grain is Grain.OBJECT and self._source.is_by_object(table):
            raise UndeclaredError(
                f"stage {self._stage.name} asks for the facts of {table}, not all of whose objects are done"
            )
        return self._source.facts(table, side)

    def once(self, name: str, make: Callable[[], Value]) -> Value:
        """What `make` gives, made once for all jobs of the pair in this process.

        `make` may ask for tables, facts and scans alone: settings, arguments and objects differ between jobs. A job
        gets what another has left only where it could have made it itself.

        Raises
        ------
        UndeclaredError
            It is made of what the stage does not declare; or, of grain OBJECT, of rows that other objects do not have.
        """
        memory = self._source.memory()
        if name not in memory:
            self._asked.append(set())
            try:
                value = make()
            finally:
                asked = self._asked.pop()
            memory[name] = value, asked
        value, asked = memory[name]
        for table, side, column in sorted(asked):
            if fault := self._why_not(table, side, column):
                raise UndeclaredError(f"stage {self._stage.name}: {name} is made of {fault}")
            if self._stage.grain is Grain.OBJECT and self._source.is_by_object(table):
                raise UndeclaredError(
                    f"stage {self._stage.name}: {name} is made of {table}, whose rows differ by object"
                )
        for outer in self._asked:
            outer.update(asked)
        return cast(Value, value)

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Times a step of the job."""
        start, n_before = perf_counter(), len(self.steps)
        try:
            yield
        finally:
            inside = sum(seconds for _, seconds in self.steps[n_before:])  # of steps within this one
            self.steps.append((name, perf_counter() - start - inside))

    def _ask(self, table: str, side: str, *columns: str) -> None:
        """Notes what is asked for, and refuses what is not declared."""
        for column in columns or ("",):
            if fault := self._why_not(table, side, column):
                raise UndeclaredError(f"stage {self._stage.name} asks for {fault}")
            for asked in self._asked:
                asked.add((table, side, column))

    def _why_not(self, table: str, side: str, column: str) -> str:
        """Why a column (a table, where it is "") may not be asked for; "" if it may."""
        stage = self._stage
        is_own_real = self.needs_real and side == "real"
        if is_own_real and table in stage.gives:
            return ""
        if table not in stage.takes:
            return f"{table}; it declares {', '.join(stage.takes) or 'no table'}"
        if column and column not in stage.takes[table]:
            return f"{table}.{column}; of {table} it declares {', '.join(stage.takes[table]) or 'the facts alone'}"
        if table == SCAN and "input" not in stage.settings:
            return "the input file; it does not declare the settings input, by which its columns are read"
        if self.side and side not in ("", self.side) and not is_own_real:
            return f"{table} of the {side} side; its job is about the {self.side} side"
        return ""

    def _refuse_in_once(self, what: str) -> None:
        if self._asked:
            raise UndeclaredError(
                f"stage {self._stage.name} asks for {what} in what is made once for all jobs of the pair"
            )


class _DeclaredSettings:
    """The groups of settings that a stage declares."""

    def __init__(self, stage: Stage, settings: Settings) -> None:
        self._stage, self._values = stage, settings

    def __getattr__(self, group: str) -> Any:
        if group.startswith("__"):
            raise AttributeError(group)
        if group not in self._stage.settings:
            raise UndeclaredError(
                f"stage {self._stage.name} asks for the settings {group}; it declares "
                f"{', '.join(self._stage.settings) or 'none'}"
            )
        return getattr(self._values, group)


def total_steps(steps: Iterable[tuple[str, float]]) -> tuple[tuple[str, float], ...]:
    """Seconds by step, each step once, in the order in which they first appear."""
    total: dict[str, float] = {}
    for name, seconds in steps:
        total[name] = total.get(name, 0.0) + seconds
    return tuple(total.items())
