"""The time limit of a pair: what is noted, what is left, and that nothing else depends on it."""

import faulthandler

import pytest

from fidpipe.pipeline.engine.time_limit import OutOfTimeError, TimeLimit, limited
from pools import WatchedPool
from runs import JOBS_PER_PAIR, assert_same_tables, run

OVER = "stage ground, real\nstage graph, real\nTimeout (0:00:03)!\nThread 0x01 (most recent call first):\n"


@pytest.fixture
def limit(tmp_path):
    (tmp_path / "pair").mkdir()
    return TimeLimit(100.0, tmp_path / "pair")


@pytest.fixture
def timer(monkeypatch):
    """Seconds to which the timer of the process would be set."""
    seconds = []
    monkeypatch.setattr(
        faulthandler, "dump_traceback_later", lambda timeout, **options: seconds.append(timeout)
    )
    return seconds


def test_what_earlier_batches_took_is_not_left(limit, timer):
    (limit.folder / "a.seconds").write_text("30.0")
    (limit.folder / "b.seconds").write_text("50.0")
    with limited(limit):
        assert timer == [pytest.approx(20.0, abs=1.0)]
    assert len(list(limit.folder.glob("*.seconds"))) == len(list(limit.folder.iterdir())) == 3


def test_a_pair_whose_time_is_used_up_is_not_begun(limit, timer):
    (limit.folder / "a.seconds").write_text("100.5")
    with pytest.raises(OutOfTimeError, match="100 s .*--pair-timeout"):
        limited(limit).__enter__()
    assert timer == []


def test_a_pair_that_ended_a_worker_is_not_begun_again_and_its_stage_is_named(limit, timer):
    (limit.folder / "a").write_text(OVER)
    with pytest.raises(OutOfTimeError, match="100 s of work in stage graph, real"):
        limited(limit).__enter__()
    assert timer == []


def test_a_worker_that_died_of_something_else_leaves_the_pair_its_time(limit, timer):
    (limit.folder / "a").write_text("stage ground, real\n")
    with limited(limit) as note:
        note("stage graph, sim")
        assert {path.read_text() for path in limit.folder.iterdir()} == {
            "stage ground, real\n",
            "stage graph, sim\n",
        }
    assert timer == [pytest.approx(100.0, abs=1.0)]


def test_without_a_limit_no_timer_is_set(timer):
    with limited(None) as note:
        note("stage graph, sim")
    assert timer == []


def test_a_limit_enters_no_key_changes_no_number_and_leaves_nothing_behind(
    dataset, finished, tmp_path
):
    out = tmp_path / "run"
    outcome = run(dataset, out, pool=WatchedPool(), pair_timeout_s=10_000.0)
    assert (outcome.failures, outcome.n_made) == ({}, 2 * JOBS_PER_PAIR)
    assert_same_tables(out, finished)
    assert not list(out.rglob("*time_limit*"))
    assert run(dataset, out, pool=WatchedPool()).n_made == 0


def most_pairs(pool):
    """Largest number of pairs with jobs in one batch."""
    sizes = []
    for batch in pool.batches:
        sizes.append(len({job[0] for job in batch}))
    return max(sizes)


def test_with_a_limit_no_pair_shares_a_batch_with_another(dataset, tmp_path):
    together, alone = WatchedPool(n_workers=1), WatchedPool(n_workers=1)
    run(dataset, tmp_path / "together", pool=together)
    run(dataset, tmp_path / "alone", pool=alone, pair_timeout_s=10_000.0)
    assert most_pairs(together) == 2
    assert most_pairs(alone) == 1
