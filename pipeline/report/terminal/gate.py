"""A judged run in the terminal, and as JUnit XML for CI.

The XML is written with the standard library: it is three elements deep, and what a library would add is a dependency.
"""

from __future__ import annotations

import re
from xml.etree import ElementTree

from rich.console import Group, RenderableType
from rich.text import Text

from ...results.gate import GateResult, Judged
from .layout import plain_table

#: What XML 1.0 cannot hold, not even escaped.
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_VERDICTS = {True: Text("pass", style="green"), False: Text("FAIL", style="red")}


def gate_view(result: GateResult) -> RenderableType:
    """Each criterion with value, bound and verdict; then what failed and why it is wanted."""
    rows = [
        (judged.criterion.name, judged.criterion.measure, _value(judged), _bound(judged), _VERDICTS[judged.passed])
        for judged in result.judged
    ]
    failed = [judged for judged in result.judged if not judged.passed]
    verdict = f"{len(failed)} of {len(result.judged)} criteria failed" if failed else "all criteria are met"
    columns = ("criterion", "measure", "value", "bound", "verdict")
    return Group(
        plain_table(f"Gate of {result.run}", columns, rows, words=(0, 1)),
        *(Text(f"note: {note}", style="yellow") for note in result.notes),
        *(Text(f"failed: {_in_words(judged)}", style="red") for judged in failed),
        Text(verdict, style="red" if failed else "green"),
    )


def junit_xml(result: GateResult) -> bytes:
    """A JUnit test suite: one test case per criterion."""
    n_failed = sum(not judged.passed for judged in result.judged)
    counts = {"tests": str(len(result.judged)), "failures": str(n_failed), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": _clean(f"fidpipe gate {result.run}")} | counts)
    for judged in result.judged:
        about = {"classname": "fidpipe.gate", "name": _clean(judged.criterion.name), "time": "0"}
        case = ElementTree.SubElement(suite, "testcase", about)
        words = _clean(_in_words(judged))
        if judged.passed:
            ElementTree.SubElement(case, "system-out").text = words
        else:
            kind = "bound" if judged.value is not None else "not computed"
            ElementTree.SubElement(case, "failure", {"message": words, "type": kind}).text = words
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _in_words(judged: Judged) -> str:
    criterion = judged.criterion
    here = judged.why if judged.value is None else f"{criterion.measure} is {_value(judged)}, wanted {_bound(judged)}"
    return f"{criterion.name}: {here}{f' ({criterion.reason})' if criterion.reason else ''}"


def _value(judged: Judged) -> str:
    return "-" if judged.value is None else f"{judged.value:.6g}"


def _bound(judged: Judged) -> str:
    return f"{'<=' if judged.criterion.bound == 'max' else '>='} {judged.criterion.limit:g}"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
