"""The tables of a run's folder: paths, writing and reading, and the record of the job that made them.

A table is written under a name that begins with a dot and renamed. The record of its job, which the
ledger keeps, has the length and the hash of each file.
"""

from __future__ import annotations

import hashlib
import os
import re
import stat
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Annotated, Any
from urllib.parse import quote

import orjson
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import StringConstraints

from ...schemas.columns import Table
from ...schemas.errors import RunError
from ...schemas.tables import TABLES
from .files import write_whole
from .object_store import read_object, write_object

TOKEN = ".writer"  #: the file that names the run which may write
_LONGEST_NAME_BYTES = 120
_SECONDS_BETWEEN_CHECKS = 10.0
_FEWEST_COMPRESSED = 1000  # rows; of smaller tables the compressor takes a third of the time

#: Parquet encodings by type: sorted ids are small differences, float bytes compress better plane by
#: plane.
_ENCODINGS = {
    pa.int32(): "DELTA_BINARY_PACKED",
    pa.float64(): "BYTE_STREAM_SPLIT",
    pa.float32(): "BYTE_STREAM_SPLIT",
    pa.bool_(): "PLAIN",
}

#: What a table of a run may be called: `TABLE.parquet`, or `TABLE/FILE.parquet`; nothing that leads
#: out of the folder.
TableName = Annotated[
    str, StringConstraints(pattern=r"^[a-z0-9_]+(\.parquet|/[A-Za-z0-9][^/\x00]*)$")
]

JobName = tuple[str, str, str]  #: stage, pair_id, part (a side, or "" for one job of a pair)
JobId = tuple[str, str]  #: stage and part, among the jobs of a pair


@dataclass(frozen=True)
class StoredFile:
    """A file as it was written: its length, content hash, and time in the file system."""

    size: int
    sha256: str
    mtime_ns: int

    def is_at(self, path: Path | str) -> bool:
        """True if the file at a path is as it was written, and not a link; hashed only if length or time differ."""
        status = self._status(path)
        is_same = status is not None and status.st_mtime_ns == self.mtime_ns
        return is_same or self.read(path) is not None

    def read(self, path: Path | str) -> bytes | None:
        """The content as it was written; None if the file is a link, has another content, or cannot be read."""
        if self._status(path) is None:
            return None
        try:
            content = Path(path).read_bytes()
        except OSError:
            return None
        return content if hashlib.sha256(content).hexdigest() == self.sha256 else None

    def _status(self, path: Path | str) -> os.stat_result | None:
        """Of the file at a path, if it has the right length and is not a link."""
        try:
            status = os.lstat(path)
        except OSError:
            return None
        is_like = status.st_size == self.size and stat.S_ISREG(status.st_mode)
        return status if is_like else None


@dataclass
class JobRecord:
    """A finished job.

    stage, pair_id, part : what it is called
    key : of its result
    files : by path relative to the run
    reads : keys of what it read
    metadata : small results that are not a table, as JSON has them
    steps : name and seconds of each step
    made_by : token of the run that made it; "" where that is not known
    """

    stage: str
    pair_id: str
    part: str
    key: str
    files: dict[TableName, StoredFile] = field(default_factory=dict)
    reads: tuple[str, ...] = ()
    metadata: dict[str, Any] = field(default_factory=dict)
    steps: tuple[tuple[str, float], ...] = ()
    made_by: str = ""

    @property
    def name(self) -> JobName:
        """Name of the job."""
        return self.stage, self.pair_id, self.part

    @property
    def job(self) -> JobId:
        """Name among the jobs of its pair."""
        return self.stage, self.part


def plain_metadata(metadata: dict[str, Any]) -> dict[str, Any]:
    """Metadata as read back from JSON: dictionaries for dataclasses, lists for tuples and arrays, Python's numbers."""
    return orjson.loads(orjson.dumps(metadata, option=orjson.OPT_SERIALIZE_NUMPY))


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


def table_name(table: str, pair_id: str, part: str = "") -> str:
    """Path of a table of a pair, relative to the run's folder."""
    return f"{table}/{file_stem(pair_id)}{'.' + part if part else ''}.parquet"


