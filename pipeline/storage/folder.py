"""A run's folder as the command sees it: its lock, its ledger, intact results, and orphaned files."""

from __future__ import annotations

import errno
import fcntl
import os
import secrets
from collections.abc import Container, Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from ...schemas.errors import RunError
from ...schemas.tables import TABLES
from .files import is_locked, path_exists
from .ledger import LEDGER, Ledger
from .run_record import command_again, read_run
from .table_files import (
    JobId,
    JobRecord,
    StoredFile,
    TableFolder,
    TablesAtUrl,
    file_stem,
    table_name,
)
from .urls import is_url, name_in_records, url_of_cache

if TYPE_CHECKING:
    import pandas as pd

_LOCK = ".lock"
_NO_LOCKS = (errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS)  # such as NFS without lockd


class RunFolder(TableFolder):
    """A run's folder; to be read, or, while `locked`, to be written."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder, secrets.token_hex(8), url_of_cache(folder))
        if folder.is_dir():
            self.refuse_links()
        self.ledger = Ledger(folder)

    @property
    def is_locked(self) -> bool:
        """True if a command is working on the folder."""
        return is_locked(self.folder / _LOCK)

    def for_workers(self, *, share_disk: bool) -> TableFolder:
        """The tables as workers see them: in the folder, or at the URL alone if they do not share the disk."""
        kind = TablesAtUrl if self.url and not share_disk else TableFolder
        return kind(self.folder, self.token, self.url)

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Holds the run's lock; the operating system frees it when the process ends, however it ends.

        Raises
        ------
        RunError
            Another run holds it, or the folder cannot be written.
        """
        with ExitStack() as lock:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
                file = lock.enter_context((self.folder / _LOCK).open("a"))
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.put_token()
            except BlockingIOError:
                raise RunError(
                    f"run {self.folder}: another fidpipe is writing here; wait for it, or give another --out"
                ) from None
            except OSError as error:
                has_locks = error.errno not in _NO_LOCKS
                fault = "cannot be written" if has_locks else "its file system has no locks"
                raise RunError(
                    f"run {self.folder}: {fault} ({error.strerror}); give another --out"
                ) from error
            try:
                yield
            finally:
                self.ledger.save_hashes()

    def refuse_links(self) -> None:
        """Raises `RunError` where something in the folder is a link: a run reads and writes its own files alone."""
        with os.scandir(self.folder) as entries:
            link = next((entry.name for entry in entries if entry.is_symlink()), None)
        if link is not None:
            raise RunError(
                f"run {self.folder}: expected a file, got the symbolic link {link}; remove the link"
            )

    def finished_jobs(self, pair_id: str) -> dict[JobId, JobRecord]:
        """The jobs of a scored pair.

        Raises
        ------
        RunError
            The file of the pair in the ledger is damaged or gone.
        """
        jobs = self.ledger.jobs(pair_id)
        if not jobs:
            raise self.damaged(f"{LEDGER}/{file_stem(pair_id)}.json")
        return jobs

    def read_table(
        self,
        table: str,
        pair_id: str = "",
        side: str = "",
        columns: list[str] | None = None,
    ) -> pa.Table:
        """A table of one pair (of one side where each side has its own), or of the whole run if `pair_id` is "".

        Parameters
        ----------
        columns : only these, by default all

        Raises
        ------
        RunError
            The file is damaged or gone.
        """
        name = table_name(table, pair_id, side) if pair_id else f"{table}.parquet"
        return self._read(table, self.ledger.files_of(pair_id), name, columns)

    def read_pairs(
        self, pair_ids: Iterable[str], columns: Mapping[tuple[str, str], list[str]]
    ) -> dict[tuple[str, str], pd.DataFrame]:
        """Tables of some pairs, each in one frame, pair after pair; `pair` is the index of the pair of a row.

        Parameters
        ----------
        columns : by table and side ("" if it has both), the columns to read

        Raises
        ------
        RunError
            A file is damaged or gone.
        """
        parts: dict[tuple[str, str], list[pa.Table]] = {source: [] for source in columns}
        for pair_id in pair_ids:
            files = self.ledger.files_of(pair_id)
            for (table, side), names in columns.items():
                name = table_name(table, pair_id, side)
                parts[table, side].append(self._read(table, files, name, names))
        frames = {}
        for source, tables in parts.items():
            sizes = [len(table) for table in tables]
            pair = np.repeat(np.arange(len(tables), dtype=np.int32), sizes)
            frames[source] = pa.concat_tables(tables).to_pandas().assign(pair=pair)
        return frames

    def _read(
        self,
        table: str,
        files: Mapping[str, StoredFile],
        name: str,
        columns: list[str] | None,
    ) -> pa.Table:
        if name not in files:
            raise self.damaged(name)
        return self.read(table, files[name], name, columns)

    def write_table(self, table: str, rows: pa.Table | Iterable[pa.Table], key: str) -> None:
        """Write a table of the whole run, or parts of it, and add it to the ledger under its key."""
        name = f"{table}.parquet"
        stored = self.write_at(self.folder / name, table, rows, key)
        self.ledger.put_job(JobRecord(table, "", "", key, {name: stored}))

    def again(self) -> str:
        """The command that recomputes what is damaged."""
        dataset = read_run(self.folder).get("dataset", "DATASET")
        return f"it again with: {command_again(self.folder, dataset)}"

    def damaged_files(self, record: JobRecord) -> list[str]:
        """Names of the files of a job that are not as they were written; tables at the URL alone are not checked."""
        damaged = []
        for name, stored in record.files.items():
            path = f"{self.folder}/{name}"  # in a third of the time of pathlib
            is_remote = self.url and "/" in name and not path_exists(path)
            if not (is_remote or stored.is_at(path)):
                damaged.append(name)
        return damaged

    def forget(self, pair_id: str, jobs: Container[JobId] | None = None) -> list[JobRecord]:
        """Remove some jobs of a pair, by default all, and their files; returns them."""
        records = list(self.ledger.jobs(pair_id).values())
        if jobs is not None:
            records = [record for record in records if record.job in jobs]
        for record in records:
            for name in record.files:
                (self.folder / name).unlink(missing_ok=True)
        self.ledger.drop_jobs(pair_id, records)
        return records

    def remove_strays(self) -> int:
        """Remove orphaned files, half-written ones included; return the number of intact ones."""
        known = self.ledger.files()
        n_intact = 0
        for table in TABLES:
            names = {f"{table}.parquet"}
            if (self.folder / table).is_dir():
                names |= {f"{table}/{path.name}" for path in (self.folder / table).iterdir()}
            for name in names - known:
                path = self.folder / name
                if path.is_file():
                    path.unlink()
                    n_intact += "/." not in name
        return n_intact


