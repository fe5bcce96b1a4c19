"""A finished run opened in Python: the frames are the files."""

import pandas as pd
import pyarrow as pa
import pytest

import fidpipe
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.tables import TABLES
from reports import HOSTILE_PAIRS
from runs import FOLDERS

FIRST, LAST = HOSTILE_PAIRS[0], HOSTILE_PAIRS[-1]


@pytest.fixture(scope="module")
def run(report_run):
    return fidpipe.open_run(str(report_run))


def test_the_frames_are_the_files(run, report_run):
    pd.testing.assert_frame_equal(run.pairs, pd.read_parquet(report_run / "pairs.parquet"))
    for name in ("objects", "metrics"):
        keys = list(TABLES[name].keys)
        files = pd.read_parquet(report_run / name).sort_values(["pair_id", *keys], ignore_index=True)
        frame = getattr(run, name)
        assert len(frame) == len(files) > 0
        pd.testing.assert_frame_equal(frame.sort_values(["pair_id", *keys], ignore_index=True), files)


@pytest.mark.parametrize("side", ["real", "sim"])
def test_points_bear_their_object_and_edges_join_object_points(run, side):
    points, edges = run.points(FIRST, side), run.edges(FIRST, side)
    assert points.community_id[points.is_ground].isna().all()
    own = points[~points.is_ground]
    counts = own.groupby("community_id").size()
    objects = run.objects.query("pair_id == @FIRST and side == @side").set_index("community_id")
    assert counts.to_dict() == objects.n_points.to_dict()
    ends = own.set_index("point_id")[["x", "y", "z"]]
    lengths = ((ends.loc[edges.src].to_numpy() - ends.loc[edges.dst].to_numpy()) ** 2).sum(axis=1) ** 0.5
    assert lengths == pytest.approx(edges.length_m.to_numpy())


def test_every_table_comes_as_arrow_with_its_schema(run):
    for name in FOLDERS:
        table = run.table(name)
        assert isinstance(table, pa.Table)
        assert table.schema.names == TABLES[name].schema.names, name
        assert run.table(name, []).schema.equals(table.schema), name
        # These streets have no rings, and so no rays.
        assert set(table.column("pair_id").to_pylist()) == (set() if "ray" in name else set(HOSTILE_PAIRS)), name
    assert run.table("metrics", [LAST]).column("pair_id").unique().to_pylist() == [LAST]


def test_what_is_not_there_is_named(run, report_run, tmp_path):
    with pytest.raises(RunError, match="no table 'metric'; it has pairs, timings, ground"):
        run.table("metric")
    with pytest.raises(RunError, match="no pair '0000'"):
        run.points("0000", "real")
    with pytest.raises(RunError, match="expected side real or sim, got 'left'"):
        run.points(FIRST, "left")
    with pytest.raises(RunError, match="pair broken <b>pair</b>: it failed and has no objects"):
        run.edges("broken <b>pair</b>", "real")
    with pytest.raises(RunError, match="no run.json"):
        fidpipe.open_run(tmp_path)
    assert repr(run) == f"<fidpipe run {report_run}: 4 pairs scored, 1 failed, preset paper>"
