"""Figures of a sweep: trends, a tornado of effects, response surfaces; and their polynomials."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from myork.report.figures import panels_of
from myork.report.numbers import labelled
from myork.types import F64

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
