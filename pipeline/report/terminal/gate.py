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


def gate_view(result: GateResult) -> RenderableType:
    """Each criterion with value, bound and verdict; then what failed and why it is wanted."""
    table = plain_table(f"Gate of {result.run}", "criterion", "measure", "value", "bound", "verdict", words=2)
    for judged in result.judged:
        met = Text("pass", style="green") if judged.passed else Text("FAIL", style="red")
        table.add_row(Text(judged.criterion.name), Text(judged.criterion.measure), _value(judged), _bound(judged), met)
    failed = [judged for judged in result.judged if not judged.passed]
    lines = [Text(f"note: {note}", style="yellow") for note in result.notes]
    lines += [Text(f"failed: {_told(judged)}", style="red") for judged in failed]
    verdict = f"{len(failed)} of {len(result.judged)} criteria failed" if failed else "all criteria are met"
    return Group(table, *lines, Text(verdict, style="red" if failed else "green"))


def junit_xml(result: GateResult) -> bytes:
    """A JUnit test suite: one test case per criterion."""
    n_failed = sum(not judged.passed for judged in result.judged)
    counts = {"tests": str(len(result.judged)), "failures": str(n_failed), "errors": "0"}
    root = ElementTree.Element("testsuites", counts)
    suite = ElementTree.SubElement(root, "testsuite", {"name": _clean(f"fidpipe gate {result.run}")} | counts)
    for judged in result.judged:
        case = ElementTree.SubElement(
            suite, "testcase", {"classname": "fidpipe.gate", "name": _clean(judged.criterion.name), "time": "0"}
        )
        told = _clean(_told(judged))
        if judged.passed:
            ElementTree.SubElement(case, "system-out").text = told
        else:
            kind = "bound" if judged.value is not None else "not computed"
            ElementTree.SubElement(case, "failure", {"message": told, "type": kind}).text = told
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _told(judged: Judged) -> str:
    criterion = judged.criterion
    told = judged.why if judged.value is None else f"{criterion.measure} is {_value(judged)}, wanted {_bound(judged)}"
    about = f"{criterion.name}: {told}"
    return f"{about} ({criterion.reason})" if criterion.reason else about


def _value(judged: Judged) -> str:
    return "-" if judged.value is None else f"{judged.value:.6g}"


def _bound(judged: Judged) -> str:
    return f"{'<=' if judged.criterion.bound == 'max' else '>='} {judged.criterion.limit:g}"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
