"""The page of a sweep: how the answers follow the keys, which key matters, what failed.

Its figures are trends, a tornado of effects and response surfaces, these two by polynomials.
"""

import json
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.figure import Figure

import myork
from myork.errors import FileError
from myork.report.figures import panels_of
from myork.report.frame import Answer, Page, Section, figure, folded, table
from myork.report.numbers import DASH, fraction, labelled, number, plain, unit_of
from myork.types import F64

#: Finished points of a sweep, by which its folder is known
SWEEP_FILE = "points.jsonl"
#: Probes, keys, and rows of tables that are shown
_MOST_PROBES, _MOST_KEYS, _MOST_ROWS = 6, 8, 60
#: Colour and mark of the points of each verdict
VERDICTS = {
    "accepted": ("#0072B2", "o"),
    "doubtful": ("#E69F00", "^"),
    "refused": ("#D55E00", "X"),
    "failed": ("#000000", "x"),
}
_FALLING, _RISING = "#D55E00", "#0072B2"
#: Points a term of a polynomial needs
_POINTS_A_TERM = 1.5


@dataclass(frozen=True)
class Column:
    """A column of the table of a sweep."""

    #: Its head
    name: str
    unit: str
    values: list[Any]  #: A value a finished point; words for a key that takes words
    errors: list[float]  #: Error bars; empty for a key

    def numbers(self) -> F64 | None:
        """The values, or nothing where one is not a number."""
        if all(isinstance(v, int | float) and not isinstance(v, bool) for v in self.values):
            return np.array(self.values, float)
        return None

    def largest_bar(self) -> float | None:
        """Largest error bar, of the largest value."""
        bars, size = np.array(self.errors, float), np.abs(np.array(self.values, float))
        bars, size = bars[np.isfinite(bars)], size[np.isfinite(size)]
        if not len(bars) or not len(size) or not size.max() > 0.0:
            return None
        return float(bars.max() / size.max())


@dataclass(frozen=True)
class Fit:
    """A polynomial of degree 1 or 2 in all numeric keys, through the values of a probe."""

    probe: Column  #: What it follows
    keys: list[Column]  #: Numeric keys that vary
    degree: int  #: 2 where there are points enough, else 1
    coefficients: F64  #: One a term
    #: Part of the variance predicted for points left out one at a time, 1 is all [-]
    predicted: float

    @classmethod
    def of(cls, keys: Sequence[Column], probe: Column) -> "Fit | None":
        """The polynomial, or nothing where points are too few or the probe does not change."""
        varied = [key for key in keys if (v := key.numbers()) is not None and np.ptp(v) > 0.0]
        y = np.array(probe.values, float)
        known = np.isfinite(y)
        if not varied or known.sum() < 3 or not np.ptp(y[known]) > 0.0:
            return None
        places = np.stack([_scaled(key) for key in varied], axis=1)[known]
        for degree in (2, 1):
            rows = _terms(places, degree)
            enough = len(rows) >= _POINTS_A_TERM * rows.shape[1]
            if enough and np.linalg.matrix_rank(rows) == rows.shape[1]:
                break
        else:
            return None
        found = np.linalg.lstsq(rows, y[known], rcond=None)[0]
        left = y[known] - rows @ found
        # residual of each point where it is left out, by the diagonal of the projection
        own = np.clip(np.sum(np.linalg.qr(rows)[0] ** 2, axis=1), 0.0, 1.0 - 1e-9)
        predicted = 1.0 - float(
            np.sum((left / (1.0 - own)) ** 2) / np.sum((y[known] - y[known].mean()) ** 2)
        )
        return cls(probe, varied, degree, found, predicted)

    def at(self, places: F64) -> F64:
        """Values at places scaled to -1..1, shape `(n, keys)`."""
        return np.asarray(_terms(places, self.degree) @ self.coefficients)

    def effects(self) -> list[tuple[float, float]]:
        """Value at the lowest and the highest end of each key, others in the middle."""
        ends = []
        for j in range(len(self.keys)):
            place = np.zeros((2, len(self.keys)))
            place[:, j] = [-1.0, 1.0]
            low, high = self.at(place)
            ends.append((float(low), float(high)))
        return ends

    def middle(self) -> float:
        """Value with all keys in the middle of their ranges."""
        return float(self.at(np.zeros((1, len(self.keys))))[0])

    def strongest(self) -> list[int]:
        """The two keys whose ends differ most."""
        size = [abs(high - low) for low, high in self.effects()]
        return [int(j) for j in np.argsort(size)[::-1][:2]]


