"""Posed recordings: valid ones are read, others rejected in one line."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fidpipe.pipeline.datasets.pairs import read_dataset
from fidpipe.pipeline.generate.recordings import read_recording
from fidpipe.schemas.errors import DatasetError
from scenes import rigid, street, write_bin

N = 4


def motions(n=N):
    """Poses of the sensor: a metre ahead and two degrees to the left with each frame."""
    return [rigid(2.0 * i, [1.0 * i, 0.1 * i, 0.02 * i]) for i in range(n)]


def scans(folder, n=N):
    for i in range(n):
        write_bin(folder / f"{i:03}.bin", street(seed=i, n=20))
    return folder


def tum(path, poses):
    lines = [
        " ".join(
            map(
                repr,
                [
                    0.1 * i,
                    *T[:, 3].tolist(),
                    *Rotation.from_matrix(T[:, :3]).as_quat().tolist(),
                ],
            )
        )
        for i, T in enumerate(poses)
    ]
    path.write_text("# time tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")


def square(T):
    return np.vstack([T, [0, 0, 0, 1]])


def write_kitti(folder, poses, Tr):
    """Poses of the camera, as KITTI has them, of a sensor that was at `poses`."""
    camera = [(square(Tr) @ square(T) @ np.linalg.inv(square(Tr)))[:3] for T in poses]
    (folder / "poses.txt").write_text(
        "\n".join(" ".join(map(repr, T.ravel().tolist())) for T in camera)
    )
    numbers = " ".join(map(repr, Tr.ravel().tolist()))
    (folder / "calib.txt").write_text(f"P0: 7 0 0 0 0 7 0 0 0 0 1 0\nTr: {numbers}\n")


def motion_of(frame):
    return np.reshape(frame.T_world_sensor, (3, 4))


def test_tum_poses_are_those_of_the_sensor(tmp_path):
    tum(scans(tmp_path) / "poses.tum", motions())
    recording = read_recording(tmp_path)
    assert [frame.pair_id for frame in recording.pairs] == ["000", "001", "002", "003"]
    assert [frame.timestamp_s for frame in recording.pairs] == pytest.approx(
        [0.0, 0.1, 0.2, 0.3]
    )
    for frame, T in zip(recording.pairs, motions(), strict=True):
        np.testing.assert_allclose(motion_of(frame), T, atol=1e-12)


def test_kitti_poses_are_brought_from_the_camera_to_the_sensor(tmp_path):
    Tr = np.column_stack([[[0, -1, 0], [0, 0, -1], [1, 0, 0]], [0.1, -0.2, -0.3]]).astype(float)
    scans(tmp_path / "velodyne")
    write_kitti(tmp_path, motions(), Tr)
    (tmp_path / "times.txt").write_text("0.0\n0.1\n0.2\n0.31\n")
    recording = read_recording(tmp_path)
    for frame, T in zip(recording.pairs, motions(), strict=True):
        np.testing.assert_allclose(motion_of(frame), T, atol=1e-9)
    assert recording.pairs[3].timestamp_s == 0.31


def test_poses_in_kittis_own_folder_are_found(tmp_path):
    folder = tmp_path / "sequences" / "07"
    scans(folder / "velodyne")
    write_kitti(folder, motions(), np.eye(3, 4))
    (tmp_path / "poses").mkdir()
    (folder / "poses.txt").rename(tmp_path / "poses" / "07.txt")
    np.testing.assert_allclose(motion_of(read_recording(folder).pairs[2]), motions()[2])


def test_the_line_of_the_calibration_may_be_indented(tmp_path):
    write_kitti(scans(tmp_path), motions(), motions()[1])
    frames = read_recording(tmp_path).pairs
    calibration = tmp_path / "calib.txt"
    calibration.write_text(calibration.read_text().replace("Tr:", " Tr :"))
    assert read_recording(tmp_path).pairs == frames


def test_a_manifest_may_hold_the_poses_and_need_not_name_simulated_scans(tmp_path):
    scans(tmp_path / "scans")
    rows = [
        f"f{i},scans/{i:03}.bin,{0.5 * i},{' '.join(map(repr, T.ravel().tolist()))}"
        for i, T in enumerate(motions())
    ]
    (tmp_path / "pairs.csv").write_text(
        "pair_id,real,timestamp_s,T_world_sensor\n" + "\n".join(rows)
    )
    recording = read_recording(tmp_path)
    assert [frame.pair_id for frame in recording.pairs] == ["f0", "f1", "f2", "f3"]
    np.testing.assert_allclose(motion_of(recording.pairs[2]), motions()[2])
    with pytest.raises(DatasetError, match="sim"):
        read_dataset(tmp_path)


def test_a_manifest_with_poses_is_a_dataset_like_any_other(tmp_path):
    scans(tmp_path / "scans")
    T = " ".join(["1 0 0 5 0 1 0 6 0 0 1 7"])
    (tmp_path / "pairs.csv").write_text(
        f"pair_id,real,sim,T_world_sensor\na,scans/000.bin,scans/001.bin,{T}\nb,scans/002.bin,scans/003.bin,\n"
    )
    dataset = read_dataset(tmp_path)
    assert dataset.warnings == ()
    assert dataset.pairs[0].T_world_sensor == (1, 0, 0, 5, 0, 1, 0, 6, 0, 0, 1, 7)
    assert dataset.pairs[1].T_world_sensor is None
    with pytest.raises(DatasetError, match="pair b .*T_world_sensor"):
        read_recording(tmp_path)


def test_poses_may_lie_elsewhere(tmp_path):
    scans(tmp_path / "drive")
    tum(tmp_path / "odometry.txt", motions())
    assert len(read_recording(tmp_path / "drive", tmp_path / "odometry.txt").pairs) == N


LEVEL = "0 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        (None, "no poses found"),
        (3 * LEVEL, "3 poses for 4 scans"),
        ("1 2 3\n", "8 or 12 numbers, got lines of 3"),
        ("a b\n", "8 or 12 numbers"),
        ("", "got lines of no"),
        (3 * LEVEL + "0 0 0 0 0 0 0 2\n", "pose 4: .*quaternion of length 1, got 2"),
        (4 * "2 0 0 0 0 1 0 0 0 0 1 0\n", "poses.tum, pose 1: "),
        (4 * "1 0 0 0 0 -1 0 0 0 0 1 0\n", "mirror image"),
        (4 * "1 0 0 0 0 1 0 0 0 0 1 0\n", "calib.txt"),
    ],
)
def test_poses_that_cannot_be_used_are_refused(poses, words, tmp_path):
    scans(tmp_path)
    if poses is not None:
        (tmp_path / "poses.tum").write_text(poses)
    with pytest.raises(DatasetError, match=words):
        read_recording(tmp_path)


def test_fewer_than_three_frames_are_refused(tmp_path):
    (tmp_path / "poses.tum").write_text(LEVEL)
    with pytest.raises(DatasetError, match="no scans"):
        read_recording(tmp_path)
    tum(scans(tmp_path, 2) / "poses.tum", motions(2))
    with pytest.raises(DatasetError, match="3 frames, got 2"):
        read_recording(tmp_path)
    with pytest.raises(DatasetError, match="nowhere"):
        read_recording(tmp_path / "nowhere")


def test_two_scans_of_one_name_are_refused(tmp_path):
    for folder in ("a", "b", "c"):
        write_bin(tmp_path / folder / "scan.bin", street(n=20))
    T = "1 0 0 0 0 1 0 0 0 0 1 0"
    (tmp_path / "pairs.csv").write_text(
        "pair_id,real,T_world_sensor\n"
        + "".join(f"{name},{name}/scan.bin,{T}\n" for name in "abc")
    )
    with pytest.raises(DatasetError, match="3 scans are called scan"):
        read_recording(tmp_path)