class TableFolder:
    """The tables of a run, as a job sees them: paths, atomic writes, checked reads. Holds no lock and no ledger.

    `token` names the run that may write here; a job whose run has ended (killed, and another one
    started) finds another token in the folder and writes nothing. Tables that the folder lacks are
    read from `url`, if there is one.
    """

    def __init__(self, folder: Path, token: str, url: str = "") -> None:
        self.folder = folder
        self.token = token
        self.url = url
        self._token_path = folder / TOKEN

    def write_job(self, record: JobRecord, tables: dict[str, pa.Table]) -> None:
        """Write the tables of a finished job, and add their files to its record.

        Parameters
        ----------
        tables : by name, as in `schemas.tables`

        Raises
        ------
        RunError
            Another run has taken over the folder, or it cannot be written.
        """
        self.check_token()
        record.made_by = self.token
        for table, rows in tables.items():
            name = table_name(table, record.pair_id, record.part)
            record.files[name] = self.write_at(self.folder / name, table, rows, record.key)

    def write_at(
        self, path: Path, table: str, rows: pa.Table | Iterable[pa.Table], key: str
    ) -> StoredFile:
        """Write a table to a path of this run atomically.

        Parameters
        ----------
        rows : which the writer checks against the table's schema; or parts of them, in their order
        key : of the result, for the footer
        """
        schema = TABLES[table]
        parts = [rows] if isinstance(rows, pa.Table) else rows
        footer = {
            "fidpipe.table": table,
            "fidpipe.schema_version": str(schema.version),
            "fidpipe.key": key,
        }
        is_small = isinstance(rows, pa.Table) and rows.num_rows < _FEWEST_COMPRESSED
        options = _writer_options(schema) | {"compression": "none" if is_small else "zstd"}
        sink = pa.BufferOutputStream()
        with pq.ParquetWriter(sink, schema.schema, **options) as writer:
            for part in parts:
                writer.write_table(part)
            writer.add_key_value_metadata(footer)
        content = memoryview(sink.getvalue())
        sha256 = hashlib.sha256(content).hexdigest()
        return StoredFile(len(content), sha256, self._store(path, content))

    def read(
        self, table: str, stored: StoredFile, name: str, columns: list[str] | None = None
    ) -> pa.Table:
        """The rows of a table of this run, which must be as it was stored and have the columns of its schema.

        Parameters
        ----------
        stored : the file as it was written
        name : of the file, relative to the run
        columns : only these, by default all

        Raises
        ------
        RunError
            The file is damaged or gone.
        """
        content = self.content(stored, name)
        try:
            rows = pq.ParquetFile(pa.BufferReader(content)).read(columns, use_threads=False)
            return TABLES[table].check(rows) if columns is None else rows.select(columns)
        except (OSError, ValueError, KeyError, pa.ArrowException) as error:
            raise self.damaged(name, str(error)) from error

    def content(self, stored: StoredFile, name: str) -> bytes:
        """The content of a file as it was written, here or else at the URL.

        Raises
        ------
        RunError
            It is damaged or gone. If its time does not show it, as on a failing disk, it gets
            another one, so that the next run recomputes it.
        StoreError
            It cannot be read there.
        """
        path = self.folder / name
        content = stored.read(path)
        if content is None and self.url:
            content = read_object(f"{self.url}/{name}")
            content = content if hashlib.sha256(content).hexdigest() == stored.sha256 else None
        if content is None:
            with suppress(OSError):
                os.utime(path, follow_symlinks=False)
            raise self.damaged(name)
        return content

    def _store(self, path: Path, content: memoryview) -> int:
        write_whole(path, content, outlasts_power=False)
        return path.stat().st_mtime_ns

    def damaged(self, name: str, cause: str = "") -> RunError:
        """The error of a file that is not as it was stored."""
        why = f" ({cause})" if cause else ""
        return RunError(
            f"run {self.folder}: {name} is damaged or gone{why}; run {self.again()}"
        )

    def again(self) -> str:
        """How to recompute what is damaged."""
        return "the same command again"

    def put_token(self) -> None:
        """Name the run of this token as the only one that may write."""
        self._token_path.write_text(self.token)

    def check_token(self) -> None:
        """Raises `RunError` where another run has taken over the folder."""
        try:
            token = self._token_path.read_text()
        except FileNotFoundError:
            token = ""
        self._compare(token)

    def _compare(self, token: str) -> None:
        if token != self.token:
            raise RunError(
                f"run {self.folder}: another run has taken over this folder; this one writes nothing more"
            )


class TablesAtUrl(TableFolder):
    """The tables of a run for a worker that does not share its folder: each is one object, read and written whole."""

    def put_token(self) -> None:
        """See `TableFolder`."""
        write_object(f"{self.url}/{TOKEN}", self.token.encode())

    def check_token(self) -> None:
        """See `TableFolder`; a process asks every ten seconds."""
        if (
            monotonic() - _CHECKED.get(self.token, -_SECONDS_BETWEEN_CHECKS)
            >= _SECONDS_BETWEEN_CHECKS
        ):
            self._compare(read_object(f"{self.url}/{TOKEN}").decode())
            _CHECKED[self.token] = monotonic()

    def _store(self, path: Path, content: memoryview) -> int:
        write_object(f"{self.url}/{path.relative_to(self.folder).as_posix()}", bytes(content))
        return 0


_CHECKED: dict[str, float] = {}


@cache
def _writer_options(table: Table) -> dict[str, Any]:
    """Options of `pyarrow.parquet.ParquetWriter`: no statistics, as a file has one pair, and its name no dictionary."""
    columns = [field for field in table.schema if field.name not in table.of_file]
    encodings = {
        field.name: _ENCODINGS[field.type] for field in columns if field.type in _ENCODINGS
    }
    return {
        "use_dictionary": [field.name for field in columns if field.name not in encodings],
        "write_statistics": False,
        "column_encoding": encodings,
        "store_schema": False,
    }
