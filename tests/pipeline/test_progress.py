"""Progress lines where stderr is not a terminal."""

import io
import re

from rich.console import Console

from fidpipe.pipeline.engine.progress import Reporter
from runs import listening


def lines(n_pairs=4, step_s=10.0, **options):
    """Lines of a reporter while pairs of five jobs end, one after each step."""
    now = 100.0
    console = Console(file=io.StringIO(), width=200, get_time=lambda: now)
    reporter = Reporter(console, **options)
    reporter.start(n_pairs, 5 * n_pairs)
    for _ in range(n_pairs):
        now += step_s
        reporter.advance(5, 1)
    reporter.stop()
    return console.file.getvalue().splitlines()


def test_counts_and_time_left_follow_the_pace_of_the_jobs():
    said = lines()
    assert [line.split(",")[0] for line in said] == [f"{n} of 4 pairs" for n in range(1, 5)]
    assert re.search(r"about 20 s left", said[1])


def test_before_the_first_pair_ends_the_share_of_the_jobs_is_shown():
    reporter, said = listening(seconds_between_lines=0.0)
    reporter.start(2, 10)
    reporter.advance(3)
    reporter.stop()
    assert said.getvalue().startswith("0 of 2 pairs, 0 failed, 30 %")


def test_a_failure_is_a_line_and_counts():
    reporter, said = listening(seconds_between_lines=0.0)
    reporter.start(2, 10)
    reporter.fail("pair 000", "no points")
    reporter.advance(5, 1)
    reporter.stop()
    failure, counts = said.getvalue().splitlines()
    assert failure == "pair 000: no points"
    assert counts.startswith("1 of 2 pairs, 1 failed")


def test_lines_are_no_more_frequent_than_requested():
    assert len(lines(n_pairs=6, step_s=2.0, seconds_between_lines=5.0)) == 2
    assert lines(seconds_between_lines=1000.0) == []
