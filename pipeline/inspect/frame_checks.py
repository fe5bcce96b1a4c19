"""Whether the two files of a pair belong together: one frame, two files, each on its own side.

A pair's frames are compared once, where its files are read anyway; what came out is kept beside the marks of both
files, so that an unchanged pair need not be compared again.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from ...schemas.columns import SIDES
from ...schemas.record import FrameSuspect
from ...stages.inspect.frames import LEAST_GAIN, LEAST_SAME_PLACE, FrameCheck
from ..datasets.pairs import ScanPair

_NUMBER = re.compile(r"[-+]?[0-9]+\.[0-9]+")
_WORDS = {"real": {"real"}, "sim": {"sim", "simulated", "simulation"}}


@dataclass(frozen=True)
class FrameFacts:
    """What was learnt of the frames of a pair.

    marks : of each file, side by side, when it was read; see `scan_checks.file_marks`
    settings_keys : of each file, see `scan_checks.settings_key`, and what else the comparison depends on
    check : of the frames; None where too little could be compared
    """

    marks: list[list[list[int]]]
    settings_keys: list[str]
    check: FrameCheck | None

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as `recall_frames` takes them back."""
        return asdict(self)

    @property
    def suspect(self) -> FrameSuspect | None:
        """What a run's record says of the pair; None where nothing is suspect."""
        if self.check is None or not self.check.is_suspect:
            return None
        check = self.check
        return FrameSuspect(
            reading=check.reading,
            coverage=round(check.coverage, 4),
            as_it_lies=round(check.as_it_lies, 4),
            setting=check.setting,
        )


_FRAME_FACTS = TypeAdapter(FrameFacts)


def frames_name(pair: ScanPair) -> str:
    """What the comparison is called in a ledger: by both files, wherever the command is called."""
    return f"{pair.pair_id} frames {' '.join(str(path and path.absolute()) for path in (pair.real, pair.sim))}"


def recall_frames(
    known: Callable[[str], Mapping[str, Any] | None],
    pair: ScanPair,
    marks: list[list[list[int]]],
    settings_keys: list[str],
) -> FrameFacts | None:
    """What was learnt of a pair's frames before, if files and settings are the same; else None.

    Parameters
    ----------
    known : gives the facts by `frames_name`, as a run's ledger has them
    marks, settings_keys : of both files as they are now
    """
    facts = known(frames_name(pair))
    try:
        found = None if facts is None else _FRAME_FACTS.validate_python(facts)
    except ValueError:  # not as this version writes them
        return None
    return found if found and (found.marks, found.settings_keys) == (marks, settings_keys) else None


def place_warning(check: FrameCheck) -> str:
    """One line for two scans of different places."""
    return (
        f"the two scans do not show the same place: the simulated scan covers {check.coverage:.2f} of the real one in "
        f"the best of all frames, units and shifts ({check.as_it_lies:.2f} as it lies); expected at least "
        f"{LEAST_SAME_PLACE:g}; pair scans of one place, or set T_real_sim"
    )


def frame_warning(suspect: FrameSuspect | FrameCheck) -> str:
    """One line with both figures and the setting that fixes it."""
    if suspect.coverage - suspect.as_it_lies < LEAST_GAIN:
        return (
            f"the ground of the two scans is at the same height if the simulated scan is {suspect.reading}; is the "
            f"mount height wrong? set {suspect.setting}"
        )
    return (
        f"the simulated scan covers {suspect.as_it_lies:.2f} of the real one as it lies and {suspect.coverage:.2f} "
        f"{suspect.reading}; is it in another frame? set {suspect.setting}"
    )


def frames_summary(suspects: Mapping[str, FrameSuspect], n_pairs: int) -> str:
    """One line for all suspect pairs of a run, told by the most frequent reading."""
    kinds = [_NUMBER.sub("", suspect.reading) for suspect in suspects.values()]
    kind = max(kinds, key=kinds.count)
    alike = {pair_id: own for (pair_id, own), other in zip(suspects.items(), kinds, strict=True) if other == kind}
    before, after = (
        float(np.mean([getattr(own, name) for own in alike.values()])) for name in ("as_it_lies", "coverage")
    )
    pair_id, first = next(iter(alike.items()))
    is_one_setting = all(own.setting == first.setting for own in alike.values())
    where = "" if is_one_setting else f" (in pair {pair_id}; the others stand under frames in run.json)"
    others = f"; {len(suspects) - len(alike)} in other ways, see frames in run.json" * (len(alike) < len(suspects))
    return (
        f"in {len(suspects)} of {n_pairs} pairs the simulated scan seems to lie in another frame: in {len(alike)} it "
        f"covers {before:.2f} of the real one as it lies and {after:.2f} {first.reading}; set {first.setting}{where} "
        f"and run again{others}"
    )


def shared_files(hashes: Mapping[str, Mapping[str, str]]) -> list[str]:
    """One line for each content that stands in more than one pair or on both sides of one.

    Parameters
    ----------
    hashes : by pair and side, the content hash of the scan file
    """
    places: dict[str, list[tuple[str, str]]] = {}
    for pair_id, sides in hashes.items():
        for side in SIDES:
            if sha256 := sides.get(side):
                places.setdefault(sha256, []).append((pair_id, side))
    lines = []
    for where in places.values():
        pair_ids = list(dict.fromkeys(pair_id for pair_id, _ in where))
        lines += [
            f"pair {pair_id}: real and simulated file hold the same points; two different scans are wanted"
            for pair_id in pair_ids
            if len([side for name, side in where if name == pair_id]) == len(SIDES)
        ]
        if len(pair_ids) > 1:
            named = ", ".join(f"{pair_id} ({side})" for pair_id, side in where[:5])
            more = f" and {len(where) - 5} more" * (len(where) > 5)
            lines.append(f"pairs {named}{more}: the files hold the same points; each scan is wanted in one pair")
    return lines


def swapped_sides(pairs: Iterable[ScanPair], folder: Path) -> list[str]:
    """One line for each pair one of whose files is named after the other side, by its own name or its folders."""
    lines = []
    resolve = cache(Path.resolve)  # of folders: many files share one
    for pair in pairs:
        if pair.real is None or pair.sim is None:
            continue
        paths = {"real": (pair.real, pair.sim), "sim": (pair.sim, pair.real)}
        words = {side: _words(*own, folder, resolve) for side, own in paths.items()}
        for side, other in (("real", "sim"), ("sim", "real")):
            if words[side] & _WORDS[other] and not words[side] & _WORDS[side]:
                name = {"real": "real", "sim": "simulated"}
                lines.append(
                    f"pair {pair.pair_id}: the {name[side]} scan is {pair.path(side)}, "
                    f"which is named {name[other]}; are the sides swapped?"
                )
                break
    return lines


def _words(path: Path, other: Path, folder: Path, resolve: Callable[[Path], Path]) -> set[str]:
    """Words in a file's name and in its folders, below the dataset's folder or else where the other's differ."""

    def resolved(file: Path) -> Path:
        return file.resolve() if file.is_symlink() else resolve(file.parent) / file.name

    if (
        not path.is_symlink()
        and path.is_relative_to(folder)
        and resolved(path) == resolve(folder) / path.relative_to(folder)
    ):
        parts: Iterable[str] = path.relative_to(folder).parts
    else:
        parts = set(resolved(path).parts) - set(resolved(other).parts)
    return {word for part in parts for word in re.split("[^a-z]+", part.lower())}
