"""A run's folder: where each table lies, by which key it is wanted, and whether what lies there is whole.

A table is written under a name that begins with a dot, flushed and renamed. What was written stands in the run's
index: the key of each job, and length and content hash of each file. A job's result is reused if and only if the index
has it under the wanted key and its files agree with the index. Leaves to others: the index itself (`index`), which
stages there are (`run`), what a table holds (`schemas.tables`).
"""

from __future__ import annotations

import hashlib
import json
import os
import re
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pyarrow as pa
import pyarrow.parquet as pq

from ...schemas.errors import RunError
from ...schemas.tables import TABLES
from .ledger import Index, JobName, JobRecord, StoredFile, note_job

_LOCK = ".lock"
_TOKEN = ".writer"
_LONGEST_NAME_BYTES = 120

#: Parquet encodings by type: sorted ids are small differences, float bytes compress better plane by plane.
_ENCODINGS = {
    pa.int32(): "DELTA_BINARY_PACKED",
    pa.float64(): "BYTE_STREAM_SPLIT",
    pa.float32(): "BYTE_STREAM_SPLIT",
    pa.bool_(): "PLAIN",
}


def key_of(*parts: Any) -> str:
    """A hash of plain values (numbers, strings, lists, dictionaries): equal if and only if they are."""
    return hashlib.sha256(json.dumps(parts, sort_keys=True, allow_nan=False).encode()).hexdigest()


def file_stem(pair_id: str) -> str:
    """A safe file name for a pair: percent-escaped; where that is long or begins oddly, a slug and a hash.

    Examples
    --------
    >>> file_stem("000104"), file_stem("street 5")
    ('000104', 'street%205')
    >>> file_stem("_x")
    'x~a01e47cb4cec0963'
    """
    escaped = quote(pair_id, safe="").replace("~", "%7E")
    if escaped[0].isalnum() and len(escaped) <= _LONGEST_NAME_BYTES:
        return escaped
    slug = re.sub(r"^[^A-Za-z0-9]+", "", escaped)[:80] or "pair"
    return f"{slug}~{hashlib.sha256(pair_id.encode()).hexdigest()[:16]}"


