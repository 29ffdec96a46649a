"""Helpers of the image tests: decks, files, diffusion images of the phantom."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from benchmarks.truths.scanners import even_directions, weighted
from myork.core.deck import text_of_tables
from myork.imaging.gradients import GradientTable
from myork.imaging.io import read_labels, write_image, write_labels
from myork.imaging.phantom import Phantom, rician
from myork.records import Image, Labels
from myork.stations.build import build
from myork.stations.segment import segment
from myork.types import F64

UNITS = {"force": "N", "length": "mm"}


def angle(a: ArrayLike, b: ArrayLike) -> F64:
    """Angle between fibers, which have no sign [degree]."""
    cosine = np.abs((np.asarray(a) * np.asarray(b)).sum(-1))
    return np.degrees(np.arccos(np.clip(cosine, 0, 1)))


def save(folder: Path, affine: F64, **files: Any) -> None:
    """Write arrays as files of their names: as labels if they are integers or records."""
    for name, data in files.items():
        path = folder / f"{name}.nii.gz"
        if isinstance(data, Labels):
            write_labels(path, data)
        elif isinstance(data, Image):
            write_image(path, data)
        elif np.asarray(data).dtype.kind in "iub":
            write_labels(path, Labels(np.asarray(data, np.int32), affine))
        else:
            write_image(path, Image(data, affine))


def segmented(folder: Path, out: str = "out", **tables: Any) -> dict[str, Any]:
    """Summary of `segment` on the files of a folder; without shading, unless a table sets it."""
    deck = {"scene": {"dimension": 3}, "bias": {"method": "none"}, **tables}
    (folder / "deck.toml").write_text(text_of_tables(deck))
    return segment(folder / "deck.toml", folder / out, progress=print)


def built(folder: Path, dimension: int = 3, **table: Any) -> dict[str, Any]:
    """Entry `model` of the summary of `build` for a table whose files are in a folder."""
    files = {k: str(folder / v) for k, v in table.items() if str(v).endswith(".nii.gz")}
    deck = {"title": "t", "units": UNITS, "scene": {"dimension": dimension}}
    return build({**deck, "build": {**table, **files}}, folder / "out")["model"]


def phantom_dwi(
    phantom: Phantom, snr: float = 25.0, directions: int = 30
) -> tuple[Image, GradientTable]:
    """Diffusion images of a phantom with Rician noise, with a tenth more without gradient."""
    still = max(1, directions // 10)
    direction = np.vstack([np.zeros((still, 3)), even_directions(directions)])
    table = GradientTable(np.repeat([0.0, 500.0], [still, directions]), direction)
    signal = weighted(phantom.still.data, phantom.clean_tensor.data, table)
    noisy = rician(signal, 400.0 / snr, np.random.default_rng(1))
    return Image(noisy, phantom.still.affine, "dwi"), table


def affine_of(spacing: ArrayLike, origin: ArrayLike = 0.0) -> F64:
    """Affine of a grid along the axes of the world [mm]."""
    affine = np.diag([*np.broadcast_to(np.asarray(spacing, float), 3), 1.0])
    affine[:3, 3] = origin
    return affine


def centred(*shape: int) -> F64:
    """Indices of voxels relative to the middle of a grid, shape `(3, *shape)`."""
    return np.indices(shape) - (np.reshape(shape, (-1, *[1] * len(shape))) - 1) / 2


def labels_in(folder: Path, name: str = "segmentation") -> Any:
    """Numbers of a label map that a station wrote."""
    return read_labels(folder / f"{name}.nii.gz").data
