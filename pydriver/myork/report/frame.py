"""Parts of a page from templates: figures, tables, sections; text is escaped, `Markup` is not."""

from __future__ import annotations

import base64
import io
from collections.abc import Iterable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup
from matplotlib.figure import Figure

__all__ = ["Section", "figure", "render", "table"]


#: Points an inch of figures, and inches of those as wide as the page
_DPI, _WIDTH = 130, 11.0


class Section(NamedTuple):
    """A section of a page.

    Attributes
    ----------
    key : str
        Its anchor.
    name : str
        Its heading.
    parts : list of Markup
        Figures, tables and other HTML.
    """

    key: str
    name: str
    parts: list[Markup]


def render(template: str, **values: Any) -> Markup:
    """Fill in a template of this room.

    Parameters
    ----------
    template : str
        File name in `templates`.
    **values
        What it names; a name without a value is an error.
    """
    return Markup(_environment().get_template(template).render(values))


def figure(picture: Figure | str, caption: str) -> Markup:
    """Figure as a picture inside the page, or a picture file beside the page."""
    share = 100.0
    if isinstance(picture, str):
        source = picture
    else:
        buffer = io.BytesIO()
        picture.savefig(buffer, format="png", dpi=_DPI, facecolor="white", bbox_inches="tight")
        wide = int.from_bytes(buffer.getvalue()[16:20], "big")
        # one size of letters in all figures of a page
        share = min(100.0, 100.0 * wide / (_DPI * _WIDTH))
        source = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    return render("figure.html", source=source, caption=caption, share=round(share))


def table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    caption: str = "",
    notes: Sequence[str] = (),
) -> Markup:
    """A table; its first column names the rows, and none of its head is a table without a head.

    Notes, one a row or none at all, stand below their rows, as wide as the table.
    """
    return render("table.html", head=head, rows=rows, caption=caption, notes=notes)


@cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
