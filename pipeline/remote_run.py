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
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from pathlib import Path

import orjson

from ..schemas.errors import FidpipeError, RunError
from .datasets.stubs import mirror_dataset
from .object_store import (
    StoredObject,
    StoreError,
    cache_of,
    delete_object,
    is_url,
    list_objects,
    read_object,
    read_with_etag,
    write_object,
)
from .storage.files import remove_stale, write_whole
from .storage.folder import RunFolder
from .storage.ledger import LEDGER, SEAL
from .storage.table_files import AT_URL, TOKEN_OBJECT

LOCK = "_writer.json"
#: Files of a run that stay on this machine.
_LOCAL = (LEDGER, f"{LEDGER}-journal", SEAL, "report.html")
_PUSH_S, _RENEW_S, _DEAD_S = 5.0, 60.0, 300.0
_AT_ONCE, _PER_RENEWAL = 16, 1000  # requests
_PAUSES_PER_PUSH = 4.0


def local_of(url: str) -> Path:
    """The local folder (or file) of a URL: a finished run fetched, or a dataset as stubs.

    Raises
    ------
    FidpipeError
        The URL cannot be read.
    """
    url = url.rstrip("/")
    if not url.startswith("http") and any(one.name == "run.json" for one in list_objects(url)):
        run = RemoteRun(url)
        if not RunFolder(run.folder).is_locked:  # by a command of this machine that works on it now
            run.pull(for_reading=True)
        return run.folder
    return mirror_dataset(url)


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
        of_ledger = [found.pop(name, None) for name in (SEAL, LEDGER, LOCK, TOKEN_OBJECT)][:2]
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
        with ThreadPoolExecutor(_AT_ONCE) as pool:
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
        """Write what has changed in the folder, and delete what it has no more.

        Raises
        ------
        RunError
            Another command writes there now.
        """
        with self._pushing:
            self._push()

    def _push(self) -> None:
        known, files = self._known(), self._files()
        changed = sorted(name for name, marks in files.items() if known.get(name, [""])[1:] != marks)
        self._renew()
        try:
            with ThreadPoolExecutor(_AT_ONCE) as pool:
                for first in range(0, len(changed), _PER_RENEWAL):
                    names = changed[first : first + _PER_RENEWAL]
                    known |= {name: own for name, own in zip(names, pool.map(self._put, names), strict=True) if own}
                    self._renew()
                gone = list(known.keys() - files.keys())
                list(pool.map(lambda name: delete_object(f"{self.url}/{name}"), gone))
            known = {name: own for name, own in known.items() if name in files}
        finally:
            self._keep(known)

    def _get(self, one: StoredObject) -> list[object]:
        path = self.folder / one.name
        write_whole(path, read_object(f"{self.url}/{one.name}", one.etag))
        return [one.etag, *_marks(path)]

    def _put(self, name: str) -> list[object]:
        """Write a file to the URL; return its etag and marks; [] if it was removed meanwhile."""
        path = self.folder / name
        try:
            marks = _marks(path)
            return [write_object(f"{self.url}/{name}", path.read_bytes()), *marks]
        except FileNotFoundError:
            return []

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
            delete_object(f"{self.url}/{SEAL}")
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
            if (self.folder / SEAL).exists():  # for those who read, when all tables are there
                for name in (LEDGER, SEAL):
                    self._put(name)
            if read_object(self._lock) == self._own:
                delete_object(f"{self.url}/{TOKEN_OBJECT}")
                delete_object(self._lock)

    def _follow(self, ended: threading.Event) -> None:
        pause_s = _PUSH_S
        while not ended.wait(pause_s):
            begun = time.monotonic()
            with suppress(FidpipeError, OSError):  # the last push reports what still fails
                self.push()
            pause_s = max(_PUSH_S, _PAUSES_PER_PUSH * (time.monotonic() - begun))

    def _renew(self) -> None:
        """Show every minute that we are alive; an error if our lock was taken over."""
        if time.monotonic() - self._renewed < _RENEW_S:
            return
        own = _owner()
        try:
            self._etag = write_object(self._lock, own, only_if=self._etag)
        except Exception:
            held, self._etag = read_with_etag(self._lock)
            if held not in (own, self._own):
                raise RunError(
                    f"run {self.url}: another command writes there now; results stay in {self.folder}"
                ) from None
            own = held
        self._own, self._renewed = own, time.monotonic()

    def _claim(self) -> None:
        """Write our lock. A write that a broken connection leaves unanswered may have succeeded: it is read."""
        self._own, self._renewed, condition = _owner(), time.monotonic(), ""
        for _ in range(2):  # first only if there is none, then only instead of a dead one
            try:
                self._etag = write_object(self._lock, self._own, only_if=condition)
                return
            except StoreError:
                raise
            except Exception as error:
                try:
                    held, condition = read_with_etag(self._lock)
                except StoreError:
                    raise RunError(f"{self._lock}: cannot be written ({type(error).__name__})") from None
            if held == self._own:
                self._etag = condition
                return
            owner = orjson.loads(held)
            is_dead = owner["host"] == socket.gethostname() and not _is_alive(owner["pid"])
            if not is_dead and time.time() - owner["time"] < _DEAD_S:
                break
        raise RunError(
            f"run {self.url}: process {owner['pid']} on {owner['host']} writes there; wait for its end, or delete "
            f"{self._lock} if it is dead"
        )

    def _files(self) -> dict[str, list[object]]:
        """Marks of the finished files of the folder by name; temporary ones and locks begin with a dot."""
        files = {}
        for folder, below, names in os.walk(self.folder):
            below[:] = [name for name in below if name[0] != "."]
            for name in names:
                path = Path(folder, name)
                if name[0] != "." and name not in _LOCAL:
                    with suppress(FileNotFoundError):  # replaced meanwhile
                        files[path.relative_to(self.folder).as_posix()] = _marks(path)
        return files

    def _known(self) -> dict[str, list[object]]:
        try:
            known: dict[str, list[object]] = orjson.loads(self._index.read_bytes())
            return known
        except (OSError, ValueError):
            return {}

    def _keep(self, known: dict[str, list[object]]) -> None:
        write_whole(self._index, orjson.dumps(known))


