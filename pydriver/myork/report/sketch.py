"""What pictures of bodies share: limits of colours, views, axes, a length, outlines and bars.

Bodies in space are triangles and strokes of surfaces, drawn from the farthest on.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import TriMesh
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Colormap, ListedColormap, Normalize, to_rgb
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from myork.types import F64, I32, I64, Index

#: Colour of places without a value, which no map of colours in use has
NO_VALUE = "#FF00C8"
#: How the outline of an undeformed plane body looks
RIM: dict[str, Any] = {"color": "#999999", "linewidth": 0.8}
#: Colours reach the largest value unless it lies this many spans of the middle 99 % beyond them
_BEYOND = 1.0
#: The reader looks from this much to the side and from above [degree]
_AZIMUTH, _ELEVATION = 28.0, 18.0
#: Share of the body that a length stroke may take
_RULER = 0.35
#: Facets that meet at a larger angle have an edge there [degree]
_EDGE_ANGLE = 60.0
#: Normals at corners are the mean of their facets' but where these are further from it [cosine]
_SMOOTH = 0.72
#: Light from everywhere, and from above the reader, who is as far from it as this upwards
_AMBIENT, _DIFFUSE, _ABOVE = 0.5, 0.6, 0.8
#: Strokes are this much nearer to the reader than they are, of the size of the picture
_LIFT = 0.03
#: Width of edges and of other strokes, of the longer side of a picture, and parts that each may be
#: hidden in
_EDGE, _STROKE, _PARTS = 0.002, 0.003, 4


def limits_of(values: F64) -> tuple[float, float, str]:
    """Ends of the colours, and which of them values pass: "neither", "min", "max" or "both".

    The whole range is shown, but for single values so far out (at an edge where the stress has no
    bound) that all others would share one colour.
    """
    values = values[np.isfinite(values)]
    if not len(values):
        return 0.0, 1.0, "neither"
    least, most = float(values.min()), float(values.max())
    low, high = (float(v) for v in np.percentile(values, [0.5, 99.5]))
    room = _BEYOND * (high - low)
    below, above = low - least > room, most - high > room
    low, high = low if below else least, high if above else most
    margin = 1e-6 * max(abs(low), abs(high), 1e-12)
    ends = {(0, 0): "neither", (1, 0): "min", (0, 1): "max", (1, 1): "both"}
    return low - margin, high + margin, ends[below, above]


def frame_of(points: F64, views: Sequence[F64]) -> tuple[F64, F64]:
    """Middle of points, and half the width and height that show them in all views."""
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    spread = np.abs(np.array([view[:2] @ (points - middle).T for view in views])).max(axis=(0, 2))
    return middle, 1.06 * np.maximum(spread, 0.15 * spread.max())


def shade_plane(
    axes: Axes,
    places: F64,
    triangles: I32,
    values: F64,
    limits: tuple[float, float, str],
    colours: str = "viridis",
) -> None:
    """Values on triangles of a plane, or at its points where there are none; crosses lack one."""
    look: dict[str, Any] = {"vmin": limits[0], "vmax": limits[1], "cmap": colours}
    if len(triangles):
        shape = Triangulation(places[:, 0], places[:, 1], triangles)
        axes.tripcolor(shape, values, shading="gouraud", **look)
    else:
        axes.scatter(places[:, 0], places[:, 1], c=values, s=12, **look)
    missing = places[~np.isfinite(values)]
    if len(missing):
        axes.plot(*missing.T, "x", color=NO_VALUE, markersize=6, clip_on=False)
    axes.set_aspect("equal")


def draw_strokes(axes: Axes, places: F64, vectors: F64, long: float, **look: Any) -> None:
    """Strokes without heads around places, shape `(n, 2)`, as long as `long` times the vectors."""
    axes.quiver(
        *places.T, *vectors.T, angles="xy", scale_units="xy", scale=1.0 / long, pivot="mid",
        headwidth=0, headlength=0, headaxislength=0, **look,
    )  # fmt: skip


def views_of(sides: F64) -> list[F64]:
    """Two opposite views of a body: on its broad side, what is long across or upwards."""
    towards = int(np.argmin(sides[:2])) if sides[2] >= sides[:2].min() else 2
    if towards == 2 and sides[2] > 0.6 * sides[:2].min():
        # a bar along x or y lies on the ground
        towards = int(np.argmin(sides[:2]))
    up = 1 if towards == 2 else 2
    across = 3 - towards - up
    axes = np.zeros((3, 3))
    axes[0, across], axes[1, up] = 1.0, 1.0
    axes[2] = np.cross(axes[0], axes[1])
    found = []
    for turn in (_AZIMUTH, _AZIMUTH + 180.0):
        a, e = np.radians([turn, _ELEVATION])
        look = np.cos(e) * (np.cos(a) * axes[2] + np.sin(a) * axes[0]) + np.sin(e) * axes[1]
        right = np.cos(a) * axes[0] - np.sin(a) * axes[2]
        found.append(np.array([right, np.cross(look, right), look]))
    return found


def draw_triad(axes: Axes, view: F64, half: F64) -> None:
    """The coordinate axes as the reader sees them, in the lower left corner."""
    arm = 0.14 * float(half.min())
    origin = -np.asarray(half) + 1.2 * arm
    for name, tip in zip("xyz", (arm * view[:2].T), strict=True):
        if np.linalg.norm(tip) > 0.15 * arm:
            end, far = (tuple((origin + part * tip).tolist()) for part in (1.0, 1.35))
            look = {"arrowstyle": "-|>", "lw": 1.0, "shrinkB": 0}
            axes.annotate("", end, tuple(origin.tolist()), arrowprops=look)
            axes.text(far[0], far[1], name, fontsize=8, ha="center", va="center")


def draw_ruler(axes: Axes, half: F64, length: str) -> None:
    """A stroke of a round length in the lower right corner."""
    most = _RULER * 2.0 * float(half[0])
    power = 10.0 ** np.floor(np.log10(most))
    long = max(f * power for f in (1.0, 2.0, 5.0) if f * power <= most)
    right, y = 0.98 * half[0], -0.97 * half[1]
    axes.plot([right - long, right], [y, y], color="black", linewidth=2)
    axes.text(
        right - long / 2, y + 0.02 * half[1], f"{long:g} {length}",
        fontsize=8, ha="center", va="bottom",
    )  # fmt: skip


def rim_of(triangles: I32) -> I32:
    """Edges of one triangle only, shape `(m, 2)`."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]],
                                    triangles[:, [2, 0]]]), axis=1)  # fmt: skip
    found, counts = np.unique(edges, axis=0, return_counts=True)
    return found[counts == 1]


