"""How names of pairs and classes are shown on pages, whatever signs they hold."""

from __future__ import annotations

import re
from html import escape

#: Signs that steer the text around them (controls, direction marks); as JavaScript also reads it.
STEERING = r"[\u0000-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2060-\u2069\ufeff]"


def shown(text: object) -> str:
    r"""A text with its steering signs shown by their numbers.

    Examples
    --------
    >>> shown("a\u202eb")
    'a\\u202eb'
    """
    return re.sub(STEERING, lambda sign: f"\\u{ord(sign[0]):04x}", str(text))


def shortened(text: str, most: int = 22) -> str:
    """A text of at most `most` signs, the last one an ellipsis where something is left out."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def in_chart(name: str, most: int = 22) -> str:
    """A name for a text of plotly, which reads a little markup: shown, shortened, and without meaning as markup."""
    return escape(shortened(shown(name), most), quote=False)
