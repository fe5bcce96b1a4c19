"""The scores of a run over its best case: what a perfect simulator would score on the same real scans.

It is a run of `fidpipe best-case`: like any other, with a recipe next to its scans that describes how they were made.
"""

from __future__ import annotations

import json
import shlex
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from pydantic import TypeAdapter

from ...schemas.columns import Row
from ...schemas.data_files import parse_toml
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import OBJECT_METRICS, RUN_SCORES, metric_of
from ...schemas.results import JsonObject
from ...stages.statistics.validation import double_validation_metric
from ..storage.run_record import read_run
from ..storage.urls import url_or_path
from .finished import FinishedRun, settings_changes, version_changes
from .object_frame import plain_rows

if TYPE_CHECKING:
    import pandas as pd

BEST_CASE_DATASET = "dataset"
BEST_CASE_RECIPE = "best_case.toml"
BEST_CASE_AMOUNTS = "best_case.csv"
AS_MEASURED: Literal["measured"] = "measured"  #: noise or losses that each real scan shows itself
#: What has a best case: columns of `pairs`.
SCORES = (
    "match_rate",
    "n_not_found",
    "n_extra",
    *(name for name in RUN_SCORES if name != "match_rate"),
)


@dataclass(frozen=True)
class BestCaseRecipe:
    """Recipe of the second measurements of a best case.

    noise_m, lost_share : "measured" for those that each scan shows, listed in `BEST_CASE_AMOUNTS`
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
        return "".join(f"{name} = {json.dumps(value)}\n" for name, value in asdict(self).items())


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


def run_of_best_case(best_case: Path, recipe: BestCaseRecipe) -> str:
    """The run next to a best case that is of the same dataset, as commands take it; "RUN" if there is none."""
    for name in (best_case.name.removesuffix("-best-case"), Path(recipe.dataset).name):
        run = best_case.with_name(name)
        if run != best_case and read_run(run).get("dataset") == recipe.dataset:
            return url_or_path(run)
    return "RUN"


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
    scored = set(other.names)
    names = tuple(name for name in run.names if name in scored)
    hashes = {name: of_scans.get("real") for name, of_scans in run.record.inputs.items()}
    theirs = other.record.inputs
    moved = [name for name in hashes if name in theirs and hashes[name] != theirs[name].get("real")]
    problem = ""
    if differing := settings_changes(run, other):
        problem = f"settings differ ({'; '.join(differing)})"
    elif moved:
        problem = f"the real scans of {len(moved)} pairs differ ({', '.join(moved[:3])})"
    elif not names:
        problem = "no pair is scored in both"
    if problem:
        runs = f"run {run.folder} and best case {best_case}"
        raise RunError(f"{runs}: {problem}; make one for it: {command}")
    of_run, of_best_case = [one.scores.loc[[*names], [*SCORES]] for one in (run, other)]
    of_pairs = of_run - of_best_case
    has_both = of_pairs.notna()
    scores = {
        "n_pairs": has_both.sum(),
        "mean": of_run[has_both].mean(),
        "best_case": of_best_case[has_both].mean(),
        "excess": of_pairs.mean(),
        "std": of_pairs.std(),
    }
    distances = _distances([run, other], names)
    return RunExcess(
        run=run.folder,
        best_case=best_case,
        recipe=recipe,
        pairs=names,
        left_out=tuple(name for name in run.names if name not in scored),
        notes=tuple(version_changes(run, other)),
        scores=dict(zip(SCORES, plain_rows(distances.assign(**scores)), strict=True)),
        of_pairs=of_pairs,
        task_gaps=other.record.task_gaps,
    )


def _distances(runs: Sequence[FinishedRun], names: Sequence[str]) -> pd.DataFrame:
    """Bias and area of each score between a run and its best case; NaN if a side has no value."""
    import pandas as pd

    of_objects = []
    for run in runs:
        objects = run.objects_of(names, OBJECT_METRICS, ("real",))
        of_objects.append(objects[objects["fate"] == "matched"])
    distances = []
    for column in SCORES:
        metric = metric_of(column).column
        frames = of_objects
        if metric not in OBJECT_METRICS:
            frames = [run.scores.loc[[*names]] for run in runs]
        sim, real = [frame[metric].to_numpy() for frame in frames]
        distances.append(double_validation_metric(real, sim))
    return pd.DataFrame(distances, index=[*SCORES], dtype=np.float64)
