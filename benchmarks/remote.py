"""What does a run from and to an object store cost next to a local one?

    python benchmarks/remote.py DATASET [N_SMALL] [POINTS]      by default 1000 small pairs of 300 points

An S3 server (moto, in Python) runs on the same machine and takes part of it, so that ratios of wall time are upper
limits. Another one, with a bucket `bench`, is taken if AWS_ENDPOINT_URL and its keys are set; its requests and CPU are
not counted then. Local and remote runs of DATASET alternate, and one on a dask cluster whose workers keep no table;
then N_SMALL small pairs, as in small_pairs.py. With - as DATASET only these are run.
"""

import collections
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from urllib.request import Request, urlopen

import psutil
from measure import FIDPIPE, machine, repeated, scratch, weigh
from scale import start
from small_pairs import N_FILES

from fidpipe.pipeline.storage.object_store import list_objects, write_object

WORKERS, PORT, REPEATS = 2, 5599, 2
URL = "s3://bench"
SERVER = f"""
import time
from moto.server import ThreadedMotoServer
ThreadedMotoServer(ip_address="127.0.0.1", port={PORT}).start()
time.sleep(1e6)
"""


class Server:
    """An S3 server, which logs its requests."""

    def __init__(self, folder):
        self._log = folder / "requests.log"
        self._process = None
        self._log.touch()
        os.environ.update({"AWS_ALLOW_HTTP": "true", "FIDPIPE_CACHE": str(folder / "cache")})
        if "AWS_ENDPOINT_URL" in os.environ:
            return
        self._process = subprocess.Popen(
            [sys.executable, "-c", SERVER], stderr=self._log.open("w")
        )
        os.environ.update(
            {
                **{"AWS_ENDPOINT_URL": f"http://127.0.0.1:{PORT}", "AWS_REGION": "us-east-1"},
                **{"AWS_ACCESS_KEY_ID": "key", "AWS_SECRET_ACCESS_KEY": "secret"},
            }
        )
        for _ in range(100):
            try:
                urlopen(Request(f"http://127.0.0.1:{PORT}/bench", method="PUT"))
                return
            except OSError:
                time.sleep(0.2)
        sys.exit("the server did not start")

    def cpu_s(self):
        if self._process is None:
            return 0.0
        times = psutil.Process(self._process.pid).cpu_times()
        return times.user + times.system

    def requests(self):
        """Requests so far, by verb."""
        return collections.Counter(re.findall(r'"([A-Z]+) /', self._log.read_text()))

    def end(self):
        if self._process is not None:
            self._process.kill()


def upload(dataset, url):
    """All files of a dataset; a manifest with URLs in place of absolute paths."""
    for path in dataset.rglob("*"):
        if path.is_file():
            write_object(f"{url}/{path.relative_to(dataset).as_posix()}", path.read_bytes())


def pair_of_runs(server, folder, dataset, url, name):
    """A local run and a remote one, in this order; seconds of both."""
    before = server.requests()
    server_s = server.cpu_s()
    remote = weigh("run", url, "--out", f"{URL}/runs/{name}", "--workers", WORKERS)
    used = server.requests() - before
    server_s = server.cpu_s() - server_s
    local = weigh("run", dataset, "--out", folder / name, "--workers", WORKERS)
    print(
        f"{name}: wall {local.wall_s:.1f} s local, {remote.wall_s:.1f} s remote: {remote.wall_s / local.wall_s:.2f}"
    )
    print(
        f"  CPU {local.cpu_s:.1f} s local, {remote.cpu_s:.1f} s remote: {remote.cpu_s / local.cpu_s:.2f}",
        end="",
    )
    print(f" (and {server_s:.1f} s of the server)")
    stored = list_objects(f"{URL}/runs/{name}") if used else []
    print(
        f"  requests {dict(used)}; {len(stored)} objects, {sum(one.size for one in stored) / 1e6:.1f} MB written"
    )
    peaks = [f"{of:.0f}" for of in (local.peaks[0], remote.peaks[0])]
    print(
        f"  peak memory of the command: {peaks[0]} MiB local, {peaks[1]} MiB remote", flush=True
    )


def on_a_cluster(server, folder, url):
    """A run whose workers read and write tables at the URL alone."""
    file = folder / "scheduler.json"
    options = ("--scheduler-file", file, "--host", "127.0.0.1", "--no-dashboard")
    scheduler = start([FIDPIPE.with_name("dask"), "scheduler", "--port", "0", *options], folder)
    while not (file.exists() and file.read_text()):
        time.sleep(0.1)
    words = ("--nworkers", str(WORKERS), "--nthreads", "1", "--memory-limit", "4GiB")
    workers = start([FIDPIPE.with_name("dask"), "worker", *options, *words], folder)
    try:
        before = server.requests()
        address = json.loads(file.read_text())["address"]
        run = weigh("run", url, "--out", f"{URL}/runs/cluster", "--scheduler", address)
        print(
            f"cluster: wall {run.wall_s:.1f} s; requests {dict(server.requests() - before)}",
            flush=True,
        )
    finally:
        workers.terminate()
        workers.wait()
        scheduler.kill()


def main(dataset, n_small=1000, points=300):
    print(machine())
    with scratch() as folder:
        server = Server(folder)
        try:
            if dataset != "-":
                upload(Path(dataset), f"{URL}/set")
                for i in range(REPEATS):
                    pair_of_runs(server, folder, dataset, f"{URL}/set", f"whole{i}")
                on_a_cluster(server, folder, f"{URL}/set")
            small = folder / "small"
            weigh(
                "synth",
                small,
                "--pairs",
                min(N_FILES, n_small),
                "--points",
                points,
                "--workers",
                WORKERS,
            )
            upload(small, f"{URL}/small")
            listed = repeated(small, n_small, folder / "listed")
            remote = folder / "remote"
            remote.mkdir()
            text = (listed / "pairs.csv").read_text()
            (remote / "pairs.csv").write_text(
                text.replace(str(small.resolve()), f"{URL}/small")
            )
            pair_of_runs(server, folder, listed, remote, f"small{n_small}")
        finally:
            server.end()


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
