"""A run's ledger: finished jobs, what was learnt of each input file, and why pairs failed. In SQLite.

A cache that the command alone writes: the same stands in the footers of the tables, from which a lost ledger is made
again. Nothing of it is kept in memory, so that a command over ten thousand pairs stays small.
"""

from __future__ import annotations

import hashlib
import sqlite3
import weakref
from collections.abc import Iterable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import asdict
from functools import cache
from pathlib import Path
from time import monotonic
from typing import Any

import orjson

from ...schemas.errors import RunError
from .files import disk_full
from .tables import JobRecord, job_record

LEDGER = "ledger.sqlite"
_VERSION = 2
_SECONDS_BETWEEN_COMMITS = 1.0
_LONGEST_PATH = 511
_SECONDS_FOR_READERS = 60.0

_TABLES = f"""
PRAGMA page_size = 16384;
CREATE TABLE jobs (pair_id TEXT PRIMARY KEY, entry BLOB, hash TEXT);
CREATE TABLE files (name TEXT PRIMARY KEY, pair_id TEXT) WITHOUT ROWID;
CREATE TABLE inputs (name TEXT PRIMARY KEY, entry BLOB, hash TEXT);
CREATE TABLE failures (pair_id TEXT PRIMARY KEY, entry BLOB, hash TEXT) WITHOUT ROWID;
CREATE TABLE state (name TEXT PRIMARY KEY, value TEXT) WITHOUT ROWID;
PRAGMA user_version = {_VERSION};
"""


_SCHEMA = "SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY type, name"


