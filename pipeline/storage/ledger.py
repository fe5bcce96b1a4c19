"""A run's index: one JSON line for each finished job, each input file that was read, and each pair that failed.

What a line holds stays on disk and is read when it is asked for; in memory are names and places, so that a command
over ten thousand pairs stays small. Each line begins with a hash of itself: what is torn or damaged is not believed.
While a run works, each process notes its jobs in a journal of its own, so that nothing is lost if it is killed.
Leaves to others: who may write (`store`), what a record means (`plan`).
"""

from __future__ import annotations

import hashlib
import os
import platform
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Generic, TypeVar

import orjson

INDEX = "index.jsonl"
_JOURNALS = ".journal"

JobName = tuple[str, str, str]  #: stage, pair_id, side ("" where the stage takes both sides)
Place = int | bytes  #: where in the index a line begins; or the line itself, of a journal
Entry = dict[str, Any]
Name = TypeVar("Name")
Value = TypeVar("Value")


@dataclass(frozen=True)
class StoredFile:
    """A file as it was written: its length and content hash, and the file system's marks of that moment."""

    size: int
    sha256: str
    mtime_ns: int
    ctime_ns: int


@dataclass(frozen=True)
class JobRecord:
    """A finished job.

    files : by path relative to the run
    facts : small results that are not a table
    steps : name and seconds of each step
    """

    stage: str
    pair_id: str
    side: str
    key: str
    files: dict[str, StoredFile]
    facts: dict[str, Any] = field(default_factory=dict)
    steps: tuple[tuple[str, float], ...] = ()

    @property
    def name(self) -> JobName:
        """What the job is called in the index."""
        return self.stage, self.pair_id, self.side


class Entries(Mapping[Name, Value], Generic[Name, Value]):
    """One kind of entries by name, each read from the disk when it is asked for."""

    def __init__(self, read: Callable[[Place], Entry], decode: Callable[[Entry], Value]) -> None:
        self.places: dict[Name, Place] = {}
        self._read, self._decode = read, decode

    def __getitem__(self, name: Name) -> Value:
        return self._decode(self._read(self.places[name]))

    def __contains__(self, name: object) -> bool:
        return name in self.places

    def __iter__(self) -> Iterator[Name]:
        return iter(self.places)

    def __len__(self) -> int:
        return len(self.places)


