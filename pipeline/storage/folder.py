"""A run's folder as the command sees it: its lock, its ledger, which results are whole, and which are nobody's."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from shutil import rmtree

import pyarrow as pa

from ...schemas.errors import RunError
from ...schemas.tables import TABLES
from .ledger import LEDGER, Ledger
from .tables import JobRecord, TableFolder, is_as_stored, read_footer, table_name

_LOCK = ".lock"
_OF_OLDER_VERSIONS = ("index.jsonl", ".journal")


class RunFolder(TableFolder):
    """A run's folder; to be read, or, while `locked`, to be written.

    Attributes
    ----------
    ledger : finished jobs, input files and failures
    """

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, secrets.token_hex(8))
        self.ledger = Ledger(folder / LEDGER, is_writable=False)
        if not self.ledger.is_complete:
            self._adopt()

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the run's lock; the operating system frees it when the process ends, however it ends.

        The finished files of a run that was killed, or whose ledger was lost, are adopted.

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
            self.token_path.write_text(self.token)
            self.ledger.close()
            self.ledger = Ledger(self.folder / LEDGER, is_writable=True)
            if not self.ledger.is_complete:
                self._adopt()
            self.ledger.set_complete(False)
            yield
            self.ledger.set_complete(True)
        finally:
            self.ledger.commit()
            lock.release()

    def read_table(self, table: str, pair_id: str, part: str = "", columns: list[str] | None = None) -> pa.Table:
        """A table of a finished job, or a table of the whole run where `pair_id` is "".

        Raises
        ------
        RunError
            It is not there, or not as it was written.
        """
        name = table_name(table, pair_id, part) if pair_id else f"{table}.parquet"
        record = self.ledger.job_of_file(name)
        if record is None or not self.is_whole(record):
            raise RunError(f"run {self.folder}: {name} is damaged or gone")
        return self.read(table, record.files[name], self.folder / name, columns)

    def is_whole(self, record: JobRecord) -> bool:
        """Whether the files of a job are as they were written."""
        return all(is_as_stored(f"{self.folder}/{name}", stored) for name, stored in record.files.items())

    def forget(self, record: JobRecord) -> None:
        """Removes a job's files and takes it out of the ledger."""
        for name in record.files:
            (self.folder / name).unlink(missing_ok=True)
        self.ledger.drop_job(record)

    def remove_strays(self) -> int:
        """Removes files that no finished job accounts for, half-written ones among them; gives how many were whole."""
        n_whole = 0
        for name in list(self._unknown_files()):
            n_whole += not Path(name).name.startswith(".")
            (self.folder / name).unlink()
        for name in _OF_OLDER_VERSIONS:
            path = self.folder / name
            rmtree(path) if path.is_dir() else path.unlink(missing_ok=True)
        return n_whole

    def _adopt(self) -> None:
        """Adds to the ledger the finished jobs that it does not know, from the footers of their files."""
        parts: dict[tuple[str, str, str, str], JobRecord] = {}
        for name in self._unknown_files():
            told = read_footer(self.folder, name)
            if told is None:
                continue
            record, names = told
            known = parts.setdefault((*record.name, record.key), record)
            known.files.update(record.files)
            if set(known.files) == set(names):
                self.ledger.put_job(known)

    def _unknown_files(self) -> Iterator[str]:
        """Files in the folders of tables that the ledger does not know, by name relative to the run."""
        for table in TABLES:
            if (self.folder / table).is_dir():
                for entry in os.scandir(self.folder / table):
                    name = f"{table}/{entry.name}"
                    if entry.is_file() and not self.ledger.knows_file(name):
                        yield name
