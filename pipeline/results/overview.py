"""The overview of a run: what to fix first, the largest missing and invented pieces, and limits to the trust in them.

It and the findings are made from the tables of objects, read some pairs at a time (`describe_objects`).
"""

from __future__ import annotations

import re
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from ...schemas.columns import SIDE_NAMES, SIDES, Row
from ...schemas.record import (
    ELSEWHERE,
    SURFACE_STATES,
    FrameSuspect,
    MetricsSummary,
    RunRecord,
    SurfaceStates,
    UnmatchedSurface,
)
from ...schemas.results import Caution, Findings, Overview, Piece, SurfaceGroup
from ...schemas.tables import TABLES
from ...stages.arrays import BoolArray, FloatArray
from ...stages.coverage import ROAD, surface_state
from ...stages.statistics.comparison import LEAST_PAIRS
from ...stages.statistics.findings import BAND_NAMES
from ..storage.files import path_exists
from ..storage.folder import RunFolder
from ..storage.urls import recorded_path
from .best_case import BEST_CASE_RECIPE
from .causes import named_and_small, read_causes, unknown_causes
from .independence import NEEDED, find_places, pairs_and_places
from .object_findings import FINDINGS_COLUMNS, summarise_objects
from .object_frame import object_parts, plain_rows
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
#: Columns of the frame of objects that the overview uses.
OVERVIEW_COLUMNS = (
    "covered_0p3m",
    "road_share",
    "r_lambda",
    "alignment_rms_m",
    "diagonal_m",
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
) -> tuple[Findings | None, Overview | None, MetricsSummary]:
    """The findings, the overview without the limits to the trust in it, and the states of unmatched objects.

    Parameters
    ----------
    scored : rows of `pairs`
    timestamps_s : by pair
    hashes : by pair, content hash of its real scan (`real`)
    by_reference : True if the real side fixes the objects
    """
    import pandas as pd

    if not len(scored):
        none = SurfaceStates(there=0, partly=0, absent=0, road=0)
        return (
            None,
            None,
            MetricsSummary(unmatched=UnmatchedSurface(not_found=none, extra=none)),
        )
    pair_ids = scored["pair_id"].to_pylist()
    columns = list({*FINDINGS_COLUMNS, *OVERVIEW_COLUMNS})
    parts = object_parts(store, pair_ids, columns, by_reference=by_reference)
    objects = pd.concat([part.loc[part["fate"] != "remnant", [*_KEYS, *columns]] for part in parts])
    objects["label"] = objects["label"].fillna("")
    blocks = find_places(store, pair_ids, hashes, timestamps_s)
    found = summarise_objects(objects, len(pair_ids))
    places = dict(zip(pair_ids, blocks.tolist(), strict=True))
    findings = Findings(n_places=len(np.unique(blocks)), places=places, **vars(found))
    causes = read_causes(store, pair_ids)
    named, small = named_and_small(causes, blocks)
    overview = Overview(
        causes=tuple(named),
        unknown=tuple(unknown_causes(causes)),
        doubts=tuple(_doubts(store, pair_ids)),
        small=tuple(small),
        pieces=tuple(largest_pieces(store, pair_ids)),
        surface=tuple(_surface(objects)),
        **_alignment(objects),
    )
    return findings, overview, _unmatched(objects)


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


def _unmatched(objects: pd.DataFrame) -> MetricsSummary:
    """Counts of unmatched objects whose surface the other side has, and of those that are road."""
    counts = {}
    for fate in UnmatchedSurface.model_fields:
        alone = objects[objects["fate"] == fate]
        states = Counter(dict.fromkeys(SURFACE_STATES, 0))
        states.update(map(surface_state, alone["covered_0p3m"]))
        counts[fate] = SurfaceStates(**states, road=int((alone["road_share"] > ROAD).sum()))
    return MetricsSummary(unmatched=UnmatchedSurface(**counts))


def _surface(objects: pd.DataFrame) -> Iterator[SurfaceGroup]:
    """Coverage by range and by class."""
    alone = objects["n_points"] * (1 - objects["covered_0p3m"].fillna(0.0))
    points = objects.assign(alone=alone)
    labels = sorted(set(objects["label"]) - {""})
    groups: tuple[tuple[str, str, dict[Any, str]], ...] = (
        ("range", "band", dict(enumerate(BAND_NAMES))),
        ("class", "label", {label: label for label in labels}),
    )
    for group, column, names in groups:
        sums = points.groupby([column, "side"])[["n_points", "alone"]].sum()
        for key, name in names.items():
            n_real, missing = sums.loc[key, "real"] if (key, "real") in sums.index else (0, 0.0)
            n_sim, invented = sums.loc[key, "sim"] if (key, "sim") in sums.index else (0, 0.0)
            yield SurfaceGroup(
                group=group,
                name=name,
                n_real=int(n_real),
                missing_share=missing / n_real if n_real else None,
                n_sim=int(n_sim),
                invented_share=invented / n_sim if n_sim else None,
            )


