"""Directives with content generated from the code: `{reference}`, `{stage}` and `{pipeline}`."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar

from sphinx.util.docutils import SphinxDirective

import contracts
from fidpipe.pipeline.jobs import EXTRAS, STAGES
from fidpipe.pipeline.stage import SCAN, Grain, Stage
from fidpipe.schemas.settings import Settings
from fidpipe.schemas.tables import TABLES

if TYPE_CHECKING:
    from docutils import nodes
    from sphinx.application import Sphinx

_GRAINS = {
    Grain.SIDE: "each side of a pair",
    Grain.PAIR: "each pair",
    Grain.OBJECT: "some of a pair's matched objects",
}


class Reference(SphinxDirective):
    """All tables, settings, known sensors, baseline metrics, or scores of matched objects."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The sections of the page."""
        text = getattr(contracts, f"all_{self.arguments[0]}")()
        return self.parse_text_to_nodes(text, allow_section_headings=True)


class StageContract(SphinxDirective):
    """Settings of a stage (the group of its name, or those in its option), its inputs, and its output tables."""

    required_arguments = 1
    option_spec: ClassVar = {"settings": str.split}

    def run(self) -> list[nodes.Node]:
        """A table for each group of settings, one of the inputs, and one for each output table."""
        stage = next((own for own in (*STAGES, *EXTRAS) if own.name == self.arguments[0]), None)
        if stage is None:
            raise self.error(
                f"stage {self.arguments[0]!r}: no such stage; known are {', '.join(_names())}"
            )
        groups = self.options.get(
            "settings", [stage.name] if stage.name in Settings.model_fields else []
        )
        if unknown := [group for group in groups if group not in Settings.model_fields]:
            raise self.error(
                f"settings {unknown[0]!r}: no such group; known are {', '.join(Settings.model_fields)}"
            )
        return self.parse_text_to_nodes(
            "\n".join([*map(contracts.settings_of, groups), tables_of(stage)])
        )


class PipelineTable(SphinxDirective):
    """One row for each stage: scope of a job, input and output tables, settings."""

    def run(self) -> list[nodes.Node]:
        """The table."""
        rows = ["| | stage | one job for | input | output | settings |", "|---" * 6 + "|"]
        for number, stage in enumerate(STAGES, 1):
            cells = (
                f"[{stage.name}]({stage.name}.md)",
                _GRAINS[stage.grain],
                ", ".join(map(_table_word, stage.takes)),
                ", ".join(map(_table_word, stage.gives)),
                ", ".join(f"`{group}`" for group in stage.settings) or "none",
            )
            rows.append(f"| {number} | {' | '.join(cells)} |")
        return self.parse_text_to_nodes("\n".join(rows) + "\n")


def tables_of(stage: Stage) -> str:
    """Markdown of the inputs and outputs of a stage."""
    lines = [f"One job for {_GRAINS[stage.grain]}.", ""]
    lines += [f"Input: {', '.join(map(_table_word, stage.takes))}."]
    lines += [
        f"\nOutput: `{name}`. {contracts.columns_of(TABLES[name])}" for name in stage.gives
    ]
    return "\n".join(lines) + "\n"


def _table_word(name: str) -> str:
    return "the scan's file" if name == SCAN else f"`{name}`"


def _names() -> list[str]:
    return [stage.name for stage in (*STAGES, *EXTRAS)]


def setup(app: Sphinx) -> dict[str, bool]:
    """Registers the directives."""
    app.add_directive("reference", Reference)
    app.add_directive("stage", StageContract)
    app.add_directive("pipeline", PipelineTable)
    return {"parallel_read_safe": True}
