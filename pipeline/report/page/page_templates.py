"""Fill the pages' templates.

Every text is escaped; data for JavaScript is JSON in which no character ends a script.

Everything is inside the page: style, code, data, and plotly.js as installed.
"""

from __future__ import annotations

import re
from functools import cache
from importlib import resources
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from ...terminal import STEERING, shown
from ..look import (
    OUTCOME_COLOURS,
    PAGE_COLOURS,
    QUADRANT_COLOURS,
    SIGNED_RAMP_M,
    TEMPLATE,
    THEMES,
    clipped,
)


def render(template: str, report: dict[str, Any], **words: Any) -> str:
    """A page as HTML.

    Parameters
    ----------
    template : its file in `templates`
    report : what JavaScript reads, plain values
    words : what the template shows
    """
    report = {
        "template": TEMPLATE,
        "steering": STEERING,
        "colours": PAGE_COLOURS,
        "signed_ramp_m": SIGNED_RAMP_M,
        **report,
    }
    return _environment().get_template(template).render(report=report, **words)


@cache
def _environment() -> Environment:
    environment = Environment(
        loader=PackageLoader(__package__ or ""),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.policies["json.dumps_kwargs"] = {"allow_nan": False, "separators": (",", ":")}
    environment.filters |= {
        "shown": shown,
        "clipped": clipped,
    }
    environment.globals |= {
        "bar_colours": QUADRANT_COLOURS | OUTCOME_COLOURS,
        "themes": THEMES,
        "asset": _asset,
        "code": _code,
        "plotly": _plotly,
    }
    return environment


def _plotly() -> Markup:
    """The text of plotly.js as installed; to import the rest of plotly takes half a second."""
    file = resources.files("plotly").joinpath("package_data", "plotly.min.js")
    return Markup(file.read_text(encoding="utf-8"))


def _asset(name: str) -> Markup:
    """A file of `assets`, inserted into the page unchanged."""
    return Markup(
        resources.files(__package__).joinpath("assets", name).read_text(encoding="utf-8")
    )


def _code(*names: str) -> Markup:
    """Modules of `assets` as the text of one, without imports and exports.

    names : each after those that it imports
    """
    text = "\n".join(_asset(name) for name in names)
    return Markup(re.sub(r"^import [^;]*;\n|^export ", "", text, flags=re.MULTILINE))
