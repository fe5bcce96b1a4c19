"""Starting runs, comparing what they wrote, and forging it."""

import contextlib
import ctypes
import hashlib
import io
import json
import shutil
import signal
import subprocess
import sys
import warnings
from itertools import pairwise
from pathlib import Path
from unittest import mock

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from rich.console import Console

from fidpipe.pipeline.cli.main import main
from fidpipe.pipeline.engine import cluster, costs, schedule
from fidpipe.pipeline.engine.engine import Machines
from fidpipe.pipeline.engine.progress import Reporter
from fidpipe.pipeline.jobs import STAGES
from fidpipe.pipeline.run import run_dataset
from fidpipe.pipeline.storage.folder import RunFolder
from fidpipe.pipeline.storage.table_files import StoredFile
from fidpipe.schemas.settings import Settings

QUIET = Reporter(Console(quiet=True))
FIDPIPE = str(Path(sys.executable).with_name("fidpipe"))
#: Commands that start worker processes, unless they are given one worker.
WITH_WORKERS = ("run", "synth", "perturb", "ablate", "best-case", "twin")
STAGE_NAMES = [stage.name for stage in STAGES]
JOBS_PER_PAIR = sum(len(stage.parts) for stage in STAGES)
FOLDERS = [table for stage in STAGES for table in stage.gives]
_PR_CAPBSET_DROP, _CAP_DAC_OVERRIDE, _CAP_DAC_READ_SEARCH = 24, 1, 2


def run(
    dataset,
    out,
    settings=None,
    *,
    workers=1,
    scheduler=None,
    pool=None,
    policy=(),
    replace=True,
    pair_timeout_s=None,
    reporter=QUIET,
    **options,
):
    """A run in this process, or on workers or a pool; it may replace what was made with other settings.

    policy : values of constants and functions of `engine.schedule` and `engine.costs`, by name
    """
    with contextlib.ExitStack() as stack:
        for name, value in dict(policy).items():
            module = schedule if hasattr(schedule, name) else costs
            stack.enter_context(mock.patch.object(module, name, value))
        if pool is not None:
            given = mock.patch.object(cluster, "start_pool", lambda *args, **options: pool)
            stack.enter_context(given)
        return run_dataset(
            dataset,
            out,
            settings or Settings(),
            reporter,
            machines=Machines(workers, scheduler, pair_timeout_s),
            replace=replace,
            **options,
        )


def listening(**options):
    """A reporter, and the text that it writes into."""
    said = io.StringIO()
    return Reporter(Console(file=said, width=1000), **options), said


def own_process(*words, code=None, timeout=300, **options):
    """Run the command in a separate process; returns exit code and output, and `code` is the exit code if given."""
    words = [FIDPIPE, *map(str, words)]
    ended = subprocess.run(
        words, capture_output=True, text=True, timeout=timeout, check=False, **options
    )
    assert code in (None, ended.returncode), ended.stdout + ended.stderr
    return ended


def command(*words, code=None, cwd=None, **options):
    """The same in this process, two seconds faster, unless the command starts workers or has process options."""
    words = [str(word) for word in words]
    alone = {"--help", "--workers 1"} & {*words, *map(" ".join, pairwise(words))}
    if options or (words[0] in WITH_WORKERS and not alone):
        return own_process(*words, code=code, cwd=cwd, **options)
    streams = [io.TextIOWrapper(io.BytesIO(), encoding="utf-8", newline="\n") for _ in range(2)]
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with (
        contextlib.chdir(cwd or "."),
        contextlib.redirect_stdout(streams[0]),
        contextlib.redirect_stderr(streams[1]),
        mock.patch.object(sys, "argv", [FIDPIPE, *words]),
        # a script, also under `python -m pytest`
        mock.patch.object(sys.modules["__main__"], "__package__", None),
        warnings.catch_warnings(),
    ):
        warnings.resetwarnings()
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            main()
        except SystemExit as exit:
            status = exit.code or 0
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
    for stream in streams:
        stream.flush()
    stdout = streams[0].buffer.getvalue().decode()
    stderr = streams[1].buffer.getvalue().decode()
    assert code in (None, status), stdout + stderr
    return subprocess.CompletedProcess(words, status, stdout, stderr)


