"""Look shared by pages and figures: colours that colour-blind readers can distinguish, and names of any characters."""

from __future__ import annotations

from html import escape

from ..results.quadrants import QUADRANTS, UNKNOWN
from ..terminal import shown

#: Okabe and Ito, Color Universal Design (2008).
BLUE, VERMILION, GREEN, ORANGE, SKY, PURPLE, GREY = (
    "#0072B2", "#D55E00", "#009E73", "#E69F00", "#56B4E9", "#CC79A7", "#999999",
)  # fmt: skip
SERIES = (BLUE, ORANGE, GREEN, PURPLE, SKY, VERMILION, GREY)
SIDE_COLOURS = {"real": BLUE, "sim": VERMILION}
SCORE_COLOURS = {"r_lambda": BLUE, "cdc": ORANGE}
FATE_COLOURS = {"matched": GREY, "missing": BLUE, "hallucinated": VERMILION, "too small": PURPLE}
#: Outcomes of rays, as `stages.rays` names them.
OUTCOME_COLOURS = {
    "same": GREY, "in_front": VERMILION, "behind": PURPLE, "dropped": BLUE, "no_surface": SKY, "sim_only": ORANGE,
}  # fmt: skip
OUTCOME_WORDS = {
    "same": "same range", "in_front": "simulated in front", "behind": "simulated behind",
    "dropped": "lost, surface is simulated", "no_surface": "lost, no surface", "sim_only": "simulated only",
}  # fmt: skip
QUADRANT_COLOURS = dict(zip((*QUADRANTS, UNKNOWN), (GREEN, ORANGE, SKY, VERMILION, GREY), strict=True))

#: Where a score is better, by whether higher is.
ARROWS = {True: "↑", False: "↓"}

#: From 0, faithful, to 1, failed: the parts of plasma that are seen on white and on black.
RAMPS = {
    "light": ("#0d0887", "#5302a3", "#8b0aa5", "#b83289", "#db5c68", "#fca636"),
    "dark": ("#6a00a8", "#9c179e", "#cc4778", "#ed7953", "#fdb42f", "#f0f921"),
}

#: Properties of a page by theme: each name is a property of its style sheet, such as --ink.
THEMES = {
    "light": {
        "ground": "#ffffff", "raised": "#f5f6f8", "ink": "#1b1e24", "soft": "#565d6a", "line": "#d5d9e0",
        "link": "#005a9c", "focus": "#d55e00", "better": "#0b62b0", "worse": "#b8500a", "blue": BLUE,
    },
    "dark": {
        "ground": "#14171c", "raised": "#1e222a", "ink": "#e8eaee", "soft": "#a9b0bc", "line": "#3a404b",
        "link": "#7cc4f5", "focus": "#e69f00", "better": "#6db3f2", "worse": "#f0994f", "blue": SKY,
    },
}  # fmt: skip


def of_theme(name: str) -> str:
    """A colour of `THEMES` as style sheets and the pages' charts name it."""
    return f"var(--{name})"


def on_page(colour: str) -> str:
    """A colour on a page: on black, blue is too dark and becomes sky blue."""
    return of_theme("blue") if colour == BLUE else colour


def clipped(text: str, most: int = 22) -> str:
    """A text of at most `most` signs, the last one an ellipsis where something is left out."""
    return text if len(text) <= most else f"{text[: most - 1]}…"


def in_chart(name: str, most: int = 22) -> str:
    """A name for a text of plotly, which reads a little markup: shown, shortened, and without meaning as markup."""
    return escape(clipped(shown(name), most), quote=False)
