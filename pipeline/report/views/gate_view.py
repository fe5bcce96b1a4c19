"""Result of a gate on a run or comparison, and JUnit XML for CI.

The XML is written with the standard library: it is three elements deep, and what a library would add is a dependency.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from ...results.gate import BaseResult, Check, GateResult, Judged
from ..view import Note, Table, View

#: What XML 1.0 cannot hold, not even escaped.
_NOT_XML = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def gate_view(result: GateResult) -> View:
    """Each criterion with value, bound and verdict; then the failed ones with the reason for each criterion."""
    rows = [
        (own.name, own.measure, _value(own), _bound(own), "pass" if own.passed else "FAIL") for own in result.judged
    ]
    failed = [own for own in result.judged if not own.passed]
    verdict = f"{len(failed)} of {len(result.judged)} criteria failed" if failed else "all criteria are met"
    return [
        Table(f"Gate of {result.run}", ("criterion", "measure", "value", "bound", "verdict"), rows, words=(0, 1)),
        *(Note(f"note: {note}", "yellow") for note in result.notes),
        *(Note(f"failed: {_in_words(own)}", "red") for own in failed),
        Note(verdict, "red" if failed else "green"),
    ]


def base_view(result: BaseResult) -> View:
    """Failures against the base, and the verdict."""
    failed = result.failed
    outcome = f"{len(failed)} of {len(result.checks)} checks failed" if failed else "passed"
    return [
        *(Note(f"failed: {check.name}: {check.found}", "red") for check in failed),
        *[Note(f"note: {result.note}", "yellow")] * bool(result.note),
        Note(f"gate on {' or '.join(result.fail_on)}: {outcome}", "red" if failed else "green"),
    ]


def gate_checks(result: GateResult) -> list[Check]:
    """The criteria as text, for JUnit."""
    words = {True: "bound", False: "not computed"}
    return [
        Check(judged.name, _in_words(judged), "" if judged.passed else words[judged.value is not None])
        for judged in result.judged
    ]


def junit_xml(command: str, suites: Mapping[str, Sequence[Check]]) -> bytes:
    """JUnit test suites by name, of a command of fidpipe: one test case per check."""
    root = ElementTree.Element("testsuites", _counts([check for checks in suites.values() for check in checks]))
    for name, checks in suites.items():
        about = {"name": _clean(f"fidpipe {command} {name}")} | _counts(checks)
        suite = ElementTree.SubElement(root, "testsuite", about)
        for check in checks:
            own = {"classname": f"fidpipe.{command}", "name": _clean(check.name), "time": "0"}
            case, words = ElementTree.SubElement(suite, "testcase", own), _clean(check.found)
            if check.fault:
                ElementTree.SubElement(case, "failure", {"message": words, "type": check.fault}).text = words
            else:
                ElementTree.SubElement(case, "system-out").text = words
    ElementTree.indent(root)
    content: bytes = ElementTree.tostring(root, encoding="utf-8", xml_declaration=True)
    return content + b"\n"


def _counts(checks: Sequence[Check]) -> dict[str, str]:
    return {"tests": str(len(checks)), "failures": str(sum(bool(check.fault) for check in checks)), "errors": "0"}


def _in_words(judged: Judged) -> str:
    here = judged.why if judged.value is None else f"{judged.measure} is {_value(judged)}, expected {_bound(judged)}"
    return f"{judged.name}: {here}{f' ({judged.reason})' if judged.reason else ''}"


def _value(judged: Judged) -> str:
    return "-" if judged.value is None else f"{judged.value:.6g}"


def _bound(judged: Judged) -> str:
    return f"{'<=' if judged.bound == 'max' else '>='} {judged.limit:g}"


def _clean(text: str) -> str:
    return _NOT_XML.sub("\ufffd", text)
