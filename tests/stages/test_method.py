"""A pair in memory has, value for value, the tables of the command."""

import numpy as np
import pandas as pd
import pytest

import fidpipe
from fidpipe import evaluate_pair
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.errors import ScanError
from fidpipe.schemas.settings import load
from runs import run
from scenes import drifted, street, write_pair

SIDES = ("real", "sim")
OF_SIDES = ("ground", "sensor", "graph", "communities", "objects")
OF_PAIRS = (
    "matching",
    "coverage",
    "surface",
    "pieces",
    "rays",
    "causes",
    "selection",
    "metrics",
)


def read_tables(folder, pair_id):
    """The tables of one pair of a run, by name and side."""
    files = {(name, side) for name in OF_SIDES for side in SIDES} | {
        (name, "") for name in OF_PAIRS
    }
    return {
        (name, side): pd.read_parquet(
            folder / name / f"{pair_id}{'.' + side if side else ''}.parquet"
        )
        for name, side in files
    }


@pytest.fixture(scope="module")
def scans():
    real = street(seed=3)
    return real, drifted(real, seed=4)


# one of the settings mirrors it
@pytest.mark.filterwarnings("ignore:the simulated scan covers")
@pytest.mark.parametrize(
    "words",
    [
        [],
        [
            "ground.shared=true",
            "ground.loss=total",
            "input.sim_frame=carla",
            "matching.method=optimal",
        ],
        ["communities.objects=reference", "graph.ties=coordinates", "communities.reach_m=0.4"],
    ],
    ids=" ".join,
)
def test_a_small_scene_has_the_tables_of_the_command(scans, words, tmp_path):
    """To the last bit in every column of every table, but for those that a scan without labels leaves null."""
    settings = load(None, words)
    write_pair(tmp_path, *scans)
    (row,) = run(tmp_path, tmp_path / "run", settings).rows
    result = evaluate_pair(
        *(read_scan(tmp_path / side / "a.bin").points for side in SIDES), settings
    )
    fields = {"ground": "points", "graph": "edges"}
    for (name, side), expected in read_tables(tmp_path / "run", "a").items():
        found = getattr(result, fields.get(name, name))
        columns = [
            c
            for c in expected.columns
            if c not in ("pair_id", "intensity", "label", "instance")
        ]
        frames = (
            own[columns].reset_index(drop=True)
            for own in (found[side] if side else found, expected)
        )
        pd.testing.assert_frame_equal(*frames, check_exact=True, check_dtype=False, obj=name)
    names = {
        name
        for name in row
        if name not in ("pair_id", "status", "reason") and "intensity" not in name
    }
    assert {name: result.summary[name] for name in names} == {name: row[name] for name in names}


def test_paths_scans_and_arrays_with_intensity_have_the_same_results(scans, tmp_path):
    columns = [
        np.column_stack([points, np.linspace(0, 1, len(points))]).astype(np.float32)
        for points in scans
    ]
    paths = [tmp_path / f"{side}.bin" for side in SIDES]
    for path, rows in zip(paths, columns, strict=True):
        rows.tofile(path)
    own = [fidpipe.read_scan(str(path)) for path in paths]
    results = [evaluate_pair(*sources) for sources in (columns, paths, own)]
    assert results[0].points["real"].intensity.max() == 1
    for result in results[1:]:
        assert result.summary == results[0].summary
        pd.testing.assert_frame_equal(result.points["sim"], results[0].points["sim"])
    matched = results[0].summary["n_matched"]
    assert matched > 0
    assert repr(results[0]).startswith(
        f"<evaluated pair, preset paper: n_matched {matched}, match_rate "
    )
    with pytest.raises(ScanError, match=r"sim: .*\(60, 5\)"):
        evaluate_pair(columns[0], np.ones((60, 5)))
