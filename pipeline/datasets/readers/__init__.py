"""Formats by suffix. One file per format, each with one `read`; a new format is a file and a row here.

Another package adds one by an entry point of the group `fidpipe.readers`: its name is the suffix without the dot, its
value the module whose `read(path) -> Scan` reads such files.
"""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple

from ....schemas.errors import DatasetError, FidpipeError, ScanError
from ...storage.urls import is_stub
from .frame_address import address_of
from .scan import Scan, cause_of, label_path_of, with_label_file, with_label_names

_KITTI = ("x", "y", "z", "intensity")
_NUSCENES = (*_KITTI, "ring")


class Format(NamedTuple):
    """Reader of the files of one suffix.

    module : whose `read(path) -> Scan` reads them: a file of this folder, with a dot before its name, or a module of
        another package; it is imported when first used
    columns : for raw rows, whose files do not name their columns, the usual ones; `read(path, columns)` then takes
        these, or those of the setting `input.columns`, and `check_width(path, columns)` rejects a file that the usual
        ones do not fit; () if the shape or a header determines them
    holds_frames : whether a file is a recording; `read` then takes an `Address`, and `frames` lists those of all frames
    content : what a file should be, for the error of one that is damaged
    may_crash : whether a damaged file may end the process that reads it, or fill the memory: formats whose libraries
        trust a file's declared sizes of its compressed parts, and the readers of other packages
    """

    module: str
    columns: tuple[str, ...] | None = None
    content: str = ""
    holds_frames: bool = False
    may_crash: bool = False


#: What `pip install 'fidpipe[...]'` brings the libraries that are not everywhere.
_EXTRAS = {
    "rosbags": "ros",
    "mcap": "ros",
    "mcap_protobuf": "ros",
    "velodyne_decoder": "velodyne",
    "dpkt": "velodyne",
    "laspy": "las",
}

#: A longer suffix is tried before a shorter one that it ends with. One that begins with / is a file in a folder.
FORMATS = {
    ".pcd.bin": Format(".float32", _NUSCENES),
    ".bin": Format(".float32", _KITTI),
    ".npy": Format(".npy", (), "a whole .npy array"),
    ".pcd": Format(".pcd", content="a whole PCD file"),
    ".ply": Format(".ply", content="a whole PLY file with vertices"),
    ".csv": Format(".csv", (), "a CSV table"),
    ".feather": Format(".feather", content="a whole Feather file", may_crash=True),
    ".parquet": Format(".parquet", content="a whole Parquet file", may_crash=True),
    ".las": Format(".las", content="a whole LAS file"),
    ".laz": Format(".las", content="a whole LAS file", may_crash=True),
    **dict.fromkeys(
        (".bag", ".db3", ".mcap", "/metadata.yaml"), Format(".rosbag", None, "a whole recording", True, True)
    ),
    **dict.fromkeys((".pcap", ".pcapng"), Format(".velodyne", None, "a whole capture of Velodyne packets", True)),
}


def formats() -> dict[str, Format]:
    """The table of readers: ours, and those of other packages that are installed.

    Raises
    ------
    DatasetError
        Two of them read files of one suffix.
    """
    return FORMATS | _other_formats()


def suffix_of(path: Path) -> str | None:
    """The known suffix of a file, or of that which a frame is in; in lower case, or None."""
    file = address_of(path).file
    name, known = _name_of(file).lower(), formats()
    by_name = (name[i:] for i, sign in enumerate(name) if sign == "." and name[i:] in known)
    return next(by_name, None) or next(
        (suffix for suffix in known if suffix[0] == "/" and (file / suffix[1:]).is_file()), None
    )


def format_of(path: Path) -> Format:
    """The format of a file, or of that which a frame is in; that of no module if it is not known."""
    return formats().get(suffix_of(path) or "", Format(""))


def may_crash(path: Path) -> bool:
    """True if reading a file may end the process; see `Format`."""
    return format_of(path).may_crash


def stem_of(path: Path) -> str:
    """The file name without its known suffix: the name of the pair; of a frame with its topic and number or time."""
    file, topic, frame = address_of(path)
    suffix = suffix_of(file) or ""
    name = _name_of(file)
    name = name if suffix.startswith("/") else name[: -len(suffix) or None]
    return "-".join(filter(None, [name, *(topic or "").split("/"), frame]))


def _name_of(file: Path) -> str:
    """The file name of a scan; of a stub that of its object."""
    return file.stem if is_stub(file) else file.name


def is_scan_path(path: Path) -> bool:
    """True if a path is a file, or the address of a frame in an existing recording."""
    file = address_of(path).file
    return file.is_file() or (suffix_of(file) or "").startswith("/")


def holds_frames(path: Path) -> bool:
    """True if a path is a recording, or a frame of one."""
    return format_of(path).holds_frames


