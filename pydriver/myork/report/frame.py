"""The frame of a page: one HTML file without external parts, with figures inside."""

from __future__ import annotations

import base64
import io
import re
from html import escape, unescape

from matplotlib.figure import Figure

__all__ = ["document", "figure", "section"]

_STYLE = """
:root { color-scheme: light; --ink: #1d2733; --soft: #5b6875; --line: #dfe4ea; --blue: #0b5c96; }
* { box-sizing: border-box; }
body { font: 16px/1.55 system-ui, "Segoe UI", "DejaVu Sans", sans-serif; color: var(--ink);
  max-width: 72rem; margin: 0 auto; padding: 1.5rem; background: #fff; }
h1 { font-size: 1.8rem; line-height: 1.2; margin: 0 0 .3rem; }
h2 { font-size: 1.3rem; margin: 2.6rem 0 .8rem; padding-top: .8rem;
  border-top: 1px solid var(--line); }
p.about, figcaption, caption, small { color: var(--soft); }
p.about { margin: 0; }
nav { margin: 1rem 0; } nav a { margin-right: 1.1rem; }
a { color: var(--blue); }
.state { display: inline-block; padding: .1rem .7rem; border-radius: 1rem; font-size: .9rem;
  font-weight: 600; vertical-align: middle; margin-left: .6rem; white-space: nowrap; }
.good { background: #dcefe6; color: #0a5a3c; } .bad { background: #fbe3d6; color: #8a3200; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(10rem, 1fr)); gap: .8rem;
  margin: 1.2rem 0; padding: 0; }
.cards div { border: 1px solid var(--line); border-radius: .5rem; padding: .7rem .9rem; }
.cards dt { color: var(--soft); font-size: .85rem; }
.cards dd { margin: 0; font-size: 1.25rem; font-weight: 600; }
.cards small { font-weight: 400; font-size: .8rem; }
.warnings { background: #fdf3e7; border-left: .3rem solid #d55e00; padding: .7rem 1rem .7rem 2rem;
  margin: 1rem 0; }
figure { margin: 1rem 0; } figure img { max-width: 100%; height: auto; display: block; }
figcaption, caption { font-size: .9rem; } caption { text-align: left; padding-bottom: .4rem; }
.scroll { overflow-x: auto; margin: 1rem 0; }
table { border-collapse: collapse; font-size: .92rem; font-variant-numeric: tabular-nums; }
th, td { padding: .3rem .8rem; border-bottom: 1px solid var(--line); text-align: right;
  vertical-align: top; }
th:first-child, td:first-child { text-align: left; padding-left: 0; }
thead th { border-bottom: 2px solid var(--soft); vertical-align: bottom; }
tbody th { font-weight: 500; white-space: nowrap; }
.facts td { text-align: left; }
code { font-size: .85rem; overflow-wrap: anywhere; }
footer { margin-top: 3rem; color: var(--soft); font-size: .85rem; }
@media print { body { max-width: none; } nav { display: none; } figure, table {
  break-inside: avoid; } }
"""


def document(title: str, header: str, body: str, footer: str) -> str:
    """A whole page; all arguments are HTML."""
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{title}</title>
<style>{_STYLE}</style>
</head>
<body>
<header>
{header}
</header>
<main>
{body}
</main>
<footer>{footer}</footer>
</body>
</html>
"""


def section(key: str, name: str, html: str) -> str:
    """A section with its heading; `key` is its anchor."""
    return (
        f'<section id="{key}" aria-labelledby="h-{key}"><h2 id="h-{key}">{name}</h2>\n{html}\n'
        "</section>"
    )


def figure(picture: Figure, caption: str) -> str:
    """Figure as a picture inside the page; its caption is its alternative text as well."""
    buffer = io.BytesIO()
    picture.savefig(buffer, format="png", dpi=130, facecolor="white", bbox_inches="tight")
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    plain = escape(unescape(re.sub("<[^>]*>", "", caption)))
    return (
        f'<figure><img alt="{plain}" src="data:image/png;base64,{data}">'
        f"<figcaption>{caption}</figcaption></figure>"
    )
