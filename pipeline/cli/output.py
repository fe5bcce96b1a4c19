"""Standard output of the commands: views for people, JSON for programs."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import typer

from ..terminal import shown
from .options import EXIT_PAIRS_FAILED

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from pydantic import JsonValue

    from ...schemas.results import JsonObject
    from ..report.view import Table, View


def print_view(view: View) -> None:
    """Print a view: as wide as the terminal, unwrapped into a file or a pipe."""
    from ..report.render import terminal
    from ..terminal import Terminal

    Terminal(soft_wrap=not sys.stdout.isatty()).print(terminal(view))


def print_as(
    output: str,
    view: Callable[[], View],
    records: Callable[[], Table],
    values: Callable[[], JsonValue],
) -> None:
    """Print a result as "json", "csv" or "markdown", or for people ("")."""
    from ..report.render import csv_table, markdown

    if output == "json":
        print_json(values())
    elif output:
        print_text(csv_table(records()) if output == "csv" else markdown(view()))
    else:
        print_view(view())


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
    """Print Markdown or CSV in UTF-8, regardless of the terminal's language."""
    sys.stdout.flush()
    sys.stdout.buffer.write(text.encode())


def print_json(values: JsonValue) -> None:
    """Print plain values as strict JSON in ASCII."""
    sys.stdout.write(json.dumps(values, indent=1, allow_nan=False) + "\n")