_WRITTEN: dict[Path, RemoteRun] = {}


def url_for_workers(folder: Path, token: str) -> str:
    """The URL where workers that do not see a folder read and write its tables, equal to the folder now; "" for none.

    Parameters
    ----------
    token : of the run that may write
    """
    run = _WRITTEN.get(folder.absolute())
    if run is None:
        return ""
    (run.folder / AT_URL).touch()
    run.push()  # so that no later push deletes what a worker writes under the same name
    write_object(f"{run.url}/{TOKEN_OBJECT}", token.encode())
    return run.url


@contextmanager
def local_arguments(words: list[str]) -> Iterator[list[str]]:
    """The words of a command with local paths in place of URLs; a URL after --out is written to.

    Raises
    ------
    FidpipeError
        A URL cannot be read, or another command writes to it.
    """
    words, outputs = list(words), []
    for i, word in enumerate(words):
        option, is_joined, value = (
            word.partition("=") if word.startswith("--") else (words[i - 1] if i else "", "", word)
        )
        if not is_url(value) or option == "--scheduler":
            continue
        if option in ("--out", "-o"):
            outputs.append(RemoteRun(value))
        path = outputs[-1].folder if option in ("--out", "-o") else local_of(value)
        words[i] = f"{option}={path}" if is_joined else str(path)
    if len(outputs) > 1:
        raise RunError("expected one --out, got several")
    if not outputs:
        yield words
        return
    with outputs[0].written():
        yield words


def _marks(path: Path) -> list[object]:
    state = path.stat()
    return [state.st_mtime_ns, state.st_size]


def _owner() -> bytes:
    return orjson.dumps({"host": socket.gethostname(), "pid": os.getpid(), "time": time.time()})


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True
