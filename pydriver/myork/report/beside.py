"""Bodies side by side, in one view: runs, and a reduced model beside the full one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from myork.reduced_fields import ReducedFields
from myork.report.numbers import unit_of
from myork.report.raster import Panel, draw
from myork.report.sketch import (
    draw_bar,
    draw_ruler,
    draw_triad,
    limits_of,
    rim_of,
    seen_points,
    shade_plane,
    views_of,
)
from myork.report.sources import Deformation
from myork.types import F64, I32, I64

__all__ = ["compared_figure", "reduced_figure"]


#: Colours of values, of sizes of differences and of differences with a sign
_VALUES, _SIZES, _SIGNED = "viridis", "magma", "coolwarm"


class _Body(NamedTuple):
    """A body: undeformed and deformed places, shape `(n, 3)` [length], and its surface."""

    rest: F64
    moved: F64
    triangles: I32

    @property
    def seen(self) -> I64:
        """Points of the surface; all where it is not known."""
        return seen_points(self.triangles, len(self.rest))


class _Shade(NamedTuple):
    """Values of a body, shape `(n,)`, with the ends and the name of their colours."""

    values: F64
    limits: tuple[float, float, str]
    colours: str = _VALUES


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
    bodies = [_Body(own.points, own.points + own.displacement, own.surface) for own in deformations]
    fields = (
        [np.linalg.norm(own.displacement, axis=1) for own in deformations],
        [own.stress for own in deformations],
    )
    rows = []
    for row in fields:
        limits = _common(row, bodies)
        rows.append([_Shade(values, limits) for values in row])
    figure, grid = _beside(bodies, rows, names, units.get("length", "?"), 1)
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
    surface = fields.surface
    both = (0, model + 1)
    bodies = [
        _Body(fields.points, fields.points + fields.displacement[at], surface) for at in (*both, 0)
    ]
    change = fields.displacement[model + 1] - fields.displacement[0]
    sizes = [np.linalg.norm(fields.displacement[at], axis=1) for at in both]
    stresses = [fields.stress[at] for at in both]
    off, wrong = np.linalg.norm(change, axis=1), stresses[1] - stresses[0]
    most = max(float(np.nanmax(np.abs(wrong[bodies[0].seen]), initial=0.0)), 1e-300)
    rows = [
        [
            *(_Shade(values, _common(sizes, bodies)) for values in sizes),
            _Shade(off, (0.0, max(float(off[bodies[0].seen].max()), 1e-300), "neither"), _SIZES),
        ],
        [
            *(_Shade(values, _common(stresses, bodies)) for values in stresses),
            _Shade(wrong, (-most, most, "neither"), _SIGNED),
        ],
    ]
    names = ("full", f"reduced, r = {fields.modes[model]}", "difference")
    figure, grid = _beside(bodies, rows, names, units.get("length", "?"), 2)
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


def _common(row: Sequence[F64], bodies: Sequence[_Body]) -> tuple[float, float, str]:
    """Ends of colours for what is seen of several bodies."""
    seen = [values[body.seen] for values, body in zip(row, bodies, strict=False)]
    return limits_of(np.concatenate(seen))


def _beside(
    bodies: Sequence[_Body],
    rows: Sequence[Sequence[_Shade]],
    names: Sequence[str],
    length: str,
    bars: int,
) -> tuple[Figure, NDArray[np.object_]]:
    """A column a body, a row a field, and the axes of both, with room for bars in each row."""
    every = np.vstack([part for body in bodies for part in (body.rest, body.moved)])
    flat = not np.ptp(every[:, 2])
    views = [np.eye(3)] if flat else views_of(np.ptp(every, axis=0))[:1]
    middle = 0.5 * (every.min(axis=0) + every.max(axis=0))
    half = 1.06 * np.abs(views[0][:2] @ (every - middle).T).max(axis=1)
    half = np.maximum(half, 0.15 * half.max())
    count, tall = len(bodies), float(half[1] / half[0])
    width = (11.0 - bars) / count
    figure = Figure(figsize=(11.0, len(rows) * width * tall + 1.2), layout="constrained")
    grid = figure.subplots(len(rows), count, squeeze=False)
    for axes, name in zip(grid[0], names, strict=True):
        axes.set_title(name, fontsize=10)
    for columns in _alike(bodies):
        cells = [(grid[k, c], bodies[c], rows[k][c]) for c in columns for k in range(len(rows))]
        if flat:
            for axes, body, shade in cells:
                _draw_plane(axes, body, shade, middle)
            continue
        none = np.empty((0, 2, 3))
        panels = [
            Panel(body.moved, shade.values, shade.limits[:2], shade.colours, none)
            for _, body, shade in cells
        ]
        first = bodies[columns[0]]
        drawn = draw(panels, first.triangles, first.rest, views, middle, half)
        for (axes, _, _), pictures in zip(cells, drawn, strict=True):
            extent = (-half[0], half[0], -half[1], half[1])
            axes.imshow(pictures[0], extent=extent, interpolation="antialiased")
    for axes in grid.ravel():
        axes.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), aspect="equal")
        axes.set_axis_off()
    if not flat:
        draw_triad(grid[0, 0], views[0], half)
    draw_ruler(grid[0, 0], half, length)
    return figure, grid


def _alike(bodies: Sequence[_Body]) -> list[list[int]]:
    """Places of bodies with the same surface, which are drawn at once."""
    groups: dict[int, list[int]] = {}
    for place, body in enumerate(bodies):
        groups.setdefault(id(body.triangles), []).append(place)
    return list(groups.values())


def _draw_plane(axes: Axes, body: _Body, shade: _Shade, middle: F64) -> None:
    """A plane body with its undeformed outline."""
    place = body.moved[:, :2] - middle[:2]
    shade_plane(axes, place, body.triangles, shade.values, shade.limits, shade.colours)
    rest = (body.rest[:, :2] - middle[:2])[rim_of(body.triangles)]
    axes.plot(*rest.transpose(2, 1, 0), color="#999999", linewidth=0.8)
