"""Bodies side by side, in one view: runs, and a reduced model beside the full one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from myork.reduced_fields import ReducedFields
from myork.report.numbers import unit_of
from myork.report.sketch import (
    draw_bar,
    draw_ruler,
    draw_triad,
    frame_of,
    limits_of,
    rim_of,
    shade_plane,
    views_of,
)
from myork.report.sources import Deformation
from myork.report.surface import Panel, show
from myork.types import F64

__all__ = ["compared_figure", "reduced_figure"]


#: Colours of sizes of differences and of differences with a sign
_SIZES, _SIGNED = "magma", "coolwarm"


def compared_figure(
    deformations: Sequence[Deformation], names: Sequence[str], units: Mapping[str, str]
) -> Figure:
    """Bodies side by side: displacement and stress, one view and one scale for all.

    Parameters
    ----------
    deformations : sequence of Deformation
        Last states, all plane or all in space.
    names : sequence of str
        Of the runs.
    units : Mapping
        Units of the summaries, keys `length` and `stress`.

    Returns
    -------
    Figure
        A column a run.
    """
    bodies = [Panel(own.points, own.points + own.displacement, own.surface) for own in deformations]
    fields = (
        [np.linalg.norm(own.displacement, axis=1) for own in deformations],
        [own.stress for own in deformations],
    )
    rows = [_in_one_scale(bodies, values) for values in fields]
    figure, grid = _beside(rows, names, units.get("length", "?"), 1)
    for axes, shades, title in zip(grid, rows, _titles(units), strict=True):
        draw_bar(figure, list(axes), shades[0].limits, wide=True).set_label(title)
    return figure


def reduced_figure(fields: ReducedFields, model: int, units: Mapping[str, str]) -> Figure:
    """A reduced model beside the full one, and their difference: displacement and stress.

    Parameters
    ----------
    fields : ReducedFields
        States of the full model and of its reduced ones.
    model : int
        Which of the reduced models, from 0.
    units : Mapping
        Units of the summary, keys `length` and `stress`.

    Returns
    -------
    Figure
        Full and reduced fields in one scale; the difference in its own, on the full model's body.
    """
    both = (0, model + 1)
    bodies = [
        Panel(fields.points, fields.points + fields.displacement[at], fields.surface) for at in both
    ]
    change = fields.displacement[model + 1] - fields.displacement[0]
    sizes = [np.linalg.norm(fields.displacement[at], axis=1) for at in both]
    stresses = [fields.stress[at] for at in both]
    off, wrong = np.linalg.norm(change, axis=1), stresses[1] - stresses[0]
    most = max(float(np.nanmax(np.abs(wrong[bodies[0].seen]), initial=0.0)), 1e-300)
    largest = max(float(off[bodies[0].seen].max()), 1e-300)
    rows = [
        [
            *_in_one_scale(bodies, sizes),
            bodies[0]._replace(values=off, limits=(0.0, largest, "neither"), colours=_SIZES),
        ],
        [
            *_in_one_scale(bodies, stresses),
            bodies[0]._replace(values=wrong, limits=(-most, most, "neither"), colours=_SIGNED),
        ],
    ]
    names = ("full", f"reduced, r = {fields.modes[model]}", "difference")
    figure, grid = _beside(rows, names, units.get("length", "?"), 2)
    errors = (_share(off, sizes[0]), _share(wrong, stresses[0]))
    for axes, shades, title, error in zip(grid, rows, _titles(units), errors, strict=True):
        draw_bar(figure, list(axes[:2]), shades[0].limits, wide=True).set_label(title)
        unit = title[title.index("[") :]
        bar = draw_bar(figure, [axes[2]], shades[2].limits, wide=True, colours=shades[2].colours)
        bar.ax.ticklabel_format(scilimits=(-2, 3), useOffset=False)
        bar.set_label(f"difference {unit}\nat most {error} of the largest")
    return figure


def _share(wrong: F64, of: F64) -> str:
    """The largest difference as a share of the largest value."""
    share = float(np.nanmax(np.abs(wrong))) / max(float(np.nanmax(np.abs(of))), 1e-300)
    if share >= 1e-4:
        return f"{100.0 * share:.2g} %"
    digits, power = f"{share:.1e}".split("e")
    return rf"${digits}\cdot 10^{{{int(power)}}}$" if share > 0.0 else "0"


def _titles(units: Mapping[str, str]) -> tuple[str, str]:
    length, stress = units.get("length", "?"), unit_of(units, "stress")
    return f"displacement |u| [{length}]", f"largest principal stress [{stress}]"


def _in_one_scale(bodies: Sequence[Panel], fields: Sequence[F64]) -> list[Panel]:
    """Bodies with a field each, in colours for what is seen of all."""
    seen = [values[body.seen] for values, body in zip(fields, bodies, strict=True)]
    limits = limits_of(np.concatenate(seen))
    return [
        body._replace(values=values, limits=limits)
        for body, values in zip(bodies, fields, strict=True)
    ]


def _beside(
    rows: Sequence[Sequence[Panel]], names: Sequence[str], length: str, bars: int
) -> tuple[Figure, NDArray[np.object_]]:
    """A column a body, a row a field, and the axes of both, with room for bars in each row."""
    every = np.vstack([part for body in rows[0] for part in (body.rest, body.positions)])
    flat = not np.ptp(every[:, 2])
    view = np.eye(3) if flat else views_of(np.ptp(every, axis=0))[0]
    middle, half = frame_of(every, [view])
    count, tall = len(rows[0]), float(half[1] / half[0])
    width = (11.0 - bars) / count
    figure = Figure(figsize=(11.0, len(rows) * width * tall + 1.2), layout="constrained")
    grid = figure.subplots(len(rows), count, squeeze=False)
    for axes, name in zip(grid[0], names, strict=True):
        axes.set_title(name, fontsize=10)
    for axes, panel in zip(grid.ravel(), (panel for row in rows for panel in row), strict=True):
        if flat:
            _draw_plane(axes, panel, middle)
            axes.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), aspect="equal")
            axes.set_axis_off()
        else:
            show(axes, panel, view, middle, half)
    if not flat:
        draw_triad(grid[0, 0], view, half)
    draw_ruler(grid[0, 0], half, length)
    return figure, grid


def _draw_plane(axes: Axes, panel: Panel, middle: F64) -> None:
    """A plane body with its undeformed outline."""
    place = panel.positions[:, :2] - middle[:2]
    shade_plane(axes, place, panel.triangles, panel.values, panel.limits, panel.colours)
    rest = (panel.rest[:, :2] - middle[:2])[rim_of(panel.triangles)]
    axes.plot(*rest.transpose(2, 1, 0), color="#999999", linewidth=0.8)
