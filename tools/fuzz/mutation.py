"""One hostile input from a whole one: bits, lengths, numbers in text, lines and pieces are changed or cut."""

import re
import struct

_WIDTHS = {1: "B", 2: "H", 4: "I", 8: "Q"}
_WHOLES = (0, 1, 2, 3, 7, 8, 16, 127, 128, 255, 256, 1000, 4096, 32767, 32768, 65535, 65536, 10**6, 10**9, 2**31 - 1)
_WHOLES += (2**31, 2**32 - 1, 2**32, 10**12, 2**53, 2**63 - 1, 2**63, 2**64 - 1)
_NUMBERS = (
    "0",
    "-1",
    "1",
    "2",
    "3",
    "255",
    "65536",
    "1000000000",
    "2147483648",
    "99999999999999999999",
    "1e400",
    "nan",
)
_NUMBERS += ("inf", "-0", "0.5", "1e-300", "0x10", "1_0", "", "+", "٣", "1.5.5", "9" * 400)
_WORDS = (
    b"\x00",
    b"\xff\xfe",
    b"../",
    b"..",
    b"/etc/passwd",
    b"#",
    b"@",
    b"\n",
    b"\r",
    b"\t",
    b",",
    b'"',
    b"'",
    b"{",
    b"}",
)
_WORDS += (
    b"[" * 60,
    b"\x1b[31m",
    b"\xe2\x80\xae",
    b"x" * 300,
    b"=1+1",
    b"%n",
    b"<script>",
    b"\\",
    b":",
    b" ",
    b"&a",
    b"*a",
)
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")


def mutated(rng, content, others, words=()):
    """The content with one to four changes.

    Parameters
    ----------
    rng : random.Random
    others : whole contents of the same kind, from which pieces are taken
    words : of the format, put in anywhere
    """
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 4))):
        content = rng.choice(_CHANGES)(rng, content, others, words)
    return content


def _bits(rng, content, others, words):
    changed = bytearray(content)
    for _ in range(rng.choice((1, 1, 2, 8)) if content else 0):
        changed[rng.randrange(len(changed))] ^= 1 << rng.randrange(8)
    return bytes(changed)


def _byte(rng, content, others, words):
    place = rng.randrange(len(content) + 1)
    return (
        content[:place] + bytes([rng.choice((0, 1, 10, 32, 127, 128, 255, rng.randrange(256)))]) + content[place + 1 :]
    )


def _length_field(rng, content, others, words):
    """A whole number in the place of another, most often near the beginning or the end, where lengths stand."""
    width = rng.choice((1, 2, 4, 4, 8))
    span = max(len(content) - width, 0)
    place = rng.choice((rng.randint(0, span), rng.randint(0, min(span, 128)), span - rng.randint(0, min(span, 128))))
    old = int.from_bytes(content[place : place + width], "little")
    value = rng.choice((rng.choice(_WHOLES), old + rng.choice((-8, -1, 1, 8)), old * 2, len(content)))
    packed = struct.pack(rng.choice("<>") + _WIDTHS[width], value % 256**width)
    return content[:place] + packed + content[place + width :]


def _number(rng, content, others, words):
    """A number in text in the place of another."""
    found = list(_NUMBER.finditer(content[:20_000]))
    if not found:
        return _length_field(rng, content, others, words)
    one = rng.choice(found)
    return content[: one.start()] + rng.choice(_NUMBERS).encode() + content[one.end() :]


def _word(rng, content, others, words):
    start = rng.randint(0, len(content))
    stop = min(len(content), start + rng.choice((0, 0, 1, 4, 16)))
    return content[:start] + rng.choice((*words, *_WORDS)) + content[stop:]


def _cut(rng, content, others, words):
    return content[: rng.randint(0, len(content))]


def _taken_out(rng, content, others, words):
    start = rng.randint(0, len(content))
    return content[:start] + content[start + rng.choice((1, 2, 4, 8, 64, 512)) :]


def _repeated(rng, content, others, words):
    start = rng.randint(0, len(content))
    piece = content[start : start + rng.choice((1, 4, 16, 128))]
    return content[:start] + piece * rng.choice((2, 2, 3, 20)) + content[start:]


def _piece_of_another(rng, content, others, words):
    other = rng.choice(others)
    start, begin = rng.randint(0, len(content)), rng.randint(0, len(other))
    piece = other[begin : begin + rng.choice((1, 4, 16, 64, 512, 4096))]
    return content[:start] + piece + content[start + rng.choice((0, len(piece))) :]


def _lines(rng, content, others, words):
    """A line twice, gone, or in the place of another."""
    lines = content.split(b"\n")
    i, k = rng.randrange(len(lines)), rng.randrange(len(lines))
    kind = rng.randrange(3)
    if kind == 0:
        lines[i] = lines[k]
    elif kind == 1:
        del lines[i]
    else:
        lines.insert(i, lines[k])
    return b"\n".join(lines)


_CHANGES = (_bits, _bits, _byte, _length_field, _length_field, _length_field, _number, _number, _word, _cut, _taken_out)
_CHANGES += (_repeated, _piece_of_another, _lines)
