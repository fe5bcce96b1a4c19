"""Forged rows, and values that agree with each other; `test_verify` forges each column alone."""

import shutil
from functools import reduce
from operator import getitem

import numpy as np
import orjson
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from sknetwork.clustering import Louvain

from fidpipe.pipeline.verify import compare_frames
from fidpipe.pipeline.verify.verify import verify_run
from fidpipe.schemas.metric_catalogue import OBJECT_METRICS
from fidpipe.schemas.settings import load
from runs import rewrite, run, some_of
from scenes import box, drifted, street, write_bin

WORDS = ["matching.delta_m=6", "metrics.baselines=chamfer", "ground.prior_m=0.25"]
PAIRS = "pairs.parquet"


@pytest.fixture(scope="module")
def honest(tmp_path_factory):
    """A run of one labelled pair with matched, missing and hallucinated objects; not to be written to."""
    folder = tmp_path_factory.mktemp("forged")
    real = np.vstack([street(seed=3, n=90), box([14, -3, 0], [1, 1, 1], 40), box([-15, 12, 0], [1, 2, 1], 30)])
    sim = np.vstack([drifted(real[:-30], seed=4), box([15, 14, 1], [1, 1, 1], 40)])
    for side, points in (("real", real), ("sim", sim)):
        scan = write_bin(folder / "data" / side / "a.bin", points)
        ((points[:, 0] > 0) + 1).astype("<u4").tofile(scan.with_suffix(".label"))
    run(folder / "data", folder / "run", load(None, WORDS))
    assert verify_run(folder / "run", None).passed
    return folder / "run"


@pytest.fixture
def forged(honest, tmp_path):
    return shutil.copytree(honest, tmp_path / "run")


def edit(folder, name, change):
    """Changes a table as a pandas frame; `change` alters it in place or gives another one."""

    def as_frame(rows):
        frame = rows.to_pandas(types_mapper=pd.ArrowDtype)
        changed = change(frame)
        frame = frame if changed is None else changed
        return pa.Table.from_pandas(frame, schema=rows.schema, preserve_index=False).replace_schema_metadata()

    rewrite(folder, name, as_frame)


def swap_rows(frame, i=0, j=1):
    order = list(range(len(frame)))
    order[i], order[j] = j, i
    return frame.iloc[order]


def summarised(folder, metrics):
    """Puts means and deviations of an edited table of metrics into `pairs`."""

    def change(frame):
        for name in OBJECT_METRICS:
            frame[f"{name}_mean"], frame[f"{name}_std"] = metrics[name].mean(), metrics[name].std()

    edit(folder, PAIRS, change)


def metrics_of(folder):
    return pq.read_table(folder / "metrics/a.parquet", partitioning=None).to_pandas()


@pytest.mark.parametrize("seed", range(4))
def test_a_sample_without_matched_objects_leaves_nothing_unexplained(honest, seed):
    assert verify_run(honest, 1, seed).unknown == ()


SWAPPED = [
    *("ground/a.real", "graph/a.sim", "communities/a.real", "objects/a.sim", "matching/a"),
    *("selection/a", "metrics/a", "coverage/a", "surface/a", "baselines/a"),
]


def with_one_edge_more(frame):
    src = frame.src[0]
    dst = max(set(frame.dst) - set(frame.dst[frame.src == src]))
    return pd.concat([frame, frame.iloc[[0]].assign(dst=dst, length_m=np.float32(3))]).sort_values(["src", "dst"])


def exchange_communities(frame):
    i, j = (frame.index[frame.community_id == own][0] for own in (0, 1))
    frame.loc[[i, j], "community_id"] = frame.loc[[j, i], "community_id"].to_numpy()


