"""The page of a sweep: dependence of the answers on the keys, and failed points."""

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

import myork
from myork.errors import FileError
from myork.report.figures import panels_of
from myork.report.frame import Answer, Page, Section, figure, table
from myork.report.numbers import DASH, fraction, labelled, number, plain, unit_of
from myork.types import F64

#: File of finished points, which identifies the folder of a sweep
SWEEP_FILE = "points.jsonl"
#: Largest number of probes, keys, and kinds of messages shown
_MOST_PROBES, _MOST_KEYS, _MOST_ROWS = 6, 8, 60
#: Colour and marker of the points of each verdict
VERDICTS = {
    "accepted": ("#0072B2", "o"),
    "doubtful": ("#E69F00", "^"),
    "refused": ("#D55E00", "X"),
    "failed": ("#000000", "x"),
}


class Column(NamedTuple):
    """A column of the table of a sweep."""

    #: Its header
    name: str
    unit: str
    values: list[Any]  #: One value per finished point; words for a key that takes words
    errors: Sequence[float] = ()  #: Error bars; empty for a key

    def numbers(self) -> F64 | None:
        """The values, or None where one is not a number."""
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values):
            return np.array(self.values, float)
        return None


def trend_figure(keys: Sequence[Column], probe: Column, verdicts: Sequence[str]) -> Figure:
    """A probe over each key with the verdicts of its points; words are placed side by side."""
    figure, panels = panels_of(len(keys), sharey=True)
    y = np.array(probe.values, float)
    bars = np.array(probe.errors or np.full(len(y), np.nan), float)
    given = np.array(verdicts)
    for axes, key in zip(panels, keys, strict=True):
        x = key.numbers()
        if x is None:
            words = list(dict.fromkeys(map(str, key.values)))
            x = np.array([words.index(str(value)) for value in key.values], float)
            axes.set_xticks(range(len(words)), words)
        if len(keys) == 1 and len(np.unique(x)) == len(x):
            order = np.argsort(x)
            axes.plot(x[order], y[order], color="#BBBBBB", linewidth=1.0, zorder=1)
        for verdict in dict.fromkeys(verdicts):
            colour, mark = VERDICTS.get(verdict, ("#666666", "."))
            own = given == verdict
            if np.isfinite(y[own]).any():
                axes.errorbar(
                    x[own], y[own], np.nan_to_num(bars[own]), fmt=mark, color=colour,
                    markersize=4.5, elinewidth=0.8, label=verdict,
                )  # fmt: skip
        axes.set_xlabel(key.name)
    for axes in panels[::3]:
        axes.set_ylabel(labelled(probe.name, probe.unit))
    handles, names = panels[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper right", ncols=4, frameon=False)
    return figure


class SweepFolder(NamedTuple):
    """Finished points of a sweep."""

    path: Path  #: The folder
    total: int  #: Number of requested points
    #: Varied keys and results, one value per finished point
    keys: list[Column]
    probes: list[Column]
    #: One entry per finished point
    verdicts: list[str]
    messages: list[str]
    cpu: list[float]  #: CPU time of each finished point [s]
    #: `sweep.json`: title of the deck, units of the columns, name of the reduced model
    about: dict[str, Any]

    @property
    def left(self) -> int:
        """Number of points that are not solved yet."""
        return self.total - len(self.verdicts)


def read_sweep(path: Path) -> SweepFolder:
    """Read the finished points of a sweep; a line truncated by a kill is left out.

    - raises FileError: the file is not that of a sweep, or it has no finished point
    """
    file = path / SWEEP_FILE
    try:
        first, *lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
        head = json.loads(first)["sweep"]
        names, points = [str(key) for key in head["keys"]], head["points"]
        found: dict[int, dict[str, Any]] = {}
        for line in lines:
            with suppress(ValueError, KeyError, TypeError):
                row = json.loads(line)
                found[int(row["point"])] = row
        rows = [found[place] for place in sorted(found)]
        values = [points[row["point"]] for row in rows]
        about = {}
        if (path / "sweep.json").is_file():
            about = json.loads((path / "sweep.json").read_text(encoding="utf-8"))
        units = about.get("units") or {}
        keys = [Column(name, "", [value[j] for value in values]) for j, name in enumerate(names)]
        asked = dict.fromkeys(name for row in rows for name in row["probes"])
        probes = [
            Column(
                name,
                unit_of(units, name, ""),
                [row["probes"].get(name, np.nan) for row in rows],
                [row["errors"].get(name, np.nan) for row in rows],
            )
            for name in asked
        ]
        sweep = SweepFolder(
            path, len(points), keys, probes,
            [str(row["verdict"]) for row in rows], [str(row["message"]) for row in rows],
            [float(row["cpu_s"]) for row in rows], about,
        )  # fmt: skip
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as reason:
        raise FileError(
            f"{file}: is not a table written by myork sweep: {reason!r}; run the sweep again"
        ) from None
    if not sweep.verdicts:
        raise FileError(f"{file}: no point is finished; run the same line of myork sweep again")
    return sweep


def sweep_page(sweep: SweepFolder) -> Page:
    """A sweep as one page."""
    badges = [(_BADGES.get(word, "bad"), f"{count} {word}") for word, count in _counts(sweep)]
    return Page(
        title=f"Sweep: {sweep.about.get('title') or sweep.path.resolve().name}",
        sections=(
            Section("trends", "Trends", _trends(sweep)),
            Section("failures", "What to look at", _failures(sweep)),
        ),
        badges=[*badges, *([("unsure", f"{sweep.left} to do")] if sweep.left else [])],
        story=_story(sweep),
        footer=Markup(
            "MyoRK {} · made by <code>myork report</code> from <code>points.jsonl</code> in\n"
            "<code>{}</code>; all numbers: <code>sweep.csv</code>"
        ).format(myork.__version__, sweep.path),
    )


_BADGES = {"accepted": "good", "doubtful": "unsure"}


def _counts(sweep: SweepFolder) -> list[tuple[str, int]]:
    counts = Counter(sweep.verdicts)
    order = [*VERDICTS, *sorted(set(counts) - set(VERDICTS))]
    return [(word, counts[word]) for word in order if counts[word]]


def _story(sweep: SweepFolder) -> Iterator[Answer]:
    ranges = []
    for key in sweep.keys:
        values = key.numbers()
        if values is None:
            ranges.append(f"{key.name}: {', '.join(dict.fromkeys(map(str, key.values)))}")
        else:
            ranges.append(f"{key.name} from {fraction(values.min())} to {fraction(values.max())}")
    model = sweep.about.get("model")
    who = f"the reduced model {model}" if model else "full solutions"
    yield Answer("Problem", [f"{sweep.total} points by {who}", "; ".join(ranges)])
    found: list[Markup] = []
    for probe in sweep.probes[:_MOST_PROBES]:
        values = np.array(probe.values, float)
        values = values[np.isfinite(values)]
        if len(values):
            found.append(
                Markup("<b>{}</b> from {} to {} {}").format(
                    probe.name, number(float(values.min())), number(float(values.max())), probe.unit
                )
            )
    seconds = np.array(sweep.cpu, float)
    seconds = seconds[np.isfinite(seconds)]
    cost = Markup("{} CPU s in all, {} s per point").format(
        number(float(seconds.sum()), 3),
        number(float(np.median(seconds)) if len(seconds) else None, 3),
    )
    yield Answer("Results", [Markup(", ").join(found) or "nothing", cost])
    counts = _counts(sweep)
    lines: list[str | Markup] = [
        ", ".join(f"{count} {word}" for word, count in counts)
        + f" of {len(sweep.verdicts)} finished points"
    ]
    if sweep.left:
        lines.append(f"{sweep.left} points are not solved yet")
    # a component that is zero by symmetry has the size of the others of its kind
    sizes: dict[str, float] = {}
    for probe in sweep.probes:
        sizes[probe.unit] = max(sizes.get(probe.unit, 0.0), _largest(probe.values))
    bars = [
        _largest(probe.errors) / sizes[probe.unit]
        for probe in sweep.probes
        if np.isfinite(probe.errors).any() and sizes[probe.unit] > 0.0
    ]
    if bars:
        lines.append(
            Markup("Error bars: at most {} % of the largest value of their unit").format(
                number(100.0 * max(bars), 2)
            )
        )
    yield Answer("Reliability", lines)


def _largest(values: Sequence[float]) -> float:
    """Largest magnitude among the values that are numbers."""
    return float(np.nanmax(np.abs(values), initial=0.0))


def _trends(sweep: SweepFolder) -> Iterator[Markup]:
    keys = sweep.keys[:_MOST_KEYS]
    for probe in sweep.probes[:_MOST_PROBES]:
        if np.isfinite(np.array(probe.values, float)).any():
            drawn = trend_figure(keys, probe, sweep.verdicts)
            yield figure(
                drawn,
                f"{probe.name} over each key; a mark a point, in the colour of its verdict, "
                "with its error bar.",
            )


def _failures(sweep: SweepFolder) -> Iterator[Markup]:
    wrong = [k for k, verdict in enumerate(sweep.verdicts) if verdict != "accepted"]
    if not wrong:
        return
    # messages that differ only in their numbers: listed once
    kinds = Counter(_kind(sweep.messages[k]) for k in wrong)
    if len(kinds) > _MOST_ROWS:
        yield Markup("<p>The first {} of {} messages.</p>").format(_MOST_ROWS, len(kinds))
    rows = []
    for kind, count in kinds.most_common(_MOST_ROWS):
        first = next(k for k in wrong if _kind(sweep.messages[k]) == kind)
        where = ", ".join(f"{key.name} = {plain(key.values[first])}" for key in sweep.keys)
        rows.append((sweep.verdicts[first], number(count), where, sweep.messages[first] or DASH))
    yield Markup('<div class="facts">{}</div>').format(
        table(("verdict", "points", "first at", "message"), rows, "Points that are not accepted")
    )


def _kind(message: str) -> str:
    return re.sub(r"[-+]?\d[\d.eE+-]*", "#", message)
