"""Datasets and runs in an object store, against a server of S3's interface on this machine."""

import errno
import hashlib
import http.server
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from functools import partial
from pathlib import Path
from typing import ClassVar
from urllib.request import Request, urlopen

import psutil
import pytest
from clusters import Cluster

from fidpipe import open_run
from fidpipe.pipeline.datasets.pairs import local_folder
from fidpipe.pipeline.storage.ledger import Ledger
from fidpipe.pipeline.storage.object_store import (
    delete_objects,
    list_objects,
    read_object,
    write_object,
)
from fidpipe.pipeline.storage.remote_run import LOCK, RemoteRun
from fidpipe.pipeline.storage.table_files import TOKEN, JobRecord, StoredFile
from fidpipe.pipeline.storage.urls import cache_of, url_of_cache
from fidpipe.schemas.errors import RunError, StoreError
from runs import FIDPIPE, assert_same_tables, command, one_line, run, some_of
from scenes import write_dataset

SECRET = "a-secret-that-nobody-may-read"
LOST = "/data/set/sim/001.bin"


class Faulty(http.server.BaseHTTPRequestHandler):
    """A proxy of the server that answers each 20th request with 503, cuts the next off, and has lost an object.

    The same request never fails three times in a row, however many run at once. `refused` names requests that are
    answered with 503 the next times, however many.
    """

    protocol_version = "HTTP/1.1"
    n = 0
    lost = None
    requests: ClassVar = []
    failed: ClassVar = Counter()
    refused: ClassVar = Counter()

    def relay(self):
        Faulty.n += 1
        fault = Faulty.n % 20 if Faulty.failed[self.command, self.path] < 2 else 0
        Faulty.failed[self.command, self.path] = (
            Faulty.failed[self.command, self.path] + 1 if fault in (7, 8) else 0
        )
        Faulty.requests.append((self.command, self.path))
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0)) or None
        headers = {
            name: value for name, value in self.headers.items() if name.lower() != "connection"
        }
        headers = {
            "Content-type": "application/octet-stream"
        } | headers  # urllib would call it a form
        request = Request(self.server.target + self.path, body, headers, method=self.command)
        try:
            with urlopen(request) as answer:
                status = answer.status
                content = answer.read()
                found = answer.headers
        except OSError as error:
            status = error.code
            content = error.read()
            found = error.headers
        if fault == 7:
            status, content = 503, b""
        if Faulty.refused[self.command, self.path] > 0:
            Faulty.refused[self.command, self.path] -= 1
            status, content, fault = 503, b"", 7
        if self.path == Faulty.lost and self.command == "GET":
            status, content = 404, b""
        self.send_response(status)
        for name, value in found.items():
            if name.lower() not in (
                "content-length",
                "connection",
                "transfer-encoding",
                "date",
                "server",
            ):
                self.send_header(name, value)
        length = found["Content-Length"] if self.command == "HEAD" else len(content)
        self.send_header("Content-Length", length)
        self.end_headers()
        self.wfile.write(content[: len(content) // 2] if fault == 8 else content)
        self.close_connection = fault == 8

    do_GET = do_PUT = do_HEAD = do_DELETE = do_POST = relay

    def log_message(self, *words):
        pass


@pytest.fixture(scope="module")
def proxy():
    """The address of the proxy."""
    server = pytest.importorskip("moto.server").ThreadedMotoServer(
        ip_address="127.0.0.1", port=0
    )
    server.start()
    host, port = server.get_host_and_port()
    own = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Faulty)
    own.target = f"http://{host}:{port}"
    threading.Thread(target=own.serve_forever, daemon=True).start()
    urlopen(Request(f"{own.target}/data", method="PUT"))
    yield f"http://127.0.0.1:{own.server_port}"
    own.shutdown()
    own.server_close()
    server.stop()


@pytest.fixture
def bucket(proxy, tmp_path, monkeypatch):
    """An empty bucket, whose objects are cached in a folder of this test."""
    Faulty.n = 20
    Faulty.lost = None
    Faulty.requests = []
    Faulty.refused = Counter()
    for name, value in {
        **{"AWS_ENDPOINT_URL": proxy, "AWS_ALLOW_HTTP": "true", "AWS_REGION": "us-east-1"},
        **{
            "AWS_ACCESS_KEY_ID": "key",
            "AWS_SECRET_ACCESS_KEY": SECRET,
            "FIDPIPE_CACHE": str(tmp_path / "cache"),
        },
    }.items():
        monkeypatch.setenv(name, value)
    return "s3://data"


@pytest.fixture(scope="module")
def local(tmp_path_factory):
    """A dataset, and its run on this machine."""
    folder = tmp_path_factory.mktemp("local")
    write_dataset(folder / "set", n_pairs=2, n=100)
    run(folder / "set", folder / "run")
    return folder


def upload(folder, url):
    for path in folder.rglob("*"):
        if path.is_file():
            write_object(f"{url}/{path.relative_to(folder).as_posix()}", path.read_bytes())


def test_a_run_from_and_to_a_bucket_has_the_tables_of_a_local_one(bucket, local, tmp_path):
    upload(local / "set", f"{bucket}/set")
    Faulty.requests = []
    ended = command(
        "run",
        f"{bucket}/set",
        "--out",
        f"{bucket}/runs/x",
        "--workers",
        "1",
        "--preset",
        "paper",
        code=0,
    )
    assert_same_tables(cache_of(f"{bucket}/runs/x"), local / "run")
    assert f"fidpipe report {bucket}/runs/x --open" in ended.stdout
    fetched = [path for verb, path in Faulty.requests if verb == "GET" and "/set/real/" in path]
    assert len(set(fetched)) == 2
    names = {one.name for one in list_objects(f"{bucket}/runs/x")}
    assert {"run.json", "pairs.parquet", "graph/000.real.parquet"} <= names
    assert not {LOCK, ".lock", TOKEN} & names
    shutil.rmtree(tmp_path / "cache")
    Faulty.requests = []
    assert "2 pairs" in command("show", f"{bucket}/runs/x").stdout
    assert not any("/graph/" in path or "/rays/" in path for _, path in Faulty.requests), (
        "fetched when read"
    )
    assert len(open_run(f"{bucket}/runs/x").pairs) == 2
    texts = [path.read_bytes() for path in (tmp_path / "cache").rglob("*") if path.is_file()]
    assert not any(
        SECRET.encode() in text
        for text in (*texts, ended.stdout.encode(), ended.stderr.encode())
    )


def downloaded(url, folder):
    """All objects below a URL as files of a folder."""
    for stored in list_objects(url):
        path = folder / stored.name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(read_object(f"{url}/{stored.name}"))
    return folder


KEPT = ("graph", "ground", "sensor")


def test_a_run_elsewhere_resumes_from_the_tables_that_are_there(
    bucket, local, tmp_path, monkeypatch
):
    upload(local / "set", f"{bucket}/set")
    words = ("run", f"{bucket}/set", "--workers", "1", "--preset", "paper", "--out")
    assert command(*words, f"{bucket}/runs/whole").returncode == 0
    whole = cache_of(f"{bucket}/runs/whole")
    for pair_id in Ledger(whole).pair_ids():
        jobs = Ledger(whole).jobs(pair_id).values()
        Ledger(whole).drop_jobs(pair_id, [job for job in jobs if job.stage not in KEPT])
    for name in ("ledger", *KEPT):
        upload(whole / name, f"{bucket}/runs/half/{name}")
    for writes_all in (True, False):
        Faulty.requests = []
        command(*words, f"{bucket}/runs/half", code=0)
        assert not list(cache_of(f"{bucket}/runs/half").glob("graph/*")), "fetched when read"
        half = downloaded(f"{bucket}/runs/half", tmp_path / f"half-{writes_all}")
        assert_same_tables(half, local / "run")
        written = {
            path.split("/half/")[1].split("/")[0]
            for verb, path in Faulty.requests
            if verb == "PUT"
        }
        assert not {*KEPT} & written, "they were there"
        assert ("metrics" in written) == writes_all
    monkeypatch.setenv("FIDPIPE_CACHE", str(tmp_path / "elsewhere"))
    command(*words, f"{bucket}/runs/half", "--replace", "--set", "graph.k=8", code=0)
    monkeypatch.setenv("FIDPIPE_CACHE", str(tmp_path / "cache"))
    assert open_run(f"{bucket}/runs/half").record.settings["graph"]["k"] == 8
    metrics = open_run(f"{bucket}/runs/half").metrics
    assert len(metrics) and not metrics.equals(open_run(local / "run").metrics)


#: A command on another machine, whose clock is wrong by some seconds: it writes to a run until its input ends.
WRITER = """
import socket, sys, time
url, late_s, renew_s = sys.argv[1], float(sys.argv[2]), float(sys.argv[3])
now = time.time
time.time = lambda: now() + late_s
socket.gethostname = lambda: "elsewhere"
from fidpipe.pipeline.storage import remote_run
remote_run._PUSH_S = remote_run._RENEW_S = renew_s
with remote_run.RemoteRun(url).written():
    print("writes", flush=True)
    sys.stdin.read()
"""


@pytest.mark.parametrize("late_s", [-600, 600])
def test_no_clock_decides_whether_a_command_of_another_machine_still_writes(
    bucket, local, monkeypatch, late_s
):
    upload(local / "set", f"{bucket}/set")
    monkeypatch.setattr("fidpipe.pipeline.storage.remote_run._DEAD_S", 6.0)
    url = f"{bucket}/runs/y"
    cache = os.environ["FIDPIPE_CACHE"]
    words = ("run", f"{bucket}/set", "--out", url, "--workers", "1")
    writer = subprocess.Popen(
        [sys.executable, "-c", WRITER, url, str(late_s), "0.5"],
        env={**os.environ, "FIDPIPE_CACHE": f"{cache}-elsewhere"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert writer.stdout.readline() == "writes\n"
        refused = command(*words, code=1)
        assert f"process {writer.pid} on elsewhere writes there" in refused.stderr
        assert "Traceback" not in refused.stderr
    finally:
        writer.kill()
        writer.communicate()
    command(*words, code=0)  # its lock stays the same


def test_a_lock_with_other_content_is_named_with_the_way_to_remove_it(bucket, local):
    upload(local / "set", f"{bucket}/set")
    lock = f"{bucket}/runs/y/{LOCK}"
    words = ("run", f"{bucket}/set", "--out", f"{bucket}/runs/y", "--workers", "1")
    owner = {"host": "elsewhere", "pid": 7, "token": "a"}
    for content in (
        "garbage",
        "[]",
        "{}",
        owner | {"pid": "7"},
        owner | {"pid": 10**19},
        owner | {"host": 7},
    ):
        text = content if isinstance(content, str) else json.dumps(content)
        write_object(lock, text.encode())
        refused = command(*words, code=1)
        assert one_line(refused.stderr).startswith("error: run ")
        assert f"{lock} is damaged" in refused.stderr
        assert "delete it" in refused.stderr
    delete_objects(f"{bucket}/runs/y", [LOCK])
    command(*words, code=0)


@pytest.mark.parametrize("n_times", [2, 3])
def test_the_lock_is_written_by_up_to_three_tries(bucket, n_times):
    Faulty.refused["PUT", f"/data/runs/tries{n_times}/{LOCK}"] = n_times
    own = RemoteRun(f"{bucket}/runs/tries{n_times}")
    if n_times < 3:
        with own.written():
            assert LOCK in {stored.name for stored in list_objects(own.url)}
        assert not list_objects(own.url)
    else:
        with pytest.raises(StoreError, match="503 .three tries"), own.written():
            pass


def test_caches_of_nested_urls_are_apart_and_one_in_use_is_left_alone(bucket, local):
    upload(local / "set", f"{bucket}/set")
    own = RemoteRun(f"{bucket}/runs/nested")
    with own.written() as folder:
        (folder / "settings.toml").write_text("new")
        (folder / "graph").mkdir()
        (folder / "graph" / "000.real.parquet").write_text("new")
        command("check", bucket)
        command("check", own.url)
        assert (folder / "settings.toml").read_text() == "new"
        assert (folder / "graph" / "000.real.parquet").read_text() == "new"
    assert {stored.name for stored in list_objects(own.url)} == {
        "settings.toml",
        "graph/000.real.parquet",
    }
    assert url_of_cache(cache_of(own.url)) == own.url
    assert cache_of(bucket) not in cache_of(own.url).parents


def test_an_index_of_the_cache_that_was_cut_short_is_rebuilt(bucket, local, tmp_path):
    upload(local / "set", f"{bucket}/set")
    url = f"{bucket}/runs/x"
    words = ("run", f"{bucket}/set", "--workers", "1", "--preset", "paper", "--out", url)
    command(*words, code=0)
    index = cache_of(url).with_name(".x.objects.json")
    for ways in (("show", url), words):
        index.write_bytes(index.read_bytes()[:40])
        assert "2 pairs" in command(*ways, code=0).stdout
    assert_same_tables(downloaded(url, tmp_path / "run"), local / "run")


def test_a_user_without_home_and_name_reads_urls_and_runs(bucket, local):
    if os.getuid() or not shutil.which("setpriv"):
        pytest.skip("this user cannot be another one")
    upload(local / "set", f"{bucket}/set")
    environment = {
        name: value
        for name, value in os.environ.items()
        if name not in ("HOME", "FIDPIPE_CACHE")
    }
    words = ["setpriv", "--reuid=54321", "--regid=54321", "--clear-groups", FIDPIPE, "run"]
    with tempfile.TemporaryDirectory() as folder:
        # pytest's folders are those of this user alone
        shutil.copytree(local / "set", f"{folder}/set")
        Path(folder).chmod(0o777)
        environment["TMPDIR"] = folder
        for dataset, n_lines in ((f"{folder}/set", 0), (f"{bucket}/set", 1)):
            ended = subprocess.run(
                [*words, dataset, "--out", f"{folder}/{n_lines}", "--workers", "1"],
                env=environment,
                cwd=folder,
                capture_output=True,
                text=True,
                check=False,
            )
            assert ended.returncode == 0, ended.stderr
            assert ended.stderr.count("no home folder") == n_lines


def test_a_full_folder_for_temporary_files_ends_a_run_that_resumes(
    bucket, local, tmp_path, monkeypatch
):
    upload(local / "set", f"{bucket}/set")
    words = (
        "run",
        f"{bucket}/set",
        "--out",
        tmp_path / "run",
        "--workers",
        "1",
        "--preset",
        "paper",
    )
    write = Path.write_bytes

    def fill(path, content):
        if path.name == "001.bin":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return write(path, content)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fill)
        ended = command(*words, code=1)
    assert "error: TMPDIR: no space left in " in ended.stderr
    assert "run the same command again" in ended.stderr
    assert "Traceback" not in ended.stderr
    command(*words, code=0)
    assert_same_tables(tmp_path / "run", local / "run")


def fill_bucket(n_pairs):
    """Pairs below s3://data/many, put into the server at once."""
    from moto.s3.models import s3_backends

    backends = [backend for account in s3_backends.values() for backend in account.values()]
    backend = next(backend for backend in backends if "data" in backend.buckets)
    for i in range(n_pairs):
        for side in ("real", "sim"):
            backend.put_object("data", f"many/{side}/{i:06d}.bin", b"0" * 1600)


@pytest.mark.parametrize("n_pairs", some_of([500, 5250], [500]))
def test_many_objects_are_listed_once_with_progress_and_soon(bucket, monkeypatch, n_pairs):
    fill_bucket(n_pairs)
    pause_s = 0 if n_pairs < 1000 else 0.5
    monkeypatch.setattr("fidpipe.pipeline.storage.object_store._SECONDS_BETWEEN_LINES", pause_s)
    Faulty.requests = []
    begun = time.thread_time()  # of this thread: the server is in another one
    ended = command("status", f"{bucket}/many", code=1)
    assert time.thread_time() - begun < 10 * max(1, 2 * n_pairs / 10_000)
    assert f"{bucket}/many: of {2 * n_pairs:,} objects: " in ended.stderr
    assert "it holds a dataset" in ended.stderr
    lists = [path for verb, path in Faulty.requests if verb == "GET" and "list-type" in path]
    assert 2 * n_pairs / 1000 <= len(lists) <= 2 * n_pairs / 1000 + 6, (
        "each page once, and what failed again"
    )


def test_a_command_whose_lock_was_taken_over_stops_writing_and_leaves_the_lock(
    bucket, tmp_path, monkeypatch
):
    monkeypatch.setattr("fidpipe.pipeline.storage.remote_run._RENEW_S", 0.0)
    own = RemoteRun(f"{bucket}/runs/z")
    other = b'{"host": "elsewhere", "pid": 7, "token": "a"}'
    with pytest.raises(RunError, match=own.url), own.written() as folder:
        write_object(f"{own.url}/{LOCK}", other)
        (folder / "settings.toml").write_text("")
    assert read_object(f"{own.url}/{LOCK}") == other
    assert [one.name for one in list_objects(own.url)] == [LOCK]


def test_the_url_never_holds_a_ledger_without_the_tables_that_it_names(tmp_path, monkeypatch):
    """At each PUT and before it: a machine may die there, and the run goes on while its files are written."""
    monkeypatch.setenv("FIDPIPE_CACHE", str(tmp_path))
    folder = cache_of("s3://data/runs/order")
    folder.mkdir(parents=True)
    lock = threading.Lock()
    stored = {}
    n_jobs = 0

    def finish_job():
        nonlocal n_jobs
        n_jobs += 1
        name = f"graph/{n_jobs:03d}.parquet"
        content = name.encode()
        (folder / "graph").mkdir(exist_ok=True)
        (folder / name).write_bytes(content)
        file = StoredFile(len(content), hashlib.sha256(content).hexdigest(), 0)
        for pair_id in ("a", str(n_jobs)):
            Ledger(folder).put_job(
                JobRecord("graph", pair_id, str(n_jobs), "key", {name: file})
            )
        (folder / "run.json").write_text(str(n_jobs))

    def put(url, content, mode="overwrite"):
        name = url.removeprefix("s3://data/runs/order/")
        time.sleep(0.05 if name.endswith("0.parquet") else 0)  # others overtake it
        with lock:
            if name.startswith("graph/") and n_jobs < 60:
                finish_job()
            stored[name] = content
            if name.startswith("ledger/"):
                assert set(re.findall(r"graph/\d+[.]parquet", content.decode())) <= set(stored)
            if name == "run.json":
                assert {f"ledger/{i}.json" for i in range(1, int(content) + 1)} <= set(stored)
        return "etag"

    monkeypatch.setattr("fidpipe.pipeline.storage.remote_run.write_object", put)
    for _ in range(20):
        finish_job()
    own = RemoteRun("s3://data/runs/order")
    for _ in range(4):
        own.push()
    assert set(stored) - {LOCK} == {
        path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file()
    }


def test_an_object_that_is_lost_fails_its_pair_by_name(bucket, local, tmp_path):
    upload(local / "set", f"{bucket}/set")
    Faulty.lost = LOST
    ended = command("run", f"{bucket}/set", "--out", tmp_path / "run", "--workers", "1")
    assert "s3://data/set/sim/001.bin" in ended.stdout + ended.stderr
    pairs = open_run(tmp_path / "run").pairs
    assert pairs.status.tolist() == ["scored", "failed"]


def test_a_manifest_names_objects_and_may_be_one_without_a_listing(
    bucket, local, tmp_path, monkeypatch
):
    upload(local / "set", f"{bucket}/set")
    (tmp_path / "named").mkdir()
    manifest = tmp_path / "named" / "pairs.csv"
    manifest.write_text(
        f"pair_id,real,sim\na,{bucket}/set/real/000.bin,{bucket}/set/sim/000.bin\n"
    )
    assert "1 of 1 pairs can be evaluated" in command("check", manifest.parent).stdout
    (local / "set" / "pairs.csv").write_text("pair_id,real,sim\na,real/000.bin,sim/000.bin\n")
    quiet = type(
        "Quiet", (http.server.SimpleHTTPRequestHandler,), {"log_message": lambda *words: None}
    )
    server = http.server.ThreadingHTTPServer(
        ("127.0.0.1", 0), partial(quiet, directory=local / "set")
    )
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        checked = command("check", f"http://127.0.0.1:{server.server_port}")
    finally:
        server.shutdown()
        server.server_close()
        (local / "set" / "pairs.csv").unlink()
    assert "1 of 1 pairs can be evaluated" in checked.stdout, checked.stderr


def test_urls_with_credentials_and_of_unknown_schemes_are_rejected(bucket):
    for url in ("s3://key:secret@data/set", "https://host/set?X-Amz-Signature=secret"):
        refused = command("check", url, code=1)
        assert "without credentials" in refused.stderr
        assert "secret" not in refused.stderr.replace(SECRET, "")
    assert "expected a URL of s3, gs, az" in command("check", "ftp://host/set").stderr


def test_a_place_that_holds_something_else_is_not_written_to(bucket, local):
    upload(local / "set", f"{bucket}/set")
    refused = command("run", local / "set", "--out", f"{bucket}/set", "--workers", "1")
    assert refused.returncode == 1
    assert f"{bucket}/set" in refused.stderr
    assert {one.name for one in list_objects(f"{bucket}/set")} >= {
        "real/000.bin",
        "sim/001.bin",
    }


def test_a_stub_outside_of_the_cache_is_no_scan(bucket, local, tmp_path):
    dataset = shutil.copytree(local / "set", tmp_path / "set")
    (dataset / "real" / "002.bin.url").write_text("http://127.0.0.1:1/x.bin\n\n100\n")
    checked = command("check", dataset)
    assert "002.bin.url" in checked.stdout + checked.stderr


def test_what_is_not_there_is_said_in_one_line(bucket):
    with pytest.raises(StoreError, match="nothing"):
        local_folder(f"{bucket}/nothing")
    with pytest.raises(StoreError, match=r"nothing/x\.bin"):
        read_object(f"{bucket}/nothing/x.bin")
    assert (
        os.environ["AWS_SECRET_ACCESS_KEY"] not in command("show", f"{bucket}/nothing").stderr
    )


def kill_after_a_table(pid):
    """Kill a dask worker and its nanny when the first table of graphs has been written."""
    while not any("/graph/" in path for verb, path in Faulty.requests if verb == "PUT"):
        time.sleep(0.01)
    worker = psutil.Process(pid)
    for process in (*worker.children(recursive=True), worker):
        process.kill()


@pytest.mark.exhaustive
def test_workers_without_a_shared_disk_finish_a_run_from_and_to_a_bucket(
    bucket, local, tmp_path
):
    """They see neither the cache nor the dataset: a file system of their own lies over both."""
    cache = tmp_path / "cache"
    dataset = local / "set"
    cache.mkdir()
    hidden = " && ".join(f"mount -t tmpfs none {path}" for path in (cache, dataset))
    before = ("unshare", "--mount", "sh", "-c", f'{hidden} && exec "$@"', "sh")
    if subprocess.run([*before, "true"], check=False, capture_output=True).returncode:
        pytest.skip("this user may not mount file systems")
    upload(dataset, f"{bucket}/set")
    with Cluster(tmp_path / "cluster") as cluster:
        cluster.add_workers(2, "--memory-limit", "4GiB", before=before)
        words = (
            "--scheduler",
            cluster.address,
            "--preset",
            "paper",
            "--out",
            f"{bucket}/runs/apart",
        )
        unseen = command("run", dataset, *words[:-1], f"{bucket}/runs/unseen", code=3)
        assert "/set/real/000.bin" in unseen.stderr
        ended = command("run", f"{bucket}/set", *words, code=0)
        assert "set: 2 pairs in" in ended.stdout
        assert not list(cache_of(f"{bucket}/runs/apart").glob("graph/*")), (
            "workers wrote to the bucket alone"
        )
        again = command("run", f"{bucket}/set", *words)
        assert "0 jobs done" in again.stdout
        apart = downloaded(f"{bucket}/runs/apart", tmp_path / "apart")
        assert_same_tables(apart, local / "run")
        killer = threading.Thread(target=kill_after_a_table, args=(cluster.workers[0].pid,))
        Faulty.requests = []
        killer.start()
        smaller = command("run", f"{bucket}/set", *words, "--replace", "--set", "graph.k=8")
        killer.join()
        assert smaller.returncode == 0, smaller.stderr
    shutil.rmtree(cache)
    assert open_run(f"{bucket}/runs/apart").record.settings["graph"]["k"] == 8
    names = {one.name for one in list_objects(f"{bucket}/runs/apart")}
    assert not {LOCK, TOKEN} & names
