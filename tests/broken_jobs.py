"""Runs that break on purpose, as separate scripts: `python broken_jobs.py kill graph 2 DATASET OUT`."""

import os
import resource
import signal
import sys
from dataclasses import replace
from pathlib import Path

from fidpipe.pipeline.jobs import STAGES, graph_job
from runs import run

POISON = "001"


def dying(make, how, n):
    """The job, which in its n-th call kills the process: at once, or in the middle of the next file that is written."""
    calls = []

    def job(context):
        calls.append(context.part)
        if how == "kill" and len(calls) == n:
            os.kill(os.getpid(), signal.SIGKILL)
        made = make(context)
        if how == "kill-writing" and len(calls) == n:
            signal.signal(signal.SIGXFSZ, signal.SIG_DFL)
            resource.setrlimit(resource.RLIMIT_FSIZE, (100, 100))
        return made

    return job


def poisoned_graph(context):
    """The graph job, which kills its worker for one pair."""
    if context.pair_id == POISON:
        os.kill(os.getpid(), signal.SIGKILL)
    return graph_job.make_graph(context)


def with_job(name, make, stages=STAGES):
    """The pipeline with another job in one stage."""
    return tuple(replace(stage, make=make) if stage.name == name else stage for stage in stages)


def main(how, name, n, dataset, out):
    make = next(stage.make for stage in STAGES if stage.name == name)
    run(dataset, out, stages=with_job(name, dying(make, how, n)))


if __name__ == "__main__":
    main(*sys.argv[1:3], int(sys.argv[3]), *map(Path, sys.argv[4:]))
