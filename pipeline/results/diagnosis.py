"""The stored diagnosis of a run: what `fidpipe diagnose` found, as long as it is of the same results."""

from __future__ import annotations

import json
from hashlib import sha256
from pathlib import Path

import orjson

from ...schemas.record import RunRecord
from ...schemas.results import Cause, Caution, DiagnosedCause, Diagnosis, Overview
from .causes import CLASS, FAR, size_words

DIAGNOSIS = "diagnosis.json"
UNEXPLAINED = "unexplained"
BASE = "base"  #: kind of the caution that the causes are over another run than a floor


def results_identity(record: RunRecord) -> str:
    """Identity of the results of a run: of its inputs, settings and stages."""
    parts = [record.inputs, record.settings, record.stages]
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()[:16]


def read_diagnosis(folder: Path, record: RunRecord) -> Diagnosis | None:
    """The diagnosis in a run's folder; None without one, or if it is of other results or of another version."""
    try:
        found = Diagnosis.from_dict(orjson.loads((folder / DIAGNOSIS).read_bytes()))
    except (OSError, ValueError):
        return None
    return found if found.of == results_identity(record) else None


def diagnosed(folder: Path, record: RunRecord, overview: Overview | None) -> Overview | None:
    """An overview with the causes of the run's diagnosis, if it has one; then surface missing by range and class.

    Without a floor the unexplained part comes after the causes that can be fixed: any two measurements differ.
    """
    from .floor import read_recipe  # which imports finished runs

    found = read_diagnosis(folder, record)
    if overview is None or found is None:
        return overview
    surface = [cause for cause in overview.causes if cause.name in (FAR, CLASS)]
    causes = sorted(found.causes, key=lambda own: own.name == UNEXPLAINED and found.floor is None)
    trust = [own for own in overview.trust if own.kind != "floor" or found.floor is None]
    if found.floor and read_recipe(Path(found.floor)) is None:
        words = f"diagnosed causes are changes against {found.floor}, the others against the real scans"
        trust.insert(0, Caution(kind=BASE, words=words))
    return overview.model_copy(update={"causes": (*map(_cause, causes), *surface), "trust": tuple(trust)})


def gain_words(cause: DiagnosedCause) -> str:
    """Gain of correcting a cause, as text.

    Examples
    --------
    >>> base = dict(name="height", words="", estimate=0.1, low=0, high=0.2, unit="m", n_pairs=3, setting="", limbs=())
    >>> gain_words(DiagnosedCause(**base, gain_m=0.02, gain=0.41, is_upper_bound=True))
    'gain at most 41 %'
    """
    if cause.gain_m is None:
        return ""
    least = "at most " if cause.is_upper_bound else ""
    if cause.gain_m <= 0:
        return "no gain alone"
    return f"gain {least}{100 * cause.gain_m:.1f} cm" if cause.gain is None else f"gain {least}{100 * cause.gain:.0f} %"


def interval_words(cause: DiagnosedCause) -> str:
    """The 95 % interval of the size of a cause, as text; a minus is the opposite of its sentence."""
    sign = -1 if cause.estimate < 0 else 1
    ends = sorted((sign * cause.low, sign * cause.high))
    low, high = (f"{'-' * (value < 0)}{size_words(value, cause.unit)}" for value in ends)
    return f"{low} to {high}"


def _cause(found: DiagnosedCause) -> Cause:
    shared = DiagnosedCause.model_fields.keys() & Cause.model_fields
    return Cause(
        **found.model_dump(include=shared),
        detail=gain_words(found),
        real=0.0,
        sim=found.estimate,
        severity=max(found.gain or 0.0, 0.0),
    )