def draw_bar(
    figure: Figure, axes: list[Any], limits: tuple[float, float, str], side: str, colours: str
) -> Colorbar:
    """A bar of colours for some axes, at one side of them."""
    low, high, ends = limits
    shade = ScalarMappable(Normalize(low, high), colormaps[colours])
    bar = figure.colorbar(
        shade, ax=axes, extend=ends, pad=0.02, aspect=25, location=side, shrink=0.8
    )
    bar.ax.locator_params(nbins=5)
    bar.ax.ticklabel_format(scilimits=(-3, 5), useOffset=False)
    return bar


class Panel(NamedTuple):
    """What is drawn of a body."""

    #: Undeformed points, whose edges are drawn grey, and their places, shape `(n, 3)` [length]
    rest: F64
    positions: F64
    triangles: I32  #: Surface, shape `(m, 3)`; where there is none, points are drawn
    values: F64 = np.empty(0)  #: What colours the points, shape `(n,)`
    #: Values at the ends of the colours, and which of them values pass, as of `limits_of`
    limits: tuple[float, float, str] = (0.0, 1.0, "neither")
    colours: str = "viridis"  #: Name of a colour map of matplotlib, or colours between commas
    strokes: F64 = np.empty((0, 2, 3))  #: Ends of strokes on the body, shape `(k, 2, 3)` [length]
    #: Directions to the right and upwards in the picture and towards the reader, shape `(3, 3)`
    view: F64 = np.eye(3)
    #: What stands above the picture and beside its bar of colours; without words no bar
    title: str = ""
    bar: str = ""

    def shaded(self, values: F64, **more: Any) -> "Panel":
        """The body in the colours of values, shape `(n,)`, as far as these are seen."""
        return self._replace(values=values, limits=limits_of(values[self.seen]), **more)

    @property
    def seen(self) -> I64:
        """Points of the surface; all where it is not known."""
        return np.unique(self.triangles) if len(self.triangles) else np.arange(len(self.rest))


