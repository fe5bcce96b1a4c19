"""A run in an object store: a local folder that is kept equal to a URL, table by table.

Each finished file is written by one PUT, which is atomic, and never renamed. A copy of the ledger, written when a run
has ended, serves those who read; without it they rebuild it from the tables. One object, written under a condition,
says who writes; its owner renews it.
"""

from __future__ import annotations

import os
import socket
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path
from typing import Any

import orjson

from ...schemas.errors import DatasetError, FidpipeError, RunError, StoreError
from ...schemas.tables import TABLES
from ..storage.files import remove_stale, write_whole
from ..storage.folder import RunFolder
from ..storage.ledger import LEDGER, SEAL
from ..storage.table_files import AT_URL, TOKEN, StoredFile, TableFolder
from ..storage.urls import cache_of, is_url
from .object_store import (
    StoredObject,
    delete_objects,
    list_objects,
    read_object,
    read_with_etag,
    write_object,
    write_once,
)
from .remote_dataset import mirror_dataset, restore_stubs

LOCK = "_writer.json"
#: Files of a run that stay on this machine.
_LOCAL = (LEDGER, f"{LEDGER}-journal", SEAL, "report.html")
_PUSH_S, _RENEW_S, _DEAD_S = 5.0, 60.0, 300.0
_REQUESTS_AT_ONCE = 16
_PAUSES_PER_PUSH = 4.0
_ASK_S = 10.0


def local_of(url: str) -> Path:
    """The local folder (or file) of a URL: a run, fetched, or a dataset as stubs.

    Raises
    ------
    DatasetError
        The URL cannot be read.
    """
    try:
        run = RemoteRun(url)
        found = [] if run.url.startswith("http") else list_objects(run.url)
        if not any(one.name == "run.json" for one in found):
            return mirror_dataset(run.url, found)
        if not RunFolder(run.folder).is_locked:  # by a command of this machine that works on it now
            run.pull(for_reading=True)
        return run.folder
    except StoreError as error:
        raise DatasetError(str(error)) from error


