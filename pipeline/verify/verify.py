"""Verification of a finished run: recompute a sample of its numbers by another implementation, and compare.

Objects are drawn at random; `recompute` computes their rows of every table again from the stored tables before it, by
the literal twin (`stages.literal`), which shares no code with the stages. Nothing is written.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import pandas as pd

from ...schemas.errors import FidpipeError, RunError
from ...schemas.results import JsonObject
from ...schemas.settings import Settings, parse
from ..datasets.content import input_hashes
from ..datasets.pairs import ScanPair, local_folder, read_dataset
from ..jobs import EXTRAS, STAGES, stages_under
from ..results.finished import FinishedRun
from .compare_frames import NOT_COMPARED, Mismatch, TableCheck, Tally
from .recompute import RECOMPUTED
from .recompute_record import RECORD
from .stored import StoredPair

DEFAULT_OBJECTS = 20
#: Number of drawn objects per pair with both sides recomputed as a whole, from all distances between them.
_OBJECTS_PER_WHOLE_PAIR = 20

PairDone = Callable[[int, int], None]


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
    tally, rng = Tally(), np.random.default_rng(seed)
    _compare_files(run, tally)
    _compare_pair_names(run, tally)
    counts = {row["pair_id"]: _n_rows(run, row["pair_id"]) for row in run.scored}
    total = sum(counts.values())
    n_drawn = total if n_objects is None else min(n_objects, total)
    numbers = np.sort(rng.choice(total, n_drawn, replace=False)) if total else np.zeros(0, dtype=np.intp)
    ends = np.cumsum([0, *counts.values()])
    parts = zip(counts, ends, np.split(numbers, np.searchsorted(numbers, ends[1:-1])), strict=False)
    drawn = {pair_id: (own - first).tolist() for pair_id, first, own in parts if len(own)}
    n_whole = len(drawn) if n_objects is None else max(1, n_drawn // _OBJECTS_PER_WHOLE_PAIR)
    scans, label_names, faults = _unchanged_scans(run, drawn)
    tables: list[str] = []
    for i, (pair_id, rows) in enumerate(drawn.items()):
        sample = (rows, n_objects is None, i < n_whole, rng)
        pair = StoredPair(run, pair_id, settings, tally, *sample, scans.get(pair_id), label_names)
        tables = [*(table for stage in stages_under(settings) for table in stage.gives), "pairs", "timings"]
        _compare_pair(pair)
        if pair_done:
            pair_done(i + 1, len(drawn))
    for what, compare in RECORD.items():
        try:
            compare(run, settings, tally)
        except (RunError, LookupError, TypeError) as error:  # damaged, which is reported already
            tally.skip(f"{what} in run.json: {error}")
    checks, mismatches = tally.results()
    return Verification(
        run=folder,
        seed=seed,
        n_objects=total,
        n_drawn=n_drawn,
        n_scored=len(counts),
        n_pairs=len(drawn),
        n_scans=len(scans),
        tables=checks,
        mismatches=mismatches,
        not_compared=(*_not_compared(tally, tables, n_whole, len(drawn)), *faults),
        unknown=tuple(tally.unknown(tables)),
    )


def _not_compared(tally: Tally, tables: Iterable[str], n_whole: int, n_pairs: int) -> Iterator[str]:
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
        dataset = read_dataset(local_folder(run.record.dataset))
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


def _compare_files(run: FinishedRun, tally: Tally) -> None:
    """Compare the hash of each file of the run."""
    for pair_id in ("", *run.store.ledger.pair_ids()):
        for record in run.store.ledger.jobs(pair_id).values():
            for name, stored in record.files.items():
                try:
                    found = stored.sha256 if run.store.content(stored, name) is not None else "another file, or none"
                except (OSError, FidpipeError) as error:
                    found = f"cannot be read ({getattr(error, 'strerror', error)})"
                tally.compare_values("files", {f"SHA-256 of {name}": stored.sha256}, {f"SHA-256 of {name}": found})


def _compare_pair_names(run: FinishedRun, tally: Tally) -> None:
    """Compare the order of `pairs`, and that exactly the scored pairs have results and scores."""
    with_scores = sorted(name for name in run.store.ledger.pair_ids() if ("metrics", "") in run.store.ledger.jobs(name))
    names, scored = [row["pair_id"] for row in run.rows], [row["pair_id"] for row in run.scored]
    tally.compare("pairs", pd.DataFrame({"pair_id": names}), pd.DataFrame({"pair_id": sorted(set(names))}))
    tally.compare("pairs", *(pd.DataFrame(index=pd.Index(own, name="pair_id")) for own in (scored, with_scores)))
    failed = {"status": "failed", "columns": str(["pair_id", "reason", "status"])}
    for row in run.rows:
        if row["status"] != "scored":
            columns = str(sorted(name for name, own in row.items() if own is not None))
            stored = {"status": row["status"], "columns": columns}
            tally.compare_values("pairs", stored, failed, **{"pair_id": row["pair_id"]})


def _compare_pair(pair: StoredPair) -> None:
    """Compare the tables of one pair; an unusable table counts as a mismatch."""
    tally = pair.tally
    for table, recompute in RECOMPUTED.items():
        try:
            recompute(pair)
        except (FidpipeError, LookupError, ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError) as error:
            if isinstance(error, RunError) and tally.check("files").n_wrong:  # reported already
                tally.is_damaged = True
                tally.skip(f"{table} of a pair with a damaged file")
            else:
                tally.reject(table, pair.pair_id, str(error))


def _n_rows(run: FinishedRun, pair_id: str) -> int:
    """Number of objects of a pair, matched or not; 0 if its table cannot be read."""
    try:
        return int(run.read_table("matching", pair_id, columns=["status"]).num_rows)
    except RunError:
        return 0