def board(cells: Sequence[Sequence[Panel]], length: str) -> tuple[Figure, NDArray[np.object_]]:
    """Rows of pictures, of one length, to one scale, with the axes of each.

    Those of a row or a column that have one bar share it; `length` is the unit of the ruler in the
    first picture.
    """
    every = [panel for row in cells for panel in row]
    places = np.vstack([part for panel in every for part in (panel.rest, panel.positions)])
    middle, half = frame_of(places, [panel.view for panel in every])
    rows, columns, solid = len(cells), len(cells[0]), np.ptp(places[:, 2]) > 0.0
    bars = max(len({panel.bar for panel in row} - {""}) for row in cells)
    high = min((11.0 - bars) / columns * float(half[1] / half[0]) + 0.3, 4.8)
    figure = Figure(figsize=(11.0, rows * high + 1.0), layout="constrained")
    grid = figure.subplots(rows, columns, squeeze=False)
    shared: dict[Any, list[Axes]] = {}
    for axes, panel in zip(grid.ravel(), every, strict=True):
        (show if solid else _show_plane)(axes, panel, middle, half)
        axes.set_title(panel.title, fontsize=10)
        shared.setdefault((panel.bar, panel.limits, panel.colours), []).append(axes)
    if solid:
        first = {panel.view.tobytes(): at for at, panel in reversed(list(enumerate(every)))}
        for at in first.values():
            draw_triad(grid.ravel()[at], every[at].view, half)
    draw_ruler(grid[0, 0], half, length)
    for (bar, limits, colours), own in shared.items():
        below = len(own) > 1 and own[0] in grid[0] and own[1] not in grid[0]
        if bar:
            draw_bar(figure, own, limits, "bottom" if below else "right", colours).set_label(bar)
    return figure, grid


def show(axes: Axes, panel: Panel, middle: F64, half: F64) -> None:
    """Draw a body by parallel projection into axes without a frame.

    `middle` is the place in the middle of the picture, shape `(3,)` [length], `half` half its width
    and height [length].
    """
    axes.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), aspect="equal")
    axes.set_axis_off()
    view = panel.view
    rest, place = (panel.rest - middle) @ view.T, (panel.positions - middle) @ view.T
    if not len(panel.triangles):
        order = np.argsort(place[:, 2])
        x, y, _ = place[order].T
        axes.scatter(x, y, s=12, c=_coloured(panel, panel.values[order]))
        return
    sharp = _edges(panel.rest, panel.triangles, float(half.min()))
    parts = [_facets(panel, place)]
    strokes = (panel.strokes - middle) @ view.T
    for ends, width, colour in ((rest[sharp], _EDGE, "#888888"), (strokes, _STROKE, "#222222")):
        parts.append(_ribbons(ends, width * float(half.max()), colour))
        parts[-1][0][..., 2] += _LIFT * float(np.linalg.norm(half))
    corners, colours = (np.concatenate(own) for own in zip(*parts, strict=True))
    order = np.argsort(corners[:, :, 2].mean(axis=1), kind="stable")
    x, y, _ = corners[order].reshape(-1, 3).T
    mesh = TriMesh(Triangulation(x, y, np.arange(len(x)).reshape(-1, 3)))
    mesh.set_facecolor([tuple(colour) for colour in colours[order].reshape(-1, 3).tolist()])
    axes.add_collection(mesh, autolim=False)


