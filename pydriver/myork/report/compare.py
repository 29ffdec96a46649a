"""Two or more runs on one page: what differs in their decks, their answers, their cost."""

from collections.abc import Iterator, Sequence
from typing import Any

from markupsafe import Markup

import myork
from myork.errors import FileError
from myork.report.bodies import compared_figure
from myork.report.figures import Series, probe_figure
from myork.report.frame import Answer, Page, Section, figure, table
from myork.report.numbers import DASH, fraction, labelled, number, plain, probe_units, with_error
from myork.report.sources import RunFolder
from myork.report.tables import run_table
from myork.summary import printed, read_summary
from myork.tables import differing_keys

#: Keys of decks that differ, and probes, that are shown
_MOST_KEYS, _MOST_PROBES = 40, 9
#: Bodies side by side
_MOST_BODIES = 4
#: Differences this small are rounding [-]
_SAME = 1e-9


def compare_page(runs: Sequence[RunFolder]) -> Page:
    """All runs side by side, the first being what the others are compared with."""
    for run in runs:
        if not run.summary.get("steps"):
            raise FileError(f"{run.path}: has no load steps to compare; solve its deck first")
    names = _names(runs)
    return Page(
        title=f"{len(runs)} runs side by side",
        sections=(
            Section("answers", "Answers", _answers(runs, names)),
            Section("bodies", "Deformed bodies", _bodies(runs, names)),
            Section("curves", "On the way", _curves(runs, names)),
            Section("decks", "What differs in the decks", _decks(runs, names)),
            Section("cost", "Sizes and cost", _cost(runs, names)),
        ),
        story=_story(runs, names),
        footer=Markup("MyoRK {} · made by <code>myork report {}</code>").format(
            myork.__version__, " ".join(str(run.path) for run in runs)
        ),
    )


def _names(runs: Sequence[RunFolder]) -> list[str]:
    """Folders by the last part of their paths that distinguishes them."""
    parts = [run.path.resolve().parts for run in runs]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(own[-count:]) for own in parts]
        if len(set(names)) == len(names):
            return names
    raise FileError(f"{runs[0].path}: is named twice; compare different folders")


def _last(run: RunFolder) -> dict[str, Any]:
    return dict(run.summary["steps"][-1])


def _probe(run: RunFolder, name: str) -> tuple[Any, Any]:
    """The last value of a probe and its error bar, None where there is none."""
    return tuple(_last(run).get(part, {}).get(name) for part in ("probes", "probe_errors"))


def _probes(runs: Sequence[RunFolder]) -> dict[str, str]:
    """Units of the probes of any run, by name."""
    found: dict[str, str] = {}
    for run in runs:
        for name, unit in probe_units(run.summary).items():
            found.setdefault(name, unit)
    return dict(list(found.items())[:_MOST_PROBES])


def _story(runs: Sequence[RunFolder], names: Sequence[str]) -> Iterator[Answer]:
    titles = [str(run.summary.get("title") or name) for run, name in zip(runs, names, strict=True)]
    same = len(set(titles)) == 1
    different = [
        f"{name}: {title}, {run.summary.get('method', '?')}"
        for name, title, run in zip(names, titles, runs, strict=True)
    ]
    yield Answer("Problem", [titles[0], *names] if same else ["Different problems", *different])
    lines: list[str | Markup] = []
    outside = []
    for name, unit in _probes(runs).items():
        values = [_probe(run, name)[0] for run in runs]
        numbers = [v for v in values if isinstance(v, int | float)]
        if len(numbers) < 2:
            continue
        size = max(abs(v) for v in numbers)
        spread = (max(numbers) - min(numbers)) / size if size else 0.0
        lines.append(
            Markup("{} from {} to {} {}: {}").format(
                name, number(min(numbers)), number(max(numbers)), unit,
                "the same" if spread < _SAME else Markup("{} % apart").format(
                    number(100.0 * spread, 2)),
            )
        )  # fmt: skip
        outside += [name] if _disagree(runs, name) else []
    yield Answer("Results", lines or ["no probe is common to two of them"])
    units = {tuple(sorted(run.summary.get("units", {}).items())) for run in runs}
    trust: list[str | Markup] = [
        "; ".join(
            f"{name} {run.summary.get('verdict', {}).get('state', 'without verdict')}"
            if run.summary.get("converged")
            else f"{name} not converged"
            for name, run in zip(names, runs, strict=True)
        )
    ]
    if len(units) > 1:
        trust.insert(0, "The runs have different units: their numbers cannot be compared")
    elif outside:
        trust.append(f"Further apart than their error bars: {', '.join(outside)}")
    elif any(_last(run).get("probe_errors") for run in runs):
        trust.append("All numbers agree within their error bars")
    yield Answer("Reliability", trust)


