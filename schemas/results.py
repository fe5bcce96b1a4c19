"""What a run says at its end, as typed values: the record in `run.json` with its summaries and findings.

Contracts like the tables: the field names are the keys of the JSON, in that order. `as_dict` gives plain values for
JSON, `from_dict` reads them again.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Self

from pydantic import BaseModel, BeforeValidator, ConfigDict, JsonValue, PlainSerializer, ValidationError

#: What JSON calls an object.
JsonObject = dict[str, JsonValue]
Number = float | int | None


class Result(BaseModel):
    """A frozen value with the layout of its JSON."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON; fields that were never given are left out."""
        return self.model_dump(mode="json", exclude_unset=True)

    @classmethod
    def from_dict(cls, values: Mapping[str, object]) -> Self:
        """The value again.

        Raises
        ------
        ValueError
            A key is missing or unknown, or a value is of another type: another version of fidpipe wrote it.
        """
        return cls.model_validate(values)


class ScoreSummary(Result):
    """A score over the pairs of a dataset; null where too few pairs have it.

    mean, std : over pairs, std with n - 1
    n_pairs : pairs that have the score
    """

    mean: float | None
    std: float | None
    n_pairs: int


class Quantiles(Result):
    """How many values there are, and their quantiles; null where there is none."""

    n: int
    min: float | None
    q05: float | None
    q25: float | None
    median: float | None
    q75: float | None
    q95: float | None
    max: float | None


class Distribution(Quantiles):
    """Some values: how many, their quantiles, mean, standard deviation (n - 1); null where there are too few.

    cv : coefficient of variation, std / mean
    peak_density : share of the values in the fullest bin of width 0.05, over that width
    """

    mean: float | None
    std: float | None
    cv: float | None
    peak_density: float | None


class ScoreDistributions(Result):
    """The distributions over all matched objects."""

    cdc: Distribution
    r_lambda: Distribution
    r_gap: Distribution


class RankCorrelation(Result):
    """Spearman's rho and Kendall's tau-b of two scores over n objects; null for fewer than 3 or constant scores."""

    n: int
    spearman: float | None
    kendall: float | None


class DensityRatio(Quantiles):
    """Quantiles of n_sim / n_real over the matched objects, and the shares below a quarter and above four."""

    share_below_quarter: float | None
    share_above_four: float | None


class Unmatched(Result):
    """Objects of each side in a group, and how many of them the other side lacks; a share of none is null."""

    n_real: int
    n_missing: int
    missing_share: float | None
    n_sim: int
    n_hallucinated: int
    hallucinated_share: float | None

    def count(self, side: str) -> int:
        """Objects of a side, "real" or "sim"."""
        return self.n_real if side == "real" else self.n_sim

    def alone(self, side: str) -> int:
        """Objects of a side that the other side lacks."""
        return self.n_missing if side == "real" else self.n_hallucinated


class _Band(Result):
    from_m: float
    to_m: float | None


class RangeBand(Unmatched, _Band):  # in this order the distances come first in JSON
    """Objects between two distances from the sensor; `to_m` is null where the band has no end."""


class RangeFindings(Result):
    """Objects by distance from the sensor.

    median_matched, median_unmatched : metres; unmatched of both sides, each of its own
    bands : of fixed edges
    halves : below and above the median range of all objects
    """

    median_matched: float | None
    median_unmatched: float | None
    bands: tuple[RangeBand, ...]
    halves: tuple[RangeBand, ...]


class GroupMean(Result):
    """Mean and standard deviation (n - 1) of a score over the n objects of a group that have it."""

    mean: float | None
    std: float | None
    n: int


class _Label(Result):
    label: str


class ClassFindings(Unmatched, _Label):  # in this order the label comes first in JSON
    """The objects of one class; a matched object has the class of its real side.

    cdc_excess : cdc less r_lambda
    r_lambda_near, r_lambda_far : of the matched objects nearer than the median range of the class, and of the others
    spearman : rank correlation of CDC and r_lambda within the class
    """

    n_matched: int
    cdc_mean: float | None
    cdc_std: float | None
    cdc_n: int
    r_lambda_mean: float | None
    r_lambda_std: float | None
    r_lambda_n: int
    r_gap_mean: float | None
    r_gap_std: float | None
    r_gap_n: int
    cdc_excess_mean: float | None
    cdc_excess_std: float | None
    cdc_excess_n: int
    r_lambda_near_mean: float | None
    r_lambda_near_std: float | None
    r_lambda_near_n: int
    r_lambda_far_mean: float | None
    r_lambda_far_std: float | None
    r_lambda_far_n: int
    spearman: float | None

    def of_score(self, score: str) -> GroupMean:
        """Mean, standard deviation and number of one score, such as `cdc` or `r_lambda_near`."""
        return GroupMean(
            mean=getattr(self, f"{score}_mean"), std=getattr(self, f"{score}_std"), n=getattr(self, f"{score}_n")
        )


class WithinPairs(Result):
    """In how many of `n_pairs` pairs r_lambda varies more than CDC over the objects of the pair."""

    n_pairs: int
    n_r_lambda_wider: int


