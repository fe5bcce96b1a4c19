"""What is said of the work that is left."""

import io
import re
import time

import pytest
from rich.console import Console

from fidpipe.pipeline.engine import progress
from fidpipe.pipeline.engine.progress import Reporter, Work
from fidpipe.pipeline.storage.tables import JobRecord

JOBS = dict.fromkeys(("ground", "graph", "communities"), (2, 0))


def seconds_left(words):
    return float(re.search(r"about ([0-9]+) s left", words)[1])


@pytest.fixture
def half_done(monkeypatch):
    """Two equal pairs, one of which has ended 40 seconds after the start."""
    now = [100.0]
    monkeypatch.setattr(progress, "monotonic", lambda: now[0])
    work = Work({"a": 20_000, "b": 20_000}, JOBS)
    now[0] = 140.0
    work.take(JobRecord("matching", "a", "", "key", {}, {"n_keep": [[0, 500], [1, 100]]}))
    work.end("a")
    return work


def test_half_of_the_work_leaves_as_much_time_again(half_done):
    assert half_done.share() == pytest.approx(0.5)
    assert seconds_left(half_done.time_left(140.0)) == 40


def test_while_nothing_ends_the_time_left_counts_down(half_done):
    assert seconds_left(half_done.time_left(165.0)) == 15


def test_when_the_time_is_over_it_says_so(half_done):
    assert half_done.time_left(185.0) == "a large object takes longer than expected"


def test_scored_objects_count_before_their_pair_ends(half_done):
    half_done.take(JobRecord("matching", "b", "", "key", {}, {"n_keep": [[0, 500], [1, 100]]}))
    for side in ("real", "sim"):
        for stage in JOBS:
            half_done.take(JobRecord(stage, "b", side, "key", {}))
    before = half_done.share()
    half_done.take_objects("b", (500,))
    assert before < half_done.share() < 1
    half_done.take_objects("b", (100,))
    assert half_done.share() == pytest.approx(1)
    half_done.end("b")
    assert half_done.share() == pytest.approx(1)


def test_a_pair_that_fails_early_leaves_nothing_to_do():
    work = Work({"a": 20_000, "b": 20_000}, JOBS)
    work.end("a")
    work.end("b")
    assert work.share() == pytest.approx(1)
    assert work.counts() == "2 of 2 pairs, 0 failed (ground 0/2, graph 0/2, communities 0/2)"


def test_a_long_silence_is_broken(monkeypatch):
    for name in ("_SECONDS_BETWEEN_LOOKS", "_SECONDS_OF_SILENCE"):
        monkeypatch.setattr(progress, name, 0.01)
    said = io.StringIO()
    reporter = Reporter(Console(file=said))
    reporter.start({"a": 100}, JOBS)
    for _ in range(500):
        if said.getvalue().count("0 of 1 pairs") >= 2:
            break
        time.sleep(0.01)
    reporter.stop()
    assert said.getvalue().count("0 of 1 pairs") >= 2
