import numpy as np
import pytest

from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.inspect.scan_checks import check_dataset
from fidpipe.schemas.errors import DatasetError
from fidpipe.schemas.settings import Settings, load
from scenes import street, write_bin


def folders(tmp_path, real=("a",), sim=("a",)):
    for side, names in (("real", real), ("sim", sim)):
        (tmp_path / side).mkdir(exist_ok=True)
        for name in names:
            write_bin(tmp_path / side / f"{name}.bin", street())
    return tmp_path


def manifest(tmp_path, rows, header="pair_id,real,sim,timestamp_s,T_real_sim"):
    folders(tmp_path)
    (tmp_path / "pairs.csv").write_text("\n".join([header, *rows]) + "\n")
    return tmp_path


def test_folders_are_paired_by_stem(tmp_path):
    dataset = read_dataset(folders(tmp_path, ("b", "a"), ("a", "b")))
    assert [(pair.pair_id, pair.real.name, pair.fault) for pair in dataset.pairs] == [
        ("a", "a.bin", None),
        ("b", "b.bin", None),
    ]


def test_a_missing_partner_is_a_fault_of_its_pair(tmp_path):
    dataset = read_dataset(folders(tmp_path, ("a", "b"), ("a", "c")))
    faults = {pair.pair_id: pair.fault for pair in dataset.pairs}
    assert faults["a"] is None
    assert "b.bin: no partner; expected a scan named b in" in faults["b"]
    assert "c.bin: no partner; expected a scan named c in" in faults["c"]


def test_two_files_of_one_stem_stop_everything(tmp_path):
    folders(tmp_path)
    write_bin(tmp_path / "sim" / "a.pcd.bin", street(), 5)
    with pytest.raises(DatasetError, match=r"a\.bin and a\.pcd\.bin have the same stem a"):
        read_dataset(tmp_path)


def test_unknown_files_are_ignored_with_a_warning_and_labels_without(tmp_path):
    folders(tmp_path)
    (tmp_path / "real" / "notes.txt").touch()
    (tmp_path / "real" / "a.label").touch()
    (tmp_path / "real" / ".hidden").touch()
    assert [text.rsplit("/", 1)[1] for text in read_dataset(tmp_path).warnings] == [
        "notes.txt: not a known scan format, ignored"
    ]


@pytest.mark.parametrize("made", [(), ("real",), ("real", "sim")])
def test_no_pairs_stop_everything(tmp_path, made):
    for side in made:
        (tmp_path / side).mkdir()
    with pytest.raises(DatasetError, match="no scan pairs found|no folder"):
        read_dataset(tmp_path)


def test_a_manifest_wins_over_folders(tmp_path):
    T = "1 0 0 0.5 0 1 0 0 0 0 1 0"
    dataset = read_dataset(manifest(tmp_path, [f"first,real/a.bin,sim/a.bin,12.5,{T}"]))
    (pair,) = dataset.pairs
    assert (pair.pair_id, pair.timestamp_s) == ("first", 12.5)
    assert pair.T_real_sim == (1, 0, 0, 0.5, 0, 1, 0, 0, 0, 0, 1, 0)


