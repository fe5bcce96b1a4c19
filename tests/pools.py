"""Pools that run in this process what they are given, remember it, and lose workers where a test wants it."""

from fidpipe.pipeline.engine.pool import Memory, Pool, WorkerDied

GIB = 2**30


class WatchedPool(Pool):
    """As if `n_workers` shared a memory.

    submitted : the functions that it was given, by name
    batches : of those that make jobs, the jobs: pair_id, stage, part
    at_once : after each submission, how many tasks are there and what as many as there are workers may need, in bytes
    """

    n_workers = 2

    def __init__(self, n_workers=2, memory=8 * GIB):
        super().__init__()
        self.n_workers = n_workers
        self._given = Memory(memory, memory)
        self._needs = {}
        self.submitted = []
        self.batches = []
        self.at_once = []

    @property
    def memory(self):
        return self._given

    def submit(self, function, *args, **options):
        self.submitted.append(name_of(function, args))
        if jobs := jobs_in(function, args):
            self.batches.append(jobs)
        handle = super().submit(function, *args, **options)
        self._needs[handle] = bytes_needed(function, args)
        self.at_once.append(
            (len(self._needs), sum(sorted(self._needs.values())[-self.n_workers :]))
        )
        return handle

    def next_done(self):
        handle, outcome = super().next_done()
        del self._needs[handle]
        return handle, outcome


class DyingPool(WatchedPool):
    """A worker dies, at most `n_deaths` times, of a task that `is_fatal` says so of: after the work, before the report.

    is_fatal : called with the jobs of a task and the name of its function
    """

    def __init__(self, is_fatal, n_deaths=10**6, **options):
        super().__init__(**options)
        self._is_fatal, self._left = is_fatal, n_deaths
        self.n_deaths = 0
        self._doomed = set()

    def submit(self, function, *args, **options):
        handle = super().submit(function, *args, **options)
        if self.n_deaths < self._left and self._is_fatal(
            jobs_in(function, args), name_of(function, args)
        ):
            self.n_deaths += 1
            self._doomed.add(handle)
        return handle

    def next_done(self):
        handle, outcome = super().next_done()
        return handle, WorkerDied("killed by a test") if handle in self._doomed else outcome


def name_of(function, args):
    """Name of the function of a task; "score_objects" and "gather_objects" for rows of objects, scored or written."""
    if function.__name__ == "run_batch":
        batch = args[0][0]
        if batch.objects:
            return "score_objects"
        if batch.rows:
            return "gather_objects"
    return function.__name__


def jobs_in(function, args):
    """The jobs that a task makes as a whole."""
    if name_of(function, args) != "run_batch":
        return ()
    return tuple((batch.plan.pair_id, *name) for batch in args[0] for name in batch.jobs)


def bytes_needed(function, args):
    """Bytes that a task may occupy, by the cost model."""
    if function.__name__ != "run_batch":
        return 0
    return max(batch.most_bytes for batch in args[0])
