"""Files of fidpipe export, read back by other libraries: every value is that of the run's tables."""

import json
import shutil
import sys

import numpy as np
import pandas as pd
import pytest
import trimesh
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.spatial import cKDTree

import fidpipe
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.exchange.export import POINT, STATUSES, export_run, message_times
from fidpipe.schemas.errors import FidpipeError, RunError
from fidpipe.schemas.settings import load
from runs import command
from runs import run as run_dataset
from scenes import box, drifted, write_dataset, write_pair

POINT_FIELD = {5: "<i4", 2: "u1", 8: "<f8"}
SIDES = ("real", "sim")


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    """Three streets: one drifted with a house invented and the bus gone, one drifted, one the same on both sides."""
    folder = write_dataset(tmp_path_factory.mktemp("data") / "streets", 3)
    real = read_scan(folder / "real" / "000.bin").points
    real = np.vstack(
        [real, box([20, -20, 0.5], [6, 2, 2], 120), box([25, 25, 0.5], [2, 2, 2], 90)]
    )
    invented, few = box([-30, -30, 2], [2, 2, 2], 60), box([25, 25, 0.5], [2, 2, 2], 5)
    write_pair(folder, real, np.vstack([drifted(real[real[:, 0] <= 15]), invented, few]), "000")
    shutil.copy(folder / "real" / "002.bin", folder / "sim" / "002.bin")
    return folder


@pytest.fixture(scope="module", params=["paper", "reference"])
def exported(request, dataset, tmp_path_factory):
    """A run, and the folder with both formats of it."""
    out = tmp_path_factory.mktemp(request.param) / "streets"
    run_dataset(dataset, out, load(None, preset=request.param))
    run = fidpipe.open_run(out)
    export_run(run, out / "export", mcap=True, ply=True)
    return run, out / "export"


@pytest.fixture
def run(exported):
    return exported[0]


@pytest.fixture
def folder(exported):
    return exported[1]


@pytest.fixture(scope="module")
def timed(dataset, tmp_path_factory):
    """Runs the pairs a and b with other stamps."""
    base = tmp_path_factory.mktemp("timed")

    def run_with(*stamps):
        rows = [
            f"{'ab'[i]},{dataset}/real/00{i}.bin,{dataset}/sim/00{i}.bin,{stamp}"
            for i, stamp in enumerate(stamps)
        ]
        (base / "pairs.csv").write_text(
            "\n".join(["pair_id,real,sim,timestamp_s", *rows]) + "\n"
        )
        run_dataset(base, base / "run")
        return fidpipe.open_run(base / "run")

    return run_with


def read_mcap(path):
    """By topic, the time of each message and its points or text."""
    store = get_typestore(Stores.EMPTY)
    topics = {}
    with Reader(path) as bag:
        for connection in bag.connections:  # the types as the file itself defines them
            store.register(get_types_from_msg(connection.msgdef.data, connection.msgtype))
        for connection, time_ns, content in bag.messages():
            message = store.deserialize_cdr(content, connection.msgtype)
            value = message.data if connection.topic == "/fidpipe/scores" else cloud(message)
            if connection.topic != "/fidpipe/scores":
                assert (
                    message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_ns
                )
            topics.setdefault(connection.topic, []).append((time_ns, value))
    return topics


def cloud(message):
    fields = message.fields
    layout = np.dtype(
        {
            "names": [field.name for field in fields],
            "formats": [POINT_FIELD[field.datatype] for field in fields],
            "offsets": [field.offset for field in fields],
            "itemsize": message.point_step,
        }
    )
    return np.frombuffer(message.data.tobytes(), layout)


def wanted_points(run, pair_id, side):
    """The points of a side with object and scores, joined by pandas from the files."""
    read = lambda table, part: pd.read_parquet(run.folder / table / f"{pair_id}{part}.parquet")  # noqa: E731
    ground = read("ground", f".{side}")
    communities = read("communities", f".{side}")
    fates = read("matching", "").rename(columns={"status": "fate"})[
        ["real_id", "sim_id", "fate"]
    ]
    fates = fates.merge(read("metrics", ""), on=["real_id", "sim_id"], how="left")
    fates = fates[fates[f"{side}_id"].notna()]
    points = ground.merge(communities[["point_id", "community_id"]], on="point_id", how="left")
    known = fates[[f"{side}_id", "fate", "status", "r_lambda", "cdc"]]
    return points.merge(known, left_on="community_id", right_on=f"{side}_id", how="left")


