"""Catalogue of scores: name, unit, bounds, direction, meaning and source of each.

Columns of tables, headings of views, names of measures for a gate, limits of the report's quadrants and the list of
baseline metrics come from here. The scores are the rows of `metrics.csv` next to this file, in the order of the columns
of the tables; its columns are the fields of `Metric`, `group` is what is scored, and `shown_in` where it is shown. To
add a score: a row there and the function that computes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from .data_files import read_rows

_NUMBERS = ("low", "high", "equal", "least", "step", "paper_mean", "paper_std")
_LAST = 1000


@dataclass(frozen=True)
class Metric:
    """One score.

    group : object, pair, coverage, surface, piece, ray, intensity, task, or baseline
    column : name in the tables, with the unit if it has one
    heading : short name for table headings, without the unit
    short : heading for narrow columns if `heading` is too long
    unit : "m", "m2", "dB", or None for a plain number
    low, high : bounds, or None
    better : "lower" or "higher", direction of a better value; None for a number that does not measure quality
    equal : value for two identical objects (or scans); None if it depends on the object
    flags : "count" (values are integers), "required" (each finished job has a value), "no-mean" (`pairs` does not have
        mean and standard deviation over the objects)
    shown_in : position in each place that shows the score, see `docs/extending.md`; in the file `PLACE:POSITION`,
        or `PLACE` alone for the end
    compared_as : heading in comparisons if it is not the label
    family : of compared scores; the scores of a family are judged together
    least : a change of the mean over pairs up to this size does not matter to a user
    step : smallest step of a compared value, such as 1 for a count
    paper_mean, paper_std : mean and standard deviation over the paper's 50 pairs
    method : name in the setting metrics.baselines that selects it; "" for our own scores
    meaning : one sentence: what the column holds
    reading : one sentence: how to read a value
    source : source of the definition
    """

    group: str
    column: str
    heading: str
    short: str
    unit: str | None
    low: float | None
    high: float | None
    better: str | None
    equal: float | None
    flags: list[str]
    shown_in: dict[str, int]
    compared_as: str
    family: str
    least: float | None
    step: float | None
    paper_mean: float | None
    paper_std: float | None
    method: str
    meaning: str
    reading: str
    source: str

    @property
    def label(self) -> str:
        """Heading with the unit, such as `offset (m)`."""
        return f"{self.heading} ({unit_words(self.unit)})" if self.unit else self.heading

    @property
    def narrow_label(self) -> str:
        """Heading for a narrow column: one word per line, the unit on the last line."""
        words = (self.short or self.heading).split()
        return "\n".join([*words, f"({unit_words(self.unit)})"] if self.unit else words)

    @property
    def mean_column(self) -> str:
        """Column of `pairs` with the mean over the objects of a pair."""
        return f"{self.column}_mean"

    @property
    def pair_column(self) -> str:
        """Column of `pairs`: the mean over the objects of a pair for a score of objects."""
        return self.mean_column if self.group == "object" else self.column

    @property
    def higher_is_better(self) -> bool:
        """True if a larger value is better."""
        return self.better == "higher"

    @property
    def scale(self) -> str:
        """Best and worst value as far as they exist, such as `0 best, 1 worst`."""
        best, worst = (self.high, self.low) if self.higher_is_better else (self.low, self.high)
        ends = ((best, "best"), (worst, "worst"))
        texts = [f"{value:g} {word}" for value, word in ends if value is not None]
        return ", ".join(texts) if self.better else ""


def unit_words(unit: str | None) -> str:
    """Unit for display, such as m²; "" for a plain number."""
    return {"m2": "m²", None: ""}.get(unit, unit or "")


def _read_metrics() -> Iterator[Metric]:
    for row in read_rows("metrics"):
        values: dict[str, Any] = dict(row)
        for name in _NUMBERS:
            values[name] = float(row[name]) if row[name] else None
        values["unit"] = row["unit"] or None
        values["better"] = row["better"] or None
        values["flags"] = row["flags"].split()
        values["shown_in"] = _positions(row["shown_in"])
        yield Metric(**values)


def _positions(text: str) -> dict[str, int]:
    """Positions of a score by place."""
    positions = {}
    for word in text.split():
        place, _, position = word.partition(":")
        positions[place] = int(position or _LAST)
    return positions


#: Largest distance to the other side at which a point counts as covered, as in names of columns: 0.1, 0.3, 1 m.
COVERAGE_REACHES = ("0p1m", "0p3m", "1m")
#: Columns of the share of either side, or of an object on it, that the other side has within 0.3 m.
COVERED = ("covered_real_0p3m", "covered_sim_0p3m")


def reach_words(reach: str) -> str:
    """Distance for display: `0.3 m` for `0p3m`."""
    return f"{reach.replace('p', '.').removesuffix('m')} m"


#: Every score by its column.
METRIC = {metric.column: metric for metric in _read_metrics()}


def scores_of(*groups: str) -> tuple[str, ...]:
    """Columns of the scores of some groups, in the order of the tables; see `Metric`."""
    return tuple(name for name, metric in METRIC.items() if metric.group in groups)


#: Scores of the displacement of the simulated surface.
SHIFT_COLUMNS = ("shift_x_m", "shift_y_m", "shift_z_m", "shift_m")
#: Scores of rays whose mean over pairs describes a run.
RAY_MEANS = tuple(
    name
    for name in scores_of("ray")
    if name not in ("n_rays", "rays_bias_low_m", "rays_bias_high_m")
)
#: Object scores with mean and standard deviation in `pairs`, in that order.
OBJECT_METRICS = tuple(
    name for name in scores_of("object") if "no-mean" not in METRIC[name].flags
)
#: Object scores whose distributions over all objects a run reports.
DISTRIBUTED = ("cdc", "r_lambda", "r_gap")
#: Limits of the quadrants of the report, by fidpipe, not by the paper; a limit itself belongs to the better quadrant.
#: CDC: the sides are on average about half a metre apart (1 - exp(-0.54^2) = 0.25, twice). r_lambda: upper end of the
#: usual values for objects of a twin meshed from scans (the paper's mean is 0.37).
QUADRANT_LIMITS = {"cdc": 0.5, "r_lambda": 0.4}
#: Geometry and structure of an object: charts, and comparisons of single objects, are of these two.
QUADRANT_SCORES = tuple(QUADRANT_LIMITS)
#: Means over the objects of a pair.
_OBJECT_MEANS = tuple(METRIC[name].mean_column for name in OBJECT_METRICS)
#: Scores of a pair that are repeated under other seeds.
SEEDED_SCORES = (*scores_of("pair"), *_OBJECT_MEANS)
#: Columns of `pairs` whose mean and standard deviation over pairs describe the dataset.
DATASET_SCORES = ("match_rate", *_OBJECT_MEANS)
#: Columns of `pairs` that describe a run, which also measures surfaces.
RUN_SCORES = (
    *DATASET_SCORES,
    *scores_of("coverage", "surface", "piece"),
    *RAY_MEANS,
    *(name for name in scores_of("intensity") if METRIC[name].equal is not None),
)
#: Valid names in the setting metrics.baselines.
BASELINE_NAMES = tuple(dict.fromkeys(METRIC[name].method for name in scores_of("baseline")))


def metric_of(column: str) -> Metric:
    """Score of a column of any table: `cdc` for `cdc` and for its mean over a pair, `cdc_mean`.

    Raises
    ------
    KeyError
        The catalogue has no score of that name.
    """
    return METRIC[column.removesuffix("_mean")]


def scores_in(place: str) -> tuple[str, ...]:
    """Columns of the scores that a place shows, in their order."""
    return tuple(metric.column for metric in metrics_in(place))


def pair_columns_in(place: str) -> tuple[str, ...]:
    """Columns of `pairs` that a place shows, in their order."""
    return tuple(metric.pair_column for metric in metrics_in(place))


def headline_scores(preset: str) -> tuple[str, ...]:
    """Columns of `pairs` that describe a run first."""
    return tuple(column for column in pair_columns_in("answer") if is_of_preset(column, preset))


def is_of_preset(column: str, preset: str) -> bool:
    """True except for the share of matched objects that a preset is not about: of one side, or of the larger one."""
    return column != ("found" if preset == "paper" else "match_rate")


def metrics_in(place: str) -> list[Metric]:
    """The scores that a place shows, in their order."""
    shown = [metric for metric in METRIC.values() if place in metric.shown_in]
    return sorted(shown, key=lambda metric: metric.shown_in[place])


def labels(columns: Iterable[str]) -> list[str]:
    """Headings of columns, each with its unit."""
    return [metric_of(column).label for column in columns]


def narrow_labels(columns: Iterable[str]) -> list[str]:
    """Headings of narrow columns: one word per line, the unit on the last line."""
    return [metric_of(column).narrow_label for column in columns]
