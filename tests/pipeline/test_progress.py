"""What is said of the work that is left."""

import io
import re
import time

import pytest
from rich.console import Console

from fidpipe.pipeline.datasets.pairs import ScanPair
from fidpipe.pipeline.engine.costs import CostModel
from fidpipe.pipeline.engine.plan import Part, Planner
from fidpipe.pipeline.engine.progress import Reporter, Work, seconds_of
from fidpipe.pipeline.inspect.scan_checks import ScanContent
from fidpipe.pipeline.jobs import STAGES, matching
from fidpipe.pipeline.stage import OBJECTS
from fidpipe.pipeline.storage.tables import JobRecord
from fidpipe.schemas.settings import Settings

N_JOBS = dict.fromkeys(("ground", "sensor", "graph", "communities"), (4, 0))
SIZES = [[0, 500], [1, 100]]
COSTS = CostModel()


class Clock:
    """Seconds that pass only when a test says so."""

    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def plan(pair_id, parts=()):
    scan = ScanContent("hash", "", 10_000)
    return Planner(STAGES, Settings(), {}).plan(ScanPair(pair_id, None, None), {"real": scan, "sim": scan}, parts)


def job(stage, pair_id, part="", **facts):
    return JobRecord(stage, pair_id, part, "key", {}, facts=facts)


def matched(pair_id):
    return job("matching", pair_id, **{OBJECTS: SIZES})


def work_on(*plans, clock=time.monotonic):
    sides_and_parts = [seconds_of(own, COSTS) for own in plans]
    seconds = sum(sides_s + sum(parts_s.values()) for sides_s, parts_s in sides_and_parts)
    work = Work(len(plans), seconds, N_JOBS, COSTS, clock)
    for own in plans:
        work.begin(own)
    return work


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def half_done(clock):
    """Two equal pairs, one of which has ended 40 seconds after the start."""
    work = work_on(plan("a"), plan("b"), clock=clock)
    clock.now = 140.0
    work.take(matched("a"))
    work.end("a")
    return work


def seconds_left(words):
    return float(re.search(r"about ([0-9]+) s left", words)[1])


def test_half_of_the_work_leaves_as_much_time_again(half_done):
    assert half_done.share() == pytest.approx(0.5)
    assert seconds_left(half_done.time_left(140.0)) == 40


def test_while_nothing_ends_the_time_left_counts_down(half_done):
    assert seconds_left(half_done.time_left(165.0)) == 15


def test_when_the_time_is_over_it_says_so(half_done):
    assert half_done.time_left(185.0) == "a large object takes longer than expected"


def test_before_anything_has_ended_the_time_is_unknown(clock):
    assert work_on(plan("a"), clock=clock).time_left(160.0) == "time left unknown"


def test_scored_objects_count_before_their_pair_ends(half_done):
    half_done.take(matched("b"))
    for side in ("real", "sim"):
        for stage in N_JOBS:
            half_done.take(job(stage, "b", side))
    before = half_done.share()
    half_done.take_objects("b", (500,))
    assert before < half_done.share() < 1
    half_done.take_objects("b", (100,))
    assert half_done.share() == pytest.approx(1)
    half_done.end("b")
    assert half_done.share() == pytest.approx(1)


def test_objects_that_were_matched_in_an_earlier_run_are_known_from_the_start():
    own = plan("a").with_records([matched("a")])
    work = work_on(own)
    work.take_objects("a", [n for _, n in SIZES])
    objects_s = sum(COSTS.object_seconds(n) for _, n in SIZES)
    assert work.share() == pytest.approx(objects_s / (objects_s + seconds_of(own, COSTS)[0]))


def test_parts_of_an_experiment_count_by_what_they_cost():
    records = [job(stage.name, "a", part) for stage in STAGES for part in stage.parts]
    parts = [Part(matching.STAGE, name, seconds=seconds) for name, seconds in (("small", 1.0), ("large", 3.0))]
    work = work_on(plan("a", parts).with_records(records))
    work.take(job("matching", "a", "large"))
    assert work.share() == pytest.approx(0.75)


def test_a_pair_that_fails_early_leaves_nothing_to_do():
    work = work_on(plan("a"), plan("b"))
    work.end("a")
    work.end("b")
    assert work.share() == pytest.approx(1)
    assert work.counts() == "2 of 2 pairs, 0 failed (ground 0/4, sensor 0/4, graph 0/4)"


def test_a_long_silence_is_broken():
    said = io.StringIO()
    reporter = Reporter(Console(file=said), seconds_of_silence=0.01)
    reporter.start(Work(1, 1.0, N_JOBS))
    end = time.monotonic() + 5
    while said.getvalue().count("0 of 1 pairs") < 2 and time.monotonic() < end:
        time.sleep(0.01)
    reporter.stop()
    assert said.getvalue().count("0 of 1 pairs") >= 2


def test_lines_are_not_said_more_often_than_wanted():
    def said(**options):
        console = Console(file=io.StringIO())
        reporter = Reporter(console, **options)
        reporter.start(Work(3, 1.0, N_JOBS))
        for pair_id in "abc":
            reporter.pair_begun(plan(pair_id))
            reporter.pair_done(plan(pair_id), ())
        reporter.stop()
        return console.file.getvalue().count(" of 3 pairs")

    assert said(seconds_between_lines=0.0) == 3
    assert said(seconds_between_lines=60.0) == 0