def hash_file(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class TableFolder:
    """The tables of a run, as a job sees them: paths, atomic writes, checked reads. Holds no lock and no index.

    `token` names the run that may write here; a job whose run has ended (killed, and another one started) finds
    another token in the folder and writes nothing.
    """

    def __init__(self, folder: Path, token: str) -> None:
        self.folder = folder
        self.token = token

    def path(self, table: str, pair_id: str, side: str = "") -> Path:
        """Where a table of a pair lies."""
        return self.folder / table / f"{file_stem(pair_id)}{'.' + side if side else ''}.parquet"

    def write(self, table: str, rows: pa.Table, key: str, pair_id: str, side: str = "") -> tuple[str, StoredFile]:
        """Writes a table of a pair under its key; returns its name in the index and what was written."""
        path = self.path(table, pair_id, side)
        return str(path.relative_to(self.folder)), self.write_at(path, table, rows, key)

    def write_at(self, path: Path, table: str, rows: pa.Table, key: str) -> StoredFile:
        """Writes a table to a path of this run, whole or not at all."""
        schema = TABLES[table]
        rows = schema.check(rows)
        own = {
            "fidpipe.table": table,
            "fidpipe.schema_version": str(schema.version),
            "fidpipe.key": key,
        }
        words = [field.name for field in schema.schema if field.type not in _ENCODINGS]
        sink = pa.BufferOutputStream()
        with pq.ParquetWriter(
            sink,
            rows.schema,
            compression="zstd",
            use_dictionary=words,
            write_statistics=words,  # of numbers they cost a quarter of the time, and a file has one pair
            column_encoding={f.name: _ENCODINGS[f.type] for f in schema.schema if f.type in _ENCODINGS},
            store_schema=False,  # so that a dictionary is read as the strings it stands for
        ) as writer:
            writer.write_table(rows)
            writer.add_key_value_metadata(own)
        content = sink.getvalue()
        self.replace(path, content)
        status = path.stat()
        return StoredFile(status.st_size, hashlib.sha256(content).hexdigest(), status.st_mtime_ns, status.st_ctime_ns)

    def read(self, table: str, stored: StoredFile, path: Path, columns: list[str] | None = None) -> pa.Table:
        """Reads a table that must be as it was stored; all columns are checked, or only the named ones are read."""
        content = path.read_bytes()
        if len(content) != stored.size or hashlib.sha256(content).hexdigest() != stored.sha256:
            raise RunError(f"{path}: the file changed while the run was using it; run the same command again")
        schema = TABLES[table]
        rows = pq.read_table(pa.BufferReader(content), columns=columns, read_dictionary=schema.same, use_threads=False)
        return rows if columns else schema.check(rows.cast(schema.schema))

    def replace(self, path: Path, content: bytes | memoryview | pa.Buffer) -> None:
        """Puts a whole file in place of another: written beside it under a dot name, flushed, renamed."""
        self.replace_by(path, [content])

    def replace_by(self, path: Path, parts: Iterable[bytes | memoryview | pa.Buffer]) -> None:
        """The same with a file whose parts are made while it is written, so that they never are in memory together."""
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary = path.with_name(f".{path.name[:100]}.{secrets.token_hex(4)}")
        try:
            with temporary.open("wb") as file:
                file.writelines(parts)
                file.flush()
                os.fsync(file.fileno())
            self._check_token()
            temporary.replace(path)
        finally:
            temporary.unlink(missing_ok=True)

    def note_job(self, record: JobRecord) -> None:
        """Adds a finished job to this process's journal, at once."""
        note_job(self.folder, self.token, record)

    def _check_token(self) -> None:
        try:
            found = (self.folder / _TOKEN).read_text()
        except FileNotFoundError:
            found = ""
        if found != self.token:
            raise RunError(f"run {self.folder}: another run has taken over this folder; this one writes nothing more")


class Store(TableFolder):
    """A run's folder as the command sees it: the one holder of its lock and the one writer of its index.

    records, inputs, failures : see `Index`
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, secrets.token_hex(8))
        self._index = Index(folder)
        self.records, self.inputs, self.failures = self._index.jobs, self._index.inputs, self._index.failures

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the run's lock; the operating system frees it when the process ends, however it ends.

        Raises
        ------
        RunError
            Another run holds it.
        """
        from filelock import FileLock, Timeout

        self.folder.mkdir(parents=True, exist_ok=True)
        lock = FileLock(self.folder / _LOCK)
        try:
            lock.acquire(timeout=0)
        except Timeout:
            raise RunError(
                f"run {self.folder}: another fidpipe is writing here; wait for it, or give another --out"
            ) from None
        try:
            if not self._index.is_as_loaded():
                self._index.load()
            self.token_path.write_text(self.token)
            self.compact()  # a line torn by a crash must not run into the next one
            yield
        finally:
            lock.release()

    @property
    def token_path(self) -> Path:
        """The file that names the run which may write here."""
        return self.folder / _TOKEN

    def take(self, record: JobRecord) -> JobName:
        """Adds a finished job to the index, at once; returns its name."""
        return self._index.put_job(record)

    def note_failure(self, pair_id: str, facts: dict[str, Any]) -> None:
        """Adds to the index why a pair failed, at once."""
        self._index.put_failure(pair_id, facts)

    def note_input(self, name: str, facts: dict[str, Any]) -> None:
        """Adds what was learnt of an input file, at once."""
        self._index.put_input(name, facts)

    def is_whole(self, record: JobRecord) -> bool:
        """Whether the files of a job are as they were written.

        A file whose length and times are those of the moment it was written is taken as it is; any other is hashed.
        """
        return all(_agrees(self.folder / name, stored) for name, stored in record.files.items())

    def forget(self, record: JobRecord) -> None:
        """Removes a job's files and takes it out of the index."""
        for name in record.files:
            (self.folder / name).unlink(missing_ok=True)
        self._index.drop_job(record.name)

    def drop_failure(self, pair_id: str) -> None:
        """Forgets why a pair failed, if it did."""
        self._index.drop_failure(pair_id)

    def strays(self, stage_folders: Iterable[str]) -> list[Path]:
        """Files in the stage folders that are in no record: half-written ones, and those of a killed run."""
        known = {name for record in self.records.values() for name in record.files}
        return [
            Path(entry.path)
            for stage in stage_folders
            if (self.folder / stage).is_dir()
            for entry in os.scandir(self.folder / stage)
            if f"{stage}/{entry.name}" not in known and entry.is_file()
        ]

    def compact(self) -> None:
        """Writes the index anew, each entry once, and does away with the journals; only if there is need."""
        self._index.compact(self.replace_by)


def _agrees(path: Path, stored: StoredFile) -> bool:
    try:
        status = path.stat()
    except FileNotFoundError:
        return False
    if status.st_size != stored.size:
        return False
    if (status.st_mtime_ns, status.st_ctime_ns) == (stored.mtime_ns, stored.ctime_ns):
        return True
    return hash_file(path) == stored.sha256