def test_a_manifest_file_that_is_not_there_is_a_fault_of_its_pair(tmp_path):
    dataset = read_dataset(manifest(tmp_path, ["p,real/a.bin,sim/b.bin,,", "q,,sim/a.bin,,"]))
    assert "sim/b.bin is not a file; expected the sim scan" in dataset.pairs[0].fault
    assert "line 3: no real scan is named" in dataset.pairs[1].fault


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        ("p,real/a.bin,sim/a.bin,soon,", "line 3: timestamp_s: expected a number, got 'soon'"),
        ("p,real/a.bin,sim/a.bin,,1 2 3", "line 3: T_real_sim: expected 12 numbers ([R | t] row by row), got 3"),
        ("p,real/a.bin,sim/a.bin,,2 0 0 0 0 1 0 0 0 0 1 0", "line 3: T_real_sim is not a rigid motion"),
        ("p,real/a.bin,sim/a.bin,,1e200 0 0 0 0 1e200 0 0 0 0 1 0", "line 3: T_real_sim is not a rigid motion"),
        (
            "p,real/a.bin,sim/a.bin,,1 0 0 1e300 0 1 0 0 0 0 1 0",
            "line 3: T_real_sim: expected a translation of at most 1e+09 m, got 1e+300 m",
        ),
        (
            "p,real/a.bin,sim/a.bin,,1 0 0 0 0 -1 0 0 0 0 1 0",
            "line 3: T_real_sim is a mirror image; set input.sim_frame",
        ),
        ("p,real/a.bin,sim/a.bin,,1 0 0 x 0 1 0 0 0 0 1 0", "line 3: T_real_sim: expected a number, got 'x'"),
        (" ,real/a.bin,sim/a.bin,,", "line 3: pair_id is empty"),
        ("first,real/a.bin,sim/a.bin,,", "line 3: pair_id first is already in line 2"),
    ],
)
def test_a_bad_manifest_stops_everything(tmp_path, row, fault):
    with pytest.raises(DatasetError) as error:
        read_dataset(manifest(tmp_path, ["first,real/a.bin,sim/a.bin,,", row]))
    assert fault in str(error.value)


def test_a_row_of_more_values_and_a_column_that_occurs_twice_are_named(tmp_path):
    with pytest.raises(DatasetError, match=r"line 2: expected 3 values, got 4"):
        read_dataset(manifest(tmp_path, ["a,real/a.bin,sim/a.bin,1"], "pair_id,real,sim"))
    with pytest.raises(DatasetError, match=r"column real occurs 2 times; expected it once"):
        read_dataset(manifest(tmp_path, ["a,real/a.bin,sim/a.bin,1"], "pair_id,real,sim,real"))
    pairs = read_dataset(manifest(tmp_path, ['"a", real/a.bin ,sim/a.bin', "", "b,real/a.bin,sim/a.bin"])).pairs
    assert [(pair.pair_id, pair.fault, pair.timestamp_s) for pair in pairs] == [("a", None, None), ("b", None, None)]


def test_a_manifest_without_its_columns_stops_everything(tmp_path):
    with pytest.raises(DatasetError, match="missing columns pair_id, sim; got name, real"):
        read_dataset(manifest(tmp_path, ["a,b"], header="name,real"))


def test_bad_label_names_stop_everything(tmp_path):
    folders(tmp_path)
    (tmp_path / "labels.toml").write_text("tree = 4\n")
    with pytest.raises(DatasetError, match=r'labels\.toml: expected lines such as 4 = "tree"'):
        read_dataset(tmp_path)


def test_a_half_sweep_on_one_side_is_a_warning(tmp_path):
    scan = street()
    write_bin(tmp_path / "real" / "a.bin", scan)
    write_bin(tmp_path / "sim" / "a.bin", scan[scan[:, 1] <= 0])
    (warning,) = check_dataset(tmp_path, Settings()).warnings
    assert "is it a half sweep" in warning


def test_every_fault_is_found_in_one_go(tmp_path):
    folders(tmp_path, ("a", "b", "c", "d"), ("a", "b", "c"))
    (tmp_path / "real" / "a.bin").write_bytes(b"123")
    (tmp_path / "sim" / "b.bin").write_bytes(b"")
    write_bin(tmp_path / "sim" / "c.bin", np.zeros((20, 3)))
    found = check_dataset(tmp_path, Settings())
    assert len(found.faults) == 4
    for name, fault in zip("abcd", found.faults, strict=True):
        assert fault.startswith(f"pair {name}: ")
    assert "expected at least 8 points after cleaning, got 0 (20 zero)" in found.faults[2]


