"""What pictures of bodies share: limits of colours, views, axes, a length, outlines and bars."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colorbar import Colorbar
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from myork.types import F64, I32

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
