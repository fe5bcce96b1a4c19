"""View and map of a tell-apart test."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

from ..report.figures import style
from ..report.view import Note, Table, View, number
from ..storage.files import write_whole
from .tell_apart import TellApart

_GUESS = 0.05  # AUC over 0.5 from which a feature is named


def tell_apart_view(found: TellApart) -> View:
    """The AUC next to that of real against real, the features that matter, and the places."""
    tests = [("real against simulated", found.test)]
    tests += [(f"  by {name} alone", one) for name, one in found.families.items()]
    tests += [(f"real against real ({found.base_of})", found.base)]
    rows = [(name, one.auc, f"{number(one.low)} to {number(one.high)}") for name, one in tests]
    folds = f"{len(found.test.by_fold)} {'places' if found.test.by_place else 'sectors'}"
    features = [
        (name, feature, auc, one.loss[feature])
        for name, one in found.families.items()
        for feature, auc in sorted(one.alone.items(), key=lambda each: -each[1])
    ]
    return [
        Table(
            f"{found.title}: {found.n_points:,} points per side, cross-validated over {folds}",
            ("points", "AUC", "95 % interval"),
            rows,
            words=(0, 2),
        ),
        Table(
            "Recognised by",
            ("family", "feature", "AUC of it alone", "loss of its family without it"),
            features,
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
    alone = [each for one in found.families.values() for each in one.alone.items() if each[1] > 0.5 + _GUESS]
    named = ", ".join(f"{name} ({number(auc, 2)} alone)" for name, auc in sorted(alone, key=lambda each: -each[1])[:3])
    return f"AUC {number(test.auc)}, real against real {number(base.auc)}; recognised by {named or 'no feature alone'}"


def draw_map(found: TellApart, path: Path) -> None:
    """Write a PNG: both sides seen from above, points coloured by the probability of being simulated."""
    frame = style.frame_of(*(points for points, _ in found.maps))
    with style.new_maps(frame, style.shown_name(found.title, 80)) as (figure, axes):
        for axis, name, (points, probability) in zip(axes, ("real", "simulated"), found.maps, strict=True):
            coloured = style.dots(axis, points, 2.0, probability, cmap="coolwarm", vmin=0, vmax=1)
            axis.set_title(f"{name} points")
        style.colour_bar(axes[1], coloured, "probability of being simulated")
    with style.in_our_style():
        content = BytesIO()
        figure.savefig(content, format="png", bbox_inches="tight", pad_inches=0.08)
    write_whole(path, content.getvalue())
