"""Objects by URL (s3, gs, az, https): read, listed and written with obstore, the extra `remote`.

Credentials come from the environment or profiles, as obstore documents; no message repeats what a
server answered.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple, TypeVar

from ...schemas.errors import StoreError

_PAUSES_S = (0.5, 1.0, None)  # after each try; none after the last
_SECONDS_BETWEEN_LINES = 3.0
_MODIFIED = "modified "
_STATUS = re.compile(r"status code: (\d+)")
#: Where a machine in a cloud asks for credentials if the environment has none.
_MACHINE = re.compile("169[.]254[.]|computeMetadata")


class NoSuchObjectError(StoreError):
    """The object does not exist."""


class ObjectChangedError(StoreError):
    """The object is not the one that a condition names."""


#: Errors that a second try does not change, by the name of obstore's exception.
_FINAL: dict[str, tuple[type[StoreError], str]] = {
    "NotFoundError": (NoSuchObjectError, "no such object"),
    "FileNotFoundError": (NoSuchObjectError, "no such object"),
    "PermissionDeniedError": (StoreError, "permission denied"),
    "UnauthenticatedError": (StoreError, "no valid credentials in the environment"),
    "PreconditionError": (ObjectChangedError, "it changed since it was listed"),
    "AlreadyExistsError": (ObjectChangedError, "it exists"),
    "NotSupportedError": (StoreError, "the server does not support this"),
}
Item = TypeVar("Item")


class StoredObject(NamedTuple):
    """An object as a listing has it. `etag` identifies its content; it need not be an MD5.

    Without an etag it is the time of the last change.
    """

    name: str
    etag: str
    size: int


def list_objects(url: str) -> list[StoredObject]:
    """All objects below a URL, by name relative to it."""
    obstore, store = _open(url)

    objects: list[StoredObject] = []

    def list_rest() -> None:
        last = objects[-1].name if objects else None
        chunks = obstore.list(store, offset=last, chunk_size=1000)
        for chunk in counted(chunks, f"{url}: thousands listed"):
            objects.extend(_described(entry) for entry in chunk)

    _tried(url, list_rest)
    return sorted(objects)


def counted(items: Iterable[Item], text: str) -> Iterator[Item]:
    """The same items; if they take long, a line every few seconds has their number so far."""
    last_line = time.monotonic()
    for n_items, item in enumerate(items, start=1):
        yield item
        if time.monotonic() - last_line >= _SECONDS_BETWEEN_LINES:
            last_line = time.monotonic()
            say(f"{text}: {n_items:,}")


def say(text: str) -> None:
    """Print a line on stderr."""
    from ..terminal import Terminal

    Terminal(stderr=True, soft_wrap=True).print(text, markup=False)


def describe_object(url: str) -> StoredObject:
    """One object, by its last name."""
    obstore, store, name = _at(url)
    return _described(_tried(url, lambda: obstore.head(store, name)))


def read_object(url: str, etag: str = "") -> bytes:
    """The content of an object.

    Parameters
    ----------
    etag : expected; an object that has changed since is an error
    """
    return read_with_etag(url, etag)[0]


def read_with_etag(url: str, etag: str = "") -> tuple[bytes, str]:
    """The content of an object, and the etag of that content; see `read_object`."""
    obstore, store, name = _at(url)
    options = {"if_match": etag} if etag and not etag.startswith(_MODIFIED) else {}

    def get() -> tuple[bytes, str]:
        answer = obstore.get(store, name, options=options)
        return bytes(answer.bytes()), str(answer.meta["e_tag"] or "")

    return _tried(url, get)


def write_object(url: str, content: bytes, mode: Any = "overwrite") -> str:
    """Write an object by one PUT, and return its etag.

    Parameters
    ----------
    mode : "create" for an object that must not exist yet, {"e_tag": ...} for one that must have
        this etag now

    Raises
    ------
    ObjectChangedError
        The condition is not met; or it was met by a try whose answer was lost.
    """
    obstore, store, name = _at(url)

    def put() -> str:
        answer = obstore.put(store, name, content, mode=mode, use_multipart=False)
        return str(answer["e_tag"] or "")

    return _tried(url, put)


def delete_objects(url: str, names: Iterable[str]) -> None:
    """Delete objects below a URL; those that do not exist are ignored."""
    obstore, store = _open(url)
    with suppress(NoSuchObjectError):
        _tried(url, lambda: obstore.delete(store, sorted(names)))


def _at(url: str) -> tuple[Any, Any, str]:
    """The library, the store of the folder of an object, and the name of the object in it."""
    folder, _, name = url.rpartition("/")
    obstore, store = _open(folder)
    return obstore, store, name


@lru_cache(maxsize=64)
def _open(folder: str) -> tuple[Any, Any]:
    """The library, and the store of a URL, which `cache_of` has accepted."""
    try:
        import obstore
        from obstore.store import from_url
    except ModuleNotFoundError as error:
        raise StoreError(
            f"{folder}: reading it needs obstore; install it with: pip install 'fidpipe[remote]'"
        ) from error
    try:
        options: Any = {
            "client_options": {"allow_http": True},
            "retry_config": {"max_retries": 0},
        }
        return obstore, from_url(folder, **options)
    except Exception as error:
        raise StoreError(
            f"{folder}: cannot be opened ({type(error).__name__}); is the environment complete? See "
            "docs/remote.md"
        ) from error


def _tried(url: str, work: Callable[[], Any]) -> Any:
    """Result of work on an object; up to three tries, as bodies can also be cut off."""
    for pause_s in _PAUSES_S:
        try:
            return work()
        except Exception as error:
            is_machine = _MACHINE.search(str(error))
            kind = "UnauthenticatedError" if is_machine else type(error).__name__
            if kind in _FINAL:
                fault, reason = _FINAL[kind]
                raise fault(f"{url}: {reason}") from None
            if pause_s is None:
                status = _STATUS.search(str(error))
                reason = (
                    f"the server answered {status[1]}" if status else "the connection failed"
                )
                raise StoreError(f"{url}: {reason} (three tries)") from None
            time.sleep(pause_s)
    raise AssertionError


def _described(entry: Any) -> StoredObject:
    etag = entry["e_tag"] or f"{_MODIFIED}{entry['last_modified'].isoformat()}"
    return StoredObject(entry["path"], etag, entry["size"])
