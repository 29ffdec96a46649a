"""The page `bench.html`: tables and curves of `bench.json`."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from myork.files import write_text
from myork.report.figures import COLOURS, MARKERS
from myork.report.frame import Page, Section, figure, table
from myork.report.numbers import number

_RIVAL = "#777777"
#: Length from which on a text is a sentence
_LONG = 44
#: Axes with a smaller ratio of their ends have numbers between the powers of ten
_FEW_DECADES = 300.0


def write_page(path: Path, record: Mapping[str, Any]) -> None:
    """Write the page of a record."""
    benches = record["benches"]
    without = [name for name, bench in benches.items() if "ended" in bench]
    again = " ".join(["myork bench", *benches, *(["--quick"] if record["quick"] else [])])
    page = Page(
        title="Benchmarks",
        sections=[
            Section(name, bench.get("title", name), _parts(bench))
            for name, bench in benches.items()
        ],
        about=(
            f"MyoRK {record['version']}, {record['date'][:19]}, {record['processor']}, "
            f"{record['cores']} cores, one thread a solve, "
            f"{'small cases only' if record['quick'] else 'all cases'}; load of the machine at "
            f"the start {record['load_average']:.1f}. {len(benches) - len(without)} "
            f"benchmarks have results{'; without: ' if without else ''}{', '.join(without)}."
        ),
        footer=Markup("Made by <code>{}</code>; all numbers: <code>bench.json</code>").format(
            again
        ),
    )
    write_text(path, page.text())


def _parts(bench: Mapping[str, Any]) -> list[Markup]:
    parts = [_about(bench["about"])] if "about" in bench else []
    if "ended" in bench:
        parts.append(Markup('<p class="warnings">No result: {}</p>').format(bench["ended"]))
    for plot in bench.get("plots", []):
        parts.append(figure(draw_curves([plot]), plot.get("caption", plot["title"])))
    for entry in bench.get("tables", []):
        parts.append(_table(entry))
    return parts


def _about(text: str) -> Markup:
    """Paragraphs, with words between backticks as code."""
    escaped = re.sub(r"`+([^`]+)`+", r"<code>\1</code>", str(escape(text.strip())))
    return Markup("".join(f"<p>{part}</p>" for part in re.split(r"\n\s*\n", escaped)))


def _table(entry: Mapping[str, Any]) -> Markup:
    """A table, with columns of sentences aligned to the left."""
    rows = [[_cell(value) for value in row] for row in entry["rows"]]
    wordy = any(len(cell) > _LONG for row in rows for cell in row[1:])
    kind = ' class="facts"' if wordy else ""
    shown = table(entry["head"], rows, entry["caption"])
    return Markup("<div{}>{}</div>").format(Markup(kind), shown)


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return value if isinstance(value, str) else number(value)


def draw_curves(plots: Sequence[Mapping[str, Any]]) -> Figure:
    """Plots side by side in one figure, with a legend outside, where it hides no point.

    - `plots`: as in `myork.bench`; curves of equal name have the same style in all of them
    """
    drawing = Figure(figsize=(5.0 + 5.0 * len(plots), 5.0), layout="constrained")
    curves = [curve for plot in plots for curve in plot["series"]]
    own = list(dict.fromkeys(c["name"] for c in curves if not c.get("rival", False)))
    shown = {}
    for axes, plot in zip(drawing.subplots(1, len(plots), squeeze=False)[0], plots, strict=True):
        for curve in plot["series"]:
            rival = curve.get("rival", False)
            k = len(own) if rival else own.index(curve["name"])
            (shown[curve["name"]],) = axes.plot(
                curve["x"],
                curve["y"],
                color=_RIVAL if rival else COLOURS[k % len(COLOURS)],
                marker="*" if rival else MARKERS[k % len(MARKERS)],
                markersize=9 if rival else 5.5,
                linestyle="--" if rival or k >= len(COLOURS) else "-",
                linewidth=1.6,
            )
        _dress(axes, plot)
    drawing.legend(
        shown.values(), shown.keys(), loc="outside right upper", frameon=False, fontsize=8.5
    )
    return drawing


def _dress(axes: Axes, plot: Mapping[str, Any]) -> None:
    """Logarithmic axes with their labels."""
    axes.set_xscale("log")
    axes.set_yscale("log")
    for axis in (axes.xaxis, axes.yaxis):
        low, high = axis.get_view_interval()
        if high < _FEW_DECADES * low:
            # one or two decades have more numbers than their powers of ten, but without overlap
            many = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
            axis.set_major_locator(LogLocator(subs=many if high < 8.0 * low else (1.0, 2.0, 5.0)))
            axis.set_major_formatter(FormatStrFormatter("%g"))
            axis.set_minor_formatter(NullFormatter())
    axes.set_xlabel(plot["x"])
    axes.set_ylabel(plot["y"])
    axes.set_title(plot["title"], fontsize=11)
    axes.grid(which="major", color="#dddddd", linewidth=0.8)
    axes.grid(which="minor", color="#eeeeee", linewidth=0.5)
    axes.spines[["top", "right"]].set_visible(False)
