"""The calls that docs/development.md lists, and the targets of all links in the pages."""

import re
import traceback
from pathlib import Path

import pytest

import fidpipe
from fidpipe.pipeline.jobs import graph_job
from fidpipe.stages.graph import build_graph
from runs import run
from scenes import write_dataset

PACKAGE = [Path(fidpipe.__file__).parent / name for name in ("pipeline", "stages")]
ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs" / "development.md"
PAGES = sorted(
    [
        *ROOT.glob("*.md"),
        *(ROOT / "docs").rglob("*.md"),
        *ROOT.glob("runs/*.md"),
        *ROOT.glob("benchmarks/*.md"),
    ]
)


def test_a_stage_s_function_is_at_most_seven_calls_from_the_command(tmp_path, monkeypatch):
    ways = []

    def watched(points, settings):
        frames = traceback.extract_stack()
        ways.append(
            [frame.name for frame in frames if set(PACKAGE) & set(Path(frame.filename).parents)]
        )
        return build_graph(points, settings)

    monkeypatch.setattr(graph_job, "build_graph", watched)
    assert not run(write_dataset(tmp_path / "streets", 1), tmp_path / "run").failures
    for way in ways:
        calls = [*way, "build_graph"]
        assert len(calls) <= 7, calls
        assert calls[0] == "run_dataset"
    named = " ".join(PAGE.read_text().split())
    assert all(f"`{name}`" in named or f".{name}`" in named for name in ways[0][:-1])


def test_a_newcomer_follows_a_run_in_few_lines():
    section = PAGE.read_text().split("## Follow `fidpipe run`")[1].split("\n## ")[0]
    files = re.findall(r"^\| `(\S+\.py)` \|", section, re.MULTILINE)
    lines = sum(len((ROOT / file).read_text().splitlines()) for file in files)
    assert len(files) <= 12 and lines <= 3000, (len(files), lines)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_relative_link_of_a_page_leads_to_a_file(page):
    links = re.findall(
        r"(?<![\"'])\]\((?!\w+:)([^)#\s]+)[^)]*\)", page.read_text(encoding="utf-8")
    )
    assert not [link for link in links if not (page.parent / link).exists()]


def test_the_readme_is_one_screen():
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 60
