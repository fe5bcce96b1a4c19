"""The method on one screen gives, value for value, the tables of the command."""

import numpy as np
import pandas as pd
import pytest

from fidpipe import evaluate_pair
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.settings import Settings, load
from fidpipe.stages.method import compare, evaluate, graph_of, n_communities, partition, score
from runs import run
from scenes import drifted, moved, rigid, road, street, write_bin

SIDES = ("real", "sim")


def frames(evaluation):
    """The tables of the command, made of what the method returns; without the names of pair and side."""
    tables, point_ids = {}, {}
    for side in SIDES:
        clean, cut, scan = (getattr(evaluation, f"{name}_{side}") for name in ("clean", "cut", "objects"))
        point_ids[side] = ids = clean.point_ids[~cut.is_ground]
        x, y, z = clean.points.T
        tables["ground", side] = {
            "point_id": clean.point_ids,
            "x": x,
            "y": y,
            "z": z,
            "height_m": cut.height_m,
            "is_ground": cut.is_ground,
        }
        edges = scan.edges
        tables["graph", side] = {"src": ids[edges.src], "dst": ids[edges.dst], "length_m": edges.length_m}
        tables["communities", side] = {"point_id": ids, "community_id": scan.labels}
        objects = scan.objects
        columns = {"community_id": np.arange(len(objects.n_points)), "n_points": objects.n_points}
        columns |= {"range_m": objects.range_m}
        columns |= dict(zip(("cx", "cy", "cz"), objects.centroid.T, strict=True))
        columns |= dict(zip(("extent_x", "extent_y", "extent_z"), objects.extent.T, strict=True))
        columns |= dict(zip(("linearity", "planarity", "scattering"), objects.shape.T, strict=True))
        tables["objects", side] = columns
    matching = evaluation.scores.matching
    matched = zip(matching.pairs, matching.distance_m.tolist(), strict=True)
    rows = [(real_id, sim_id, distance_m, "matched") for (real_id, sim_id), distance_m in matched]
    rows += [(real_id, None, None, "missing") for real_id in matching.missing.tolist()]
    rows += [(None, sim_id, None, "hallucinated") for sim_id in matching.hallucinated.tolist()]
    columns = ["real_id", "sim_id", "centroid_distance_m", "status"]
    tables["matching", ""] = pd.DataFrame(rows, columns=columns).sort_values(["real_id", "sim_id"])
    selections, metrics = [], []
    members = {
        side: [np.flatnonzero(scan.labels == i) for i in range(len(scan.objects.n_points))]
        for side, scan in (("real", evaluation.objects_real), ("sim", evaluation.objects_sim))
    }
    for (real_id, sim_id), distance_m, scored in zip(
        matching.pairs, matching.distance_m, evaluation.scores.objects, strict=True
    ):
        nodes, n_keep = scored.selection, len(scored.selection.real_nodes)
        own = {"real": members["real"][real_id], "sim": members["sim"][sim_id]}
        columns = {"real_id": real_id, "sim_id": sim_id, "rank": np.arange(n_keep)}
        columns |= {"real_point_id": point_ids["real"][own["real"]][nodes.real_nodes]}
        columns |= {"sim_point_id": point_ids["sim"][own["sim"]][nodes.sim_nodes]}
        columns |= {"real_influence": nodes.real_influence, "sim_influence": nodes.sim_influence}
        selections.append(pd.DataFrame(columns))
        sizes = {"n_real": len(own["real"]), "n_sim": len(own["sim"]), "n_keep": n_keep}
        ids = {"real_id": real_id, "sim_id": sim_id, "centroid_distance_m": distance_m}
        metrics.append(ids | sizes | vars(scored.scores))
    tables["selection", ""] = pd.concat(selections)
    tables["metrics", ""] = pd.DataFrame(metrics)
    return {name: pd.DataFrame(columns) for name, columns in tables.items()}


def summary(evaluation, n_raw):
    """The row of the pair, made of what the method returns."""
    row = evaluation.scores.summary | n_communities(evaluation.scores.summary) | evaluation.surfaces
    for side in SIDES:
        clean, cut, scan = (getattr(evaluation, f"{name}_{side}") for name in ("clean", "cut", "objects"))
        row |= {f"n_{side}_raw": n_raw[side], f"n_{side}_clean": len(clean.points)}
        row |= {f"n_{side}_points": len(scan.points)}
        row |= {f"ground_{side}_{name}": getattr(cut, name) for name in ("peak_m", "threshold_m", "loss")}
        row |= {f"ground_{side}_iterations": cut.iterations, f"ground_{side}_tilt_deg": cut.tilt_deg}
        row[f"ground_{side}_removed_share"] = np.count_nonzero(cut.is_ground) / len(clean.points)
    return row


def assert_same(evaluation, tables, row, n_raw):
    """Every column of every table is the same to the last bit, but for those that a scan without labels leaves null."""
    own = frames(evaluation)
    assert own.keys() == tables.keys()
    for name, wanted in tables.items():
        columns = [c for c in wanted.columns if c not in ("pair_id", "side", "intensity", "label", "instance")]
        assert set(own[name].columns) == set(columns), name
        frame = own[name][columns].reset_index(drop=True)
        pd.testing.assert_frame_equal(
            frame, wanted[columns], check_exact=True, check_dtype=False, obj=f"{name}", rtol=0, atol=0
        )
    wanted_row = {name: value for name, value in row.items() if name not in ("pair_id", "status", "reason")}
    assert summary(evaluation, n_raw) == wanted_row


def tables_of(result):
    """The tables of one evaluated pair, by name and side."""
    names = {"ground": "points", "graph": "edges", "communities": "communities", "objects": "objects"}
    tables = {(name, side): getattr(result, field)[side] for name, field in names.items() for side in SIDES}
    return tables | {(name, ""): getattr(result, name) for name in ("matching", "selection", "metrics")}


