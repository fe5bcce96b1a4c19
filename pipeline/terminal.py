"""The console of all commands: no sign in a name, a label or a message of others steers the terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

#: Signs that steer the text around them (controls, direction marks); as JavaScript also reads it.
STEERING = r"[\u0000-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]"
#: The same but for the end of a line; and halves of signs, which no terminal can be sent.
_UNPRINTED = re.compile(STEERING.replace(r"\u0000-\u001f", r"\u0000-\u0009\u000b-\u001f\ud800-\udfff"))


def shown(text: object) -> str:
    r"""A text with its steering signs shown by their numbers.

    Examples
    --------
    >>> shown("a\u202eb")
    'a\\u202eb'
    """
    return re.sub(STEERING, _number, str(text))


class Terminal(Console):
    """A console that shows control characters in texts as escapes; its own colours stay."""

    def __init__(self, **options: Any) -> None:
        super().__init__(highlight=False, **options)

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments of a view."""
        for segment in super().render(renderable, options):
            is_plain = segment.control or not _UNPRINTED.search(segment.text)
            yield segment if is_plain else Segment(_UNPRINTED.sub(_number, segment.text), segment.style)


def _number(sign: re.Match[str]) -> str:
    return f"\\u{ord(sign[0]):04x}"