class ScanFindings(Result):
    """One of the four scans of the paper's box plots."""

    pair: str
    timestamp_s: float | None
    cdc: Distribution
    r_lambda: Distribution


class Scans(Result):
    """The scans; `apart` says whether they are known to be more than a minute apart."""

    apart: bool
    scans: tuple[ScanFindings, ...]


class ObjectFindings(Result):
    """What the objects of all pairs say together: the numbers of the paper's section "Real experiments"."""

    n_pairs: int
    n_matched: int
    distributions: ScoreDistributions
    rank_correlation: RankCorrelation
    density_ratio: DensityRatio
    range_m: RangeFindings
    classes: tuple[ClassFindings, ...]
    within_pairs: WithinPairs
    scans: Scans


class Claim(Result):
    """One claim: what the paper says, what the value is here, by which rule, and whether it holds.

    estimate, low, high : what the rule looks at, such as a difference, with its 95 % interval; null where there is none
    n_pairs : independent pairs that it comes from
    verdict : holds, does not hold, or not decided
    why : why there is no interval or no verdict; "" where nothing is to be said
    """

    claim: str
    paper: str
    here: str
    estimate: float | None
    low: float | None
    high: float | None
    n_pairs: int
    rule: str
    verdict: str
    why: str


class _Key(Result):
    key: str


class Findings(ObjectFindings, _Key):  # in this order the key comes first in JSON
    """The findings as they are recorded.

    key : hash of all that they were made from; another key asks for new ones
    claims : the paper's, each with its verdict
    """

    claims: tuple[Claim, ...]

    @classmethod
    def recorded(cls, values: object) -> Findings | None:
        """Findings from an earlier record; None where it has none, or another version of fidpipe wrote them."""
        try:
            return cls.model_validate(values) if values else None
        except ValidationError:
            return None


class Verdict(Result):
    """What has become of the real objects of all scored pairs, and how many simulated ones have no counterpart.

    faithful, structure_lost, displaced, failed : matched objects by quadrant, see `pipeline.results.quadrants`
    unjudged : matched objects that are too small for a score of structure
    missing, hallucinated : objects that only one side has
    """

    n_pairs: int
    n_real: int
    faithful: int
    structure_lost: int
    displaced: int
    failed: int
    unjudged: int
    missing: int
    hallucinated: int


class HeadlineNumber(ScoreSummary):
    """One of the numbers that a run is judged by first.

    column : of `pairs`, by which the catalogue of metrics knows it
    label : how it is called
    better : "higher" or "lower"
    last : its mean in the run that this one replaced; null where there was none
    """

    column: str
    label: str
    better: str
    last: float | None


class WorstObject(Result):
    """One of the worst objects, and what is wrong with it.

    side : "real", or "sim" of a hallucinated object; `object_id` is its number there
    label : its class, or its shape where nothing is labelled
    n_points : of its own side
    status : "matched", "missing" or "hallucinated"
    covered : share of its points that the other side has within 0.3 m
    cdc, r_lambda : null where it is not matched, or too small
    what : the same in words
    """

    pair_id: str
    side: str
    object_id: int
    label: str
    range_m: float
    n_points: int
    status: str
    covered: float
    cdc: float | None
    r_lambda: float | None
    what: str


class Failing(_Band):
    """How often objects of one class at one distance fail in one way.

    kind : "missing", "hallucinated", or a quadrant that is not faithful
    n, n_objects : so many of so many: of the simulated objects where hallucinated, else of the real ones
    n_there : so many more are missing or hallucinated only because they are divided differently: their surface is there
    words : the same in words
    """

    label: str
    kind: str
    n: int
    n_objects: int
    n_there: int
    words: str


class Caution(Result):
    """What limits the trust in the numbers.

    kind : failed, to_do, frames, pairs, independence, partition, alignment, or floor (that none is known)
    words : in one sentence
    """

    kind: str
    words: str


class ObjectOverview(Result):
    """What the objects of all scored pairs say at a glance; see `pipeline.results.overview` for the rules.

    class_is : "class" where objects are labelled, else "shape"
    n_aligned, n_badly_aligned : objects with an r_lambda, and those whose alignment is too bad for it
    worst : the three worst objects
    failings : the three commonest failings
    """

    class_is: str
    verdict: Verdict
    n_aligned: int
    n_badly_aligned: int
    worst: tuple[WorstObject, ...]
    failings: tuple[Failing, ...]


class Overview(ObjectOverview, _Key):  # in this order the key comes first in JSON
    """The answer to what a person asks first of a run.

    key : hash of all that the objects' part was made from; another key asks for a new one
    numbers : match rate, CDC, r_lambda, r_gap, and the share of real points that is covered within 0.3 m
    trust : what limits the trust in them
    """

    numbers: tuple[HeadlineNumber, ...]
    trust: tuple[Caution, ...]

    @classmethod
    def recorded(cls, values: object) -> Overview | None:
        """The overview of an earlier record; None where it has none, or another version of fidpipe wrote it."""
        try:
            return cls.model_validate(values) if values else None
        except ValidationError:
            return None


