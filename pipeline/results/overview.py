"""The overview of a run: what to fix first, the largest missing and invented pieces, and limits to the trust in them.

The objects are counted while the findings read them (`Tally`), some pairs at a time, so that the overview needs no
memory of its own.
"""

from __future__ import annotations

import shlex
from collections.abc import Iterator, Sequence
from heapq import nlargest
from pathlib import Path
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from ...schemas.columns import Row
from ...schemas.record import RunRecord
from ...schemas.results import Caution, Findings, ObjectOverview, Overview, Piece, SurfaceGroup
from ...schemas.settings import MatchingSettings
from ...stages.arrays import BoolArray, FloatArray
from ...stages.statistics.comparison import BLOCK_S, LEAST_PAIRS
from ...stages.statistics.findings import BAND_EDGES_M, BAND_NAMES
from ..inspect.frame_checks import frames_summary
from ..storage.files import path_exists
from .causes import CLASS, FAR, GroupCoverage, find_causes, surface_causes
from .findings import ObjectRows, SideRows
from .finished import FinishedRun
from .floor import FLOOR_RECIPE
from .places import moved_words, place_words

#: Number of the largest pieces that are kept.
N_PIECES = 4
#: An alignment is bad beyond this share of the diagonal of the real object's bounding box. Paired at random, the points
#: of a filled cube give 0.41: the distance of two of them (root mean square: edge / sqrt 2) over edge sqrt 3.
BAD_ALIGNMENT = 0.25
#: So far apart it is bad regardless of the object's size: as far as centroids may lie for two objects to be matched.
BAD_ALIGNMENT_M = MatchingSettings().delta_m
#: From this share of badly aligned objects on it is reported.
_MANY_BADLY_ALIGNED = 0.05
BAD_ALIGNMENT_WORDS = f"nodes over {100 * BAD_ALIGNMENT:g} % of the object's size or {BAD_ALIGNMENT_M:g} m apart"
NO_LABEL = "(no label)"


@overload
def alignment_is_bad(alignment_rms_m: float, diagonal_m: float) -> bool: ...


@overload
def alignment_is_bad(alignment_rms_m: FloatArray, diagonal_m: FloatArray) -> BoolArray: ...


