"""`fidpipe twin`: twins of posed scans, made of the other scans alone, the same however they are made."""

import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.generate import twin
from fidpipe.pipeline.generate.recordings import read_recording
from fidpipe.schemas.errors import DatasetError, FidpipeError
from fidpipe.schemas.sensor_models import SENSORS, SensorModel
from fidpipe.schemas.settings import InputSettings
from fidpipe.stages.clean import clean_scan
from fidpipe.stages.generate.flaws import FLAWS, parse_flaws
from fidpipe.stages.generate.rescan import RECORDED
from runs import QUIET, command, files_in
from scenes import box, moved, rigid, write_bin

DOCUMENTATION = Path(__file__).resolve().parents[2] / "docs" / "twin.md"
N = 4
NAMES = [f"{i:03}" for i in range(N)]
SMALL = SensorModel(
    "small",
    tuple(np.linspace(-25, 12, 30)),
    (0.0,) * 30,
    1.5,
    0.5,
    100.0,
    0.02,
    0.0,
    0.03,
    60.0,
)
ALONE = np.array([5.0, -4.0, -0.5])  # where a box stands in frame 2 and in no other


def surface(seed, n=5000):
    """A road, a wall and a box about a short drive; other points of them with each seed. The box is the last sixth."""
    rng = np.random.default_rng(seed)
    road = np.column_stack([rng.uniform(-7, 7, (n // 2, 2)), np.full(n // 2, -1.7)])
    wall = np.column_stack(
        [rng.uniform(-7, 7, n // 3), np.full(n // 3, 6.0), rng.uniform(-1.7, 1.3, n // 3)]
    )
    return np.vstack([road, wall, box([-5, -4, -0.7], [1.5, 2, 2], n // 6, seed)])


def world_from_sensor(i):
    return rigid(4.0 * i, [0.3 * i, 0.05 * i, 0.01 * i])


def to_sensor(points, T):
    return (points - T[:, 3]) @ T[:, :3]


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """The folder of a recording of four scans, in a manifest."""
    folder = tmp_path_factory.mktemp("drive")
    rows = []
    for i, name in enumerate(NAMES):
        T = world_from_sensor(i)
        points = surface(i)
        labels = np.where(np.arange(len(points)) < len(points) - len(points) // 6, 1, 2)
        if i == 2:
            points = np.vstack([points, box(ALONE, [1, 1, 1], 300)])
            labels = np.concatenate([labels, np.full(300, 1)])
        write_bin(folder / f"{name}.bin", to_sensor(points, T))
        labels.astype("<u4").tofile(folder / f"{name}.label")
        rows.append(f"{name},{name}.bin,{0.1 * i},{' '.join(map(repr, T.ravel().tolist()))}")
    (folder / "labels.toml").write_text('1 = "built"\n2 = "hedge"\n')
    (folder / "pairs.csv").write_text(
        "pair_id,real,timestamp_s,T_world_sensor\n" + "\n".join(rows) + "\n"
    )
    return folder


def make(out, drive, *flaws, **options):
    """Make twins of the drive, with flaws as text."""
    request = {
        "pattern": options.pop("pattern", None),
        "replace": options.pop("replace", False),
    }
    request["workers"] = options.pop("workers", 1)
    recipe = twin.TwinRecipe(**{"sensor": SMALL, "flaws": parse_flaws(flaws), **options})
    return twin.make_twins(read_recording(drive), out, QUIET, recipe, **request)


@pytest.fixture(scope="module")
def twins(drive, tmp_path_factory):
    out = tmp_path_factory.mktemp("twins") / "plain"
    assert make(out, drive) == (N, {})
    return out


def sim(folder, name, side="sim"):
    return read_scan(folder / side / f"{name}.bin").points


def real(folder, name):
    return sim(folder, name, "real")


def near(points, place, within_m=1.0):
    return int((np.linalg.norm(points - place, axis=1) < within_m).sum())


def test_a_twin_lies_on_the_surface_that_the_scan_shows(twins):
    for name in NAMES:
        ours = real(twins, name)
        theirs = sim(twins, name)
        ours = ours[np.linalg.norm(ours, axis=1) > 2.5]
        assert len(theirs) > 3000
        apart, _ = cKDTree(ours).query(theirs)
        assert np.median(apart) < 0.12  # the points of either lie about 0.2 m apart
        built = theirs[np.abs(to_world(theirs, name)[:, 1] - 6.0) < 0.2]
        assert np.abs(to_world(built, name)[:, 1] - 6.0).mean() < 0.03  # noise of 2 cm


def to_world(points, name):
    return moved(points, world_from_sensor(int(name)))


def test_what_stands_in_one_scan_alone_is_in_every_twin_but_its_own(twins):
    seen = {name: near(to_world(sim(twins, name), name), ALONE) for name in NAMES}
    assert near(to_world(real(twins, "002"), "002"), ALONE) == 300
    assert seen["002"] == 0
    assert seen["001"] > 10
    assert seen["003"] > 10


def test_the_dataset_names_times_poses_labels_and_the_recipe(twins, drive):
    dataset = read_dataset(twins)
    assert [pair.pair_id for pair in dataset.pairs] == NAMES
    assert [pair.timestamp_s for pair in dataset.pairs] == pytest.approx([0.0, 0.1, 0.2, 0.3])
    for pair, frame in zip(dataset.pairs, read_recording(drive).pairs, strict=True):
        assert pair.T_world_sensor == frame.T_world_sensor
        assert pair.real.file.read_bytes() == frame.real.file.read_bytes()
        assert set(read_scan(pair.real, label_names=dataset.label_names).labels) == {
            "built",
            "hedge",
        }
    recipe = tomllib.loads((twins / "twin.toml").read_text())
    assert (recipe["seed"], recipe["flaw"], recipe["sensor"]["name"]) == (0, [], "small")
    assert {"numpy", "scipy", "trimesh", "embreex"} <= recipe["libraries"].keys()
    assert len(read_recording(twins).pairs) == N  # and it is a recording itself


def test_the_same_recipe_gives_the_same_bytes_and_another_seed_gives_others(
    twins, drive, tmp_path
):
    make(tmp_path / "again", drive)
    assert files_in(tmp_path / "again") == files_in(twins)
    make(tmp_path / "other", drive, seed=1)
    assert all(
        (sim(twins, name)[:50] != sim(tmp_path / "other", name)[:50]).all() for name in NAMES
    )


@pytest.mark.exhaustive
def test_two_processes_make_the_same_twins(twins, drive, tmp_path):
    make(tmp_path / "two", drive, workers=2)
    assert files_in(tmp_path / "two") == files_in(twins)


def test_where_the_world_begins_does_not_matter(twins, drive, tmp_path):
    elsewhere = shutil.copytree(drive, tmp_path / "drive")
    T = np.vstack([rigid(70.0, [400.0, -90.0, 12.0]), [0, 0, 0, 1]])
    lines = (drive / "pairs.csv").read_text().splitlines()
    for i in range(N):
        moved_pose = (T @ np.vstack([world_from_sensor(i), [0, 0, 0, 1]]))[:3]
        lines[i + 1] = ",".join(
            [*lines[i + 1].split(",")[:3], " ".join(map(repr, moved_pose.ravel().tolist()))]
        )
    (elsewhere / "pairs.csv").write_text("\n".join(lines) + "\n")
    assert make(tmp_path / "out", elsewhere, pattern="*1") == (1, {})
    ours, theirs = sim(twins, "001"), sim(tmp_path / "out", "001")
    assert len(ours) == len(theirs)
    assert (
        np.abs(ours - theirs).max(axis=1) < 1e-3
    ).mean() > 0.999  # a point on the border of two voxels may change


def test_what_was_interrupted_goes_on_with_the_twins_that_are_missing(
    twins, drive, tmp_path, monkeypatch
):
    out = shutil.copytree(twins, tmp_path / "out")
    (out / "sim" / "001.bin").unlink()
    (out / "pairs.csv").unlink()
    made = []
    rescan = twin._rescan
    monkeypatch.setattr(
        twin, "_rescan", lambda task: made.append(task.frame.pair_id) or rescan(task)
    )
    make(out, drive)
    assert made == ["001"]
    assert files_in(out) == files_in(twins)


def test_a_broken_scan_fails_alone(drive, tmp_path):
    broken = shutil.copytree(drive, tmp_path / "drive")
    (broken / "000.bin").write_bytes(b"no scan")
    done = command("twin", broken, tmp_path / "out", "--workers", 1, code=3)
    assert "000.bin" in done.stderr
    assert [pair.pair_id for pair in read_dataset(tmp_path / "out").pairs] == NAMES[1:]
    for index in (1, 2):
        (broken / f"{NAMES[index]}.bin").write_bytes(b"no scan")
    _, reasons = make(tmp_path / "out2", broken)
    assert any(
        "expected at least 2 readable other scans for a model, got 0" in reason
        for reason in reasons.values()
    )


def test_flaws_are_those_of_the_functions_and_alike_in_all_frames_where_they_are_systematic(
    twins, drive, tmp_path
):
    make(tmp_path / "mirrored", drive, "mirrored")
    make(tmp_path / "offset", drive, "offset=0.5")
    shifts = []
    for name in NAMES:
        plain = sim(twins, name)
        np.testing.assert_allclose(
            sim(tmp_path / "mirrored", name), plain * [1, -1, 1], atol=1e-6
        )
        shift = sim(tmp_path / "offset", name) - plain
        assert np.ptp(shift, axis=0).max() < 1e-5
        shifts.append(shift[0])
    np.testing.assert_allclose(shifts, np.broadcast_to(shifts[0], (N, 3)), atol=1e-5)
    assert np.linalg.norm(shifts[0]) == pytest.approx(0.5, abs=1e-5)


def test_several_flaws_are_applied_in_the_order_of_their_list(twins, drive, tmp_path):
    make(tmp_path / "a", drive, "yaw=90", "dropout=0.5")
    make(tmp_path / "b", drive, "dropout=0.5", "yaw=90")
    assert files_in(tmp_path / "a") == files_in(tmp_path / "b")
    for name in NAMES:
        plain, bad = sim(twins, name), sim(tmp_path / "a", name)
        assert len(bad) == pytest.approx(0.5 * len(plain), rel=0.1)
        back = bad[:, [1, 0, 2]] * [1, -1, 1]
        assert cKDTree(plain).query(back)[0].max() < 1e-5
    flaws = tomllib.loads((tmp_path / "a/twin.toml").read_text())["flaw"]
    assert [flaw["name"] for flaw in flaws] == ["dropout", "yaw"]


def test_the_recording_itself_is_left_alone(drive, tmp_path):
    with pytest.raises(FidpipeError, match="holds other things"):
        make(drive, drive)
    with pytest.raises(FidpipeError, match='input.real_frame: .*"nuscenes"'):
        make(tmp_path / "turned", drive, settings=InputSettings(real_frame="nuscenes"))
    with pytest.raises(DatasetError, match="none of the 4 pairs"):
        make(tmp_path / "out", drive, pattern="x*")


def test_how_scans_are_read_is_a_setting(drive, twins, tmp_path):
    make(tmp_path / "near", drive, settings=InputSettings(max_range_m=5.0))
    assert np.linalg.norm(sim(tmp_path / "near", "001"), axis=1).max() < 6.0
    assert np.linalg.norm(sim(twins, "001"), axis=1).max() > 7


def test_the_beams_of_the_recording_are_the_usual_ones(drive, tmp_path):
    make(tmp_path / "out", drive, sensor=RECORDED, pattern="*1")
    scan = real(tmp_path / "out", "001")
    scan = scan[np.linalg.norm(scan, axis=1) > 2.5]
    twin = sim(tmp_path / "out", "001")
    seen = twin / np.linalg.norm(twin, axis=1)[:, None]
    ours = scan / np.linalg.norm(scan, axis=1)[:, None]
    assert (cKDTree(seen).query(ours)[0] < 1e-6).mean() > 0.8


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["drop-out=0.3"], "'drop-out'.*did you mean dropout"),
        (["xyz=1"], "the nearest are .*foliage"),
        (["dropout=1.5"], "flaw dropout: .*got '1.5'"),
        (["dropout"], "flaw dropout: expected a number"),
        (["holes=3:1"], "flaw holes: .*got '3:1'"),
        (["holes=2.5"], "a whole number from 0 to 10000"),
        (["mirrored=0.5"], "a whole number from 0 to 1"),
        (["yaw=1", "yaw=2"], "flaw yaw"),
        (["dropout=nan"], "flaw dropout: .*got 'nan'"),
    ],
)
def test_flaws_that_make_no_sense_are_refused(words, reason):
    with pytest.raises(FidpipeError, match=reason):
        parse_flaws(words)


def test_the_command_says_what_to_do_next_and_its_help_names_every_flaw(drive, tmp_path):
    words = ("--pairs", "*1", "--flaw", "far-dropout=0.5", "--workers", 1)
    done = command("twin", drive, tmp_path / "out", *words, "--sensor", "hdl64", code=0)
    assert f" in {tmp_path / 'out'}; " in done.stdout
    assert done.stdout.count("\n") == 1
    command("twin", drive, tmp_path / "other", *words, "--sensor", "hdl46", code=2)
    text = command("twin", "--help").stdout
    assert all(name in text for name in FLAWS)


def test_the_documentation_has_every_flaw_and_sensor():
    text = DOCUMENTATION.read_text()
    assert all(f"| `{name}` |" in text for name in FLAWS)
    assert all(f"`{name}`" in text for name in ("recorded", *SENSORS))


@pytest.mark.exhaustive
@pytest.mark.parametrize("sensor", ["recorded", "hdl64"])
def test_a_kitti_drive_scanned_again_covers_what_was_seen(sensor, real_data, tmp_path):
    command(
        "twin",
        real_data / "kitti_sequence",
        tmp_path / "out",
        "--pairs",
        "*[27]",
        "--sensor",
        sensor,
        code=0,
    )
    for pair in read_dataset(tmp_path / "out").pairs:
        ours = clean_scan(read_scan(pair.real).points, InputSettings()).points
        theirs = clean_scan(read_scan(pair.sim).points, InputSettings()).points
        shares = [
            (cKDTree(a).query(b)[0] <= 0.3).mean() for a, b in ((theirs, ours), (ours, theirs))
        ]
        assert min(shares) > 0.7
        assert len(theirs) == pytest.approx(len(ours), rel=0.25)