class Ledger:
    """The ledger of a run's folder, or an empty one in memory where there is none and nothing may be written.

    Entries that do not agree with the hash beside them are not believed.

    Parameters
    ----------
    path : of the file
    is_writable : else nothing is written to disk, whatever is put in

    Raises
    ------
    RunError
        It cannot be written: here, and later where something is put in.
    """

    def __init__(self, path: Path, *, is_writable: bool) -> None:
        self._path = path
        self._begun: float | None = None
        try:
            self._db = self._open(path, is_writable)
        except sqlite3.DatabaseError:  # not a database, torn, or of another version: it is made again
            if is_writable:
                path.unlink(missing_ok=True)
                path.with_name(f"{path.name}-journal").unlink(missing_ok=True)
            self._db = self._open(path, is_writable) if is_writable else _in_memory()
        weakref.finalize(self, self._db.close)

    def close(self) -> None:
        """Writes what is not written yet, and ends the use of the file."""
        self.commit()
        self._db.close()

    def commit(self) -> None:
        """Writes what was put in since the last time."""
        if self._begun is not None:
            self._begun = None
            with self._writing():
                self._db.execute("COMMIT")

    @property
    def is_complete(self) -> bool:
        """Whether it was closed in order: it then knows every finished job."""
        return _is_complete(self._db)

    def set_complete(self, is_complete: bool) -> None:
        """Notes, at once, that it knows every finished job, or that jobs may be finished without it."""
        self._change("INSERT OR REPLACE INTO state VALUES ('is_complete', ?)", "1" if is_complete else "0")
        self.commit()

    def jobs(self, pair_id: str) -> dict[tuple[str, str], JobRecord]:
        """The finished jobs of a pair, by stage and part; those of the whole run under ""."""
        return {(record.stage, record.part): record for record in self._records(pair_id)}

    def job_of_file(self, name: str) -> JobRecord | None:
        """The finished job that made a file, by its name relative to the run."""
        row = self._db.execute("SELECT pair_id FROM files WHERE name = ?", (name,)).fetchone()
        records = self.jobs(row[0]).values() if row is not None else ()
        return next((record for record in records if name in record.files), None)

    def knows_file(self, name: str) -> bool:
        """Whether a finished job made a file of this name."""
        return self._db.execute("SELECT 1 FROM files WHERE name = ?", (name,)).fetchone() is not None

    def pair_ids(self) -> Iterator[str]:
        """The pairs with finished jobs, by name."""
        for (pair_id,) in self._db.execute("SELECT pair_id FROM jobs WHERE pair_id != '' ORDER BY pair_id"):
            yield pair_id

    def put_jobs(self, pair_id: str, records: Iterable[JobRecord]) -> None:
        """Adds finished jobs of a pair, in place of those of the same names; those of the whole run under ""."""
        added = {record.name: record for record in records}
        kept = [record for record in self._records(pair_id) if record.name not in added]
        self._put_records(pair_id, [*kept, *added.values()])
        for record in added.values():
            for name in record.files:
                self._change("INSERT OR REPLACE INTO files VALUES (?, ?)", name, pair_id)

    def put_job(self, record: JobRecord) -> None:
        """Adds one finished job."""
        self.put_jobs(record.pair_id, [record])

    def drop_job(self, record: JobRecord) -> None:
        """Forgets a finished job."""
        kept = [other for other in self._records(record.pair_id) if other.name != record.name]
        self._put_records(record.pair_id, kept)
        for name in record.files:
            self._change("DELETE FROM files WHERE name = ?", name)

    def _records(self, pair_id: str) -> list[JobRecord]:
        """The finished jobs of a pair; none of an entry that is not as this ledger writes them."""
        row = self._db.execute("SELECT entry, hash FROM jobs WHERE pair_id = ?", (pair_id,)).fetchone()
        try:
            records = [job_record(entry) for entry in orjson.loads(row[0])] if row and _agrees(*row) else []
        except (ValueError, TypeError):
            return []
        return [record for record in records if record.pair_id == pair_id]

    def _put_records(self, pair_id: str, records: list[JobRecord]) -> None:
        if records:
            self._put("INSERT OR REPLACE INTO jobs VALUES (?, ?, ?)", pair_id, [asdict(record) for record in records])
        else:
            self._change("DELETE FROM jobs WHERE pair_id = ?", pair_id)

    def input(self, name: str) -> dict[str, Any] | None:
        """What was learnt of an input file; None if nothing."""
        return self._entry("SELECT entry, hash FROM inputs WHERE name = ?", name)

    def put_input(self, name: str, facts: Mapping[str, Any]) -> None:
        """Adds what was learnt of an input file."""
        self._put("INSERT OR REPLACE INTO inputs VALUES (?, ?, ?)", name, facts)

    def failure(self, pair_id: str) -> dict[str, Any] | None:
        """Why a pair failed (`key` of the job that did, `reason`); None if it did not."""
        return self._entry("SELECT entry, hash FROM failures WHERE pair_id = ?", pair_id)

    def failed_pairs(self) -> list[str]:
        """The pairs that failed, by name."""
        return [pair_id for (pair_id,) in self._db.execute("SELECT pair_id FROM failures ORDER BY pair_id")]

    def put_failure(self, pair_id: str, facts: Mapping[str, Any]) -> None:
        """Adds why a pair failed."""
        self._put("INSERT OR REPLACE INTO failures VALUES (?, ?, ?)", pair_id, facts)

    def drop_failure(self, pair_id: str) -> None:
        """Forgets why a pair failed, if it did."""
        self._change("DELETE FROM failures WHERE pair_id = ?", pair_id)

    def _entry(self, question: str, name: str) -> dict[str, Any] | None:
        row = self._db.execute(question, (name,)).fetchone()
        try:
            entry = orjson.loads(row[0]) if row is not None and _agrees(*row) else None
        except ValueError:
            return None
        return entry if isinstance(entry, dict) else None

    def _put(self, order: str, name: str, facts: Any) -> None:
        entry = orjson.dumps(facts, option=orjson.OPT_SERIALIZE_NUMPY)
        self._change(order, name, entry, _hash(entry))

    def _change(self, order: str, *values: Any) -> None:
        now = monotonic()
        with self._writing():
            if self._begun is None:
                self._db.execute("BEGIN")
                self._begun = now
            self._db.execute(order, values)
        if now - self._begun > _SECONDS_BETWEEN_COMMITS:
            self.commit()

    @staticmethod
    def _open(path: Path, is_writable: bool) -> sqlite3.Connection:
        if not is_writable:
            return _read_only(path) if path.exists() else _in_memory()
        try:
            db = _connect(path, timeout=_SECONDS_FOR_READERS)
        except sqlite3.OperationalError as error:
            n = len(str(path.absolute()))
            why = f"a path of {n} characters, SQLite takes {_LONGEST_PATH}" if n > _LONGEST_PATH else str(error)
            raise RunError(f"{path}: cannot be opened ({why}); give another --out") from error
        try:
            with _damage_named():
                if not db.execute("SELECT 1 FROM sqlite_master").fetchone():
                    db.executescript(_TABLES)
                _check(db)
        except sqlite3.OperationalError as error:  # locked by another program, no permission, a full disk
            db.close()
            if error.sqlite_errorcode == sqlite3.SQLITE_FULL:
                raise disk_full(path, error) from error
            raise RunError(f"{path}: cannot be written ({error}); give another --out") from error
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
            raise RunError(f"{self._path}: cannot be written ({error}); run the same command again") from error


