"""Parts of an experiment on a pool of the test's own: what they see, and what a dying worker takes along."""

from fidpipe.pipeline.datasets.content import ScanContent
from fidpipe.pipeline.datasets.pairs import ScanPair, read_dataset
from fidpipe.pipeline.engine.engine import Machines, RunEngine, Survey
from fidpipe.pipeline.engine.plan import Part, Planner
from fidpipe.pipeline.engine.pool import Pool
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.stage import Grain, Inputs, JobResult, Stage
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.schemas.settings import Settings
from fidpipe.schemas.tables import TABLES
from pools import DyingPool, WatchedPool
from runs import QUIET, listening

N_BASE = 7  # both sides of ground, graph and communities, and matching


def probe(takes, make=None, gives="perturb_objects"):
    """A stage of an experiment that records the number of rows it sees."""

    def count(inputs: Inputs) -> JobResult:
        if make is not None:
            make(inputs)
        sides = ("",) if "matching" in takes else ("real", "sim")
        n_rows = sum(inputs.table(table, side).num_rows for table in takes for side in sides)
        return JobResult({gives: TABLES[gives].from_rows([])}, {"n_rows": n_rows, "arguments": inputs.arguments})

    name = f"probe of {' and '.join(takes)}"
    return Stage(name=name, takes=takes, gives=(gives,), grain=Grain.PAIR, make=count)


SEES_GROUND = probe({"ground": ("point_id",)})
SEES_MATCHING = probe({"matching": ("real_id",)}, gives="perturb_baselines")


def make_parts(dataset, out, parts, pool):
    """Has the parts made of every pair, after the stages up to matching; gives the engine and the finished jobs."""
    pairs = read_dataset(dataset).pairs
    up_to_matching = [stage for stage in STAGES if stage.name in ("ground", "graph", "communities", "matching")]
    planner = Planner(up_to_matching, Settings(), {})
    folder = RunFolder(out)
    machines = Machines(pool=pool)
    with folder.locked(), RunEngine(folder, Settings(), machines, QUIET) as engine:
        engine.hash_files(pairs)

        def plan(pair):
            return planner.plan(pair, engine.contents[pair.pair_id], parts)

        survey = engine.survey(pairs, plan, selected={pair.pair_id for pair in pairs})
        with engine.making(survey, plan, lambda: None) as schedule:
            schedule.run()
        return engine, {pair.pair_id: folder.ledger.jobs(pair.pair_id) for pair in pairs}


def test_a_pair_of_many_points_is_announced_with_its_memory_and_minutes(tmp_path):
    folder, (reporter, said) = RunFolder(tmp_path / "run"), listening()
    with folder.locked(), RunEngine(folder, Settings(), Machines(pool=Pool()), reporter) as engine:
        for n in (200_000, 1_000_000):
            engine.contents[str(n)] = dict.fromkeys(("real", "sim"), ScanContent("", "", n))
        survey = Survey(todo=[ScanPair(name, None, None) for name in engine.contents])
        with engine.making(survey, lambda pair: None, lambda: None):
            pass
    assert "1 of 2 pairs have 500,000 points or more; the largest has about 2,000,000; with all" in said.getvalue()
    assert "some 11 GiB of memory and 17 minutes, more where points are dense; thin both sides" in said.getvalue()


def test_a_part_sees_what_was_made_after_another_part_had_begun(dataset, tmp_path):
    parts = [Part(SEES_GROUND, "early"), Part(SEES_MATCHING, "late")]
    engine, jobs = make_parts(dataset, tmp_path, parts, Pool())
    assert engine.failures == {}
    for own in jobs.values():
        assert (
            own[SEES_GROUND.name, "early"].metadata["n_rows"] > own[SEES_MATCHING.name, "late"].metadata["n_rows"] > 0
        )


def test_each_part_gets_its_own_arguments_and_is_a_batch_of_its_own(dataset, tmp_path):
    parts = [Part(SEES_GROUND, f"part-{i}", arguments=(i,)) for i in range(3)]
    pool = WatchedPool()
    engine, jobs = make_parts(dataset, tmp_path, parts, pool)
    assert engine.n_made == 2 * (N_BASE + 3)
    assert [jobs["000"][SEES_GROUND.name, f"part-{i}"].metadata["arguments"] for i in range(3)] == [[0], [1], [2]]
    assert all(len(batch) == 1 for batch in pool.batches if any("part" in part for _, _, part in batch))


def test_a_poison_part_fails_alone(dataset, tmp_path):
    parts = [Part(SEES_GROUND, f"part-{i}") for i in range(3)]
    pool = DyingPool(lambda jobs, name: ("000", SEES_GROUND.name, "part-1") in jobs)
    engine, jobs = make_parts(dataset, tmp_path, parts, pool)
    assert list(engine.failures) == ["000, part-1"]
    assert engine.failures["000, part-1"].startswith("the worker process died, and again when the pair ran alone")
    assert pool.n_deaths == 2 + 1  # with others, alone
    assert (SEES_GROUND.name, "part-1") not in jobs["000"]
    assert {pair_id: len(own) for pair_id, own in jobs.items()} == {"000": N_BASE + 2, "001": N_BASE + 3}
    assert not (tmp_path / "perturb_objects" / "000.part-1.parquet").exists()
    again, _ = make_parts(dataset, tmp_path, parts, Pool())
    assert (again.failures, again.n_made) == ({}, 1)
