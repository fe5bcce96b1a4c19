"""Up to eight runs of the same real scans in a row: how has the simulator developed?

Only pairs that all runs have scored are used, so that the means of all runs are over the same scans.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

from ...schemas.errors import RunError
from ...schemas.results import JsonObject
from ...stages.statistics.comparison import Difference
from .compare import Comparison, compare_two, pairs_left_out
from .families import FamilyChange, families
from .finished import FinishedRun


@dataclass(frozen=True)
class RunOfHistory:
    """One of the runs: its folder, when it was made, and how many pairs it has scored and how many failed."""

    folder: Path
    written: str
    n_scored: int
    n_failed: int


@dataclass(frozen=True)
class Step:
    """A family in one run.

    mean : of its score, over the independent pairs that all runs have scored; None if null
    low, high : 95 % interval of the change since the first run, added to the first run's mean; None without one
    since_first, since_last : verdict of the family against the first run, and against the one before, in brackets if it
        does not count; "" for the first
    """

    mean: float | None
    low: float | None = None
    high: float | None = None
    since_first: str = ""
    since_last: str = ""


@dataclass(frozen=True)
class FamilyHistory:
    """A family over the runs, with its representative score.

    name, mark : of the score; direction of good
    """

    family: str
    name: str
    mark: str
    steps: tuple[Step, ...]


@dataclass(frozen=True)
class History:
    """Runs in their order, and their families of scores.

    pairs : that all runs have scored
    left_out : by pair that some run has scored, why it is not among them
    failed : pairs that the first run has scored and that fail in the last
    n_blocks : independent pairs
    n_comparisons : how many there are, each of which is wrong by chance in under 5 % of the cases
    """

    runs: tuple[RunOfHistory, ...]
    pairs: tuple[str, ...]
    left_out: dict[str, str]
    failed: tuple[str, ...]
    n_blocks: int
    n_comparisons: int
    families: tuple[FamilyHistory, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> JsonObject:
        """Plain values, for programs."""
        runs: JsonObject = {"runs": [asdict(run) | {"folder": str(run.folder)} for run in self.runs]}
        return asdict(self) | runs


def read_history(
    folders: Sequence[Path],
    *,
    by_date: bool = False,
    allow_different_settings: bool = False,
    independent: bool = False,
) -> History:
    """The families of scores of runs in a row, each compared with the first and with the one before.

    Parameters
    ----------
    folders : two or more, in order
    by_date : order them by when they were made instead
    independent : see `compare_runs`

    Raises
    ------
    RunError
        A folder is not a finished run, settings differ and that is not allowed, or no pair is scored by all.
    """
    runs = [FinishedRun(folder) for folder in folders]
    dates = [run.record.written for run in runs]
    if by_date:
        runs.sort(key=lambda run: run.record.written)
    first, *others = runs
    left_out = {name: why for other in others for name, why in pairs_left_out(first, other).items()}
    pairs = tuple(row["pair_id"] for row in first.scored if row["pair_id"] not in left_out)
    if not pairs:
        why = "; ".join(f"{name!r}: {reason}" for name, reason in list(left_out.items())[:3])
        raise RunError(
            f"{len(runs)} runs from {first.folder} on: no pair is scored by all ({why or 'no pair is scored'})"
        )

    def compared(a: FinishedRun, b: FinishedRun) -> Comparison:
        return compare_two(a, b, allow_different_settings, only=pairs, independent=independent)

    since_first = [compared(first, other) for other in others]
    since_last = [since_first[0], *(compared(a, b) for a, b in pairwise(others))]
    notes = [since_first[0].blocking]
    notes += dict.fromkeys(f"differs: {note}" for one in since_first for note in (*one.settings, *one.notes))
    if not by_date and dates != sorted(dates):
        notes.append("the runs are not in the order in which they were made; --by-date orders them so")
    return History(
        runs=tuple(
            RunOfHistory(run.folder, run.record.written, run.record.pairs.scored, run.record.pairs.failed)
            for run in runs
        ),
        pairs=pairs,
        left_out=left_out,
        failed=since_first[-1].failed,
        n_blocks=since_first[0].n_blocks,
        n_comparisons=2 * len(others) - 1,
        families=tuple(_over_runs(family.name, since_first, since_last) for family in since_first[0].families),
        notes=tuple(notes),
    )


def _over_runs(family: str, since_first: Sequence[Comparison], since_last: Sequence[Comparison]) -> FamilyHistory:
    """The history of a family, and of the first of its scores in the catalogue that is decided, else has values."""
    first, last = ([_family(one, family) for one in compared] for compared in (since_first, since_last))
    known = {score.name: score for score in first[0].scores}
    decided = {own.name for one in first for own in one.scores if own.verdict in ("better", "worse")}
    headings = [score.heading for preset in ("reference", "paper") for score in families(preset)[family]]
    headings.sort(key=lambda heading: heading not in decided)
    chosen = next(known[heading] for heading in headings if heading in known)
    steps = [Step(chosen.difference.before)]
    for against_first, against_last in zip(first, last, strict=True):
        own = next((score.difference for score in against_first.scores if score.name == chosen.name), Difference())
        low, high = (
            None if change is None or own.before is None else own.before + change for change in (own.low, own.high)
        )
        steps.append(Step(own.after, low, high, against_first.called, against_last.called))
    return FamilyHistory(family, chosen.name, chosen.mark, tuple(steps))


def _family(comparison: Comparison, name: str) -> FamilyChange:
    """A family of a comparison; one without scores if it has none."""
    absent = FamilyChange(name, "undecided", None, "", "", ())
    return next((family for family in comparison.families if family.name == name), absent)
