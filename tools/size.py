"""Lines of code without blank lines, comments and docstrings: the product, its core, each satellite, the tests.

A satellite is a subject that uses the core and that the core never imports; `lint-imports` proves it.
"""

from __future__ import annotations

import ast
import io
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[1]
PRODUCT = ("pipeline", "stages", "schemas")
SATELLITES = {
    "paper": ("pipeline/paper", "stages/paper"),
    "generate": ("pipeline/generate", "stages/generate"),
    "exchange": ("pipeline/exchange",),
    "diagnose": ("pipeline/diagnose", "stages/diagnose"),
    "inspect": ("pipeline/inspect", "stages/inspect"),
    "remote": ("pipeline/remote",),
}
_NO_CODE = {
    tokenize.COMMENT,
    tokenize.NL,
    tokenize.NEWLINE,
    tokenize.INDENT,
    tokenize.DEDENT,
    tokenize.ENDMARKER,
    tokenize.ENCODING,
}


def lines_of_code(text: str) -> int:
    """Count the lines of a module that carry code."""
    documented: set[int] = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(
            node
        ):
            documented.update(range(node.body[0].lineno, (node.body[0].end_lineno or 0) + 1))
    code: set[int] = set()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_CODE:
            code.update(range(token.start[0], token.end[0] + 1))
    return len(code - documented)


def size_of(*folders: str) -> int:
    """Count the lines of code of all modules in some folders."""
    return sum(lines_of_code(path.read_text("utf-8")) for folder in folders for path in (ROOT / folder).rglob("*.py"))


def main() -> None:
    """Print a line for the product, its core, each satellite and the tests."""
    satellites = {name: size_of(*folders) for name, folders in SATELLITES.items()}
    product = size_of(*PRODUCT)
    rows = {"product": product, "  core": product - sum(satellites.values())}
    rows |= {f"  {name}": lines for name, lines in satellites.items()} | {"tests": size_of("tests")}
    for name, lines in rows.items():
        print(f"{lines:7,d}  {name}")


if __name__ == "__main__":
    main()