def alignment_is_bad(alignment_rms_m: float | FloatArray, diagonal_m: float | FloatArray) -> bool | BoolArray:
    """Whether nodes are aligned so far apart that r_lambda says little, (n,) bool; or of one object.

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


class Tally:
    """Counts the objects of a run, some pairs at a time, and keeps the largest pieces.

    A piece that moved is one piece, of the real side. Largest: most points; ties by pair, side and number.
    """

    def __init__(self) -> None:
        self._n_pairs = self._n_aligned = self._n_badly_aligned = 0
        self._bands: dict[str, list[FloatArray]] = {"real": [], "sim": []}  # (2, n, n_bands): points and those alone
        self._classes: dict[str, dict[str, list[FloatArray]]] = {"real": {}, "sim": {}}  # by label, (2, n)
        self._pieces: list[tuple[tuple[int, str, str, int], Piece]] = []

    def add(self, rows: ObjectRows) -> None:
        """Counts the objects of some more pairs."""
        n = len(rows.pair_ids)
        scores = rows.scores
        for name, side in (("real", rows.real), ("sim", rows.sim)):
            band = np.searchsorted(BAND_EDGES_M, side.range_m, side="right") - 1
            self._bands[name].append(_points_of(side, band, n, len(BAND_EDGES_M)))
            labels, index = np.unique(side.label.astype(np.str_), return_inverse=True)
            by_label = _points_of(side, index, n, len(labels))
            classes = self._classes[name]
            for label in {*classes, *labels.tolist()}:
                own = by_label[..., labels == label].sum(axis=-1)
                classes.setdefault(label, [np.zeros((2, self._n_pairs))]).append(own)
        is_bad = alignment_is_bad(scores["alignment_rms_m"], rows.real.diagonal_m[rows.real_rows])
        has_r_lambda = ~np.isnan(scores["r_lambda"])
        self._n_aligned += int(np.count_nonzero(has_r_lambda))
        self._n_badly_aligned += int(np.count_nonzero(is_bad & has_r_lambda))
        self._n_pairs += n
        self._pieces = nlargest(N_PIECES, [*self._pieces, *_pieces_of(rows)], key=lambda piece: piece[0])

    def objects(self, rows: Sequence[Row]) -> ObjectOverview:
        """The overview of the counted objects.

        Parameters
        ----------
        rows : of `pairs`, the scored ones
        """
        bands = {side: np.concatenate(parts, axis=1) for side, parts in self._bands.items()}
        classes = {
            side: {label: np.concatenate(parts, axis=1) for label, parts in sorted(own.items())}
            for side, own in self._classes.items()
        }
        real = classes["real"]
        of_class = np.stack([*real.values()], axis=-1) if real else np.zeros((2, self._n_pairs, 0))
        of_surface = surface_causes(GroupCoverage(BAND_NAMES, *bands["real"]), GroupCoverage(tuple(real), *of_class))
        by_band = zip(BAND_NAMES, *(own.sum(axis=1).T for own in bands.values()), strict=True)
        labels = sorted({label for own in classes.values() for label in own if label})
        by_class = (
            (label, *(own.get(label, np.zeros((2, 1))).sum(axis=1) for own in classes.values())) for label in labels
        )
        return ObjectOverview(
            causes=tuple(find_causes(rows, surface=of_surface)),
            pieces=tuple(piece for _, piece in self._pieces),
            surface=tuple(
                _group(kind, *group) for kind, groups in (("range", by_band), ("class", by_class)) for group in groups
            ),
            n_aligned=self._n_aligned,
            n_badly_aligned=self._n_badly_aligned,
        )


def overview_of(key: str, objects: ObjectOverview, record: RunRecord) -> Overview:
    """The overview of a run: that of its objects, and the cautions of its record.

    Parameters
    ----------
    key : hash of all that `objects` was made from
    record : of the run, with or without an overview
    """
    of_objects = {name: getattr(objects, name) for name in ObjectOverview.model_fields}
    return Overview(key=key, **of_objects, trust=tuple(_cautions(objects, record)))


def over_floor(run: FinishedRun, floor: Path) -> Overview | None:
    """The overview of a run with the values of a floor subtracted from its causes."""
    overview = run.record.overview
    if overview is None:
        return None
    rows = {row["pair_id"]: row for row in FinishedRun(floor).scored}
    surface = [cause for cause in overview.causes if cause.name in (FAR, CLASS)]
    known = {
        "causes": tuple(find_causes(run.scored, rows, surface)),
        "trust": tuple(caution for caution in overview.trust if caution.kind != "floor"),
    }
    return overview.model_copy(update=known)


def independence(findings: Findings | None) -> list[str]:
    """Which pairs count as one, or that this is not known."""
    if findings is None:
        return []
    n_pairs, n_independent = findings.n_pairs, findings.n_independent
    if n_independent < n_pairs:
        return [f"{n_pairs} pairs count as {n_independent}: copies, and scans within {BLOCK_S:g} s, count once"]
    if n_pairs > 1 and all(scan.timestamp_s is None for scan in findings.scans.scans):
        return ["no timestamps: each pair counts as independent, which neighbouring frames of a drive are not"]
    return []


def _points_of(side: SideRows, group: NDArray[np.integer[Any]], n_pairs: int, n_groups: int) -> FloatArray:
    """Points of each pair and group, and those without a counterpart within 0.3 m, (2, n_pairs, n_groups)."""
    alone = side.n_points * (1 - np.nan_to_num(side.covered))
    place = side.pair.astype(np.int64) * n_groups + group
    counts = [np.bincount(place, own, n_pairs * n_groups) for own in (side.n_points.astype(np.float64), alone)]
    return np.stack(counts).astype(np.float64).reshape(2, n_pairs, n_groups)


def _pieces_of(rows: ObjectRows) -> Iterator[tuple[tuple[int, str, str, int], Piece]]:
    """The largest pieces of some pairs, each with its rank."""
    pieces = rows.pieces
    is_own = (pieces["side"] == "real") | (pieces["fate"] != "moved")
    order = np.lexsort((-pieces["n_points"], ~is_own))[: np.count_nonzero(is_own)]
    for i in order[:N_PIECES].tolist():
        own: dict[str, Any] = {name: column[i] for name, column in pieces.items()}
        is_moved = own["fate"] == "moved"
        fate = "moved" if is_moved else "missing" if own["side"] == "real" else "invented"
        extents = float(own["extent_x"]), float(own["extent_y"]), float(own["extent_z"])
        piece = Piece(
            pair_id=rows.pair_ids[own["pair"]],
            side=own["side"],
            piece_id=int(own["piece_id"]),
            fate=fate,
            label=own["label"],
            n_points=int(own["n_points"]),
            range_m=float(own["range_m"]),
            bearing_deg=float(own["bearing_deg"]),
            extents_m=extents,
            words=place_words(own["label"], extents, float(own["range_m"]), float(own["bearing_deg"])),
            fate_words=moved_words(*(float(own[f"moved_{axis}_m"]) for axis in "xyz")) if is_moved else fate,
        )
        yield (piece.n_points, piece.pair_id, piece.side, piece.piece_id), piece


def _group(kind: str, name: str, real: FloatArray, sim: FloatArray) -> SurfaceGroup:
    shares = [float(alone / n) if n else None for n, alone in (real, sim)]
    return SurfaceGroup(
        group=kind,
        name=name,
        n_real=int(real[0]),
        missing_share=shares[0],
        n_sim=int(sim[0]),
        invented_share=shares[1],
    )


def _cautions(objects: ObjectOverview, record: RunRecord) -> Iterator[Caution]:
    """Limits to the trust in the numbers, most important first."""
    pairs = record.pairs
    n_pairs = pairs.scored + pairs.failed + pairs.to_do
    if pairs.failed:
        yield Caution(kind="failed", words=f"{pairs.failed} of {n_pairs} pairs failed and count nowhere")
    if pairs.to_do:
        yield Caution(kind="to_do", words=f"{pairs.to_do} of {n_pairs} pairs are not evaluated yet")
    if record.frames:
        yield Caution(kind="frames", words=frames_summary(record.frames, n_pairs))
    if record.notes:
        pair_id, (note, *_) = next(iter(record.notes.items()))
        words = f"ground cut, notes on {len(record.notes)} of {n_pairs} pairs; {pair_id}: {note}"
        yield Caution(kind="ground", words=words)
    n_independent = record.findings.n_independent if record.findings else pairs.scored
    if n_independent < LEAST_PAIRS:
        few = f"{n_independent} independent pair{'s' * (n_independent != 1)}: too few for a verdict ({LEAST_PAIRS})"
        yield Caution(kind="pairs", words=few)
    for words in independence(record.findings):
        yield Caution(kind="independence", words=words)
    if objects.n_aligned and objects.n_badly_aligned >= _MANY_BADLY_ALIGNED * objects.n_aligned:
        share = f"{100 * objects.n_badly_aligned / objects.n_aligned:.0f} %"
        words = f"r_lambda of {share} of the matched objects is unreliable (poor alignment: {BAD_ALIGNMENT_WORDS})"
        yield Caution(kind="alignment", words=words)
    if record.preset != "reference":
        words = "each scan is segmented separately, so scores vary with the segmentation; to compare simulators: "
        yield Caution(kind="partition", words=f"{words}fidpipe run --preset reference")
    if path_exists(Path(record.dataset) / FLOOR_RECIPE):
        return  # it is a floor itself
    floor = shlex.join(["fidpipe", "floor", record.dataset, "--preset", record.preset])
    yield Caution(kind="floor", words=f"no floor yet; the scores of a perfect simulator: {floor}")
