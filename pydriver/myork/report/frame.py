"""A page and its parts: figures, tables, sections; text is escaped, `Markup` is not."""

import base64
import io
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markdown_it import MarkdownIt
from markupsafe import Markup
from matplotlib.figure import Figure

#: Points per inch of figures, width of full-width figures in inches, and their least width in
#: letters
_DPI, _WIDTH, _LEAST = 130, 11.0, 42.0
#: A picture; its caption is also its alternative text
_FIGURE = Markup(
    '<figure><img alt="{alt}" src="{source}" style="{style}">'
    "<figcaption>{caption}</figcaption></figure>"
)


class Answer(NamedTuple):
    """A question of the reader with its answer."""

    question: str  #: A word or two
    lines: list[str | Markup]  #: Sentences of the answer, the most important one first


class Section(NamedTuple):
    """A section of a page."""

    key: str  #: Its anchor
    name: str  #: Its heading
    parts: Iterable[Markup]  #: Figures, tables and other HTML


class Page(NamedTuple):
    """All that a page shows."""

    title: str  #: Its heading
    sections: Iterable[Section]  #: Those without parts are left out
    footer: Markup  #: Software that made it
    #: Kind (`good`, `unsure`, `bad`) and words of each badge, after the heading
    badges: Iterable[tuple[str, str]] = ()
    about: str = ""  #: A line that describes it
    #: First questions of a reader; those without an answer are left out
    story: Iterable[Answer] = ()
    warnings: Sequence[str] = ()  #: Problems found

    def text(self) -> str:
        """The page as one file without external parts."""
        listed = ((key, name, list(parts)) for key, name, parts in self.sections)
        shown = self._replace(story=[answer for answer in self.story if answer.lines])
        return render("page.html", page=shown, sections=[own for own in listed if own[2]])


def page_of_markdown(text: str, pictures: Mapping[str, Figure], footer: Markup) -> str:
    """A page in Markdown as one file; its headings of the second level begin sections.

    - `pictures`: figures by the paths that the text gives, each in a paragraph
    """
    reader = MarkdownIt("js-default")
    head, *parts = re.split("^## ", text, flags=re.M)
    title, _, about = head.removeprefix("# ").partition("\n")
    sections = []
    for number, part in enumerate(parts, start=1):
        name, _, body = part.partition("\n")
        html = re.sub("(<table>.*?</table>)", r'<div class="scroll">\1</div>', reader.render(body),
                      flags=re.S)  # fmt: skip
        html = re.sub(
            '<p><img src="(.*?)" alt="(.*?)"></p>',
            lambda found: figure(pictures[found[1]], Markup(found[2])),
            html,
        )
        sections.append(Section(f"section-{number}", name, [Markup(html)]))
    shown = Markup(reader.renderInline(about.strip()))
    return Page(title, sections, footer, about=shown).text()


def render(template: str, **values: Any) -> Markup:
    """Fill in a file of `templates`; a name without a value is an error."""
    return Markup(_environment().get_template(template).render(values))


def figure(picture: Figure, caption: str) -> Markup:
    """Figure as a picture inside the page."""
    buffer = io.BytesIO()
    picture.savefig(buffer, format="png", dpi=_DPI, facecolor="white", bbox_inches="tight")
    wide = int.from_bytes(buffer.getvalue()[16:20], "big")
    # the same letter size in all figures of a page; on a phone they scroll and stay legible
    share = min(1.0, wide / (_DPI * _WIDTH))
    style = f"width: max({100 * share:.0f}%, {_LEAST * share:.1f}rem)"
    source = "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode("ascii")
    return _FIGURE.format(
        alt=Markup(caption).striptags(), source=source, caption=caption, style=style
    )


def table(head: Sequence[str], rows: Iterable[Sequence[str]], caption: str = "") -> Markup:
    """A table; its first column names the rows, and an empty head gives a table without a head."""
    return render("table.html", head=head, rows=rows, caption=caption)


def table_lines(rows: Sequence[Sequence[str]]) -> list[str]:
    """A table as lines of Markdown; its first row is the head."""
    lines = [f"| {' | '.join(row)} |" for row in rows]
    return [lines[0], "|" + "---|" * len(rows[0]), *lines[1:]]


def folded(summary: str, content: Markup) -> Markup:
    """Content that is unfolded by a click on its summary."""
    return Markup("<details><summary>{}</summary>{}</details>").format(summary, content)


@cache
def _environment() -> Environment:
    return Environment(
        loader=FileSystemLoader(Path(__file__).parent / "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
