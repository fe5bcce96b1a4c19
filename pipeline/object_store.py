"""Objects by URL (s3, gs, az, https): read, listed and written with obstore, the extra `remote`.

Credentials come from the environment or profiles, as obstore documents; no message repeats what a server answered.
"""

from __future__ import annotations

import os
import re
import time
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ..schemas.errors import FidpipeError

SCHEMES = ("s3", "gs", "az", "http", "https")
_URL = re.compile(r"[a-z][a-z0-9+.-]+://")
_FIRST_PAUSE_S = 0.5
_MODIFIED = "modified "
_STATUS = re.compile(r"\b([45]\d\d)\b")
#: Errors that a second try does not change, by the name of obstore's exception.
_FINAL = {
    "NotFoundError": "no such object",
    "FileNotFoundError": "no such object",
    "PermissionDeniedError": "permission denied",
    "UnauthenticatedError": "no valid credentials",
    "PreconditionError": "it changed since it was listed",
    "AlreadyExistsError": "it exists",
    "NotSupportedError": "the server does not support this",
}


class StoreError(FidpipeError):
    """An object cannot be read or written. `kind` is the name of obstore's exception."""

    def __init__(self, url: str, reason: str, kind: str = "") -> None:
        super().__init__(f"{url}: {reason}")
        self.kind = kind

    @property
    def is_absence(self) -> bool:
        """True if there is no such object."""
        return self.kind in ("NotFoundError", "FileNotFoundError")


@dataclass(frozen=True)
class StoredObject:
    """An object as a listing has it. `etag` identifies its content; it need not be an MD5.

    Without an etag it is the time of the last change.
    """

    name: str
    etag: str
    size: int


def is_url(text: str) -> bool:
    """True for text such as s3://bucket/key."""
    return bool(_URL.match(text))


def cache_base() -> Path:
    """The folder of all that is fetched: FIDPIPE_CACHE, by default ~/.cache/fidpipe."""
    return _cache_base(os.environ.get("FIDPIPE_CACHE"), os.environ.get("HOME"))


@lru_cache(maxsize=4)
def _cache_base(named: str | None, home: str | None) -> Path:
    return Path(named or Path.home() / ".cache" / "fidpipe").absolute()


def cache_of(url: str) -> Path:
    """The local folder that mirrors a URL."""
    check_url(url)
    parts = urlsplit(url)
    names = parts.path.strip("/").split("/")
    if ".." in names:
        raise StoreError(url, "expected no .. in a URL")
    return cache_base().joinpath(parts.scheme, parts.netloc, *names)


def url_of_cache(folder: Path) -> str:
    """The URL that a folder mirrors; "" outside of the cache."""
    folder, base = folder.absolute(), cache_base()
    if base not in folder.parents:
        return ""
    scheme, *names = folder.relative_to(base).parts
    return f"{scheme}://{'/'.join(names)}" if scheme in SCHEMES else ""


def name_in_records(folder: Path) -> str:
    """A dataset's URL, or the absolute path of its folder."""
    return url_of_cache(folder) or str(folder.resolve())


def url_or_path(folder: Path) -> str:
    """The name of a folder for the user, as commands take it."""
    return url_of_cache(folder) or str(folder)


def recorded_path(name: str) -> Path:
    """The folder, in the cache for a URL, that a record names."""
    return cache_of(name) if is_url(name) else Path(name)


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


def write_object(url: str, content: bytes, *, only_if: str | None = None) -> str:
    """Write an object by one PUT, and return its etag.

    Parameters
    ----------
    only_if : etag that it must have now; "" for an object that must not exist yet; None for no condition
    """
    obstore, store, name = _at(url)
    mode: Any = "overwrite" if only_if is None else {"e_tag": only_if} if only_if else "create"

    def put() -> Any:
        return obstore.put(store, name, content, mode=mode, use_multipart=False)

    return str((_tried(url, put) if only_if is None else put())["e_tag"] or "")


def delete_object(url: str) -> None:
    """Delete an object; without one nothing happens."""
    obstore, store, name = _at(url)
    try:
        _tried(url, lambda: obstore.delete(store, name))
    except StoreError as error:
        if not error.is_absence:
            raise


def check_url(url: str) -> None:
    """Raise `StoreError` unless fidpipe reads such URLs, and if it holds a secret."""
    parts = urlsplit(url)
    if parts.scheme not in SCHEMES:
        raise StoreError(f"{parts.scheme}://", f"expected a URL of {', '.join(SCHEMES)}, or a local path")
    if "@" in parts.netloc or parts.query:
        clean = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
        raise StoreError(clean, "expected a URL without credentials or a query; credentials come from the environment")


def _at(url: str) -> tuple[Any, Any, str]:
    """The library, the store of the folder of an object, and the name of the object in it."""
    folder, _, name = url.rpartition("/")
    return *_open(folder), name


@lru_cache(maxsize=64)
def _open(folder: str) -> tuple[Any, Any]:
    """The library, and the store of a URL."""
    check_url(folder)
    try:
        import obstore
        from obstore.store import from_url
    except ModuleNotFoundError as error:
        raise StoreError(folder, "reading it needs obstore; install it with: pip install 'fidpipe[remote]'") from error
    try:
        return obstore, from_url(folder, client_options={"allow_http": True}, retry_config={"max_retries": 0})
    except Exception as error:
        raise StoreError(folder, f"cannot be opened ({type(error).__name__})") from error


def _tried(url: str, work: Any) -> Any:
    """Result of work on an object; up to three tries, as bodies can also be cut off."""
    for pause_s in (_FIRST_PAUSE_S, 2 * _FIRST_PAUSE_S, None):
        try:
            return work()
        except Exception as error:
            kind = type(error).__name__
            if kind in _FINAL:
                raise StoreError(url, _FINAL[kind], kind) from None
            if pause_s is None:
                status = _STATUS.search(str(error))
                reason = f"the server answered {status[1]}" if status else "the connection failed"
                raise StoreError(url, f"{reason} (three tries)", kind) from None
            time.sleep(pause_s)
    raise AssertionError


def _described(one: Any) -> StoredObject:
    return StoredObject(one["path"], one["e_tag"] or f"{_MODIFIED}{one['last_modified'].isoformat()}", one["size"])