def _show_plane(axes: Axes, panel: Panel, middle: F64, half: F64) -> None:
    """Draw a plane body with its undeformed outline; parameters as of `show`."""
    rest, place = ((own - middle)[:, :2] for own in (panel.rest, panel.positions))
    shade_plane(axes, place, panel.triangles, panel.values, panel.limits, panel.colours)
    axes.plot(*rest[rim_of(panel.triangles)].transpose(2, 1, 0), **RIM)
    axes.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]), aspect="equal")
    axes.set_axis_off()


def _facets(panel: Panel, place: F64) -> tuple[F64, F64]:
    """Triangles that face the reader: their corners, and the colours there in the light."""
    triangles, view = panel.triangles, panel.view
    light = _normals(panel.positions, triangles) @ _unit(view[2] + _ABOVE * view[1])
    corners = place[triangles]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    front = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0.0
    values = panel.values[triangles[front]]
    if panel.colours.startswith("#"):
        # between two tissues lies none of the colours between theirs
        values = np.repeat(np.median(values, axis=1)[:, None], 3, axis=1)
    shade = np.minimum(_AMBIENT + _DIFFUSE * light[front].clip(0.0, 1.0), 1.0)
    return corners[front], _coloured(panel, values) * shade[..., None]


def _ribbons(ends: F64, width: float, colour: str) -> tuple[F64, F64]:
    """Strokes as narrow triangles: their corners and the colours there."""
    share = np.linspace(0.0, 1.0, _PARTS + 1)[:, None]
    line = ends[:, None, 0] * (1.0 - share) + ends[:, None, 1] * share
    along = _unit(ends[:, 1, :2] - ends[:, 0, :2])
    side = np.zeros_like(ends)[:, :1]
    side[:, 0, :2] = width * np.stack([-along[:, 1], along[:, 0]], axis=1)
    left, right = line - side, line + side
    halves = [
        [left[:, :-1], left[:, 1:], right[:, 1:]],
        [left[:, :-1], right[:, 1:], right[:, :-1]],
    ]
    corners = np.concatenate([np.stack(own, axis=2) for own in halves]).reshape(-1, 3, 3)
    return corners, np.broadcast_to(to_rgb(colour), corners.shape)


def _coloured(panel: Panel, values: F64) -> F64:
    """Colours of values, of one more axis."""
    named: Colormap = (
        ListedColormap(panel.colours.split(","))
        if panel.colours.startswith("#")
        else colormaps[panel.colours]
    )
    low, high, _ = panel.limits
    share = np.ma.masked_invalid((values - low) / (high - low))
    return np.asarray(named.with_extremes(bad=NO_VALUE)(share))[..., :3]


def _areas(points: F64, triangles: I32) -> F64:
    """Normals of triangles, as long as twice their area, shape `(m, 3)`."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _unit(vectors: F64) -> F64:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def _normals(points: F64, triangles: I32) -> F64:
    """Normals at the corners of triangles, shape `(m, 3, 3)`: smooth but at edges."""
    facet = _areas(points, triangles)
    mean = np.zeros_like(points)
    for k in range(3):
        np.add.at(mean, triangles[:, k], facet)
    own = np.repeat(_unit(facet)[:, None], 3, axis=1)
    smooth = _unit(mean)[triangles]
    return np.where(np.sum(own * smooth, axis=2, keepdims=True) > _SMOOTH, smooth, own)


def _edges(points: F64, triangles: I32, least: float) -> Index:
    """Ends of edges that hang together over a length; short ones are folds of a rough surface."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    edges, normal = edges[order], _unit(_areas(points, triangles))[order // 3]
    both = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    cosine = np.sum(normal[both] * normal[both + 1], axis=1)
    sharp = edges[both[cosine < np.cos(np.radians(_EDGE_ANGLE))]]
    graph = coo_array((np.ones(len(sharp)), sharp.T), shape=(len(points), len(points)))
    part = connected_components(graph, directed=False)[1][sharp[:, 0]]
    sides = {own: np.ptp(points[sharp[part == own]].reshape(-1, 3), axis=0) for own in set(part)}
    long = [own for own, side in sides.items() if np.linalg.norm(side) >= least]
    return np.asarray(sharp[np.isin(part, long)], np.intp)
