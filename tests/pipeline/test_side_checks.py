"""Messages of check on a whole side: datasets of a sensor that drives through a street, with one error each."""

import csv
import json
import re

import numpy as np
import pandas as pd
import pytest

from fidpipe.pipeline.inspect import scan_checks, side_checks
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.schemas.settings import load
from fidpipe.stages.sensor_description import describe_sensor
from runs import command
from scenes import box, road

NONE_NEARER = "input.min_range_m=0"


@pytest.fixture(autouse=True)
def without_beams(monkeypatch):
    """Random points have no beams, and to look for these takes longer than all other checks."""
    monkeypatch.setattr(scan_checks, "MOST_PAIRS", 0)
    monkeypatch.setattr(
        side_checks, "describe_sensor", lambda points, *own: describe_sensor(points[:9], *own)
    )


def scan(i, seed=0, noise_m=0.02):
    """The scan after i metres of the street."""
    rng = np.random.default_rng(seed)
    boxes = [
        box([x - i, 8 * (-1) ** n, -0.5], [1 + n % 3, 2, 2.4], 250, n)
        for n, x in enumerate(range(-40, 60, 3))
    ]
    points = np.vstack([*boxes, road(4000, seed=seed)])
    return points + rng.normal(0, noise_m, points.shape)


def write(folder, real, sim, turn=((1, 0, 0), (0, 1, 0), (0, 0, 1))):
    """A dataset of scans, or tables of points with times, in the order of time; names run against it."""
    rows = []
    for i, scans in enumerate(zip(real, sim, strict=True)):
        row = {"pair_id": f"p{50 - i}", "timestamp_s": 1.5 + 0.1 * i}
        for side, points in zip(("real", "sim"), scans, strict=True):
            row[side] = f"{side}{i}.npy"
            is_table = isinstance(points, pd.DataFrame)
            table = (
                points
                if is_table
                else pd.DataFrame(points @ np.array(turn), columns=list("xyz"))
            )
            np.save(folder / row[side], table.to_records(index=False))
        rows.append(row)
    with (folder / "pairs.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return folder


def warnings(folder, *words):
    return check_dataset(folder, load(None, list(words))).warnings


def drive(start=0, n=6, seed=0, **options):
    return [scan(start + i, seed + i, **options) for i in range(n)]


def test_two_healthy_sides_raise_no_warning(tmp_path):
    found = check_dataset(write(tmp_path, drive(), drive(seed=20)), load(None, [NONE_NEARER]))
    assert (found.warnings, found.faults, found.notes) == ([], [], [])


def test_a_late_side_is_named_with_frames(tmp_path):
    texts = warnings(write(tmp_path, drive(2), drive(0, seed=20)))
    (warning,) = [text for text in texts if "frames late" in text]
    assert warning.startswith("simulated scans seem 2 frames late: ") and "--offset" in warning


def test_a_side_that_is_one_scan_is_named(tmp_path):
    still = [scan(3, seed, 0.03) for seed in range(6)]
    texts = warnings(write(tmp_path, drive(), still))
    (warning,) = [text for text in texts if not text.startswith("pair ")]
    assert warning.startswith("all simulated scans ")


def test_an_empty_side_is_named_beside_the_faults_of_its_scans(tmp_path):
    check = check_dataset(write(tmp_path, drive(), [np.zeros((100, 3))] * 6), load())
    assert len(check.faults) == 6
    assert any("nearly empty" in text for text in check.warnings)
    sparse = [points[::40] for points in drive(seed=20)]
    assert any("nearly empty" in text for text in warnings(write(tmp_path, drive(), sparse)))


@pytest.mark.parametrize(
    ("frame", "turn"),
    [
        ("ros", ((1, 0, 0), (0, 1, 0), (0, 0, 1))),
        ("nuscenes", ((0, 1, 0), (-1, 0, 0), (0, 0, 1))),
    ],
)
def test_ego_hits_are_named_with_settings_that_drop_them(tmp_path, frame, turn):
    bonnet = box([3.2, 0, -0.9], [1, 1.6, 0.3], 600)
    own = [np.vstack([points, bonnet]) for points in drive()]
    folder = write(tmp_path, own, own, turn=turn)
    words = [f"input.{side}_frame={frame}" for side in ("real", "sim")]
    real, sim = [text for text in warnings(folder, *words) if "ego vehicle" in text]
    assert real.startswith("real scans: 3.9%") and sim.startswith("simulated scans: 3.9%")
    for setting in re.findall(r"input\.(?:exclude_box|min_range_m)=\S+", real):
        assert not [text for text in warnings(folder, *words, setting) if "ego vehicle" in text]


def timed(i, way=-1, seed=0):
    """A table of points that are measured one after the other as the sensor turns."""
    points = scan(i, seed)
    order = np.argsort(way * np.arctan2(points[:, 1], points[:, 0]))
    times = np.linspace(0, 0.1, len(points))
    return pd.DataFrame(points[order], columns=list("xyz")).assign(time=times)


def test_the_command_prints_notes_and_warnings_of_sides(tmp_path):
    folder = write(
        tmp_path, [timed(i) for i in range(3)], [timed(i, way=1, seed=9) for i in range(3)]
    )
    assert "real scans: 0.1 s from first to last point" in command("check", folder).stdout
    told = json.loads(command("check", folder, "--json").stdout)
    assert len(told["notes"]) == 2
    assert told["warnings"] == []


def test_the_times_of_a_recorded_scan_are_those_of_a_revolution(
    real_data, tmp_path, monkeypatch
):
    monkeypatch.undo()
    bag = real_data / "velodyne_vlp32c/rosbag1.bag"
    (tmp_path / "pairs.csv").write_text(
        f"pair_id,real,sim\na,{bag}#0,{bag}#1\nb,{bag}#1,{bag}#2\n"
    )
    check = check_dataset(tmp_path, load())
    ends = "s from first to last point"
    assert check.notes == [f"real scans: 0.101 {ends}", f"simulated scans: 0.1 {ends}"]
