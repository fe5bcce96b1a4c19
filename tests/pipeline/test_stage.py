"""Inputs of a stage, and proof that its row and job are all that is needed: a toy stage of each grain."""

import shutil
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

import toys
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.jobs.points_job import object_points
from fidpipe.pipeline.stage import SCAN, JobResult, Memo
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.schemas.columns import column
from fidpipe.schemas.errors import StageError
from fidpipe.schemas.tables import TABLES
from pools import WatchedPool
from runs import assert_same_tables, changed_tables, marks, run, some_of
from toys import OF_OBJECT, OF_PAIR, OF_SIDE, TOY_TABLES, ToySettings, with_toys

N_POINTS = 100

N_PAIRS = 2
ALL_SPLIT = {"WORTH_SPLITTING_S": 0.0, "BATCH_S": 0.0}
JOBS_PER_PAIR = sum(len(stage.parts) for stage in with_toys())


def run_with_toys(dataset, out, settings=None, stages=None, **options):
    return run(dataset, out, settings or ToySettings(), stages=stages or with_toys(), **options)


def toy_results(out):
    """The tables and the facts of the toys."""
    tables = {
        str(path.relative_to(out)): pq.read_table(path)
        for table in TOY_TABLES
        for path in sorted((out / table.name).glob("*.parquet"))
    }
    ledger = RunFolder(out).ledger
    facts = {
        record.name: record.metadata
        for pair_id in ledger.pair_ids()
        for record in ledger.jobs(pair_id).values()
        if set(record.files) & set(tables)
    }
    return tables, facts


def assert_same_results(a, b):
    assert_same_tables(a, b)
    (tables, facts), (others, other_facts) = toy_results(a), toy_results(b)
    assert len(tables) == 4 * N_PAIRS
    assert tables.keys() == others.keys()
    assert all(tables[name].equals(others[name]) for name in tables)
    assert facts == other_facts


@pytest.fixture(scope="module")
def whole(dataset, tmp_path_factory):
    out = tmp_path_factory.mktemp("runs") / "streets"
    outcome = run_with_toys(dataset, out)
    assert (outcome.n_made, outcome.failures) == (JOBS_PER_PAIR * N_PAIRS, {})
    return out


@pytest.fixture
def again(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "run")


def test_toys_of_each_grain_have_rows_and_facts(whole):
    tables, facts = toy_results(whole)
    assert all(table.num_rows for table in tables.values())
    assert facts["crowds", "000", "real"]["n_crowds"] == facts["ratios", "000", ""]["real"]
    marks = tables["toy_marks/000.parquet"]
    assert marks.num_rows == tables["toy_ratios/000.parquet"].num_rows > 1
    assert facts["marks", "000", ""]["best"] == min(marks.column("mark").to_pylist())


def test_split_into_sides_and_objects_they_give_the_same(whole, dataset, tmp_path):
    pool = WatchedPool()
    run_with_toys(dataset, tmp_path / "run", pool=pool, policy=ALL_SPLIT)
    n_objects = sum(
        table.num_rows
        for name, table in toy_results(whole)[0].items()
        if name.startswith("toy_marks")
    )
    # before the toy of the pair, and after it
    assert pool.submitted.count("score_objects") == 2 * n_objects
    assert_same_results(tmp_path / "run", whole)


@pytest.mark.parametrize("policy", some_of([{}, ALL_SPLIT], [ALL_SPLIT]))
def test_on_two_workers_they_give_the_same(whole, dataset, tmp_path, policy):
    run_with_toys(dataset, tmp_path / "run", workers=2, policy=policy)
    assert_same_results(tmp_path / "run", whole)


@pytest.mark.parametrize(
    ("toy", "stage", "follow"),
    [
        ("of_side", OF_SIDE, {"toy_crowds", "toy_ratios", "toy_marks"}),
        ("of_pair", OF_PAIR, {"toy_ratios", "toy_marks"}),
        ("of_object", OF_OBJECT, {"toy_marks"}),
    ],
)
def test_a_raised_version_reruns_the_stage_and_what_follows(again, dataset, toy, stage, follow):
    before = marks(again)
    run_with_toys(dataset, again, stages=with_toys(**{toy: replace(stage, version=2)}))
    assert changed_tables(again, before) == follow


