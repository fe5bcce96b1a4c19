"""The command: parses, calls, prints. No arithmetic; heavy imports only after the options are checked."""

from __future__ import annotations

import signal
import sys
from pathlib import Path
from typing import Annotated

import typer

from .experiments import ablate, perturb
from .options import (
    EXIT_INTERRUPTED,
    EXIT_PAIRS_FAILED,
    EXIT_WRONG_INPUT,
    Assignments,
    DatasetFolder,
    Scheduler,
    SettingsFile,
    Workers,
    check_machines,
)
from .output import print_view as _print
from .results import compare, gate, show

app = typer.Typer(
    name="fidpipe",
    help="How faithful is this simulated LiDAR, and where does it fail?\n\n"
    "fidpipe compares real and simulated scans object by object: what is missing, what is invented, and how far the "
    "geometry (CDC) and the structure (r_lambda, r_gap) of each common object have drifted.\n\n"
    "Example: fidpipe run dataset/   (dataset/real/*.bin and dataset/sim/*.bin of the same names)",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def main() -> None:
    """Runs the command; the one place where known errors become exit codes."""
    from ...schemas.errors import FidpipeError
    from ..engine import prefork

    # A batch system that ends a job means what Ctrl-C means.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        code = app(standalone_mode=False)
    except FidpipeError as error:
        _complain(f"error: {error}")
        code = EXIT_WRONG_INPUT
    except (KeyboardInterrupt, typer.Abort):
        code = EXIT_INTERRUPTED
    except Exception as error:
        show = getattr(error, "show", None)  # wrong usage, as click and typer raise it
        if show is None:
            raise
        show()
        code = getattr(error, "exit_code", 2)
    if code == EXIT_INTERRUPTED:  # typer turns Ctrl-C into this code
        _complain("interrupted; run the same command again to go on")
    sys.stdout.flush()
    prefork.stop()
    sys.exit(code)


def _complain(text: str) -> None:
    from rich.console import Console

    Console(stderr=True, soft_wrap=True, highlight=False).print(text, markup=False, style="red")


def _version(wanted: bool) -> None:
    if wanted:
        from ... import __version__

        print(f"fidpipe {__version__}")
        raise typer.Exit


@app.callback()
def _root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    pass


@app.command()
def check(
    dataset: DatasetFolder,
    settings: SettingsFile = None,
    assignments: Assignments = None,
) -> None:
    """Show what would be read from a dataset, and what is wrong with it; computes nothing.

    Exits with 1 if anything is wrong.

    Example:  fidpipe check dataset/ --set input.min_range_m=3
    """
    from ...schemas.settings import load
    from ..datasets.scan_checks import check_dataset
    from ..report.terminal.run import check_view

    found = check_dataset(dataset, load(settings, assignments or []))
    _print(check_view(found))
    raise typer.Exit(EXIT_WRONG_INPUT if found.faults else 0)


@app.command()
def run(
    dataset: DatasetFolder,
    out: Annotated[
        Path | None, typer.Option("--out", help="Folder of the run.", show_default="runs/NAME_OF_DATASET")
    ] = None,
    settings: SettingsFile = None,
    assignments: Assignments = None,
    workers: Workers = None,
    scheduler: Scheduler = None,
    from_stage: Annotated[
        str | None, typer.Option("--from", metavar="STAGE", help="Make this stage and those after it again.")
    ] = None,
    pairs: Annotated[
        str | None,
        typer.Option("--pairs", metavar="PATTERN", help="Work only on pairs whose name matches, such as '0000*'."),
    ] = None,
    seeds: Annotated[
        int | None,
        typer.Option(
            "--seeds", min=1, help="Repeat communities to metrics with this many seeds; tells how stable scores are."
        ),
    ] = None,
) -> None:
    """Evaluate a dataset, stage by stage; run again, it goes on where it stopped.

    What is there already and still right is not computed again. Exits with 0 if all pairs are scored, 3 if some failed.

    Examples
    --------
    fidpipe run dataset/                         results go to runs/dataset

    fidpipe run dataset/ --set matching.delta_m=3    only matching and what follows is made again

    fidpipe run dataset/ --from metrics --pairs '0001*' --workers 8

    fidpipe run dataset/ --set metrics.baselines=chamfer,emd    the distances of others as well; "all" for all
    """
    from ...schemas.settings import load
    from ..engine import prefork
    from ..engine.cluster import cpu_count

    check_machines(workers, scheduler)
    repeats = [] if seeds is None else [f"stability.seeds={seeds}"]
    in_force = load(settings, [*(assignments or []), *repeats])
    out = out or Path("runs") / (dataset.resolve().name or "dataset")
    if scheduler is None and (workers or cpu_count()) > 1 and dataset.is_dir() and not out.exists():
        prefork.start(needed=False)  # a new run: workers will be wanted when all else is imported

    from ..engine.progress import Reporter
    from ..engine.request import RunRequest
    from ..report.terminal.run import outcome_view
    from ..run import run_dataset, stages_of

    stage_names = [stage.name for stage in stages_of(in_force)]
    if from_stage is not None and from_stage not in stage_names:
        raise typer.BadParameter(
            f"{from_stage!r} is no stage; one of {', '.join(stage_names)} is wanted", param_hint="--from"
        )
    request = RunRequest(
        dataset=dataset,
        out=out,
        settings=in_force,
        workers=workers,
        scheduler=scheduler,
        from_stage=from_stage,
        pattern=pairs,
    )
    outcome = run_dataset(request, Reporter())
    _print(outcome_view(outcome))
    raise typer.Exit(EXIT_PAIRS_FAILED if outcome.failures else 0)


@app.command()
def synth(
    out: Annotated[
        Path, typer.Argument(help="Folder of the dataset; new, empty, or made by synth.", show_default=False)
    ],
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="How many streets; each gives one pair.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another seed gives other streets.")] = 0,
    sensor: Annotated[str, typer.Option("--sensor", help="Model of the sensor: vlp32c or hdl64.")] = "vlp32c",
    points: Annotated[
        int | None,
        typer.Option(
            "--points", min=100, help="About this many points per real scan.", show_default="as the sensor has them"
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Processes on this machine; they change nothing but the time.")
    ] = 1,
) -> None:
    """Make a dataset: scans of ray-cast streets, and of a flawed digital twin of each.

    The same seed gives the same bytes. Interrupted, it goes on where it stopped; asked for more pairs, it adds them.

    For example:

    fidpipe synth streets/                        50 pairs as a Velodyne VLP-32C sees them

    fidpipe synth small/ --pairs 10000 --points 2000 --workers 8

    fidpipe synth dense/ --pairs 1 --sensor hdl64 --points 120000
    """
    from ...stages.sensing.ray_casting import SENSORS
    from ..engine.progress import Reporter
    from ..experiments.synth.synth import SynthRequest, make_dataset

    if sensor not in SENSORS:
        raise typer.BadParameter(
            f"{sensor!r} is no sensor; one of {', '.join(SENSORS)} is wanted", param_hint="--sensor"
        )
    make_dataset(SynthRequest(out, pairs, seed, sensor, points, workers), Reporter().say)
    print(f"{pairs} pairs in {out}; evaluate them with: fidpipe run {out}")


