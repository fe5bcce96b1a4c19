"""What the engine announces before it works."""

import numpy as np

from fidpipe.pipeline.datasets.pairs import ScanPair
from fidpipe.pipeline.datasets.readers.scan_ref import scan_ref
from fidpipe.pipeline.engine.engine import large_pairs_text, voxel_for
from fidpipe.schemas.settings import InputSettings


def test_a_pair_of_many_points_is_announced_with_its_memory_and_minutes():
    text = large_pairs_text([400_000, 2_000_000], 0.1)
    assert (
        "1 of 2 pairs have 500,000 points or more; the largest has about 2,000,000; with all"
        in text
    )
    assert (
        "some 7 GiB of memory and 17 minutes, more where points are dense; thin both sides"
        in text
    )
    assert "input.voxel_m=0.1, lower" in text


def test_the_announced_voxel_leaves_fewer_points_on_each_side(tmp_path, rng):
    scans = {}
    for side, size_m in (("real", 30), ("sim", 40)):
        points = rng.uniform([3, 0, 0, 0], [3 + size_m, size_m, 0.01, 1], (600_000, 4))
        path = tmp_path / f"{side}.bin"
        path.write_bytes(points.astype(np.float32).tobytes())
        scans[side] = scan_ref(path)
    pair = ScanPair("0", scans["real"], scans["sim"])
    assert voxel_for(pair, InputSettings()) == 0.1
    scans["sim"].file.write_bytes(b"no points")
    assert voxel_for(pair, InputSettings()) is None
