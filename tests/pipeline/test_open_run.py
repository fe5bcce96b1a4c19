"""A finished run opened in Python: the frames are the files."""

import pandas as pd
import pyarrow as pa
import pytest

import fidpipe
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.tables import TABLES
from runs import run as run_dataset
from scenes import write_bin, write_dataset


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run of two pairs, and one that failed."""
    base = tmp_path_factory.mktemp("open")
    data = write_dataset(base / "streets", 2)
    for side in ("real", "sim"):
        write_bin(data / side / "poor.bin", [[10.0, 0.0, 0.0]] * 3)
    run_dataset(data, base / "run")
    return base / "run"


@pytest.fixture(scope="module")
def run(folder):
    return fidpipe.open_run(str(folder))


def test_the_frames_are_the_files(run, folder):
    pd.testing.assert_frame_equal(run.pairs, pd.read_parquet(folder / "pairs.parquet"))
    for name in ("objects", "metrics"):
        keys = list(TABLES[name].keys)
        files = pd.read_parquet(folder / name).sort_values(["pair_id", *keys], ignore_index=True)
        frame = getattr(run, name)
        assert len(frame) == len(files) > 0
        pd.testing.assert_frame_equal(frame.sort_values(["pair_id", *keys], ignore_index=True), files)


@pytest.mark.parametrize("side", ["real", "sim"])
def test_points_bear_their_object_and_edges_join_object_points(run, side):
    points, edges = run.points("000", side), run.edges("000", side)
    assert points.community_id[points.is_ground].isna().all()
    own = points[~points.is_ground]
    counts = own.groupby("community_id").size()
    objects = run.objects.query("pair_id == '000' and side == @side").set_index("community_id")
    assert counts.to_dict() == objects.n_points.to_dict()
    ends = own.set_index("point_id")[["x", "y", "z"]]
    lengths = ((ends.loc[edges.src].to_numpy() - ends.loc[edges.dst].to_numpy()) ** 2).sum(axis=1) ** 0.5
    assert lengths == pytest.approx(edges.length_m.to_numpy())


def test_every_table_comes_as_arrow_with_its_schema(run):
    for name in (
        "ground",
        "sensor",
        "graph",
        "communities",
        "objects",
        "matching",
        "coverage",
        "surface",
        "pieces",
        "selection",
        "metrics",
    ):
        table = run.table(name)
        assert isinstance(table, pa.Table)
        assert table.schema.names == TABLES[name].schema.names, name
        assert run.table(name, []).schema.equals(table.schema), name
        assert set(table.column("pair_id").to_pylist()) == {"000", "001"}
    assert run.table("metrics", ["001"]).column("pair_id").unique().to_pylist() == ["001"]


def test_what_is_not_there_is_named(run, folder, tmp_path):
    with pytest.raises(RunError, match="no table 'metric'; it has pairs, timings, ground"):
        run.table("metric")
    with pytest.raises(RunError, match="no pair '0000'"):
        run.points("0000", "real")
    with pytest.raises(RunError, match="expected side real or sim, got 'left'"):
        run.points("000", "left")
    with pytest.raises(RunError, match="pair poor: it failed and has no objects"):
        run.edges("poor", "real")
    with pytest.raises(RunError, match="no run.json"):
        fidpipe.open_run(tmp_path)
    assert repr(run) == f"<fidpipe run {folder}: 2 pairs scored, 1 failed, preset paper>"
