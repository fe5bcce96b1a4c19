"""Verification of a finished run: recompute a sample of its numbers by another implementation, and compare.

Objects are drawn at random; `recompute` computes their rows of every table again from the stored tables before it, by
the literal twin (`stages.literal`), which shares no code with the stages. Nothing is written.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from ...schemas.columns import Row
from ...schemas.errors import FidpipeError, RunError
from ...schemas.metric_catalogue import DISTRIBUTED, METRIC, RUN_SCORES
from ...schemas.results import JsonObject
from ...schemas.settings import Settings, parse
from ...schemas.tables import TABLES
from ...stages.literal.literal_method import mean_and_std
from ..datasets.content import input_hashes
from ..datasets.pairs import ScanPair, read_dataset
from ..datasets.stubs import recorded_dataset
from ..jobs import EXTRAS, STAGES
from ..results.finished import FinishedRun
from ..storage.run_record import unmatched_worst
from .compare_frames import NOT_COMPARED, ColumnComparison, compare
from .recompute import RECOMPUTED, UNMATCHED, stages_of
from .recompute_nvs import nvs_means
from .stored import TABLE_OF, Part, Sample, Skipped, StoredPair, summaries, values

DEFAULT_OBJECTS = 20
#: Number of drawn objects per pair with both sides recomputed as a whole, from all distances between them.
_OBJECTS_PER_WHOLE_PAIR = 20
#: Mismatches listed per table.
_MAX_LISTED = 5

#: Compared values of each table, in the order of the report.
COMPARED = {
    "files": "unchanged content (SHA-256)",
    "rows": "names of pair and side, order by keys, no duplicates",
    "scan": "points kept of the scan, and their coordinates",
    "ground": "cut, heights, flags of all points",
    "sensor": "description of the scan, by the same code",
    "graph": "all edge lengths; all edges of drawn nodes",
    "communities": "Louvain again; numbering; reference: nearest real points",
    "objects": "sizes; place and shape of drawn objects",
    "matching": "matched objects and their distances",
    "coverage": "drawn objects, from all distances",
    "surface": "displacement of drawn objects",
    "pieces": "counts, shares and moves of all pieces",
    "rays": "outcomes, from stored ranges; the rest by the same code",
    "ray_scores": "scores of stored rays",
    "selection": "influence, kept nodes, optimal alignment",
    "metrics": "scores from dense matrices",
    "baselines": "baseline metrics",
    "seeds": "row of the configured seed",
    "nvs": "all scores, pixel by pixel",
    "pairs": "counts, cuts, means, deviations, medians",
    "run.json": "means and deviations over pairs",
}

PairDone = Callable[[int, int], None]


@dataclass(frozen=True)
class Mismatch:
    """A stored value that differs from the recomputed one."""

    table: str
    pair_id: str
    side: str
    object: str
    column: str
    stored: str
    recomputed: str


@dataclass
class TableCheck:
    """The comparisons of one table.

    columns : columns with at least one compared value
    largest : largest absolute difference; 0 if all are equal
    where : pair, row and column of the largest difference
    n_wrong : values that differ by more than rounding allows
    """

    table: str
    what: str
    columns: tuple[str, ...] = ()
    n_numbers: int = 0
    largest: float = 0.0
    where: str = ""
    n_wrong: int = 0


@dataclass(frozen=True)
class Verification:
    """The outcome of a verification.

    n_objects, n_drawn : matched, missing and hallucinated objects of all scored pairs, and number of drawn objects
    n_scored, n_pairs, n_scans : scored pairs, pairs of the drawn objects, and those of them with available scans
    tables : one entry per table, in the order of the stages
    mismatches : first mismatches of each table
    not_compared : texts about values that could not be compared
    unknown : columns, as `table.column`, that are not recomputed without a declared reason: they are missing in the
        literal twin
    """

    run: Path
    seed: int
    n_objects: int
    n_drawn: int
    n_scored: int
    n_pairs: int
    n_scans: int
    tables: tuple[TableCheck, ...]
    mismatches: tuple[Mismatch, ...]
    not_compared: tuple[str, ...]
    unknown: tuple[str, ...]

    @property
    def n_numbers(self) -> int:
        """Number of compared values."""
        return sum(table.n_numbers for table in self.tables)

    @property
    def n_wrong(self) -> int:
        """Number of values that do not agree."""
        return sum(table.n_wrong for table in self.tables)

    @property
    def passed(self) -> bool:
        """True if all agree."""
        return not self.n_wrong

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        plain: JsonObject = asdict(self)
        counts = {"passed": self.passed, "n_numbers": self.n_numbers, "n_wrong": self.n_wrong}
        return plain | {"run": str(self.run)} | counts


@dataclass
class _Tally:
    """Results of comparisons so far.

    compared, excused : columns (`table.column`) with compared values; columns or tables that need no comparison
    n_rows : by table, of whole tables and of drawn objects; a table without any of either kind cannot be compared
    """

    checks: dict[str, TableCheck] = field(default_factory=dict)
    mismatches: dict[str, list[Mismatch]] = field(default_factory=dict)
    skipped: Counter[str] = field(default_factory=Counter)
    compared: set[str] = field(default_factory=set)
    excused: set[str] = field(default_factory=lambda: {*NOT_COMPARED})
    n_rows: Counter[tuple[str, bool]] = field(default_factory=Counter)
    is_damaged: bool = False

    def add(self, parts: Iterable[Part | Skipped], pair_id: str = "") -> None:
        """Compare the parts of a table."""
        for part in parts:
            if isinstance(part, Skipped):
                self.skipped.update([part.why] if part.why else [])
                self.excused.update(part.columns)
                continue
            table = TABLE_OF.get(part.table, part.table)
            self.n_rows[table, part.is_whole] += len(part.recomputed)
            for column in compare(table, part.stored, part.recomputed, is_whole=part.is_whole):
                self._count(part, pair_id, column)
                if len(column.rows):
                    self.compared.add(column.column if "." in column.column else f"{table}.{column.column}")

    def check(self, table: str) -> TableCheck:
        """Result of a table, created if necessary."""
        self.mismatches.setdefault(table, [])
        return self.checks.setdefault(table, TableCheck(table, COMPARED[table]))

    def reject(self, table: str, pair_id: str, why: str) -> None:
        """Count an unusable table as a mismatch."""
        self.is_damaged = True
        self.check(table).n_wrong += 1
        shown = Mismatch(table, pair_id, "", "", "the table", "is unusable", why)
        self.mismatches[table] += [shown] if len(self.mismatches[table]) < _MAX_LISTED else []

    def unknown(self, tables: Iterable[str]) -> Iterator[str]:
        """Columns that were not compared without a declared reason; empty if a table is damaged."""
        without_rows = {table for (table, _), n in self.n_rows.items() if not n}
        for table in tables:
            if not (self.is_damaged or table in self.excused | without_rows):
                columns = (f"{table}.{name}" for name in TABLES[table].schema.names)
                yield from (name for name in columns if name not in self.compared | self.excused)

    def columns(self, table: str) -> tuple[str, ...]:
        """Compared columns of a table, in its order."""
        names = TABLES[table].schema.names if table in TABLES else []
        return tuple(name for name in names if f"{table}.{name}" in self.compared)

    def _count(self, part: Part, pair_id: str, column: ColumnComparison) -> None:
        check, listed = self.check(part.table), self.mismatches[part.table]
        check.n_numbers += len(column.rows)
        check.n_wrong += int(column.is_wrong.sum())
        if len(column.rows) and column.difference.max() > check.largest:
            i = int(column.difference.argmax())
            place = _object(column.rows, i, part.side) or part.side
            words = (f"pair {pair_id}" if pair_id else "", place, column.column)
            check.largest, check.where = float(column.difference[i]), ", ".join(filter(None, words))
        for i in np.flatnonzero(column.is_wrong)[: _MAX_LISTED - len(listed)].tolist():
            name = _object(column.rows, i, part.side)
            shown = column.column, _word(column.stored[i]), _word(column.recomputed[i])
            listed.append(Mismatch(part.table, pair_id, part.side, name, *shown))


def verify_run(
    folder: Path, n_objects: int | None = DEFAULT_OBJECTS, seed: int = 0, pair_done: PairDone | None = None
) -> Verification:
    """Compare the tables of a finished run with those that the literal twin computes from the preceding tables.

    Parameters
    ----------
    folder : folder of the run
    n_objects : number of objects to draw, at most all; None for all, with every node and both whole sides of each pair
    seed : seed of the draw
    pair_done : called after each pair with the number of finished pairs and of all pairs

    Raises
    ------
    RunError
        The folder is not a run, the run has not ended, its table of pairs cannot be read, or another
        version of a stage computed it.
    """
    run = FinishedRun(folder)
    current = {stage.name: stage.version for stage in (*STAGES, *EXTRAS)}
    if other := [name for name, version in run.record.stages.items() if current.get(name, version) != version]:
        raise RunError(f"run {folder}: {', '.join(other)} by another version of fidpipe; recompute it with fidpipe run")
    settings = parse({group: own for group, own in run.record.settings.items() if group in Settings.model_fields})
    tally, rng = _Tally(), np.random.default_rng(seed)
    tally.add(_files(run))
    tally.add(_pair_names(run))
    counts = [(row["pair_id"], _n_rows(run, row["pair_id"])) for row in run.scored]
    total = sum(n for _, n in counts)
    n_drawn = total if n_objects is None else min(n_objects, total)
    drawn = _draw(counts, np.sort(rng.choice(total, n_drawn, replace=False)).tolist() if total else [])
    n_whole = len(drawn) if n_objects is None else max(1, n_drawn // _OBJECTS_PER_WHOLE_PAIR)
    scans, label_names, faults = _unchanged_scans(run, drawn)
    tables: list[str] = []
    for i, (pair_id, rows) in enumerate(drawn.items()):
        sample = Sample(rows, all_nodes=n_objects is None, whole_sides=i < n_whole, rng=rng)
        pair = StoredPair(run, pair_id, settings, sample, scans.get(pair_id), label_names)
        tables = [*(table for stage in stages_of(pair) for table in stage.gives), "pairs", "timings"]
        _compare_pair(pair, tally)
        if pair_done:
            pair_done(i + 1, len(drawn))
    _compare_record(run, settings, tally)
    not_compared = [*_not_compared(tally, tables, n_whole, len(drawn)), *faults]
    for check in tally.checks.values():
        check.columns = tally.columns(check.table)
    order = [table for table in COMPARED if table in tally.checks]
    return Verification(
        run=folder,
        seed=seed,
        n_objects=total,
        n_drawn=n_drawn,
        n_scored=len(counts),
        n_pairs=len(drawn),
        n_scans=len(scans),
        tables=tuple(tally.checks[table] for table in order),
        mismatches=tuple(mismatch for table in order for mismatch in tally.mismatches[table]),
        not_compared=tuple(not_compared),
        unknown=tuple(tally.unknown(tables)),
    )


def _compare_record(run: FinishedRun, settings: Settings, tally: _Tally) -> None:
    """Compare the values of `run.json` that the tables determine."""
    for what, parts in (
        ("unmatched objects", _unmatched),
        ("baselines", _baseline_means),
        ("nvs", nvs_means),
        ("scores", _summary),
    ):
        try:
            tally.add(parts(run, settings))
        except (RunError, LookupError, TypeError) as error:  # damaged, which is reported already
            tally.add([Skipped(f"{what} in run.json: {error}")])


def _not_compared(tally: _Tally, tables: Iterable[str], n_whole: int, n_pairs: int) -> Iterator[str]:
    """Texts about everything that was not compared."""
    yield from (f"{why}: {n} times" if n > 1 else why for why, n in tally.skipped.items())
    if n_whole < n_pairs:
        yield (
            f"coverage medians, displacement, roughness and pieces of whole sides: only of {n_whole} of {n_pairs} "
            "pairs (all distances between two scans); --all compares all"
        )
    yield "findings, overview, and the spread over other seeds"
    yield from (f"{name}: {why}" for name, why in NOT_COMPARED.items() if name.partition(".")[0] in tables)


def _unchanged_scans(
    run: FinishedRun, pair_ids: Iterable[str]
) -> tuple[dict[str, ScanPair], dict[int, str], list[str]]:
    """Pairs of the dataset whose scans are those of the run, its class names, and reasons why other pairs are not."""
    what = "points kept of the scans"
    try:
        dataset = read_dataset(recorded_dataset(run.record.dataset))
    except (FidpipeError, OSError) as error:
        return {}, {}, [f"{what}, and their coordinates: {error}"]
    pairs, unchanged, faults = {pair.pair_id: pair for pair in dataset.pairs}, {}, []
    for pair_id in pair_ids:
        pair, why = pairs.get(pair_id), "is no longer in the dataset"
        try:
            if pair is not None and input_hashes(pair, dataset.label_names) == run.record.inputs.get(pair_id):
                unchanged[pair_id] = pair
                continue
            why = why if pair is None else "the scans of the dataset have changed"
        except (FidpipeError, OSError) as error:
            why = str(error)
        faults.append(f"{what} of pair {pair_id}: {why}")
    return unchanged, dataset.label_names, faults


def _files(run: FinishedRun) -> Iterator[Part]:
    """Hash of each file of the run."""
    for pair_id in ("", *run.store.ledger.pair_ids()):
        for record in run.store.ledger.jobs(pair_id).values():
            for name, stored in record.files.items():
                try:
                    found = stored.sha256 if run.store.content(stored, name) is not None else "another file, or none"
                except (OSError, FidpipeError) as error:
                    found = f"cannot be read ({getattr(error, 'strerror', error)})"
                yield values("files", {f"SHA-256 of {name}": stored.sha256}, {f"SHA-256 of {name}": found})


def _pair_names(run: FinishedRun) -> Iterator[Part]:
    """Order of `pairs`, and that exactly the scored pairs have results and scores."""
    with_scores = sorted(name for name in run.store.ledger.pair_ids() if ("metrics", "") in run.store.ledger.jobs(name))
    names, scored = [row["pair_id"] for row in run.rows], [row["pair_id"] for row in run.scored]
    yield Part("pairs", pd.DataFrame({"pair_id": names}), pd.DataFrame({"pair_id": sorted(set(names))}))
    stored, recomputed = (pd.DataFrame(index=pd.Index(own, name="pair_id")) for own in (scored, with_scores))
    yield Part("pairs", stored, recomputed)
    for row in run.rows:
        if row["status"] != "scored":
            columns = {"status": row["status"], "columns": str(sorted(n for n, own in row.items() if own is not None))}
            failed = {"status": "failed", "columns": str(["pair_id", "reason", "status"])}
            yield values("pairs", columns, failed, pair_id=row["pair_id"])


def _compare_pair(pair: StoredPair, tally: _Tally) -> None:
    """Compare the tables of one pair; an unusable table counts as a mismatch."""
    for table, recompute in RECOMPUTED.items():
        try:
            tally.add(recompute(pair), pair.pair_id)
        except (FidpipeError, LookupError, ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            if isinstance(error, RunError) and tally.check("files").n_wrong:  # reported already
                tally.is_damaged = True
                tally.add([Skipped(f"{table} of a pair with a damaged file")])
            else:
                tally.reject(table, pair.pair_id, str(error))


def _n_rows(run: FinishedRun, pair_id: str) -> int:
    """Number of objects of a pair, matched or not; 0 if its table cannot be read."""
    try:
        return int(run.read_table("matching", pair_id, columns=["status"]).num_rows)
    except RunError:
        return 0


def _draw(counts: list[tuple[str, int]], numbers: list[int]) -> dict[str, list[int]]:
    """Rows of `matching` by pair, from ascending numbers over the rows of all pairs."""
    ends = np.cumsum([n for _, n in counts])
    drawn: dict[str, list[int]] = {}
    for number in numbers:
        i = int(np.searchsorted(ends, number, side="right"))
        drawn.setdefault(counts[i][0], []).append(int(number - ends[i] + counts[i][1]))
    return drawn


def _summary(run: FinishedRun, settings: Settings) -> Iterator[Part]:
    """Counts of pairs, means and deviations over pairs in `run.json`, from the rows of `pairs`."""
    scored, counts = run.scored, run.record.pairs
    stored: Row = {"pairs.scored": counts.scored, "pairs.failed": counts.failed}
    expected: Row = {"pairs.scored": len(scored), "pairs.failed": len(run.rows) - len(scored)}
    columns = {name: [row[name] for row in scored] for name in RUN_SCORES}
    for name in DISTRIBUTED:
        columns[unmatched_worst(name)] = []
        for row in scored:
            n = row["n_matched"] - (0 if "required" in METRIC[name].flags else row["n_too_small"])
            n_alone, worst = row["n_missing"] + row["n_hallucinated"], METRIC[name].high or 0.0
            sums = (row[METRIC[name].mean_column] or 0.0) * n + worst * n_alone
            columns[unmatched_worst(name)].append(sums / (n + n_alone) if n + n_alone else None)
    for name, own in columns.items():
        summary, (mean, std) = run.record.summary.get(name), mean_and_std(own)
        n_pairs = sum(value is not None for value in own)
        for key, value in {"mean": mean, "std": std, "n_pairs": n_pairs}.items():
            stored[f"summary.{name}.{key}"], expected[f"summary.{name}.{key}"] = getattr(summary, key, None), value
    yield values("run.json", stored, expected)


def _unmatched(run: FinishedRun, settings: Settings) -> Iterator[Part]:
    """Number of unmatched objects that the other side has, has partly, or lacks, and of those that are road there."""
    expected = {f"{word}.{state}": 0 for word in UNMATCHED.values() for state in ("there", "partly", "absent", "road")}
    for own in run.scored:
        rows = run.read_table("coverage", own["pair_id"]).to_pylist()
        coverage = {(row["side"], row["community_id"]): row for row in rows}
        for match in run.read_table("matching", own["pair_id"]).to_pylist():
            for side, word in UNMATCHED.items():
                if match["status"] == word:
                    row = coverage[side, match[f"{side}_id"]]
                    share = row["covered_0p3m"]
                    expected[f"{word}.{'there' if share > 0.8 else 'partly' if share > 0.2 else 'absent'}"] += 1
                    expected[f"{word}.road"] += (row["road_share"] or 0) > 0.5
    unmatched = run.record.metrics and run.record.metrics.unmatched
    for name, n in expected.items():
        word, state = name.split(".")
        column, stored = f"metrics.unmatched.{name}", getattr(unmatched, word)
        yield values("run.json", {column: getattr(stored, state)}, {column: n})


def _baseline_means(run: FinishedRun, settings: Settings) -> Iterator[Part]:
    """Means and deviations over pairs of the baseline metrics, of objects and of whole scans."""
    of_pairs: dict[tuple[str, str], list[list[float | None]]] = {}
    for own in run.scored if settings.metrics.baselines else []:
        of_pair: dict[tuple[str, str], list[float | None]] = {}
        for row in run.read_table("baselines", own["pair_id"]).to_pylist():
            level = "scans" if row["real_id"] is None else "objects"
            of_pair.setdefault((row["baseline"], level), []).append(row["value"])
        for name, own_values in of_pair.items():
            of_pairs.setdefault(name, []).append(own_values)
    expected = []
    for (baseline, level), pairs in of_pairs.items():
        mean, std = mean_and_std([mean_and_std(own_values)[0] for own_values in pairs])
        n_null = sum(own_values.count(None) for own_values in pairs)
        n = sum(map(len, pairs)) - n_null
        expected.append((baseline, level, mean, std, n, n_null))
    yield summaries(run.record.baselines, expected)


def _object(rows: pd.Index[Any], i: int, side: str) -> str:
    """Text of the keys of a row, such as "real 3, sim 5" or "point 12"; "" for single values and whole sides."""
    key = rows[i] if isinstance(rows, pd.MultiIndex) else (rows[i],)
    named = {str(name): value for name, value in zip(rows.names, key, strict=True) if name is not None and value != -1}
    side = named.pop("side", side) if len(named) > 1 else side
    of_side = {"community_id": side}
    return ", ".join(f"{of_side.get(name, name.removesuffix('_id'))} {value}" for name, value in named.items())


def _word(value: object) -> str:
    """Text of a value with all its digits."""
    if isinstance(value, float | np.floating):
        return "null" if np.isnan(value) else repr(float(value))
    return "null" if value is None else str(value)