class RemoteRun:
    """The local folder of a run at a URL, and what is known to be equal at both places."""

    def __init__(self, url: str) -> None:
        self.url, self.folder = url.rstrip("/"), cache_of(url)
        self._index = self.folder.with_name(f".{self.folder.name}.objects.json")
        self._lock = f"{self.url}/{LOCK}"
        self._own, self._etag, self._renewed = b"", "", 0.0
        self._pushing = threading.Lock()

    def pull(self, *, for_reading: bool = False) -> None:
        """Fetch what the URL has and the folder lacks, and remove what the URL has not.

        Parameters
        ----------
        for_reading : leave tables of pairs there, to be fetched when they are read, if the run has ended in order
        """
        known, found = self._known(), {one.name: one for one in list_objects(self.url)}
        of_ledger = [found.pop(name, None) for name in (SEAL, LEDGER, LOCK, TOKEN)][:2]
        if for_reading and None not in of_ledger:
            found = {name: one for name, one in found.items() if "/" not in name}
            for one in filter(None, of_ledger):
                self._get(one)
            (self.folder / AT_URL).touch()
        else:
            (self.folder / AT_URL).unlink(missing_ok=True)
        if found and "run.json" not in found:  # of a run that was killed, or no run at all
            if not all(name.endswith((".parquet", "settings.toml")) for name in found):
                raise RunError(f"run {self.url}: the URL holds other things than a run; give another --out")
            self.folder.mkdir(parents=True, exist_ok=True)
            (self.folder / LEDGER).touch()
        missing = [
            one
            for name, one in found.items()
            if known.get(name, [""])[0] != one.etag or not (self.folder / name).exists()
        ]
        with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
            known |= zip((one.name for one in missing), pool.map(self._get, missing), strict=True)
        if (self.folder / AT_URL).exists():
            self._keep(known)
            return
        if any("/" in one.name for one in missing):  # what this machine knows of them is out of date
            (self.folder / SEAL).unlink(missing_ok=True)
            (self.folder / LEDGER).write_bytes(b"")
        for name in (self._files().keys() & known.keys()) - found.keys():  # others are newer than the last push
            remove_stale(self.folder / name)
        self._keep({name: marks for name, marks in known.items() if name in found})

    def push(self) -> None:
        """Write what has changed in the folder.

        Raises
        ------
        RunError
            Another command writes there now.
        """
        with self._pushing, ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
            known, files = self._known(), self._files()
            changed = sorted(name for name, marks in files.items() if known.get(name, [""])[1:] != marks)
            self._renew()
            try:
                for name, own in zip(changed, pool.map(self._put, changed), strict=True):
                    known[name] = own
                    self._renew()
            finally:
                self._keep(known)

    def _get(self, one: StoredObject) -> list[object]:
        path = self.folder / one.name
        write_whole(path, read_object(f"{self.url}/{one.name}", one.etag))
        return [one.etag, *_marks(path)]

    def _put(self, name: str) -> list[object]:
        marks = _marks(self.folder / name)
        return [write_object(f"{self.url}/{name}", (self.folder / name).read_bytes()), *marks]

    @contextmanager
    def written(self) -> Iterator[Path]:
        """The folder for a command that writes: fetched first, written back every few seconds and at the end.

        Raises
        ------
        RunError
            Another command writes there.
        """
        self._claim()
        ended = threading.Event()
        follow = threading.Thread(target=self._follow, args=(ended,), daemon=True)
        try:
            self.pull()
            delete_objects(self.url, [SEAL])
            self.folder.mkdir(parents=True, exist_ok=True)
            _WRITTEN[self.folder] = self
            follow.start()
            yield self.folder
        finally:
            ended.set()
            _WRITTEN.pop(self.folder, None)
            if follow.is_alive():
                follow.join()
            self.push()
            if (self.folder / SEAL).exists():
                self._end()
            if read_object(self._lock) == self._own:
                delete_objects(self.url, [TOKEN, LOCK])

    def _end(self) -> None:
        """Delete what was removed here, or belongs to no finished job; then write the ledger, for those who read."""
        ledger, found = RunFolder(self.folder).ledger, {*self._known()}
        if (self.folder / AT_URL).exists():  # workers wrote there, and some may have died
            found |= {one.name for one in list_objects(self.url) if one.name.partition("/")[0] in TABLES}
        delete_objects(self.url, found.difference(_LOCAL, self._files(), *map(ledger.files, TABLES)))
        for name in (LEDGER, SEAL):
            self._put(name)

    def _follow(self, ended: threading.Event) -> None:
        pause_s = _PUSH_S
        while not ended.wait(pause_s):
            begun = time.monotonic()
            with suppress(FidpipeError, OSError):  # a file is removed meanwhile; the last push reports what still fails
                self.push()
            pause_s = max(_PUSH_S, _PAUSES_PER_PUSH * (time.monotonic() - begun))

    def _renew(self) -> None:
        """Show every minute that we are alive; an error if our lock was taken over."""
        if time.monotonic() - self._renewed >= _RENEW_S and self._other_lock({"e_tag": self._etag}):
            raise RunError(f"run {self.url}: another command writes there now; results stay in {self.folder}")

    def _claim(self) -> None:
        """Write our lock, if there is none or one of a dead command; else raise `RunError`."""
        mode: Any = "create"
        for _ in range(2):
            if not (held := self._other_lock(mode)):
                return
            mode, owner = {"e_tag": self._etag}, orjson.loads(held)
            is_dead = owner["host"] == socket.gethostname() and not _is_alive(owner["pid"])
            if not is_dead and time.time() - owner["time"] < _DEAD_S:
                break
        raise RunError(
            f"run {self.url}: process {owner['pid']} on {owner['host']} writes there; wait for its end, or delete "
            f"{self._lock} if it is dead"
        )

    def _other_lock(self, mode: Any) -> bytes:
        """Write our lock under a condition; return the one of another command that is in its place, or b"".

        A write that a broken connection leaves unanswered may have succeeded: the lock is read.
        """
        held = own = orjson.dumps({"host": socket.gethostname(), "pid": os.getpid(), "time": time.time()})
        try:
            self._etag = write_once(self._lock, own, mode)
        except StoreError:
            raise
        except Exception as error:
            try:
                held, self._etag = read_with_etag(self._lock)
            except StoreError:
                raise RunError(f"{self._lock}: cannot be written ({type(error).__name__})") from None
            if held not in (own, self._own):
                return held
        self._own, self._renewed = held, time.monotonic()
        return b""

    def _files(self) -> dict[str, list[object]]:
        """Marks of the finished files of the folder by name; temporary ones and locks begin with a dot."""
        names = {path.relative_to(self.folder).as_posix(): path for path in self.folder.rglob("*") if path.is_file()}
        return {name: _marks(path) for name, path in names.items() if "/." not in f"/{name}" and name not in _LOCAL}

    def _known(self) -> dict[str, list[object]]:
        """Etag and marks of each file, by name, as they were when the two places were equal."""
        known: dict[str, list[object]] = orjson.loads(self._index.read_bytes()) if self._index.exists() else {}
        return known

    def _keep(self, known: dict[str, list[object]]) -> None:
        write_whole(self._index, orjson.dumps(known))


