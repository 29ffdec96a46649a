"""The page `bench.html`: tables and curves of `bench.json`."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from myork.files import write_text
from myork.report import frame
from myork.report.numbers import DASH, number
from myork.report.tables import table

__all__ = ["write_page"]

# Okabe and Ito's palette; curves differ in marker as well
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">")
_RIVAL = "#777777"
_SCALES = {
    "log-log": ("log", "log"),
    "log-y": ("linear", "log"),
    "linear": ("linear", "linear"),
}


def write_page(path: Path, record: Mapping[str, Any]) -> None:
    """Write the page of a record."""
    write_text(path, _page(record))


def _page(record: Mapping[str, Any]) -> str:
    benches = record["benches"]
    titles = {name: escape(bench.get("title", name)) for name, bench in benches.items()}
    links = "".join(f'<a href="#{name}">{title}</a>' for name, title in titles.items())
    extent = "small cases only" if record["quick"] else "all cases"
    header = f"""<h1>Benchmarks</h1>
<p class="about">MyoRK {escape(record["version"])}, {escape(record["date"])},
{escape(record["processor"])}, {record["cores"]} cores, one thread a solve, {extent}; load of the
machine at the start {record["load_average"]:.1f}.</p>
<nav aria-label="Sections">{links}</nav>"""
    body = "\n".join(
        frame.section(name, titles[name], _bench(bench)) for name, bench in benches.items()
    )
    again = " ".join(["myork bench", *benches, *(["--quick"] if record["quick"] else [])])
    footer = f"Made by <code>{escape(again)}</code>; all numbers: <code>bench.json</code>"
    return frame.document("MyoRK benchmarks", header, body, footer)


def _bench(bench: Mapping[str, Any]) -> str:
    parts = [f"<p>{escape(bench['about'])}</p>"] if "about" in bench else []
    for plot in bench.get("plots", []):
        parts.append(frame.figure(_curves(plot), escape(plot.get("caption", plot["title"]))))
    for entry in bench.get("maps", []):
        parts.append(frame.figure(_map(entry), escape(entry["title"])))
    for entry in bench.get("pictures", []):
        caption = escape(entry["caption"])
        parts.append(
            f'<figure><img alt="{caption}" src="{escape(entry["file"])}">'
            f"<figcaption>{caption}</figcaption></figure>"
        )
    for entry in bench.get("tables", []):
        rows = [[_cell(value) for value in row] for row in entry["rows"]]
        head = [escape(text) for text in entry["head"]]
        parts.append(table(head, rows, escape(entry["caption"])))
    return "\n".join(parts)


def _cell(value: Any) -> str:
    if isinstance(value, str):
        return escape(value)
    if isinstance(value, bool):
        return "yes" if value else "no"
    return DASH if value is None else number(value)


def _curves(plot: Mapping[str, Any]) -> Figure:
    """Curves with legends outside, so that they hide no point."""
    figure = Figure(figsize=(9.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    own = 0
    for curve in plot["series"]:
        rival = curve.get("rival", False)
        axes.plot(
            curve["x"],
            curve["y"],
            color=_RIVAL if rival else _COLOURS[own % len(_COLOURS)],
            marker="*" if rival else _MARKERS[own % len(_MARKERS)],
            markersize=9 if rival else 5.5,
            linestyle="--" if rival or own >= len(_COLOURS) else "-",
            linewidth=1.6,
            label=curve["name"],
        )
        for x, y, note in zip(curve["x"], curve["y"], curve.get("notes", []), strict=False):
            axes.annotate(
                note, (x, y), xytext=(4, 4), textcoords="offset points", fontsize=7, color="#444444"
            )
        own += not rival
    scale_x, scale_y = _SCALES[plot.get("scale", "log-log")]
    axes.set_xscale(scale_x)
    axes.set_yscale(scale_y)
    axes.set_xlabel(plot["x"])
    axes.set_ylabel(plot["y"])
    axes.set_title(plot["title"], fontsize=11)
    axes.grid(which="major", color="#dddddd", linewidth=0.8)
    axes.grid(which="minor", color="#eeeeee", linewidth=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, fontsize=8.5)
    return figure


def _map(entry: Mapping[str, Any]) -> Figure:
    """Values at points of a plane, in its shape."""
    x, y = entry["x"], entry["y"]
    tall = (max(y) - min(y)) / (max(x) - min(x))
    figure = Figure(figsize=(5.0, 1.0 + 3.0 * tall), layout="constrained")
    axes = figure.add_subplot()
    drawn = axes.tripcolor(x, y, entry["value"], shading="gouraud", cmap="viridis")
    axes.plot(x, y, ".", markersize=1.5, color="#444444")
    axes.set_aspect("equal")
    axes.set_title(entry["title"], fontsize=9)
    figure.colorbar(drawn, ax=axes, label=entry["label"])
    return figure
