"""Formats by suffix. One file per format, each with one `read`; a new format is a file and a row here.

Another package adds one by an entry point of the group `fidpipe.readers`: its name is the suffix
without the dot, its value the module whose `read(path) -> Scan` reads such files.
"""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from typing import NamedTuple

_KITTI = ("x", "y", "z", "intensity")
_NUSCENES = (*_KITTI, "ring")


class Format(NamedTuple):
    """Reader of the files of one suffix.

    module : whose `read(path) -> Scan` reads them: a file of this folder, with a dot before its
        name, or a module of another package; it is imported when first used; "" if the format is
        not known
    columns : for raw rows, whose files do not name their columns, the usual ones; `read(path,
        columns)` then takes these, or those of the setting `input.columns`, and `check_width(path,
        columns)` rejects a file that the usual ones do not fit; () if the shape or a header
        determines them
    extra : of fidpipe, that brings the library of the reader; "" if it is always there
    holds_frames : whether a file is a recording; `read` then takes a `ScanRef`, and `frames` lists
        those of all frames
    may_crash : whether a damaged file may end the process that reads it, or fill the memory:
        formats whose libraries trust a file's declared sizes of its compressed parts, and the
        readers of other packages
    """

    module: str
    columns: tuple[str, ...] | None = None
    extra: str = ""
    holds_frames: bool = False
    may_crash: bool = False


_BAG = Format(".rosbag", extra="ros", holds_frames=True, may_crash=True)
_CAPTURE = Format(".velodyne", extra="velodyne", holds_frames=True)

#: A longer suffix is tried before a shorter one that it ends with. One that begins with / is a file in a folder.
FORMATS = {
    ".pcd.bin": Format(".float32", _NUSCENES),
    ".bin": Format(".float32", _KITTI),
    ".npy": Format(".npy", ()),
    ".pcd": Format(".pcd"),
    ".ply": Format(".ply"),
    ".csv": Format(".csv", ()),
    ".feather": Format(".arrow", may_crash=True),
    ".parquet": Format(".arrow", may_crash=True),
    ".las": Format(".las", extra="las"),
    ".laz": Format(".las", extra="las", may_crash=True),
    ".bag": _BAG,
    ".db3": _BAG,
    ".mcap": _BAG,
    "/metadata.yaml": _BAG,
    ".pcap": _CAPTURE,
    ".pcapng": _CAPTURE,
}


@cache
def known_formats() -> dict[str, Format]:
    """Readers by suffix: ours, and those that other packages declare in the group `fidpipe.readers`."""
    others = {}
    for entry in entry_points(group="fidpipe.readers"):
        others[f".{entry.name.lower()}"] = Format(entry.value, may_crash=True)
    return others | FORMATS
