"""A remote dataset as a local folder: each scan is a stub, a small file NAME.url with its URL, etag and size.

The listing makes the stubs; a worker that reads one fetches the object, by one GET, into a temporary file of the scan's
own name. So the content hash of a remote scan is that of its URL, etag and size.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from ...schemas.errors import ScanError, StoreError
from ..storage.files import remove_stale, write_whole
from ..storage.urls import RESTORED, STUB, cache_of, read_stub
from .object_store import NoSuchObjectError, StoredObject, describe_object, read_object

#: Files of a dataset that are read when a run is planned, and so are fetched whole.
_SMALL = (".csv", ".toml", ".tum", ".txt")
_REQUESTS_AT_ONCE = 16
_LARGEST_SMALL = 100_000_000
_MANIFEST = "pairs.csv"


def mirror_dataset(url: str, found: Sequence[StoredObject]) -> Path:
    """Stubs of all objects below a URL, or of one object; those of objects that are gone are removed.

    Parameters
    ----------
    found : objects of the listing; of a server that cannot list, none: it is one object, or has a manifest
    """
    if not found and "." in urlsplit(url).path.rpartition("/")[2]:
        return _mirror(url, cache_of(url), describe_object(url))
    try:
        found = found or [describe_object(f"{url}/{_MANIFEST}")]
    except NoSuchObjectError as error:
        raise StoreError(f"{url}: expected a run, scans or a {_MANIFEST}, got none ({error})") from error
    folder = cache_of(url)
    mirrored = {_mirror(f"{url}/{one.name}", folder / one.name, one) for one in found}
    for path in folder.rglob("*"):
        if path.is_file() and path not in mirrored:
            remove_stale(path)
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


def restore_stubs(texts: Mapping[Path, str]) -> None:
    """Write stubs that the command sent where it has them, on the disk of this machine."""
    for path, text in texts.items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_whole(path, text.encode(), advice="; give the command a FIDPIPE_CACHE that workers can create")
        RESTORED.add(path)


@contextmanager
def fetched_scan(path: Path, labels: Path) -> Iterator[Path]:
    """A temporary copy of the object that a stub names, next to its labels.

    Raises
    ------
    ScanError
        The object, or that of its labels, cannot be fetched whole.
    """
    with tempfile.TemporaryDirectory(prefix="fidpipe-") as folder:
        for stub in (path, *[labels] * labels.exists()):
            url, etag, size = read_stub(stub)
            try:
                content = read_object(url, etag)
            except StoreError as error:
                raise ScanError(str(error)) from error
            if len(content) != int(size):
                raise ScanError(f"{url}: expected {size} bytes, got {len(content)}")
            Path(folder, stub.stem).write_bytes(content)
        yield Path(folder, path.stem)


def _mirror(url: str, path: Path, one: StoredObject) -> Path:
    """A small file itself, or the stub of an object; written only if it differs."""
    if path.suffix in _SMALL and path.parent.name not in ("real", "sim") and one.size < _LARGEST_SMALL:
        content = read_object(url, one.etag)
    else:
        path = path.with_name(path.name + STUB)
        content = f"{url}\n{one.etag}\n{one.size}\n".encode()
    if not path.exists() or path.read_bytes() != content:
        write_whole(path, content)
    return path
