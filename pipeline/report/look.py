"""Look shared by pages and figures.

Colours that colour-blind readers can distinguish, and names of any characters.
"""

from __future__ import annotations

from typing import Any

from ..results.object_frame import UNKNOWN

#: Okabe and Ito, Color Universal Design (2008), vermilion darker for a contrast of 5 on white. One
#: meaning per colour: blue and vermilion are the sides, green is good, crimson is bad, purple is
#: behind a surface and olive in front of it. Scores differ in their symbols.
BLUE = "#0072B2"
VERMILION = "#B84E00"
GREEN = "#009E73"
ORANGE = "#E69F00"
SKY = "#56B4E9"
PURPLE = "#CC79A7"
GREY = "#999999"
CRIMSON = "#EC5C8D"
BROWN = "#B08968"
BEHIND = "#762a83"
IN_FRONT = "#9A8500"
SIDE_COLOURS = {"real": BLUE, "sim": VERMILION}
#: Words for the fate of an object; missing and invented are said of surface and pieces.
FATE_WORDS = {"matched": "matched", "not_found": "not found", "extra": "extra"}
#: Outcomes of rays, as `stages.rays` names them.
OUTCOME_COLOURS = {
    "same": GREY,
    "in_front": IN_FRONT,
    "behind": BEHIND,
    "dropped": BLUE,
    "no_surface": SKY,
    "sim_only": VERMILION,
}
OUTCOME_WORDS = {
    "same": "same range",
    "in_front": "simulated in front",
    "behind": "simulated behind",
    "dropped": "lost, surface is simulated",
    "no_surface": "lost, no surface",
    "sim_only": "simulated only",
}
QUADRANT_COLOURS = {
    "faithful": GREEN,
    "structure lost": ORANGE,
    "displaced": BROWN,
    "failed": CRIMSON,
    UNKNOWN: GREY,
}

#: From 0, faithful, to 1, failed: the parts of plasma that are seen on white and on black.
RAMPS = {
    "light": ("#0d0887", "#5302a3", "#8b0aa5", "#b83289", "#db5c68", "#fca636"),
    "dark": ("#6a00a8", "#9c179e", "#cc4778", "#ed7953", "#fdb42f", "#f0f921"),
}

#: From behind a surface to in front of it, with a grey middle.
SIGNED_RAMP_M = 0.25
SIGNED_RAMP = (BEHIND, "#9970ab", "#c2a5cf", "#9c9c9c", "#d8cc7c", "#bba83e", IN_FRONT)

#: Properties of a page by theme: each name is a property of its style sheet, such as --ink. Text in
#: any of them has a contrast of at least 4.5 on the ground.
THEMES = {
    "light": {
        "ground": "#ffffff",
        "raised": "#f5f6f8",
        "ink": "#1b1e24",
        "soft": "#565d6a",
        "line": "#d5d9e0",
        "link": "#005a9c",
        "focus": "#8a4fd0",
        "better": "#1b7837",
        "worse": "#b3123f",
        "blue": BLUE,
        "vermilion": VERMILION,
    },
    "dark": {
        "ground": "#14171c",
        "raised": "#1e222a",
        "ink": "#e8eaee",
        "soft": "#a9b0bc",
        "line": "#3a404b",
        "link": "#7cc4f5",
        "focus": "#c9a6ff",
        "better": "#5fc98b",
        "worse": "#ff7a9c",
        "blue": SKY,
        "vermilion": "#f07030",
    },
}


def of_theme(name: str) -> str:
    """A colour of `THEMES` as style sheets and the pages' charts name it."""
    return f"var(--{name})"


def clipped(text: str, most: int = 22) -> str:
    """Text truncated to at most `most` characters, ending in an ellipsis."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


#: Colours that the pages' JavaScript draws with.
PAGE_COLOURS = {
    "sides": {"real": of_theme("blue"), "sim": of_theme("vermilion")},
    "ramps": RAMPS,
    "signed": SIGNED_RAMP,
    "quadrants": QUADRANT_COLOURS,
    "none": GREY,
}

_INK = of_theme("ink")
_SOFT = of_theme("soft")
_LINE = of_theme("line")
_CLEAR = "rgba(0,0,0,0)"
_GRID = {"gridcolor": _LINE, "zerolinecolor": _LINE}
_AXIS = {**_GRID, "linecolor": _SOFT, "showline": True, "showgrid": True, "automargin": True}
_AXIS_3D = {**_GRID, "color": _SOFT, "showbackground": False, "showspikes": False}

#: The look that all charts of a page share, as plotly.js reads it; the page replaces var(--ink) and the like.
TEMPLATE: dict[str, Any] = {
    "layout": {
        "paper_bgcolor": _CLEAR,
        "plot_bgcolor": _CLEAR,
        "font": {"color": _INK, "family": "system-ui, sans-serif", "size": 12},
        "modebar": {"bgcolor": _CLEAR, "color": _SOFT, "activecolor": _INK},
        "margin": {"l": 55, "r": 15, "t": 40, "b": 45},
        "hoverlabel": {"align": "left"},
        "legend": {"orientation": "h", "y": 1.02, "yanchor": "bottom", "x": 0},
        "shapedefaults": {"line": {"color": _INK}},
        "xaxis": _AXIS,
        "yaxis": _AXIS,
        "scene": {
            "aspectmode": "data",
            "dragmode": "orbit",
            **dict.fromkeys(("xaxis", "yaxis", "zaxis"), _AXIS_3D),
        },
    }
}
