"""A run's ledger: finished jobs, hashes of input files, and why pairs failed. In SQLite.

A cache that only the command writes: the footers of the tables hold the same. It is trusted if it
has the hash that was stored when it was closed properly; else it is deleted and rebuilt from the
footers. Nothing of it is kept in memory, so that a command over ten thousand pairs stays small.
"""

from __future__ import annotations

import os
import sqlite3
import weakref
import zlib
from collections.abc import Collection, Container, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic
from typing import Any

import orjson

from ...schemas.errors import RunError
from .files import disk_full, file_marks, hash_file, write_whole
from .table_files import JobRecord, job_record, plain_record

LEDGER = "ledger.sqlite"
SEAL = "ledger.sha256"
_SECONDS_BETWEEN_COMMITS = 1.0
_LONGEST_PATH = 511
_SECONDS_FOR_READERS = 60.0

_TABLES = """
PRAGMA page_size = 16384;
CREATE TABLE jobs (pair_id TEXT PRIMARY KEY, entry BLOB); -- JSON: values of each JobRecord
CREATE TABLE files (name TEXT PRIMARY KEY, pair_id TEXT) WITHOUT ROWID;
CREATE TABLE hashes (path BLOB PRIMARY KEY, marks TEXT, sha256 TEXT) WITHOUT ROWID;
CREATE TABLE failures (pair_id TEXT PRIMARY KEY, key TEXT, reason TEXT) WITHOUT ROWID;
"""


_LAYOUT = zlib.crc32(_TABLES.encode()) >> 1  # in the file; one with other tables is rebuilt


