"""Docstrings of the Python API in reStructuredText: sections in bold, `name : meaning` as definition lists."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_ITEM = re.compile(r"([\w*]+(?:, [\w*]+)*) : (.+)")


def to_rst(lines: list[str]) -> list[str]:
    """The lines of a docstring as Sphinx reads them.

    Examples
    --------
    >>> to_rst(["Raises", "------", "RunError", "    No.", "", "real, sim : points,", "    metres"])
    ['**Raises**', '', 'RunError', '    No.', '', '``real``, ``sim``', '    points,', '    metres']
    """
    found: list[str] = []
    for line, following in zip(lines, [*lines[1:], ""], strict=True):
        item = _ITEM.fullmatch(line)
        if re.fullmatch("-{3,}", line):
            found.append("")
        elif re.fullmatch("-{3,}", following):
            found.append(f"**{line}**")
        elif item:
            found += [
                ", ".join(f"``{name}``" for name in item[1].split(", ")),
                f"    {item[2]}",
            ]
        else:
            found.append(line)
    return found


def _rewrite(
    app: Sphinx, what: str, name: str, found: object, options: object, lines: list[str]
) -> None:
    lines[:] = to_rst(lines)


def setup(app: Sphinx) -> dict[str, Any]:
    """Rewrites each docstring that autodoc finds."""
    app.connect("autodoc-process-docstring", _rewrite)
    return {"parallel_read_safe": True}
