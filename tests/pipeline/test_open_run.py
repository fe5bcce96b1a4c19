"""A finished run opened in Python: the frames are the files, and the plots show them; and all public names."""

from io import BytesIO
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.image import imread

import fidpipe
from fidpipe.pipeline.report.figures.plots import plot_range_image
from fidpipe.pipeline.report.look import SIDE_COLOURS
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.tables import TABLES
from reports import HOSTILE_PAIRS
from runs import FOLDERS

FIRST = HOSTILE_PAIRS[0]
LAST = HOSTILE_PAIRS[-1]


@pytest.fixture(scope="module")
def run(report_run):
    return fidpipe.open_run(str(report_run))


def test_the_frames_are_the_files(run, report_run):
    pd.testing.assert_frame_equal(run.pairs, pd.read_parquet(report_run / "pairs.parquet"))
    keys = list(TABLES["metrics"].keys)
    files = pd.read_parquet(report_run / "metrics").sort_values(
        ["pair_id", *keys], ignore_index=True
    )
    assert len(run.metrics) == len(files) > 0
    pd.testing.assert_frame_equal(
        run.metrics.sort_values(["pair_id", *keys], ignore_index=True), files
    )


def test_the_objects_are_one_table_with_scores_coverage_and_units(run, report_run):
    keys = ["pair_id", "side", "community_id"]
    objects = run.objects.set_index(keys)
    files = pd.read_parquet(report_run / "objects").set_index(keys).loc[objects.index]
    assert (objects.n_points == files.n_points).all()
    assert objects.x_m.equals(files.cx.rename("x_m"))
    coverage = (
        pd.read_parquet(report_run / "coverage").dropna(subset="community_id").set_index(keys)
    )
    np.testing.assert_array_equal(
        objects.covered_0p3m, coverage.loc[objects.index].covered_0p3m
    )
    matched = run.objects.query("side == 'real' and fate == 'matched'").set_index(
        ["pair_id", "community_id"]
    )
    scores = run.metrics.set_index(["pair_id", "real_id"]).loc[matched.index]
    np.testing.assert_array_equal(matched.cdc, scores.cdc)
    assert not {"cx", "extent_x", "pair", "band"} & {*run.objects.columns}


@pytest.mark.parametrize("side", ["real", "sim"])
def test_points_bear_their_object_and_edges_join_object_points(run, side):
    points = run.points(FIRST, side)
    edges = run.edges(FIRST, side)
    assert points.community_id[points.is_ground].isna().all()
    own = points[~points.is_ground]
    counts = own.groupby("community_id").size()
    objects = run.objects.query("pair_id == @FIRST and side == @side").set_index("community_id")
    assert counts.to_dict() == objects.n_points.to_dict()
    ends = own.set_index("point_id")[["x", "y", "z"]]
    lengths = ((ends.loc[edges.src].to_numpy() - ends.loc[edges.dst].to_numpy()) ** 2).sum(
        axis=1
    ) ** 0.5
    assert lengths == pytest.approx(edges.length_m.to_numpy())


def test_every_table_comes_as_arrow_with_its_schema(run):
    for name in FOLDERS:
        table = run.table(name)
        assert isinstance(table, pa.Table)
        assert table.schema.names == TABLES[name].schema.names, name
        assert run.table(name, []).schema.equals(table.schema), name
        # These streets have no rings, and so no rays.
        assert set(table.column("pair_id").to_pylist()) == (
            set() if "ray" in name else set(HOSTILE_PAIRS)
        ), name
    assert run.table("metrics", [LAST]).column("pair_id").unique().to_pylist() == [LAST]


def test_what_is_not_there_is_named(run, report_run):
    with pytest.raises(RunError, match="'metric'"):
        run.table("metric")
    with pytest.raises(RunError, match="'0000'"):
        run.points("0000", "real")
    with pytest.raises(RunError, match="'left'"):
        run.points(FIRST, "left")
    with pytest.raises(RunError, match="pair broken <b>pair</b>"):
        run.edges("broken <b>pair</b>", "real")
    assert repr(run) == f"<fidpipe run {report_run}: 4 pairs scored, 1 failed, preset paper>"


