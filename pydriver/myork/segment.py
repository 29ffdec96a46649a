"""Station one: images to a label map and fibers.

Files in the output folder: `anatomy.nii.gz` (the image that was segmented), `segmentation.nii.gz`
with `segmentation.json` (names), `fibers.nii.gz` (unit vectors in the world frame; with tensors
only), `summary.json`; from the phantom also its images and its truth (`write_phantom`).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import myork
from myork.console import ProgressCallback
from myork.core_image import evolve_level_sets
from myork.errors import FileError, InputError
from myork.imaging.diffusion import read_tensors
from myork.imaging.geometry import check_same_grid, length_factor
from myork.imaging.io import read_image, read_labels, write_image, write_labels
from myork.imaging.phantom import make_phantom, write_phantom
from myork.model.fibers import fiber_field
from myork.model.orientation import check_orientation
from myork.records import Image, Labels
from myork.segmentation.channels import scaled_values
from myork.segmentation.level_sets import LevelSets, Regions, segment_regions, wanted_phase
from myork.segmentation.regions import body_mask, box_mask, grown_mask, piece_with_seed
from myork.segmentation.scores import dice, pearson
from myork.summary import update_summary
from myork.tissue import find_tissues

__all__ = ["segment"]

_CHOICES = ("volume", "start", "mu", "nu", "epsilon", "dt", "tolerance", "iterations")


def segment(
    deck: Mapping[str, Any], folder: Path, out: Path, progress: ProgressCallback
) -> dict[str, Any]:
    """Segment the image of a deck, or the phantom where the deck names no image.

    Parameters
    ----------
    deck : mapping
        Effective deck; the tables `image`, `phantom` and `units` are read.
    folder : Path
        Where the deck's relative paths start.
    out : Path
        Folder of the results.
    progress : callable
        Called with a line of text at a time.

    Returns
    -------
    dict
        What was added to `summary.json`.
    """
    table = deck.get("image")
    if table is None:
        raise InputError("the deck has no table [image]; `segment` needs one")
    _make(out)
    image, tensor, truth = _inputs(deck, table, folder, out, progress)
    wanted = None if truth is None else _wanted(truth, table["truth_labels"])

    region = _region(image, table, folder)
    progress(f"segmenting {int(region.sum())} pixels in {image.data.shape[2]} slices")
    choice = LevelSets(
        regions=table["regions"],
        lambdas=table["lambda"],
        **{key: table[key] for key in _CHOICES},
    )
    grey = scaled_values(image, region)
    result = segment_regions(
        grey[..., np.newaxis],
        region,
        evolve_level_sets,
        choice,
        spacing=image.spacing,
        labels=_start_labels(image, table, folder),
        name=image.name,
    )
    inside = wanted_phase(result, grey, table["phase"])
    if "seed" in table:
        inside = piece_with_seed(inside, image, table["seed"])
    if not inside.any():
        raise InputError(
            f"{image.name}: the segmentation of the {table['phase']} phase is empty; check "
            "image.phase, image.box and image.mu"
        )
    labels = Labels(inside.astype(np.int32), image.affine, {1: table["label"]}, "segmentation")
    write_image(out / "anatomy.nii.gz", image)
    write_labels(out / "segmentation.nii.gz", labels)

    warnings = [] if not result.unrest else [_unrest(result, choice.iterations)]
    (out / "fibers.nii.gz").unlink(missing_ok=True)
    if tensor is not None:
        progress("fibers from the diffusion tensors")
        fibers, filled = fiber_field(
            tensor, inside, table["fiber_smoothing"], table["tensor_frame"]
        )
        write_image(out / "fibers.nii.gz", fibers)
        evidence, doubt = check_orientation(fibers, labels if truth is None else truth)
        warnings += [doubt] if doubt else []
        if filled:
            warnings.append(
                f"{tensor.name}: {filled} of {int(inside.sum())} tensors of the tissue are not "
                "finite or not positive; their neighbours were used"
            )
    summary = _summary(deck, table["label"], labels, result, wanted, warnings)
    if tensor is not None:
        summary["segmentation"]["orientation"] = [entry.record() for entry in evidence]
    if deck["tissue"]["find"]:
        progress("materials of the leg")
        summary["tissue"] = find_tissues(deck, folder, out, image, tensor)
    update_summary(out, summary)
    for line in (*_lines(summary), *(f"warning: {text}" for text in warnings)):
        progress(line)
    return summary


def _make(out: Path) -> None:
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as reason:
        raise FileError(f"{out}: the output folder cannot be made: {reason}") from None


def _inputs(
    deck: Mapping[str, Any],
    table: Mapping[str, Any],
    folder: Path,
    out: Path,
    progress: ProgressCallback,
) -> tuple[Image, Image | None, Labels | None]:
    """Anatomy, tensor and truth from files, or those of the phantom, which are also written."""
    if "anatomy" not in table:
        stray = [key for key in ("tensor", "dwi", "truth") if key in table]
        if stray:
            raise InputError(
                f"image.{stray[0]} needs image.anatomy; without it the phantom and its own "
                f"{stray[0]} are used"
            )
        keys = deck["phantom"]
        progress(f"phantom of {' x '.join(map(str, keys['size']))} voxels")
        phantom = make_phantom(**keys)
        write_phantom(out, phantom)
        return phantom.anatomy, phantom.tensor, phantom.truth
    image = read_image(folder / table["anatomy"])
    progress(f"{image.name}: {' x '.join(map(str, image.data.shape))} voxels")
    tensor = read_tensors(table, folder)
    truth = read_labels(folder / table["truth"]) if "truth" in table else None
    for other in (tensor, truth):
        if other is not None:
            check_same_grid(other, image)
    return image, tensor, truth


def _region(image: Image, table: Mapping[str, Any], folder: Path) -> NDArray[np.bool_]:
    """Pixels that take part."""
    region = body_mask(image)
    if "region" in table:
        map_ = read_labels(folder / table["region"])
        check_same_grid(map_, image)
        region &= grown_mask(map_, table["region_margin"])
    if "box" in table:
        region &= box_mask(image, table["box"])
    return region


def _start_labels(image: Image, table: Mapping[str, Any], folder: Path) -> NDArray[np.int32] | None:
    """Label map to start from, if the deck names one."""
    if "start_labels" not in table:
        return None
    labels = read_labels(folder / table["start_labels"])
    check_same_grid(labels, image)
    return labels.data


def _unrest(result: Regions, limit: int) -> str:
    return (
        f"{result.unrest} of {len(result.iterations)} blocks of slices still changed after "
        f"image.iterations = {limit}; raise it, or image.tolerance"
    )


def _wanted(truth: Labels, numbers: list[int]) -> NDArray[np.bool_]:
    """Voxels of the truth that should be found."""
    wanted = np.isin(truth.data, numbers) if numbers else truth.data > 0
    if not wanted.any():
        raise InputError(
            f"{truth.name}: no voxel has one of image.truth_labels = {list(numbers)}; "
            f"the labels there are: {np.unique(truth.data).tolist()}"
        )
    return wanted


def _summary(
    deck: Mapping[str, Any],
    name: str,
    labels: Labels,
    result: Regions,
    wanted: NDArray[np.bool_] | None,
    warnings: list[str],
) -> dict[str, Any]:
    """Entries for `summary.json`; volumes in the deck's unit of length, cubed."""
    inside = labels.data > 0
    pixels = int(inside.sum())
    voxel = float(np.prod(labels.spacing * length_factor(deck["units"]["length"])))
    scores = {}
    if wanted is not None:
        scores[name] = {"dice": dice(inside, wanted), "pcc": pearson(inside, wanted)}
    return {
        "title": deck["title"],
        "deck_sha256": deck["sha256"],
        "version": myork.__version__,
        "units": dict(deck["units"]),
        "segmentation": {
            "labels": {name: {"pixels": pixels, "volume": pixels * voxel}},
            "scores": scores,
            "iterations": int(result.iterations.max()),
            "converged": not result.unrest,
            "energy": result.energy.tolist(),
            "warnings": warnings,
        },
    }


def _lines(summary: Mapping[str, Any]) -> list[str]:
    """What to tell at the end."""
    found = summary["segmentation"]
    unit = summary["units"]["length"]
    lines = [
        f"{name}: {entry['pixels']} pixels, {entry['volume']:.4g} {unit}^3"
        for name, entry in found["labels"].items()
    ]
    lines += [
        f"{name}: Dice {score['dice']:.3f}, PCC {score['pcc']:.3f} against the truth"
        for name, score in found["scores"].items()
    ]
    return lines
