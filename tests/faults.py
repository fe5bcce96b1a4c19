"""Runs that break on purpose, as scripts of their own: `python faults.py kill graph DATASET OUT`."""

import os
import signal
import sys
from dataclasses import replace
from pathlib import Path

POISON = "001"


def die_at_second_call(make):
    """The job, which at its second call takes the whole process with it."""
    calls = []

    def job(bench, side):
        calls.append(side)
        if len(calls) == 2:
            os.kill(os.getpid(), signal.SIGKILL)
        return make(bench, side)

    return job


def poisoned_graph(bench, side):
    """The graph job, which kills its worker for one pair."""
    from fidpipe.pipeline.jobs.core import make_graph

    if bench.pair_id == POISON:
        os.kill(os.getpid(), signal.SIGKILL)
    return make_graph(bench, side)


def buggy_matching(bench, side):
    """The matching job, with a bug for one pair."""
    from fidpipe.pipeline.jobs.core import make_matching

    if bench.pair_id == POISON:
        raise ZeroDivisionError("a bug")
    return make_matching(bench, side)


def with_stage(name, make):
    """The pipeline with another job in one stage."""
    from fidpipe.pipeline import run

    return tuple(replace(stage, make=make) if stage.name == name else stage for stage in run.STAGES)


def main(how, stage, dataset, out):
    from fidpipe.pipeline import run
    from fidpipe.pipeline.cli import main as cli
    from fidpipe.pipeline.storage.store import TableFolder

    if how == "kill":
        make = next(of.make for of in run.STAGES if of.name == stage)
        run.STAGES = with_stage(stage, die_at_second_call(make))
    elif how == "kill-writing":
        write = TableFolder.replace

        def torn(self, path, content):
            if path.parent.name == stage:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.with_name(f".{path.name}.torn").write_bytes(bytes(content)[: len(content) // 2])
                os.kill(os.getpid(), signal.SIGKILL)
            write(self, path, content)

        TableFolder.replace = torn
    sys.argv = ["fidpipe", "run", dataset, "--out", out, "--workers", "1"]
    cli.main()


if __name__ == "__main__":
    main(*sys.argv[1:3], *map(str, map(Path, sys.argv[3:])))