class Ledger:
    """The ledger of a run's folder, or an empty one in memory if no intact one exists and none may be written.

    Parameters
    ----------
    path : of the file
    is_writable : if False, nothing is written to disk

    Attributes
    ----------
    is_complete : whether it was closed in order, and so knows every finished job

    Raises
    ------
    RunError
        It cannot be written: here, and later when something is put in.
    """

    def __init__(self, path: Path, *, is_writable: bool) -> None:
        self._path, self.is_writable = path, is_writable
        self._begun: float | None = None
        self._seal = path.with_name(SEAL)
        try:
            self.is_complete = self._is_sealed()
            self._db = self._open() if is_writable else _read_only(path, self.is_complete)
        except sqlite3.DatabaseError:  # damaged
            self.is_complete = False
            if is_writable:
                for file in (path, path.with_name(f"{path.name}-journal"), self._seal):
                    file.unlink(missing_ok=True)
            self._db = self._open() if is_writable else _in_memory()
        weakref.finalize(self, self._db.close)

    def close(self) -> None:
        """Write pending entries and close the file."""
        self.commit()
        self._db.close()

    def commit(self) -> None:
        """Write the entries added since the last call."""
        if self._begun is not None:
            self._begun = None
            with self._writing():
                self._db.execute("COMMIT")

    def set_complete(self, is_complete: bool) -> None:
        """Record immediately whether the ledger lists every finished job."""
        self.commit()
        if is_complete:
            write_whole(self._seal, hash_file(self._path).encode())
        else:
            self._seal.unlink(missing_ok=True)
        self.is_complete = is_complete

    def jobs(self, pair_id: str) -> dict[tuple[str, str], JobRecord]:
        """The finished jobs of a pair, by stage and part; those of the whole run under ""."""
        row = self._db.execute("SELECT entry FROM jobs WHERE pair_id = ?", (pair_id,)).fetchone()
        try:
            records = [] if row is None else [job_record(values) for values in orjson.loads(row[0])]
        except (
            ValueError,
            TypeError,
            AttributeError,
        ) as error:  # of a run that was not closed in order
            raise RunError(
                f"{self._path}: damaged; remove it, it is rebuilt from the tables"
            ) from error
        return {record.job: record for record in records}

    def job_of_file(self, name: str) -> JobRecord | None:
        """The finished job that made a file, by its name relative to the run."""
        row = self._db.execute("SELECT pair_id FROM files WHERE name = ?", (name,)).fetchone()
        records = self.jobs(row[0]).values() if row is not None else ()
        return next((record for record in records if name in record.files), None)

    def files(self, folder: str) -> set[str]:
        """Names of the files of finished jobs in a folder of the run; those outside of folders for ""."""
        if not folder:
            return {
                name
                for (name,) in self._db.execute("SELECT name FROM files WHERE instr(name, '/') = 0")
            }
        span = f"{folder}/", f"{folder}0"  # 0 follows / in ASCII
        return {
            name
            for (name,) in self._db.execute(
                "SELECT name FROM files WHERE name >= ? AND name < ?", span
            )
        }

    def pair_ids(self) -> Iterator[str]:
        """The pairs with finished jobs, by name."""
        for (pair_id,) in self._db.execute(
            "SELECT pair_id FROM jobs WHERE pair_id != '' ORDER BY pair_id"
        ):
            yield pair_id

    def put_jobs(self, pair_id: str, records: Collection[JobRecord]) -> None:
        """Adds finished jobs of a pair, in place of those of the same names; those of the whole run under ""."""
        jobs = self.jobs(pair_id) | {record.job: record for record in records}
        self._put_records(pair_id, jobs.values())
        for name in [name for record in records for name in record.files]:
            self._change("INSERT OR REPLACE INTO files VALUES (?, ?)", name, pair_id)

    def put_job(self, record: JobRecord) -> None:
        """Adds one finished job."""
        self.put_jobs(record.pair_id, [record])

    def drop_jobs(self, pair_id: str, records: Collection[JobRecord]) -> None:
        """Forgets finished jobs of a pair."""
        dropped = {record.job for record in records}
        left = [record for job, record in self.jobs(pair_id).items() if job not in dropped]
        self._put_records(pair_id, left)
        for record in records:
            for name in record.files:
                self._change("DELETE FROM files WHERE name = ?", name)

    def _put_records(self, pair_id: str, records: Collection[JobRecord]) -> None:
        if records:
            entry = orjson.dumps(
                [plain_record(record) for record in records], option=orjson.OPT_SERIALIZE_NUMPY
            )
            self._change("INSERT OR REPLACE INTO jobs VALUES (?, ?)", pair_id, entry)
        else:
            self._change("DELETE FROM jobs WHERE pair_id = ?", pair_id)

    def input_hash(self, path: Path) -> str:
        """SHA-256 of an input file; computed again only if its length, times or inode have changed."""
        name = os.fsencode(path.absolute())
        marks = file_marks(path)
        row = self._db.execute(
            "SELECT sha256 FROM hashes WHERE path = ? AND marks = ?", (name, marks)
        ).fetchone()
        if row is not None:
            return str(row[0])
        sha256 = hash_file(path)
        if self.is_writable:
            self._change("INSERT OR REPLACE INTO hashes VALUES (?, ?, ?)", name, marks, sha256)
        return sha256

    def failure(self, pair_id: str, keys: Container[str]) -> str | None:
        """Reason why a pair failed, if the failed job has one of these keys."""
        row = self._db.execute(
            "SELECT key, reason FROM failures WHERE pair_id = ?", (pair_id,)
        ).fetchone()
        return str(row[1]) if row is not None and row[0] in keys else None

    def failed_pairs(self) -> list[str]:
        """The pairs that failed, by name."""
        return [
            pair_id
            for (pair_id,) in self._db.execute("SELECT pair_id FROM failures ORDER BY pair_id")
        ]

    def put_failure(self, pair_id: str, key: str, reason: str) -> None:
        """Adds the key of the failed job of a pair, and the reason."""
        self._change("INSERT OR REPLACE INTO failures VALUES (?, ?, ?)", pair_id, key, reason)

    def drop_failure(self, pair_id: str) -> None:
        """Forgets why a pair failed, if it did."""
        self._change("DELETE FROM failures WHERE pair_id = ?", pair_id)

    def _change(self, order: str, *values: Any) -> None:
        now = monotonic()
        with self._writing():
            if self._begun is None:
                self._db.execute("BEGIN")
                self._begun = now
            self._db.execute(order, values)
        if now - self._begun > _SECONDS_BETWEEN_COMMITS:
            self.commit()

    def _is_sealed(self) -> bool:
        """True if the ledger was closed in order; raises `sqlite3.DatabaseError` if it has changed since."""
        if not (self._seal.is_file() and self._path.is_file()):
            return False
        if self._seal.read_text(errors="replace") != hash_file(self._path):
            raise sqlite3.DatabaseError("the ledger is not as it was closed")
        return True

    def _open(self) -> sqlite3.Connection:
        try:
            db = _connect(self._path, timeout=_SECONDS_FOR_READERS)
        except sqlite3.OperationalError as error:
            n = len(str(self._path.absolute()))
            why = (
                f"a path of {n} characters, SQLite takes {_LONGEST_PATH}"
                if n > _LONGEST_PATH
                else str(error)
            )
            raise RunError(f"{self._path}: cannot be opened ({why}); give another --out") from error
        try:
            names = {name for (name,) in db.execute("SELECT name FROM sqlite_master")}
            if not names:
                _make_tables(db)
            elif _layout(db) != _LAYOUT:
                raise sqlite3.DatabaseError("the ledger has other tables")
        except (
            sqlite3.OperationalError
        ) as error:  # locked by another program, no permission, a full disk
            db.close()
            if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise disk_full(self._path, error) from error
            raise RunError(
                f"{self._path}: cannot be written ({error}); give another --out"
            ) from error
        except sqlite3.DatabaseError:
            db.close()
            raise
        return db

    @contextmanager
    def _writing(self) -> Iterator[None]:
        try:
            yield
        except sqlite3.OperationalError as error:
            self._begun = None
            if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise disk_full(self._path, error) from error
            raise RunError(
                f"{self._path}: cannot be written ({error}); run the same command again"
            ) from error


def _connect(path: Path | str, **options: Any) -> sqlite3.Connection:
    """A connection without implicit transactions that any thread may close."""
    db: sqlite3.Connection = sqlite3.connect(
        path, isolation_level=None, check_same_thread=False, **options
    )
    return db


def _in_memory() -> sqlite3.Connection:
    db = _connect(":memory:")
    _make_tables(db)
    return db


def _make_tables(db: sqlite3.Connection) -> None:
    db.executescript(f"{_TABLES} PRAGMA user_version = {_LAYOUT};")


def _layout(db: sqlite3.Connection) -> int:
    return int(db.execute("PRAGMA user_version").fetchone()[0])


def _read_only(path: Path, is_complete: bool) -> sqlite3.Connection:
    """The ledger for a reader, who writes nothing, not even a lock where the medium is read-only.

    One that does not know every finished job is copied into memory, where the others can be added.
    """
    if not path.exists():
        return _in_memory()
    for mode in ("mode=ro", "mode=ro&immutable=1"):
        db = _connect(f"{path.resolve().as_uri()}?{mode}", uri=True)
        try:
            layout = _layout(db)
        except sqlite3.OperationalError:
            db.close()
            continue
        if layout != _LAYOUT:
            db.close()
            break
        if is_complete:
            return db
        copy = _connect(":memory:")
        db.backup(copy)
        db.close()
        return copy
    raise sqlite3.DatabaseError(f"{path} cannot be opened, or has other tables")
