"""A remote dataset as a local folder: each scan is a stub, a small file NAME.url with its URL, etag and size.

The listing makes the stubs; a worker that reads one fetches the object, by one GET, into a temporary file of the scan's
own name. So the content hash of a remote scan is that of its URL, etag and size.
"""

from __future__ import annotations

import csv
import io
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from urllib.parse import urlsplit

from ...schemas.columns import SIDES
from ...schemas.errors import DatasetError, ScanError
from ..object_store import (
    StoredObject,
    StoreError,
    cache_base,
    cache_of,
    describe_object,
    is_url,
    list_objects,
    read_object,
)
from ..storage.files import remove_stale, write_whole

STUB = ".url"
#: Files of a dataset that are read when a run is planned, and so are fetched whole.
_SMALL = (".csv", ".toml", ".tum", ".txt")
_REQUESTS_AT_ONCE = 16
_LARGEST_SMALL = 100_000_000
_MANIFEST = "pairs.csv"


def is_stub(path: Path) -> bool:
    """True for a stub in the cache. Elsewhere it is ignored: a dataset of others could name any address."""
    return path.suffix == STUB and (path in _RESTORED or cache_base() in path.absolute().parents)


def stub_texts(paths: Iterable[Path]) -> dict[Path, str]:
    """The stubs among some files, for a worker that does not see the cache."""
    return {path: path.read_text(encoding="utf-8") for path in paths if is_stub(path) and path.exists()}


def restore_stubs(texts: Mapping[Path, str]) -> None:
    """Write stubs that the command sent where it has them, on the disk of this machine."""
    for path, text in texts.items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            write_whole(path, text.encode(), advice="; give the command a FIDPIPE_CACHE that workers can create")
        _RESTORED.add(path)


def url_of(stub: Path) -> str:
    """The URL of the object that a stub names."""
    return stub.read_text(encoding="utf-8").split("\n")[0]


def mirror_dataset(url: str) -> Path:
    """Stubs of all objects below a URL, or of one object; those of objects that are gone are removed.

    Raises
    ------
    DatasetError
        The URL cannot be listed or holds nothing.
    """
    url = url.rstrip("/")
    try:
        found = [] if url.startswith("http") else list_objects(url)
        if not found:
            return _mirror_one(url)
    except StoreError as error:
        raise DatasetError(str(error)) from error
    folder, stubs = cache_of(url), set()
    for one in found:
        stubs.add(_mirror(f"{url}/{one.name}", folder / one.name, one))
    for path in folder.rglob("*"):
        if path.is_file() and path not in stubs:
            remove_stale(path)
    return folder


def recorded_dataset(name: str) -> Path:
    """The folder of the dataset that a record names; of a URL the current stubs.

    Raises
    ------
    DatasetError
        The URL cannot be listed.
    """
    return mirror_dataset(name) if is_url(name) else Path(name)


def stubs_of(urls: Iterable[str]) -> dict[str, Path | str]:
    """The stub of each object, or the reason why there is none."""

    def stub_of(url: str) -> Path | str:
        try:
            return _mirror(url, cache_of(url), describe_object(url))
        except StoreError as error:
            return str(error)

    once = list(dict.fromkeys(urls))
    with ThreadPoolExecutor(_REQUESTS_AT_ONCE) as pool:
        return dict(zip(once, pool.map(stub_of, once), strict=True))


def n_bytes_of(path: Path) -> int:
    """Size of a scan file; of a stub that of its object."""
    return int(path.read_text(encoding="utf-8").split("\n")[2]) if is_stub(path) else path.stat().st_size


@contextmanager
def local_scan(path: Path, labels: Path) -> Iterator[Path]:
    """A scan file on this machine, next to its labels: itself, or a temporary copy of the object that a stub names.

    Raises
    ------
    ScanError
        The object, or that of its labels, cannot be fetched whole.
    """
    if not is_stub(path):
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="fidpipe-") as folder:
        for stub in (path, *[labels] * labels.exists()):
            url, etag, size = stub.read_text(encoding="utf-8").split("\n")[:3]
            try:
                content = read_object(url, etag)
            except StoreError as error:
                raise ScanError(str(error)) from error
            if len(content) != int(size):
                raise ScanError(f"{url}: expected {size} bytes, got {len(content)}")
            Path(folder, stub.stem).write_bytes(content)
        yield Path(folder, path.stem)


_RESTORED: set[Path] = set()


def _mirror_one(url: str) -> Path:
    """A dataset without a listing, by its manifest; or one object."""
    if "." in urlsplit(url).path.rpartition("/")[2]:
        return _mirror(url, cache_of(url), describe_object(url))
    try:
        manifest = read_object(f"{url}/{_MANIFEST}")
    except StoreError as error:
        if not error.is_absence:
            raise
        raise StoreError(url, f"expected a run, scans or a {_MANIFEST}, got none ({error})") from error
    rows = list(csv.DictReader(manifest.decode("utf-8").splitlines()))
    for row in rows:
        row |= {side: f"{url}/{row[side]}" for side in SIDES if row.get(side) and not is_url(row[side])}
    text = io.StringIO()
    writer = csv.DictWriter(text, [*rows[0]] if rows else ["pair_id", *SIDES])
    writer.writeheader()
    writer.writerows(rows)
    folder = cache_of(url)
    write_whole(folder / _MANIFEST, text.getvalue().encode())
    return folder


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
