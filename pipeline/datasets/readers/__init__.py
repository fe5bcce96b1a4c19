"""Reading scans of any format."""

from __future__ import annotations

import importlib
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from ....schemas.errors import FidpipeError, ScanError
from .formats import known_formats
from .scan import Scan, cause_of, with_label_file, with_label_names
from .scan_ref import ScanRef, scan_ref


def frames_of(source: ScanRef | Path | str) -> list[ScanRef]:
    """The frames of a recording, in order of time.

    Raises
    ------
    ScanError
        The recording is missing or broken, or has several topics and no topic is given.
    """
    recording = scan_ref(source)
    if not recording.format.holds_frames:
        raise ScanError(
            f"{source}: expected a bag or a capture of packets: files of this format hold no frames",
        )
    with _reader(recording) as reader:
        return reader.frames(recording)


def read_scan(
    path: ScanRef | Path | str,
    columns: tuple[str, ...] | None = None,
    label_names: dict[int, str] | None = None,
) -> Scan:
    """The points of a scan file, or of one frame of a recording, with their other columns.

    Points that are not finite or zero are kept: cleaning drops and counts them.

    Parameters
    ----------
    path : the file; its suffix determines the format; of a recording with the frame,
        `drive.mcap#/points@12`
    columns : names of the columns of a raw file (.bin, .pcd.bin), if not the usual ones, or of a
        table (.npy, .csv) with as many columns; ignored for other formats
    label_names : class names for labels that are numbers, of a .label file or of a file that names
        its columns

    Raises
    ------
    ScanError
        The file is missing, empty, truncated or of another format; or the library that reads it is
        missing.
    """
    ref = scan_ref(path)
    known = ref.format
    if not known.module:
        if not ref.file.exists():
            raise ScanError(f"{ref}: no such file")
        raise ScanError(f"{ref}: unknown format; known are {', '.join(known_formats())}")
    if (ref.topic or ref.frame) and not known.holds_frames:
        raise ScanError(f"{ref}: a {ref.suffix} file holds one scan; it is named without #")
    if known.holds_frames and ref.stubs:
        raise ScanError(f"{ref}: recordings are not read by URL; copy it to a local folder")
    with _local(ref) as file, _reader(ref) as reader:
        if file.stat().st_size == 0:
            raise ScanError(f"{ref}: the file is empty")
        names = () if known.columns is None else (columns or known.columns,)
        scan: Scan = reader.read(ref if known.holds_frames else file, *names)
        if known.columns and not columns:
            reader.check_width(file, known.columns)
        if not len(scan.points):
            raise ScanError(f"{ref}: the file has no points")
        labelled = with_label_file(scan, replace(ref, file=file, stubs=()))
    has_names = labelled is not scan or not known.columns
    return with_label_names(labelled, label_names if label_names and has_names else {})


def _local(ref: ScanRef) -> AbstractContextManager[Path]:
    """The file of a scan on this machine next to its labels: itself, or a copy of the object that a stub names."""
    if not ref.stubs:
        return nullcontext(ref.file)
    from ...storage.remote_dataset import fetched_scan

    return fetched_scan(ref.stubs)


@contextmanager
def _reader(ref: ScanRef) -> Iterator[Any]:
    """The module that reads a scan; any of its errors becomes a `ScanError`: a broken file may raise any."""
    try:
        yield importlib.import_module(ref.format.module, __name__)
    except FidpipeError:
        raise
    except BaseException as error:
        # panics of libraries in Rust are not subclasses of Exception
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        reason = f"damaged or of another format ({cause_of(error)}); export it again"
        if isinstance(error, OSError) and error.strerror:
            # of the file itself, not of a library
            reason = f"cannot be read ({error.strerror})"
        elif isinstance(error, MemoryError):
            reason = f"cannot be read ({cause_of(error)}); too large for the memory, or damaged"
        elif isinstance(error, ModuleNotFoundError):
            reason = f"reading it needs {error.name}"
            if ref.format.extra:
                reason += f"; install it with: pip install 'fidpipe[{ref.format.extra}]'"
        raise ScanError(f"{ref}: {reason}") from error
