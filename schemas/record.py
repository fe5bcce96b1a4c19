"""Fields of `run.json`: how a run was made, the outcomes of its pairs, and its results (`results`)."""

from __future__ import annotations

from pydantic import ConfigDict, Field

from .results import Findings, JsonObject, Overview, Result, ScoreSummary

#: Levels of a baseline.
OF_OBJECTS, OF_SCAN = "objects", "scans"


class BaselineSummary(Result):
    """A baseline over the pairs.

    level : "objects" (mean over the matched objects of a pair) or "scans" (its two scans)
    n, n_null : objects or pairs of scans with and without a value
    """

    baseline: str
    level: str
    unit: str | None
    mean: float | None
    std: float | None
    n: int
    n_null: int


class Spread(Result):
    """The spread of one score over seeds and pairs; null for too few values.

    mean : over pairs, of each pair's mean over seeds
    std_pairs : standard deviation (n - 1) over pairs of each pair's mean over seeds
    std_seeds : standard deviation over seeds within a pair: root mean square of those (n - 1) of all pairs
    least_pair, least_dataset : repeatability limit (ISO 5725): two evaluations of a pair (of all pairs) under seeds of
        their own that differ only by chance are nearer than this in 95 % of the cases
    """

    mean: float | None
    std_pairs: float | None
    std_seeds: float | None
    least_pair: float | None
    least_dataset: float | None


class SeedSummary(Result):
    """The repeats under other seeds: of each score the spread over all pairs."""

    n_seeds: int
    n_pairs: int
    dataset: dict[str, Spread]


class TaskSummary(Result):
    """A measure of a task over the pairs; null if no pair has a value.

    real, sim, gap : means of the values of both sides, and of their gap
    gap_std : standard deviation (n - 1) of the gap
    n_pairs : pairs that have the gap
    """

    task: str
    measure: str
    unit: str
    real: float | None
    sim: float | None
    gap: float | None
    gap_std: float | None
    n_pairs: int


class Machine(Result):
    """Machine of a run."""

    python: str
    system: str
    processor: str
    cores: int | None


class PairCounts(Result):
    """Pairs of the dataset by state."""

    scored: int
    failed: int
    to_do: int


ELSEWHERE = "of another place"  #: reading of a pair whose scans do not show the same place


class FrameSuspect(Result):
    """A pair whose simulated scan fits the real one much better in another reading than as it is evaluated, or in none.

    reading : the candidate transform as text, such as "mirrored in y"; `ELSEWHERE` if the scans show two places
    coverage, as_it_lies : 0 to 1, how well the scans cover each other in that reading, and as they are evaluated
    setting : what makes that reading the one that is evaluated
    """

    reading: str
    coverage: float
    as_it_lies: float
    setting: str


class RunHeader(Result):
    """Fields of `run.json` from the start of a run: inputs, settings and versions.

    preset : whose objects they are, and in `departures` the settings that differ from its own
    settings : effective settings by group and name
    stages : version of each stage's code
    libraries : version of each library, null if it is not installed
    """

    fidpipe: str
    written: str
    dataset: str
    preset: str
    departures: tuple[str, ...]
    settings: dict[str, JsonObject]
    seed: int
    stages: dict[str, int]
    libraries: dict[str, str | None]
    machine: Machine


class RunRecord(RunHeader):
    """Fields of `run.json` at the end of a run.

    workers : of the last command; 0 where there was nothing to do
    wall_s : seconds of the last command by phase
    summary : by column of `pairs`; `cdc_unmatched_worst_mean` and the like: with unmatched objects counted as worst
    findings, overview : None if no pair is scored
    inputs : by pair, content hash by side, and `content` of all that the pair's numbers come from
    times_s : by pair, the time of its real scan where the dataset has one
    frames : by pair, those whose simulated scan seems to lie in another frame, or shows another place
    notes : by pair, notes on its ground cut
    baselines, seeds, tasks : only if requested
    """

    model_config = ConfigDict(extra="allow")  # what a later version adds is shown as it is

    workers: int
    wall_s: dict[str, float]
    pairs: PairCounts
    summary: dict[str, ScoreSummary]
    findings: Findings | None
    inputs: dict[str, dict[str, str]]
    overview: Overview | None = None
    times_s: dict[str, float] = Field(default_factory=dict)
    frames: dict[str, FrameSuspect]
    notes: dict[str, tuple[str, ...]]
    baselines: tuple[BaselineSummary, ...] = ()
    seeds: SeedSummary | None = None
    tasks: tuple[TaskSummary, ...] = ()

    @property
    def task_gaps(self) -> dict[str, float | None]:
        """Mean gap of each measure of a task, by names such as `objects.lost`."""
        return {f"{row.task}.{row.measure}": row.gap for row in self.tasks}
