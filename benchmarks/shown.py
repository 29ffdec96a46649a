"""Tables and plots of a benchmark from its cases, by the names of what they show."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

#: What is shown of a case: a key (`"solver.used"` or a tuple of keys of a mapping within), or a
#: function of the case
Shown = str | tuple[str, ...] | Callable[[Mapping[str, Any]], Any]

#: Head of each column with what it shows
Columns = Sequence[tuple[str, Shown]]


def table(caption: str, columns: Columns, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Table with a line a case; what a case has not stays empty."""
    return {
        "caption": caption,
        "head": [head for head, _ in columns],
        "rows": [[entry_of(case, key) for _, key in columns] for case in cases],
    }


def plot(
    title: str,
    axes: tuple[str, str],
    cases: Sequence[Mapping[str, Any]],
    x: Shown,
    y: Shown,
    by: str = "curve",
) -> dict[str, Any]:
    """Curves through the cases, in their order, that have a value to show.

    `axes` are labels with units; the key `by` distinguishes the curves and names them.
    """
    series = []
    for name in dict.fromkeys(case[by] for case in cases):
        points = [case for case in cases if case[by] == name and entry_of(case, y) is not None]
        if points:
            one, other = ([entry_of(case, key) for case in points] for key in (x, y))
            rival = points[0].get("rival", False)
            series.append({"name": name, "x": one, "y": other, "rival": rival})
    return {"title": title, "x": axes[0], "y": axes[1], "series": series}


def entry_of(case: Mapping[str, Any], key: Shown) -> Any:
    """What is shown of a case, None where it has it not; numbers of a key are places of a list."""
    if callable(key):
        return key(case)
    value: Any = case
    for part in key.split(".") if isinstance(key, str) else key:
        if isinstance(value, Sequence) and part.isdigit():
            value = value[int(part)] if int(part) < len(value) else None
        else:
            value = value.get(part) if isinstance(value, Mapping) else None
    return value
