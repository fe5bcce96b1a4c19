"""The numbers of a finished run by name, such as `r_lambda.mean` or `missing.within_20m`: what a gate can judge."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, SettingsError
from ...schemas.metrics import DISTRIBUTED, METRIC, OBJECT_METRICS
from ...stages.arrays import BoolArray, FloatArray, IndexArray
from ...stages.statistics.findings import MatchedObjects, SideObjects, distribution
from ..datasets.pairs import Dataset, read_dataset
from ..datasets.scan_checks import input_hashes
from .findings import read_objects
from .finished import FinishedRun

_OF_PAIRS = ("mean", "std", "min", "median", "max")
_OF_OBJECTS = ("mean", "std", "min", "q05", "q25", "median", "q75", "q95", "max")
_COUNTS = ("total", "mean", "max", "share")
_PAIR_SCORES = ("match_rate", *OBJECT_METRICS)
_UNMATCHED = {"missing": 0, "hallucinated": 1}

_STATES = ("scored", "failed", "to_do", "changed")
_NO_PAIR = "no pair is scored"

#: Every name that can be measured; words in capitals stand for many.
KNOWN = (
    f"SCORE.{'|'.join(_OF_PAIRS)} over pairs ({', '.join(_PAIR_SCORES)})",
    f"objects.SCORE.{'|'.join(_OF_OBJECTS)} and class.LABEL.SCORE.... over objects ({', '.join(DISTRIBUTED)})",
    f"missing.{'|'.join(_COUNTS)}, hallucinated...., class.LABEL.missing....",
    "missing.within_20m and missing.within_20m.share (any distance)",
    "matched.total|mean|min",
    f"pairs.{'|'.join(_STATES)}",
)


@dataclass(frozen=True)
class Measured:
    """A number, or None and why there is none."""

    value: float | None
    why: str = ""


class Measures:
    """The numbers of a finished run by name."""

    def __init__(self, run: FinishedRun) -> None:
        self.run = run

    def named(self, name: str) -> Measured:
        """The number of that name.

        Raises
        ------
        SettingsError
            There is no such name.
        """
        for pattern, measure in _MEASURES:
            match = pattern.fullmatch(name)
            if match:
                return measure(self, **match.groupdict())
        raise SettingsError(f"criterion {name!r}: no such measure; known are {'; '.join(KNOWN)}")

    @cached_property
    def dataset_is_gone(self) -> bool:
        """Whether the dataset's folder is not on this machine; one that is there but broken is not gone."""
        try:
            Path(self.run.record.dataset).stat()
        except (FileNotFoundError, NotADirectoryError):
            return True
        except OSError:
            pass  # it is there and cannot be read, which `_dataset` says
        return False

    def _of_pairs(self, score: str, stat: str) -> Measured:
        column = METRIC[score].mean_column if score in OBJECT_METRICS else score
        values = np.array([np.nan if row[column] is None else row[column] for row in self.run.scored], dtype=float)
        return _statistic(values, stat, "pair", score)

    def _of_objects(self, label: str | None, score: str, stat: str) -> Measured:
        if not self.run.scored:
            return Measured(None, _NO_PAIR)
        values: FloatArray = getattr(self._matched, score)
        if label is not None:
            values = values[self._matched.label == label]
        return _statistic(
            values, stat, "matched object" if label is None else f"matched object of class {label}", score
        )

    def _unmatched(self, label: str | None, what: str, within: str | None, count: str | None) -> Measured:
        if not self.run.scored:
            return Measured(None, _NO_PAIR)
        side = self._sides[_UNMATCHED[what]]
        chosen: BoolArray = np.ones(len(side.pair), dtype=np.bool_)
        if label is not None:
            chosen &= side.label == label
            if not any((objects.label == label).any() for objects in self._sides):
                return Measured(
                    None, f"no object has the class {label}; classes are {', '.join(self._labels) or 'none'}"
                )
        if within is not None:
            chosen &= side.range_m < float(within)
        alone = chosen & ~side.is_matched
        if count == "share":
            if not chosen.any():
                return Measured(None, f"there is no such object on the {SIDES[_UNMATCHED[what]]} side")
            return Measured(float(np.mean(alone[chosen])))
        return Measured(_counted(np.bincount(side.pair[alone], minlength=len(self.run.scored)), count or "total"))

    def _both(self, count: str) -> Measured:
        if not self.run.scored:
            return Measured(None, _NO_PAIR)
        return Measured(_counted(np.array([row["n_matched"] for row in self.run.scored]), count))

    def _pairs(self, state: str) -> Measured:
        if state == "changed":
            return self._changed()
        if state != "to_do":
            return Measured(float(sum(row["status"] == state for row in self.run.rows)))
        if self.dataset_is_gone:
            return Measured(float(self.run.record.pairs.to_do))
        if isinstance(self._dataset, str):
            return Measured(None, self._dataset)
        return Measured(
            float(len({pair.pair_id for pair in self._dataset.pairs} - {row["pair_id"] for row in self.run.rows}))
        )

    def _changed(self) -> Measured:
        """Pairs of other scans, labels, label names or T_real_sim than were evaluated, or no longer in the dataset."""
        if self.dataset_is_gone:
            return Measured(None, f"the dataset {self.run.record.dataset} is not here")
        if isinstance(self._dataset, str):
            return Measured(None, self._dataset)
        before = self.run.record.inputs
        if not all("content" in hashes for hashes in before.values()):
            again = f"fidpipe run {self.run.record.dataset} --out {self.run.folder}"
            return Measured(
                None, f"an older fidpipe wrote the run and did not note all that it is made of; run again: {again}"
            )
        now = {pair.pair_id: pair for pair in self._dataset.pairs}
        names = self._dataset.label_names
        try:
            n = sum(
                pair_id not in now or input_hashes(now[pair_id], names)["content"] != hashes["content"]
                for pair_id, hashes in before.items()
            )
        except OSError as error:
            return Measured(None, f"a file of the dataset cannot be read ({error})")
        return Measured(float(n))

    @cached_property
    def _dataset(self) -> Dataset | str:
        """The dataset of the run as it is now, or why it cannot be read."""
        try:
            return read_dataset(Path(self.run.record.dataset))
        except (DatasetError, OSError) as error:
            return str(error)

    @cached_property
    def _objects(self) -> tuple[SideObjects, SideObjects, MatchedObjects]:
        names = [row["pair_id"] for row in self.run.scored]
        for name in names:
            self.run.check(name)
        return read_objects(self.run.store, names)

    @property
    def _sides(self) -> tuple[SideObjects, SideObjects]:
        return self._objects[:2]

    @property
    def _matched(self) -> MatchedObjects:
        return self._objects[2]

    @property
    def _labels(self) -> list[str]:
        labels: list[str] = np.unique(np.concatenate([side.label for side in self._sides])).tolist()
        return [label for label in labels if label]


