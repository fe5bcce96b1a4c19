"""The commented settings and their JSON schema against what `load` reads."""

import json
import re
import tomllib

import jsonschema
import pytest

from contracts import all_settings
from fidpipe.schemas.errors import SettingsError
from fidpipe.schemas.settings import PRESETS, Settings, load, parse, preset_of
from fidpipe.schemas.settings_text import commented_toml, json_schema
from runs import command

OTHER_VALUES = [
    "graph.k=33",
    "graph.tau_m=0.1",
    "input.columns=x,y,z,intensity,ring",
    "input.exclude_box=-1 -1 -1 1.5 1e-9 1",
    "input.max_range_m=1e9",
    "input.min_range_m=1e-300",
    "metrics.baselines=all",
    "ground.shared=true",
    "machine.memory_gib=0.5",
    "communities.seed=2147482647",
]


def read_back(text, tmp_path):
    file = tmp_path / "settings.toml"
    file.write_text(text, encoding="utf-8")
    return load(file)


@pytest.fixture(scope="module")
def validator():
    schema = json_schema()
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("words", [[], OTHER_VALUES, *([word] for word in OTHER_VALUES)])
def test_what_is_printed_is_read_back_to_equal_settings(preset, words, tmp_path, validator):
    settings = load(None, words, preset=preset)
    text = commented_toml(settings)
    assert read_back(text, tmp_path) == settings
    assert tomllib.loads(text)["preset"] == preset_of(settings)
    validator.validate(tomllib.loads(text))


def test_every_setting_has_a_line_below_its_meaning():
    parts = re.split(r"^\[(\w+)\]\n", commented_toml(Settings()), flags=re.MULTILINE)
    groups = dict(zip(parts[1::2], parts[2::2], strict=True))
    for group_name, group in Settings():
        lines = ["", *groups[group_name].splitlines()]
        for name, field in type(group).model_fields.items():
            [at] = [i for i, line in enumerate(lines) if re.match(rf"(# )?{name} = ", line)]
            comment = at - 1
            while lines[comment - 1].startswith("# ") and " = " not in lines[comment - 1]:
                comment -= 1
            meaning = " ".join(line.removeprefix("# ") for line in lines[comment:at])
            assert field.description in meaning


def test_the_example_of_a_setting_that_is_unset_holds(tmp_path, validator):
    text = re.sub(r"^# (\w+ = )", r"\1", commented_toml(Settings()), flags=re.MULTILINE)
    settings = read_back(text, tmp_path)
    assert settings.input.columns == ("x", "y", "z", "intensity", "ring")
    assert settings.input.include_box == (-50, -20, -5, 50, 20, 10)
    assert not [name for _, group in settings for name, value in group if value is None]
    validator.validate(tomllib.loads(text))


@pytest.mark.parametrize(
    "text",
    [
        "[graph]\nk = 0",
        "[graph]\nkk = 3",
        "[grph]\nk = 3",
        "[matching]\nmethod = 'best'",
        "[input]\nexclude_box = [1, 2]",
        "[metrics]\nbaselines = ['chamfr']",
        "[ground]\nshared = 1",
        "preset = 'papper'",
        "graph = 3",
    ],
)
def test_the_schema_refuses_what_load_refuses(text, tmp_path, validator):
    assert not validator.is_valid(tomllib.loads(text))
    if "shared" not in text:  # as a number it is read as true; an editor expects a boolean
        with pytest.raises(SettingsError):
            read_back(text, tmp_path)


@pytest.mark.parametrize(
    "text", ["[metrics]\nbaselines = 'all'", "[input]\ncolumns = 'x,y,z'", "[graph]\nk = 1"]
)
def test_the_schema_takes_what_load_takes(text, tmp_path, validator):
    validator.validate(tomllib.loads(text))
    assert read_back(text, tmp_path) == parse(tomllib.loads(text))


def test_the_command_prints_what_its_options_say(tmp_path):
    printed = command("settings", "--preset", "reference", "--set", "graph.k=60", code=0)
    assert read_back(printed.stdout, tmp_path) == load(None, ["graph.k=60"], preset="reference")
    changed = command(
        "settings", "--settings", tmp_path / "settings.toml", "--set", "graph.k=61"
    )
    assert read_back(changed.stdout, tmp_path).graph.k == 61
    assert json.loads(command("settings", "--json-schema").stdout) == json_schema()


def test_the_table_for_people_has_every_setting_with_its_default_and_bounds():
    lines = [line for line in all_settings().splitlines() if line.startswith("| `")]
    assert len(lines) == sum(len(type(values).model_fields) for _, values in Settings())
    by_name = {line.split("`")[1]: line for line in lines}
    assert "| `90` | `90` | 1 to 2000 | nearest neighbours" in by_name["graph.k"]
    assert "| `5` | `5` | above 0 |" in by_name["matching.delta_m"]
    assert "| `greedy`, `optimal` |" in by_name["matching.method"]
    assert "| none | none | 6 numbers |" in by_name["input.exclude_box"]