def _alignment(objects: pd.DataFrame) -> dict[str, int]:
    """Numbers of aligned and of badly aligned objects."""
    scored = objects[(objects["side"] == "real") & objects["r_lambda"].notna()]
    is_bad = alignment_is_bad(scored["alignment_rms_m"].to_numpy(), scored["diagonal_m"].to_numpy())
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
    return Piece(
        pair_id=row["pair_id"],
        side=row["side"],
        piece_id=row["piece_id"],
        fate=fate,
        label=row["label"],
        n_points=row["n_points"],
        range_m=row["range_m"],
        bearing_deg=row["bearing_deg"],
        extents_m=extents,
        words=place_words(row["label"], extents, row["range_m"], row["bearing_deg"]),
        fate_words=fate_words,
    )


def cautions(overview: Overview, record: RunRecord) -> Iterator[Caution]:
    """Limits to the trust in the numbers of a run, most important first; from its record without an overview."""
    pairs = record.pairs
    n_pairs = pairs.scored + pairs.failed + pairs.to_do
    if pairs.failed:
        yield Caution(
            kind="failed", words=f"{pairs.failed} of {n_pairs} pairs failed and count nowhere"
        )
    if pairs.to_do:
        yield Caution(kind="to_do", words=f"{pairs.to_do} of {n_pairs} pairs are not evaluated yet")
    suspects = dict(record.frames)
    elsewhere = [name for name, frame in suspects.items() if frame.reading == ELSEWHERE]
    for name in elsewhere:
        del suspects[name]
    if suspects:
        yield Caution(kind="frames", words=_frames_summary(suspects, n_pairs))
    if elsewhere:
        names = ", ".join(elsewhere[:_MOST_NAMED])
        if len(elsewhere) > _MOST_NAMED:
            names += ", ..."
        which = f"in {len(elsewhere)} of {n_pairs} pairs"
        words = f"{which} the two scans do not show the same place, but count ({names})"
        yield Caution(kind="frames", words=words)
    if record.notes:
        pair_id, (note, *_) = next(iter(record.notes.items()))
        words = f"ground cut, notes on {len(record.notes)} of {n_pairs} pairs; {pair_id}: {note}"
        yield Caution(kind="ground", words=words)
    n_places = record.findings.n_places if record.findings else 0
    if n_places < LEAST_PAIRS:
        counted = pairs_and_places(pairs.scored, n_places)
        yield Caution(kind="pairs", words=f"{counted}: a verdict on the world {NEEDED}")
    elif n_places < pairs.scored:
        yield Caution(
            kind="independence",
            words=f"{pairs_and_places(pairs.scored, n_places)}, which count once each",
        )
    if overview.n_aligned and overview.n_badly_aligned >= _MANY_BADLY_ALIGNED * overview.n_aligned:
        share = f"{100 * overview.n_badly_aligned / overview.n_aligned:.0f} %"
        words = (
            f"r_lambda of {share} of the matched objects is unreliable "
            f"(poor alignment: {BAD_ALIGNMENT_WORDS})"
        )
        yield Caution(kind="alignment", words=words)
    if record.preset != "reference":
        words = (
            "each scan is segmented separately, so scores vary with the segmentation; "
            f"to compare simulators: {_by_reference(record)}"
        )
        yield Caution(kind="partition", words=words)
    if path_exists(recorded_path(record.dataset) / BEST_CASE_RECIPE):
        return  # it is a best case itself
    yield Caution(
        kind="best_case",
        words="no best case yet; the scores of a perfect simulator: fidpipe best-case RUN",
    )


def _by_reference(record: RunRecord) -> str:
    """Command that evaluates the dataset of a run with reference objects and its other settings."""
    command = ["fidpipe", "run", record.dataset, "--preset", "reference"]
    for setting in record.departures:
        command += ["--set", setting]
    out = f"runs/{recorded_path(record.dataset).name}-reference"
    return shlex.join([*command, "--out", out])


def _frames_summary(suspects: Mapping[str, FrameSuspect], n_pairs: int) -> str:
    """One line for all suspect pairs of a run, by their most frequent reading."""
    kinds = [_NUMBER.sub("", suspect.reading) for suspect in suspects.values()]
    kind = max(kinds, key=kinds.count)
    similar = {
        pair_id: own
        for (pair_id, own), other in zip(suspects.items(), kinds, strict=True)
        if other == kind
    }
    before = float(np.mean([suspect.as_it_lies for suspect in similar.values()]))
    after = float(np.mean([suspect.coverage for suspect in similar.values()]))
    pair_id, first = next(iter(similar.items()))
    is_one_setting = all(own.setting == first.setting for own in similar.values())
    where = (
        ""
        if is_one_setting
        else f" (in pair {pair_id}; the others are listed under frames in run.json)"
    )
    others = ""
    if len(similar) < len(suspects):
        others = f"; {len(suspects) - len(similar)} in other ways, see frames in run.json"
    return (
        f"in {len(suspects)} of {n_pairs} pairs the simulated scan seems to lie in another frame: "
        f"in {len(similar)} it "
        f"covers {before:.2f} of the real one as given and {after:.2f} {first.reading}; set "
        f"{first.setting}{where} "
        f"and run again{others}"
    )