def test_a_run_without_a_scored_pair_says_that_it_has_no_objects(report_run):
    failed = fidpipe.open_run(report_run)
    failed.rows = [row for row in failed.rows if row["status"] == "failed"]
    with pytest.raises(RunError, match="no pair is scored"):
        _ = failed.objects


def test_the_public_names_are_those_of_dir_and_each_loads():
    assert dir(fidpipe) == sorted(fidpipe.__all__)
    assert all(hasattr(fidpipe, name) for name in dir(fidpipe))
    assert issubclass(fidpipe.Run, fidpipe.FinishedRun)


def test_an_object_is_found_by_its_number_on_either_side(run):
    matched = run.pair(FIRST)["objects"][0]
    real, sim = [matched[side]["community_id"] for side in ("real", "sim")]
    assert run.object(FIRST, f"sim:{sim}") == run.object(FIRST, real) == matched


def test_the_plot_of_an_object_has_its_points_in_colour_and_its_scores(run):
    matched = run.pair(FIRST)["objects"][0]
    figure = run.plot_object(FIRST, matched["real"]["community_id"])
    (axis,) = figure.axes
    assert f"CDC {matched['real']['cdc']:.3f}" in axis.get_title()
    for points, (side, colour) in zip(axis.collections[1:], SIDE_COLOURS.items(), strict=True):
        assert len(points.get_offsets()) == matched[side]["n_points"]
        assert tuple(points.get_facecolor()[0]) == to_rgba(colour)
    assert imread(BytesIO(figure._repr_png_())).shape[2] == 4


def test_plots_are_drawn_into_given_axes(run):
    figure = Figure()
    in_space = figure.add_subplot(1, 2, 1, projection="3d")
    from_above = figure.add_subplot(1, 2, 2)
    name = run.pair(FIRST)["objects"][0]["real"]["community_id"]
    assert run.plot_object(FIRST, name, ax=in_space) is figure
    assert run.plot_pieces(FIRST, ax=from_above) is figure
    assert figure.axes == [in_space, from_above]
    assert all(axis.collections for axis in figure.axes)


def test_the_plot_of_pieces_has_the_points_of_the_table(run):
    figure = run.plot_pieces(LAST)
    pieces = run.table("pieces", [LAST]).to_pandas()
    assert len(pieces)
    (axis,) = figure.axes
    of_sides = [pieces[pieces.side == side] for side in ("real", "sim")]
    for points, of_side in zip(axis.collections[1::2], of_sides, strict=True):
        assert len(points.get_offsets()) == of_side.n_points.sum()
    centres = np.array([text.xy for text in axis.texts]).reshape(-1, 2)
    expected = [of_side[["cx", "cy"]].to_numpy()[:10] for of_side in of_sides]
    assert centres == pytest.approx(np.concatenate(expected))


def test_a_pair_without_rays_has_no_range_image(run):
    with pytest.raises(RunError, match="no rays: "):
        run.plot_range_image(FIRST)


def test_a_range_image_has_left_on_the_left_and_the_highest_beam_on_top():
    outcomes = ["same", "none", "dropped", "sim_only", "same", "behind", "same"]
    rays = {"beam": [0, 0, 1, 1, 2, 2, 2], "column": [0, 1, 0, 1, 0, 1, 2], "outcome": outcomes}
    stub = SimpleNamespace(folder="run", table=lambda name, pairs: pa.table(rays))
    outcome = plot_range_image(stub, "a").axes[0].images[0].get_array()
    # the third column of beam 2 is beyond a turn
    assert outcome.tolist() == [
        [2, 0],
        [5, 3],
        [None, 0],
    ]
