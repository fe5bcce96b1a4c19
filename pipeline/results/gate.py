"""Acceptance criteria on a finished run: each has a measure, a bound and a verdict. And a run against a base, for CI.

Four criteria are always checked unless the user sets another max for them: no pair failed, no pair is still to do, no
simulated scan seems to lie in another frame, and no pair has scans, labels or T_real_sim other than those that were
evaluated. A criterion on something that could not be computed fails. `measures` has everything that can be measured.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...schemas.data_files import read_toml
from ...schemas.errors import SettingsError
from ...schemas.results import JsonObject
from ...schemas.settings import expected_and_got
from .best_case import excess_over
from .finished import FinishedRun, partition_note
from .independence import NEEDED, pairs_and_places
from .measures import Measures

if TYPE_CHECKING:
    from .compare import Comparison
    from .families import FamilyChange

Bound = Literal["max", "min"]


@dataclass(frozen=True)
class Criterion:
    """Acceptance criterion: `measure` at most (max) or at least (min) `limit`, both inclusive.

    name : what people call it
    reason : why it is required; may be empty
    """

    name: str
    measure: str
    bound: Bound
    limit: float
    reason: str = ""


_WHOLE = "a gate is about the whole dataset"
#: Of runs whose dataset is on this machine.
UNCHANGED = Criterion(
    "scans and labels are those that were evaluated",
    "pairs.changed",
    "max",
    0,
    "else run it again",
)
#: Criteria of every gate, unless the user gives another bound.
ALWAYS = (
    Criterion("every pair is scored", "pairs.failed", "max", 0, _WHOLE),
    Criterion("no pair is left to do", "pairs.to_do", "max", 0, _WHOLE),
    Criterion(
        "both sides lie in one frame",
        "pairs.frame_suspect",
        "max",
        0,
        "fidpipe check shows how to fix it",
    ),
    UNCHANGED,
)


@dataclass(frozen=True)
class Judged(Criterion):
    """A criterion with the value in the run; `why` is the reason if it is None."""

    value: float | None = None
    passed: bool = False
    why: str = ""

    @property
    def fault(self) -> str:
        """The kind of violation; "" if it is met."""
        if self.passed:
            return ""
        return "not computed" if self.value is None else "bound"

    @property
    def bound_words(self) -> str:
        """The bound, such as `<= 0.4`."""
        return f"{'<=' if self.bound == 'max' else '>='} {self.limit:g}"

    @property
    def found(self) -> str:
        """The name, the value found and the bound, or why it is not known, and the reason of the criterion."""
        words = self.why
        if self.value is not None:
            words = f"{self.measure} is {self.value:.6g}, expected {self.bound_words}"
        reason = f" ({self.reason})" if self.reason else ""
        return f"{self.name}: {words}{reason}"


@dataclass(frozen=True)
class GateResult:
    """Results of all criteria of a run; `notes` lists unchecked criteria and other remarks."""

    run: Path
    dataset: str
    judged: tuple[Judged, ...]
    notes: tuple[str, ...]

    @property
    def passed(self) -> bool:
        """True if every criterion is met."""
        return all(verdict.passed for verdict in self.judged)

    def as_dict(self) -> JsonObject:
        """Plain values, for `gate.json`."""
        return {
            "run": str(self.run),
            "dataset": self.dataset,
            "passed": self.passed,
            "notes": [*self.notes],
            "criteria": [dict(vars(verdict)) for verdict in self.judged],
        }


def judge_run(
    folder: Path, criteria: Iterable[Criterion], best_case: Path | None = None
) -> GateResult:
    """Check a finished run against criteria.

    Parameters
    ----------
    best_case : the run of fidpipe best-case that measures such as `excess.r_lambda.mean` are over

    Raises
    ------
    RunError
        The folder is not a finished run, a table is damaged, or the best case is another's.
    SettingsError
        A criterion names an unknown measure, or one that needs a best case without one.
    """
    run = FinishedRun(folder)
    excess = None if best_case is None else excess_over(run, best_case)
    measures = Measures(run, excess)
    criteria = list(criteria)
    always = list(ALWAYS)
    notes = [note] if (note := partition_note([run])) else []
    if excess is not None:
        n_both = f"{len(excess.pairs)} of {len(run.scored)} pairs"
        notes.append(
            f"excess is over the best case {best_case} ({excess.recipe.words}), {n_both}"
        )
    if measures.dataset_is_gone:
        always.remove(UNCHANGED)
        notes.append(
            f"the dataset {run.record.dataset} is not here: not checked whether it has changed "
            "since the run"
        )
    bounded = {criterion.measure for criterion in criteria if criterion.bound == "max"}
    added = [criterion for criterion in always if criterion.measure not in bounded]
    judged = []
    for criterion in added + criteria:
        value, why = measures.named(criterion.measure)
        passed = value is not None and (
            value <= criterion.limit if criterion.bound == "max" else value >= criterion.limit
        )
        if value is None:
            why = f"could not be computed: {why}"
        judged.append(Judged(**vars(criterion), value=value, passed=passed, why=why))
    return GateResult(folder, run.record.dataset, tuple(judged), tuple(notes))


@dataclass(frozen=True)
class Check:
    """A requirement, the value found as text, and the kind of violation; "" if it is met."""

    name: str
    found: str
    fault: str


@dataclass(frozen=True)
class BaseResult:
    """A comparison, checked for CI.

    fail_on : "worse" or "undecided"
    """

    comparison: Comparison
    fail_on: str
    checks: tuple[Check, ...]

    @property
    def failed(self) -> tuple[Check, ...]:
        """Violated requirements."""
        return tuple(check for check in self.checks if check.fault)

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON: the comparison and the requirements."""
        return self.comparison.as_dict() | {
            "fail_on": [self.fail_on],
            "checks": [dict(vars(check)) for check in self.checks],
            "passed": not self.failed,
        }