def test_communities_made_again_on_a_graph_that_stays_share_their_points_with_later_stages(
    again, dataset, tmp_path
):
    changed = ToySettings.model_validate({"communities": {"seed": 3}})
    assert not run_with_toys(dataset, again, changed).failures
    run_with_toys(dataset, tmp_path / "fresh", changed)
    assert_same_results(again, tmp_path / "fresh")


def test_a_stage_of_the_sides_may_read_what_a_stage_of_the_pair_gives(dataset, tmp_path):
    def make(inputs):
        n_matched = sum(
            status == "matched"
            for status in inputs.table("matching", "").column("status").to_pylist()
        )
        rows = {
            "pair_id": inputs.pair_id,
            "side": inputs.part,
            "community_id": [0],
            "n_over": [n_matched],
        }
        return JobResult({"toy_crowds": toys.CROWDS.build(rows)})

    late = replace(OF_SIDE, takes=("matching",), settings=(), make=make)
    for out, options in (
        ("whole", {}),
        ("split", {"pool": WatchedPool(), "policy": ALL_SPLIT}),
    ):
        outcome = run(dataset, tmp_path / out, stages=(*STAGES, late), **options)
        n_over = (
            pq.read_table(tmp_path / out / "toy_crowds" / "000.sim.parquet")
            .column("n_over")
            .to_pylist()
        )
        assert n_over == [outcome.rows[0]["n_matched"]]


@pytest.mark.parametrize(
    ("ask", "missing"),
    [
        (lambda own: own.table("graph", own.part), "KeyError: ('graph', "),
        (lambda own: own.metadata("ground", own.part), "KeyError: ('ground', "),
        (lambda own: own.settings.graph, "has no attribute 'graph'"),
        (lambda own: own.table("communities", "sim"), "KeyError: ('communities', 'sim')"),
        (lambda own: own.scans[own.part], "KeyError: 'real'"),
        (lambda own: object_points(own, own.part), "KeyError: ('ground', 'real')"),
    ],
)
def test_a_job_has_no_input_but_what_its_stage_declares(dataset, tmp_path, ask, missing):
    def make(inputs):
        assert inputs.T_real_sim is None
        ask(inputs)
        return OF_SIDE.make(inputs)

    stages = (*STAGES[: toys.N_BEFORE_MATCHING], replace(OF_SIDE, make=make))
    reason = run(
        dataset, tmp_path / "run", ToySettings(), stages=stages, pattern="000"
    ).failures["000"]
    assert "stage crowds, real: internal error" in reason
    assert missing in reason


def failure_of(stage, dataset, out, stages=()):
    return run(dataset, out, ToySettings(), stages=(*stages, stage), pattern="000").failures[
        "000"
    ]


def test_the_real_side_gets_no_motion_of_the_simulated_one(dataset, tmp_path):
    motions = {}

    def make(inputs):
        motions[inputs.part] = inputs.T_real_sim
        raise StageError("seen")

    cell = " ".join(map(str, np.eye(3, 4).ravel()))
    rows = [
        f"{path.stem},{path},{dataset / 'sim' / path.name},{cell}"
        for path in (dataset / "real").iterdir()
    ]
    (tmp_path / "pairs.csv").write_text("\n".join(["pair_id,real,sim,T_real_sim", *rows]))
    extra = replace(
        OF_SIDE, takes=(SCAN,), settings=("input",), make=make, is_wanted=lambda settings: True
    )
    failure_of(extra, tmp_path, tmp_path / "run", STAGES)
    assert motions == {"real": None, "sim": tuple(np.eye(3, 4).ravel())}