@app.command()
def report(
    run: Annotated[Path, typer.Argument(help="Folder of a run, such as runs/dataset.", show_default=False)],
    pairs: Annotated[
        str | None,
        typer.Option("--pairs", metavar="PATTERN", help="Show pairs whose name matches in 3D, such as '0000*'."),
    ] = None,
    folder: Annotated[bool, typer.Option("--folder", help="One page per pair and an index, in RUN/report.")] = False,
) -> None:
    """Make a page that shows a finished run, and the paper's figures; the page opens from disk and loads nothing.

    RUN/report.html: verdict, scores, missing and invented objects, tables, the points of some pairs in 3D (the worst,
    the middle and the best ones, or those of --pairs). RUN/figures: each figure as PNG and SVG.

    Examples
    --------
    fidpipe report runs/dataset

    fidpipe report runs/dataset --pairs '0007'

    fidpipe report runs/dataset --folder
    """
    from ..report.page.page import write_report

    made = write_report(run, pairs, one_page_a_pair=folder)
    pages = f" and {made.n_pages - 1} more" if made.n_pages > 1 else ""
    print(f"page:    {made.page}{pages} ({made.n_views} of {made.n_pairs} pairs in 3D)")
    print(f"figures: {made.figures[0].parent} ({', '.join(path.stem for path in made.figures[::2])}; PNG and SVG)")


@app.command()
def status(
    run: Annotated[Path, typer.Argument(help="Folder of a run, such as runs/dataset.", show_default=False)],
) -> None:
    """Show how far a run is: for each stage, how many pairs are done, stale, failed or to do.

    Example:  fidpipe status runs/dataset
    """
    from ..report.terminal.run import status_view
    from ..results.status import run_status

    _print(status_view(run_status(run)))


app.command()(perturb)
app.command()(ablate)
app.command()(show)
app.command()(gate)
app.command()(compare)
