"""Looks at all files of a dataset before anything heavy starts: each is read once, and known from then on.

Leaves to others: what one file holds and what is wrong with it (`intake`), what is said of it (`session`).
"""

from __future__ import annotations

from collections.abc import Iterable

from ...schemas.columns import SIDES
from ...schemas.settings import InputSettings
from ..datasets.pairs import ScanPair
from ..datasets.scan_checks import ScanContent, ScanFacts, input_name, inspect_pairs, pair_warnings, recall_scan
from ..storage.store import Store
from .pool import Pool

_MOST_PAIRS_A_TASK = 32
_LEAST_TASKS = 8


class Inspection:
    """What the files of some pairs hold.

    contents : by pair_id and side, of the pairs whose files can all be read
    faults : why a pair cannot be used, by pair_id
    warnings : what is odd about a pair's files, by pair_id
    unknown : pairs whose files must be read
    """

    def __init__(
        self, pairs: Iterable[ScanPair], settings: InputSettings, label_names: dict[int, str], store: Store
    ) -> None:
        self._settings, self._label_names, self._store = settings, label_names, store
        self.contents: dict[str, dict[str, ScanContent]] = {}
        self.faults: dict[str, str] = {}
        self.warnings: dict[str, list[str]] = {}
        self.unknown = [pair for pair in pairs if not self._recall(pair)]

    def read(self, pool: Pool, *, note: bool) -> None:
        """Reads the unknown files; with `note` the run remembers what was learnt."""
        n = max(1, min(_MOST_PAIRS_A_TASK, len(self.unknown) // _LEAST_TASKS))
        parts = [self.unknown[i : i + n] for i in range(0, len(self.unknown), n)]
        handles = {pool.submit(inspect_pairs, part, self._settings, self._label_names): part for part in parts}
        while handles:
            handle, found = pool.next_done()
            for pair, facts in zip(handles.pop(handle), found, strict=True):
                for side, of in facts.items() if note else ():
                    self._store.note_input(input_name(pair, side), of.as_dict())
                self._judge(pair, facts)

    def _recall(self, pair: ScanPair) -> bool:
        """Whether what a pair's files hold is known from the last run and still so."""
        facts = {}
        for side in SIDES:
            if pair.path(side) is None:
                continue
            known = recall_scan(self._store.inputs, pair, side, self._settings)
            if known is None:
                return False
            facts[side] = known
        self._judge(pair, facts)
        return True

    def _judge(self, pair: ScanPair, facts: dict[str, ScanFacts]) -> None:
        """Keeps what is needed of a pair's files, and what is to be said of them if anything is."""
        faults = [of.fault for of in facts.values() if of.fault]
        if not faults:
            self.contents[pair.pair_id] = {side: of.content for side, of in facts.items()}
        if fault := pair.fault or "; ".join(faults):
            self.faults[pair.pair_id] = fault
        if warnings := pair_warnings(pair, facts):
            self.warnings[pair.pair_id] = warnings
