"""The scores of a run over its best case: what a perfect simulator would score on the same real scans.

It is a run of `fidpipe best-case`: like any other, with a recipe next to its scans that describes how they were made.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import TypeAdapter

from ...schemas.columns import Row
from ...schemas.data_files import parse_toml
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import METRIC, OBJECT_METRICS, RUN_SCORES
from ...schemas.results import JsonObject
from ...stages.arrays import FloatArray
from ...stages.statistics.validation import double_validation_metric
from ..storage.urls import url_or_path
from .finished import (
    OTHER_SCAN,
    FinishedRun,
    pairs_left_out,
    settings_changes,
    version_changes,
)
from .object_frame import plain_rows

if TYPE_CHECKING:
    import pandas as pd

BEST_CASE_DATASET = "dataset"
BEST_CASE_RECIPE = "best_case.toml"
#: Noise or losses that each real scan shows itself.
AS_MEASURED: Literal["measured"] = "measured"
#: What has a best case: columns of `pairs`.
SCORES = ("n_not_found", "n_extra", *RUN_SCORES)


@dataclass(frozen=True)
class BestCaseRecipe:
    """Recipe of the second measurements of a best case.

    noise_m, lost_share : "measured" for those that each scan shows
    seed : of noise and losses
    dataset : whose real scans they are of
    """

    version: int
    noise_m: float | Literal["measured"]
    lost_share: float | Literal["measured"]
    seed: int
    dataset: str

    @property
    def words(self) -> str:
        """The same for people; equal where the same scans give the same measurements."""
        noise = "as measured" if self.noise_m == AS_MEASURED else f"{self.noise_m:g} m"
        lost = "as measured" if self.lost_share == AS_MEASURED else f"{self.lost_share:g}"
        return f"range noise {noise}, dropout {lost}, seed {self.seed}"

    def to_toml(self) -> str:
        """The text of the recipe's file."""
        return "".join(
            f"{name} = {json.dumps(value)}\n" for name, value in asdict(self).items()
        )


@dataclass(frozen=True)
class RunExcess:
    """A run over its best case.

    recipe : of the best case
    pairs : that both have; `left_out` are scored in the run alone
    notes : what else differs and can change a number
    scores : by column of `pairs`, in the score's unit, None if unknown: `n_pairs` that have it in both, over these
        `mean` and `best_case`, and mean and standard deviation (n - 1) of score - best case of the same pair (`excess`,
        `std`); `bias` and `area`, the double validation metric of both distributions, over all matched objects of a
        score of objects, else over the pairs (`stages.statistics.validation`)
    of_pairs : (pairs, scores) score - best case; NaN if either is null
    task_gaps : of the best case, by names such as `objects.lost`
    """

    run: Path
    best_case: Path
    recipe: BestCaseRecipe
    pairs: tuple[str, ...]
    left_out: tuple[str, ...]
    notes: tuple[str, ...]
    scores: dict[str, Row]
    of_pairs: pd.DataFrame
    task_gaps: dict[str, float | None]

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        return vars(self) | {
            "run": str(self.run),
            "best_case": str(self.best_case),
            "recipe": asdict(self.recipe),
            "of_pairs": dict(zip(self.pairs, plain_rows(self.of_pairs), strict=True)),
        }


_RECIPE = TypeAdapter(BestCaseRecipe)


def read_recipe(run: Path) -> BestCaseRecipe | None:
    """The recipe of a best case; None if the folder is not a run of `fidpipe best-case`."""
    try:
        recipe = parse_toml(
            (run / BEST_CASE_DATASET / BEST_CASE_RECIPE).read_text(encoding="utf-8")
        )
        return _RECIPE.validate_python(recipe)
    except (OSError, ValueError):  # TOML and unicode errors are ValueErrors
        return None


def excess_over(run: FinishedRun, best_case: Path) -> RunExcess:
    """Each score of a run minus that of the same pair in the best case, and the distance of both distributions.

    excess = mean over pairs of (score - best case)

    Above 0 is worse than a perfect simulator where lower is better, below 0 where higher is better.

    Parameters
    ----------
    best_case : the folder of a run of `fidpipe best-case`

    Raises
    ------
    RunError
        The folder is not a best case, has other settings or other real scans, has none of the pairs, or a table is
        damaged.
    """
    command = shlex.join(["fidpipe", "best-case", url_or_path(run.folder)])
    recipe = read_recipe(best_case)
    if recipe is None:
        raise RunError(
            f"{best_case}: is not a run of fidpipe best-case (no "
            f"{BEST_CASE_DATASET}/{BEST_CASE_RECIPE} in it); make one for {run.folder} with: "
            f"{command}; for changes against another run: fidpipe compare, diagnose --since"
        )
    other = FinishedRun(best_case)
    left_out = pairs_left_out(run, other)
    names = tuple(name for name in run.names if name not in left_out)
    if problem := _problem(run, other, left_out):
        runs = f"run {run.folder} and best case {best_case}"
        raise RunError(f"{runs}: {problem}; make one for it: {command}")
    of_pairs = run.scores.loc[[*names], [*SCORES]] - other.scores.loc[[*names], [*SCORES]]
    return RunExcess(
        run=run.folder,
        best_case=best_case,
        recipe=recipe,
        pairs=names,
        left_out=tuple(name for name in run.names if name in left_out),
        notes=tuple(version_changes(run, other)),
        scores=_excess(run, other, of_pairs),
        of_pairs=of_pairs,
        task_gaps=other.record.task_gaps,
    )


def _problem(run: FinishedRun, other: FinishedRun, left_out: Mapping[str, str]) -> str:
    """Why a run has no excess over a best case; "" if it has."""
    if differing := settings_changes(run, other):
        return f"settings differ ({'; '.join(differing)})"
    moved = [name for name, why in left_out.items() if why == OTHER_SCAN]
    if moved:
        return f"the real scans of {len(moved)} pairs differ ({', '.join(moved[:3])})"
    return "no pair is scored in both" if left_out.keys() >= {*run.names} else ""


def _excess(run: FinishedRun, other: FinishedRun, of_pairs: pd.DataFrame) -> dict[str, Row]:
    """The `scores` of `RunExcess`, from its `of_pairs`."""
    import pandas as pd

    names = [*of_pairs.index]
    has_both = of_pairs.notna()
    sim = _values(run, names)
    real = _values(other, names)
    apart = [double_validation_metric(real[column], sim[column]) for column in SCORES]
    summary = pd.DataFrame(apart, index=[*SCORES], dtype=np.float64).assign(
        n_pairs=has_both.sum(),
        mean=run.scores.loc[names][has_both].mean(),
        best_case=other.scores.loc[names][has_both].mean(),
        excess=of_pairs.mean(),
        std=of_pairs.std(),
    )
    return dict(zip(SCORES, plain_rows(summary), strict=True))


def _values(run: FinishedRun, names: Sequence[str]) -> dict[str, FloatArray]:
    """Values by column of `pairs`: of all matched objects of some pairs for a score of objects, else of the pairs."""
    scores = run.scores.loc[[*names], [*SCORES]]
    values = {column: scores[column].to_numpy() for column in SCORES}
    objects = run.objects_of(names, OBJECT_METRICS, ("real",))
    matched = objects[objects["fate"] == "matched"]
    for name in OBJECT_METRICS:
        values[METRIC[name].mean_column] = matched[name].to_numpy()
    return values
