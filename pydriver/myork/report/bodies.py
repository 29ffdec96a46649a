"""Pictures of bodies: surfaces, reduced ones beside full ones, plane bodies, planes through them.

A `Deformation` is the last state of a run; `units` are those of its summary, keys `length` and
`stress`.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from myork.report.numbers import unit_of
from myork.report.sketch import (
    RIM,
    Panel,
    board,
    draw_strokes,
    frame_of,
    limits_of,
    rim_of,
    shade_plane,
    views_of,
)
from myork.report.sources import Body, Deformation
from myork.results import ReducedFields
from myork.types import F64, I32, Index

#: Colours of tissues: those of Okabe and Ito, then darker ones and a light one
_TISSUES = (
   "#D55E00", "#56B4E9", "#F0E442", "#009E73", "#CC79A7", "#E69F00", "#0072B2",
   "#7A3600", "#9A8F10", "#00543D", "#7C3F62", "#9FD9B8",
)  # fmt: skip
_PLAIN = "#D8D8D8"
_TENSION, _PRESSURE = "#FFFFFF", "#000000"
#: Strokes across the longer side of a body or plane
_ACROSS = 16
#: A body this much wider than high is drawn in rows, not in columns
_WIDE = 1.6


def surface_figure(
    deformation: Deformation, units: Mapping[str, str], tissues: Sequence[str] = ()
) -> Figure:
    """Surface of a body in space: displacement, stress, fibers or volume ratio, two views.

    A picture a field and a view, with one scale for all; of points where there is no surface.
    `tissues` are names of the labels of the points, in their order.
    """
    points, moved, titles = deformation.points, deformation.moved, _titles(units)
    body = Panel(points, moved, deformation.surface)
    panels = [
        body.shaded(getattr(deformation, name), title=titles[name], bar=" ")
        for name in ("size", "stress", "volume_ratio")
    ]
    labels, tissue = np.unique(deformation.label, return_inverse=True)
    fibers = deformation.fiber.any()
    if fibers or len(labels) > 1:
        colours = [_TISSUES[k % len(_TISSUES)] for k in range(len(labels))]
        panels[2] = Panel(
            points, points, deformation.surface, tissue.astype(float),
            (-0.5, len(labels) - 0.5, "neither"),
            ",".join(colours) if len(labels) > 1 else _PLAIN,
            _strokes(deformation, body.seen) if fibers else body.strokes,
            title="fibers and tissue, undeformed" if fibers else "tissue, undeformed",
        )  # fmt: skip
    both = np.vstack([points, moved])
    views = views_of(np.ptp(both, axis=0))
    half = frame_of(both, views)[1]
    cells = [
        [panel._replace(view=views[0]), panel._replace(view=views[1], title="")] for panel in panels
    ]
    wide = half[0] > _WIDE * half[1]
    figure, grid = board(
        cells if wide else list(zip(*cells, strict=True)), unit_of(units, "length")
    )
    if panels[2].colours not in (body.colours, _PLAIN):
        named = [*tissues[: len(labels)], *(f"label {k}" for k in range(len(tissues), len(labels)))]
        grid[-1, -1].legend(
            handles=[Patch(color=own[0], label=own[1]) for own in zip(colours, named, strict=True)],
            loc="upper center", bbox_to_anchor=(0.5, -0.01), frameon=False, fontsize="small",
            ncols=2,
        )  # fmt: skip
    return figure


def reduced_figure(fields: ReducedFields, model: int, units: Mapping[str, str]) -> Figure:
    """A reduced model, from 0, beside the full one: displacement and stress.

    Both in one scale; their difference in its own, on the full model's body.
    """
    full, reduced = (
        Body(fields.points, fields.displacement[at], fields.stress[at], fields.surface)
        for at in (0, model + 1)
    )
    cells = _compared((full, reduced), ("full", f"reduced, r = {fields.modes[model]}"), units)
    off = np.linalg.norm(reduced.displacement - full.displacement, axis=1)
    for row, wrong, of, low, colours in (
        (cells[0], off, full.size, 0.0, "magma"),
        (cells[1], reduced.stress - full.stress, full.stress, -1.0, "coolwarm"),
    ):
        most = max(float(np.nanmax(np.abs(wrong[row[0].seen]), initial=0.0)), 1e-300)
        unit = row[0].bar[row[0].bar.index("[") :]
        row.append(
            row[0]._replace(
                values=wrong, limits=(low * most, most, "neither"), colours=colours,
                title="difference" if row[0].title else "",
                bar=f"difference {unit}\nat most {_share(wrong, of)} of the largest",
            )
        )  # fmt: skip
    return board(cells, unit_of(units, "length"))[0]


def _compared(
    bodies: Sequence[Body], names: Sequence[str], units: Mapping[str, str]
) -> list[list[Panel]]:
    """Displacement and stress of bodies, a column each, in one view and one scale of colours."""
    every = np.vstack([part for own in bodies for part in (own.points, own.moved)])
    flat = all(own.is_plane for own in bodies)
    view = np.eye(3) if flat else views_of(np.ptp(every, axis=0))[0]
    rows = []
    for kind, heads in (("size", names), ("stress", [""] * len(names))):
        panels = [
            Panel(own.points, own.moved, own.surface, getattr(own, kind), view=view, title=head)
            for own, head in zip(bodies, heads, strict=True)
        ]
        limits = limits_of(np.concatenate([own.values[own.seen] for own in panels]))
        rows.append([own._replace(limits=limits, bar=_titles(units)[kind]) for own in panels])
    return rows


def _share(wrong: F64, of: F64) -> str:
    """The largest difference as a share of the largest value."""
    share = float(np.nanmax(np.abs(wrong))) / max(float(np.nanmax(np.abs(of))), 1e-300)
    if share >= 1e-4:
        return f"{100.0 * share:.2g} %"
    digits, power = f"{share:.1e}".split("e")
    return rf"${digits}\cdot 10^{{{int(power)}}}$" if share > 0.0 else "0"


def _titles(units: Mapping[str, str]) -> dict[str, str]:
    """What stands beside a field of a body, by the name that `Deformation` gives it."""
    return {
        "size": f"displacement |u| [{unit_of(units, 'length')}]",
        "stress": f"largest principal stress [{unit_of(units, 'stress')}]",
        "volume_ratio": "volume ratio J [-]",
        "fiber": "fibers and tissue",
    }


def _strokes(deformation: Deformation, seen: NDArray[Any]) -> F64:
    """Fibers of points on the surface, thinned to an even distance, cut where the body ends."""
    points = deformation.points
    own = seen[np.any(deformation.fiber[seen] != 0.0, axis=1)]
    own = own[_thinned(points[own], _reach(points))]
    along = 0.4 * _reach(points) * deformation.fiber[own]
    ends = []
    for half in (-along, along):
        room = np.where(half > 0.0, points.max(axis=0), points.min(axis=0)) - points[own]
        share = np.divide(room, half, out=np.ones_like(half), where=half != 0.0).min(axis=1)
        ends.append(points[own] + np.clip(share, 0.0, 1.0)[:, None] * half)
    return np.stack(ends, axis=1)


def plane_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """A plane body, deformed: displacement with its arrows, stress with its crosses, J.

    Three panels with equal scales; the undeformed outline is grey.
    """
    points, moved = deformation.points[:, :2], deformation.moved[:, :2]
    across, up = np.ptp(np.vstack([points, moved]), axis=0)
    wide, tall = across > _WIDE * up, float(up / across)
    high = 3 * (8.0 * tall + 0.9) if wide else min(3.4 * tall + 1.4, 8.0)
    figure = Figure(figsize=(11.0, high), layout="constrained")
    panels = figure.subplots(*((3, 1) if wide else (1, 3)))
    everything = np.arange(len(points))
    for axes, kind in zip(panels, ("size", "stress", "volume_ratio"), strict=True):
        axes.plot(*points[rim_of(deformation.surface)].transpose(2, 1, 0), **RIM)
        _map(axes, deformation, kind, moved, deformation.surface, everything, (0, 1))
        axes.set_title(_titles(units)[kind], fontsize=10)
        axes.set_xlabel(f"x [{unit_of(units, 'length')}]")
    panels[0].set_ylabel(f"y [{unit_of(units, 'length')}]")
    return figure


def slices_figure(deformation: Deformation, units: Mapping[str, str]) -> Figure:
    """Three planes through the middle of an undeformed body, a row each.

    Displacement, fibers, principal stresses.
    """
    length = unit_of(units, "length")
    kinds = ("size", "fiber", "stress") if deformation.fiber.any() else ("size", "stress")
    sides = np.ptp(deformation.points, axis=0)
    heights = [min(3.4 * sides[b] / sides[a], 4.6) + 0.8 for a, b, _ in _PLANES]
    figure = Figure(figsize=(3.7 * len(kinds), sum(heights)), layout="constrained")
    grid = figure.subplots(3, len(kinds), height_ratios=heights, squeeze=False)
    for row, (a, b, normal) in zip(grid, _PLANES, strict=True):
        kept, triangles = _plane(deformation.lattice, normal)
        flat = deformation.points[kept][:, [a, b]]
        level = float(np.median(deformation.points[kept, normal]))
        for axes, kind in zip(row, kinds, strict=True):
            _map(axes, deformation, kind, flat, triangles, kept, (a, b))
            axes.set_xlabel(f"{'xyz'[a]} [{length}]")
        row[0].set_ylabel(f"plane {'xyz'[normal]} = {level:.4g} {length}\n{'xyz'[b]} [{length}]")
    for axes, kind in zip(grid[0], kinds, strict=True):
        axes.set_title(_titles(units)[kind], fontsize=10)
    return figure


#: Across, upwards and normal of the transverse, coronal and sagittal planes
_PLANES = ((0, 1, 2), (0, 2, 1), (1, 2, 0))


def _plane(lattice: I32, normal: int) -> tuple[Index, I32]:
    """Points of the fullest plane of a lattice, and triangles between them.

    Of planes alike it is that nearest to the middle, which itself may lie between two limbs.
    """
    layer = lattice[:, normal] - int(lattice[:, normal].min())
    count = np.bincount(layer)
    full = np.flatnonzero(count == count.max())
    kept = np.flatnonzero(layer == full[np.abs(full - (len(count) - 1) // 2).argmin()])
    places = np.delete(lattice[kept], normal, axis=1)
    places = places - places.min(axis=0)
    at = np.full(places.max(axis=0) + 1, -1, np.int32)
    at[tuple(places.T)] = np.arange(len(kept))
    square = np.stack([at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]], axis=-1).reshape(-1, 4)
    lost = square < 0
    # halves of squares, or what is left of those that lack a corner
    cut = [square[:, [0, 1, 2]], square[:, [0, 2, 3]],
           square[lost[:, 2]][:, [0, 1, 3]], square[lost[:, 0]][:, [1, 2, 3]]]  # fmt: skip
    triangles = np.concatenate(cut)
    return kept, triangles[(triangles >= 0).all(axis=1)]


def _map(
    axes: Axes,
    deformation: Deformation,
    kind: str,
    places: F64,
    triangles: I32,
    kept: Index,
    plane: tuple[int, int],
) -> None:
    """A field of the points that are kept, at places in a plane, with its strokes.

    Displacements have arrows, stresses crosses, and tissues their fibers.
    """
    few, own = _thinned(places, _reach(places)), list(plane)
    if kind == "fiber":
        tissue = np.unique(deformation.label, return_inverse=True)[1].astype(float)
        _tissue(axes, places, triangles, tissue[kept])
        fibers = deformation.fiber[kept][few][:, own]
        draw_strokes(
            axes, places[few], fibers, _reach(places) / 1.2, width=0.008, color="#222222"
        )  # fmt: skip
        return
    values = getattr(deformation, kind)[kept]
    limits = limits_of(values)
    shade_plane(axes, places, triangles, values, limits)
    # a bar beside the picture however wide it is
    bar = axes.figure.colorbar(
        ScalarMappable(Normalize(*limits[:2])), cax=axes.inset_axes((1.03, 0.0, 0.05, 1.0)),
        extend=limits[2],
    )  # fmt: skip
    bar.ax.ticklabel_format(useOffset=False)
    bar.ax.locator_params(nbins=6)
    if kind == "size":
        _arrows(axes, places, few, deformation.displacement[kept][:, own])
    elif kind == "stress":
        _crosses(axes, places[few], deformation.cauchy[kept][few][:, own][:, :, own])


def _tissue(axes: Axes, places: F64, triangles: I32, tissues: F64) -> None:
    """Triangles in the colour of their tissue."""
    if len(triangles):
        count = len(_TISSUES)
        colours = ListedColormap(_TISSUES if tissues.max() > 0.0 else [_PLAIN] * count)
        own = np.median(tissues[triangles], axis=1) % count
        axes.tripcolor(
            Triangulation(places[:, 0], places[:, 1], triangles), facecolors=own, cmap=colours,
            vmin=-0.5, vmax=count - 0.5, alpha=0.8,
        )  # fmt: skip
    axes.set_aspect("equal")


def _reach(places: F64) -> float:
    """Distance of strokes, of which about `_ACROSS` lie along the longer side."""
    return max(float(np.ptp(places, axis=0).max()), 1e-300) / _ACROSS


def _thinned(places: F64, reach: float) -> Index:
    """Points at an even distance."""
    return np.unique(np.floor(places / reach), axis=0, return_index=True)[1]


def _arrows(axes: Axes, places: F64, few: Index, moves: F64) -> None:
    """Arrows of the displacement at a few places, the longest as long as their distance."""
    most = float(np.linalg.norm(moves[few], axis=1).max(initial=0.0))
    if most > 0.0:
        axes.quiver(
            *places[few].T, *moves[few].T, angles="xy", scale_units="xy",
            scale=most / _reach(places[few]), width=0.006, color="white", edgecolor="black",
            linewidth=0.4,
        )  # fmt: skip


def _crosses(axes: Axes, places: F64, stress: F64) -> None:
    """Principal stresses in the plane: white pulls, black presses, as long as they are large."""
    known = np.isfinite(stress).all(axis=(1, 2))
    places, stress = places[known], stress[known]
    values, vectors = np.linalg.eigh(0.5 * (stress + stress.transpose(0, 2, 1)))
    most = float(np.percentile(np.abs(values), 98.0)) if values.size else 0.0
    if not most > 0.0:
        return
    reach = _reach(places)
    for k in range(2):
        long = np.clip(values[:, k] / most, -1.0, 1.0) * 0.9 * reach
        for sign, colour in ((1.0, _TENSION), (-1.0, _PRESSURE)):
            own = sign * long > 0.02 * reach
            if own.any():
                strokes = vectors[own, :, k] * np.abs(long[own, None])
                draw_strokes(
                    axes, places[own], strokes, 1.0, width=0.009, color=colour,
                    edgecolor="#555555", linewidth=0.3,
                )  # fmt: skip
