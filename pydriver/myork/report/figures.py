"""Figures of a report, drawn off-screen; each function takes arrays and returns a figure.

Colours: Okabe and Ito's palette for lines, viridis for fields; both are distinct to colour-blind
readers (https://jfly.uni-koeln.de/color). Lines differ in marker or dash as well.
"""

from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator

from myork.report.numbers import labelled
from myork.types import F64

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#56B4E9", "#E69F00", "#000000")
#: Colours of labels: six of the palette, then those farthest from all before, in CIELAB, and from
#: black, white, grey and the colours of fibers and of missing values
LABELS = (
    "#D55E00", "#56B4E9", "#009E73", "#CC79A7", "#0072B2", "#E69F00", "#22E622",
    "#2243E6", "#C3E67E", "#99172D", "#736211", "#862699", "#2D9917", "#E6B27E",
    "#5CE6E6", "#5C73E6", "#E62284", "#22E684", "#A4E622", "#733F50",
)  # fmt: skip
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
DASHES = ("-", "--", ":", "-.")
GREY = "#666666"


def panels_of(count: int, **keys: Any) -> tuple[Figure, list[Axes]]:
    """A figure with `count` panels, three in a row; keys are those of `subplots`."""
    columns = min(count, 3)
    rows = -(-count // columns)
    figure = Figure(figsize=(11.0 if columns > 1 else 6.5, 3.4 * rows), layout="constrained")
    found = figure.subplots(rows, columns, squeeze=False, **keys).ravel()
    for axes in found:
        axes.grid(color="#E5E5E5")
    for axes in found[count:]:
        axes.set_visible(False)
    return figure, list(found[:count])


def label_colours(labels: Iterable[int]) -> dict[int, str]:
    """Colour of each label: by its number, so that it is the same in all pictures.

    A colour that a lower label has is replaced by the next free one, if there is any.
    """
    found: dict[int, str] = {}
    for label in sorted(set(labels)):
        order = [LABELS[(label - 1 + more) % len(LABELS)] for more in range(len(LABELS))]
        found[label] = next((one for one in order if one not in found.values()), order[0])
    return found


def draw_strokes(
    axes: Axes, places: F64, vectors: F64, long: float, body: F64 | None = None, **look: Any
) -> None:
    """Strokes without heads centred at places, shape `(n, 2)`, of `long` times the vectors.

    - `body`: triangles of one orientation, to which the strokes are cut, shape `(m, 3, 2)`
    """
    strokes = axes.quiver(
        *places.T, *vectors.T, angles="xy", scale_units="xy", scale=1.0 / long, pivot="mid",
        headwidth=0, headlength=0, headaxislength=0, **look,
    )  # fmt: skip
    if body is not None:
        strokes.set_clip_path(Path.make_compound_path_from_polys(body), axes.transData)


class Series(NamedTuple):
    """Probes over the load steps."""

    name: str  #: Name of the series; empty for the only one of a figure
    #: Steps as in the summary: `load`, `activation`, `probes`, `probe_errors`
    steps: Sequence[Mapping[str, Any]]
    #: Style of its curves, as keys of `Axes.plot`
    look: Mapping[str, Any] = MappingProxyType({})


def probe_figure(
    series: Sequence[Series],
    units: Mapping[str, str],
    reference: Mapping[str, Any] = MappingProxyType({}),
    exact: Mapping[str, Any] = MappingProxyType({}),
) -> Figure:
    """Probes against activation if it changes, otherwise against load, one panel each.

    Estimated errors are drawn as bands. Components of a single series differ in colour, otherwise
    the series do. `units` has the unit of each probe by name; `reference` and `exact` are from the
    summary: open circles, and a star at the last step.
    """
    figure, panels = panels_of(len(units))
    active = any(step.get("activation") for own in series for step in own.steps)
    across = "activation" if active else "load"
    for axes, (name, unit) in zip(panels, units.items(), strict=True):
        for number, own in enumerate(series):
            _draw_series(axes, own, name, across, number if len(series) > 1 else None)
        theirs = reference.get(name, {})
        if theirs.get(across):
            axes.plot(
                theirs[across], theirs["reference"], "o", markersize=9, markerfacecolor="none",
                color=COLOURS[1], label="reference",
            )  # fmt: skip
        answer = exact.get(name, {}).get("reference")
        shown = [step for step in series[0].steps if name in step.get("probes", {})]
        if answer is not None and shown:
            axes.plot(
                shown[-1][across], answer, "*", markersize=14, markerfacecolor="none",
                color=COLOURS[1], label="exact",
            )  # fmt: skip
        axes.set(xlabel=f"{across} [-]", ylabel=labelled(name, unit))
        if len(series) == 1 and len(axes.lines) > 1:
            axes.legend(frameon=False, fontsize="small")
    if len(series) > 1:
        names = [axes.get_legend_handles_labels() for axes in panels]
        found = {label: handle for own in names for handle, label in zip(*own, strict=True)}
        figure.legend(
            found.values(), found, loc="outside upper center", ncols=4, frameon=False
        )  # fmt: skip
    return figure


def _draw_series(axes: Axes, own: Series, name: str, across: str, number: int | None) -> None:
    """Curves of a probe, by components; the number of a series among several gives its colour."""
    shown = [step for step in own.steps if name in step.get("probes", {})]
    places = np.array([step.get(across) for step in shown], dtype=float)
    values = _as_columns([step["probes"][name] for step in shown])
    bars = _as_columns([step.get("probe_errors", {}).get(name) for step in shown], values.shape[1])
    for part in range(values.shape[1]):
        kind = part if number is None else number
        dash = DASHES[part if number is None or values.shape[1] > 1 else number % len(DASHES)]
        word = own.name or ("computed" if values.shape[1] == 1 else "xyz"[part])
        colour = COLOURS[kind % len(COLOURS)]
        look = {
            "color": colour, "linestyle": dash, "marker": MARKERS[kind % len(MARKERS)],
            "markersize": 4, "label": word if number is None or part == 0 else "_", **own.look,
        }  # fmt: skip
        axes.plot(places, values[:, part], **look)
        value, bar = values[:, part], bars[:, part]
        if len(places) == 1:
            axes.errorbar(places, value, bar, color=look["color"], capsize=5)
        else:
            axes.fill_between(
                places, value - bar, value + bar, color=look["color"], alpha=0.2, linewidth=0
            )


def rom_series(rom: Mapping[str, Any]) -> list[Series]:
    """Probes of the full solution as a line, those of the reduced models as markers on it.

    `rom` is the entry of the summary: `full` with `load` and `probes`, and `models` with `probes`.
    """
    load = rom["full"]["load"]

    def steps(probes: Mapping[str, Any]) -> list[dict[str, Any]]:
        return [
            {"load": at, "probes": {name: own[k] for name, own in probes.items()}}
            for k, at in enumerate(load)
        ]

    found = [Series("full", steps(rom["full"].get("probes", {})), {"color": "black", "marker": ""})]
    for number, model in enumerate(rom.get("models", [])):
        look = {
            "linestyle": "none", "markerfacecolor": "none", "color": COLOURS[number % 6],
            "marker": MARKERS[number % len(MARKERS)], "markersize": 6 + 2 * (number % 3),
        }  # fmt: skip
        found.append(Series(f"r = {model['r']}", steps(model.get("probes", {})), look))
    return found


def _as_columns(values: Sequence[Any], width: int = 1) -> F64:
    """Numbers, lists of numbers and missing values as an array of shape `(n, components)`."""
    width = max([width, *(len(value) for value in values if isinstance(value, list))])
    rows = [np.broadcast_to(np.array(value, dtype=float), width) for value in values]
    return np.array(rows).reshape(-1, width)


def decay_figure(rom: Mapping[str, Any]) -> Figure:
    """Decay of the modes, from the entry `rom` of the summary, on a logarithmic scale."""
    figure, (decay,) = panels_of(1)
    pov = np.asarray(rom.get("pov", []), dtype=float)
    if pov.size and pov[0] > 0.0:
        relative = np.where(pov > 0.0, pov / pov[0], np.nan)
        decay.semilogy(np.arange(1, len(pov) + 1), relative, "o-", color=COLOURS[0], markersize=4)
        for model in rom.get("models", []):
            decay.axvline(model["r"], color=GREY, linewidth=0.8, linestyle=":")
        decay.xaxis.set_major_locator(MaxNLocator(integer=True))
    decay.set(xlabel="mode (dotted: sizes used)", ylabel="orthogonal value / first [-]")
    decay.minorticks_off()
    return figure