def _statistic(values: FloatArray, stat: str, what: str, score: str) -> Measured:
    spread = distribution(values)
    if not spread.n:
        return Measured(None, f"no {what} has a {score}")
    value = getattr(spread, stat)
    return Measured(None, f"only one {what} has a {score}") if value is None else Measured(float(value))


def _counted(by_pair: IndexArray, count: str) -> float:
    numbers = {"total": by_pair.sum(), "mean": by_pair.mean(), "min": by_pair.min(), "max": by_pair.max()}
    return float(numbers[count])


def _either(name: str, words: Iterable[str]) -> str:
    return f"(?P<{name}>{'|'.join(words)})"


_CLASS = r"(?:class\.(?P<label>.+)\.)"
_WITHIN = r"(?:\.within_(?P<within>[0-9]+(?:\.[0-9]+)?)m)?"
_MEASURES: tuple[tuple[re.Pattern[str], Callable[..., Measured]], ...] = tuple(
    (re.compile(pattern, re.DOTALL), measure)
    for pattern, measure in (
        (rf"{_either('score', _PAIR_SCORES)}\.{_either('stat', _OF_PAIRS)}", Measures._of_pairs),
        (
            rf"(?:objects\.|{_CLASS}){_either('score', DISTRIBUTED)}\.{_either('stat', _OF_OBJECTS)}",
            Measures._of_objects,
        ),
        (rf"{_CLASS}?{_either('what', _UNMATCHED)}{_WITHIN}(?:\.{_either('count', _COUNTS)})?", Measures._unmatched),
        (rf"matched\.{_either('count', ('total', 'mean', 'min'))}", Measures._both),
        (rf"pairs\.{_either('state', _STATES)}", Measures._pairs),
    )
)