def judge_comparison(
    comparison: Comparison, fail_on: str, *, undecided_ok: bool = False
) -> BaseResult:
    """Evaluate a run against its base.

    A cause of the sensor fails if it is worse, a family if it is worse or mixed. Every pair that the base has scored
    must have been compared: one that fails now fails the gate, for a simulator that loses its hardest pairs looks
    better in the means. A comparison that is undecided for lack of places fails, too.

    Parameters
    ----------
    fail_on : "worse" or "undecided"; with "undecided" the gate also fails if changes are within the noise
    undecided_ok : pass a comparison that lacks places
    """
    n_base = len(comparison.pairs) + len(comparison.lost)
    reasons = [f"{name}: {comparison.left_out[name]}" for name in comparison.lost]
    compared = f"{len(comparison.pairs)} of {n_base} pairs are compared"
    fault = "not compared" if reasons else ""
    found = "; ".join([compared, *reasons])
    checks = [Check("every pair that the base has scored is compared", found, fault)]
    for change in comparison.changes.causes:
        if change.verdict:
            fault = change.verdict if change.verdict == "worse" else ""
            checks.append(Check(f"{change.name} is not worse", change.words, fault))
    for family in comparison.families:
        fault = (
            family.verdict if family.verdict in ("worse", "mixed") and not family.why else ""
        )
        checks.append(Check(f"{family.name} is not worse", _found(family), fault))
    lacks_places = comparison.lacks_places and not undecided_ok
    if lacks_places or fail_on == "undecided":
        found = comparison.decision
        if comparison.lacks_places:
            counted = pairs_and_places(len(comparison.pairs), comparison.n_places)
            found = f"undecided: {counted}, {NEEDED}; --undecided-ok accepts that"
        fault = "undecided" if comparison.decision == "undecided" else ""
        checks.append(Check("the comparison is decided", found, fault))
    return BaseResult(comparison, fail_on, tuple(checks))


def _found(family: FamilyChange) -> str:
    score = family.scores[0]
    p = "" if family.p is None else f", p {family.p:.3g}"
    why = f" ({family.why})" if family.why else ""
    change = score.difference
    return f"{family.verdict}{why}: {score.name} {change.before:.6g} to {change.after:.6g}{p}"


def parse_word(word: str, bound: Bound) -> Criterion:
    """A criterion from a word such as `r_lambda.mean=0.4`.

    Examples
    --------
    >>> parse_word("r_lambda.mean=0.4", "max").name
    'r_lambda.mean <= 0.4'
    """
    measure, _, text = word.rpartition("=")
    measure = measure.strip()
    text = text.strip()
    try:
        limit = float(text)
    except ValueError:
        limit = math.nan
    if not measure or not math.isfinite(limit):
        raise SettingsError(
            f"--{bound} {word!r}: expected MEASURE=NUMBER, such as r_lambda.mean=0.4"
        )
    return Criterion(
        f"{measure} {'<=' if bound == 'max' else '>='} {text}", measure, bound, limit
    )


def read_criteria(path: Path) -> list[Criterion]:
    """The criteria of a TOML file: tables `[[criterion]]` with name, measure, max or min or both, and reason.

    Raises
    ------
    SettingsError
        The file cannot be read, holds none, or a field is missing, unknown or of the wrong kind.
    """
    try:
        file = _File.model_validate(read_toml(path, "criteria file"))
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"])
        raise SettingsError(
            f"criteria file {path}: {where}: {expected_and_got(problem)}; write tables "
            "[[criterion]], each with "
            'name = "...", measure = "r_lambda.mean", max = 0.4 (or min), reason = "..."'
        ) from error
    criteria: list[Criterion] = []
    for i, entry in enumerate(file.criterion):
        limits: dict[Bound, float | None] = {"max": entry.max, "min": entry.min}
        if {*limits.values()} == {None}:
            raise SettingsError(
                f"criteria file {path}: criterion.{i} ({entry.name}) has no bound; expected max or "
                "min"
            )
        for bound, limit in limits.items():
            if limit is not None:
                criteria.append(
                    Criterion(entry.name, entry.measure, bound, limit, entry.reason)
                )
    return criteria


class _Entry(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    name: Annotated[str, Field(min_length=1)]
    measure: str
    reason: Annotated[str, Field(min_length=1)]
    max: float | None = None
    min: float | None = None


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid")

    criterion: Annotated[list[_Entry], Field(min_length=1)]
