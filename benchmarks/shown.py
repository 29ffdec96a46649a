"""Tables and plots of a benchmark from its cases, by the names of the columns and axes."""

from collections.abc import Mapping, Sequence
from typing import Any


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
