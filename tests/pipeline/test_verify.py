"""A finished run is recomputed: what does not agree is named, also what was forged to agree with all else."""

import json
import os
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

from fidpipe.pipeline.jobs import EXTRAS, STAGES
from fidpipe.pipeline.verify import compare_frames, recompute
from fidpipe.pipeline.verify.compare_frames import NOT_COMPARED, compare
from fidpipe.pipeline.verify.verify import verify_run
from fidpipe.pipeline.verify.verify_view import verify_view
from fidpipe.schemas.errors import RunError
from fidpipe.schemas.metric_catalogue import OBJECT_METRICS
from fidpipe.schemas.sensor_models import SENSORS
from fidpipe.schemas.settings import load
from fidpipe.schemas.tables import TABLES
from fidpipe.stages.generate.street_scans import make_pair
from fidpipe.stages.literal import literal_method
from reports import text_of
from runs import command, contents, flip, rewrite, run, some_of
from scenes import box, drifted, street, write_dataset, write_pair
from toys import TOY_TABLES

SMALL = ["matching.delta_m=20"]  # the objects of so small a street are matched all the same
WITH_EXTRAS = [*SMALL, "metrics.baselines=all", "stability.seeds=2"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run of one small labelled pair with all baselines and another seed; not to be written to."""
    folder = tmp_path_factory.mktemp("verify")
    for scan in write_dataset(folder / "streets", 1, n=60).glob("*/*.bin"):
        x, y = np.fromfile(scan, "<f4").reshape(-1, 4)[:, :2].T
        (((x > 0) + 1) | ((y > 0) + 1) << 16).astype("<u4").tofile(scan.with_suffix(".label"))
    run(folder / "streets", folder / "run", load(None, WITH_EXTRAS))
    return folder / "run"


@pytest.fixture(scope="module")
def with_rays(tmp_path_factory):
    """A run of one labelled pair from sensors whose beams are recognised; not to be written to."""
    folder = tmp_path_factory.mktemp("rays")
    pair = make_pair(0, 0, SENSORS["vlp16"], 4000)
    for side, scan in (("real", pair.real), ("sim", pair.sim)):
        (folder / "streets" / side).mkdir(parents=True)
        scan.rows.tofile(folder / "streets" / side / "000.bin")
        (scan.object_ids % 3 + 1).astype("<u4").tofile(folder / "streets" / side / "000.label")
    run(folder / "streets", folder / "run", load(None, [*SMALL, "input.intensity_scale=same"]))
    return folder / "run"


@pytest.fixture(scope="module")
def verified(whole, with_rays):
    """The verification of both in full: by name of the fixture."""
    return {"whole": verify_run(whole, None), "with_rays": verify_run(with_rays, None)}


@pytest.fixture
def copy(whole, tmp_path):
    """A copy of the run that a test may spoil."""
    return shutil.copytree(whole, tmp_path / "run")


def forge(folder, name, column, change):
    """Changes a value of a table so that file, footer and ledger agree; `change` gives the row and the new value."""

    def edit(rows):
        values = rows.column(column).to_pylist()
        row, value = change(values)
        values[row] = value
        i = rows.schema.get_field_index(column)
        return rows.set_column(i, rows.schema.field(i), pa.array(values, rows.schema.field(i).type))

    rewrite(folder, name, edit)


def another(values, *, is_text=False):
    """A row with a value, and one that is a little different from it; where all are null, some value for the first."""
    row = next((i for i, value in enumerate(values) if value is not None), 0)
    value = values[row]
    if value is None:
        return row, "too_small" if is_text else 1.0
    if isinstance(value, bool):
        return row, not value
    if isinstance(value, str):
        return row, f"{value}x"
    return row, value + 1 if isinstance(value, int) else float(np.float32(value * 1.001 + 0.001))


def test_all_numbers_of_a_run_agree(verified):
    result = verified["whole"]
    assert result.passed, result.mismatches
    assert verified["with_rays"].passed, verified["with_rays"].mismatches
    assert (result.n_drawn, result.n_pairs, result.n_scans) == (result.n_objects, 1, 1)
    assert {table.table for table in result.tables} == {
        *("files", "scan", "ground", "sensor", "graph", "communities", "objects", "matching", "coverage", "surface"),
        *("pieces", "rays", "ray_scores", "selection", "metrics", "baselines", "seeds", "pairs"),
        *("run.json", "rows"),
    }
    assert all(table.n_numbers > 0 for table in result.tables if "ray" not in table.table)
    assert result.tables[-1].largest < 1e-12


FILES = {
    "ground": "ground/000.sim.parquet",
    "sensor": "sensor/000.real.parquet",
    "graph": "graph/000.real.parquet",
    "communities": "communities/000.sim.parquet",
    "objects": "objects/000.real.parquet",
    **{name: f"{name}/000.parquet" for name in ("matching", "coverage", "surface", "pieces", "selection", "metrics")},
    **{name: f"{name}/000.parquet" for name in ("baselines", "seeds", "rays", "ray_scores")},
    "pairs": "pairs.parquet",
}
RAYS = ("rays", "ray_scores")
#: Tables of which all columns are forged at once, but for those by which rows are found and counts of other tables.
AT_ONCE = ("sensor", "objects", "matching", "coverage", "surface", "pieces", "metrics", "seeds", "pairs", *RAYS)
ONE_BY_ONE = {
    *("pair_id", "side", "real_id", "sim_id", "community_id", "piece_id", "seed", "status", "reason"),
    *("n_points", "n_real", "n_sim", "n_keep", "centroid_distance_m", "beam", "column", "by", "band"),
}
COLUMNS = {
    table: [name for name in TABLES[table].schema.names if f"{table}.{name}" not in NOT_COMPARED] for table in FILES
}
SINGLE = [
    (table, name)
    for table, names in COLUMNS.items()
    for name in names
    if table not in AT_ONCE or (name in ONE_BY_ONE and table not in RAYS)
]
FEW = [
    *(("ground", "x"), ("graph", "length_m"), ("communities", "community_id"), ("matching", "sim_id")),
    *(
        ("selection", "sim_point_id"),
        ("baselines", "value"),
        ("surface", "n_points"),
        ("metrics", "status"),
    ),
]


def forge_column(folder, table, name):
    is_text = pa.types.is_string(pq.read_schema(folder / FILES[table]).field(name).type)
    forge(folder, FILES[table], name, lambda values: another(values, is_text=is_text))


@pytest.mark.parametrize(("table", "column"), some_of(SINGLE, FEW))
def test_an_edited_number_is_found_though_the_ledger_agrees(whole, plain, tmp_path, table, column):
    copy = shutil.copytree(whole if table in ("baselines", "seeds") else plain, tmp_path / "run")
    forge_column(copy, table, column)
    try:
        result = verify_run(copy, None)
    except RunError as error:
        assert table == "pairs", error  # names and states of pairs: nothing can be looked up
        return
    wrong = {"pairs" if mismatch.table == "run.json" else mismatch.table for mismatch in result.mismatches}
    assert not result.passed
    assert "files" not in wrong, "the edit was to be found by its number"
    assert wrong & {table, "rows", "pairs", "scan", "metrics"}, wrong


@pytest.mark.parametrize("table", AT_ONCE)
def test_each_edited_column_is_named_though_all_of_a_table_are_edited_at_once(
    whole, with_rays, tmp_path, monkeypatch, table
):
    monkeypatch.setattr(compare_frames, "MAX_LISTED", 10**6)
    copy = shutil.copytree(with_rays if table in (*RAYS, "pairs") else whole, tmp_path / "run")
    names = {*COLUMNS[table]} - ONE_BY_ONE
    assert table != "rays" or len(pd.read_parquet(copy / table)) > 1000
    for name in names:
        forge_column(copy, table, name)
    n_objects = 1 if table == "pairs" else None
    found = {mismatch.column for mismatch in verify_run(copy, n_objects).mismatches if mismatch.table == table}
    assert names - found == set()


def test_every_column_of_every_table_is_compared_or_declared_not_to_be(verified):
    result = verified["whole"]
    assert result.unknown == ()
    tables = (*result.tables, *verified["with_rays"].tables)
    compared = {f"{own.table}.{column}" for own in tables for column in own.columns}
    of_runs = [table for stage in (*STAGES, *EXTRAS) for table in stage.gives]
    columns = {f"{table}.{name}" for table in [*of_runs, "pairs"] for name in TABLES[table].schema.names}
    assert columns - compared <= NOT_COMPARED.keys()
    assert NOT_COMPARED.keys() <= columns | {"timings"}, "what is declared is there"
    experiments = {name for name in TABLES if name.startswith(("perturb_", "ablate"))}
    assert TABLES.keys() == {*of_runs, "pairs", "timings", *experiments, *(table.name for table in TOY_TABLES)}
    for name, why in NOT_COMPARED.items():
        assert f"{name}: {why}" in result.not_compared


def test_a_score_that_the_literal_twin_does_not_know_is_said_to_be_unverified(plain, monkeypatch):
    spectral = literal_method.spectral
    monkeypatch.setattr(literal_method, "spectral", lambda *matrices: without(spectral(*matrices), "gap_sim"))
    monkeypatch.setattr(
        literal_method, "SPECTRAL", tuple(name for name in literal_method.SPECTRAL if name != "gap_sim")
    )
    result = verify_run(plain, None)
    assert result.passed
    assert result.unknown == ("metrics.gap_sim",)
    assert result.as_dict()["unknown"] == ("metrics.gap_sim",)
    shown = text_of(verify_view(result), 200)
    assert "not recomputed: metrics.gap_sim" in shown
    assert "numbers agree; not verified: 1 of their columns" in shown


def test_a_table_that_nobody_compares_is_said_to_be_unverified(plain, monkeypatch):
    monkeypatch.delitem(recompute.RECOMPUTED, "coverage")
    assert [name for name in verify_run(plain, None).unknown if name.startswith("coverage.")] == [
        f"coverage.{name}" for name in TABLES["coverage"].schema.names if name != "pair_id"
    ]


def test_a_column_that_the_schema_does_not_know_is_named(copy):
    rewrite(copy, FILES["metrics"], lambda rows: rows.append_column("emissivity", pa.array([0.0] * len(rows))))
    result = verify_run(copy, None)
    assert not result.passed
    assert any("emissivity" in mismatch.recomputed for mismatch in result.mismatches)


def without(values, name):
    return {key: value for key, value in values.items() if key != name}


def test_a_mismatch_names_table_pair_object_column_and_both_values(copy):
    forge(copy, FILES["metrics"], "cdc", lambda values: (2, values[2] + 1e-6))
    stored = pq.read_table(copy / FILES["metrics"], partitioning=None).to_pylist()[2]
    (mismatch, *_) = verify_run(copy, None).mismatches
    assert (mismatch.table, mismatch.pair_id, mismatch.column) == ("metrics", "000", "cdc")
    assert mismatch.object == f"real {stored['real_id']}, sim {stored['sim_id']}"
    assert float(mismatch.stored) == stored["cdc"]
    assert float(mismatch.recomputed) == pytest.approx(stored["cdc"] - 1e-6, abs=1e-9)
    found = command("verify", copy, "--all", code=4)
    line = next(line for line in found.stdout.splitlines() if line.startswith("wrong: metrics"))
    assert line == (
        f"wrong: metrics, pair 000, object {mismatch.object}, cdc: "
        f"stored {mismatch.stored}, recomputed {mismatch.recomputed}"
    )


def test_a_flipped_bit_is_found_in_any_file(copy, monkeypatch):
    monkeypatch.setattr(compare_frames, "MAX_LISTED", 10**6)
    names = {*FILES.values()} - {"pairs.parquet"}
    for name in (copy / name for name in names):
        flip(name, name.stat().st_size // 3)
    found = [mismatch.column for mismatch in verify_run(copy, 1).mismatches if mismatch.table == "files"]
    assert names == {name.removeprefix("SHA-256 of ") for name in found}
    flip(copy / "pairs.parquet", 1000)
    with pytest.raises(RunError, match=r"pairs\.parquet"):
        verify_run(copy, 1)


def test_no_flipped_bit_ends_verify_otherwise(plain, tmp_path):
    copy = shutil.copytree(plain, tmp_path / "run")
    file = copy / FILES["matching"]
    whole = file.read_bytes()
    for place in range(len(whole) - 600, len(whole), 41):  # the footer, which pyarrow would accept
        file.write_bytes(whole[:place] + bytes([whole[place] ^ 32]) + whole[place + 1 :])
        assert [mismatch.table for mismatch in verify_run(copy, 1).mismatches] == ["files"]


def test_a_file_that_is_gone_or_none_of_the_run_s_own_is_found(copy, tmp_path):
    file = copy / FILES["metrics"]
    elsewhere = file.rename(tmp_path / "metrics.parquet")
    for replace in (lambda: None, lambda: file.symlink_to(elsewhere), lambda: os.mkfifo(file)):  # never ends if read
        file.unlink(missing_ok=True)
        replace()
        assert any(mismatch.column.endswith(FILES["metrics"]) for mismatch in verify_run(copy, 1).mismatches)


def test_a_run_of_another_version_of_a_stage_is_rejected(copy):
    record = orjson.loads((copy / "run.json").read_bytes())
    record["stages"]["coverage"] -= 1
    (copy / "run.json").write_bytes(orjson.dumps(record))
    with pytest.raises(RunError, match="coverage by another version of fidpipe; recompute it with fidpipe run"):
        verify_run(copy, 2)


def test_changed_scans_are_not_taken_for_those_of_the_run_and_without_any_all_else_is_compared(tmp_path):
    dataset = write_dataset(tmp_path / "streets", 2, n=40)
    run(dataset, tmp_path / "run")
    scan = dataset / "sim" / "001.bin"
    scan.write_bytes(scan.read_bytes()[16:])
    changed = verify_run(tmp_path / "run")
    assert (changed.passed, changed.n_pairs, changed.n_scans) == (True, 2, 1)
    assert any("pair 001" in what and "have changed" in what for what in changed.not_compared)
    shutil.rmtree(dataset)
    gone = verify_run(tmp_path / "run")
    assert (gone.passed, gone.n_pairs, gone.n_scans) == (True, 2, 0)
    assert "scan" not in {table.table for table in gone.tables}
    assert any("no such folder" in what for what in gone.not_compared)


def test_nothing_is_written_and_a_seed_draws_the_same_objects(whole):
    before = contents(whole)
    first, again, other = (verify_run(whole, 2, seed) for seed in (0, 0, 1))
    assert first == again
    assert other.tables != first.tables
    assert first.n_drawn == 2
    assert contents(whole) == before


def test_the_json_has_what_the_terminal_says(whole):
    found = command("verify", whole, "--objects", 2, "--json", code=0)
    result = json.loads(found.stdout)
    assert result["passed"] is True
    assert result["n_wrong"] == 0
    assert result["n_numbers"] == sum(table["n_numbers"] for table in result["tables"])
    assert command("verify", whole.parent, "--objects", 2).returncode == 1


def wrong(stored, recomputed, **options):
    """By column, the rows and values that differ; the rows are numbered."""
    frames = [pd.DataFrame(own).rename_axis("real_id") for own in (stored, recomputed)]
    return {
        own.column: [(own.rows[i], own.stored[i], own.recomputed[i]) for i in np.flatnonzero(own.is_wrong)]
        for own in compare("metrics", *frames, **options)
        if own.is_wrong.any()
    }


def test_a_comparison_tells_null_from_a_number_and_words_from_each_other():
    stored = {"r_gap": [None, 1.0, None], "status": ["scored", "scored", None], "cdc": [1.0 + 1e-10, 2.0, 3.0]}
    recomputed = {"r_gap": [None, None, 2.0], "status": ["scored", "identical", ""], "cdc": [1.0, 2.0, 3.0]}
    found = wrong(stored, recomputed)
    assert repr([tuple(map(float, own)) for own in found.pop("r_gap")]) == "[(1.0, 1.0, nan), (2.0, nan, 2.0)]"
    assert found == {"status": [(1, "scored", "identical"), (2, None, "")]}
    assert wrong({"cdc": [1.0]}, {"cdc": [1.0 + 1e-8]}).keys() == {"cdc"}


def test_a_comparison_finds_rows_that_are_missing_surplus_or_there_twice():
    rows = pd.DataFrame({"n_real": [4, 5, 6]})
    assert wrong(rows.iloc[[0, 2]], rows) == {"row": [(1, "absent", "present")]}
    assert wrong(rows, rows.iloc[:2]) == {"row": [(2, "present", "absent")]}
    assert wrong(rows, rows.iloc[:2], is_whole=False) == {}
    assert wrong(rows.iloc[[0, 1, 1, 2]], rows) == {"row": [(1, "present", "absent")]}


@pytest.mark.parametrize("column", ["n_real", "status", "graph.length_m", "surface.shift_m"])
def test_a_comparison_has_the_tolerance_of_the_column(column):
    table, _, name = column.rpartition(".")
    stored, near, far = {"n_real": (7, 7, 8), "status": ("a", "a", "b"), "length_m": (0.25, 0.25, 0.25 + 1e-13),
                         "shift_m": (1.0, 1.0 + 5e-9, 1.0 + 5e-8)}[name]  # fmt: skip
    for value, is_wrong in ((near, False), (far, True)):
        frames = (pd.DataFrame({name: [own]}) for own in (stored, value))
        (found,) = compare(table or "metrics", *frames)
        assert found.is_wrong.tolist() == [is_wrong]


WORDS = ["matching.delta_m=6", "metrics.baselines=chamfer", "ground.prior_m=0.25"]


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """A run of one labelled pair with matched and missing objects, which takes less time to verify."""
    folder = tmp_path_factory.mktemp("forged")
    real = np.vstack([street(seed=3, n=90), box([14, -3, 0], [1, 1, 1], 40), box([-15, 12, 0], [1, 2, 1], 30)])
    sim = np.vstack([drifted(real[:-30], seed=4), box([15, 14, 1], [1, 1, 1], 40)])
    write_pair(folder / "data", real, sim, "000", lambda points: (points[:, 0] > 0) + 1)
    run(folder / "data", folder / "run", load(None, WORDS))
    assert verify_run(folder / "run", None).passed
    return folder / "run"


@pytest.fixture
def forged(plain, tmp_path):
    return shutil.copytree(plain, tmp_path / "run")


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


@pytest.mark.parametrize("seed", range(4))
def test_a_sample_without_matched_objects_leaves_nothing_unexplained(plain, seed):
    assert verify_run(plain, 1, seed).unknown == ()


SWAPPED = [
    *("ground/000.real", "graph/000.sim", "communities/000.real", "objects/000.sim", "matching/000"),
    *("selection/000", "metrics/000", "coverage/000", "surface/000", "baselines/000"),
]


def with_one_edge_more(frame):
    src = frame.src[0]
    dst = max(set(frame.dst) - set(frame.dst[frame.src == src]))
    return pd.concat([frame, frame.iloc[[0]].assign(dst=dst, length_m=np.float32(3))]).sort_values(["src", "dst"])


def exchange_communities(frame):
    i, j = (frame.index[frame.community_id == own][0] for own in (0, 1))
    frame.loc[[i, j], "community_id"] = frame.loc[[j, i], "community_id"].to_numpy()


FORGERIES = {f"two rows of {name} swapped": (name, swap_rows) for name in SWAPPED} | {
    "an edge less": ("graph/000.real", lambda frame: frame.drop(index=len(frame) // 2)),
    "an edge more": ("graph/000.sim", with_one_edge_more),
    "two points have the communities of each other": ("communities/000.real", exchange_communities),
    "a covered row twice": ("coverage/000", lambda frame: pd.concat([frame.iloc[:1], frame])),
    "a row of coverage less": ("coverage/000", lambda frame: frame.drop(index=1)),
    "an aligned node less": ("selection/000", lambda frame: frame.drop(index=frame.index[frame.real_id == 0][-1])),
}
#: Those that are hard to see: agreeing with everything else, or small.
HARD_TO_SEE = [
    "two rows of graph/000.sim swapped",
    "an edge less",
    "two points have the communities of each other",
]


@pytest.mark.parametrize("name", some_of(FORGERIES, HARD_TO_SEE))
def test_a_forged_table_is_found(forged, name):
    table, change = FORGERIES[name]
    file = f"{table}.parquet"
    before = pq.read_table(forged / file)
    edit(forged, file, change)
    assert not pq.read_table(forged / file).equals(before), "the forgery changes something"
    result = verify_run(forged, None)
    assert not result.passed
    assert "files" not in {mismatch.table for mismatch in result.mismatches}


def test_points_of_another_object_of_the_reference_are_found(plain, tmp_path):
    run(plain.parent / "data", tmp_path / "run", load(None, preset="reference"))
    groups = pq.read_table(tmp_path / "run/communities/000.sim.parquet").column("community_id").to_numpy()
    assert groups.max() > 1
    for i, old in enumerate((0, groups.max())):
        forged = shutil.copytree(tmp_path / "run", tmp_path / f"forged-{i}")

        def move(frame, old=old):
            row = frame.index[frame.community_id == old][-1]
            frame.loc[row, "community_id"] = 1

        edit(forged, "communities/000.sim.parquet", move)
        assert "communities" in {mismatch.table for mismatch in verify_run(forged, None).mismatches}


def test_communities_of_another_resolution_are_found_though_their_numbers_are_in_order(plain, tmp_path, monkeypatch):
    """As if the stage called its library with another parameter."""
    find = Louvain.__init__
    monkeypatch.setattr(Louvain, "__init__", lambda own, **options: find(own, **options | {"resolution": 0.8}))
    run(plain.parent / "data", tmp_path / "run", load(None, WORDS))
    monkeypatch.undo()
    wrong = {mismatch.table for mismatch in verify_run(tmp_path / "run", None).mismatches}
    assert wrong == {"communities"}


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


def summarised(folder, metrics):
    """Puts means and deviations of an edited table of metrics into `pairs`."""

    def change(frame):
        for name in OBJECT_METRICS:
            frame[f"{name}_mean"], frame[f"{name}_std"] = metrics[name].mean(), metrics[name].std()

    edit(folder, "pairs.parquet", change)


def metrics_of(folder):
    return pq.read_table(folder / "metrics/000.parquet", partitioning=None).to_pandas()


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

    edit(forged, "matching/000.parquet", part)
    for table in ("selection", "metrics", "baselines"):
        edit(forged, f"{table}/000.parquet", lambda frame: frame[(frame.real_id != real_id).fillna(True)])
    summarised(forged, metrics.iloc[:-1])

    def count(frame):
        for name, by in (("n_matched", -1), ("n_scored", -1), ("n_missing", 1), ("n_hallucinated", 1)):
            frame[name] = frame[name] + by
        frame["match_rate"] = frame.n_matched / (frame.n_matched + frame[["n_missing", "n_hallucinated"]].max(axis=1))

    edit(forged, "pairs.parquet", count)
    assert "matching" in {mismatch.table for mismatch in verify_run(forged, None).mismatches}
