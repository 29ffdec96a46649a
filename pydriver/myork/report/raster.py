"""Pictures of a surface: triangles, strokes and points, the nearest of them in each pixel."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, ListedColormap, to_rgb
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from myork.report.sketch import NO_VALUE
from myork.types import F64, I32, I64

__all__ = ["Panel", "picture_of", "show"]

#: Pixels of the longer side of a picture, and those that make one of these along each side
_SIDE, _FINE = 520, 2
#: Distance of samples, so that each pixel of a triangle has one [pixel]
_STEP = 0.7
#: Facets that meet at a larger angle have an edge there [degree]
_EDGE_ANGLE = 60.0
#: Normals at corners are the mean of their facets' but where these are further from it [cosine]
_SMOOTH = 0.72
#: Light from everywhere, and from above the reader, who is as far from it as this upwards
_AMBIENT, _DIFFUSE, _ABOVE = 0.5, 0.6, 0.8
#: Strokes are this much nearer to the reader than they are, of the size of the picture
_LIFT = 0.012


class Panel(NamedTuple):
    """What is drawn of a body.

    Attributes
    ----------
    rest, positions : NDArray
        Undeformed points, whose edges are drawn grey, and their places, shape `(n, 3)` [length].
    triangles : NDArray
        Surface, shape `(m, 3)`; where there is none, points are drawn.
    values : NDArray
        What colours the points, shape `(n,)`.
    limits : tuple
        Values at the ends of the colours, and which of them values pass, as of `limits_of`.
    colours : str
        Name of a colour map of matplotlib, or colours between commas.
    strokes : NDArray
        Ends of strokes on the body, shape `(k, 2, 3)` [length].
    """

    rest: F64
    positions: F64
    triangles: I32
    values: F64 = np.empty(0)
    limits: tuple[float, float, str] = (0.0, 1.0, "neither")
    colours: str = "viridis"
    strokes: F64 = np.empty((0, 2, 3))

    @property
    def seen(self) -> I64:
        """Points of the surface; all where it is not known."""
        return np.unique(self.triangles) if len(self.triangles) else np.arange(len(self.rest))


def show(axes: Axes, panel: Panel, view: F64, middle: F64, half: F64) -> None:
    """Put a picture into axes without a frame; arguments as of `picture_of`."""
    extent = (-half[0], half[0], -half[1], half[1])
    axes.imshow(picture_of(panel, view, middle, half), extent=extent, interpolation="antialiased")
    axes.set_axis_off()


def picture_of(panel: Panel, view: F64, middle: F64, half: F64) -> NDArray[np.uint8]:
    """A body by parallel projection.

    Parameters
    ----------
    panel : Panel
        What is drawn.
    view : F64
        Directions to the right and upwards in the picture and towards the reader, shape `(3, 3)`.
    middle : F64
        Place in the middle of the picture, shape `(3,)` [length].
    half : F64
        Half its width and height [length].

    Returns
    -------
    NDArray
        Pixels, shape `(height, width, 3)`.
    """
    picture = _Picture(view, middle, half)
    if len(panel.triangles):
        picture.add_triangles(panel)
    else:
        picture.add_points(panel)
    edges = _edges(panel.rest, panel.triangles, float(half.min()))
    picture.add_strokes(panel.rest[edges], "#888888", 1.0)
    picture.add_strokes(panel.strokes, "#222222", 1.5)
    return picture.pixels()


class _Picture:
    """Colours and depths of fine pixels."""

    def __init__(self, view: F64, middle: F64, half: F64) -> None:
        size = np.maximum(np.round(_SIDE * half / half.max()), 80).astype(int) * _FINE
        self.view, self.middle, self.half = view, middle, half
        self.wide, self.high = (int(n) for n in size)
        self.scale = size / (2.0 * half)
        self.colour = np.ones((self.high * self.wide, 3))
        self.depth = np.full(self.high * self.wide, -np.inf)

    def seen(self, x: F64) -> F64:
        """Pixels to the right and upwards, and length towards the reader."""
        own = (x - self.middle) @ self.view.T
        own[..., :2] = (own[..., :2] + self.half) * self.scale
        return np.asarray(own)

    def _nearest(self, place: F64) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Pixels in which samples are nearer than what is there, and these samples."""
        column, row = np.floor(place[:, :2]).astype(int).T
        inside = (column >= 0) & (column < self.wide) & (row >= 0) & (row < self.high)
        pixel = np.where(inside, (self.high - 1 - row) * self.wide + column, 0)
        own = np.flatnonzero(inside & (place[:, 2] > self.depth[pixel]))
        # of several samples in a pixel the last one stays; whole numbers are sorted at once
        near = place[own, 2]
        low, high = near.min(initial=np.inf), near.max(initial=-np.inf)
        steps = (near - low) * (65535.0 / max(high - low, 1e-30))
        own = own[np.argsort(steps.astype(np.uint16), kind="stable")]
        last = np.full(len(self.depth), -1)
        last[pixel[own]] = own
        pixels = np.flatnonzero(last >= 0)
        self.depth[pixels] = place[last[pixels], 2]
        return pixels, last[pixels]

    def add_triangles(self, panel: Panel) -> None:
        """The sides of triangles that face the reader."""
        triangles = panel.triangles
        light = _normals(panel.positions, triangles) @ _unit(self.view[2] + _ABOVE * self.view[1])
        corners = self.seen(panel.positions)[triangles]
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        front = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0] > 0.0
        corners, light = corners[front].astype(np.float32), light[front]
        values = panel.values[triangles][front]
        owner, weight = _samples(corners[:, :, :2])
        pixels, own = self._nearest(_mean(weight, corners, owner))
        weight, owner = weight[own], owner[own]
        shade = _AMBIENT + _DIFFUSE * _mean(weight, light, owner).clip(0.0, 1.0)
        # between two tissues lies none of the colours between theirs
        words = panel.colours.startswith("#")
        mixed = values[owner, weight.argmax(axis=1)] if words else _mean(weight, values, owner)
        colour = _coloured(panel, mixed)
        self.colour[pixels] = colour * np.minimum(shade, 1.0)[:, None]

    def add_points(self, panel: Panel) -> None:
        """Discs that nearly touch."""
        sides = np.maximum(np.ptp(panel.positions, axis=0), 1e-9 * np.ptp(panel.positions))
        radius = 0.5 * np.cbrt(np.prod(sides) / len(panel.positions)) * float(self.scale[0])
        disc = _disc(float(np.clip(radius, 2.0, 12.0)))
        place = np.repeat(self.seen(panel.positions), len(disc), axis=0)
        place[:, :2] += np.tile(disc, (len(panel.positions), 1))
        pixels, own = self._nearest(place)
        self.colour[pixels] = _coloured(panel, panel.values)[own // len(disc)]

    def add_strokes(self, ends: F64, colour: str, width: float) -> None:
        """Strokes of a width in pixels of the picture, shape `(m, 2, 3)` [length]."""
        if not len(ends):
            return
        seen = self.seen(ends)
        seen[..., 2] += _LIFT * float(np.linalg.norm(self.half))
        parts = int(np.ceil(np.linalg.norm(np.diff(seen[..., :2], axis=1), axis=2).max())) + 1
        share = np.linspace(0.0, 1.0, parts)[:, None]
        line = (seen[:, None, 0] * (1.0 - share) + seen[:, None, 1] * share).reshape(-1, 3)
        disc = _disc(0.5 * width * _FINE)
        place = np.repeat(line, len(disc), axis=0)
        place[:, :2] += np.tile(disc, (len(line), 1))
        self.colour[self._nearest(place)[0]] = to_rgb(colour)

    def pixels(self) -> NDArray[np.uint8]:
        """Means of the fine pixels."""
        fine = self.colour.reshape(self.high // _FINE, _FINE, self.wide // _FINE, _FINE, 3)
        return np.asarray(np.round(255.0 * fine.mean(axis=(1, 3))), np.uint8)


def _disc(radius: float) -> F64:
    """Offsets of the pixels of a disc."""
    line = np.arange(-np.ceil(radius), np.ceil(radius) + 1)
    offset = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    return offset[np.linalg.norm(offset, axis=1) <= radius]


def _coloured(panel: Panel, values: F64) -> F64:
    """Colours of values, shape `(n, 3)`."""
    named: Colormap = (
        ListedColormap(panel.colours.split(","))
        if panel.colours.startswith("#")
        else colormaps[panel.colours]
    )
    low, high, _ = panel.limits
    share = np.ma.masked_invalid((values - low) / (high - low))
    return np.asarray(named.with_extremes(bad=NO_VALUE)(share))[:, :3]


def _mean(weight: Any, values: Any, owner: NDArray[np.intp]) -> Any:
    """Values at samples of those at the corners of their triangles, shape `(m, 3, ...)`."""
    share = weight.reshape(*weight.shape, *[1] * (values.ndim - 2))
    return sum(share[:, k] * values[owner, k] for k in range(3))


def _samples(corners: F64) -> tuple[NDArray[np.intp], F64]:
    """Triangles of samples and their weights at the corners, for corners in pixels."""
    sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
    parts = np.ceil(sides.max(axis=1, initial=0.0) / _STEP).astype(int).clip(1, 4 * _SIDE)
    owners, weights = [np.empty(0, np.intp)], [np.empty((0, 3), np.float32)]
    for n in np.unique(parts):
        own = np.flatnonzero(parts == n)
        i, j = np.meshgrid(np.arange(n + 1), np.arange(n + 1))
        kept = i + j <= n
        weight = np.stack([n - i[kept] - j[kept], i[kept], j[kept]], axis=1) / np.float32(n)
        owners.append(np.repeat(own, len(weight)))
        weights.append(np.tile(weight.astype(np.float32), (len(own), 1)))
    return np.concatenate(owners), np.concatenate(weights)


def _facets(points: F64, triangles: I32) -> F64:
    """Normals of triangles, as long as twice their area, shape `(m, 3)`."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return np.cross(b - a, c - a)


def _unit(vectors: F64) -> F64:
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300))


def _normals(points: F64, triangles: I32) -> F64:
    """Normals at the corners of triangles, shape `(m, 3, 3)`: smooth but at edges."""
    facet = _facets(points, triangles)
    mean = np.zeros_like(points)
    for k in range(3):
        np.add.at(mean, triangles[:, k], facet)
    own = np.repeat(_unit(facet)[:, None], 3, axis=1)
    smooth = _unit(mean)[triangles]
    return np.where(np.sum(own * smooth, axis=2, keepdims=True) > _SMOOTH, smooth, own)


def _edges(points: F64, triangles: I32, least: float) -> NDArray[np.intp]:
    """Ends of edges that hang together over a length; short ones are folds of a rough surface."""
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    order = np.lexsort(edges.T)
    edges, normal = edges[order], _unit(_facets(points, triangles))[order // 3]
    both = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    cosine = np.sum(normal[both] * normal[both + 1], axis=1)
    sharp = edges[both[cosine < np.cos(np.radians(_EDGE_ANGLE))]]
    graph = coo_array((np.ones(len(sharp)), sharp.T), shape=(len(points), len(points)))
    part = connected_components(graph, directed=False)[1][sharp[:, 0]]
    sides = {own: np.ptp(points[sharp[part == own]].reshape(-1, 3), axis=0) for own in set(part)}
    long = [own for own, side in sides.items() if np.linalg.norm(side) >= least]
    return np.asarray(sharp[np.isin(part, long)], np.intp)
