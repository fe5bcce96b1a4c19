"""Whether the numbers of a finished run are right: some are computed again, another way, and compared.

Objects are drawn at random; from the stored tables that a stage read, its numbers are made again by the literal twin
(`stages.literal`), which shares no code with the stages. What is computed of each table stands in `sides` and
`objects`; here it is decided which objects are drawn, and what is said of them all. Nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from ...schemas.errors import FidpipeError, RunError
from ...schemas.metrics import DISTRIBUTED, METRIC, RUN_SCORES
from ...schemas.results import JsonObject
from ...schemas.settings import Settings, parse
from ...schemas.tables import TABLES
from ...stages.literal.method import mean_and_std
from ..datasets.pairs import Dataset, ScanPair, read_dataset
from ..inspect.scan_checks import input_hashes
from ..jobs import EXTRAS, STAGES
from ..results.finished import FinishedRun
from ..storage.record import unmatched_worst
from . import objects, sides
from .comparisons import LENGTH_M, NOT_COMPARED, Comparisons, Mismatch, Place, TableCheck
from .stored import Drawn, StoredPair, wanted_stages

DEFAULT_OBJECTS = 20
#: One of so many drawn objects has both sides of its pair computed again as a whole, from all distances between them.
_OBJECTS_PER_WHOLE_PAIR = 20

#: What is compared of each table of a pair, in the order of the stages.
_CHECKS: dict[str, Callable[[StoredPair, Comparisons], None]] = {
    "rows": sides.check_rows,
    "scan": sides.check_scan,
    "ground": sides.check_ground,
    "sensor": sides.check_sensor,
    "graph": sides.check_graph,
    "communities": sides.check_communities,
    "objects": sides.check_objects,
    "matching": objects.check_matching,
    "coverage": sides.check_coverage,
    "surface": sides.check_surface,
    "pieces": sides.check_pieces,
    "selection": objects.check_selection,
    "metrics": objects.check_metrics,
    "baselines": objects.check_baselines,
    "seeds": objects.check_seeds,
    "pairs": objects.check_pairs,
}
#: The stage that makes a table, where it has another name.
_STAGE_OF = {"scan": "ground", "objects": "communities", "pairs": "metrics"}
#: The columns of `pairs` that the check of another table compares, by how they begin.
_IN_PAIRS = {
    "scan": ("n_real_raw", "n_sim_raw"),
    "ground": ("ground_", "n_real_", "n_sim_"),
    "coverage": ("covered_",),
    "sensor": ("sensor_",),
    "surface": ("shift_", "roughness_"),
    "pieces": ("n_missing_pieces", "n_invented_pieces", "missing_pieces_", "invented_pieces_"),
}
_VERSIONS = {stage.name: stage.version for stage in (*STAGES, *EXTRAS)}

PairDone = Callable[[int, int], None]


@dataclass(frozen=True)
class Verification:
    """What was compared, and what does not agree.

    n_objects, n_drawn : matched, missing and hallucinated objects of all scored pairs, and how many were drawn
    n_scored, n_pairs, n_scans : scored pairs, those of the drawn objects, and of how many of these the scans are there
    tables : one for each table, in the order in which they were compared
    mismatches : of each table the first few
    not_compared : in words, what could not be
    unknown : columns, as `table.column`, that nothing recomputes though no reason is declared: the literal twin has yet
        to learn them
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
        """How many numbers were compared."""
        return sum(table.n_numbers for table in self.tables)

    @property
    def n_wrong(self) -> int:
        """How many of them do not agree."""
        return sum(table.n_wrong for table in self.tables)

    @property
    def passed(self) -> bool:
        """Whether all agree."""
        return not self.n_wrong

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        plain: JsonObject = asdict(self)
        return plain | {
            "run": str(self.run),
            "passed": self.passed,
            "n_numbers": self.n_numbers,
            "n_wrong": self.n_wrong,
        }


