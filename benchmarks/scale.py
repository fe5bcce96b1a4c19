"""How many workers can one command and one scheduler serve?

    python benchmarks/scale.py [N_PAIRS] [SECONDS] [WORKERS]      by default 320 pairs of 16 s on 32 workers

Workers of a dask cluster sleep before the stage graph of pairs of 300 points, half of SECONDS per side, so that two
cores can stand for many; all are in one process, apart from the scheduler's. Prints how long the workers slept, and the
CPU seconds per pair and the memory of command, scheduler and workers.
"""

import asyncio
import json
import os
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import distributed
import psutil
from measure import FIDPIPE, MIB, machine, repeated, scratch, weigh
from rich.console import Console
from small_pairs import N_FILES

from fidpipe.pipeline.engine import schedule
from fidpipe.pipeline.engine.engine import Machines
from fidpipe.pipeline.engine.progress import Reporter
from fidpipe.pipeline.jobs import STAGES, graph_job
from fidpipe.pipeline.run import run_dataset
from fidpipe.schemas.settings import Settings

POINTS = 300


def sleeping_graph(inputs):
    """The job of the stage graph after a rest."""
    time.sleep(float(os.environ["SLEEP_S"]))
    return graph_job.make_graph(inputs)


async def serve(address, n_workers):
    """Workers of one thread each in this process, until it is ended."""
    workers = [
        distributed.Worker(address, nthreads=1, memory_limit="1GiB") for _ in range(n_workers)
    ]
    await asyncio.gather(*workers)
    await asyncio.gather(*(worker.finished() for worker in workers))


def start(words, folder):
    """A process in whose output nobody is interested."""
    return subprocess.Popen(
        words, cwd=folder, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


def used(processes):
    """CPU seconds, and largest resident memory of one, MiB."""
    times = [process.cpu_times() for process in processes]
    return sum(own.user + own.system for own in times), max(
        own.memory_info().rss for own in processes
    ) / MIB


def main(n_pairs=320, seconds=16.0, n_workers=32):
    print(machine())
    os.environ["SLEEP_S"] = str(seconds / 2)
    stages = tuple(
        replace(stage, make=sleeping_graph) if stage.name == "graph" else stage
        for stage in STAGES
    )
    with scratch() as folder:
        weigh("synth", folder / "small", "--pairs", min(N_FILES, n_pairs), "--points", POINTS)
        listed = repeated(folder / "small", n_pairs, folder / "listed")
        file = folder / "scheduler.json"
        options = (
            "--scheduler-file",
            file,
            "--host",
            "127.0.0.1",
            "--port",
            "0",
            "--no-dashboard",
        )
        scheduler = start([FIDPIPE.with_name("dask"), "scheduler", *options], folder)
        while not (file.exists() and file.read_text()):
            time.sleep(0.1)
        address = json.loads(file.read_text())["address"]
        workers = start(
            [sys.executable, Path(__file__).resolve(), "serve", address, str(n_workers)], folder
        )
        try:
            with distributed.Client(address, set_as_default=False) as client:
                client.wait_for_workers(n_workers)
            machines = Machines(scheduler=address)
            schedule.BUNDLE_S = 1e-9  # a pair each
            begun = time.perf_counter()
            own = psutil.Process()
            of_command = used([own])[0]
            out = folder / "run"
            ended = run_dataset(
                listed,
                out,
                Settings(),
                Reporter(Console(quiet=True)),
                machines=machines,
                stages=stages,
            )
            wall_s = time.perf_counter() - begun
            of_command = used([own])[0] - of_command
            of_scheduler, scheduler_mib = used([psutil.Process(scheduler.pid)])
            of_workers, worker_mib = used([psutil.Process(workers.pid)])
            memory = used([own])[1]
        finally:
            workers.terminate()
            workers.wait()
            scheduler.kill()
        stages_s = ended.record.wall_s["stages"]
    print(
        f"{n_pairs} pairs, {len(ended.failures)} failed; {wall_s:.0f} s wall, {stages_s:.0f} s of them in stages"
    )
    print(f"workers asleep: {n_pairs * seconds / (n_workers * stages_s):.0%} of the time")
    for name, cpu_s, mib in (
        ("command", of_command, memory),
        ("scheduler", of_scheduler, scheduler_mib),
        ("workers", of_workers, worker_mib),
    ):
        print(f"{name}: {1e3 * cpu_s / n_pairs:.1f} ms of CPU per pair, {mib:.0f} MiB")


if __name__ == "__main__":
    if sys.argv[1:2] == ["serve"]:
        asyncio.run(serve(sys.argv[2], int(sys.argv[3])))
    else:
        main(*map(int, sys.argv[1:]))
