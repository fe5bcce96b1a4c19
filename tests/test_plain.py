"""Counts of `tools/plain.py` on a small module, and on this project where the tool that it follows is at hand."""

import subprocess
import sys
from pathlib import Path

import pytest

import plain

ROOT = Path(__file__).resolve().parents[1]
ORIGINAL = ROOT.parent / "shared" / "plain.py"
MODULE = b'''"""Docstring."""

# comment
a, b = f(x), g(y)
c, d = f(x), f(y)
names = [one for one in [a] for two in [three for three in b]]
text = "s" * (a > 1)
value = 1 if a else (2 if b else 3)
'''


def test_tokens_lines_and_tricks_are_counted():
    n_tokens, n_lines, n_tricks, n_long = plain.measure(MODULE)
    assert n_tokens == 13 + 13 + 21 + 9 + 13
    assert n_lines == 5
    assert n_tricks == 5
    assert n_long == 0


def test_the_counts_are_those_of_the_tool_that_it_follows():
    if not ORIGINAL.exists():
        pytest.skip(f"{ORIGINAL} is absent")
    folders = ["schemas", "tools", "benchmarks"]
    rows = []
    for tool in (ROOT / "tools" / "plain.py", ORIGINAL):
        command = [sys.executable, tool, *folders]
        printed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
        rows.append([line[:73] for line in printed.stdout.splitlines()[1 : len(folders) + 1]])
    assert rows[0] == rows[1]


@pytest.mark.parametrize("folders", ["pipeline stages schemas", "tests", "tools", "benchmarks"])
def test_there_are_at_most_three_tricks_in_a_thousand_lines(folders):
    n_lines = n_tricks = 0
    for folder in folders.split():
        for path in (ROOT / folder).rglob("*.py"):
            _, lines, tricks, _ = plain.measure(path.read_bytes())
            n_lines += lines
            n_tricks += tricks
    assert 1000 * n_tricks <= 3 * n_lines
