"""Objects by URL (s3, gs, az, https): read, listed and written with obstore, the extra `remote`.

Credentials come from the environment or profiles, as obstore documents; no message repeats what a server answered.
"""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import lru_cache
from typing import Any, NamedTuple

from ...schemas.errors import StoreError

_FIRST_PAUSE_S = 0.5
_MODIFIED = "modified "
_STATUS = re.compile(r"status code: (\d+)")
_MACHINE = re.compile("169[.]254[.]|computeMetadata")  # where a machine in a cloud asks if the environment has none
#: Errors that a second try does not change, by the name of obstore's exception.
_FINAL = {
    "NotFoundError": "no such object",
    "FileNotFoundError": "no such object",
    "PermissionDeniedError": "permission denied",
    "UnauthenticatedError": "no valid credentials in the environment",
    "PreconditionError": "it changed since it was listed",
    "AlreadyExistsError": "it exists",
    "NotSupportedError": "the server does not support this",
}


class NoSuchObjectError(StoreError):
    """The object does not exist."""


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
    found = _tried(url, lambda: [one for chunk in obstore.list(store) for one in chunk])
    return sorted((_described(one) for one in found), key=lambda one: one.name)


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

    content: tuple[bytes, str] = _tried(url, get)
    return content


def write_object(url: str, content: bytes) -> str:
    """Write an object by one PUT, and return its etag."""
    return str(_tried(url, lambda: write_once(url, content, "overwrite")))


def write_once(url: str, content: bytes, mode: Any) -> str:
    """Write an object by one PUT that is not repeated, and return its etag; errors are those of obstore.

    Parameters
    ----------
    mode : "create" for an object that must not exist yet, {"e_tag": ...} for one that must have this etag now
    """
    obstore, store, name = _at(url)
    return str(obstore.put(store, name, content, mode=mode, use_multipart=False)["e_tag"] or "")


def delete_objects(url: str, names: Iterable[str]) -> None:
    """Delete objects below a URL; those that do not exist are ignored."""
    obstore, store = _open(url)
    with suppress(NoSuchObjectError):
        _tried(url, lambda: obstore.delete(store, sorted(names)))


def _at(url: str) -> tuple[Any, Any, str]:
    """The library, the store of the folder of an object, and the name of the object in it."""
    folder, _, name = url.rpartition("/")
    return *_open(folder), name


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
        return obstore, from_url(folder, client_options={"allow_http": True}, retry_config={"max_retries": 0})
    except Exception as error:
        hint = "; az:// needs AZURE_STORAGE_ACCOUNT_NAME in the environment" * folder.startswith("az")
        raise StoreError(f"{folder}: cannot be opened ({type(error).__name__}){hint}") from error


def _tried(url: str, work: Callable[[], Any]) -> Any:
    """Result of work on an object; up to three tries, as bodies can also be cut off."""
    for pause_s in (_FIRST_PAUSE_S, 2 * _FIRST_PAUSE_S, None):
        try:
            return work()
        except Exception as error:
            kind = "UnauthenticatedError" if _MACHINE.search(str(error)) else type(error).__name__
            if kind in _FINAL:
                fault = NoSuchObjectError if "NotFound" in kind else StoreError
                raise fault(f"{url}: {_FINAL[kind]}") from None
            if pause_s is None:
                status = _STATUS.search(str(error))
                reason = f"the server answered {status[1]}" if status else "the connection failed"
                raise StoreError(f"{url}: {reason} (three tries)") from None
            time.sleep(pause_s)
    raise AssertionError


def _described(one: Any) -> StoredObject:
    return StoredObject(one["path"], one["e_tag"] or f"{_MODIFIED}{one['last_modified'].isoformat()}", one["size"])
