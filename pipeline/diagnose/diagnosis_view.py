"""View of a diagnosis: causes with their estimates and gains, and what remains unexplained."""

from __future__ import annotations

from ...schemas.results import Diagnosis
from ..report.view import Note, Table, View, percent
from ..results.diagnosis import UNEXPLAINED, gain_words, interval_words

_COLUMNS = (*("name", "words", "estimate", "low", "high", "unit"), *("n_pairs", "gain_m", "gain", "setting"))
_NO_GAIN = ("not in the distance", "")


def diagnosis_records(found: Diagnosis) -> Table:
    """One row per cause, for programs."""
    return Table("", _COLUMNS, [[getattr(own, name) for name in _COLUMNS] for own in found.causes])


def diagnosis_view(found: Diagnosis) -> View:
    """A row per cause, most important first, and notes on the base, the intervals and the pairs left out."""
    gains = [gain_words(own).removeprefix("gain ") or _NO_GAIN[own.name == UNEXPLAINED] for own in found.causes]
    rows = [
        (i, own.words, interval_words(own), gain, own.setting)
        for i, (own, gain) in enumerate(zip(found.causes, gains, strict=True), 1)
    ]
    over = f" (floor {100 * found.floor_m:.1f} cm)" if found.floor else ""
    title = (
        f"{found.n_pairs} pair{'s' * (found.n_pairs > 1)}; the surfaces are {100 * found.distance_m:.1f} cm apart on "
        f"average{over}, distances counted up to 1 m"
    )
    least = "at least " * any(own.is_upper_bound for own in found.causes)
    places = "; no. 1 is a share of the surface" * bool(found.floor and rows and found.causes[0].name == UNEXPLAINED)
    notes = [
        f"unexplained: {least}{percent(found.unexplained)} of the distance{' over the floor' * bool(found.floor)} "
        f"remains if all causes are corrected{places}"
        if found.unexplained is not None
        else "hardly any distance over the floor: gains are in cm, not shares; causes are in the order of their size",
        f"intervals: 95 % over {found.over}" + ("" if found.floor else "; without --floor only clear causes are named"),
    ]
    if found.left_out:
        notes.append(f"left out, too little surface in common: {', '.join(found.left_out)}")
    if found.doubtful:
        notes.append(f"measured, but hardly closer if corrected: {'; '.join(found.doubtful)}")
    columns, none = ("", "cause", "95 % interval", "gain if corrected", "setting"), Note("no cause named")
    table = Table(title, columns, rows, words=(1, 2, 3, 4), whole=(4,))
    return [*([table] if rows else [Note(title, "bold"), none]), *map(Note, notes)]
