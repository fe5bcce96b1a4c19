"""Meanings of parameters and fields, as docstrings give them: `name : meaning`, further lines indented."""

from __future__ import annotations

import re
from inspect import cleandoc

_HEADING = re.compile(r"^Parameters\n-+\n", re.MULTILINE)
_MEANING = re.compile(r"^(\w+) : (.+\n(?: {4}.+\n)*)", re.MULTILINE)


def split_docstring(docstring: str) -> tuple[str, dict[str, str]]:
    r"""The text of a docstring without the meanings, and these by name.

    Examples
    --------
    >>> split_docstring("Edges between points.\n\n    k : number of nearest\n        neighbours")
    ('Edges between points.', {'k': 'number of nearest neighbours'})
    """
    text = f"{cleandoc(docstring)}\n"
    meanings = {name: " ".join(meaning.split()) for name, meaning in _MEANING.findall(text)}
    text = _HEADING.sub("", _MEANING.sub("", text))
    return re.sub(r"\n{3,}", "\n\n", text).strip(), meanings
