"""The public contract: tables, settings, commands, exit codes, JSON fields. `python tools/contract.py` writes the list.

The list is `tests/contract.json`; `tests/test_contract.py` compares the code with it. A change of it breaks the scripts
of users: write it only if that is the purpose of the change, and say so in CHANGELOG.md.
"""

import json
import os
import shutil
import sys
import tempfile
from pathlib import Path
from typing import get_type_hints

import numpy as np
import typer

from fidpipe.pipeline.cli import options
from fidpipe.pipeline.cli.main import app
from fidpipe.schemas.settings import PRESETS, Settings, load
from fidpipe.schemas.tables import TABLES

sys.path.append(str(Path(__file__).resolve().parents[1] / "tests"))

from reports import HOSTILE_CLASS
from runs import command, run
from scenarios import Shared

FILE = Path(__file__).parents[1] / "tests" / "contract.json"
KINDS = {bool: "boolean", int: "number", float: "number", str: "string", type(None): "null"}
#: Fields whose entries are no contract, or listed elsewhere; `record` is what `run.json` holds.
FREE = {"libraries", "machine", "record", "seconds", "settings", "stages", "wall_s"}


def measure(scenario):
    """The present contract; `scenario` gives the folder of a finished run by name."""
    return {
        "tables": {
            name: {field.name: f"{field.type}{' or null' * field.nullable}" for field in table.schema}
            for name, table in TABLES.items()
            if not name.startswith("toy_")  # of other tests in the same process
        },
        "settings": Settings().model_dump(mode="json"),
        "presets": {name: load(preset=name).model_dump(mode="json", exclude_defaults=True) for name in PRESETS},
        "commands": commands(),
        "exit codes": {name: value for name, value in vars(options).items() if name.startswith("EXIT_")},
        "json": json_fields(scenario),
    }


def commands():
    """Arguments and options of each command: position or names, type, and default."""
    found = {}
    for name, one in sorted(typer.main.get_command(app).commands.items()):
        hints = get_type_hints(next(c.callback for c in app.registered_commands if c.callback.__name__ == name))
        found[name] = {
            " ".join(each.opts) if each.opts[0].startswith("-") else f"argument {i}": (
                f"{getattr(hints[each.name], '__name__', hints[each.name])}, "
                + ("required" if each.required else f"default {each.default}")
            )
            for i, each in enumerate(one.params, 1)
        }
    return found


def json_fields(scenario):
    """Names and types of the fields of each JSON that fidpipe writes."""
    labelled, extras = scenario("labelled"), scenario("extras") / "run"
    one = labelled / "run"
    with tempfile.TemporaryDirectory() as folder:
        other = Path(folder) / "other"
        shifted = shutil.copytree(labelled / "streets", Path(folder) / "streets")
        for file in (shifted / "sim").glob("*.bin"):
            (np.fromfile(file, "<f4").reshape(-1, 4) + np.array([0.3, 0, 0, 0], "<f4")).tofile(file)
        run(shifted, other)
        gate = Path(folder) / "gate.json"
        command("gate", one, "--max", "pairs.failed=9", "--json", gate, "--junit", os.devnull)
        pair = next(row["pair_id"] for row in json.loads(printed("show", one))["pairs"] if row["status"] == "scored")
        texts = {
            "run.json": (one / "run.json").read_text(),
            "run.json with extras": (extras / "run.json").read_text(),
            "show RUN": printed("show", one),
            "show RUN PAIR": printed("show", one, pair),
            "show RUN PAIR OBJECT": printed("show", one, pair, "0"),
            "show RUN --paper": printed("show", one, "--paper"),
            "compare": printed("compare", one, other),
            "gate": gate.read_text(),
            "verify": printed("verify", one),
            "diagnose": printed("diagnose", other),
            "diagnose --tell-apart": printed("diagnose", other, "--tell-apart"),
            "check": printed("check", labelled / "streets"),
            "run": printed("run", shifted, "--out", other, "--workers", "1"),
        }
    pairs = {row["pair_id"] for one in (one, extras) for row in json.loads(printed("show", one))["pairs"]}
    data = pairs | {HOSTILE_CLASS, "wall"}
    return {name: fields(json.loads(text), data) for name, text in texts.items()}


def printed(*words):
    ended = command(*words, "--json")
    assert ended.stdout, ended.stderr
    return ended.stdout


def fields(value, data):
    """Types of all fields by path. Names of the data become NAME; entries of a list, or of one kind, are one path."""
    if not isinstance(value, dict | list):
        return {"": KINDS[type(value)]}
    if isinstance(value, list):
        parts = {"[]": {}}
        for one in value:
            parts["[]"] |= {path: kind for path, kind in fields(one, data).items() if kind != "null"}
    else:
        kept = {key: one for key, one in value.items() if key not in FREE}
        parts = {"NAME" if key in data else key: fields(one, data) for key, one in kept.items()}
        first = next(iter(parts.values()), {})
        if len(parts) > 3 and len(first) > 1 and all(one == first for one in parts.values()):
            parts = {"*": {"": ", ".join(parts), **first}}
        parts |= {key: {"": "object"} for key in value if key in FREE}
    return {
        f"{key}.{path}".rstrip("."): kind for key, one in parts.items() for path, kind in (one or {"": "?"}).items()
    }


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as place:
        FILE.write_text(json.dumps(measure(Shared(Path(place))), indent=1) + "\n")