FORGERIES = {f"two rows of {name} swapped": (name, swap_rows) for name in SWAPPED} | {
    "an edge less": ("graph/a.real", lambda frame: frame.drop(index=len(frame) // 2)),
    "an edge more": ("graph/a.sim", with_one_edge_more),
    "two points of different communities have each other's": ("communities/a.real", exchange_communities),
    "a covered row twice": ("coverage/a", lambda frame: pd.concat([frame.iloc[:1], frame])),
    "a row of coverage less": ("coverage/a", lambda frame: frame.drop(index=1)),
    "an aligned node less": ("selection/a", lambda frame: frame.drop(index=frame.index[frame.real_id == 0][-1])),
}
#: Those that are hard to see: agreeing with everything else, or small.
FEW = ["two rows of graph/a.sim swapped", "an edge less", "two points of different communities have each other's"]


@pytest.mark.parametrize("name", some_of(FORGERIES, FEW))
def test_a_forged_table_is_found(forged, name):
    table, change = FORGERIES[name]
    file = f"{table}.parquet"
    before = pq.read_table(forged / file)
    edit(forged, file, change)
    assert not pq.read_table(forged / file).equals(before), "the forgery changes something"
    result = verify_run(forged, None)
    assert not result.passed
    assert "files" not in {mismatch.table for mismatch in result.mismatches}


def test_a_match_that_is_removed_from_every_table_is_found(forged):
    """As if delta were smaller: the match becomes a missing and a hallucinated object everywhere."""
    metrics = metrics_of(forged)
    real_id, sim_id = (int(metrics[name].iloc[-1]) for name in ("real_id", "sim_id"))

    def part(frame):
        row = frame.real_id == real_id
        frame.loc[row, ["sim_id", "centroid_distance_m"]] = None
        frame.loc[row, "status"] = "missing"
        alone = frame[row].assign(real_id=None, sim_id=sim_id, status="hallucinated")
        return pd.concat([frame, alone.astype(frame.dtypes)]).sort_values(["real_id", "sim_id"])

    edit(forged, "matching/a.parquet", part)
    for table in ("selection", "metrics", "baselines"):
        edit(forged, f"{table}/a.parquet", lambda frame: frame[(frame.real_id != real_id).fillna(True)])
    summarised(forged, metrics.iloc[:-1])

    def count(frame):
        for name, by in (("n_matched", -1), ("n_scored", -1), ("n_missing", 1), ("n_hallucinated", 1)):
            frame[name] = frame[name] + by
        frame["match_rate"] = frame.n_matched / (frame.n_matched + frame[["n_missing", "n_hallucinated"]].max(axis=1))

    edit(forged, PAIRS, count)
    assert "matching" in {mismatch.table for mismatch in verify_run(forged, None).mismatches}


def test_points_of_another_object_of_the_reference_are_found(honest, tmp_path):
    run(honest.parent / "data", tmp_path / "run", load(None, preset="reference"))
    groups = pq.read_table(tmp_path / "run/communities/a.sim.parquet").column("community_id").to_numpy()
    assert groups.max() > 1
    for i, old in enumerate((0, groups.max())):
        forged = shutil.copytree(tmp_path / "run", tmp_path / f"forged-{i}")

        def move(frame, old=old):
            row = frame.index[frame.community_id == old][-1]
            frame.loc[row, "community_id"] = 1

        edit(forged, "communities/a.sim.parquet", move)
        assert "communities" in {mismatch.table for mismatch in verify_run(forged, None).mismatches}


def test_communities_of_another_resolution_are_found_though_their_numbers_are_in_order(honest, tmp_path, monkeypatch):
    """As if the stage called its library with another parameter."""
    find = Louvain.__init__
    monkeypatch.setattr(Louvain, "__init__", lambda own, **options: find(own, **options | {"resolution": 0.8}))
    run(honest.parent / "data", tmp_path / "run", load(None, WORDS))
    monkeypatch.undo()
    wrong = {mismatch.table for mismatch in verify_run(tmp_path / "run", None).mismatches}
    assert wrong == {"communities"}


def test_a_score_that_is_wrong_in_every_table_is_found_by_its_objects(forged):
    """r_gap without the 2 in its denominator, and all means of it."""
    edit(forged, "metrics/a.parquet", lambda frame: frame.assign(r_gap=frame.r_gap * 2))
    metrics = metrics_of(forged)
    summarised(forged, metrics)
    record = orjson.loads((forged / "run.json").read_bytes())
    record["summary"]["r_gap_mean"]["mean"] = float(metrics.r_gap.mean())
    (forged / "run.json").write_bytes(orjson.dumps(record))
    wrong = {(mismatch.table, mismatch.column) for mismatch in verify_run(forged, None).mismatches}
    assert ("metrics", "r_gap") in wrong


def test_all_forged_numbers_of_a_record_are_found(forged, monkeypatch):
    monkeypatch.setattr(compare_frames, "MAX_LISTED", 10**6)
    forgeries = {
        ("summary", "match_rate", "n_pairs"): 2,
        **{("summary", name, "mean"): 0.4321 for name in ("cdc_mean", "cdc_unmatched_worst_mean", "covered_real_1m")},
        ("pairs", "failed"): 1,
        ("metrics", "unmatched", "missing", "absent"): 7,
        ("metrics", "unmatched", "hallucinated", "road"): 7,
        ("baselines", 0, "mean"): 0.5,
        ("baselines", 1, "n_null"): 1,
    }
    record = orjson.loads((forged / "run.json").read_bytes())
    for (*folders, name), value in forgeries.items():
        place = reduce(getitem, folders, record)
        assert place[name] != value
        place[name] = value
    del record["summary"]["r_lambda_mean"]
    (forged / "run.json").write_bytes(orjson.dumps(record))
    found = verify_run(forged, 1).mismatches
    assert {mismatch.table for mismatch in found} == {"run.json"}
    gone = {mismatch.column for mismatch in found if mismatch.stored == "null"}
    assert gone == {f"summary.r_lambda_mean.{key}" for key in ("mean", "n_pairs")}
    assert len(found) == len(forgeries) + len(gone)