def some_of(values, always):
    """Parameters of a test: all values, of which those that are not always tried are marked as exhaustive."""
    rest = [value for value in values if value not in always]
    assert len(rest) + len(always) == len(values)
    sets = [value if isinstance(value, tuple) else (value,) for value in rest]
    return [*always, *(pytest.param(*one, marks=pytest.mark.exhaustive) for one in sets)]


def tables(run_folder):
    """Every table of a run by its relative path, but for the timings."""
    files = sorted(
        path for folder in FOLDERS for path in (run_folder / folder).glob("*.parquet")
    )
    files.append(run_folder / "pairs.parquet")
    return {str(path.relative_to(run_folder)): pq.read_table(path) for path in files}


def assert_same_tables(a, b):
    """The same files with the same values in the same columns."""
    a, b = tables(a), tables(b)
    assert a.keys() == b.keys()
    assert [name for name in a if not a[name].equals(b[name])] == []


def contents(folder):
    """The bytes of all tables and records of a run or an experiment."""
    return {
        path: path.read_bytes()
        for path in folder.rglob("*")
        if path.suffix in (".parquet", ".json", ".toml")
    }


def files_in(folder):
    """The bytes of all files by relative path."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def copied(dataset, out, folder):
    """Copies of a dataset and of its run, whose record names the copy."""
    data, own = (
        shutil.copytree(dataset, folder / "streets"),
        shutil.copytree(out, folder / "run"),
    )
    record = json.loads((own / "run.json").read_text()) | {"dataset": str(data)}
    (own / "run.json").write_text(json.dumps(record))
    return data, own


def one_line(text):
    """The only line of a text that is not empty."""
    lines = [line for line in text.splitlines() if line.strip()]
    assert len(lines) == 1, text
    return lines[0]


def temporary_files(out):
    """Files that a run should not leave: names that begin with a dot, except lock and writer."""
    return [path for path in out.rglob(".*") if path.name not in {".lock", ".writer"}]


def changed_files(run_folder, before):
    """Names of files that are new or whose modification time has changed."""
    now = marks(run_folder)
    return {name for name in now if now[name] != before.get(name)}


def changed_tables(run_folder, before):
    """Names of the tables that have such files."""
    return {name.split("/")[0] for name in changed_files(run_folder, before)}


def marks(run_folder):
    """Modification times of the tables of sides, pairs and objects by relative path."""
    return {
        str(path.relative_to(run_folder)): path.stat().st_mtime_ns
        for path in run_folder.glob("*/*.parquet")
    }


def job_of_file(store, name):
    """The finished job that wrote a file of a run."""
    ledger = store.ledger
    records = (
        record
        for pair_id in ("", *ledger.pair_ids())
        for record in ledger.jobs(pair_id).values()
    )
    return next(record for record in records if name in record.files)


def rewrite(folder, name, change):
    """Changes a table of a run so that file and ledger agree."""
    store = RunFolder(folder)
    with store.locked():
        record = job_of_file(store, name)
        rows = change(pq.read_table(folder / name, partitioning=None))
        content = pa.BufferOutputStream()
        footer = pq.read_metadata(folder / name).metadata
        with pq.ParquetWriter(content, rows.schema, store_schema=False) as writer:
            writer.write_table(rows)
            writer.add_key_value_metadata(
                {key: value for key, value in footer.items() if key.startswith(b"fidpipe.")}
            )
        (folder / name).write_bytes(content.getvalue())
        status = (folder / name).stat()
        digest = hashlib.sha256(content.getvalue()).hexdigest()
        record.files[name] = StoredFile(status.st_size, digest, status.st_mtime_ns)
        store.ledger.put_job(record)


def flip(path, position, bit=2):
    """Flips a bit of a file."""
    content = bytearray(path.read_bytes())
    content[position] ^= 1 << bit
    path.write_bytes(content)


def read_only(folder, mode=0o555):
    """Function for a command's process to call first, so that it may not write there, not even as root.

    mode : of the folder itself
    """

    def forbid():
        for path in (*folder.rglob("*"), folder):
            path.chmod(0o555 if path.is_dir() else 0o444)
        folder.chmod(mode)
        for capability in (_CAP_DAC_OVERRIDE, _CAP_DAC_READ_SEARCH):
            ctypes.CDLL(None).prctl(_PR_CAPBSET_DROP, capability, 0, 0, 0)

    return forbid
