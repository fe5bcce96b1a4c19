"""Pictures of the README, one for each score: python tools/score_pictures.py RUN, a run with preset reference.

The first pair, its largest missing piece, and the trees whose scores are nearest to given values.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.collections import LineCollection

from fidpipe.pipeline.report.figures import style
from fidpipe.pipeline.report.look import SIDE_COLOURS
from fidpipe.pipeline.report.run_frames import coordinates, points_of, read_results
from fidpipe.schemas.columns import SIDES
from fidpipe.schemas.settings import Settings
from fidpipe.stages.coverage import nearest_distances
from fidpipe.stages.pieces import CutScan, find_pieces
from object_pictures import MOST_EDGES, Example, MatchedObject, choose, save

FOLDER = Path(__file__).resolve().parents[1] / "docs" / "pictures"
SIZE_IN = (4.2, 2.9)
REACH_M = 25.0  #: a scan is shown this far around the sensor
MARGIN_M = 3.0  #: around a piece
COVERED_COLOUR = "#aaaaaa"


def draw_surface(results, pair_id, path):
    """The real points from above: covered by the simulation within 0.3 m, or not."""
    points, sim = [
        coordinates(rows.query("not is_ground"))
        for rows in points_of(results.run, pair_id).values()
    ]
    is_covered = nearest_distances(points, sim)[0] <= 0.3
    with style.new_figure(*SIZE_IN) as figure:
        axis = figure.subplots()
        style.dots(axis, points[is_covered], 3, COVERED_COLOUR)
        style.dots(axis, points[~is_covered], 3, SIDE_COLOURS["real"])
        axis.set(
            xlim=(-REACH_M, REACH_M),
            ylim=(-0.7 * REACH_M, 0.7 * REACH_M),
            aspect="equal",
            xticks=[],
            yticks=[],
        )
        axis.set_title(
            f"{100 * is_covered.mean():.0f} % of the real surface is simulated (grey)"
        )
        save(figure, path)


def draw_piece(results, pair_id, path):
    """The largest missing piece of a pair among the points of both sides, from the side."""
    points = {side: results.run.points(pair_id, side) for side in SIDES}
    scans = [
        CutScan(
            own[["x", "y", "z"]].to_numpy(), own.is_ground.to_numpy(), own.height_m.to_numpy()
        )
        for own in points.values()
    ]
    labels = find_pieces(*scans, Settings().pieces)[0].labels
    is_piece = labels == np.argmax(np.bincount(labels[labels >= 0]))
    places = {side: own[["x", "y", "z"]].to_numpy() for side, own in points.items()}
    centre = places["real"][is_piece].mean(axis=0)
    spread = places["real"][is_piece][:, :2] - centre[:2]
    across = np.append(np.linalg.svd(spread, full_matrices=False)[2][0], 0.0)
    with style.new_figure(*SIZE_IN) as figure:
        axes = figure.subplots(2, 1, sharex=True, sharey=True)
        for axis, side in zip(axes, SIDES, strict=True):
            near = (
                np.linalg.norm(places[side][:, :2] - centre[:2], axis=1)
                < np.abs(spread).max() + MARGIN_M
            )
            seen = np.column_stack([(places[side] - centre) @ across, places[side][:, 2]])
            style.dots(axis, seen[near], 2, COVERED_COLOUR)
            if side == "real":
                style.dots(axis, seen[is_piece], 4, SIDE_COLOURS["real"])
            axis.set(aspect="equal", xticks=[], yticks=[])
        axes[0].set_title("real: a missing piece (blue)")
        axes[1].set_title("simulated: nothing there")
        save(figure, path)


def draw_objects(results, examples, path, *, is_graph):
    """Matched trees side by side: both sides overlaid, or the graph of each with its edges."""
    trees = results.matched.query("group == 'tree' and diagonal_m < 12")
    objects = [MatchedObject(results, choose(trees, one)) for one in examples]
    with style.new_figure(*SIZE_IN) as figure:
        axes = figure.subplots(2 if is_graph else 1, len(objects), squeeze=False)
        for column, own in enumerate(objects):
            value = own.row[examples[column].score]
            axes[0][column].set_title(
                f"{examples[column].score.replace('cdc', 'CDC')} {value:.2f}"
            )
            for row, side in enumerate(SIDES):
                axis = axes[row if is_graph else 0][column]
                if is_graph:
                    places = own.kept(side)
                    ends = own.kept_edges(side)
                    look = {
                        "colors": SIDE_COLOURS[side],
                        "linewidths": 0.3,
                        "alpha": 0.2,
                        "rasterized": True,
                    }
                    axis.add_collection(
                        LineCollection(places[ends[:: len(ends) // MOST_EDGES + 1]], **look)
                    )
                    style.dots(axis, places, 1.5, "black")
                else:
                    style.dots(axis, own.seen(own.graphs[side].points), 2, SIDE_COLOURS[side])
                axis.set(xticks=[], yticks=[])
                axis.set_aspect("equal", adjustable="datalim")
                if column == 0 and is_graph:
                    axis.set_ylabel("real" if side == "real" else "simulated")
        save(figure, path)


def main(run):
    """Write the four pictures."""
    results = read_results(run)
    pair_id = results.pairs.pair_id.iloc[0]
    draw_surface(results, pair_id, FOLDER / "read_surface.png")
    draw_piece(results, pair_id, FOLDER / "read_pieces.png")
    geometry = [Example("", "cdc", value) for value in (0.03, 0.15, 0.35)]
    draw_objects(results, geometry, FOLDER / "read_cdc.png", is_graph=False)
    structure = [Example("", "r_lambda", value, most_rms_m=0.5) for value in (0.1, 0.4, 0.7)]
    draw_objects(results, structure, FOLDER / "read_r_lambda.png", is_graph=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
