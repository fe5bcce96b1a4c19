"""The numbers of a finished run by name, such as `r_lambda.mean` or `not_found.within_20m`, for criteria of a gate."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ...schemas.cause_catalogue import CAUSES, UNEVEN
from ...schemas.errors import (
    DatasetError,
    RunError,
    ScanError,
    SettingsError,
    StageError,
    suggestion,
)
from ...schemas.metric_catalogue import (
    DISTRIBUTED,
    METRIC,
    OBJECT_METRICS,
    RAY_MEANS,
    scores_of,
)
from ...schemas.results import Unknown
from ...schemas.tables import TABLES
from ..datasets.content import input_hashes
from ..datasets.pairs import Dataset, local_folder, read_dataset
from .best_case import RunExcess
from .finished import FinishedRun
from .odometry import compare_odometry

if TYPE_CHECKING:
    import pandas as pd

_QUANTILES = {
    "min": 0,
    "q05": 0.05,
    "q25": 0.25,
    "median": 0.5,
    "q75": 0.75,
    "q95": 0.95,
    "max": 1,
}
STATISTICS = ("mean", "std", *_QUANTILES)
#: Of the double validation metric, over objects where a score has them.
OF_DISTRIBUTIONS = ("bias", "area")
COUNTS = ("total", "mean", "min", "max", "share")
STATES = ("scored", "failed", "to_do", "changed", "frame_suspect")
#: Columns of `pairs` by the name of their score.
PAIR_SCORES = {
    **{name: METRIC[name].pair_column for name in ("match_rate", *OBJECT_METRICS)},
    **{name: name for name in scores_of("surface", "piece")},
}
#: And by names with dots: `covered.real.0.3m` is `covered_real_0p3m`, `rays.bias_m` is `rays_bias_m`.
DOTTED = {
    **{name.replace("_", ".").replace("p", "."): name for name in scores_of("coverage")},
    **{column.replace("rays_", "rays."): column for column in RAY_MEANS},
}
#: Estimated properties of both sensors: `sensor.sim.range_noise_m` is the column `sensor_sim_range_noise_m`.
SENSOR_VALUES: dict[str, str] = {
    column.replace("_", ".", 2): column
    for column in TABLES["pairs"].schema.names
    if column.startswith("sensor_")
}
#: Gaps of tasks: `tasks.objects.lost` is the mean, `tasks.objects.lost.max` the largest value.
TASK_GAPS = {f"tasks.{name}": name for name in scores_of("task")}
#: Measures of odometry: `tasks.odometry.drift_m` is the gap over the longest sequence of scans.
ODOMETRY_MEASURES = ("drift_m", "step_m", "turn_deg")
#: Names of causes by that of the catalogue.
CAUSE_NAMES = {name.replace(" ", "_"): name for name in CAUSES if name != UNEVEN}
_COLUMNS = PAIR_SCORES | DOTTED | SENSOR_VALUES | TASK_GAPS

#: Names to guess from what a wrong one means.
_EXAMPLES = (
    *(f"{name}.mean" for name in _COLUMNS),
    *(f"objects.{score}.q95" for score in DISTRIBUTED),
    *(
        "not_found.within_20m",
        "not_found.share",
        "extra.within_20m",
        "extra.share",
        "matched.min",
    ),
    *(f"pairs.{state}" for state in STATES),
    *(f"causes.{name}" for name in CAUSE_NAMES),
    *(f"tasks.odometry.{measure}" for measure in ODOMETRY_MEASURES),
)


class _AbsentError(Exception):
    """The number does not exist; the message is the reason."""


class Measures:
    """The numbers of a finished run by name; those over its best case where there is one."""

    def __init__(self, run: FinishedRun, excess: RunExcess | None = None) -> None:
        self.run, self._excess = run, excess

    def named(self, name: str) -> tuple[float | None, str]:
        """The number of that name; or None, and the reason.

        Raises
        ------
        SettingsError
            The name is unknown, or needs a best case that is not given.
        """
        for pattern, measure in _MEASURES.items():
            if match := re.fullmatch(pattern, name, re.DOTALL):
                try:
                    return float(measure(self, **match.groupdict())), ""
                except _AbsentError as why:
                    return None, str(why)
        mean = f"{name}.mean"
        hint = f"did you mean {mean}?" if mean in _EXAMPLES else suggestion(name, _EXAMPLES)
        raise SettingsError(
            f"criterion {name!r}: no such measure; {hint} (fidpipe gate --help lists the forms)"
        )

    @cached_property
    def dataset_is_gone(self) -> bool:
        """True if the dataset's folder is not on this machine; a broken one is not gone."""
        try:
            return not local_folder(self.run.record.dataset).exists()
        except DatasetError:
            return True
        except OSError:
            return False  # it is there and cannot be read, which `_dataset` says

    def _of_pairs(self, score: str, stat: str = "mean") -> float:
        column = _COLUMNS[score]
        if column not in self.run.scores:
            raise _AbsentError(f"the run has no {score}; add it with fidpipe run --tasks")
        return _statistic(self.run.scores[column], stat, "pair", score)

    def _over_best_case(self, score: str, stat: str) -> float:
        if self._excess is None:
            raise SettingsError(
                f"criterion 'excess.{score}.{stat}': needs a best case; add --best-case RUN"
            )
        column = _COLUMNS[score]
        score = f"{score} in both runs"
        if stat not in OF_DISTRIBUTIONS:
            return _statistic(self._excess.of_pairs[column], stat, "pair", score)
        value: float | None = self._excess.scores[column][stat]
        if value is None:
            raise _AbsentError(f"no pair has a {score}")
        return value

    def _of_objects(self, label: str | None, score: str, stat: str) -> float:
        objects = self._objects_of("real", label)
        scores = objects.loc[objects["fate"] == "matched", score]
        what = "matched object" if label is None else f"matched object of class {label}"
        return _statistic(scores, stat, what, score)

    def _count(
        self, label: str | None, fate: str, within: str | None, count: str | None
    ) -> float:
        """Number of objects of a fate: in all, by default, a statistic over pairs, or their share."""
        side = "sim" if fate == "extra" else "real"
        objects = self._objects_of(side, label)
        if within is not None:
            objects = objects[objects["range_m"] < float(within)]
        has_fate = objects["fate"] == fate
        if count == "share":
            if objects.empty:
                raise _AbsentError(f"the {side} side has no such object")
            return float(has_fate.mean())
        of_pairs = np.bincount(objects.loc[has_fate, "pair"], minlength=len(self.run.names))
        return float(of_pairs.sum() if count in (None, "total") else getattr(of_pairs, count)())

    def _objects_of(self, side: str, label: str | None) -> pd.DataFrame:
        """The objects of a side, or those of a class."""
        objects = self._objects[self._objects["side"] == side]
        if label is None:
            return objects
        labels = sorted(self._objects["label"].dropna().unique())
        if label not in labels:
            raise _AbsentError(
                f"no object has the class {label}; classes are {', '.join(labels) or 'none'}"
            )
        return objects[objects["label"] == label]

    @cached_property
    def _objects(self) -> pd.DataFrame:
        self._require_pairs()
        objects = self.run.objects_of(self.run.names, ["range_m", "label", *DISTRIBUTED])
        return objects[objects["fate"] != "remnant"]

    def _cause(self, cause: str, end: str | None) -> float:
        """Mean amount of a cause without its sign, or an end of its interval."""
        self._require_pairs()
        amount = self.run.mean_amounts[CAUSE_NAMES[cause]]
        if isinstance(amount, Unknown):
            raise _AbsentError(amount.reason)
        sizes = {None: amount.estimate, "low": amount.low, "high": amount.high}
        if amount.estimate < 0:
            sizes = {None: -amount.estimate, "low": -amount.high, "high": -amount.low}
        return sizes[end]

    def _require_pairs(self) -> None:
        if not self.run.names:
            raise _AbsentError("no pair is scored")

    def _odometry(self, measure: str) -> float:
        """The gap of odometry over the longest sequence of scans."""
        try:
            return self._odometry_gaps[measure]
        except (RunError, StageError) as error:
            raise _AbsentError(str(error)) from error

    @cached_property
    def _odometry_gaps(self) -> dict[str, float]:
        return {row["measure"]: row["gap"] for row in compare_odometry(self.run)}

    def _pairs(self, state: str) -> float:
        """Number of pairs in a state; `changed` are of other scans or labels than now, or not in the dataset."""
        record = self.run.record
        states = [row["status"] for row in self.run.rows]
        if state in ("scored", "failed"):
            return states.count(state)
        if state == "frame_suspect":
            return len(record.frames)
        if self.dataset_is_gone:
            if state == "to_do":
                return record.pairs.to_do
            raise _AbsentError(f"the dataset {record.dataset} is not here")
        now = {pair.pair_id: pair for pair in self._dataset.pairs}
        if state == "to_do":
            return len(now.keys() - self.run.rows_by_name.keys())
        n_changed = 0
        for pair_id, hashes in record.inputs.items():
            try:
                is_same = pair_id in now and (
                    input_hashes(now[pair_id], self._dataset.label_names)["content"]
                    == hashes["content"]
                )
            except ScanError as error:
                raise _AbsentError(str(error)) from error
            n_changed += not is_same
        return n_changed

    @cached_property
    def _dataset(self) -> Dataset:
        """The dataset of the run as it is now."""
        try:
            return read_dataset(local_folder(self.run.record.dataset))
        except (DatasetError, OSError) as error:
            raise _AbsentError(str(error)) from error


