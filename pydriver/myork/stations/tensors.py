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
from numpy.typing import NDArray

import myork
from myork.console import ProgressCallback, silent
from myork.core.deck import read_deck
from myork.errors import InputError
from myork.imaging.diffusion import (
    fractional_anisotropy,
    full_tensors,
    mean_diffusivity,
    read_tensors,
    tensor_components,
)
from myork.imaging.geometry import check_same_grid, frame
from myork.imaging.io import read_image, read_labels, write_image
from myork.model.fibers import fiber_field
from myork.records import Image
from myork.segmentation.regions import body_mask
from myork.summary import renewing, update_summary

__all__ = ["tensor_maps", "write_tensors"]


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
    values, out = read_deck(deck, overrides, "tensors"), Path(out)
    table, folder = values["image"], Path(values["folder"])
    with renewing(out, "tensors"):
        tensor = read_tensors(table, folder)
        if tensor is None:
            raise InputError("myork tensors needs image.dwi or image.tensor")
        if table["tensor_frame"] == "voxel":
            axes = frame(tensor.affine)
            turned = tensor_components(axes @ full_tensors(tensor.data) @ axes.T)
            tensor = Image(turned, tensor.affine, tensor.name)
        label = _mask(tensor, table, folder)
        progress(f"{tensor.name}: fibers in {int((label > 0).sum())} voxels")
        write_image(out / "tensor.nii.gz", Image(_or_zero(tensor.data), tensor.affine))
        maps = tensor_maps(tensor)
        for name, image in maps.items():
            write_image(out / f"{name}.nii.gz", image)
        found = fiber_field(tensor, label, table.get("fiber_smoothing"))
        write_image(out / "tensor_fibers.nii.gz", found.fibers)
        inside = label > 0
        known = inside & _known(tensor.data)
        record = {
            "voxels": int(inside.sum()),
            "fa": float(np.median(maps["fa"].data[known])),
            "md": float(np.median(maps["md"].data[known])),
            "fiber_smoothing": found.smoothing,
            "filled": found.filled,
            "far": found.far,
        }
        if found.far:
            progress(
                f"{found.far} voxels have no usable tensor around them and took the fiber of the "
                f"nearest voxel that has, up to {found.distance:.3g} mm away"
            )
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


def tensor_maps(tensor: Image) -> dict[str, Image]:
    """Fractional anisotropy, mean diffusivity and eigenvalues; zero where there is no tensor.

    Parameters
    ----------
    tensor : Image
        Shape `(ni, nj, nk, 6)` [mm^2/s].

    Returns
    -------
    dict
        `fa` and `md` of shape `(ni, nj, nk)`, `eigenvalues` of shape `(ni, nj, nk, 3)`, the largest
        first.
    """
    components = _or_zero(tensor.data)
    values = np.linalg.eigvalsh(full_tensors(components))[..., ::-1]
    maps = {
        "fa": fractional_anisotropy(components),
        "md": mean_diffusivity(components),
        "eigenvalues": values,
    }
    return {
        name: Image(data.astype(np.float64), tensor.affine, name) for name, data in maps.items()
    }


def _known(components: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Voxels that have a tensor."""
    return np.asarray(np.isfinite(components).all(axis=-1) & components.any(axis=-1), np.bool_)


def _or_zero(components: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.where(np.isfinite(components).all(axis=-1, keepdims=True), components, 0.0)


def _mask(tensor: Image, table: Mapping[str, Any], folder: Path) -> NDArray[np.int32]:
    """Labels of the user's mask; one label where there is none: the body, or all tensors."""
    for key in ("region", "body"):
        if key in table:
            labels = read_labels(folder / table[key])
            check_same_grid(labels, tensor)
            return np.asarray(np.where(labels.data > 0, labels.data, 0), np.int32)
    known = _known(tensor.data)
    if "dwi" in table:
        images = read_image(folder / table["dwi"], values=None)
        mean = np.nan_to_num(images.data).mean(axis=-1)
        known &= body_mask(Image(mean, images.affine, images.name), rim=0.0)
    return np.asarray(known, np.int32)
