"""Arrays of other kinds than (n, 3) float64: computed with all the same, or rejected by name."""

import numpy as np
import pytest

from bounds import KEEP_ALL, evaluated
from fidpipe import evaluate_pair
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.errors import FidpipeError, ScanError
from scenes import cloud, drifted, street

POINTS = cloud()
ACCEPTED = {
    "float16": POINTS.astype(np.float16),
    "float32": POINTS.astype(np.float32),
    "long double": POINTS.astype(np.longdouble),
    "big-endian": POINTS.astype(">f8"),
    "whole numbers": (9 * POINTS).astype(np.int32),
    "unsigned bytes": np.abs(9 * POINTS).astype(np.uint8),
    "every second row and column": np.repeat(np.repeat(POINTS, 2, axis=0), 2, axis=1)[::2, ::2],
    "column by column": np.asfortranarray(POINTS),
    "nested lists": POINTS.tolist(),
}
REJECTED = {
    "expected real numbers, got complex128 values": POINTS + 1j,
    "expected real numbers, got bool values": POINTS > 9,
    "expected real numbers, got object values": POINTS.astype(object),
    "expected real numbers, got <U32 values": POINTS.astype(str),
    "expected real numbers, got datetime64": POINTS.astype("M8[s]"),
    "got rows of unequal lengths": [[1.0, 2.0, 3.0], [1.0]],
    r"got \(3,\)": np.ones(3),
    r"got \(20, 5\)": np.ones((20, 5)),
    r"got \(\)": 5.0,
    "expected at least 8 points": np.empty((0, 3)),
}
UNCHANGED_BY_MOTION = ("n_matched", "match_rate", "cdc_mean", "r_lambda_mean", "r_gap_mean")


@pytest.mark.parametrize("kind", ACCEPTED)
def test_arrays_of_any_real_numbers_are_scored(kind):
    summary = evaluated(ACCEPTED[kind], ACCEPTED[kind], KEEP_ALL).summary
    assert summary["n_identical"] == summary["n_matched"] == 1


@pytest.mark.parametrize("words", REJECTED)
def test_other_arrays_are_rejected(words):
    with pytest.raises(FidpipeError, match=words):
        evaluate_pair(REJECTED[words], REJECTED[words], KEEP_ALL)


def test_read_only_arrays_are_scored_and_left_unchanged():
    points = street()
    expected = evaluate_pair(points, drifted(points)).summary
    frozen = np.asfortranarray(points)
    frozen.flags.writeable = False
    assert evaluate_pair(frozen, drifted(points)).summary == expected


def test_thinned_sides_keep_their_sensors_and_count_no_returns():
    points = street()
    result = evaluate_pair(points, drifted(points), {"input": {"voxel_m": 0.3}})
    assert result.summary["n_real_raw"] == len(points) > result.summary["n_real_clean"]
    assert result.summary["rays_reason"] == "scans thinned by input.voxel_m=0.3"
    causes = result.causes.set_index("cause")
    assert "thinned by input.voxel_m=0.3" in causes.reason["lost returns"]
    assert causes.amount["height"] is not None


def test_masked_points_are_dropped():
    points = street()
    mask = np.zeros_like(points, dtype=bool)
    mask[::9, 1] = True
    expected = evaluate_pair(points[~mask.any(axis=1)], points).summary
    summary = evaluate_pair(np.ma.masked_array(points, mask), points).summary
    assert summary.pop("n_real_raw") == expected.pop("n_real_raw") + mask.sum()
    assert summary == expected


@pytest.mark.parametrize("away_m", [[1e6, 1e6, 0], [4.5e5, 5.4e6, 300]])
def test_projected_coordinates_have_the_scores_of_the_origin(away_m):
    real = street()
    sim = drifted(real)
    expected = evaluated(real, sim, KEEP_ALL).summary
    with pytest.warns(
        UserWarning, match=r"not in the sensor's frame: .*set input.sensor_position"
    ):
        summary = evaluated(real + away_m, sim + away_m, KEEP_ALL).summary
    for name in UNCHANGED_BY_MOTION:
        assert summary[name] == pytest.approx(expected[name], rel=1e-6), name


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [
        ("z", "c16", "column z: .* got complex128 values"),
        ("x", "?", "column x: .* got bool values"),
        ("y", ("f8", 2), r"column y: .* got float64 values of shape \(20, 2\)"),
        ("intensity", "c8", "column intensity: .* got complex64 values"),
    ],
)
def test_columns_without_real_numbers_are_rejected_by_name(tmp_path, name, kind, words):
    kinds = {"x": "f8", "y": "f8", "z": "f8", "intensity": "f4"} | {name: kind}
    fields = []
    for column, of_column in kinds.items():
        fields.append(
            (column, *of_column) if isinstance(of_column, tuple) else (column, of_column)
        )
    np.save(tmp_path / "a.npy", np.ones(20, dtype=fields))
    with pytest.raises(ScanError, match=words):
        read_scan(tmp_path / "a.npy")


def test_infinite_labels_are_text(tmp_path):
    rows = np.zeros(60, dtype=[("x", "f8"), ("y", "f8"), ("z", "f8"), ("label", "f8")])
    rows["x"], rows["y"], rows["z"] = cloud().T
    rows["label"][:30] = np.inf
    np.save(tmp_path / "a.npy", rows)
    assert set(read_scan(tmp_path / "a.npy").labels) == {"inf", "0.0"}  # a warning is an error