def read_tables(folder, pair_id):
    """The tables of one pair of a run, by name and side."""
    by_side = {(name, side) for name in ("ground", "graph", "communities", "objects") for side in SIDES}
    files = by_side | {(name, "") for name in ("matching", "selection", "metrics")}
    return {
        (name, side): pd.read_parquet(folder / name / f"{pair_id}{'.' + side if side else ''}.parquet")
        for name, side in files
    }


def assert_same_as_the_command(real, sim, settings):
    result = evaluate_pair(real, sim, settings)
    n_raw = {"real": len(real), "sim": len(sim)}
    assert_same(evaluate(real, sim, settings), tables_of(result), result.summary, n_raw)


@pytest.fixture(scope="module")
def scans():
    real = street(seed=3)
    return real, drifted(real, seed=4)


@pytest.mark.filterwarnings("ignore:the simulated scan covers")  # one of the settings mirrors it
@pytest.mark.parametrize(
    "words",
    [
        [],
        ["ground.shared=true", "ground.loss=total"],
        ["input.sim_flip_y=true", "matching.delta_m=40", "matching.method=optimal"],
        ["graph.edges=intersection", "graph.k=12", "graph.tau_m=0.6", "selection.t=0.3"],
        ["communities.backend=python-louvain", "communities.seed=5", "ground.method=none", "graph.k=8"],
        ["communities.objects=reference", "graph.ties=coordinates", "communities.reach_m=0.4"],
    ],
    ids=" ".join,
)
def test_a_small_scene_has_the_tables_of_the_command(scans, words):
    assert_same_as_the_command(*scans, load(None, words))


def test_a_transformed_and_mirrored_pair_has_the_tables_of_a_run(scans, tmp_path):
    T = rigid(25, [4.0, -2.0, 0.3])
    real = scans[0]
    seen = moved(scans[1] - T[:, 3], np.column_stack([T[:, :3].T, np.zeros(3)])) * [1, -1, 1]
    write_bin(tmp_path / "a.bin", real)
    write_bin(tmp_path / "b.bin", seen)
    cell = " ".join(repr(float(value)) for value in T.ravel())
    (tmp_path / "pairs.csv").write_text(f"pair_id,real,sim,T_real_sim\nturned,a.bin,b.bin,{cell}\n")
    settings = load(None, ["input.sim_flip_y=true", "ground.shared=true"])
    (row,) = run(tmp_path, tmp_path / "run", settings).rows
    points = [read_scan(tmp_path / name).points for name in ("a.bin", "b.bin")]
    evaluation = evaluate(*points, settings, T_real_sim=T)
    n_raw = {"real": len(real), "sim": len(seen)}
    assert_same(evaluation, read_tables(tmp_path / "run", "turned"), row, n_raw)
    assert row["match_rate"] > 0.5


@pytest.mark.exhaustive
def test_a_real_pair_has_the_tables_of_the_command(real_data):
    real, sim = (read_scan(real_data / "kitti_twin" / side / "000002.bin").points for side in SIDES)
    assert_same_as_the_command(real, sim, Settings())


def test_a_side_without_objects_is_refused(scans):
    with pytest.raises(StageError, match="0 object points after ground removal"):
        evaluate(scans[0], road() * [1, 1, 0] + [0, 0, -1.7], Settings())


def test_a_graph_that_is_given_is_taken_and_another_seed_changes_the_communities_only(rng):
    points, settings = rng.normal(0, 3, (400, 3)), load(None, ["graph.k=10"])
    first = partition(points, settings)
    again = partition(points, settings, edges=first.edges)
    other = partition(points, load(None, ["graph.k=99", "communities.seed=2"]), edges=first.edges)
    np.testing.assert_array_equal(again.labels, first.labels)
    assert other.edges is first.edges
    assert (other.labels != first.labels).any()


def test_with_a_memo_no_object_is_scored_twice_and_nothing_else_changes(scans):
    settings = [load(None, [f"matching.delta_m={delta}", f"selection.t={t}"]) for t in (1, 2) for delta in (2, 60)]
    real, sim = (partition(scan[scan[:, 2] > -1.3], settings[0]) for scan in scans)
    memo = {}
    for chosen in settings:
        before = dict(memo)
        with_memo, alone = compare(real, sim, chosen, memo=memo), compare(real, sim, chosen)
        assert with_memo.summary == alone.summary
        assert [own.scores for own in with_memo.objects] == [own.scores for own in alone.objects]
        assert all(memo[key] is scored for key, scored in before.items())
    assert len(memo) == 2 * len({key[:2] for key in memo})


def test_no_common_objects_are_a_summary_without_scores():
    points = np.random.default_rng(0).normal(0, 0.1, (30, 3))
    real, sim = (partition(points + [0, place, 0], Settings()) for place in (0, 50))
    scores = compare(real, sim, Settings())
    assert scores.objects == ()
    assert (scores.summary["match_rate"], scores.summary["cdc_mean"]) == (0, None)


def test_points_as_one_object_are_scored_like_a_scan_that_is_one_community(rng):
    settings = load(None, ["graph.k=5"])
    real, sim = rng.normal(0, 1, (40, 3)), rng.normal(0.1, 1, (50, 3))
    whole = [partition(points, settings) for points in (real, sim)]
    one = [type(scan)(scan.points, scan.edges, np.zeros_like(scan.labels), scan.objects) for scan in whole]
    wanted = score(one[0].subgraphs([0])[0], one[1].subgraphs([0])[0], settings.selection)
    own = score(graph_of(real, settings), graph_of(sim, settings), settings.selection)
    assert own.scores == wanted.scores
