"""View and map of a tell-apart test."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from ..report.figures import style
from ..report.view import Note, Table, View, number
from ..storage.files import write_whole
from .tell_apart import TellApart

_GUESS = 0.05  # AUC over 0.5 from which a feature is named
_MOST_NAMED = 3


def tell_apart_view(found: TellApart) -> View:
    """The AUC next to that of real against real, the features that matter, and the places."""
    tests = [("real against simulated", found.test)]
    tests += [(f"  by {name} alone", test) for name, test in found.families.items()]
    tests += [(f"real against real ({found.base_of})", found.base)]
    rows = [(name, test.auc, f"{number(test.low)} to {number(test.high)}") for name, test in tests]
    folds = f"{len(found.test.by_fold)} {'places' if found.by_place else 'sectors'}"
    return [
        Table(
            f"{found.title}: {found.n_points:,} points per side, cross-validated over {folds}",
            ("points", "AUC", "95 % interval"),
            rows,
            words=(0, 2),
        ),
        Table(
            "Recognised by",
            ("family", "feature", "AUC of it alone"),
            [(*names, auc) for names, auc in found.features.items()],
            words=(0, 1),
        ),
        Table("Where, by surface alone", ("points", "AUC"), [*found.where.items()]),
        Note(summary(found), "bold"),
        *(Note(text, "yellow") for text in found.notes),
    ]


def summary(found: TellApart) -> str:
    """The result in one sentence."""
    test, base = found.test, found.base
    if test.low <= base.high:
        return f"AUC {number(test.auc)}: not distinguishable from real against real ({number(base.auc)})"
    named = []
    for (_, feature), auc in [*found.features.items()][:_MOST_NAMED]:
        if auc > 0.5 + _GUESS:
            named.append(f"{feature} ({number(auc, 2)} alone)")
    by = ", ".join(named) or "no feature alone"
    return f"AUC {number(test.auc)}, real against real {number(base.auc)}; recognised by {by}"


def draw_map(found: TellApart, path: Path) -> None:
    """Write a PNG: both sides seen from above, points coloured by the probability of being simulated."""
    sides = []
    for is_sim in (False, True):
        side = found.points[found.points.is_sim == is_sim]
        sides.append((side[["x", "y", "z"]].to_numpy(), side.probability.to_numpy()))
    frame = style.frame_of(*(points for points, _ in sides))
    with style.new_figure(9.4, 5.25, style.shown_name(found.title, 80)) as figure:
        axes = figure.subplots(1, 2, sharex=True, sharey=True)
        for axis, name, (points, probability) in zip(
            axes, ("real", "simulated"), sides, strict=True
        ):
            coloured = style.dots(axis, points, 2.0, probability, cmap="coolwarm", vmin=0, vmax=1)
            axis.set_title(f"{name} points")
            style.from_above(axis, frame)
        style.colour_bar(axes[1], coloured, "probability of being simulated")
    with style.in_our_style():
        content = BytesIO()
        figure.savefig(content, format="png", bbox_inches="tight", pad_inches=0.08)
    write_whole(path, content.getvalue())
