"""A remote dataset as a local folder: each scan is a stub, a small file NAME.url with its URL, etag and size.

The listing makes the stubs; a worker that reads one fetches the object, by one GET, into a
temporary file of the scan's own name. So the content hash of a remote scan is that of its URL, etag
and size.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from ...schemas.columns import SIDES
from ...schemas.errors import StoreError
from .files import write_whole
from .object_store import (
    NoSuchObjectError,
    StoredObject,
    counted,
    describe_object,
    read_object,
)
from .urls import STUB, cache_of

#: Files of a dataset that are read when a run is planned, and so are fetched whole.
_SMALL = (".csv", ".toml", ".tum", ".txt")
_REQUESTS_AT_ONCE = 16
_LARGEST_SMALL = 100_000_000
_MANIFEST = "pairs.csv"


def mirror_dataset(url: str, objects: Sequence[StoredObject]) -> Path:
    """Stubs of all objects below a URL, or of one object; those of objects that are gone are removed.

    Parameters
    ----------
    objects : of the listing; of a server that cannot list, none: it is one object, or has a
        manifest
    """
    if not objects and "." in urlsplit(url).path.rpartition("/")[2]:
        return _mirror(url, cache_of(url), describe_object(url))
    try:
        objects = objects or [describe_object(f"{url}/{_MANIFEST}")]
    except NoSuchObjectError as error:
        raise StoreError(
            f"{url}: expected a run, scans or a {_MANIFEST}, got none ({error})"
        ) from error
    folder = cache_of(url)
    mirrored = set()
    for stored in counted(objects, f"{url}: of {len(objects):,} objects"):
        mirrored.add(_mirror(f"{url}/{stored.name}", folder / stored.name, stored))
    for path in folder.rglob("*"):
        if path.is_file() and path not in mirrored:
            path.unlink(missing_ok=True)
    return folder


def stubs_of(urls: Mapping[str, str]) -> dict[str, Path | str]:
    """The stub of each object, by the same names, or the reason why there is none."""

    def stub_of(url: str) -> Path | str:
        try:
            return _mirror(url, cache_of(url), describe_object(url))
        except StoreError as error:
            return str(error)

    with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
        return dict(zip(urls, pool.map(stub_of, urls.values()), strict=True))


@contextmanager
def fetched_scan(stubs: Iterable[str]) -> Iterator[Path]:
    """A temporary copy of the object of the first stub, next to those of others: its labels.

    Parameters
    ----------
    stubs : their texts

    Raises
    ------
    StoreError
        An object cannot be fetched whole.
    """
    files = []
    with tempfile.TemporaryDirectory(prefix="fidpipe-") as folder:
        for stub in stubs:
            url, etag, size = stub.split("\n")[:3]
            content = read_object(url, etag)
            if len(content) != int(size):
                raise StoreError(f"{url}: expected {size} bytes, got {len(content)}")
            files.append(Path(folder, url.rpartition("/")[2]))
            files[-1].write_bytes(content)
        yield files[0]


def _mirror(url: str, path: Path, stored: StoredObject) -> Path:
    """A small file itself, or the stub of an object; written only if it differs."""
    is_scan = url.endswith(tuple(f"/{side}/{path.name}" for side in SIDES))
    if path.suffix in _SMALL and not is_scan and stored.size < _LARGEST_SMALL:
        content = read_object(url, stored.etag)
    else:
        path = path.with_name(path.name + STUB)
        content = f"{url}\n{stored.etag}\n{stored.size}\n".encode()
    if not path.exists() or path.read_bytes() != content:
        write_whole(path, content, outlasts_power=False)
    return path