def test_the_points_in_mcap_are_those_of_the_tables(run, folder):
    topics = read_mcap(folder / "streets.mcap")
    seen = set()
    for side in SIDES:
        for (_, points), pair_id in zip(
            topics[f"/fidpipe/{side}"], ["000", "001", "002"], strict=True
        ):
            wanted = wanted_points(run, pair_id, side)
            for name in ("x", "y", "z", "r_lambda", "cdc"):
                np.testing.assert_array_equal(
                    points[name], wanted[name].to_numpy(dtype=float), err_msg=name
                )
            np.testing.assert_array_equal(points["community"], wanted.community_id.fillna(-1))
            status = (
                wanted.status.fillna(wanted.fate)
                .where(wanted.community_id.notna(), "ground")
                .fillna("not_found")
            )
            assert [STATUSES[code] for code in points["status"]] == status.tolist()
            seen |= set(status)
    assert seen >= {"ground", "scored", "identical", "not_found", "extra"}
    sim = topics["/fidpipe/sim"][0][1]
    remnants = np.unique(sim["community"][sim["status"] == STATUSES.index("not_found")])
    # the box that is simulated by a few points
    assert remnants.tolist() == ([5] if run.preset == "reference" else [])


def test_distances_are_to_the_other_side_and_have_the_median_of_the_table(run, folder):
    topics = read_mcap(folder / "streets.mcap")
    for i, pair_id in enumerate(["000", "001", "002"]):
        both = {side: topics[f"/fidpipe/{side}"][i][1] for side in SIDES}
        coverage = run.table("coverage", [pair_id]).to_pandas()
        for side, other in (SIDES, SIDES[::-1]):
            own = both[side][both[side]["community"] >= 0]
            others = both[other][both[other]["community"] >= 0]
            assert np.isnan(both[side]["distance_m"][both[side]["community"] < 0]).all()
            here = np.array([own[c] for c in "xyz"]).T
            there = np.array([others[c] for c in "xyz"]).T
            nearest, _ = cKDTree(there).query(here)
            np.testing.assert_allclose(own["distance_m"], nearest, atol=1e-12)
            for row in coverage[coverage.side == side].itertuples():
                of_object = (
                    own
                    if pd.isna(row.community_id)
                    else own[own["community"] == row.community_id]
                )
                if len(of_object):
                    assert np.median(of_object["distance_m"]) == row.median_distance_m


def test_the_objects_in_mcap_are_those_of_the_tables(run, folder):
    topics = read_mcap(folder / "streets.mcap")
    for side, other in (SIDES, SIDES[::-1]):
        for (_, objects), pair_id in zip(
            topics[f"/fidpipe/{side}_objects"], ["000", "001", "002"], strict=True
        ):
            wanted = run.objects.query("pair_id == @pair_id and side == @side and n_points > 0")
            metrics = run.metrics.query("pair_id == @pair_id").set_index(f"{side}_id")
            covered = (
                run.table("coverage", [pair_id])
                .to_pandas()
                .query("side == @side")
                .set_index("community_id")
            )
            ids = objects["community"]
            assert ids.tolist() == wanted.community_id.tolist()
            for name, column in {
                "x": "x_m",
                "y": "y_m",
                "z": "z_m",
                "n_points": "n_points",
            }.items():
                np.testing.assert_array_equal(objects[name], wanted[column])
            for name in ("r_lambda", "cdc", "r_gap", "centroid_distance_m", "alignment_rms_m"):
                np.testing.assert_array_equal(
                    objects[name], metrics[name].reindex(ids).to_numpy(dtype=float)
                )
            for name in ("covered_0p3m", "median_distance_m"):
                np.testing.assert_array_equal(
                    objects[name], covered[name].loc[ids].to_numpy(dtype=float)
                )
            np.testing.assert_array_equal(
                objects["partner"], metrics[f"{other}_id"].reindex(ids).fillna(-1)
            )


def test_the_scores_of_each_pair_are_a_message_of_json(run, folder):
    texts = read_mcap(folder / "streets.mcap")["/fidpipe/scores"]
    assert [json.loads(text) for _, text in texts] == run.scored


