"""The overview of a run: what to fix first, the largest missing and invented pieces, and limits to the trust in them.

And the findings: the objects of all pairs together by range and by class; means over pairs are in `stages.summary`.
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDE_NAMES, SIDES, Row
from ...schemas.metric_catalogue import DISTRIBUTED
from ...schemas.record import (
    ELSEWHERE,
    FrameSuspect,
    RunRecord,
)
from ...schemas.results import (
    Caution,
    Findings,
    ObjectGroup,
    Overview,
    Piece,
)
from ...schemas.tables import TABLES
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.bands import BAND_EDGES_M, BAND_NAMES
from ...stages.statistics.comparison import LEAST_PAIRS
from ...stages.summary import mean_and_std
from ..storage.folder import RunFolder
from ..storage.run_record import as_options
from ..storage.urls import recorded_path
from .causes import named_and_small, read_causes, unknown_causes
from .independence import NEEDED, find_places, pairs_and_places
from .object_frame import EXTENTS, object_frame, plain_rows
from .places import moved_words, place_words

if TYPE_CHECKING:
    import pandas as pd

#: Number of the largest pieces that are kept.
N_PIECES = 4
#: An alignment is bad beyond this share of the diagonal of the real object's bounding box. Paired at random, the points
#: of a filled cube give 0.41: the distance of two of them (root mean square: edge / sqrt 2) over edge sqrt 3.
BAD_ALIGNMENT = 0.25
#: So far apart it is bad regardless of the object's size: as far as centroids may lie for two objects to be matched
#: (the default of matching.delta_m).
BAD_ALIGNMENT_M = 5.0
#: From this share of badly aligned objects on it is reported.
_MANY_BADLY_ALIGNED = 0.05
_MOST_NAMED = 3
_NUMBER = re.compile(r"[-+]?[0-9]+(\.[0-9]+)?")
BAD_ALIGNMENT_WORDS = (
    f"nodes over {100 * BAD_ALIGNMENT:g} % of the object's size or {BAD_ALIGNMENT_M:g} m apart"
)
NO_LABEL = "(no label)"
_KEYS = ["pair", "side", "fate", "n_points"]
#: Requested columns of the frame of objects.
_COLUMNS = (
    *("range_m", "label", "covered_0p3m"),
    *(*DISTRIBUTED, "alignment_rms_m", *EXTENTS),
)


def alignment_is_bad(
    alignment_rms_m: float | FloatArray, diagonal_m: float | FloatArray
) -> bool | BoolArray:
    """True if nodes are aligned so far apart that r_lambda is unreliable, (n,) bool; or of one object.

    Parameters
    ----------
    alignment_rms_m : (n,) float64, of `metrics`
    diagonal_m : (n,) float64, of the real object's axis-aligned bounding box

    Examples
    --------
    >>> alignment_is_bad(np.array([20.0, 2.0, 1.0]), np.array([90.0, 6.0, 6.0])).tolist()
    [True, True, False]
    """
    return alignment_rms_m > np.minimum(BAD_ALIGNMENT * diagonal_m, BAD_ALIGNMENT_M)


def describe_objects(
    store: RunFolder,
    scored: pa.Table,
    timestamps_s: Mapping[str, float | None],
    hashes: Mapping[str, Mapping[str, str]],
    *,
    by_reference: bool,
) -> tuple[Findings | None, Overview | None]:
    """The findings, and the overview without the limits to the trust in it; None without a scored pair.

    Parameters
    ----------
    scored : rows of `pairs`
    timestamps_s : by pair
    hashes : by pair, content hash of its real scan (`real`)
    by_reference : True if the real side fixes the objects
    """
    if not len(scored):
        return None, None
    pair_ids = scored["pair_id"].to_pylist()
    objects = object_frame(store, pair_ids, _COLUMNS, by_reference=by_reference)
    objects = objects.loc[objects["fate"] != "remnant", [*_KEYS, *_COLUMNS]]
    objects["label"] = objects["label"].fillna("")
    blocks = find_places(store, pair_ids, hashes, timestamps_s)
    places = dict(zip(pair_ids, blocks.tolist(), strict=True))
    groups = tuple(object_groups(objects))
    findings = Findings(groups=groups, n_places=len(set(places.values())), places=places)
    causes = read_causes(store, pair_ids)
    named, small = named_and_small(causes, blocks)
    overview = Overview(
        causes=tuple(named),
        unknown=tuple(unknown_causes(causes)),
        doubts=tuple(_doubts(store, pair_ids)),
        small=tuple(small),
        pieces=tuple(largest_pieces(store, pair_ids)),
        **_alignment(objects),
    )
    return findings, overview


def object_groups(objects: pd.DataFrame) -> Iterator[ObjectGroup]:
    """The objects by range, then by class, the class with most objects first.

    Parameters
    ----------
    objects : of both sides without remnants, with `_COLUMNS`; label is "" if an object has none
    """
    bands = np.digitize(objects["range_m"], BAND_EDGES_M) - 1
    for band, name in enumerate(BAND_NAMES):
        yield _group("range", name, objects[bands == band])
    sizes = objects[objects["label"] != ""].groupby("label").size()
    for label in sizes.sort_values(ascending=False, kind="stable").index:
        yield _group("class", label, objects[objects["label"] == label])


def _group(by: str, name: str, objects: pd.DataFrame) -> ObjectGroup:
    real, sim = [objects[objects["side"] == side] for side in SIDES]
    matched = real[real["fate"] == "matched"]
    return ObjectGroup(
        by=by,
        name=name,
        n_real=len(real),
        n_not_found=len(real) - len(matched),
        n_sim=len(sim),
        n_extra=int((sim["fate"] == "extra").sum()),
        n_real_points=int(real["n_points"].sum()),
        missing_share=_uncovered_share(real),
        n_sim_points=int(sim["n_points"].sum()),
        invented_share=_uncovered_share(sim),
        scores={name: mean_and_std(matched[name].to_numpy())[0] for name in DISTRIBUTED},
    )


def _uncovered_share(objects: pd.DataFrame) -> float | None:
    """Share of the points of some objects without a counterpart within 0.3 m; None without points."""
    n_points = objects["n_points"]
    n_uncovered = (n_points * (1 - objects["covered_0p3m"].fillna(0.0))).sum()
    return float(n_uncovered / n_points.sum()) if n_points.any() else None


def _doubts(store: RunFolder, pair_ids: Sequence[str]) -> list[str]:
    """Why points of the scans cannot be trusted, see `doubt_lines`."""
    tables = store.read_pairs(pair_ids, {("sensor", side): ["doubts"] for side in SIDES})
    lines = []
    for side in SIDES:
        texts = "\n".join(tables["sensor", side]["doubts"].dropna()).splitlines()
        lines += doubt_lines(side, texts, len(pair_ids))
    return lines


def doubt_lines(side: str, texts: Sequence[str], n_scans: int) -> list[str]:
    """One line for each kind of doubt about the scans of a side, of the first of them, with their number."""
    kinds = [_NUMBER.sub("", text) for text in texts]
    start = f"{SIDE_NAMES[side]} scans"
    return [
        f"{start} ({n} of {n_scans}): {texts[kinds.index(kind)]}"
        for kind, n in Counter(kinds).items()
    ]


def _alignment(objects: pd.DataFrame) -> dict[str, int]:
    """Numbers of aligned and of badly aligned objects."""
    scored = objects[(objects["side"] == "real") & objects["r_lambda"].notna()]
    diagonal_m = np.linalg.norm(scored[[*EXTENTS]], axis=1)
    is_bad = alignment_is_bad(scored["alignment_rms_m"].to_numpy(), diagonal_m)
    return {"n_aligned": len(scored), "n_badly_aligned": int(np.count_nonzero(is_bad))}


def largest_pieces(store: RunFolder, pair_ids: Sequence[str]) -> list[Piece]:
    """The largest pieces of surface without a counterpart; one that moved counts once, on the real side."""
    columns = {("pieces", ""): TABLES["pieces"].schema.names}
    pieces = store.read_pairs(pair_ids, columns)["pieces", ""]
    pieces = pieces[(pieces["side"] == "real") | (pieces["fate"] != "moved")]
    order = ["n_points", "pair_id", "side", "piece_id"]
    largest = pieces.sort_values(order, ascending=False).head(N_PIECES)
    return [_piece(row) for row in plain_rows(largest)]


def _piece(row: Row) -> Piece:
    extents = row["extent_x"], row["extent_y"], row["extent_z"]
    fate = fate_words = "missing" if row["side"] == "real" else "invented"
    if row["fate"] == "moved":
        fate = "moved"
        fate_words = moved_words(row["moved_x_m"], row["moved_y_m"], row["moved_z_m"])
    stored = {name: row[name] for name in ("pair_id", "side", "piece_id", "n_points")}
    words = place_words(row["label"], extents, row["range_m"], row["bearing_deg"])
    return Piece(**stored, fate=fate, words=words, fate_words=fate_words)


def cautions(overview: Overview, record: RunRecord) -> list[Caution]:
    """Limits to the trust in the numbers of a run, most important first; from its record without an overview."""
    return [Caution(kind=kind, words=words) for kind, words in _limits(overview, record)]


def _limits(overview: Overview, record: RunRecord) -> Iterator[tuple[str, str]]:
    """Kind and words of each caution."""
    pairs = record.pairs
    n_pairs = pairs.scored + pairs.failed + pairs.to_do
    n_places = record.findings.n_places if record.findings else 0
    counted = pairs_and_places(pairs.scored, n_places)
    if pairs.to_do:
        yield "to_do", f"{pairs.to_do} of {n_pairs} pairs are not evaluated yet"
    for words in _frame_words(record.frames, n_pairs):
        yield "frames", words
    if record.notes:
        pair_id, (note, *_) = next(iter(record.notes.items()))
        n_noted = len(record.notes)
        yield "ground", f"ground cut, notes on {n_noted} of {n_pairs} pairs; {pair_id}: {note}"
    if n_places < LEAST_PAIRS:
        yield "pairs", f"{counted}: a verdict on the world {NEEDED}"
    elif n_places < pairs.scored:
        yield "independence", f"{counted}, which count once each"
    if (
        overview.n_aligned
        and overview.n_badly_aligned >= _MANY_BADLY_ALIGNED * overview.n_aligned
    ):
        share = f"{100 * overview.n_badly_aligned / overview.n_aligned:.0f} %"
        yield (
            "alignment",
            f"r_lambda of {share} of the matched objects is unreliable "
            f"(poor alignment: {BAD_ALIGNMENT_WORDS})",
        )
    if record.preset != "reference":
        yield (
            "partition",
            "each scan is segmented separately, so scores vary with the segmentation; "
            f"to compare simulators: {_by_reference(record)}",
        )


def _frame_words(frames: Mapping[str, FrameSuspect], n_pairs: int) -> Iterator[str]:
    """One line for all pairs that seem to lie in another frame, and one for those that show two places."""
    elsewhere = [name for name, frame in frames.items() if frame.reading == ELSEWHERE]
    suspects = [name for name in frames if name not in elsewhere]
    if suspects:
        first = frames[suspects[0]]
        yield (
            f"in {len(suspects)} of {n_pairs} pairs the simulated scan seems to lie in another "
            f"frame: in {suspects[0]} it covers {first.as_it_lies:.2f} of the real one as given "
            f"and {first.coverage:.2f} {first.reading}; set {first.setting} and run again "
            "(all of them: frames in run.json)"
        )
    if elsewhere:
        names = ", ".join(elsewhere[:_MOST_NAMED])
        if len(elsewhere) > _MOST_NAMED:
            names += ", ..."
        yield (
            f"in {len(elsewhere)} of {n_pairs} pairs the two scans do not show the same place, "
            f"but count ({names})"
        )


def _by_reference(record: RunRecord) -> str:
    """Command that evaluates the dataset of a run with reference objects and its other settings."""
    command = ["fidpipe", "run", record.dataset, *as_options("reference", record.departures)]
    out = f"runs/{recorded_path(record.dataset).name}-reference"
    return shlex.join([*command, "--out", out])
