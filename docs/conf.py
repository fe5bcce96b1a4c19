"""Sphinx configuration: `make docs` writes build/docs, without network."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from pygments.lexers.special import TextLexer

import fidpipe

if TYPE_CHECKING:
    from sphinx.application import Sphinx
    from sphinx.writers.html5 import HTML5Translator

project = "fidpipe"
author = "the fidpipe developers"
version = release = fidpipe.__version__

sys.path.insert(0, str(Path(__file__).with_name("_ext")))
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinxcontrib.typer", "docstrings", "generated"]
myst_enable_extensions = ["dollarmath", "colon_fence", "deflist"]
myst_heading_anchors = 4
nitpicky = True
nitpick_ignore_regex = [("py:.*", ".*")]  # types in signatures
default_role = "literal"  # of docstrings
autodoc_type_aliases = {"FloatArray": "FloatArray"}
autodoc_inherit_docstrings = False
add_module_names = False
highlight_language = "none"

# The tutorial runs at each build, in a temporary folder, with the fidpipe of the interpreter that runs Sphinx.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
os.environ["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
os.environ["COLUMNS"] = "100"
os.environ["PYTHONPATH"] = os.pathsep.join(
    filter(None, (sys.path[0], os.environ.get("PYTHONPATH")))
)  # shell_cells

html_theme = "furo"
html_title = "fidpipe"
html_static_path = ["_static"]
html_css_files = ["look.css"]
html_math_renderer = "mathml"
html_copy_source = False
html_show_sourcelink = False
html_show_copyright = False


def inline_math(writer: HTML5Translator, node: nodes.math) -> None:
    """Writes a formula in the line as MathML, which every browser draws without a script or a font from elsewhere."""
    writer.body.append(mathml(node, as_block=False))
    raise nodes.SkipNode


def block_math(writer: HTML5Translator, node: nodes.math_block) -> None:
    """Writes a formula as a block of MathML."""
    writer.body.append(f'<div class="math-block">{mathml(node, as_block=True)}</div>')
    raise nodes.SkipNode


def mathml(node: nodes.math | nodes.math_block, *, as_block: bool) -> str:
    """The formula of a node; both bars of a norm are as high as the letters, else one of them is higher."""
    return tex2mathml(node.astext(), as_block=as_block).replace(
        "<mo>‖</mo>", '<mo stretchy="false">‖</mo>'
    )


def setup(app: Sphinx) -> None:
    """Registers the writer of formulas, and lines of CSV as plain text."""
    app.add_lexer("csv", TextLexer)
    app.add_html_math_renderer("mathml", (inline_math, None), (block_math, None))
