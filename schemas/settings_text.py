"""Settings as people and editors read them: TOML, plain or commented, and its JSON schema."""

from __future__ import annotations

import json
from textwrap import wrap
from typing import Any

from pydantic import BaseModel, JsonValue

from .settings import PRESET_OBJECTS, PRESETS, Settings, preset_of

_WIDTH = 100
_UNITS = (
    "# Lengths are in metres, angles in degrees, times in seconds; scans have x forward, y left, z up (ros) unless\n"
    "# input.real_frame or input.sim_frame says otherwise.\n"
)
_PRESET_MEANING = (
    "settings that belong together; those that the file does not name are the preset's"
)


def to_toml(settings: Settings) -> str:
    """The settings as TOML; those that are unset (None) are left out, so that `load` reads it back."""
    import tomli_w

    return _UNITS + tomli_w.dumps(settings.model_dump(mode="json", exclude_none=True))


def commented_toml(settings: Settings) -> str:
    """All settings as TOML, each with its meaning and allowed values as comments; `load` reads the same settings back.

    An unset value has an example as a comment, since TOML has no null. A unit is the end of a name (`tau_m`).

    Examples
    --------
    >>> print(commented_toml(Settings()).splitlines()[5])
    preset = "paper"  # paper, reference
    """
    objects = "; ".join(f"{name}: {words}" for name, words in PRESET_OBJECTS.items())
    lines = [
        *_UNITS.splitlines(),
        *_comment(f"{_PRESET_MEANING}. {objects}"),
        _line("preset", preset_of(settings), ", ".join(PRESETS)),
    ]
    for group, values in settings:
        model: type[BaseModel] = type(values)
        schema = model.model_json_schema()["properties"]
        lines += ["", *_comment(model.__doc__ or ""), f"[{group}]"]
        for name, field in model.model_fields.items():
            value = getattr(values, name)
            is_unset = value is None
            line = _line(
                name,
                (field.examples or [])[0] if is_unset else value,
                allowed(schema[name]),
            )
            lines += [*_comment(field.description or ""), f"# {line}" if is_unset else line]
    return "\n".join(lines) + "\n"


def json_schema() -> dict[str, JsonValue]:
    """The JSON schema (draft 2020-12) of a file of settings, for editors; rules about two settings are not in it."""
    schema: dict[str, Any] = Settings.model_json_schema()
    preset = {
        "type": "string",
        "enum": list(PRESETS),
        "default": "paper",
        "description": _PRESET_MEANING,
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "fidpipe settings",
        "properties": {"preset": preset, **schema["properties"]},
    }


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in wrap(text, _WIDTH)]


def _line(name: str, value: Any, allowed: str) -> str:
    """A setting with its value on one line: of texts, numbers and lists, JSON is TOML."""
    return f"{name} = {json.dumps(value)}  # {allowed}".replace("`", "")


def allowed(schema: dict[str, Any]) -> str:
    """Allowed values of a field as text, from its JSON schema."""
    kinds = [kind for kind in schema.get("anyOf", [schema]) if kind.get("type") != "null"]
    kind = kinds[0]
    if "enum" in kind:
        return ", ".join(f"`{value}`" for value in kind["enum"])
    if kind["type"] == "array":
        n, items = kind.get("maxItems"), kind.get("items", {})
        if "enum" in items:
            return "names, or `all`"
        return f"{n} numbers" if n else "names"
    if kind["type"] == "boolean":
        return "`true`, `false`"
    if {"minimum", "maximum"} <= kind.keys():
        return f"{kind['minimum']:.10g} to {kind['maximum']:.10g}"
    bounds = {
        "minimum": "at least",
        "exclusiveMinimum": "above",
        "maximum": "at most",
        "exclusiveMaximum": "below",
    }
    return ", ".join(
        f"{words} {kind[name]:.10g}" for name, words in bounds.items() if name in kind
    )
