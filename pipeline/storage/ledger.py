"""The ledger of a run: which jobs of each pair are finished, and why a pair failed. One small file per pair.

Only the command writes it, each file atomically, after the tables that the file names. The file of
a pair is what says that its tables exist; one that is damaged counts as absent, and its jobs run
again. Nothing is kept in memory but the hashes of input files.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Container, Iterable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import orjson
from pydantic import TypeAdapter, ValidationError

from .files import file_marks, hash_file, write_whole
from .table_files import JobId, JobRecord, StoredFile, file_stem

LEDGER = "ledger"  #: the folder of its files in that of a run
INPUT_HASHES = "_inputs.json"  #: in it: hashes of input files, which only this machine can use
_WHOLE_RUN = "_run"  # in it: the tables of the whole run; no pair has a file of this name


@dataclass
class _PairEntry:
    """The content of the file of a pair.

    jobs : that are finished
    failure : key of the job that failed, and the reason; None if none did
    """

    pair_id: str
    jobs: list[JobRecord] = field(default_factory=list)
    failure: tuple[str, str] | None = None


_ENTRY = TypeAdapter(_PairEntry)


class Ledger:
    """The ledger of a run's folder; pairs are named by pair_id, and "" is the whole run."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder / LEDGER
        self._hashes: dict[str, list[str]] | None = None
        self._has_new_hashes = False

    def jobs(self, pair_id: str) -> dict[JobId, JobRecord]:
        """The finished jobs of a pair, by stage and part."""
        return {record.job: record for record in self._read(pair_id).jobs}

    def pair_ids(self) -> list[str]:
        """The pairs with finished jobs or a failure, by name."""
        names = []
        for path in self._folder.glob("[!._]*.json"):
            stem = path.stem
            entry = self._entry(stem) if "~" in stem else _PairEntry(unquote(stem))
            if entry is not None:
                names.append(entry.pair_id)
        return sorted(names)

    def files_of(self, pair_id: str) -> dict[str, StoredFile]:
        """The files of the finished jobs of a pair, by name relative to the run."""
        files: dict[str, StoredFile] = {}
        for record in self.jobs(pair_id).values():
            files |= record.files
        return files

    def files(self) -> set[str]:
        """Names of all files of finished jobs, relative to the run."""
        return set().union(*map(self.files_of, ("", *self.pair_ids())))

    def put_jobs(self, pair_id: str, records: Iterable[JobRecord]) -> None:
        """Add finished jobs of a pair, in place of those of the same names; an earlier failure is forgotten."""
        jobs = self.jobs(pair_id) | {record.job: record for record in records}
        self._write(_PairEntry(pair_id, list(jobs.values())))

    def put_job(self, record: JobRecord) -> None:
        """Add one finished job."""
        self.put_jobs(record.pair_id, [record])

    def drop_jobs(self, pair_id: str, records: Iterable[JobRecord]) -> None:
        """Forget finished jobs of a pair."""
        entry = self._read(pair_id)
        dropped = {record.job for record in records}
        self._write(replace(entry, jobs=[job for job in entry.jobs if job.job not in dropped]))

    def failure(self, pair_id: str, keys: Container[str]) -> str | None:
        """Reason why a pair failed, if the failed job has one of these keys."""
        failure = self._read(pair_id).failure
        return failure[1] if failure is not None and failure[0] in keys else None

    def put_failure(self, pair_id: str, key: str, reason: str) -> None:
        """Add the key of the failed job of a pair, and the reason."""
        self._write(replace(self._read(pair_id), failure=(key, reason)))

    def input_hash(self, path: Path) -> str:
        """SHA-256 of an input file; computed again only if its length, times or inode have changed."""
        if self._hashes is None:
            self._hashes = load_json(self._folder / INPUT_HASHES) or {}
        name = os.fsencode(path.absolute()).decode("latin-1")
        marks = file_marks(path)
        known = self._hashes.get(name)
        if known is None or known[0] != marks:
            known = self._hashes[name] = [marks, hash_file(path)]
            self._has_new_hashes = True
        return known[1]

    def save_hashes(self) -> None:
        """Write the hashes of input files that were computed, for later commands."""
        if self._has_new_hashes:
            self._has_new_hashes = False
            save_json(self._folder / INPUT_HASHES, self._hashes)

    def _read(self, pair_id: str) -> _PairEntry:
        entry = self._entry(file_stem(pair_id) if pair_id else _WHOLE_RUN)
        return entry if entry is not None and entry.pair_id == pair_id else _PairEntry(pair_id)

    def _entry(self, stem: str) -> _PairEntry | None:
        """The content of a file; None if it does not exist or is damaged."""
        try:
            return _ENTRY.validate_python(load_json(self._folder / f"{stem}.json"))
        except ValidationError:
            return None

    def _write(self, entry: _PairEntry) -> None:
        path = (
            self._folder / f"{file_stem(entry.pair_id) if entry.pair_id else _WHOLE_RUN}.json"
        )
        if entry.jobs or entry.failure is not None:
            save_json(path, entry)
        else:
            path.unlink(missing_ok=True)


def save_json(path: Path, content: Any) -> None:
    """Write JSON with the hash of its text in the line before it."""
    text = orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY)
    digest = hashlib.sha256(text).hexdigest().encode()
    write_whole(path, b"%s\n%s\n" % (digest, text), outlasts_power=False)


def load_json(path: Path) -> Any:
    """The content that `save_json` wrote; None if the file does not exist, or has changed."""
    try:
        digest, _, text = path.read_bytes().partition(b"\n")
        if hashlib.sha256(text[:-1]).hexdigest().encode() == digest:
            return orjson.loads(text)
    except (OSError, ValueError):
        pass
    return None
