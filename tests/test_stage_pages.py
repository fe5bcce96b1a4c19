"""The pages of the stages and the worked objects of docs/scores.md, against the code that they describe."""

import re
from pathlib import Path

import pytest
from PIL import Image

import pictures
from fidpipe.pipeline.generate import synth
from fidpipe.pipeline.jobs import STAGES
from fidpipe.stages.generate.streets import KINDS
from object_pictures import EXAMPLES, numbers_table
from runs import STAGE_NAMES, run

DOCS = Path(__file__).resolve().parents[1] / "docs"
SECTIONS = ["Definition", "Settings and tables", "What goes wrong"]


def page(name):
    return (DOCS / "stages" / f"{name}.md").read_text(encoding="utf-8")


def test_every_stage_has_a_page_in_the_order_of_the_pipeline():
    listed = re.search(r"```\{toctree\}\n:hidden:\n\n(.*?)```", page("index"), re.DOTALL)[
        1
    ].split()
    assert listed == STAGE_NAMES
    assert {path.stem for path in (DOCS / "stages").glob("*.md")} == {"index", *STAGE_NAMES}


@pytest.mark.parametrize("name", STAGE_NAMES)
def test_a_page_has_equation_source_picture_and_its_sections(name):
    text = page(name)
    assert re.findall("^## (.*)$", text, re.MULTILINE) == SECTIONS
    assert "$$" in text
    assert "**Source**" in text
    assert f"```{{stage}} {name}\n" in text
    assert f"](../pictures/{name}.png)" in text


def test_every_setting_that_a_stage_reads_is_on_a_page():
    named = {
        group
        for name in STAGE_NAMES
        for own in re.findall(":settings: (.*)", page(name))
        for group in own.split()
    }
    assert {*named, *STAGE_NAMES} >= {group for stage in STAGES for group in stage.settings}


def test_every_stage_has_a_picture_and_all_that_is_shown_is_there():
    assert list(pictures.STAGE_PICTURES) == list(pictures.STAGE_PANELS) == STAGE_NAMES
    texts = [
        (DOCS / "scores.md").read_text(encoding="utf-8"),
        page("index"),
        *map(page, STAGE_NAMES),
    ]
    shown = set(re.findall(r"pictures/([\w.]+\.png)\)", "\n".join(texts)))
    assert shown == {
        path.name for path in (DOCS / "pictures").iterdir() if not path.name.startswith("read_")
    }
    examples = [example.name for example in EXAMPLES]
    assert shown == {f"{name}.png" for name in ("pipeline", *STAGE_NAMES, *examples)}


@pytest.mark.exhaustive
def test_the_worked_objects_are_those_of_the_page_and_the_pictures_can_be_drawn(tmp_path):
    text = (DOCS / "scores.md").read_text(encoding="utf-8")
    named = re.findall(r"`(\d{4}) (\d+)`", text)
    streets = tmp_path / "streets"
    for index in sorted({int(pair_id) for pair_id, _ in named}):
        recipe = synth.recipe_of(0, "vlp32c", None)
        synth.write_pair((streets, f"{index:04d}", recipe, index))
    labels = "".join(f'{number} = "{kind}"\n' for number, kind in enumerate(KINDS))
    (streets / "labels.toml").write_text(labels)
    assert not run(streets, tmp_path / "run").failures
    chosen = pictures.draw_all(tmp_path / "run", tmp_path)
    assert [(row.pair_id, str(row.real_id)) for row in chosen.values()] == named
    assert numbers_table(chosen) in text
    for path in tmp_path.glob("*.png"):
        with Image.open(path) as picture:
            assert picture.width > 600
            assert len(picture.convert("RGB").getcolors(picture.width * picture.height)) > 20
    stored = {
        path.name for path in (DOCS / "pictures").iterdir() if not path.name.startswith("read_")
    }
    assert {path.name for path in tmp_path.glob("*.png")} == stored
