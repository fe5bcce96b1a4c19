"""Any damage to a valid file ends with points or with one line of error, in bounded time and memory."""

import multiprocessing
import re
import resource
import struct
import sys
import warnings
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from fidpipe.pipeline.datasets.pairs import scans_of
from fidpipe.pipeline.datasets.readers import read_scan
from fidpipe.pipeline.datasets.readers.scan_ref import scan_ref
from fidpipe.schemas.errors import FidpipeError
from scan_files import POINTS, WRITERS, write_packets

FILES = WRITERS | {
    "pcap": ("a.pcap", lambda path, rows: write_packets(path)),
    "pcapng": ("a.pcapng", lambda path, rows: write_packets(path)),
}
MAX_SECONDS = 10
MAX_BYTES = 64 * 2**20
MAX_BYTES_PER_BYTE = 100
#: Address space beyond that of the process when it starts.
MAX_ADDRESS_SPACE = 2**30
WHOLES = [
    0,
    1,
    2,
    7,
    255,
    1000,
    65535,
    10**6,
    10**9,
    2**31 - 1,
    2**31,
    2**32 - 1,
    2**63 - 1,
    2**63,
    2**64 - 1,
]
WORDS = [
    b"0",
    b"-1",
    b"1000000000",
    b"9" * 30,
    b"1e400",
    b"nan",
    b"inf",
    b"0.5",
    b"0x10",
    b"1_0",
    b"",
    b"x",
    b"\xff",
]
NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?")
#: Bytes in which headers are.
HEAD = 512
#: Audit events that reading a file never raises.
FORBIDDEN = (
    "subprocess.",
    "os.system",
    "os.exec",
    "os.posix_spawn",
    "socket.connect",
    "socket.send",
    "pickle.find_class",
)


@st.composite
def damaged(draw, content):
    """The content with one to three changes."""
    changes = st.sampled_from([flipped, cut, without_a_part, other_number, other_word])
    for change in draw(st.lists(changes, min_size=1, max_size=3)):
        if content:
            content = change(draw, content)
    return content


def place(draw, content):
    """A position in a content, every second one in its head."""
    last = len(content) - 1
    return draw(st.integers(0, min(HEAD, last)) | st.integers(0, last))


def flipped(draw, content):
    position = place(draw, content)
    changed = bytearray(content)
    changed[position] ^= 1 << draw(st.integers(0, 7))
    return bytes(changed)


def cut(draw, content):
    return content[: place(draw, content)]


def without_a_part(draw, content):
    start = place(draw, content)
    return content[:start] + content[start + draw(st.integers(1, 100)) :]


def other_number(draw, content):
    position = place(draw, content)
    size, code = draw(st.sampled_from([(1, "B"), (2, "H"), (4, "I"), (8, "Q")]))
    number = draw(st.sampled_from(WHOLES)) % 256**size
    return content[:position] + struct.pack("<" + code, number) + content[position + size :]


def other_word(draw, content):
    numbers = list(NUMBER.finditer(content[: 4 * HEAD]))
    if not numbers:
        return content
    number = draw(st.sampled_from(numbers))
    return content[: number.start()] + draw(st.sampled_from(WORDS)) + content[number.end() :]


class Child:
    """A process that reads files under limits; it is replaced if a file ends it."""

    def __init__(self):
        self._start()

    def _start(self):
        context = multiprocessing.get_context("spawn")
        self._pipe, far_end = context.Pipe()
        self._process = context.Process(target=answer, args=(far_end,), daemon=True)
        self._process.start()
        far_end.close()
        assert self._pipe.recv() == "ready"

    def read(self, path):
        """The result for a file: "points", "error", "ended", or what is wrong."""
        self._pipe.send(path)
        try:
            if self._pipe.poll(MAX_SECONDS):
                return self._pipe.recv()
            problem = f"no answer after {MAX_SECONDS} s"
        except (EOFError, ConnectionResetError):
            problem = "ended"
        self.stop()
        self._start()
        return problem

    def stop(self):
        self._process.kill()
        self._process.join()
        self._pipe.close()


def answer(pipe):
    """Read the files whose paths arrive, and send back how that went."""
    warnings.simplefilter("ignore")
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    limit = pages * resource.getpagesize() + MAX_ADDRESS_SPACE
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    events = []
    sys.addaudithook(lambda event, _: events.append(event))
    pipe.send("ready")
    while True:
        path = pipe.recv()
        events.clear()
        result = outcome(path)
        forbidden = [event for event in events if event.startswith(FORBIDDEN)]
        pipe.send(f"events {forbidden}" if forbidden else result)


def outcome(path):
    """How reading a file ended."""
    n_bytes = sum(file.stat().st_size for file in [path, *path.rglob("*")])
    before = peak_memory()
    try:
        for scan in scans_of(path)[:1]:
            read_scan(scan)
        result = "points"
    except FidpipeError as error:
        result = "error" if len(str(error).splitlines()) == 1 else f"several lines: {error}"
    except Exception as error:
        return f"{type(error).__name__}: {error}"
    grown = peak_memory() - before
    is_bounded_by_worker = scan_ref(path).format.may_crash
    if grown > MAX_BYTES + MAX_BYTES_PER_BYTE * n_bytes and not is_bounded_by_worker:
        return f"{grown / 2**20:.0f} MiB for {n_bytes} bytes"
    return result


def peak_memory():
    """The most memory that this process has had, in bytes."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


@pytest.fixture(scope="module")
def child():
    child = Child()
    yield child
    child.stop()


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_gives_points_or_one_line_of_error(child, tmp_path_factory, name):
    file, write = FILES[name]
    path = tmp_path_factory.mktemp("valid") / file
    write(path, POINTS)
    assert child.read(path) == "points"
    valid = {part: part.read_bytes() for part in [path, *path.glob("*")] if part.is_file()}
    allowed = {"points", "error"}
    if scan_ref(path).format.may_crash:
        # runs read such files in workers with a limit, and replace a worker that ends
        allowed.add("ended")

    @settings(
        max_examples=100,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=[*HealthCheck],
    )
    @given(st.data())
    def damage(data):
        part = data.draw(st.sampled_from(list(valid)))
        part.write_bytes(data.draw(damaged(valid[part])))
        result = child.read(path)
        part.write_bytes(valid[part])
        assert result in allowed

    damage()
