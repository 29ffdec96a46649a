"""What a benchmark shows: tables and plots of its cases, and a page of them as Markdown."""

import re
from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from myork.report.figures import COLOURS, MARKERS
from myork.report.frame import table_lines

_RIVAL = "#777777"
#: Axes with a smaller ratio of their ends have numbers between the powers of ten
_FEW_DECADES = 300.0


def table(caption: str, rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Table whose header has the names of its first row; values that a row lacks stay empty."""
    head = list(rows[0]) if rows else []
    return {
        "caption": caption,
        "head": head,
        "rows": [[row.get(name) for name in head] for row in rows],
    }


def plot(
    title: str, axes: tuple[str, str], cases: Sequence[Mapping[str, Any]], x: str, y: str
) -> dict[str, Any]:
    """Curves through the cases, in their order, that have the values.

    `axes` are labels with units; the key `curve` distinguishes the curves and names them.
    """
    series = []
    for name in dict.fromkeys(case["curve"] for case in cases):
        points = [case for case in cases if case["curve"] == name and case.get(y) is not None]
        if points:
            one, other = ([case.get(key) for case in points] for key in (x, y))
            rival = points[0].get("rival", False)
            series.append({"name": name, "x": one, "y": other, "rival": rival})
    return {"title": title, "x": axes[0], "y": axes[1], "series": series}


def body_of(name: str, shown: Mapping[str, Any]) -> tuple[str, dict[str, Figure]]:
    """What stands below the introduction of a benchmark, and its figures by their file names."""
    lines: list[str] = []
    pictures = {}
    plots_of = groupby(shown.get("plots", ()), key=lambda one: one.get("figure", one["title"]))
    for problem, plots in plots_of:
        picture = f"{name}-{'-'.join(re.findall(r'[a-z0-9]+', problem.lower()))}.png"
        pictures[picture] = draw_curves(list(plots))
        lines += ["", f"![error over CPU time: {problem}]({picture})"]
    for entry in shown.get("tables", ()):
        rows = [entry["head"], *([_cell(value) for value in row] for row in entry["rows"])]
        lines += ["", f"{entry['caption']}:", "", *table_lines(rows)]
    return "\n".join(lines) + "\n", pictures


def _cell(value: Any) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return "" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def draw_curves(plots: Sequence[Mapping[str, Any]]) -> Figure:
    """Plots side by side in one figure, with a legend outside, where it hides no point.

    - `plots`: as in `myork.bench`; curves of equal name have the same style in all of them
    """
    drawing = Figure(figsize=(5.0 + 5.0 * len(plots), 5.0), layout="constrained")
    curves = [curve for plot in plots for curve in plot["series"]]
    own, rivals = (
        list(dict.fromkeys(c["name"] for c in curves if c.get("rival", False) == one))
        for one in (False, True)
    )
    shown = {}
    for axes, plot in zip(drawing.subplots(1, len(plots), squeeze=False)[0], plots, strict=True):
        for curve in plot["series"]:
            rival = curve.get("rival", False)
            k = (rivals if rival else own).index(curve["name"])
            (shown[curve["name"]],) = axes.plot(
                curve["x"],
                curve["y"],
                color=_RIVAL if rival else COLOURS[k % len(COLOURS)],
                marker=MARKERS[k % len(MARKERS)],
                markersize=5.5,
                markerfacecolor="none" if rival else None,
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
