"""What one process of a campaign does: it makes hostile inputs by number, reads each, and says what went wrong.

Called as `python tools/fuzz/attack.py PLACE READER START STOP`. Each line on standard output is a finding as JSON,
or the sums at the end. The number of the input at work stands in the file PLACE/number, for whoever watches.
"""

import contextlib
import json
import mmap
import os
import random
import resource
import shutil
import signal
import struct
import sys
import tempfile
import traceback
import warnings
from itertools import count
from pathlib import Path
from time import process_time

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(Path(__file__).parent), str(ROOT / "tests")]

from mutation import mutated
from targets import TARGETS

#: An input may take so many seconds of the processor, so much memory, and so much again for each byte it is long.
MOST_SECONDS = 2.0
MOST_BYTES = 64 * 2**20
MOST_BYTES_A_BYTE = 100
#: Address space beyond what the process has when it begins: what is asked for above that is refused by the system.
MOST_ADDRESSES = 2**30

_NEVER = (
    "subprocess.",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "os.fork",
    "socket.",
    "pickle.find_class",
    "ctypes.dlopen",
)
_CHANGES = (
    "os.remove",
    "os.rename",
    "os.rmdir",
    "os.mkdir",
    "os.link",
    "os.symlink",
    "os.truncate",
    "os.chmod",
    "shutil.",
)


class Watch:
    """Sees through Python's audit hook which files are opened and changed, and what must never happen."""

    def __init__(self):
        self.folder, self.seen = None, []
        known = (
            sys.prefix,
            sys.base_prefix,
            "/usr",
            "/etc/localtime",
            "/proc",
            "/sys",
            "/dev",
            ROOT,
        )
        self._known = tuple(map(str, known))
        sys.addaudithook(self._hook)

    def _hook(self, event, values):
        if self.folder is None:
            return
        if event.startswith(_NEVER):
            self.seen.append(f"{event} {values[:2]!r}")
        elif event == "open" and isinstance(values[0], str | bytes):
            name, writes = os.fsdecode(values[0]), bool((values[2] or 0) & (os.O_WRONLY | os.O_RDWR))
            if self._is_outside(name) and (writes or not name.startswith(self._known)):
                self.seen.append(f"opened {name}{' to write' if writes else ''}")
        elif event.startswith(_CHANGES) and values and isinstance(values[0], str | bytes):
            self.seen += [f"{event} {values[0]!r}"] * self._is_outside(os.fsdecode(values[0]))

    def _is_outside(self, name):
        if name == "<string>":  # Python from 3.13 on looks there for the text of a SyntaxError
            return False
        return not os.path.normpath(Path.cwd() / name).startswith(self.folder)

    @contextlib.contextmanager
    def over(self, folder):
        self.seen, self.folder = [], str(folder)
        try:
            yield self.seen
        finally:
            self.folder = None


def make_input(target, seeds, name, number):
    """The files of an input; every whole input comes first as it is."""
    rng = random.Random(f"{name} {number}")
    files = dict(seeds[number] if number < len(seeds) else rng.choice(seeds))
    if number >= len(seeds):
        hot = rng.choice([file for file in files if file.startswith(target.hot)])
        others = [content for seed in seeds for file, content in seed.items() if file.startswith(target.hot)]
        files[hot] = mutated(rng, files[hot], others, target.words)
    return files


def write_input(folder, files):
    for file, content in files.items():
        path = folder / file
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)


def fault_of(error):
    """What is wrong with how a reader refused an input, in words; "" where it did as it should."""
    from fidpipe.schemas.errors import FidpipeError, ScanError

    if not isinstance(error, FidpipeError):
        return f"{type(error).__name__} escaped"
    if "\n" in str(error).strip() or len(str(error)) > 3000:
        return "a message of many lines"
    cause = error
    while cause is not None:
        is_caught_last = isinstance(error, ScanError) and ": cannot be read (" in str(error)
        if is_caught_last and not isinstance(cause, FidpipeError | OSError | MemoryError):
            return f"{type(cause).__name__} that nobody had expected"
        cause = cause.__cause__ or cause.__context__
    return ""


class Judge:
    """Reads inputs of a target, one after the other, and says of each what was wrong with how that went.

    Parameters
    ----------
    scratch : the folder that inputs are in; nothing is to be opened elsewhere
    """

    def __init__(self, target, seeds, scratch):
        self._target, self._watch, self._scratch = target, Watch(), scratch
        self.sums = {"inputs": 0, "read": 0, "refused": 0, "slowest_s": 0.0, "slowest": -1}
        for seed in seeds:  # loads what is loaded at first use, before anything is measured
            folder = scratch / "whole"
            write_input(folder, seed)
            with contextlib.suppress(Exception):
                target.read(folder)
            shutil.rmtree(folder)
        own = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (own + MOST_ADDRESSES, own + MOST_ADDRESSES))
        self._base = self._peak = 0

    def __call__(self, folder, n_bytes, number):
        """What is wrong, in words, "" for nothing; and where it happened."""
        fault = trace = ""
        peak, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, process_time()
        with self._watch.over(self._scratch) as seen:
            try:
                self._target.read(folder)
                self.sums["read"] += 1
            except Exception as error:
                fault, self.sums["refused"] = fault_of(error), self.sums["refused"] + 1
                trace = "".join(traceback.format_exception(error))[-3000:] if fault else ""
        seconds = process_time() - began
        self.sums["inputs"] += 1
        if seconds > self.sums["slowest_s"]:
            self.sums["slowest_s"], self.sums["slowest"] = seconds, number
        self._base, self._peak = self._base or peak, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        if (
            not self._target.in_worker
            and (grown := (self._peak - peak) * 1024) > MOST_BYTES + MOST_BYTES_A_BYTE * n_bytes
        ):
            fault = fault or f"{grown / 2**20:.0f} MiB of memory for {n_bytes} bytes"
        if seconds > MOST_SECONDS:
            fault = fault or f"{seconds:.1f} s"
        for event in seen:
            fault = fault or event.replace(str(folder), "INPUT")
        return fault, trace

    @property
    def grown_mib(self):
        """By how much memory has grown since the first input."""
        return (self._peak - self._base) / 1024


def attack(place, name, start, stop):
    """Reads inputs by number; prints findings, and at the end the sums."""
    target = TARGETS[name]
    seeds = target.inputs()
    scratch = place / "scratch"
    tempfile.tempdir = str(scratch)
    number_file = (place / "number").open("w+b")
    number_file.write(bytes(8))
    number_file.flush()
    at_work = mmap.mmap(number_file.fileno(), 8)
    scratch.mkdir(exist_ok=True)
    warnings.simplefilter("ignore")
    judge = Judge(target, seeds, scratch)
    ended = []  # whoever ends the process is told how far it came
    signal.signal(signal.SIGTERM, lambda *_: ended.append(True))
    for number in count(start):
        if number >= stop or ended:
            break
        files = make_input(target, seeds, name, number)
        folder = scratch / f"input{number}"
        write_input(folder, files)
        at_work[:] = struct.pack("<Q", number + 1)
        fault, trace = judge(folder, sum(map(len, files.values())), number)
        if fault:
            print(json.dumps({"reader": name, "number": number, "fault": fault, "trace": trace}), flush=True)
        shutil.rmtree(folder)
    print(json.dumps(judge.sums | {"grown_mib": judge.grown_mib}), flush=True)


if __name__ == "__main__":
    attack(Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4]))
