"""Reading the files of pairs where a reader may crash, never end, or fill the memory: then its pair fails alone."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

from ...schemas.settings import InputSettings
from ..datasets.pairs import ScanPair
from ..datasets.readers import may_crash
from ..inspect.scan_checks import PairFacts, inspect_pairs
from .pool import Handle, Pool, WorkerDied
from .time_limit import Clock, OutOfTimeError, TimeLimit

_FEW_PAIRS = 16  # whose files are read in this process
_MOST_PAIRS_PER_BATCH = 32
_LEAST_BATCHES = 8
_BATCHES_PER_WORKER = 4
_DEATHS_ALONE = 2  # one may be anybody's fault
_DIED = (
    "the worker process died while it read the files, and again when it did so alone (a crash of the reader, or out of "
    "memory?)"
)


def wants_workers(pairs: Sequence[ScanPair]) -> bool:
    """True if workers read the files: there are many, or a reader may crash."""
    paths = [path for pair in pairs for path in (pair.real, pair.sim) if path is not None]
    return len(pairs) > _FEW_PAIRS or any(map(may_crash, paths))


def read_files(
    pool: Pool,
    pairs: Sequence[ScanPair],
    settings: InputSettings,
    label_names: dict[int, str],
    limits: Mapping[str, TimeLimit],
) -> Iterator[tuple[ScanPair, PairFacts | str]]:
    """What the files of pairs hold, in any order, or in words why that cannot be told.

    Parameters
    ----------
    pool : where they are read; pairs at which a worker dies are read again apart from each other, and where one dies
        again, with nothing beside them
    limits : by pair_id, how long reading may take; {} for as long as it takes
    """

    def read(parts: Iterable[Sequence[ScanPair]]) -> Iterator[tuple[Sequence[ScanPair], Any]]:
        waiting, handles = iter(parts), dict[Handle, Sequence[ScanPair]]()
        while True:
            for part in islice(waiting, max(0, _BATCHES_PER_WORKER * pool.n_workers - len(handles))):
                own = {pair.pair_id: limits[pair.pair_id] for pair in part if pair.pair_id in limits}
                handles[pool.submit(inspect_batch, part, settings, label_names, own)] = part
            if not handles:
                return
            handle, outcome = pool.next_done()
            yield handles.pop(handle), outcome

    left: Sequence[ScanPair] = pairs
    for n in dict.fromkeys((max(1, min(_MOST_PAIRS_PER_BATCH, len(pairs) // _LEAST_BATCHES)), 1)):
        lost: list[ScanPair] = []
        for part, outcome in read([left[i : i + n] for i in range(0, len(left), n)]):
            if isinstance(outcome, WorkerDied):
                lost.extend(part)
            else:
                yield from zip(part, outcome, strict=True)
        left = lost
    for pair in left:
        n_deaths = 0
        while n_deaths < _DEATHS_ALONE:
            [(_, outcome)] = read([[pair]])
            if not isinstance(outcome, WorkerDied):
                yield pair, outcome[0]
                break
            n_deaths += outcome.n_deaths
        else:
            yield pair, _DIED


def inspect_batch(
    pairs: Sequence[ScanPair], settings: InputSettings, label_names: dict[int, str], limits: Mapping[str, TimeLimit]
) -> list[PairFacts | str]:
    """What the files of each pair hold, or why its time was over; a worker that is out of time ends."""
    facts: list[PairFacts | str] = []
    for pair in pairs:
        try:
            with Clock(limits.get(pair.pair_id)) as clock:
                clock.begin("reading its files")
                facts += inspect_pairs([pair], settings, label_names)
        except OutOfTimeError as error:
            facts.append(str(error))
    return facts