def _statistic(values: pd.Series[float], stat: str, what: str, score: str) -> float:
    known = values.dropna()
    if known.empty:
        raise _AbsentError(f"no {what} has a {score}")
    if stat in _QUANTILES:
        return float(known.quantile(_QUANTILES[stat]))
    if stat == "std" and len(known) == 1:
        raise _AbsentError(f"only one {what} has a {score}")
    return float(known.agg(stat))


def _either(name: str, words: Iterable[str]) -> str:
    return f"(?P<{name}>{'|'.join(map(re.escape, words))})"


_CLASS = r"class\.(?P<label>.+)\."
_WITHIN = r"(?:\.within_(?P<within>[0-9]+(?:\.[0-9]+)?)m)?"
_STATISTIC = _either("stat", STATISTICS)
_FATE = _either("fate", ("not_found", "extra", "matched"))
_MEASURES: dict[str, Callable[..., float]] = {
    rf"{_either('score', _COLUMNS)}\.{_STATISTIC}": Measures._of_pairs,
    _either("score", TASK_GAPS): Measures._of_pairs,
    rf"excess\.{_either('score', PAIR_SCORES | DOTTED)}\."
    rf"{_either('stat', (*STATISTICS, *OF_DISTRIBUTIONS))}": Measures._over_best_case,
    rf"(?:objects\.|{_CLASS}){_either('score', DISTRIBUTED)}\.{_STATISTIC}": Measures._of_objects,
    rf"(?:{_CLASS})?{_FATE}{_WITHIN}(?:\.{_either('count', COUNTS)})?": Measures._count,
    rf"pairs\.{_either('state', STATES)}": Measures._pairs,
    rf"tasks\.odometry\.{_either('measure', ODOMETRY_MEASURES)}": Measures._odometry,
    rf"causes\.{_either('cause', CAUSE_NAMES)}(?:\.{_either('end', ('low', 'high'))})?": (
        Measures._cause
    ),
}
