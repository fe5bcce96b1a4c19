"""Result of a gate on a run or comparison, and JUnit XML for CI.

The XML is written with the standard library: it is three elements deep.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree import ElementTree

from ...results.gate import BaseResult, Check, GateResult, Judged
from ...terminal import shown
from ..view import Note, Table, View, warnings


def gate_view(result: GateResult) -> View:
    """Each criterion with value, bound and verdict; then the failed ones with their reasons."""
    rows = []
    for judged in result.judged:
        verdict = "pass" if judged.passed else "FAIL"
        value = "-" if judged.value is None else f"{judged.value:.6g}"
        rows.append((judged.name, judged.measure, value, judged.bound_words, verdict))
    headings = ("criterion", "measure", "value", "bound", "verdict")
    failed = [judged for judged in result.judged if not judged.passed]
    outcome = Note("all criteria are met", "green")
    if failed:
        outcome = Note(f"{len(failed)} of {len(result.judged)} criteria failed", "red")
    return [
        Table(f"Gate of {result.run}", headings, rows, words=(0, 1)),
        *warnings(result.notes),
        *(Note(f"failed: {judged.found}", "red") for judged in failed),
        outcome,
    ]


def base_view(result: BaseResult) -> View:
    """Failures against the base, and the verdict."""
    failed = result.failed
    outcome = f"{len(failed)} of {len(result.checks)} checks failed" if failed else "passed"
    return [
        *(
            Note(f"failed: expected: {check.name}; found: {check.found}", "red")
            for check in failed
        ),
        Note(f"gate on {result.fail_on}: {outcome}", "red" if failed else "green"),
    ]


def junit_xml(command: str, suites: Mapping[str, Sequence[Check | Judged]]) -> bytes:
    """JUnit test suites by name, of a command of fidpipe: one test case per check."""
    root = ElementTree.Element("testsuites")
    for name, checks in suites.items():
        n_failed = sum(bool(check.fault) for check in checks)
        about = {"name": shown(f"fidpipe {command} {name}"), "tests": str(len(checks))}
        about |= {"failures": str(n_failed), "errors": "0"}
        suite = ElementTree.SubElement(root, "testsuite", about)
        for check in checks:
            about = {"classname": f"fidpipe.{command}", "name": shown(check.name), "time": "0"}
            case = ElementTree.SubElement(suite, "testcase", about)
            words = shown(check.found)
            if check.fault:
                failure = {"message": words, "type": check.fault}
                ElementTree.SubElement(case, "failure", failure).text = words
            else:
                ElementTree.SubElement(case, "system-out").text = words
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"