def _scaled(key: Column) -> F64:
    values = np.array(key.values, float)
    return np.asarray(2.0 * (values - values.min()) / np.ptp(values) - 1.0)


def _terms(places: F64, degree: int) -> F64:
    """Monomials up to a degree, shape `(n, terms)`."""
    parts = [np.ones(len(places))]
    for order in range(1, degree + 1):
        for own in combinations_with_replacement(range(places.shape[1]), order):
            parts.append(np.prod(places[:, own], axis=1))
    return np.stack(parts, axis=1)


def trend_figure(keys: Sequence[Column], probe: Column, verdicts: Sequence[str]) -> Figure:
    """A probe over each key with the verdicts of its points; words stand side by side."""
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


def tornado_figure(fits: Sequence[Fit]) -> Figure:
    """Effect of each key on each probe by its polynomial, the largest on top."""
    columns = min(len(fits), 2)
    rows = -(-len(fits) // columns)
    high = 1.3 + 0.42 * max(len(fit.keys) for fit in fits)
    figure = Figure(figsize=(11.0 if columns > 1 else 7.5, high * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False).ravel()
    for axes, fit in zip(panels, fits, strict=False):
        ends = fit.effects()
        order = np.argsort([abs(high - low) for low, high in ends])
        middle = fit.middle()
        for place, j in enumerate(order):
            for end, value, colour in zip("↓↑", ends[j], (_FALLING, _RISING), strict=True):
                axes.barh(place, value - middle, left=middle, color=colour, height=0.6)
                near = value >= middle
                axes.annotate(
                    end, (value, place), xytext=(3 if near else -3, 0), va="center",
                    textcoords="offset points", ha="left" if near else "right", fontsize=8,
                )  # fmt: skip
        axes.axvline(middle, color="black", linewidth=0.8)
        axes.set_yticks(range(len(order)), [fit.keys[j].name for j in order])
        axes.margins(x=0.12)
        axes.ticklabel_format(axis="x", useOffset=False)
        label = labelled(fit.probe.name, fit.probe.unit)
        axes.set_xlabel(f"{label} (↓ key at its lowest, ↑ at its highest)")
        axes.set_title(f"degree {fit.degree}, Q² = {fit.predicted:.3f}", fontsize=10)
        for side in ("top", "right", "left"):
            axes.spines[side].set_visible(False)
    for axes in panels[len(fits) :]:
        axes.set_visible(False)
    return figure


def response_figure(fit: Fit, verdicts: Sequence[str]) -> Figure:
    """A probe by its polynomial over the two keys that matter most, and the points."""
    across, up = fit.strongest()
    line = np.linspace(-1.0, 1.0, 61)
    a, b = np.meshgrid(line, line)
    places = np.zeros((a.size, len(fit.keys)))
    places[:, across], places[:, up] = a.ravel(), b.ravel()
    value = fit.at(places).reshape(a.shape)
    x, y = (np.array(fit.keys[j].values, float) for j in (across, up))
    figure = Figure(figsize=(7.0, 4.6), layout="constrained")
    axes = figure.subplots()
    shape = tuple(np.interp(line, [-1.0, 1.0], [v.min(), v.max()]) for v in (x, y))
    drawn = axes.contourf(*shape, value, levels=12, cmap="viridis")
    lines = axes.contour(
        *shape, value, levels=np.asarray(drawn.levels)[::3], colors="white", linewidths=0.6
    )
    axes.clabel(lines, fontsize=8)
    given = np.array(verdicts)
    for verdict in dict.fromkeys(verdicts):
        own = given == verdict
        mark = VERDICTS.get(verdict, ("", "."))[1]
        axes.plot(
            x[own], y[own], mark, color="white", markeredgecolor="black", markersize=4.5,
            label=verdict, linestyle="none",
        )  # fmt: skip
    axes.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=4, frameon=False)
    axes.set(xlabel=fit.keys[across].name, ylabel=fit.keys[up].name)
    figure.colorbar(drawn, ax=axes, label=labelled(fit.probe.name, fit.probe.unit))
    return figure


class SweepFolder(NamedTuple):
    """Finished points of a sweep."""

    path: Path  #: The folder
    total: int  #: Number of points that were asked for
    #: What was varied and what came out, a value a finished point
    keys: list[Column]
    probes: list[Column]
    #: Of each finished point
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
    """Read what is finished of a sweep; a line that a kill cut short is left out.

    - raises FileError: the file is not that of a sweep, or nothing in it is finished
    """
    file = path / SWEEP_FILE
    try:
        first, *lines = file.read_text(encoding="utf-8", errors="replace").splitlines()
        head = json.loads(first)["sweep"]
        names, points = [str(key) for key in head["keys"]], head["points"]
        found: dict[int, dict[str, Any]] = {}
        for line in lines:
            try:
                row = json.loads(line)
                found[int(row["point"])] = row
            except (ValueError, KeyError, TypeError):
                continue
        rows = [found[place] for place in sorted(found)]
        values = [points[row["point"]] for row in rows]
        about = {}
        if (path / "sweep.json").is_file():
            about = json.loads((path / "sweep.json").read_text(encoding="utf-8"))
        units = about.get("units") or {}
        keys = [
            Column(name, "", [value[j] for value in values], []) for j, name in enumerate(names)
        ]
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
            f"{file}: is not what myork sweep writes: {reason!r}; run the sweep again"
        ) from None
    if not sweep.verdicts:
        raise FileError(f"{file}: no point is finished; run the same line of myork sweep again")
    return sweep


