"""Settings of the site: `sphinx-build -W docs build/site`, with the package installed."""

import html
import re

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

from myork import __version__

project = "MyoRK"
author = "The MyoRK developers"
copyright = author
release = __version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
]
myst_enable_extensions = ["amsmath", "dollarmath"]
myst_heading_anchors = 3
napoleon_google_docstring = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"  # the docstrings give shapes and units
html_theme = "furo"
html_title = f"MyoRK {release}"
html_math_renderer = "mathml"  # what browsers draw themselves: pages need no network


def _mathml(node: nodes.Node, display: str) -> str:
    """MathML of a formula; bold characters by their own code points, which all browsers know."""

    def bold(found: re.Match[str]) -> str:
        tag, char = found[1], html.unescape(found[2])
        first, start = next(
            (first, start)
            for last, first, start in (
                ("9", "0", 0x1D7CE),
                ("Z", "A", 0x1D400),
                ("z", "a", 0x1D41A),
                ("Ω", "Α", 0x1D6A8),
                ("ω", "α", 0x1D6C2),
            )
            if char <= last
        )
        return f"<{tag}>{chr(start + ord(char) - ord(first))}</{tag}>"

    return re.sub(
        r'<(m[in]) mathvariant="bold(?:-italic)?">(\w|&#x0?03[0-9A-F]{2};)</\1>',
        bold,
        convert(node.astext(), display=display),
    )


def _inline(self: HTML5Translator, node: nodes.math) -> None:
    self.body.append(_mathml(node, "inline"))
    raise nodes.SkipNode


def _display(self: HTML5Translator, node: nodes.math_block) -> None:
    self.body.append(_mathml(node, "block"))
    raise nodes.SkipNode


def setup(app: Sphinx) -> None:
    """Write formulas as MathML."""
    app.add_html_math_renderer("mathml", (_inline, None), (_display, None))
