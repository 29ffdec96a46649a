"""Diffusion tensors by themselves: fit, numbers of each voxel, fibers in a mask.

Files in the output folder: `tensor.nii.gz` (xx, yy, zz, xy, xz, yz in the world frame),
`fa.nii.gz`, `md.nii.gz`, `eigenvalues.nii.gz` (largest first), `tensor_fibers.nii.gz` (of
averaged tensors, unit vectors in the world frame; `fibers.nii.gz` is that of `segment`, in its
muscles, and `build` takes no other by itself); `summary.json` gets `tensors`.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from myork.console import ProgressCallback
from myork.errors import InputError
from myork.imaging.diffusion import finite_tensors, known_tensors, tensor_maps
from myork.imaging.geometry import slice_axis, with_axis_at
from myork.imaging.io import renew_images
from myork.model.fibers import fibers_of_labels
from myork.records import Image, Labels
from myork.segmentation.regions import body_mask
from myork.stations.data import DeckFiles, OneGrid
from myork.stations.station import station


@station("tensors", "tensors")
def write_tensors(deck: Mapping[str, Any], out: Path, progress: ProgressCallback) -> dict[str, Any]:
    """Fit the tensors of a deck, without an anatomy or a segmentation.

    Of the table `image`, `dwi` or `tensor` is read, and `region` or `body` as the mask of the
    fibers.
    """
    files = DeckFiles(deck, "image", OneGrid(progress))
    measured = files.tensors()
    if measured is None:
        raise InputError("myork tensors needs image.dwi or image.tensor")
    tensor, mean = measured
    labels = _mask(tensor, mean, files)
    inside = labels.data > 0
    progress(f"{tensor.name}: fibers in {int(inside.sum())} voxels")
    maps = tensor_maps(tensor)
    found = fibers_of_labels(tensor, labels, files.table.get("fiber_smoothing"))
    whole = Image(finite_tensors(tensor.data), tensor.affine)
    renew_images(out, tensor=whole, tensor_fibers=found.fibers, **maps)
    known = inside & known_tensors(tensor.data)
    record = {
        "voxels": int(inside.sum()),
        "fa": float(np.median(maps["fa"].data[known])),
        "md": float(np.median(maps["md"].data[known])),
        "fiber_smoothing": found.smoothing,
        "filled": found.filled,
        "far": found.far,
    }
    doubts = [*files.grid.doubts, *found.doubts()]
    for text in (found.axes.remark, *(f"warning: {doubt}" for doubt in doubts)):
        if text:
            progress(text)
    progress(
        f"medians: FA {record['fa']:.3f}, MD {record['md']:.3g} mm^2/s; fibers averaged over "
        f"{found.smoothing:.2f} mm"
    )
    return {"tensors": record, "grid": files.grid}


def _mask(tensor: Image, mean: Image | None, files: DeckFiles) -> Labels:
    """Labels of the user's mask; one label where there is none: the body, or all tensors."""
    for key in ("region", "body"):
        labels = files.labels(key, tensor)
        if labels is not None:
            return labels
    known = known_tensors(tensor.data)
    if mean is not None:
        axis = slice_axis(mean.spacing, mean.data.shape)
        known &= np.moveaxis(body_mask(with_axis_at(mean, axis, 2), rim=0.0), 2, axis)
    return Labels(np.asarray(known, np.int32), tensor.affine)
