"""What would be read from a dataset, and what is wrong with it; computes nothing.

Leaves to others: reading (`readers`), judging one file (`intake`), showing it (`report.terminal`).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ...schemas.settings import Settings
from .pairs import ScanPair, read_dataset
from .scan_checks import ScanFacts, inspect_pairs, pair_warnings


@dataclass(frozen=True)
class DatasetCheck:
    """What was found.

    pairs : each with the facts of its sides; a missing file has none
    faults, warnings : by pair, each a line
    """

    folder: Path
    pairs: list[tuple[ScanPair, dict[str, ScanFacts]]]
    faults: list[str]
    warnings: list[str]


def check_dataset(folder: Path, settings: Settings) -> DatasetCheck:
    """Reads every file of a dataset once and names every fault.

    Raises
    ------
    DatasetError
        The dataset as a whole cannot be used.
    """
    dataset = read_dataset(folder)
    pairs, faults, warnings = [], [], list(dataset.warnings)
    for pair in dataset.pairs:
        facts = inspect_pairs([pair], settings.input, dataset.label_names)[0]
        pairs.append((pair, facts))
        found = [pair.fault] if pair.fault else []
        found += [of.fault for of in facts.values() if of.fault]
        faults += [f"pair {pair.pair_id}: {fault}" for fault in found]
        warnings += [f"pair {pair.pair_id}: {text}" for text in pair_warnings(pair, facts)]
    return DatasetCheck(folder, pairs, faults, warnings)