def _disagree(runs: Sequence[RunFolder], name: str) -> bool:
    """Whether two runs are further apart than the sum of their error bars."""
    found = []
    for run in runs:
        value, bar = _probe(run, name)
        if isinstance(value, int | float):
            bar = float(bar) if isinstance(bar, int | float) else 0.0
            found.append((float(value), bar))
    return any(
        abs(a - b) > (bar + other) + _SAME * max(abs(a), abs(b))
        for k, (a, bar) in enumerate(found)
        for b, other in found[k + 1 :]
    )


def _answers(runs: Sequence[RunFolder], names: Sequence[str]) -> Iterator[Markup]:
    rows: list[list[str | Markup]] = [
        ["verdict", *(run.summary.get("verdict", {}).get("state", DASH) for run in runs)],
        ["load reached", *(fraction(_last(run).get("load")) for run in runs)],
    ]
    for name, unit in _probes(runs).items():
        first, _ = _probe(runs[0], name)
        row: list[str | Markup] = [labelled(name, unit)]
        for run in runs:
            value, bar = _probe(run, name)
            cell = with_error(printed(_last(run)).get(name), bar)
            if run is not runs[0] and isinstance(value, int | float) and first:
                change = 100.0 * (value - first) / abs(first)
                cell = Markup("{}<br><small>{}{} %</small>").format(
                    cell, "+" if change >= 0.0 else "", number(change, 2)
                )
            row.append(cell)
        rows.append(row)
    for key, label in (("min_J", "smallest J"), ("max_J", "largest J")):
        rows.append([label, *(number(_last(run).get(key), 3) for run in runs)])
    rows.append(
        ["force imbalance", *(number(run.summary.get("force_imbalance"), 2) for run in runs)]
    )
    shown = [row for row in rows if any(cell != DASH for cell in row[1:])]
    yield table(("", *names), shown, "At the last load; per cent: from the first run")


def _bodies(runs: Sequence[RunFolder], names: Sequence[str]) -> Iterator[Markup]:
    """The bodies of the first runs, if they are all plane or all in space."""
    own = [
        (run.deformation, name)
        for run, name in zip(runs, names, strict=True)
        if run.deformation is not None and len(run.deformation.loads) > 1
    ][:_MOST_BODIES]
    kinds = {deformation.is_plane for deformation, _ in own}
    units = [run.summary.get("units", {}) for run in runs]
    if len(own) < 2 or len(kinds) > 1 or any(other != units[0] for other in units):
        return
    deformations, shown = zip(*own, strict=True)
    caption = (
        "Last load of each run, deformed to scale; undeformed edges in grey. Colours, view and "
        "scale are the same for all."
    )
    if len(own) < len(runs):
        caption += f" {len(own)} of {len(runs)} runs."
    yield figure(compared_figure(deformations, shown, units[0]), caption)


def _curves(runs: Sequence[RunFolder], names: Sequence[str]) -> Iterator[Markup]:
    units = _probes(runs)
    if units:
        series = [Series(name, run.summary["steps"]) for run, name in zip(runs, names, strict=True)]
        yield figure(probe_figure(series, units), "Probes of all runs. Bands: estimated errors.")


def _decks(runs: Sequence[RunFolder], names: Sequence[str]) -> Iterator[Markup]:
    """Keys whose values are not those of all; of a list, its entries by their names."""
    first, *others = (read_summary(run.path).get("deck") or {} for run in runs)
    changes = [differing_keys(first, other) for other in others]
    rows = []
    for key in dict.fromkeys(key for change in changes for key in change):
        own = next(change[key][0] for change in changes if key in change)
        values = [own, *(change.get(key, (own, own))[1] for change in changes)]
        rows.append([key, *(plain(value) for value in values)])
    if not rows:
        yield Markup("<p>Nothing: all keys have the same values.</p>")
        return
    more = f"; {len(rows) - _MOST_KEYS} more" if len(rows) > _MOST_KEYS else ""
    yield table(("key", *names), rows[:_MOST_KEYS], f"Keys with different values{more}")


def _cost(runs: Sequence[RunFolder], names: Sequence[str]) -> Iterator[Markup]:
    yield run_table([run.summary for run in runs], names)
    times = [run.summary.get("timings_s", {}) for run in runs]
    stages = dict.fromkeys(stage for own in times for stage in own)
    rows = [[f"{stage} [s]", *(number(own.get(stage), 3) for own in times)] for stage in stages]
    yield table(("", *names), rows, "Wall times of the full solutions")
