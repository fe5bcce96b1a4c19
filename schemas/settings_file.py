"""What people and editors get of the settings: a commented TOML file to change, and a JSON schema of such files."""

from __future__ import annotations

from textwrap import wrap
from typing import Any

from pydantic import BaseModel, JsonValue

from .settings import PRESET_OBJECTS, PRESETS, Settings, allowed_values, preset_of

_WIDTH = 100
_PRESET_MEANING = "settings that belong together; those that the file does not name are the preset's"


def commented_toml(settings: Settings) -> str:
    """All settings as TOML, each below what it means and beside the values it takes; `load` reads the same back.

    What is unset has an example as a comment, since TOML has no word for it. A unit is the end of a name (`tau_m`).

    Examples
    --------
    >>> print(commented_toml(Settings()).splitlines()[3])
    preset = "paper"  # paper, reference
    """
    objects = "; ".join(f"{name}: {words}" for name, words in PRESET_OBJECTS.items())
    lines = [*_comment(f"{_PRESET_MEANING}. {objects}"), _line("preset", preset_of(settings), ", ".join(PRESETS))]
    for group, values in settings:
        model: type[BaseModel] = type(values)
        schema = model.model_json_schema(mode="serialization")["properties"]
        lines += ["", *_comment(model.__doc__ or ""), f"[{group}]"]
        for name, field in model.model_fields.items():
            value = getattr(values, name)
            is_unset = value is None
            line = _line(name, (field.examples or [])[0] if is_unset else value, allowed_values(schema[name]))
            lines += [*_comment(field.description or ""), f"# {line}" if is_unset else line]
    return "\n".join(lines) + "\n"


def json_schema() -> dict[str, JsonValue]:
    """The JSON schema (draft 2020-12) of a file of settings, for editors; rules about two settings are not in it."""
    schema: dict[str, Any] = Settings.model_json_schema()
    preset = {"type": "string", "enum": list(PRESETS), "default": "paper", "description": _PRESET_MEANING}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        **schema,
        "title": "fidpipe settings",
        "properties": {"preset": preset, **schema["properties"]},
    }


def _comment(text: str) -> list[str]:
    return [f"# {line}" for line in wrap(text, _WIDTH)]


def _line(name: str, value: Any, allowed: str) -> str:
    """A setting with its value on one line; tomli_w breaks arrays into several."""
    import tomli_w

    assignment = " ".join(tomli_w.dumps({name: value}).split()).replace("[ ", "[").replace(", ]", "]")
    return f"{assignment}  # {allowed}".replace("`", "")
