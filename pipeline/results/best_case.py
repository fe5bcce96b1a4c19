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

from ...schemas.data_files import parse_toml
from ...schemas.errors import RunError
from ...schemas.metric_catalogue import OBJECT_METRICS, RUN_SCORES, metric_of
from ...schemas.results import JsonObject
from ...stages.statistics.validation import double_validation_metric
from ...stages.summary import mean_and_std
from ..storage.run_record import read_run
from ..storage.urls import url_or_path
from .finished import FinishedRun, settings_changes, version_changes

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
class ScoreExcess:
    """One score of a run over its best case, in the score's unit.

    column : of `pairs`
    n_pairs : pairs that have the score in both
    mean, best_case : over these pairs
    excess, std : mean and standard deviation (n - 1) over them of score - best case of the same pair
    bias, area : double validation metric of both distributions, over all matched objects of a score of objects, else
        over the pairs; see `stages.statistics.validation`
    of_pairs : by pair, score - best case; None if either is null
    """

    column: str
    n_pairs: int
    mean: float | None
    best_case: float | None
    excess: float | None
    std: float | None
    bias: float | None
    area: float | None
    of_pairs: dict[str, float | None]


@dataclass(frozen=True)
class RunExcess:
    """A run over its best case.

    recipe : of the best case
    pairs : that both have; `left_out` are scored in the run alone
    notes : what else differs and can change a number
    scores : by column of `pairs`
    task_gaps : of the best case, by names such as `objects.lost`
    """

    run: Path
    best_case: Path
    recipe: BestCaseRecipe
    pairs: tuple[str, ...]
    left_out: tuple[str, ...]
    notes: tuple[str, ...]
    scores: dict[str, ScoreExcess]
    task_gaps: dict[str, float | None]

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON."""
        return asdict(self) | {"run": str(self.run), "best_case": str(self.best_case)}


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
    of_pairs = [_pairs(run, names), _pairs(other, names)]
    of_objects = [_matched(run, names), _matched(other, names)]
    return RunExcess(
        run=run.folder,
        best_case=best_case,
        recipe=recipe,
        pairs=names,
        left_out=tuple(name for name in run.names if name not in scored),
        notes=tuple(version_changes(run, other)),
        scores={column: _excess(column, names, of_pairs, of_objects) for column in SCORES},
        task_gaps=other.record.task_gaps,
    )


def _pairs(run: FinishedRun, names: Sequence[str]) -> pd.DataFrame:
    """The scores of some pairs; NaN for null."""
    return run.pairs.set_index("pair_id").loc[[*names], [*SCORES]].astype(np.float64)


def _matched(run: FinishedRun, names: Sequence[str]) -> pd.DataFrame:
    """The matched objects of some pairs."""
    return run.objects_of(names, OBJECT_METRICS).query("side == 'real' and partner >= 0")


def _excess(
    column: str,
    names: Sequence[str],
    pairs: Sequence[pd.DataFrame],
    objects: Sequence[pd.DataFrame],
) -> ScoreExcess:
    """One score of a run over its best case, from the pairs and the matched objects of both."""
    of_run = pairs[0][column].to_numpy()
    of_best_case = pairs[1][column].to_numpy()
    over = of_run - of_best_case
    has_both = ~np.isnan(over)
    excess, std = mean_and_std(over)
    metric = metric_of(column).column
    values = [of_run, of_best_case]
    if metric in OBJECT_METRICS:
        values = [frame[metric].to_numpy() for frame in objects]
    apart = double_validation_metric(sim=values[0], real=values[1])
    known = [None if np.isnan(value) else value for value in over.tolist()]
    return ScoreExcess(
        column=column,
        n_pairs=int(np.count_nonzero(has_both)),
        mean=mean_and_std(of_run[has_both])[0],
        best_case=mean_and_std(of_best_case[has_both])[0],
        excess=excess,
        std=std,
        bias=apart.bias,
        area=apart.area,
        of_pairs=dict(zip(names, known, strict=True)),
    )
