"""View and map of a tell-apart test."""

from __future__ import annotations

from pathlib import Path

from ..report.view import Note, Table, View, columns_of, number
from .tell_apart import TellApart


def tell_apart_view(found: TellApart) -> View:
    """The AUC next to that of real against real, and the AUC by each feature."""
    values = found.values
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
            f"{found.title}: {values['n_points']:,} points per side, cross-validated over "
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


def draw_map(found: TellApart, path: Path) -> None:
    """Write a PNG: both sides seen from above, points coloured by the probability of being simulated."""
    from ..report.figures import style  # matplotlib takes a second to load

    frame = style.frame_of(found.points[["x", "y", "z"]].to_numpy())
    with style.new_figure(9.4, 5.25, style.shown_name(found.title, 80)) as figure:
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, (is_sim, side) in zip(axes, found.points.groupby("is_sim"), strict=True):
            points = side[["x", "y", "z"]].to_numpy()
            coloured = style.dots(
                axis, points, 2.0, side.probability, cmap="coolwarm", vmin=0, vmax=1
            )
            axis.set_title("simulated points" if is_sim else "real points")
            style.from_above(axis, frame)
        style.colour_bar(axes[1], coloured, "probability of being simulated")
    style.save(figure, path)
