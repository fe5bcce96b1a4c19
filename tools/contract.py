"""The public contract: tables, settings, commands and exit codes. `python tools/contract.py` writes the list.

The list is `tests/contract.json`; `tests/test_contract.py` compares the code with it. A change of it breaks the scripts
of users: write it only if that is the purpose of the change, and say so in CHANGELOG.md.
"""

import json
from pathlib import Path
from typing import get_type_hints

import typer

from fidpipe.pipeline.cli import options
from fidpipe.pipeline.cli.main import app
from fidpipe.schemas.settings import PRESETS, Settings, load
from fidpipe.schemas.tables import TABLES

FILE = Path(__file__).parents[1] / "tests" / "contract.json"


def measure():
    """The present contract."""
    return {
        "tables": {name: columns(table) for name, table in TABLES.items()},
        "settings": Settings().model_dump(mode="json"),
        "presets": {
            name: load(preset=name).model_dump(mode="json", exclude_defaults=True)
            for name in PRESETS
        },
        "commands": commands(),
        "exit codes": {
            name: value for name, value in vars(options).items() if name.startswith("EXIT_")
        },
    }


def columns(table):
    """Type of each column of a table, and whether it may be null."""
    return {
        field.name: f"{field.type} or null" if field.nullable else str(field.type)
        for field in table.schema
    }


def commands():
    """Arguments and options of each command: position or names, type, and default."""
    hints = {
        command.callback.__name__.replace("_", "-"): get_type_hints(command.callback)
        for command in app.registered_commands
    }
    described = {}
    for name, command in sorted(typer.main.get_command(app).commands.items()):
        described[name] = {}
        for position, parameter in enumerate(command.params, 1):
            is_option = parameter.opts[0].startswith("-")
            label = " ".join(parameter.opts) if is_option else f"argument {position}"
            hint = hints[name][parameter.name]
            default = "required" if parameter.required else f"default {parameter.default}"
            described[name][label] = f"{getattr(hint, '__name__', hint)}, {default}"
    return described


if __name__ == "__main__":
    FILE.write_text(json.dumps(measure(), indent=1) + "\n")