class Index:
    """The index of a run's folder, and the journals beside it that were not gathered yet.

    jobs, inputs, failures : finished jobs; what was learnt of each input file; why each failed pair failed
    is_compact : each entry stands in the index once, and there is no journal
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._file: BinaryIO | None = None
        self._loaded: list[tuple[Path, int, int]] = []
        self.jobs: Entries[JobName, JobRecord] = Entries(self._entry, _job_record)
        self.inputs: Entries[str, Entry] = Entries(self._entry, _facts)
        self.failures: Entries[str, Entry] = Entries(self._entry, _facts)
        self.is_compact = False
        self.load()

    def load(self) -> None:
        """Learns the names and places of all entries anew."""
        for entries in (self.jobs, self.inputs, self.failures):
            entries.places.clear()
        self._close()
        self._loaded = self._files()
        n_lines, is_torn = 0, False
        for path, _, _ in self._loaded:
            place = 0
            with path.open("rb") as file:
                for line in file:
                    n_lines += 1
                    is_torn |= not line.endswith(b"\n")
                    self._learn(line, place if path.name == INDEX else line)
                    place += len(line)
        n_entries = len(self.jobs) + len(self.inputs) + len(self.failures)
        self.is_compact = len(self._loaded) == 1 and n_lines == n_entries and not is_torn

    def is_as_loaded(self) -> bool:
        """Whether nobody has written to index or journals since they were loaded."""
        return self._loaded == self._files()

    def put_job(self, record: JobRecord) -> JobName:
        """Adds a finished job; returns its name."""
        name = record.name
        self.jobs.places[name] = self._append({"job": _as_dict(record)})
        return name

    def put_input(self, name: str, facts: Entry) -> None:
        """Adds what was learnt of an input file."""
        self.inputs.places[name] = self._append({"input": name, "facts": facts})

    def put_failure(self, pair_id: str, facts: Entry) -> None:
        """Adds why a pair failed."""
        self.failures.places[pair_id] = self._append({"failure": pair_id, "facts": facts})

    def drop_job(self, name: JobName) -> None:
        """Forgets a finished job."""
        self.jobs.places.pop(name, None)
        self.is_compact = False

    def drop_failure(self, pair_id: str) -> None:
        """Forgets why a pair failed, if it did."""
        if self.failures.places.pop(pair_id, None) is not None:
            self.is_compact = False

    def compact(self, replace: Callable[[Path, Iterable[bytes]], None]) -> None:
        """Writes the index anew, each entry once, and does away with the journals; only if there is need.

        Parameters
        ----------
        replace : puts a file of these parts in place of another
        """
        if self.is_compact:
            return
        new_places: list[tuple[dict[Any, Place], Any, int]] = []
        kinds: tuple[Entries[Any, Any], ...] = (self.inputs, self.failures, self.jobs)

        def lines() -> Iterator[bytes]:
            place = 0
            for entries in kinds:
                for name in sorted(entries.places):
                    line = self._line(entries.places[name])
                    new_places.append((entries.places, name, place))
                    place += len(line)
                    yield line

        replace(self._folder / INDEX, lines())
        for places, name, place in new_places:
            places[name] = place
        self._close()
        for journal in (self._folder / _JOURNALS).glob("*.jsonl"):
            journal.unlink()
        self.is_compact = True

    def _append(self, entry: Entry) -> int:
        self.is_compact = False
        file = self._open()
        place = file.seek(0, os.SEEK_END)
        file.write(_line_of(entry))
        file.flush()
        return place

    def _entry(self, place: Place) -> Entry:
        entry = _entry_of(self._line(place))
        if not entry:
            raise RuntimeError(f"{self._folder / INDEX}: the line at {place!r} has changed since it was read")
        return entry

    def _line(self, place: Place) -> bytes:
        if isinstance(place, bytes):
            return place
        file = self._open()
        file.seek(place)
        return file.readline()

    def _open(self) -> BinaryIO:
        if self._file is None:
            path = self._folder / INDEX
            try:
                self._file = path.open("r+b")
            except PermissionError:  # somebody else's run, to be read
                self._file = path.open("rb")
            weakref.finalize(self, self._file.close)
        return self._file

    def _close(self) -> None:
        if self._file is not None:
            self._file.close()
            self._file = None

    def _files(self) -> list[tuple[Path, int, int]]:
        """The index and the journals, with the file system's marks."""
        paths = [self._folder / INDEX, *sorted((self._folder / _JOURNALS).glob("*.jsonl"))]
        return [(path, (of := path.stat()).st_mtime_ns, of.st_size) for path in paths if path.exists()]

    def _learn(self, line: bytes, place: Place) -> None:
        entry = _entry_of(line)
        if "job" in entry:
            job = entry["job"]
            self.jobs.places[job["stage"], job["pair_id"], job["side"]] = place
        elif "failure" in entry:
            self.failures.places[entry["failure"]] = place
        elif "input" in entry:
            self.inputs.places[entry["input"]] = place


def note_job(folder: Path, token: str, record: JobRecord) -> None:
    """Adds a finished job to this process's journal, at once.

    Parameters
    ----------
    folder, token : of the run that the process works for
    """
    journal = folder / _JOURNALS / f"{token}-{platform.node()}-{os.getpid()}.jsonl"
    journal.parent.mkdir(exist_ok=True)
    with journal.open("ab") as file:
        file.write(_line_of({"job": _as_dict(record)}))


def _as_dict(record: JobRecord) -> Entry:
    """The same as `dataclasses.asdict`, which copies all that is inside."""
    return vars(record) | {"files": {name: vars(of) for name, of in record.files.items()}}


def _job_record(entry: Entry) -> JobRecord:
    job = entry["job"]
    files = {name: StoredFile(**of) for name, of in job.pop("files").items()}
    steps = tuple((step, seconds) for step, seconds in job.pop("steps"))
    return JobRecord(**job, files=files, steps=steps)


def _facts(entry: Entry) -> Entry:
    facts: Entry = entry["facts"]
    return facts


def _line_of(entry: Entry) -> bytes:
    text = orjson.dumps(entry, option=orjson.OPT_SERIALIZE_NUMPY)
    return _line_hash(text) + b" " + text + b"\n"


def _entry_of(line: bytes) -> Entry:
    """The entry of an index line; {} of a torn or damaged one, so that what it spoke of is made again."""
    found, _, text = line.rstrip(b"\n").partition(b" ")
    if found != _line_hash(text):
        return {}
    entry: Entry = orjson.loads(text)
    return entry


def _line_hash(text: bytes) -> bytes:
    return hashlib.sha256(text).hexdigest()[:16].encode()
