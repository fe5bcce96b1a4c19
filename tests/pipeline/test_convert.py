"""Scans written in another format: every value comes back."""

import shutil

import numpy as np
import pytest

from fidpipe.pipeline.datasets.pairs import read_label_names
from fidpipe.pipeline.datasets.readers import frames_of, read_scan
from fidpipe.pipeline.exchange.convert import convert
from fidpipe.schemas.errors import DatasetError
from recordings import carla_ply
from runs import command
from scenes import street, write_bin

SUFFIXES = (".parquet", ".ply", ".pcd")
COLUMNS = ("points", "intensity", "rings", "times_s", "incidence", "instances")


def same(first, second):
    for name in COLUMNS:
        one, other = getattr(first, name), getattr(second, name)
        assert (one is None) == (other is None), name
        if one is not None:
            np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("far", [0.0, 635619.123456789])
def test_float64_coordinates_come_back_to_the_last_bit(tmp_path, suffix, far):
    points = street() + far
    points[3], points[5] = np.nan, 0
    np.save(tmp_path / "a.npy", points)
    (written,) = convert(tmp_path / "a.npy", tmp_path / f"b{suffix}")
    np.testing.assert_array_equal(read_scan(written).points, points)


def test_coordinates_that_float32_holds_are_written_in_float32(tmp_path):
    (written,) = convert(write_bin(tmp_path / "a.bin", street()), tmp_path / "a.ply")
    assert b"property float x\n" in written.read_bytes()[:200]


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_all_columns_of_carla_come_back(tmp_path, suffix):
    points = np.round(street(), 4)
    n = len(points)
    columns = {"CosAngle": np.arange(n) % 2 / 2, "ObjIdx": np.arange(n) % 5, "ObjTag": np.arange(n) % 30}
    (tmp_path / "a.ply").write_text(carla_ply(points, columns))
    (written,) = convert(tmp_path / "a.ply", tmp_path / "out" / f"b{suffix}")
    first, second = read_scan(tmp_path / "a.ply"), read_scan(written)
    same(first, second)
    if suffix != ".parquet":  # words are numbers there, by the simulator's own
        assert set(second.labels) == set(map(str, range(30)))
        names = read_label_names(tmp_path / "out")
        second = read_scan(written, label_names=names)
    assert second.labels.tolist() == first.labels.tolist()


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_names_of_the_dataset_go_with_labels(tmp_path, suffix):
    path = write_bin(tmp_path / "a.bin", street())
    numbers = np.full(len(street()), 4 + (7 << 16), "<u4")
    numbers[0] = 99
    (tmp_path / "a.label").write_bytes(numbers.tobytes())
    (tmp_path / "labels.toml").write_text('4 = "tree"\n')
    (written,) = convert(path, tmp_path / "out" / f"a{suffix}")
    scan = read_scan(written, label_names={4: "tree"})
    assert scan.labels[:2].tolist() == ["99", "tree"]
    assert scan.instances[:2].tolist() == [0, 7]


def test_names_that_contradict_are_refused(tmp_path):
    points, columns = np.round(street(), 4), {"CosAngle": [0.5] * 2000, "ObjIdx": [1] * 2000, "ObjTag": [14] * 2000}
    (tmp_path / "a.ply").write_text(carla_ply(points, columns))
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "labels.toml").write_text('14 = "Ground"\n')
    with pytest.raises(DatasetError, match="14 is 'Ground', the scan has 'Car'"):
        convert(tmp_path / "a.ply", tmp_path / "out" / "a.pcd")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_frames_of_a_capture_come_back(real_data, tmp_path, suffix):
    capture = real_data / "velodyne_vlp32c/sweeps.pcap"
    shown = command("convert", capture, tmp_path / "frames", "--to", suffix[1:], code=0)
    assert shown.stdout.strip() == f"5 files in {tmp_path / 'frames'}"
    for frame, file in zip(frames_of(capture), sorted((tmp_path / "frames").iterdir()), strict=True):
        same(read_scan(frame), read_scan(file))


def test_what_is_there_is_not_replaced_unasked_and_the_source_never(tmp_path):
    path = write_bin(tmp_path / "a.bin", street())
    (written,) = convert(path, tmp_path / "a.ply")
    before = written.read_bytes()
    with pytest.raises(DatasetError, match="already exists; use --replace to overwrite it"):
        convert(path, written)
    assert convert(path, written, replace=True) == [written]
    with pytest.raises(DatasetError, match="is the scan being read"):
        convert(written, written, replace=True)
    assert written.read_bytes() == before


@pytest.mark.parametrize(("out", "to", "wanted"), [("b.xyz", "ply", ".xyz"), ("b", "bag", ".bag")])
def test_a_format_that_is_not_written_is_named(tmp_path, out, to, wanted):
    with pytest.raises(DatasetError, match=rf"cannot write \{wanted} files; expected one of \.parquet, \.ply, \.pcd"):
        convert(write_bin(tmp_path / "a.bin", street()), tmp_path / out, to)


def test_several_frames_do_not_go_into_one_file(real_data, tmp_path):
    shutil.copy(real_data / "velodyne_vlp32c/rosbag1.bag", tmp_path)
    with pytest.raises(DatasetError, match=r"3 frames found, .*a\.ply is one file; name a frame, or a folder"):
        convert(tmp_path / "rosbag1.bag", tmp_path / "a.ply")


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "name", ["las/autzen_trim.laz", "las/test1_4.las", "registration/source.ply", "rellis/000104.bin"]
)
def test_real_scans_come_back(real_data, tmp_path, suffix, name):
    (written,) = convert(real_data / name, tmp_path / f"a{suffix}")
    first, second = read_scan(real_data / name), read_scan(written)
    same(first, second)
    assert (first.labels is None) == (second.labels is None)
