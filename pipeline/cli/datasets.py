"""The commands that make datasets: synth and twin."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .options import EXIT_PAIRS_FAILED, Assignments, Replace


def synth(
    out: Annotated[
        Path, typer.Argument(help="Folder of the dataset; new, empty, or made by synth.", show_default=False)
    ],
    pairs: Annotated[int, typer.Option("--pairs", min=1, help="How many streets; each gives one pair.")] = 50,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another seed gives other streets.")] = 0,
    sensor: Annotated[
        str,
        typer.Option(
            "--sensor", help="Model of the sensor: vlp32c, hdl64, os1-64, carla or another of docs/sensors.md."
        ),
    ] = "vlp32c",
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
    from ...stages.sensing.sensor_models import SENSORS
    from ..engine.progress import Reporter
    from ..experiments.synth import SynthRequest, make_dataset

    if sensor not in SENSORS:
        raise typer.BadParameter(
            f"{sensor!r} is no sensor; one of {', '.join(SENSORS)} is wanted", param_hint="--sensor"
        )
    make_dataset(SynthRequest(out, pairs, seed, sensor, points, workers, replace), Reporter())
    print(f"{pairs} pairs in {out}; evaluate them with: fidpipe run {out}")


def twin(
    sequence: Annotated[
        Path, typer.Argument(help="Folder of a recording: scans and the poses of the sensor.", show_default=False)
    ],
    out: Annotated[
        Path, typer.Argument(help="Folder of the dataset; new, empty, or made by twin.", show_default=False)
    ],
    flaw: Annotated[
        list[str] | None,
        typer.Option("--flaw", metavar="NAME=AMOUNT[:METRES]", help="A known flaw of all twins; repeatable."),
    ] = None,
    sensor: Annotated[
        str,
        typer.Option(
            "--sensor",
            help="recorded (beams as the recording shows them), vlp32c, hdl64, os1-64, carla, or a table of elevations "
            "(.csv, .toml).",
        ),
    ] = "recorded",
    range_noise: Annotated[
        float | None,
        typer.Option("--range-noise", min=0, max=10, help="Std along the ray, metres.", show_default="the sensor's"),
    ] = None,
    dropout: Annotated[
        float | None,
        typer.Option("--dropout", min=0, max=1, help="Share of the pulses lost.", show_default="the sensor's"),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option("--poses", help="TUM or KITTI poses.", show_default="pairs.csv, poses.tum or poses.txt"),
    ] = None,
    calib: Annotated[
        Path | None, typer.Option("--calib", help="KITTI's calibration, with Tr.", show_default="calib.txt")
    ] = None,
    others: Annotated[
        int, typer.Option("--others", min=2, help="Of so many other frames, the nearest, each model is made.")
    ] = 4,
    foliage: Annotated[
        str | None,
        typer.Option(
            "--foliage",
            metavar="LABEL[,LABEL]",
            help="What is foliage, for its flaw.",
            show_default="what is scattered",
        ),
    ] = None,
    pairs: Annotated[
        str | None, typer.Option("--pairs", metavar="PATTERN", help="Scan again only frames that match, as '*[02468]'.")
    ] = None,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Another seed draws other random numbers.")] = 0,
    assignments: Assignments = None,
    workers: Annotated[
        int, typer.Option("--workers", min=1, help="Processes on this machine; they change nothing but the time.")
    ] = 1,
    replace: Replace = False,
) -> None:
    """Make a dataset: posed real scans, and each place scanned again in a model of the other scans.

    A simulator whose flaws are known: surfels of the other frames, ray casting, and
    what --flaw names: foliage, holes, far-dropout, dropout, density, beams, blur,
    noise, ghosts, yaw, offset, mirrored (amounts: docs/twin.md). twin.toml beside
    the scans is the recipe; the same recipe gives the same bytes. Interrupted, it
    goes on where it stopped.

    For example:

    fidpipe twin drive/ twins/            poses are in drive/poses.tum

    fidpipe twin drive/ bad/ --flaw dropout=0.3 --flaw holes=12:1.5 --flaw mirrored

    fidpipe twin sequences/00 twins/ --sensor hdl64 --pairs '*0' --workers 8
    """
    from dataclasses import replace as with_values

    from ...schemas.settings import load
    from ...stages.sensing.flaws import parse_flaws
    from ..datasets.sensors import read_sensor
    from ..datasets.sequences import read_recording
    from ..engine.progress import Reporter
    from ..experiments.twin import TwinRequest, make_twins

    model = read_sensor(sensor)
    request = TwinRequest(
        out=out,
        flaws=parse_flaws(flaw or []),
        sensor=with_values(
            model,
            range_noise_m=model.range_noise_m if range_noise is None else range_noise,
            lost_share=model.lost_share if dropout is None else dropout,
        ),
        recording=read_recording(sequence, poses, calib),
        n_others=others,
        foliage=tuple(foliage.split(",")) if foliage else (),
        pattern=pairs,
        seed=seed,
        settings=load(None, assignments or []).input,
        workers=workers,
        replace=replace,
    )
    outcome = make_twins(request, Reporter())
    print(f"{outcome.n_pairs} pairs in {out}; evaluate them with: fidpipe run {out}")
    raise typer.Exit(EXIT_PAIRS_FAILED if outcome.failures else 0)