def verify_run(
    folder: Path, n_objects: int | None = DEFAULT_OBJECTS, seed: int = 0, pair_done: PairDone | None = None
) -> Verification:
    """Compares the tables of a finished run with what the literal twin makes of the tables before them.

    Parameters
    ----------
    folder : as `fidpipe run` wrote it
    n_objects : how many objects are drawn, at most all; None for all, with every node and both whole sides of each pair
    seed : another one draws others
    pair_done : called after each pair with the number done and of all

    Raises
    ------
    RunError
        The folder is no run, the run has not ended, or its table of pairs cannot be read.
    """
    run = FinishedRun(folder)
    settings = parse({group: own for group, own in run.record.settings.items() if group in Settings.model_fields})
    comparisons, rng = Comparisons(), np.random.default_rng(seed)
    _compare_files(run, comparisons)
    _compare_pair_names(run, comparisons)
    counts = [(row["pair_id"], _n_rows(run, row["pair_id"])) for row in run.scored]
    total = sum(n for _, n in counts)
    n_drawn = total if n_objects is None else min(n_objects, total)
    drawn = _draw(counts, np.sort(rng.choice(total, n_drawn, replace=False)) if total else np.empty(0, dtype=np.intp))
    scans = _Scans(run)
    n_whole = len(drawn) if n_objects is None else max(1, n_drawn // _OBJECTS_PER_WHOLE_PAIR)
    n_scans = 0
    for i, (pair_id, rows) in enumerate(drawn.items()):
        scan_pair = scans.of(pair_id)
        n_scans += scan_pair is not None
        chosen = Drawn(rows, all_nodes=n_objects is None, whole_sides=i < n_whole, rng=rng)
        _compare_pair(run, pair_id, settings, chosen, scan_pair, scans.label_names, comparisons)
        if pair_done:
            pair_done(i + 1, len(drawn))
    _compare_summary(run, settings, comparisons)
    not_compared = [*comparisons.not_compared, *scans.faults]
    of_pairs = [table for stage in wanted_stages(settings) for table in stage.gives]
    tables = [*of_pairs, "pairs", "timings"] if drawn else []
    if n_objects is not None and n_whole < len(drawn):
        not_compared.append(
            f"coverage medians, displacement, roughness and pieces of whole sides: only of {n_whole} of {len(drawn)} "
            "pairs (all distances between two scans); --all compares all"
        )
    return Verification(
        run=folder,
        seed=seed,
        n_objects=total,
        n_drawn=n_drawn,
        n_scored=len(counts),
        n_pairs=len(drawn),
        n_scans=n_scans,
        tables=comparisons.tables,
        mismatches=comparisons.mismatches,
        not_compared=(
            *not_compared,
            "findings, overview, and the spread over other seeds",
            *(f"{name}: {why}" for name, why in NOT_COMPARED.items() if name.partition(".")[0] in tables),
        ),
        unknown=tuple(
            f"{table}.{column}" for table in tables for column in comparisons.unknown(table, TABLES[table].schema.names)
        ),
    )


class _Scans:
    """The scans that a run was made of, where they are still there and the same.

    faults : in words, why they are not
    """

    def __init__(self, run: FinishedRun) -> None:
        self.faults: list[str] = []
        self._inputs = run.record.inputs
        self._dataset: Dataset | None = None
        try:
            self._dataset = read_dataset(Path(run.record.dataset))
        except (FidpipeError, OSError) as error:
            self.faults.append(f"which points of a scan were kept, and where they lie: {error}")
        self._pairs = {pair.pair_id: pair for pair in self._dataset.pairs} if self._dataset else {}

    @property
    def label_names(self) -> dict[int, str]:
        """The class names of the dataset."""
        return self._dataset.label_names if self._dataset else {}

    def of(self, pair_id: str) -> ScanPair | None:
        """A pair of the dataset whose scans are those of the run; None where there is none."""
        if self._dataset is None:
            return None
        pair = self._pairs.get(pair_id)
        try:
            if pair is not None and input_hashes(pair, self.label_names) == self._inputs.get(pair_id):
                return pair
            why = "is no longer in the dataset" if pair is None else "the dataset has other scans now"
        except (FidpipeError, OSError) as error:
            why = str(error)
        self.faults.append(f"which points of the scans of pair {pair_id} were kept: {why}")
        return None


def _compare_files(run: FinishedRun, comparisons: Comparisons) -> None:
    """Notes each file whose content is not that which was written."""
    for pair_id in ("", *run.store.ledger.pair_ids()):
        for record in run.store.ledger.jobs(pair_id).values():
            for name, stored in record.files.items():
                try:
                    found = stored.sha256 if stored.read(run.folder / name) is not None else "another file, or none"
                except OSError as error:
                    found = f"cannot be read ({error.strerror})"
                comparisons.compare(Place("files", pair_id), f"SHA-256 of {name}", stored.sha256, found)


def _compare_pair_names(run: FinishedRun, comparisons: Comparisons) -> None:
    """Notes rows of `pairs` out of order, scored pairs without results or the reverse, and failed ones with scores."""
    place, names = Place("pairs", ""), [row["pair_id"] for row in run.rows]
    comparisons.compare(place, "pair_id", names, sorted(set(names)))
    with_scores = sorted(name for name in run.store.ledger.pair_ids() if ("metrics", "") in run.store.ledger.jobs(name))
    comparisons.compare(place, "pair_id of scored pairs", [row["pair_id"] for row in run.scored], with_scores)
    for row in run.rows:
        if row["status"] != "scored":
            own = Place("pairs", row["pair_id"])
            told = {name for name, value in row.items() if value is not None}
            comparisons.compare(own, "status", row["status"], "failed")
            comparisons.compare(own, "columns of a failed pair", sorted(told), ["pair_id", "reason", "status"])


def _compare_pair(
    run: FinishedRun,
    pair_id: str,
    settings: Settings,
    drawn: Drawn,
    scans: ScanPair | None,
    label_names: dict[int, str],
    comparisons: Comparisons,
) -> None:
    """Compares the tables of one pair; one that nothing can be computed from is a fault of its own."""
    pair = StoredPair(run, pair_id, settings, drawn, scans, label_names)
    for table, check in _CHECKS.items():
        stage = _STAGE_OF.get(table, table)
        columns = _columns_of(table, pair)
        now = _VERSIONS.get(stage)  # the check of all tables has none
        version = run.record.stages.get(stage, now)
        if version != now:
            comparisons.leave_out(f"{table} of version {version} of its stage, which is {now} now", columns)
            continue
        try:
            check(pair, comparisons)
        except RunError as error:
            if any(one.table == "files" for one in comparisons.mismatches):  # which is named already
                comparisons.leave_out(f"{table} of a pair with a damaged file", columns)
            else:
                comparisons.refuse(Place(table, pair_id), str(error), columns)
        except (FidpipeError, LookupError, ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            comparisons.refuse(Place(table, pair_id), str(error), columns)


def _columns_of(table: str, pair: StoredPair) -> list[str]:
    """The columns, or the whole table, that nothing compares where the check of a table could not be done."""
    if table == "rows":
        return [f"{own}.{name}" for own, _ in pair.tables for name in ("pair_id", "side")]
    prefixes = _IN_PAIRS.get(table, ())
    return [table, *(f"pairs.{name}" for name in TABLES["pairs"].schema.names if name.startswith(prefixes))]


def _n_rows(run: FinishedRun, pair_id: str) -> int:
    """How many objects a pair has, matched or not; 0 where its table cannot be read."""
    try:
        n_rows: int = run.read_table("matching", pair_id, columns=["status"]).num_rows
    except RunError:
        return 0
    return n_rows


def _draw(counts: list[tuple[str, int]], numbers: np.ndarray[tuple[int], np.dtype[np.intp]]) -> dict[str, list[int]]:
    """By pair, the rows of `matching` that bear these numbers, ascending, when all pairs are counted through."""
    drawn: dict[str, list[int]] = {}
    left: Iterator[tuple[str, int]] = iter(counts)
    pair_id, start, n = "", 0, 0
    for number in numbers.tolist():
        while number >= start + n:
            start += n
            pair_id, n = next(left)
        drawn.setdefault(pair_id, []).append(number - start)
    return drawn


def _compare_summary(run: FinishedRun, settings: Settings, comparisons: Comparisons) -> None:
    """Compares means and counts of `run.json` with the rows of `pairs` and of the tables of all pairs."""
    place, scored = Place("run.json", ""), run.scored
    for what, check in (("unmatched objects", objects.check_unmatched), ("baselines", objects.check_baseline_means)):
        try:
            check(run, settings, place, comparisons)
        except (RunError, LookupError, TypeError) as error:  # of another version, or damaged, which is named already
            comparisons.leave_out(f"what run.json says of {what}: {error}")
    counts = run.record.pairs
    comparisons.compare(place, "pairs.scored", counts.scored, len(scored))
    comparisons.compare(place, "pairs.failed", counts.failed, len(run.rows) - len(scored))
    values = {name: [row[name] for row in scored] for name in RUN_SCORES}
    for name in DISTRIBUTED:
        values[unmatched_worst(name)] = []
        for row in scored:
            n = row["n_matched"] - (row["n_too_small"] if METRIC[name].is_nullable else 0)
            n_alone, worst = row["n_missing"] + row["n_hallucinated"], METRIC[name].high or 0.0
            sums = (row[METRIC[name].mean_column] or 0.0) * n + worst * n_alone
            values[unmatched_worst(name)].append(sums / (n + n_alone) if n + n_alone else None)
    for name, own in values.items():
        stored = run.record.summary.get(name)
        if stored is None:
            continue  # an older fidpipe did not have this score
        mean, std = mean_and_std(own)
        n_pairs = sum(value is not None for value in own)
        for column, kept, made in (("mean", stored.mean, mean), ("std", stored.std, std)):
            comparisons.compare(place, f"summary.{name}.{column}", kept, made, tolerance=LENGTH_M)
        comparisons.compare(place, f"summary.{name}.n_pairs", stored.n_pairs, n_pairs)
