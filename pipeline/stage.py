"""Definition of a stage: its inputs, its outputs, and the argument of its job.

A stage declares tables, groups of settings, and its grain. Its job is a function
of these: they arrive as its argument, and nothing else does, so that a result never depends on
something that its key does not cover. The grain determines whether a job runs alone, with others of
its pair, or object by object; the job does not know.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import Enum
from time import perf_counter
from typing import Any, TypeVar

import pyarrow as pa

from ..schemas.columns import SIDES, Row
from ..schemas.settings import Settings
from ..schemas.tables import TABLES
from .datasets.readers.scan import Scan
from .storage.table_files import JobRecord

SCAN = "scan"  #: among the inputs of a stage: the side's input file
OBJECTS = "objects"  #: metadata: the objects that later stages process one by one
OF_PAIR = "pairs"  #: metadata: columns of the pair's row in `pairs`
N_CLEAN = "n_clean"  #: metadata: number of points of a side after cleaning
INSPECTION = "inspection"  #: metadata: plausibility of a side's scan, see `stages.plausibility`
FRAMES = "frames"  #: metadata: comparison of both scans' frames, see `stages.frame_search`
UNEXPLAINED = "unexplained"  #: row of table `gains`: distance that no correction removes
DISTANCES = "distances_m"  #: metadata of gains: distance before and after corrections, and of a second measurement
AMOUNTS = "amounts"  #: metadata of gains: mean amount of each cause that was corrected

Metadata = dict[str, Any]
Tables = dict[str, pa.Table]
Value = TypeVar("Value")


class Grain(Enum):
    """The scope of one job of a stage."""

    SIDE = "side"  #: one side of a pair; both sides may run at the same time
    PAIR = "pair"  #: both sides of a pair
    OBJECT = "object"  #: matched objects of a pair, of which any number may be scored anywhere


@dataclass(frozen=True)
class JobResult:
    """The output of a job.

    tables : by name, as its stage declares them; for grain OBJECT the rows of its objects
    metadata : small results that are not a table; later stages and the run's tables read them
    """

    tables: Tables
    metadata: Metadata = field(default_factory=dict)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stage:
    """One step of the pipeline.

    name : in commands and in `timings`
    takes : names of tables; `SCAN` for the input file. A table comes with the metadata of its job
    gives : names of tables
    settings : the groups of settings that it reads
    grain : scope of one job, by default the pair
    version : of its code, raised by hand whenever its results change
    make : the job
    libraries : libraries that it may call in addition to numpy and scipy; their versions are in its
        key
    takes_real : tables of the real side that the job of the simulated side reads under given
        settings; may include the stage's own
    gather : for grain OBJECT, returns the metadata of the pair from the rows of all objects
    is_wanted : for an extra, True if the settings request it; None for a stage that every run has
    summarise : entries of `run.json` about its finished jobs
    arguments : plain values for its jobs, covered by their keys
    is_long : True if a job takes minutes, however small its pair is: no other pair shares its batch
    """

    name: str
    takes: tuple[str, ...]
    gives: tuple[str, ...]
    settings: tuple[str, ...] = ()
    grain: Grain = Grain.PAIR
    version: int = 1
    make: Callable[[Inputs], JobResult]
    libraries: tuple[str, ...] = ()
    takes_real: Callable[[Settings], tuple[str, ...]] = lambda settings: ()
    gather: Callable[[Inputs, Tables], Metadata] | None = None
    is_wanted: Callable[[Settings], bool] | None = None
    summarise: Callable[[Iterable[JobRecord], Settings], dict[str, Any]] | None = None
    arguments: tuple[Any, ...] = ()
    is_long: bool = False

    @property
    def parts(self) -> tuple[str, ...]:
        """The parts of a pair that have a job each: its sides, or "" for the whole."""
        return SIDES if self.grain is Grain.SIDE else ("",)

    @property
    def is_extra(self) -> bool:
        """True if a pair can be scored without it."""
        return self.is_wanted is not None


class Steps:
    """Seconds of the steps of a job."""

    def __init__(self, seconds: Iterable[tuple[str, float]] = ()) -> None:
        self._seconds = list(seconds)

    @contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a step; without the steps within it."""
        start = perf_counter()
        n_before = len(self._seconds)
        try:
            yield
        finally:
            inside = sum(seconds for _, seconds in self._seconds[n_before:])
            self._seconds.append((name, perf_counter() - start - inside))

    def total(self) -> tuple[tuple[str, float], ...]:
        """Seconds by step, each step once, in the order in which they first appear."""
        total: dict[str, float] = {}
        for name, seconds in self._seconds:
            total[name] = total.get(name, 0.0) + seconds
        return tuple(total.items())


class Memo:
    """Results of functions that jobs of a pair have in common: equal arguments, tables by identity, are computed once.

    A job gets what another one left only if it has the same arguments, so that no input goes
    undeclared.
    """

    def __init__(self) -> None:
        self._results: dict[tuple[Any, ...], tuple[Any, tuple[Any, ...]]] = {}

    def __call__(self, function: Callable[..., Value], *arguments: Any) -> Value:
        """The result of a function of tables and plain values."""
        key = (
            function,
            *(id(value) if isinstance(value, pa.Table) else value for value in arguments),
        )
        if key not in self._results:
            # kept, so that no other table gets the same id
            self._results[key] = (
                function(*arguments),
                arguments,
            )
        return self._results[key][0]


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Argument of a job: what its stage declares, and nothing else.

    part : the side, or ""
    settings : the declared groups
    tables : by name and side, "" for a table of the pair; read when first called
    outputs : metadata of the jobs that made these tables, by name and side
    scans : by side, the input file, if the stage takes it; read when first called
    T_real_sim : motion of the simulated into the real sensor's frame, 12 numbers row by row; None
        if not given, or if the stage takes no input file, or for the real side, whose key does not
        cover it
    objects : of grain OBJECT, the ids of the matched objects to be scored
    arguments : of the stage
    step : times a step of the job
    memo : computes once what several jobs of the pair need
    """

    pair_id: str
    part: str
    settings: Settings
    tables: Mapping[tuple[str, str], Callable[[], pa.Table]]
    outputs: Mapping[tuple[str, str], Metadata]
    scans: Mapping[str, Callable[[], Scan]]
    T_real_sim: tuple[float, ...] | None
    objects: tuple[int, ...]
    arguments: tuple[Any, ...]
    step: Steps
    memo: Memo

    def table(self, name: str, side: str = "") -> pa.Table:
        """A table; `KeyError` if it or its side is not declared."""
        return self.tables[name, side]()

    def metadata(self, name: str, side: str = "") -> Metadata:
        """Metadata of the job that made a table; `KeyError` for a table or side that is not declared."""
        return self.outputs[name, side]

    def rows(self, name: str, rows: Iterable[Row]) -> Tables:
        """One table, by its name: its rows without pair and side, sorted by its keys."""
        return {name: TABLES[name].from_rows(self._of_file | row for row in rows)}

    def columns(self, name: str, *parts: Row) -> Tables:
        """One table, by its name, of parts in their order: columns without pair and side."""
        table = TABLES[name]
        built = [table.build(self._of_file | part) for part in parts]
        joined = pa.concat_tables(built or [table.schema.empty_table()])
        return {name: joined.combine_chunks()}

    @property
    def _of_file(self) -> Row:
        return {"pair_id": self.pair_id, "side": self.part}