def files_of(path: Path) -> list[Path]:
    """The files that a scan or a frame is read from."""
    file = address_of(path).file
    return sorted(each for each in file.iterdir() if each.is_file()) if file.is_dir() else [file]


def frames_of(path: Path) -> list[Path]:
    """Addresses of the frames of a recording, in order of time.

    Raises
    ------
    ScanError
        The recording is missing or broken, or has several topics and no topic is given.
    """
    known = format_of(path)
    if not known.holds_frames:
        raise ScanError(f"{path}: expected a bag or a capture of packets: files of this format hold no frames")
    with _reader(path, known) as reader:
        found: list[Path] = reader.frames(address_of(path))
    return found


def read_scan(
    path: Path | str, columns: tuple[str, ...] | None = None, label_names: dict[int, str] | None = None
) -> Scan:
    """The points of a scan file, or of one frame of a recording, with their other columns.

    Points that are not finite or zero are kept: cleaning drops and counts them.

    Parameters
    ----------
    path : the file; its suffix determines the format; of a recording with the frame, `drive.mcap#/points@12`
    columns : names of the columns of a raw file (.bin, .pcd.bin), if not the usual ones, or of a table (.npy, .csv)
        with as many columns; ignored for other formats
    label_names : class names for labels that are numbers, of a .label file or of a file that names its columns

    Raises
    ------
    ScanError
        The file is missing, empty, truncated or of another format; or the library that reads it is missing.
    """
    path = Path(path)
    known, address = format_of(path), address_of(path)
    if not known.module:
        if not address.file.exists():
            raise ScanError(f"{path}: no such file")
        raise ScanError(f"{path}: unknown format; known are {', '.join(formats())}")
    if address.file != path and not known.holds_frames:
        raise ScanError(f"{path}: a {suffix_of(path)} file holds one scan; it is named without #")
    if known.holds_frames and is_stub(address.file):
        raise ScanError(f"{path}: recordings are not read by URL; copy it to a local folder")
    with _local(address.file, stem_of(path)) as file, _reader(path, known) as reader:
        if file.stat().st_size == 0:
            raise ScanError(f"{path}: the file is empty")
        if known.holds_frames:
            scan: Scan = reader.read(address)
        elif known.columns is None:
            scan = reader.read(file)
        else:
            scan = reader.read(file, columns or known.columns)
        if known.columns and not columns:
            reader.check_width(file, known.columns)
        if not len(scan.points):
            raise ScanError(f"{path}: the file has no points")
        labelled = with_label_file(scan, file, stem_of(path))
    names = label_names if label_names and (labelled is not scan or not known.columns) else {}
    return with_label_names(labelled, names)


def _local(file: Path, stem: str) -> AbstractContextManager[Path]:
    """A scan file on this machine next to its labels: itself, or a copy of the object that a stub names."""
    if not is_stub(file):
        return nullcontext(file)
    from ...storage.remote_dataset import fetched_scan

    return fetched_scan(file, label_path_of(file, stem))


@contextmanager
def _reader(path: Path, known: Format) -> Iterator[Any]:
    """The module that reads files of a format; any of its errors becomes a `ScanError`: a broken file may raise any."""
    try:
        yield importlib.import_module(known.module, __name__)
    except ModuleNotFoundError as error:
        extra = _EXTRAS.get((error.name or "").partition(".")[0])
        if extra is None:
            raise
        raise ScanError(
            f"{path}: reading it needs {error.name}; install it with: pip install 'fidpipe[{extra}]'"
        ) from error
    except FidpipeError:
        raise
    except BaseException as error:
        is_panic = type(error).__name__ == "PanicException"  # of a library in Rust; pyo3 makes it no Exception
        if not (isinstance(error, Exception) or is_panic):
            raise
        what = f"not {known.content}" if known.content else "cannot be read"
        cause = "its header is not text" if isinstance(error, UnicodeDecodeError) else cause_of(error)
        if isinstance(error, OSError) and error.errno is not None:  # of the file itself, not of a library
            what, cause = "cannot be read", str(error.strerror)
        raise ScanError(f"{path}: {what} ({cause})") from error


@cache
def _other_formats() -> dict[str, Format]:
    """Readers that other packages declare in the group `fidpipe.readers`, by suffix."""
    found: dict[str, Format] = {}
    for entry in entry_points(group="fidpipe.readers"):
        suffix = f".{entry.name.lower()}"
        other = found.get(suffix) or FORMATS.get(suffix)
        if other is not None:
            raise DatasetError(
                f"two readers of {suffix} files are installed, {other.module.strip('.')} and {entry.value}; "
                f"uninstall the package of {entry.value}"
            )
        found[suffix] = Format(entry.value, may_crash=True)
    return found
