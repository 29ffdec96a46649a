"""Figures of a segmentation: slices with contours and fibers.

Pictures are shown in the canonical frame (right, anterior, superior), whatever the order and the
signs of the voxel axes in the file.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from scipy import ndimage

from myork.files import write_figure
from myork.imaging.geometry import canonical
from myork.imaging.io import read_image, read_labels
from myork.records import Image, Labels
from myork.report.figures import draw_strokes, label_colours
from myork.types import F64, I32, Mask

#: Margin shown around the labels [mm]
_AROUND = 10.0
#: Fibers drawn across the longer side of a picture
_FIBERS_ACROSS = 28
_FIBER_COLOUR = "#FFD700"
#: Relative heights of the axial slices among those with labels
_HEIGHTS = (0.15, 0.5, 0.85)


def slice_figure(labels: Labels, image: Image | None, fibers: Image | None) -> Figure:
    """Three axial slices and a coronal one, with the contour of each label and fibers.

    Image and fiber vectors (world frame) are on the grid of the labels; without an image the labels
    are filled. Panels are cropped to the labels, with one panel for a single slice. Lengths are in
    mm of the world, as for seeds, or from the corner of the image if it is oblique.
    """
    body = _Body.of(labels, image, fibers)
    rows = np.flatnonzero(body.labels.any(axis=(0, 2)))
    cuts = [(2, k) for k in _axial(body.labels > 0)]
    cuts.append((1, int(np.median(rows)) if len(rows) else body.labels.shape[1] // 2))

    width, depth, height = np.array(body.labels.shape) * body.spacing
    figure = Figure(figsize=(11.0, 3.9), layout="constrained")
    if body.labels.shape[2] == 1:
        panels, cuts = [figure.subplots()], cuts[:1]
    else:
        ratios = [width / depth] * 3 + [max(width / height, 0.5)]
        panels = figure.subplots(1, 4, width_ratios=ratios)
    for axes, (normal, index) in zip(panels, cuts, strict=True):
        body.draw(axes, normal, index)
        place = body.corner[normal] + (index + 0.5) * body.spacing[normal]
        name, up = ("coronal, y", "superior") if normal == 1 else ("axial, z", "anterior")
        axes.set(title=f"{name} = {place:.0f} mm", xlabel="right → [mm]")
        if axes in (panels[0], panels[-1]):
            axes.set_ylabel(f"{up} → [mm]")
    handles = [
        Line2D([], [], color=colour, linewidth=2, label=labels.label_name(label))
        for label, colour in body.colours.items()
    ]
    if fibers is not None:
        handles.append(Line2D([], [], color=_FIBER_COLOUR, linewidth=2, label="fibers (in plane)"))
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False)
    return figure


def _axial(known: Mask) -> list[int]:
    """Three axial slices among those that have labels, or among all."""
    filled = np.flatnonzero(known.any(axis=(0, 1)) | (not known.any()))
    return list(filled[np.round(np.array(_HEIGHTS) * (len(filled) - 1)).astype(int)].tolist())


def draw_labels(folder: Path) -> list[Path]:
    """Draw the label maps that `segment` wrote to a folder over the image, as PNG beside them.

    - `folder`: output folder of `segment`
    - returns `segmentation.png`, and `tissue.png` where there are tissues
    """
    image, pictures = read_image(folder / "anatomy.nii.gz"), []
    for name in ("segmentation", "tissue"):
        labels, picture = folder / f"{name}.nii.gz", folder / f"{name}.png"
        if labels.is_file():
            write_figure(picture, slice_figure(read_labels(labels), image, None))
            pictures.append(picture)
        else:
            picture.unlink(missing_ok=True)
    return pictures


def _corner(shown: Labels) -> F64:
    """Lowest corner of a reoriented map in the world, zero if it is oblique, shape `(3,)` [mm]."""
    straight = np.allclose(shown.affine[:3, :3] / shown.spacing, np.eye(3), atol=1e-3)
    return shown.world([-0.5] * 3) if straight else np.zeros(3)


@dataclass(frozen=True)
class _Body:
    """Image region around the labels, with axes turned to right, anterior, superior."""

    #: Labels, image, and components of the fibers along the turned axes
    labels: I32
    grey: F64 | None
    vectors: F64 | None
    #: Size of a voxel, and lowest corner in the world, shape `(3,)` [mm]
    spacing: F64
    corner: F64
    colours: dict[int, str]  #: Of the labels

    @classmethod
    def of(cls, labels: Labels, image: Image | None, fibers: Image | None) -> "_Body":
        """The part of the images that contains the labels, with a margin of some millimetres."""
        shown = canonical(labels)
        found = ndimage.find_objects((shown.data > 0).astype(np.int8))
        parts = found[0] if found else tuple(slice(0, n) for n in shown.data.shape)
        room = np.ceil(_AROUND / shown.spacing).astype(int).tolist()
        around = tuple(
            slice(max(part.start - more, 0), part.stop + more)
            for part, more in zip(parts, room, strict=True)
        )
        where = shown.data[around]
        directions = shown.affine[:3, :3] / shown.spacing
        return cls(
            where,
            None if image is None else canonical(image).data[around],
            None if fibers is None else canonical(fibers).data[around] @ directions,
            shown.spacing,
            _corner(shown)
            + [part.start * step for part, step in zip(around, shown.spacing, strict=True)],
            label_colours(np.unique(where[where > 0]).tolist()),
        )

    def draw(self, axes: Axes, normal: int, index: int) -> None:
        """A plane normal to an axis: image, contours, fibers."""
        plane = [axis for axis in range(3) if axis != normal]
        cut = tuple(index if axis == normal else slice(None) for axis in range(3))
        where, spacing, start = self.labels[cut], self.spacing[plane], self.corner[plane]
        end = start + where.shape * spacing
        box = (start[0], end[0], start[1], end[1])
        if self.grey is not None:
            top = np.nanpercentile(self.grey, 99.5)
            shade = self.grey[cut].T
            axes.imshow(shade, origin="lower", extent=box, cmap="gray", vmin=0.0, vmax=top or 1)
        x, y = (
            begin + (np.arange(count) + 0.5) * step
            for begin, count, step in zip(start, where.shape, spacing, strict=True)
        )
        for label, colour in self.colours.items():
            mask = (where == label).T
            if mask.any() and min(mask.shape) > 1:
                # The line between two labels has the colour of one of them, the faces have both.
                axes.contourf(x, y, mask, levels=[0.5, 1.5], colors=[colour], alpha=0.3)
                axes.contour(x, y, mask, levels=[0.5], colors=[colour], linewidths=1.0)
        if self.vectors is not None:
            vectors = self.vectors[cut][..., plane]
            # at even distances
            long = float(np.max(where.shape * spacing)) / _FIBERS_ACROSS
            apart = np.maximum(np.ceil(long / spacing), 1).astype(int)
            some = np.zeros_like(where, bool)
            some[:: apart[0], :: apart[1]] = True
            some &= (where > 0) & np.isfinite(vectors).all(axis=-1) & vectors.any(axis=-1)
            i, j = np.nonzero(some)
            at = np.stack([x[i], y[j]], axis=1)
            draw_strokes(axes, at, vectors[i, j], long, width=0.008, color=_FIBER_COLOUR)
        axes.set_aspect("equal")
        axes.set(xlim=box[:2], ylim=box[2:])
