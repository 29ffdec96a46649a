"""Diffusion tensors by themselves: fit, numbers of each voxel, fibers in a mask.

Files in the output folder: `tensor.nii.gz` (xx, yy, zz, xy, xz, yz in the world frame),
`fa.nii.gz`, `md.nii.gz`, `eigenvalues.nii.gz` (largest first), `tensor_fibers.nii.gz` (of
averaged tensors, unit vectors in the world frame; `fibers.nii.gz` is that of `segment`, in its
muscles, and `build` takes no other by itself); `summary.json` gets `tensors`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import myork
from myork.console import ProgressCallback, silent
from myork.core.deck import load_deck
from myork.errors import InputError
from myork.imaging.diffusion import (
    known_tensors,
    read_tensors,
    tensor_maps,
)
from myork.imaging.geometry import check_same_grid
from myork.imaging.io import read_image, read_labels, renew_images
from myork.model.fibers import fiber_field
from myork.records import Image
from myork.segmentation.regions import body_mask
from myork.summary import renewing, update_summary
from myork.types import I32

__all__ = ["write_tensors"]


def write_tensors(
    deck: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Fit the tensors of a deck, without an anatomy or a segmentation.

    Parameters
    ----------
    deck : str, Path or mapping
        Deck file, or its tables as data; `image.dwi` or `image.tensor` is read, and `image.region`
        or `image.body` as the mask of the fibers.
    out : str or Path
        Folder of the results.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    threads : int, optional
        Not used; every station has it.
    progress : callable
        Called with a line of text at a time.

    Returns
    -------
    dict
        What was added to `summary.json`.
    """
    values, out = load_deck(deck, overrides, "tensors"), Path(out)
    table, folder = values["image"], Path(values["folder"])
    with renewing(out, "tensors"):
        tensor = read_tensors(table, folder)
        if tensor is None:
            raise InputError("myork tensors needs image.dwi or image.tensor")
        label = _mask(tensor, table, folder)
        progress(f"{tensor.name}: fibers in {int((label > 0).sum())} voxels")
        whole = np.where(np.isfinite(tensor.data).all(axis=-1, keepdims=True), tensor.data, 0.0)
        maps = tensor_maps(tensor)
        found = fiber_field(tensor, label, table.get("fiber_smoothing"))
        whole_tensor = Image(whole, tensor.affine)
        renew_images(out, tensor=whole_tensor, tensor_fibers=found.fibers, **maps)
        inside = label > 0
        known = inside & known_tensors(tensor.data)
        record = {
            "voxels": int(inside.sum()),
            "fa": float(np.median(maps["fa"].data[known])),
            "md": float(np.median(maps["md"].data[known])),
            "fiber_smoothing": found.smoothing,
            "filled": found.filled,
            "far": found.far,
        }
        for text in found.doubts():
            progress(text)
        progress(
            f"medians: FA {record['fa']:.3f}, MD {record['md']:.3g} mm^2/s; fibers averaged over "
            f"{found.smoothing:.2f} mm"
        )
        summary = {
            "title": values["title"],
            "deck_sha256": values["sha256"],
            "version": myork.__version__,
            "tensors": record,
        }
        update_summary(out, summary)
    return summary


def _mask(tensor: Image, table: Mapping[str, Any], folder: Path) -> I32:
    """Labels of the user's mask; one label where there is none: the body, or all tensors."""
    for key in ("region", "body"):
        if key in table:
            labels = read_labels(folder / table[key])
            check_same_grid(labels, tensor)
            return np.asarray(np.where(labels.data > 0, labels.data, 0), np.int32)
    known = known_tensors(tensor.data)
    if "dwi" in table:
        images = read_image(folder / table["dwi"], values=None)
        mean = np.nan_to_num(images.data).mean(axis=-1)
        known &= body_mask(Image(mean, images.affine, images.name), rim=0.0)
    return np.asarray(known, np.int32)
