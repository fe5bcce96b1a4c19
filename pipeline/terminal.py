"""The console of all commands: no character of a name or message steers the terminal."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

#: Characters that steer the text around them (controls, direction marks), as JavaScript reads it.
STEERING = r"[\u0000-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]"
#: These without the end of a line; and lone surrogates, which no terminal can be sent.
_BUT_NEWLINES = r"\u0000-\u0009\u000b-\u001f\ud800-\udfff"
_UNPRINTED = re.compile(STEERING.replace(r"\u0000-\u001f", _BUT_NEWLINES))


def shown(text: object) -> str:
    r"""A text with its steering characters shown by their numbers.

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

    def render(
        self,
        renderable: RenderableType,
        options: ConsoleOptions | None = None,
    ) -> Iterable[Segment]:
        """The segments of a view."""
        for segment in super().render(renderable, options):
            if not segment.control and _UNPRINTED.search(segment.text):
                text = _UNPRINTED.sub(_number, segment.text)
                segment = Segment(text, segment.style)  # noqa: PLW2901
            yield segment


def _number(character: re.Match[str]) -> str:
    return f"\\u{ord(character[0]):04x}"