def test_ply_read_by_trimesh_holds_the_same_points_as_scalar_fields(folder):
    topics = read_mcap(folder / "streets.mcap")
    for side in SIDES:
        for (_, points), pair_id in zip(
            topics[f"/fidpipe/{side}"], ["000", "001", "002"], strict=True
        ):
            read = trimesh.load(folder / f"{pair_id}.{side}.ply")
            np.testing.assert_array_equal(read.vertices, np.array([points[c] for c in "xyz"]).T)
            rows = read.metadata["_ply_raw"]["vertex"]["data"]
            for name in set(POINT.names) - set("xyz"):
                column = rows[f"scalar_{name}"].reshape(-1)
                assert column.dtype == POINT[name]
                np.testing.assert_array_equal(column, points[name])


@pytest.mark.parametrize(
    ("stamps", "wanted"),
    [
        (["12.5", "10.25"], {"a": 12_500_000_000, "b": 10_250_000_000}),
        (["12.5", ""], None),
        (["12.5", "12.5"], None),
        (["-1", "10"], None),
        (["1", "3e9"], None),
    ],
)
def test_stamps_are_those_of_the_dataset_if_every_pair_has_its_own(
    timed, tmp_path, stamps, wanted
):
    run = timed(*stamps)
    times_ns, stamps_of = message_times(run, ["a", "b"])
    assert stamps_of == ("of the dataset" if wanted else "one second apart")
    assert times_ns == (wanted or {"a": 1_000_000_000, "b": 2_000_000_000})
    export_run(run, tmp_path, mcap=True)
    messages = read_mcap(tmp_path / "run.mcap")["/fidpipe/scores"]
    assert [(time_ns, json.loads(text)["pair_id"]) for time_ns, text in messages] == sorted(
        (time_ns, name) for name, time_ns in times_ns.items()
    )


def test_only_pairs_that_match_are_exported(run, tmp_path):
    lines = export_run(run, tmp_path, "*1", ply=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["001.real.ply", "001.sim.ply"]
    assert lines[:2] == [f"PLY:    2 files in {tmp_path}", "pairs:  1"]
    with pytest.raises(RunError, match=r"'x\*'"):
        export_run(run, tmp_path, "x*", ply=True)


@pytest.mark.parametrize(
    ("name", "options"), [("streets.mcap", {"mcap": True}), ("001.sim.ply", {"ply": True})]
)
def test_an_existing_file_stays_unless_it_is_to_be_replaced(
    run, folder, tmp_path, name, options
):
    other = b"ply\nformat ascii 1.0\nend_header\n"
    (tmp_path / name).write_bytes(other)
    with pytest.raises(RunError, match=f"{name}: .*--replace"):
        export_run(run, tmp_path, **options)
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [other]
    export_run(run, tmp_path, **options, replace=True)
    assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def test_an_export_that_stops_midway_leaves_the_file_of_before(run, tmp_path):
    whole = shutil.copytree(run.folder, tmp_path / "streets")
    export_run(fidpipe.open_run(whole), tmp_path / "out", mcap=True)
    before = (tmp_path / "out" / "streets.mcap").read_bytes()
    (whole / "objects" / "002.sim.parquet").unlink()
    with pytest.raises(RunError, match=r"objects/002\.sim\.parquet"):
        export_run(fidpipe.open_run(whole), tmp_path / "out", mcap=True, replace=True)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["streets.mcap"]
    assert (tmp_path / "out" / "streets.mcap").read_bytes() == before


def test_without_rosbags_the_install_command_is_said_and_ply_is_written(
    run, tmp_path, monkeypatch
):
    monkeypatch.setitem(sys.modules, "rosbags", None)
    with pytest.raises(FidpipeError, match=r'pip install "fidpipe\[ros\]"'):
        export_run(run, tmp_path, mcap=True)
    assert "pairs:  3" in export_run(run, tmp_path, ply=True)


def test_the_command_says_what_it_wrote(run):
    result = command(
        "export",
        run.folder,
        "--mcap",
        "--ply",
        "--pairs",
        "00[01]",
        "--out",
        run.folder / "two",
        code=0,
    )
    assert "streets.mcap, stamps one second apart" in result.stdout
    assert "PLY:    4 files in" in result.stdout
    assert "0 ground, 1 scored, 2 identical, 3 too_small, 4 not_found, 5 extra" in result.stdout
    assert result.stderr == ""