class PreviousRun(Result):
    """The results that a run has replaced in its folder.

    written, fidpipe : when they were written, and by which version
    n_pairs : scored pairs
    changes : in words, what is other now: settings, libraries, code, scans, pairs
    means : by column of `pairs`
    """

    written: str
    fidpipe: str
    n_pairs: int
    changes: tuple[str, ...]
    means: dict[str, float | None]

    @classmethod
    def recorded(cls, values: object) -> PreviousRun | None:
        """Those of an earlier record; None where it has none, or another version of fidpipe wrote it."""
        try:
            return cls.model_validate(values) if values else None
        except ValidationError:
            return None


class BaselineSummary(Result):
    """A baseline over the pairs.

    level : "objects" (mean over the matched objects of a pair) or "scans" (all object points of its two scans)
    n, n_null : objects or scans with and without a value
    seconds : per pair, beside the first number of a method; else null
    """

    baseline: str
    level: str
    unit: str | None
    mean: float | None
    std: float | None
    n: int
    n_null: int
    seconds: float | None


class Spread(Result):
    """The spread of one score over seeds and pairs; null where there are too few values.

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


class MeanStd(Result):
    """Mean and standard deviation (n - 1); null where there are too few values."""

    mean: float | None
    std: float | None


class SeedSummary(Result):
    """The repeats under other seeds: of each score the spread over all pairs; of each pair mean and deviation."""

    n_seeds: int
    n_pairs: int
    dataset: dict[str, Spread]
    pairs: dict[str, dict[str, MeanStd]]


class Machine(Result):
    """Where a run was made."""

    python: str
    system: str
    processor: str
    cores: int | None


class PairCounts(Result):
    """Pairs of the dataset by state."""

    scored: int
    failed: int
    to_do: int


class Seconds(Result):
    """Seconds by stage and step (mean over the pairs that have the stage), and by pair and stage."""

    mean: dict[str, dict[str, float]]
    pairs: dict[str, dict[str, float]]


class FrameSuspect(Result):
    """A pair whose simulated scan fits the real one much better in another reading than as it is evaluated.

    reading : in words, such as "mirrored in y"
    coverage, as_it_lies : 0 to 1, how well the scans cover each other in that reading, and as they are evaluated
    setting : what makes that reading the one that is evaluated
    """

    reading: str
    coverage: float
    as_it_lies: float
    setting: str


class RunHeader(Result):
    """What `run.json` holds from the start of a run: what it is made from and with.

    preset : whose objects they are, and in `departures` the settings that differ from its own
    settings : by group and name, as they are in force
    stages : version of each stage's code
    libraries : version of each library, null where it is not installed
    previous : the finished results of this folder that these replace; None where there were none, or none others
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
    previous: PreviousRun | None = None


class SurfaceStates(Result):
    """Unmatched objects of all pairs, by whether their surface is on the other side: see `stages.coverage`.

    there : it is, and only divided differently
    road : of all three, those that lie mostly below the other side's ground cut: road that only one side's cut left;
        None where an older fidpipe wrote the record
    """

    there: int
    partly: int
    absent: int
    road: int | None = None


#: The names of the states.
SURFACE_STATES = tuple(name for name in SurfaceStates.model_fields if name != "road")


class UnmatchedSurface(Result):
    """What is behind the objects that only one side has."""

    missing: SurfaceStates
    hallucinated: SurfaceStates


class MetricsSummary(Result):
    """What the stage metrics says of all pairs."""

    unmatched: UnmatchedSurface


class RunRecord(RunHeader):
    """What `run.json` holds at the end of a run.

    workers : of the last command; 0 where there was nothing to do
    wall_s : seconds of the last command by phase
    summary : by column of `pairs`; `cdc_unmatched_worst_mean` and the like: with unmatched objects counted as worst
    findings : None ({} in JSON) where no pair is scored
    overview : None where no pair is scored, or an older fidpipe wrote the record
    inputs : by pair, content hash by side, and `content` of all that the pair's numbers come from
    frames : by pair, those whose simulated scan seems to lie in another frame; None where none were compared
    metrics : what is behind the unmatched objects; None where an older fidpipe wrote the record
    baselines, seeds : only where they were asked for
    """

    model_config = ConfigDict(extra="allow")  # what a later version adds is shown as it is

    workers: int
    wall_s: dict[str, float]
    pairs: PairCounts
    summary: dict[str, ScoreSummary]
    findings: Annotated[
        Findings | None,
        BeforeValidator(lambda value: value or None),
        PlainSerializer(lambda found: {} if found is None else found.as_dict()),
    ]
    seconds: Seconds
    inputs: dict[str, dict[str, str]]
    overview: Overview | None = None
    frames: dict[str, FrameSuspect] | None = None
    metrics: MetricsSummary | None = None
    baselines: tuple[BaselineSummary, ...] = ()
    seeds: SeedSummary | None = None

    @property
    def claims(self) -> Sequence[Claim]:
        """The paper's claims; none where no pair is scored."""
        return self.findings.claims if self.findings else ()