def sweep_page(sweep: SweepFolder) -> Page:
    """All of a sweep as one page."""
    fits = [Fit.of(sweep.keys[:_MOST_KEYS], probe) for probe in sweep.probes[:_MOST_PROBES]]
    badges = [(_BADGES.get(word, "bad"), f"{count} {word}") for word, count in _counts(sweep)]
    return Page(
        title=f"Sweep: {sweep.about.get('title') or sweep.path.resolve().name}",
        sections=(
            Section("trends", "Trends", _trends(sweep)),
            Section("effects", "Which key matters", _effects(fits)),
            Section("surfaces", "Response surfaces", _surfaces(sweep, fits)),
            Section("failures", "What to look at", _failures(sweep)),
            Section("points", "All points", _points(sweep)),
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
    bars = [bar for probe in sweep.probes if (bar := probe.largest_bar()) is not None]
    if bars:
        lines.append(
            Markup("Error bars: {} % of the largest value at most").format(
                number(100.0 * max(bars), 2)
            )
        )
    yield Answer("Reliability", lines)


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


def _effects(fits: list[Fit | None]) -> Iterator[Markup]:
    shown = [fit for fit in fits if fit is not None]
    if shown:
        yield figure(
            tornado_figure(shown),
            "Change of each probe from the lowest to the highest value of a key, all others in "
            "the middle, by a polynomial through the points; its degree and the part of the "
            "variance that it predicts for points left out (Q²) stand above.",
        )


def _surfaces(sweep: SweepFolder, fits: list[Fit | None]) -> Iterator[Markup]:
    for fit in fits:
        if fit is not None and fit.degree == 2 and len(fit.strongest()) == 2:
            yield figure(
                response_figure(fit, sweep.verdicts),
                f"{fit.probe.name} over the two keys that matter most, all others in the middle, "
                "by the same polynomial; marks are points of the sweep.",
            )


def _failures(sweep: SweepFolder) -> Iterator[Markup]:
    wrong = [k for k, verdict in enumerate(sweep.verdicts) if verdict != "accepted"]
    if not wrong:
        return
    # alike but for their numbers: listed once
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


def _points(sweep: SweepFolder) -> Iterator[Markup]:
    head = [key.name for key in sweep.keys]
    head += [labelled(probe.name, probe.unit) for probe in sweep.probes]
    rows = [
        [
            *(plain(key.values[k]) for key in sweep.keys),
            *(number(float(probe.values[k])) for probe in sweep.probes),
            verdict,
        ]
        for k, verdict in enumerate(sweep.verdicts[:_MOST_ROWS])
    ]
    caption = (
        f"The first {len(rows)} points; all: sweep.csv" if len(rows) < sweep.total else "Points"
    )
    yield folded(caption, table([*head, "verdict"], rows))
