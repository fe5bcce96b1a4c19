"""Results of a run as typed values: summaries of scores, findings over all objects, the overview; see also `record`.

Contracts like the tables: the field names are the keys of the JSON, in that order. `as_dict` gives plain values for
JSON, `model_validate` reads them again.
"""

from __future__ import annotations

from pydantic import BaseModel, ConfigDict, JsonValue

#: What JSON calls an object.
JsonObject = dict[str, JsonValue]
Number = float | int | None


class Result(BaseModel):
    """A frozen value with the layout of its JSON."""

    model_config = ConfigDict(frozen=True, extra="forbid", defer_build=True)

    def as_dict(self) -> JsonObject:
        """Plain values, for JSON; fields that were never given are left out."""
        return self.model_dump(mode="json", exclude_unset=True)


class ScoreSummary(Result):
    """A score over the pairs of a dataset; null if too few pairs have it.

    mean, std : over pairs, std with n - 1
    n_pairs : pairs that have the score
    """

    mean: float | None
    std: float | None
    n_pairs: int


class ObjectGroup(Result):
    """The objects of all pairs in a range band or of a class; a matched object has the class of its real side.

    by : "range", each object by its own side, or "class"
    n_real, n_sim : objects of each side
    n_not_found, n_extra : those of them that the other side lacks
    n_real_points, n_sim_points : of these objects
    missing_share, invented_share : of these points, those without a counterpart within 0.3 m; null without points
    scores : means of cdc, r_lambda, r_gap over the matched real objects; null if none has it
    """

    by: str
    name: str
    n_real: int
    n_not_found: int
    n_sim: int
    n_extra: int
    n_real_points: int
    missing_share: float | None
    n_sim_points: int
    invented_share: float | None
    scores: dict[str, float | None]


class Findings(Result):
    """The objects of all pairs together, and the places of the pairs.

    groups : objects by range, then by class, the class with most objects first
    n_places : independent places: copies and neighbouring frames count once
    places : by scored pair, the number of its place
    """

    groups: tuple[ObjectGroup, ...]
    n_places: int
    places: dict[str, int]


class Cause(Result):
    """A flaw of the simulator with the setting that controls it; see `pipeline.results.causes`.

    kind : "sensor" for a property of the sensor or its pose, "world" for what differs from place to place
    words : the flaw with its amount and direction
    estimate, low, high : mean over pairs with its 95 % interval in `unit`
    unit : "m", "deg", "share" or "" for a number
    real, sim : means of the values of both sides; null if the cause has none
    share : share of the surface that it affects, 0 to 1
    gain_m : metres by which the surface distance becomes smaller if it is corrected; null if that was not measured
    gain : the same as a share of the distance beyond that of a perfect second measurement; null if there is hardly any
    is_upper_bound : real returns were restored, so that the gain is at most this
    limbs : identifiers of PerCollECT's LidarLimbs cause tree
    """

    name: str
    kind: str
    words: str
    setting: str
    estimate: float
    low: float
    high: float
    unit: str
    n_pairs: int
    real: float | None
    sim: float | None
    share: float
    gain_m: float | None = None
    gain: float | None = None
    is_upper_bound: bool = False
    limbs: tuple[int, ...] = ()


class ChangedCause(Cause):
    """A cause that changed from one run to another by `estimate`.

    before, after : mean amounts of both runs, simulated minus real; null if unknown
    verdict : "worse" or "better" for a cause of the sensor or its pose, "changed" if neither is established; "" for one
        of the world, about which the families decide
    """

    before: float | None
    after: float | None
    verdict: str


class Piece(Result):
    """One of the largest missing, invented or moved pieces of surface, a row of table `pieces`.

    side, piece_id : its number on that side; "real" for a missing or moved piece, "sim" for an invented one
    fate : "missing", "invented" or "moved"
    words : class or size, extents and place
    fate_words : fate, with distance and direction of a moved piece
    """

    pair_id: str
    side: str
    piece_id: int
    fate: str
    n_points: int
    words: str
    fate_words: str


class Caution(Result):
    """A limit to the trust in the numbers.

    kind : to_do, frames, ground, pairs, independence, partition, or alignment
    words : one sentence
    """

    kind: str
    words: str


class Unknown(Result):
    """Causes that cannot be estimated in most pairs, and the reason."""

    causes: tuple[str, ...]
    reason: str


class Overview(Result):
    """The first answer of a run, from the objects and pieces of all scored pairs; see `pipeline.results.overview`.

    causes : what to fix first, most severe first
    unknown : causes that cannot be estimated
    small : displacements that explain too little of the distance to be named, as sentences
    doubts : why points of the scans cannot be trusted, one line for each side and kind
    pieces : the largest pieces
    n_aligned, n_badly_aligned : objects with an r_lambda, and those whose alignment is too bad for it
    trust : limits to the trust in the numbers, most important first
    """

    causes: tuple[Cause, ...]
    unknown: tuple[Unknown, ...]
    pieces: tuple[Piece, ...]
    n_aligned: int
    n_badly_aligned: int
    trust: tuple[Caution, ...] = ()
    doubts: tuple[str, ...] = ()
    small: tuple[str, ...] = ()


class Diagnosis(Result):
    """Causes of the difference between both sides, with the gain of correcting each.

    n_pairs : diagnosed pairs
    distance_m, best_case_m : mean distance of both sides' surfaces, counted up to 1 m, and that of a perfect second
        measurement of the real scans
    unexplained : share of the distance over `best_case_m` that no correction explains; null if there is hardly any
    causes : those with the largest gain first
    doubtful : seen, but fixing them would not help
    unknown : causes that cannot be estimated
    notes : on causes that can have several reasons
    """

    n_pairs: int
    distance_m: float
    best_case_m: float
    unexplained: float | None
    causes: tuple[Cause, ...]
    doubtful: tuple[str, ...] = ()
    unknown: tuple[Unknown, ...] = ()
    notes: tuple[str, ...] = ()