_WRITTEN: dict[Path, RemoteRun] = {}


def share_folder(folder: TableFolder) -> None:
    """Make the URL of a remote run the place of its tables: workers need not see the folder.

    Parameters
    ----------
    folder : of the run that may write
    """
    if run := _WRITTEN.get(folder.folder.absolute()):
        (run.folder / AT_URL).touch()
        run.push()
        write_object(f"{run.url}/{TOKEN}", folder.token.encode())
        folder.url = run.url


def folder_of_worker(folder: Path, token: str, url: str, stubs: Mapping[Path, str]) -> TableFolder:
    """The tables of a run, for a worker that may not share its folder, nor the cache of the command."""
    restore_stubs(stubs)
    return (TablesAtUrl if url else TableFolder)(folder, token, url)


class TablesAtUrl(TableFolder):
    """The tables of a run for a worker that does not share its folder: each is one object, read and written whole."""

    def check_token(self) -> None:
        """See `TableFolder`; a process asks every ten seconds."""
        if time.monotonic() - _ASKED.get(self.token, -_ASK_S) >= _ASK_S:
            self._compare(read_object(f"{self.url}/{TOKEN}").decode())
            _ASKED[self.token] = time.monotonic()

    def _store(self, path: Path, content: memoryview, sha256: str) -> StoredFile:
        self.check_token()
        write_object(f"{self.url}/{path.relative_to(self.folder).as_posix()}", bytes(content))
        return StoredFile(len(content), sha256, 0)


_ASKED: dict[str, float] = {}


@contextmanager
def local_arguments(words: list[str]) -> Iterator[None]:
    """Replace the URLs among the words of a command by local paths; that after --out is written to.

    Raises
    ------
    FidpipeError
        A URL cannot be read, or another command writes to it.
    """
    run = None
    for i, word in enumerate(words):
        option, is_joined, value = word.partition("=") if word.startswith("--") else (words[i - 1], "", word)
        if not is_url(value) or option == "--scheduler":
            continue
        if option in ("--out", "-o"):
            run = RemoteRun(value)
        path = run.folder if run and option in ("--out", "-o") else local_of(value)
        words[i] = f"{option}={path}" if is_joined else str(path)
    with run.written() if run else nullcontext():
        yield


def _marks(path: Path) -> list[object]:
    state = path.stat()
    return [state.st_mtime_ns, state.st_size]


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError as error:
        return isinstance(error, PermissionError)  # of another user
    return True
