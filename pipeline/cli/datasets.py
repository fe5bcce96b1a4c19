"""The commands that make datasets: synth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import Replace


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
            "--points", min=100, help="About so many points per real scan.", show_default="as the sensor has them"
        ),
    ] = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Processes on this machine; they change nothing but the time.")
    ] = 1,
    replace: Replace = False,
) -> None:
    """Make a dataset: scans of ray-cast streets, and of a flawed digital twin of each.

    The same seed gives the same bytes. Interrupted, it goes on where it stopped; asked for more pairs, it adds them.
    Finished pairs of another seed, sensor or number of points are replaced only with --replace.

    For example:

    fidpipe synth streets/                        50 pairs as a Velodyne VLP-32C sees them

    fidpipe synth small/ --pairs 10000 --points 2000 --workers 8

    fidpipe synth dense/ --pairs 1 --sensor hdl64 --points 120000
    """
    from ...stages.sensing.ray_casting import SENSORS
    from ..engine.progress import Reporter
    from ..experiments.synth import SynthRequest, make_dataset

    if sensor not in SENSORS:
        raise typer.BadParameter(
            f"{sensor!r} is no sensor; one of {', '.join(SENSORS)} is wanted", param_hint="--sensor"
        )
    make_dataset(SynthRequest(out, pairs, seed, sensor, points, workers, replace), Reporter())
    print(f"{pairs} pairs in {out}; evaluate them with: fidpipe run {out}")
