"""Figures of a segmentation: slices with contours and fibers, areas of the labels.

Pictures are shown in the canonical frame (right, anterior, superior), whatever the order and the
signs of the voxel axes in the file.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from nibabel.orientations import apply_orientation, io_orientation
from numpy.typing import NDArray
from scipy import ndimage

from myork.records import Image, Labels
from myork.report.figures import COLOURS, DASHES, MARKERS
from myork.report.sketch import draw_strokes
from myork.types import F64, I32, Mask

__all__ = ["area_figure", "slice_figure"]


# What is shown around the labels [mm]
_AROUND = 10.0
# Fibers drawn across the longer side of a picture
_FIBERS_ACROSS = 28
_FIBER_COLOUR = "#FFD700"


def slice_figure(labels: Labels, image: Image | None, fibers: Image | None) -> Figure:
    """Three axial slices and a coronal one, with the contour of each label and fibers.

    Parameters
    ----------
    labels : Labels
        Label map.
    image : Image or None
        Image behind it, on the same grid; without it the labels are filled.
    fibers : Image or None
        Fiber vectors in the world frame, on the same grid.

    Returns
    -------
    Figure
        Four panels around the labels, one for a single slice; lengths in mm of the world, as seeds
        are given, from the corner of the image where that lies askew.
    """
    frame = _Frame(labels)
    around = frame.around(labels.data)
    where = frame.canonical(labels.data)[around]
    grey = None if image is None else frame.canonical(image.data)[around]
    vectors = None if fibers is None else frame.directions(fibers.data)[around]
    corner = frame.corner + [
        part.start * step for part, step in zip(around, frame.spacing, strict=True)
    ]
    filled = np.flatnonzero(where.any(axis=(0, 1)))
    if not len(filled):
        filled = np.arange(where.shape[2])
    axial = filled[np.round(np.array([0.15, 0.5, 0.85]) * (len(filled) - 1)).astype(int)]
    rows = np.flatnonzero(where.any(axis=(0, 2)))
    coronal = int(np.median(rows)) if len(rows) else where.shape[1] // 2

    width, depth, height = np.array(where.shape) * frame.spacing
    figure = Figure(figsize=(11.0, 3.9), layout="constrained")
    shape = width / depth
    flat = where.shape[2] == 1
    if flat:
        panels = np.array([figure.subplots()])
    else:
        panels = figure.subplots(1, 4, width_ratios=(shape, shape, shape, max(width / height, 0.5)))
    colours = {
        label: COLOURS[number % len(COLOURS)]
        for number, label in enumerate(np.unique(where[where > 0]).tolist(), start=1)
    }
    for axes, index in zip(panels, axial, strict=False):
        cut: tuple = (slice(None), slice(None), index)
        _draw_slice(axes, frame.spacing, corner, where, grey, cut, vectors, (0, 1), colours)
        axes.set(
            title=f"axial, z = {corner[2] + (index + 0.5) * frame.spacing[2]:.0f} mm",
            xlabel="right → [mm]",
            ylabel="anterior → [mm]" if axes is panels[0] else "",
        )
    if not flat:
        cut = (slice(None), coronal, slice(None))
        _draw_slice(panels[3], frame.spacing, corner, where, grey, cut, vectors, (0, 2), colours)
        panels[3].set(
            title=f"coronal, y = {corner[1] + (coronal + 0.5) * frame.spacing[1]:.0f} mm",
            xlabel="right → [mm]",
            ylabel="superior → [mm]",
        )
    handles = [
        Line2D([], [], color=colour, linewidth=2, label=labels.label_name(label))
        for label, colour in colours.items()
    ]
    if vectors is not None:
        handles.append(Line2D([], [], color=_FIBER_COLOUR, linewidth=2, label="fibers (in plane)"))
    figure.legend(handles=handles, loc="outside lower center", ncols=6, frameon=False)
    return figure


def area_figure(labels: Labels, energy: Sequence[float]) -> Figure:
    """Cross-sectional area of each label along the stack, and the energy of the segmentation.

    Parameters
    ----------
    labels : Labels
        Label map.
    energy : Sequence of float
        Energy in each iteration [-]; empty where it was not recorded.

    Returns
    -------
    Figure
        One curve for each label; a second panel for the energy.
    """
    frame = _Frame(labels)
    where = frame.canonical(labels.data)
    heights = frame.corner[2] + (np.arange(where.shape[2]) + 0.5) * frame.spacing[2]
    panels = 2 if len(energy) > 1 else 1
    figure = Figure(figsize=(5.5 * panels, 3.4), layout="constrained")
    axes = figure.add_subplot(1, panels, 1)
    for number, label in enumerate(np.unique(where[where > 0]).tolist()):
        area = (where == label).sum(axis=(0, 1)) * frame.spacing[0] * frame.spacing[1] / 100.0
        axes.plot(
            heights, area, DASHES[number % 4], color=COLOURS[(number + 1) % len(COLOURS)],
            marker=MARKERS[number % len(MARKERS)], markersize=4, label=labels.label_name(label),
        )  # fmt: skip
    axes.set(xlabel="height z (superior →) [mm]", ylabel="cross-sectional area [cm²]")
    axes.set_ylim(bottom=0.0)
    axes.grid(color="#E5E5E5")
    if axes.lines:
        axes.legend(frameon=False, fontsize="small")
    if panels == 2:
        axes = figure.add_subplot(1, 2, 2)
        axes.plot(np.arange(1, len(energy) + 1), energy, color=COLOURS[0])
        axes.set(xlabel="iteration", ylabel="segmentation energy [-]")
        axes.grid(color="#E5E5E5")
    return figure


class _Frame:
    """The canonical frame of a label map: axes turned to right, anterior, superior."""

    def __init__(self, labels: Labels) -> None:
        self._turn = io_orientation(labels.affine)
        axis = np.argsort(self._turn[:, 0])
        self.spacing = labels.spacing[axis]
        # Columns: directions of the canonical axes in the world
        self._axes = labels.affine[:3, :3][:, axis] * self._turn[axis, 1] / self.spacing
        # Lowest corner of the image in the world, where its axes are those of the world [mm]
        self.corner = np.zeros(3)
        if np.allclose(self._axes, np.eye(3), atol=1e-3):
            last = np.array([*labels.data.shape, 1.0]) - [1.0, 1.0, 1.0, 0.0]
            ends = labels.affine[:3] @ np.array([[0.0, 0.0, 0.0, 1.0], last]).T
            self.corner = ends.min(axis=1) - 0.5 * self.spacing

    def canonical(self, data: NDArray) -> NDArray:
        """Array of shape `(ni, nj, nk, ...)` with its axes turned."""
        return apply_orientation(data, self._turn)

    def around(self, data: I32) -> tuple[slice, slice, slice]:
        """The part of the turned array in which labels lie, and what is around them."""
        found = ndimage.find_objects((self.canonical(data) > 0).astype(np.int8))
        parts = found[0] if found else (slice(0, n) for n in self.canonical(data).shape)
        room = np.ceil(_AROUND / self.spacing).astype(int)
        first, second, third = (
            slice(max(part.start - more, 0), part.stop + more)
            for part, more in zip(parts, room.tolist(), strict=True)
        )
        return first, second, third

    def directions(self, data: F64) -> F64:
        """World vectors as components along the canonical axes, turned as well."""
        return self.canonical(data) @ self._axes


def _draw_slice(
    axes: Axes,
    sizes: F64,
    corner: F64,
    labels: I32,
    grey: F64 | None,
    cut: tuple,
    vectors: F64 | None,
    plane: tuple[int, int],
    colours: dict[int, str],
) -> None:
    """One picture: image, contours, fibers."""
    where, spacing, start = labels[cut], sizes[list(plane)], corner[list(plane)]
    end = start + where.shape * spacing
    box = (start[0], end[0], start[1], end[1])
    if grey is not None:
        top = np.nanpercentile(grey, 99.5)
        axes.imshow(grey[cut].T, origin="lower", extent=box, cmap="gray", vmin=0.0, vmax=top or 1)
    x, y = (
        begin + (np.arange(n) + 0.5) * step
        for begin, n, step in zip(start, where.shape, spacing, strict=True)
    )
    for label, colour in colours.items():
        mask = (where == label).T
        if mask.any() and min(mask.shape) > 1:
            # The line between two labels has the colour of one of them, the faces have both.
            axes.contourf(x, y, mask, levels=[0.5, 1.5], colors=[colour], alpha=0.3)
            axes.contour(x, y, mask, levels=[0.5], colors=[colour], linewidths=1.0)
    if vectors is not None:
        _draw_fibers(axes, spacing, (x, y), vectors[cut][..., plane], where > 0)
    axes.set_aspect("equal")
    axes.set(xlim=box[:2], ylim=box[2:])


def _draw_fibers(
    axes: Axes, spacing: F64, places: tuple[F64, F64], vectors: F64, inside: Mask
) -> None:
    """Strokes without heads: a fiber has no sign."""
    length = float(np.max(inside.shape * spacing)) / _FIBERS_ACROSS
    step = np.maximum(np.ceil(length / spacing), 1).astype(int)
    some = np.zeros_like(inside)
    some[:: step[0], :: step[1]] = True
    some &= inside & np.isfinite(vectors).all(axis=-1) & vectors.any(axis=-1)
    i, j = np.nonzero(some)
    at = np.stack([places[0][i], places[1][j]], axis=1)
    draw_strokes(axes, at, vectors[i, j], length, width=0.008, color=_FIBER_COLOUR)
