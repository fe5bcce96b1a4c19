"""A run in an object store: a local folder that is kept equal to a URL, table by table.

Each finished file is written by one PUT, which is atomic, and never renamed; files of the ledger
after the tables that they name. One object, written under a condition, says who writes; its owner
renews it.
"""

from __future__ import annotations

import fcntl
import os
import secrets
import socket
import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from functools import cache
from itertools import chain
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...schemas.errors import FidpipeError, RunError, StoreError
from ...schemas.tables import TABLES
from .files import file_marks, is_locked, write_whole
from .ledger import INPUT_HASHES, LEDGER, Ledger, load_json, save_json
from .object_store import (
    ObjectChangedError,
    StoredObject,
    counted,
    delete_objects,
    list_objects,
    read_object,
    read_with_etag,
    say,
    write_object,
)
from .remote_dataset import mirror_dataset
from .run_record import RUN_JSON, SETTINGS_TOML
from .table_files import TOKEN
from .urls import TEMPORARY_CACHE, cache_folder, cache_of, is_url

LOCK = "_writer.json"
#: Files of a run that stay on this machine.
_LOCAL = (f"{LEDGER}/{INPUT_HASHES}", "report.html")
_PUSH_S = 5.0
_RENEW_S = 15.0
_DEAD_S = 120.0  # an owner that has not renewed its lock for this long is dead
_LOOK_S = 1.0
_REQUESTS_AT_ONCE = 16
_PAUSES_PER_PUSH = 4.0

Known = dict[str, list[str]]  #: etag and marks of files, by name


class _Owner(BaseModel):
    """The command that writes to a run; the content of its lock.

    token : of the command
    n_renewed : differs after each renewal, so that a lock that stays the same is that of a dead
        command
    """

    model_config = ConfigDict(strict=True)

    host: str
    pid: int = Field(gt=0, lt=2**31)
    token: str
    n_renewed: int = 0


def local_of(url: str) -> Path:
    """The local folder (or file) of a URL: a run, fetched, or a dataset as stubs.

    Raises
    ------
    StoreError
        The URL cannot be read.
    """
    _prepare_cache()
    run = RemoteRun(url)
    if run.is_in_use:
        return run.folder
    objects = [] if run.url.startswith("http") else list_objects(run.url)
    names = {stored.name for stored in objects}
    if not names & {RUN_JSON, LOCK}:
        return mirror_dataset(run.url, objects)
    run.pull(objects)
    return run.folder


