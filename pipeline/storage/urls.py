"""URLs and the cache, the folder whose parts mirror them. Only `object_store` reads and writes objects.

A remote scan is a stub in the cache: a small file NAME.url with the URL of its object, etag and
size.
"""

from __future__ import annotations

import os
import re
from pathlib import Path
from urllib.parse import urlsplit

from ...schemas.errors import StoreError

SCHEMES = ("s3", "gs", "az", "http", "https")
STUB = ".url"
TEMPORARY_CACHE = "fidpipe-cache-"
_URL = re.compile(r"[a-z][a-z0-9+.-]+://")


def is_url(text: str) -> bool:
    """True for text such as s3://bucket/key."""
    return bool(_URL.match(text))


def cache_of(url: str) -> Path:
    """The local folder that mirrors a URL; all URLs of the user pass here.

    The number of names in a URL comes before them, so that the folder of one URL is never inside
    that of another.

    Raises
    ------
    StoreError
        fidpipe does not read such URLs, or it holds a secret.
    """
    parts = urlsplit(url)
    if parts.scheme not in SCHEMES:
        raise StoreError(
            f"{parts.scheme}://: expected a URL of {', '.join(SCHEMES)}, or a local path"
        )
    if "@" in parts.netloc or parts.query:
        clean = f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"
        raise StoreError(
            f"{clean}: expected a URL without credentials or a query; credentials come from the environment"
        )
    names = [name for name in (parts.netloc, *parts.path.split("/")) if name]
    if ".." in names:
        raise StoreError(f"{url}: expected no .. in it")
    return cache_folder().joinpath(parts.scheme, str(len(names)), *names)


def url_of_cache(folder: Path) -> str:
    """The URL that a folder mirrors; "" outside of the cache."""
    folder = folder.absolute()
    cache = cache_folder()
    if cache not in folder.parents:
        return ""
    scheme, _, *names = folder.relative_to(cache).parts
    return f"{scheme}://{'/'.join(names)}" if scheme in SCHEMES and names else ""


def name_in_records(folder: Path) -> str:
    """A dataset's URL, or the absolute path of its folder; `UnicodeEncodeError` unless it is UTF-8, as records are."""
    return (url_of_cache(folder) or str(folder.resolve())).encode().decode()


def url_or_path(folder: Path) -> str:
    """The name of a folder for the user, as commands take it."""
    return url_of_cache(folder) or str(folder)


def recorded_path(name: str) -> Path:
    """The folder, in the cache for a URL, that a record names."""
    return cache_of(name) if is_url(name) else Path(name)


def is_stub(path: Path) -> bool:
    """True for a stub in the cache. Elsewhere it is ignored: a dataset of others could name any address."""
    return path.suffix == STUB and cache_folder() in path.absolute().parents


def stub_text(path: Path) -> str:
    """The lines of a stub: URL, etag and size of its object; "" for any other file."""
    return path.read_text(encoding="utf-8") if is_stub(path) and path.exists() else ""


def stub_size(text: str) -> int:
    """Size of the object of a stub."""
    return int(text.split("\n")[2])


def cache_folder() -> Path:
    """FIDPIPE_CACHE, by default ~/.cache/fidpipe; in the folder for temporary files if the user has no home."""
    if named := os.environ.get("FIDPIPE_CACHE"):
        return Path(named).absolute()
    try:
        return Path.home() / ".cache" / "fidpipe"
    except RuntimeError:  # a user id without an entry, as in containers
        from tempfile import gettempdir

        return Path(gettempdir(), f"{TEMPORARY_CACHE}{os.getuid()}").absolute()
