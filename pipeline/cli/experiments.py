"""The commands of the paper's experiments: perturb and ablate."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from .options import (
    Assignments,
    Count,
    DatasetFolder,
    Pairs,
    Preset,
    Replace,
    Seed,
    SettingsFile,
    Workers,
)
from .output import print_outcome


def perturb(
    source: Path,
    out: Path | None = None,
    sweep: Annotated[list[str] | None, typer.Option(metavar="KIND[=AMOUNTS]")] = None,
    repeats: Count = 20,
    global_repeats: Annotated[int, typer.Option(min=0)] = 5,
    seed: Seed = 0,
    preset: Preset = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    workers: Workers = None,
    pairs: Pairs = None,
    replace: Replace = False,
) -> None:
    """Alter a real scan in known ways and see how the scores respond: the paper's Table I.

    Kinds: noise, dropout, rigid (motion), hallucination (spurious clusters) and density, on the
    whole scan and on single objects (a vegetation, a car, a tree and a wall, or without labels one
    of each shape). Of a dataset, the real side of the first pair is used. Run again to resume.

    Parameters
    ----------
    source : A scan file, or a dataset's folder.
    out : Folder of the results, else runs/NAME-perturb.
    sweep : One kind; repeatable.
    repeats : Trials per level on an object.
    global_repeats : Trials on the whole scan.
    seed : Seed of all trials.
    pairs : Matching pairs instead of the first one.

    Examples
    --------
    fidpipe perturb scan.bin                     results go to runs/scan-perturb

    fidpipe perturb dataset/ --pairs '000*' --workers 8

    fidpipe perturb scan.bin --sweep noise --sweep dropout=0.1,0.3,0.5

    fidpipe perturb scan.bin --sweep rigid=0:1,0.1:5        metres:degrees

    fidpipe perturb scan.bin --set metrics.baselines=all --global-repeats 0    also baseline metrics
    """
    from ...schemas.settings import load
    from ..engine.progress import Reporter
    from ..paper.experiment_views import show_perturbations
    from ..paper.perturb import AMOUNTS, PerturbRequest, parse_levels, perturb_source

    request = PerturbRequest(
        levels=parse_levels(["null", *(sweep or AMOUNTS)]),
        repeats=repeats,
        global_repeats=global_repeats,
        seed=seed,
    )
    outcome = perturb_source(
        source,
        out or _experiment_folder(source, "perturb"),
        load(settings, assignments or [], preset=preset),
        Reporter(),
        request,
        pattern=pairs,
        n_workers=workers,
        replace_finished=replace,
    )
    print_outcome(show_perturbations(outcome), outcome.failures)


def ablate(
    dataset: DatasetFolder,
    out: Path | None = None,
    k: Annotated[str | None, typer.Option(metavar="30,60,90")] = None,
    tau: Annotated[str | None, typer.Option(metavar="0.1,0.2")] = None,
    delta: Annotated[str | None, typer.Option(metavar="3,5")] = None,
    t: Annotated[str | None, typer.Option(metavar="0.5,1,2")] = None,
    preset: Preset = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    workers: Workers = None,
    pairs: Pairs = None,
    replace: Replace = False,
) -> None:
    """See how match rate and r_lambda depend on k, tau, delta and t.

    One setting is varied at a time, around the effective ones (--settings, --set), on all pairs.
    Graphs are computed once for each k and tau. Run again to resume; other values of a finished
    ablation require --replace or another --out. --k with a single value keeps k fixed.

    Parameters
    ----------
    out : Folder of the results, else runs/NAME-ablate.
    k : Values of graph.k. Default: 30,60,90,120,150.
    tau : Values of graph.tau_m, metres. Default: 0.1,0.2,0.3,0.5.
    delta : Values of matching.delta_m, metres. Default: 1,3,5,7,10.
    t : Values of selection.t. Default: 0.1,0.5,1,2,5.

    Examples
    --------
    fidpipe ablate dataset/                          results go to runs/dataset-ablate

    fidpipe ablate dataset/ --k 90 --tau 0.2 --t 1 --delta 1,2,3,4,5,6,8,10
    """
    from ...schemas.settings import load
    from ..engine.progress import Reporter
    from ..paper.ablate import ablate_dataset
    from ..paper.experiment_views import show_ablation

    options = {"k": k, "tau_m": tau, "delta_m": delta, "t": t}
    outcome = ablate_dataset(
        dataset,
        out or _experiment_folder(dataset, "ablate"),
        load(settings, assignments or [], preset=preset),
        Reporter(),
        values={
            name: _numbers(name, text) for name, text in options.items() if text is not None
        },
        pattern=pairs,
        n_workers=workers,
        replace=replace,
    )
    print_outcome(show_ablation(outcome), outcome.failures)


def _numbers(name: str, text: str) -> tuple[float, ...]:
    """The values of an option, which is named as its setting is, without the unit."""
    try:
        return tuple(float(word) for word in text.split(","))
    except ValueError:
        option = f"--{name.removesuffix('_m')}"
        raise typer.BadParameter(
            f"expected numbers with commas, got {text!r}", param_hint=option
        ) from None


def _experiment_folder(source: Path, experiment: str) -> Path:
    from ..datasets.readers.scan_ref import scan_ref

    path = Path(os.path.realpath(source))
    name = scan_ref(path).stem if scan_ref(source).exists else path.name
    return Path("runs") / f"{name}-{experiment}"