class RemoteRun:
    """The local folder of a run at a URL, and what is known to be equal at both places."""

    def __init__(self, url: str) -> None:
        self.url = url.rstrip("/")
        self.folder = cache_of(url)
        self._index = self.folder.with_name(f".{self.folder.name}.objects.json")
        self._in_use = self.folder.with_name(f".{self.folder.name}.lock")
        self._lock = f"{self.url}/{LOCK}"
        self._owner = _Owner(
            host=socket.gethostname(),
            pid=os.getpid(),
            token=secrets.token_hex(8),
        )
        self._etag = ""
        self._renewed = 0.0

    @property
    def is_in_use(self) -> bool:
        """True if a command of this machine works on the folder: others leave it alone."""
        return is_locked(self._in_use)

    def pull(self, objects: Sequence[StoredObject]) -> None:
        """Fetch what the URL has and the folder lacks, and remove what the URL has not.

        Tables of pairs are left there, to be fetched when they are read.

        Parameters
        ----------
        objects : at the URL
        """
        known = self._known()
        remote = [stored for stored in objects if stored.name not in (LOCK, TOKEN)]
        names = {stored.name for stored in remote}
        if RUN_JSON not in names:  # of a run that was killed, or no run at all
            others = [name for name in names if _group(name) == 0]
            if not all(name.endswith((".parquet", SETTINGS_TOML)) for name in others):
                raise RunError(
                    f"run {self.url}: the URL holds other things than a run; give another --out"
                )
        self.folder.mkdir(parents=True, exist_ok=True)
        missing = []
        for stored in remote:
            path = self.folder / stored.name
            if known.get(stored.name, [""])[0] == stored.etag and path.exists():
                continue
            if "/" in stored.name and _group(stored.name) == 0:
                path.unlink(missing_ok=True)
            else:
                missing.append(stored)
        known |= self._get_all(missing)
        for name in (self._files().keys() & known.keys()) - names:
            (self.folder / name).unlink(missing_ok=True)  # others are newer than the last push
        save_json(self._index, {name: marks for name, marks in known.items() if name in names})

    def push(self) -> None:
        """Write what has changed in the folder.

        Raises
        ------
        RunError
            Another command writes there now.
        """
        with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
            known = self._known()
            changed = {
                name: marks
                for name, marks in self._files().items()
                if name not in known or known[name][1] != marks
            }
            if changed:
                self._claim()
            else:
                self._renew()
            try:
                for group in range(3):
                    names = [name for name in changed if _group(name) == group]
                    puts = pool.map(self._put, names, [changed[name] for name in names])
                    for name, marks in zip(names, puts, strict=True):
                        if marks:
                            known[name] = marks
                        self._renew()
            finally:
                save_json(self._index, known)

    def _get_all(self, objects: Sequence[StoredObject]) -> Known:
        """Fetch objects; returns what is known of them, by name."""

        def get(stored: StoredObject) -> list[str]:
            path = self.folder / stored.name
            content = read_object(f"{self.url}/{stored.name}", stored.etag)
            write_whole(path, content, outlasts_power=False)
            return [stored.etag, file_marks(path)]

        known: Known = {}
        with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
            all_marks = counted(
                pool.map(get, objects), f"{self.url}: fetched, of {len(objects):,}"
            )
            for stored, marks in zip(objects, all_marks, strict=True):
                known[stored.name] = marks
                self._renew()
        return known

    def _put(self, name: str, listed: str) -> list[str] | None:
        """Write an object; returns what is known of it.

        None, without writing, if it names other files and has changed since it was listed: those
        may not have been listed.
        """
        path = self.folder / name
        marks = file_marks(path)
        content = path.read_bytes()
        is_same = marks == listed == file_marks(path)
        if not is_same and _group(name):
            return None
        return [write_object(f"{self.url}/{name}", content), marks]

    @contextmanager
    def written(self) -> Iterator[Path]:
        """The folder for a command that writes: fetched first, written back every few seconds and at the end.

        Raises
        ------
        RunError
            Another command writes there.
        """
        _prepare_cache()
        self._claim_first()
        ended = threading.Event()
        follow = threading.Thread(target=self._follow, args=(ended,), daemon=True)
        self.folder.mkdir(parents=True, exist_ok=True)
        with self._in_use.open("a") as in_use:
            fcntl.flock(in_use, fcntl.LOCK_EX)
            try:
                self.pull(list_objects(self.url))
                self.push()
                follow.start()
                try:
                    yield self.folder
                finally:
                    ended.set()
                    follow.join()
                    self.push()
                    self._delete_removed()
            finally:
                if self._held()[0].token == self._owner.token:
                    delete_objects(self.url, [TOKEN, LOCK])

    def _delete_removed(self) -> None:
        """Delete objects whose file was removed here, or that belong to no finished job."""
        stored = set(self._known())
        for listed in list_objects(self.url):
            if listed.name.partition("/")[0] in TABLES:  # also of workers that died
                stored.add(listed.name)
        removed = stored.difference(self._files(), Ledger(self.folder).files())
        for group in (2, 1, 0):
            delete_objects(self.url, [name for name in removed if _group(name) == group])

    def _follow(self, ended: threading.Event) -> None:
        pause_s = _PUSH_S
        while not ended.wait(pause_s):
            begun = time.monotonic()
            # A file may be removed meanwhile; the last push reports what still fails.
            with suppress(FidpipeError, OSError):
                self.push()
            pause_s = max(_PUSH_S, _PAUSES_PER_PUSH * (time.monotonic() - begun))

    def _renew(self) -> None:
        """If we write, show every few seconds that we are alive; `RunError` if we were replaced."""
        if self._etag and time.monotonic() - self._renewed >= _RENEW_S:
            self._claim()

    def _claim(self) -> None:
        """Write our lock in place of ours; raises `RunError` if it was taken over."""
        if self._other_owner({"e_tag": self._etag}) is not None:
            raise RunError(
                f"run {self.url}: another command writes there now; results stay in {self.folder}"
            )

    def _claim_first(self) -> None:
        """Write our lock, if there is none or one of a dead command; else raise `RunError`.

        A command of this machine is dead if its process is. Any other one is, if its lock stays the
        same for some minutes of our own clock.
        """
        other = self._other_owner("create")
        if other is None:
            return
        is_dead = other.host == self._owner.host and not _is_alive(other.pid)
        if not is_dead:
            say(
                f"run {self.url}: process {other.pid} on {other.host} had begun to write there; "
                f"waiting up to {_DEAD_S:.0f} s to see whether it still does"
            )
            is_dead = self._stays_the_same()
        if not is_dead or self._other_owner({"e_tag": self._etag}) is not None:
            raise RunError(
                f"run {self.url}: process {other.pid} on {other.host} writes there; "
                f"wait for its end, or delete {self._lock} if it is dead"
            )

    def _stays_the_same(self) -> bool:
        """True if the lock at the URL is not renewed for `_DEAD_S` seconds."""
        begun = time.monotonic()
        while time.monotonic() - begun < _DEAD_S:
            time.sleep(_LOOK_S)
            if self._held()[1] != self._etag:
                return False
        return True

    def _other_owner(self, mode: Any) -> _Owner | None:
        """Write our lock under a condition; returns the command whose lock is there instead, or None."""
        self._owner.n_renewed += 1
        owner = self._owner
        try:
            self._etag = write_object(self._lock, owner.model_dump_json().encode(), mode)
        except ObjectChangedError:  # or it is ours, and the answer to a try was lost
            owner, self._etag = self._held()
        if owner.token != self._owner.token:
            return owner
        self._renewed = time.monotonic()
        return None

    def _held(self) -> tuple[_Owner, str]:
        """The command whose lock is at the URL, and the etag of the lock."""
        content, etag = read_with_etag(self._lock)
        try:
            return _Owner.model_validate_json(content), etag
        except ValidationError as error:
            raise RunError(
                f"run {self.url}: {self._lock} is damaged, so it is not known who writes there; "
                "delete it if no command does"
            ) from error

    def _files(self) -> dict[str, str]:
        """Marks of the finished files of the folder by name; temporary ones and locks begin with a dot.

        Files that name others are looked at first, so that what they name is listed, too.
        """
        files = {}
        naming = [self.folder / RUN_JSON, *self.folder.glob(f"{LEDGER}/*")]
        for path in chain(naming, self.folder.rglob("*")):
            name = path.relative_to(self.folder).as_posix()
            if name not in files and path.is_file() and "/." not in f"/{name}":
                files[name] = file_marks(path)
        for name in _LOCAL:
            files.pop(name, None)
        return files

    def _known(self) -> Known:
        """Etag and marks of each file, by name, as they were when the two places were equal."""
        return load_json(self._index) or {}  # new, or cut short: all is fetched again


def _group(name: str) -> int:
    """0 for a table, 1 for a file of the ledger, which names tables, 2 for the record, which names pairs."""
    if name == RUN_JSON:
        return 2
    return 1 if name.startswith(f"{LEDGER}/") else 0


@cache
def _prepare_cache() -> None:
    """Say once if the cache is among temporary files, where no other user may have made it."""
    folder = cache_folder()
    if not folder.name.startswith(TEMPORARY_CACHE):
        return
    say(
        f"no home folder: files of URLs are kept in {folder}; FIDPIPE_CACHE names another place"
    )
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.lstat().st_uid != os.getuid():
        raise StoreError(
            f"{folder}: belongs to another user; set FIDPIPE_CACHE to a folder of yours"
        )


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
        option = words[i - 1]
        before = ""
        value = word
        if word.startswith("--"):
            option, _, value = word.partition("=")
            before = f"{option}="
        if not is_url(value) or option == "--scheduler":
            continue
        if option in ("--out", "-o"):
            run = RemoteRun(value)
            words[i] = f"{before}{run.folder}"
        else:
            words[i] = f"{before}{local_of(value)}"
    with run.written() if run else nullcontext():
        yield


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except OSError as error:
        return isinstance(error, PermissionError)  # of another user
    return True
