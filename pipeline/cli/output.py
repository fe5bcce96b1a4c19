"""Standard output of the commands: views for people, JSON for programs."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import typer

from ..terminal import shown
from .options import EXIT_PAIRS_FAILED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pydantic import JsonValue

    from ...schemas.results import JsonObject
    from ..report.view import View


def print_view(view: View) -> None:
    """Print a view: as wide as the terminal, unwrapped into a file or a pipe."""
    from ..report.render import terminal
    from ..terminal import Terminal

    Terminal(soft_wrap=not sys.stdout.isatty()).print(terminal(view))


def print_outcome(result: View | JsonObject, failures: Mapping[str, str]) -> None:
    """Print the result of a command and raise `typer.Exit`, with its own code if pairs failed.

    Parameters
    ----------
    result : a view, or plain values, which are printed as JSON
    """
    print_json(result) if isinstance(result, dict) else print_view(result)
    raise typer.Exit(EXIT_PAIRS_FAILED if failures else 0)


def print_line(text: str) -> None:
    """Print a line; control characters in names are escaped."""
    print(shown(text))


def print_text(text: str) -> None:
    """Print a text in UTF-8, regardless of the terminal's language."""
    sys.stdout.flush()
    sys.stdout.buffer.write(text.encode())


def print_json(values: JsonValue) -> None:
    """Print plain values as strict JSON in ASCII."""
    sys.stdout.write(json.dumps(values, indent=1, allow_nan=False) + "\n")
