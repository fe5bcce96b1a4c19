"""View of a tell-apart test."""

from __future__ import annotations

from typing import Any

from ..report.view import Note, Table, View, columns_of, number


def tell_apart_view(title: str, values: dict[str, Any]) -> View:
    """The AUC next to that of real against real, and the AUC by each feature."""
    base = values["real_against_real"]
    tests = [("real against simulated", values)]
    tests += [(f"  by {family['name']} alone", family) for family in values["families"]]
    tests.append((f"real against real ({base['of']})", base))
    rows = [
        (name, test["auc"], f"{number(test['low'])} to {number(test['high'])}")
        for name, test in tests
    ]
    same = "not " if values["low"] <= base["high"] else ""
    return [
        Table(
            f"{title}: {values['n_points']:,} points per side, cross-validated over "
            f"{values['n_folds']} {values['folds']}",
            ("points", "AUC", "95 % interval"),
            rows,
            words=(0, 2),
        ),
        Table(
            "Recognised by",
            ("family", "feature", "AUC of it alone"),
            columns_of(values["features"], ("family", "name", "auc")),
            words=(0, 1),
        ),
        Note(f"{same}easier to distinguish than real points from real points", "bold"),
    ]