def test_a_stage_that_reads_the_input_declares_the_settings_of_its_columns(dataset, tmp_path):
    with pytest.raises(ValueError, match="stage crowds: .*settings input"):
        run_with_toys(
            dataset, tmp_path / "run", stages=with_toys(replace(OF_SIDE, takes=(SCAN,)))
        )


@pytest.mark.parametrize("is_split", [False, True], ids=["whole", "split"])
def test_no_object_depends_on_which_others_are_scored_beside_it(dataset, tmp_path, is_split):
    def make(inputs):
        inputs.metadata("metrics")  # of all objects
        return OF_OBJECT.make(inputs)

    stages = with_toys(of_object=replace(OF_OBJECT, make=make))
    options = {"policy": ALL_SPLIT, "pool": WatchedPool()} if is_split else {}
    outcome = run(
        dataset, tmp_path / "run", ToySettings(), stages=stages, pattern="000", **options
    )
    assert "KeyError: ('metrics', '')" in outcome.failures["000"]


def test_a_memo_gives_a_result_only_for_the_same_tables_and_values():
    memo = Memo()
    calls = []
    one = TABLES["graph"].schema.empty_table()
    other = TABLES["graph"].schema.empty_table()

    def count(*arguments):
        calls.append(arguments)
        return len(calls)

    values = [memo(count, *own) for own in ((one, "x"), (one, "x"), (other, "x"), (one, "y"))]
    assert values == [1, 1, 2, 3]


def test_a_stage_that_gives_other_tables_than_it_declares_fails(dataset, tmp_path):
    stage = replace(OF_SIDE, make=lambda inputs: JobResult({}))
    reason = failure_of(stage, dataset, tmp_path / "run", STAGES[: toys.N_BEFORE_MATCHING])
    assert "stage crowds: " in reason


def test_a_stage_that_takes_what_none_before_it_gives_is_refused_before_any_work(
    dataset, tmp_path
):
    with pytest.raises(ValueError, match="stage ratios takes matching, selection"):
        run(
            dataset,
            tmp_path / "run",
            ToySettings(),
            stages=(*STAGES[: toys.N_BEFORE_MATCHING], OF_SIDE, OF_PAIR),
        )
    assert not (tmp_path / "run" / "ground").exists()


def test_a_stage_that_names_what_no_contract_has_is_refused_before_any_work(dataset, tmp_path):
    stages = with_toys(replace(OF_SIDE, gives=("toy_clouds",)))
    with pytest.raises(KeyError, match="toy_clouds"):
        run_with_toys(dataset, tmp_path / "run", stages=stages)
    assert not (tmp_path / "run" / "ground").exists()


def test_another_column_makes_a_table_again_and_what_follows(again, dataset, monkeypatch):
    before = marks(again)
    wider = toys.MARKS.schema.append(column("more", pa.float64(), "of the same", optional=True))
    monkeypatch.setattr(toys, "MARKS", replace(toys.MARKS, schema=wider))
    monkeypatch.setitem(TABLES, "toy_marks", toys.MARKS)
    run_with_toys(dataset, again)
    assert changed_tables(again, before) == {"toy_marks"}
    assert pq.read_table(again / "toy_marks" / "000.parquet").column("more").null_count


@pytest.mark.parametrize("is_split", [False, True], ids=["whole", "split"])
def test_stages_by_any_other_name_give_the_same_tables(whole, dataset, tmp_path, is_split):
    renamed = tuple(replace(stage, name=f"stage-{i}") for i, stage in enumerate(with_toys()))
    options = {"policy": ALL_SPLIT, "pool": WatchedPool()} if is_split else {}
    outcome = run_with_toys(dataset, tmp_path / "run", stages=renamed, **options)
    assert {row["status"] for row in outcome.rows} == {"scored"}
    assert_same_tables(tmp_path / "run", whole)
    assert set(
        pq.read_table(tmp_path / "run" / "timings.parquet").column("stage").to_pylist()
    ) == {stage.name for stage in renamed}
