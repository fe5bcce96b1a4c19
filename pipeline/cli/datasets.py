"""The commands that make datasets: synth, twin and pair."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import EXIT_PAIRS_FAILED, Assignments, Count, LocalWorkers, Pairs, Replace, Seed
from .output import print_line

if TYPE_CHECKING:
    from ...schemas.sensor_models import SensorModel


def synth(
    out: Path,
    pairs: Count = 50,
    seed: Seed = 0,
    sensor: str = "vlp32c",
    points: Annotated[int | None, typer.Option(min=100)] = None,
    workers: LocalWorkers = 1,
    replace: Replace = False,
) -> None:
    """Make a dataset: scans of ray-cast streets, and of a flawed digital twin of each.

    The same seed produces the same bytes. Run again to resume after an interruption, or with a
    larger --pairs to add pairs. Finished pairs of another seed, sensor or number of points are
    replaced only with --replace.

    Parameters
    ----------
    out : Folder of the dataset; new, empty, or made by synth.
    pairs : Number of streets, and so of pairs.
    seed : Seed of the streets.
    sensor : Model of the sensor: vlp32c, hdl64, os1-64, carla or another of docs/sensors.md.
    points : Approximate number of points per real scan, else that of the sensor.

    For example:

    fidpipe synth streets/                        50 pairs as a Velodyne VLP-32C sees them

    fidpipe synth small/ --pairs 10000 --points 2000 --workers 8

    fidpipe synth dense/ --pairs 1 --sensor hdl64 --points 120000
    """
    from ...schemas.sensor_models import SENSORS
    from ..engine.progress import Reporter
    from ..generate.synth import make_dataset

    _known_sensor(sensor, SENSORS)
    make_dataset(
        out,
        Reporter(),
        n_pairs=pairs,
        seed=seed,
        sensor=sensor,
        n_points=points,
        workers=workers,
        replace=replace,
    )
    _print_made(pairs, out)


def twin(
    sequence: Path,
    out: Path,
    flaw: Annotated[list[str] | None, typer.Option(metavar="NAME=AMOUNT")] = None,
    sensor: str = "recorded",
    poses: Path | None = None,
    calib: Path | None = None,
    others: Annotated[int, typer.Option(min=2)] = 4,
    pairs: Pairs = None,
    seed: Seed = 0,
    assignments: Assignments = None,
    workers: LocalWorkers = 1,
    replace: Replace = False,
) -> None:
    """Make a dataset: posed real scans, and simulated scans in a model built from other scans.

    A simulator whose flaws are known: it casts rays onto surfels of the other frames and adds the
    flaws that --flaw names: foliage, holes, far-dropout, dropout, density, blur, noise, ghosts,
    yaw, offset, mirrored (amounts: docs/twin.md). twin.toml next to the scans is the recipe;
    the same recipe produces the same bytes. Run again to resume after an interruption.

    Parameters
    ----------
    sequence : Folder of a recording: scans and the poses of the sensor.
    out : Folder of the dataset; new, empty, or made by twin.
    flaw : Known flaw of all twins; repeatable.
    sensor : recorded (beams as in the recording), vlp32c, hdl64, os1-64, carla and others.
    poses : TUM or KITTI poses, else pairs.csv, poses.tum or poses.txt.
    calib : KITTI's calibration with Tr, else calib.txt.
    others : Number of nearest other frames in each model.
    pairs : Only frames whose name matches, such as '*[02468]'.
    seed : Seed of the random numbers.

    For example:

    fidpipe twin drive/ twins/            poses are in drive/poses.tum

    fidpipe twin drive/ bad/ --flaw dropout=0.3 --flaw holes=12 --flaw mirrored

    fidpipe twin sequences/00 twins/ --sensor hdl64 --pairs '*0' --workers 8
    """
    from ...schemas.sensor_models import SENSORS
    from ...schemas.settings import load
    from ...stages.generate.flaws import parse_flaws
    from ...stages.generate.rescan import RECORDED
    from ..engine.progress import Reporter
    from ..generate.recordings import read_recording
    from ..generate.twin import TwinRecipe, make_twins

    recipe = TwinRecipe(
        sensor=_known_sensor(sensor, {RECORDED.name: RECORDED, **SENSORS}),
        flaws=parse_flaws(flaw or []),
        n_others=others,
        seed=seed,
        settings=load(None, assignments or []).input,
    )
    recording = read_recording(sequence, poses, calib)
    n_pairs, failures = make_twins(
        recording, out, Reporter(), recipe, pattern=pairs, workers=workers, replace=replace
    )
    _print_made(n_pairs, out)
    raise typer.Exit(EXIT_PAIRS_FAILED if failures else 0)


def _known_sensor(name: str, sensors: Mapping[str, SensorModel]) -> SensorModel:
    if name not in sensors:
        raise typer.BadParameter(
            f"expected one of {', '.join(sensors)}; got {name!r}", param_hint="--sensor"
        )
    return sensors[name]


def _print_made(n_pairs: int, out: Path) -> None:
    from ..report.view import count

    command = f"fidpipe run {shlex.quote(str(out))} --preset reference"
    print_line(f"{count(n_pairs, 'pair')} in {out}; evaluate with: {command}")


def pair(
    real: Path,
    sim: Path,
    out: Annotated[Path, typer.Option("--out", "-o")],
    tolerance: Annotated[float, typer.Option(min=1e-6)] = 0.05,
    offset: float | None = None,
    every: Count = 1,
    start: Annotated[float, typer.Option("--from")] = 0.0,
    stop: Annotated[float | None, typer.Option("--to")] = None,
    replace: bool = False,
) -> None:
    """Make a dataset from simultaneous frames of two recordings; nothing is copied.

    Its pairs.csv points into the recordings.

    Parameters
    ----------
    real : Bag, capture or folder of scans; a topic as drive.mcap#/points.
    sim : Bag, capture or folder of scans of the simulator.
    out : Folder of the dataset.
    tolerance : Largest time between the two frames of a pair, seconds.
    offset : Seconds added to simulated times, else those that pair most frames.
    every : Only every Nth pair.
    start : Only pairs from here on, seconds after the first.
    stop : Only pairs up to here, seconds after the first.
    replace : Replace an existing manifest.

    For example:

    fidpipe pair drive.bag carla.mcap -o dataset/ && fidpipe run dataset/

    fidpipe pair drive.bag#/top/points carla/ -o dataset/ --offset 12.3 --every 10
    """
    from ..datasets.pairing import pair_times, read_timeline, write_dataset

    lines = read_timeline(real), read_timeline(sim)
    pairing = pair_times(lines[0].times_s, lines[1].times_s, tolerance, offset)
    since_s = lines[0].times_s[pairing.real_ids] - lines[0].times_s[0]
    last = float("inf") if stop is None else stop
    kept = ((since_s >= start) & (since_s <= last)).nonzero()[0][::every]
    print_line(write_dataset(out, *lines, pairing, kept, replace=replace))