def check_folder(out: Path, dataset: Path, experiment: str = "run") -> None:
    """Raise `RunError` unless a folder is new, empty, or holds the run of this dataset by this command."""
    record = read_run(out) if out.is_dir() else {}
    is_run = (out / LEDGER).is_dir() or bool(record.get("dataset"))
    refuse_other_content(f"{experiment} {out}", out, "a run", is_own=is_run)
    made_by = record.get("experiment", "run")
    before = record.get("dataset")
    if not before:
        return
    if made_by != experiment:
        raise RunError(
            f"{experiment} {out}: was written by fidpipe {made_by}, not by fidpipe {experiment}; "
            "give another --out"
        )
    is_there = is_url(before) or os.path.lexists(before)
    if before != name_in_records(dataset) and is_there:
        raise RunError(
            f"{experiment} {out}: holds the results of {before}, not of {dataset}; give another --out"
        )


def refuse_other_content(name: str, out: Path, kind: str, *, is_own: bool) -> None:
    """Raise `RunError` if results would be written to a file, or to a folder that holds something else.

    Parameters
    ----------
    name : of the results, which begins the message, such as `run OUT`
    kind : of the results, as text
    is_own : whether the folder already holds results of this kind
    """
    if out.exists() and not out.is_dir():
        raise RunError(f"{name}: expected a folder, got a file; give another folder")
    if (
        not is_own
        and out.is_dir()
        and any(not path.name.startswith(".") for path in out.iterdir())
    ):
        raise RunError(
            f"{name}: the folder holds other things than {kind}; give another folder"
        )


def refuse_overwrite(name: str, lost: str, why: Iterable[str]) -> None:
    """Raise `RunError`: a finished result is replaced only with `--replace`.

    Parameters
    ----------
    name : see `refuse_other_content`
    lost : what would be replaced
    why : description of what has changed
    """
    changes = "; ".join(why)
    raise RunError(
        f"{name}: is finished, and {lost} would be replaced ({changes}); add --replace, or give another folder"
    )