def warnings_of(tmp_path, scan):
    for side in ("real", "sim"):
        write_bin(tmp_path / side / "a.bin", scan)
    return " ".join(check_dataset(tmp_path, load(None, ["input.max_range_m=1e9"])).warnings)


@pytest.mark.parametrize(("factor", "unit"), [(100, "centimetres"), (1000, "millimetres")])
def test_a_scan_in_another_unit_is_told_by_its_unit(tmp_path, factor, unit):
    assert f"expected metres: are they {unit}?" in warnings_of(tmp_path, street() * factor)


def test_projected_coordinates_are_not_taken_for_another_unit(tmp_path):
    assert "are they projected?" in warnings_of(tmp_path, street() + [4000, 9000, 0])


def test_half_the_points_not_finite_is_a_warning(tmp_path):
    scan = street()
    scan[::2] = np.nan
    assert "50% of the points are not finite" in warnings_of(tmp_path, scan)


def test_five_points_are_a_fault(tmp_path):
    folders(tmp_path)
    write_bin(tmp_path / "real" / "a.bin", street()[:5])
    (fault,) = check_dataset(tmp_path, Settings()).faults
    assert "expected at least 8 points after cleaning, got 5 (no more in the file)" in fault


def test_the_faults_of_real_scans_are_seen(real_data, tmp_path):
    carla = real_data / "carla"
    (tmp_path / "pairs.csv").write_text(
        "pair_id,real,sim\n"
        f"half,{carla / '000030.bin'},{carla / 'half_sweep.bin'}\n"
        f"good,{real_data / 'kitti_twin/real/000000.bin'},{real_data / 'kitti_twin/sim/000000.bin'}\n"
    )
    warnings = check_dataset(tmp_path, Settings()).warnings
    assert any("000030.bin: 51% of the points are within 3 m" in text for text in warnings)
    assert any("half_sweep.bin: no point in a sector of 180 degrees" in text for text in warnings)
    assert not any("kitti_twin" in text for text in warnings)


def test_wrong_columns_of_a_real_scan_are_seen(real_data, tmp_path):
    (scan,) = (real_data / "nuscenes").glob("*.pcd.bin")
    (tmp_path / "pairs.csv").write_text(f"pair_id,real,sim\na,{scan},{scan}\n")
    assert not any("columns" in text for text in check_dataset(tmp_path, Settings()).warnings)
    as_four = check_dataset(tmp_path, load(None, ["input.columns=x y z intensity"]))
    assert any("are the columns right" in text for text in as_four.warnings)


def test_check_estimates_the_sensors_of_both_sides_from_the_sampled_pairs_and_names_other_ones(tmp_path):
    azimuth, elevation = np.meshgrid(np.radians(np.arange(0, 360, 0.5)), np.radians(np.arange(-15.0, 16.0, 2.0)))
    range_m = 10 + 4 * np.sin(3 * azimuth)
    rows = np.stack(
        [
            range_m * np.cos(elevation) * np.cos(azimuth),
            range_m * np.cos(elevation) * np.sin(azimuth),
            range_m * np.sin(elevation),
        ],
        axis=-1,
    ).reshape(-1, 3)
    dataset = folders(tmp_path, ("a", "b", "c"), ("a", "b"))
    for name in ("a", "b", "c"):
        write_bin(dataset / "real" / f"{name}.bin", rows if name != "c" else rows[np.arange(len(rows)) // 720 % 2 == 0])
    sensors = check_dataset(dataset, Settings()).sensors
    assert sensors.pair_ids == ("a", "b", "c")
    assert sensors.sides["real"].model == "Velodyne VLP-16"
    assert sensors.sides["real"].azimuth_step_deg == pytest.approx(0.5, abs=0.001)
    assert sensors.sides["sim"].model is None
    assert sensors.differences[0] == "beams: 16 real, none detected simulated"
    (line,) = sensors.unlike
    assert line == "real scan of pair c: beams at least 8, others 16 (Velodyne VLP-16)"
