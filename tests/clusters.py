"""A dask cluster of processes on this machine."""

import json
import os
import subprocess
import time
from pathlib import Path

from distributed import Client

from runs import FIDPIPE

_TESTS = Path(__file__).parent
TEST_MODULES = os.pathsep.join(
    [str(_TESTS), str(_TESTS / "pipeline"), *filter(None, [os.environ.get("PYTHONPATH")])]
)


class Cluster:
    """A dask scheduler and its workers, each a separate process, with a TCP address."""

    def __init__(self, folder):
        folder.mkdir()
        self._folder = folder
        self._file = folder / "scheduler.json"
        self.scheduler = self._start(
            "scheduler", "--port", "0", "--dashboard-address", "127.0.0.1:0"
        )
        while not (self._file.exists() and self._file.read_text()):
            time.sleep(0.05)
        self.address = json.loads(self._file.read_text())["address"]
        self.workers = []

    def add_workers(self, n, *options, **environment):
        """Start workers of one thread that can import the tests' modules, and wait for them.

        Parameters
        ----------
        environment : and `before`, words of a command that starts the worker
        """
        self.workers += [
            self._start("worker", "--no-dashboard", "--nthreads", "1", *options, **environment)
            for _ in range(n)
        ]
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(len(self.workers), timeout=60)
        return self

    def _start(self, what, *options, before=(), **environment):
        dask = str(Path(FIDPIPE).with_name("dask"))
        return subprocess.Popen(
            [
                *before,
                dask,
                what,
                "--scheduler-file",
                str(self._file),
                "--host",
                "127.0.0.1",
                *options,
            ],
            cwd=self._folder,
            env={**os.environ, "PYTHONPATH": TEST_MODULES, **environment},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )

    def __enter__(self):
        return self

    def __exit__(self, *error):
        """End what is still there, the scheduler last."""
        for process in self.workers:
            process.terminate()
        for process in (*self.workers, self.scheduler):
            try:
                process.wait(10 if process is not self.scheduler else 0)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