def _connect(path: Path | str, **options: Any) -> sqlite3.Connection:
    """A connection that begins no transaction by itself, and that whichever thread collects the ledger may close."""
    db: sqlite3.Connection = sqlite3.connect(path, isolation_level=None, check_same_thread=False, **options)
    return db


def _in_memory() -> sqlite3.Connection:
    db = _connect(":memory:")
    db.executescript(_TABLES)
    return db


def _read_only(path: Path) -> sqlite3.Connection:
    """The ledger for a reader, who writes nothing, not even a lock where the medium is read-only.

    One that does not know every finished job is copied into memory, where the others can be added.
    """
    for mode in ("mode=ro", "mode=ro&immutable=1"):
        db = _connect(f"{path.resolve().as_uri()}?{mode}", uri=True)
        try:
            with _damage_named():
                _check(db)
        except sqlite3.OperationalError:
            db.close()
            continue
        except sqlite3.DatabaseError:
            db.close()
            raise
        if _is_complete(db):
            return db
        copy = _connect(":memory:")
        db.backup(copy)
        db.close()
        return copy
    raise sqlite3.DatabaseError(f"{path} cannot be opened")


def _check(db: sqlite3.Connection) -> None:
    """Raises `sqlite3.DatabaseError` where it is no ledger of this version, or damaged."""
    if db.execute("PRAGMA user_version").fetchone()[0] != _VERSION:
        raise sqlite3.DatabaseError("a ledger of another version")
    if db.execute("PRAGMA quick_check(1)").fetchone()[0] != "ok":
        raise sqlite3.DatabaseError("a damaged ledger")
    if db.execute(_SCHEMA).fetchall() != _own_schema():  # views and triggers of others would run with our statements
        raise sqlite3.DatabaseError("a ledger with other tables")


@contextmanager
def _damage_named() -> Iterator[None]:
    """Makes text that is none, in names or in what SQLite says of them, an error of the database."""
    try:
        yield
    except UnicodeDecodeError as error:
        raise sqlite3.DatabaseError("a damaged ledger") from error


def _is_complete(db: sqlite3.Connection) -> bool:
    row = db.execute("SELECT value FROM state WHERE name = 'is_complete'").fetchone()
    return row is not None and row[0] == "1"


@cache
def _own_schema() -> list[tuple[str, ...]]:
    with closing(_in_memory()) as db:
        return db.execute(_SCHEMA).fetchall()


def _hash(entry: bytes) -> str:
    return hashlib.blake2b(entry, digest_size=8).hexdigest()


def _agrees(entry: object, check: object) -> bool:
    return isinstance(entry, bytes) and _hash(entry) == check
