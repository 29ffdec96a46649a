"""Diffusion tensors from diffusion-weighted images, and measures of tensors.

Tensors (4.1) are symmetric and stored as xx, yy, zz, xy, xz, yz.

References: [1] Basser, Mattiello, Le Bihan, J. Magn. Reson. B 103 (1994),
doi:10.1006/jmrb.1994.1037; [2] Salvador et al., Hum. Brain Mapp. 24 (2005), doi:10.1002/hbm.20076
(weights from the fit)
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.errors import InputError
from myork.imaging.dicom import converted, series_files, split_choice
from myork.imaging.geometry import frame
from myork.imaging.gradients import GradientTable, read_gradients
from myork.imaging.headers import described_by
from myork.imaging.io import read_image
from myork.records import Image
from myork.types import F64, I64, Mask

# Order of the components
_PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
#: Weight of each squared component in the norm of a tensor
SQUARES = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0])
# Voxels solved at a time: with 33 images they take some tens of megabytes.
_CHUNK = 20000
# Number of random orders of the directions, and the fraction of them that may fit equally well:
# none does on phantoms with a correct table down to SNR 2, at least 2 % do with a wrong one
_ORDERS, _BETTER = 200, 0.01
# With fewer images beyond the seven unknowns, any order fits too well for a comparison
_LEAST_SPARE = 5
# Factor between the signal of a volume in the body and that predicted by all others from which on
# it is damaged, and the least part of a volume that must not predict itself (seven directions are
# too few). Right volumes differ by up to 2.5 % in muscle, by 30 % in parallel white matter, those
# of wrong tables by 15 %; beyond the last b value signals near the noise do not follow tensors.
_OFF, _FREE, _LAST_B = 1.4, 0.3, 1200.0
# Mean diffusivity of living and fixed tissue, with margins; free water has 3e-3 [mm^2/s]
_DIFFUSIVITY = (3e-4, 4e-3)
_ZERO = 0.01  # component of a direction that counts as zero
# A design with a larger condition number does not determine all six components.
_WORST_CONDITION = 1e4


def tensor_components(full: F64) -> F64:
    """Components xx, yy, zz, xy, xz, yz, shape `(..., 6)`, of tensors of shape `(..., 3, 3)`."""
    return np.stack([full[..., i, j] for i, j in _PAIRS], axis=-1)


def dyads_of(vector: F64) -> F64:
    """Components of the dyads of vectors, shape `(..., 6)` from `(..., 3)`."""
    return tensor_components(vector[..., :, np.newaxis] * vector[..., np.newaxis, :])


def unit_vectors(vector: F64) -> tuple[F64, Mask]:
    """Unit vectors, shape `(..., 3)`, zero for zero vectors, and a mask of the others."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    known = np.isfinite(length) & (length > 0)
    return np.divide(vector, length, out=np.zeros(vector.shape), where=known), known[..., 0]


def full_tensors(components: F64) -> F64:
    """Symmetric tensors of shape `(..., 3, 3)` from `(..., 6)`."""
    full = np.empty((*components.shape[:-1], 3, 3))
    for place, (i, j) in enumerate(_PAIRS):
        full[..., i, j] = full[..., j, i] = components[..., place]
    return full


def lead_vector(components: F64) -> F64:
    """Unit eigenvector of the largest eigenvalue, turned to point upwards (z, then y, then x).

    - `components`: symmetric tensors xx, yy, zz, xy, xz, yz, shape `(n, 6)`
    """
    vector = np.linalg.eigh(full_tensors(components))[1][..., -1]
    z_y_x = vector[..., ::-1]
    first = np.argmax(np.abs(z_y_x) > 1e-9, axis=-1)
    sign = np.sign(np.take_along_axis(z_y_x, first[..., np.newaxis], axis=-1))
    return vector * sign


def mean_diffusivity(components: F64) -> F64:
    """Third of the trace, shape `(...)`, unit of the tensors."""
    return components[..., :3].mean(axis=-1)


def fractional_anisotropy(components: F64) -> F64:
    """Fractional anisotropy, 0 for equal eigenvalues to 1 for a stick, shape `(...)` [-]."""
    mean = mean_diffusivity(components)[..., np.newaxis]
    shift = components - mean * [1, 1, 1, 0, 0, 0]
    norm, rest = ((SQUARES * one**2).sum(axis=-1) for one in (components, shift))
    ratio = np.divide(rest, norm, out=np.zeros(norm.shape), where=norm > 0)
    return np.sqrt(1.5 * ratio)


def tensor_maps(tensor: Image) -> dict[str, Image]:
    """Fractional anisotropy, mean diffusivity and eigenvalues; zero where there is no tensor.

    - `tensor`: shape `(ni, nj, nk, 6)` [mm^2/s]
    - returns `fa` and `md` of shape `(ni, nj, nk)`, `eigenvalues` of shape `(ni, nj, nk, 3)`, the
      largest first
    """
    components = finite_tensors(tensor.data)
    maps: dict[str, F64] = {
        "fa": fractional_anisotropy(components),
        "md": mean_diffusivity(components),
        "eigenvalues": np.asarray(np.linalg.eigvalsh(full_tensors(components))[..., ::-1], float),
    }
    return {name: Image(data, tensor.affine, name) for name, data in maps.items()}


def finite_tensors(components: F64) -> F64:
    """Components of tensors, shape `(..., 6)`, all set to zero where one of them is not finite."""
    return np.where(np.isfinite(components).all(axis=-1, keepdims=True), components, 0.0)


def known_tensors(components: F64) -> Mask:
    """Voxels that have a tensor, shape `(...)`, of components of shape `(..., 6)`."""
    return np.asarray(np.isfinite(components).all(axis=-1) & components.any(axis=-1), np.bool_)


def fit_tensors(dwi: Image, table: GradientTable) -> Image:
    """Fit a tensor to every voxel by weighted least squares of the logarithms.

    A fit with equal weights predicts signals whose squares are the weights of the second fit: the
    variance of the logarithm of a signal is inversely proportional to its square [2].

    - `dwi`: diffusion-weighted images, shape `(ni, nj, nk, nvolume)`
    - `table`: their gradients in the world frame
    - returns tensors in the world frame, shape `(ni, nj, nk, 6)` [mm^2/s]; not a number where a
      signal is not finite or no image without gradient has a signal
    """
    unit = float(table.b.max())
    design = np.column_stack([np.ones(len(table.b)), -table.design() / unit])
    if dwi.data.shape[3:] != (len(design),):
        raise InputError(
            f"{dwi.name}: a volume for each of {len(design)} gradients is needed, its shape is "
            f"{dwi.data.shape}"
        )
    condition = np.linalg.cond(design)
    if len(design) < 7 or not condition < _WORST_CONDITION:
        raise InputError(
            f"{dwi.name}: its {len(table.b)} gradients do not determine a tensor (condition number "
            f"{condition:.3g}); six directions in general position and an image without gradient, "
            "or a second b value, are needed"
        )
    signal = dwi.data.reshape(-1, len(design))
    still = signal[:, table.still] if table.still.any() else signal
    usable = np.flatnonzero(np.isfinite(signal).all(axis=1) & (still.mean(axis=1) > 0))
    tensor = np.full((len(signal), 6), np.nan)
    if len(usable):
        floor = 1e-4 * still[usable].mean()
        inverse = np.linalg.pinv(design)
        for first in range(0, len(usable), _CHUNK):
            rows = usable[first : first + _CHUNK]
            logarithm = np.log(np.maximum(signal[rows], floor))
            weight = np.exp(2.0 * (logarithm @ inverse.T) @ design.T)
            normal = np.einsum("vn,ni,nj->vij", weight, design, design, optimize=True)
            right = np.einsum("vn,ni->vi", weight * logarithm, design, optimize=True)
            tensor[rows] = np.linalg.solve(normal, right[..., np.newaxis])[:, 1:, 0] / unit
    return Image(tensor.reshape(*dwi.data.shape[:3], 6), dwi.affine, dwi.name)


def diffusion_doubts(dwi: Image, table: GradientTable, tensor: Image) -> list[str]:
    """Warnings about diffusion images, their gradients and the tensors fitted to them."""
    signal = np.abs(np.nan_to_num(dwi.data))
    mean = signal.mean(axis=-1)
    body = mean >= (1 - 1e-9) * mean.mean()
    doubts = [_order_doubt(dwi, table), _sign_doubt(table.direction @ frame(dwi.affine))]
    doubts += [_volume_doubt(signal[body].mean(axis=0), table)]
    typical = np.nanmedian(np.append(mean_diffusivity(tensor.data[body]), np.nan))
    if not _DIFFUSIVITY[0] <= typical <= _DIFFUSIVITY[1]:
        doubts.append(
            f"the median mean diffusivity of the body is {typical:.2g} mm^2/s, that of tissue is "
            f"from {_DIFFUSIVITY[0]:g} to {_DIFFUSIVITY[1]:g}: check that the b values, up to "
            f"{table.b.max():g}, are in s/mm^2"
        )
    return [f"{dwi.name}: {text}" for text in doubts if text]


def _sign_doubt(direction: F64) -> str:
    """A warning if the signs of directions in the frame of the voxels are lost; else empty."""
    general = (np.abs(direction) > _ZERO).all(axis=1)  # not the six along axes and diagonals
    one_sign = (direction > -_ZERO).all(axis=0) | (direction < _ZERO).all(axis=0)
    if not (general.any() and one_sign.all()):
        return ""
    return (
        "along each voxel axis all components of its gradient directions have the same sign: signs "
        "were probably lost in an export, and fibers are wrong; use the table of the scanner"
    )


def _volume_doubt(signal: F64, table: GradientTable) -> str:
    """A warning naming volumes whose signal differs from that predicted by all others; else empty.

    - `signal`: mean in the body, shape `(n,)`; predicted by a tensor, and a brightness per b value
    """
    logarithm = np.log(np.maximum(signal, 1e-4 * (signal.max() or 1.0)))
    shell, design = _shells(table), table.design() / table.b.max()
    every = np.column_stack([shell[:, np.newaxis] == np.unique(shell), design])
    kept, found = np.flatnonzero(table.b <= _LAST_B), []
    while len(kept):
        fit = every[kept] @ np.linalg.pinv(every[kept])
        free = 1.0 - np.diag(fit)
        error = np.where(free > _FREE, logarithm[kept] - fit @ logarithm[kept], 0.0)
        error /= np.maximum(free, _FREE)
        worst = int(np.abs(error).argmax())
        if not abs(error[worst]) > np.log(_OFF):
            break
        found.append(f"{kept[worst]} (by a factor of {np.exp(error[worst]):.2g})")
        kept = np.delete(kept, worst)
    if not found:
        return ""
    return (
        f"the signal of volume {', '.join(found)}, counted from 0, is not what the others predict: "
        "it is damaged or scaled differently; remove it and its gradient"
    )


def _shells(table: GradientTable) -> F64:
    """A whole number for each image, the same for similar b values."""
    return np.rint(20.0 * table.b / table.b.max())


def _order_doubt(dwi: Image, table: GradientTable) -> str:
    """A warning if the directions may belong to other images; empty without a doubt.

    Logarithms of signals are linear in the tensor: their means over parts of the image fit the
    table as those of a voxel do, but with little noise. The residual of the correct order is
    smaller than that of directions shuffled among images of the same b value. Flipped or exchanged
    axes do not change it.
    """
    signal = dwi.data
    known = np.isfinite(signal).all(axis=-1) & (signal > 0).all(axis=-1)
    if len(table.b) < 7 + _LEAST_SPARE or not known.any():
        return ""
    # where all have the same brightness all are taken, up to rounding
    own = known & (signal.mean(axis=-1) >= (1 - 1e-9) * signal[known].mean())
    part = (np.argwhere(own) * 2 // dwi.data.shape[:3]) @ [4, 2, 1]
    logarithm = np.log(signal[own])
    means = [logarithm[part == number].mean(axis=0) for number in np.unique(part)]
    shell = _shells(table)
    random = np.random.default_rng(0)

    def residual(order: I64) -> float:
        shuffled = replace(table, direction=table.direction[order])
        design = np.column_stack([np.ones(len(table.b)), -shuffled.design() / table.b.max()])
        fit = np.linalg.lstsq(design, np.array(means).T, rcond=None)[0]
        return float(((design @ fit - np.array(means).T) ** 2).sum())

    right, better = residual(np.arange(len(table.b))), 0
    for _ in range(_ORDERS):
        order = np.arange(len(table.b))
        for one in np.unique(shell):
            order[shell == one] = random.permutation(order[shell == one])
        better += residual(order) <= right
    if better <= _BETTER * _ORDERS:
        return ""
    percent = 100.0 * better / _ORDERS
    return (
        f"{percent:.0f} % of random orders of its gradient directions fit the "
        "signals as well as the order of the file: the table may belong to another series, or its "
        "directions may be in another order than the images"
    )


def parse_axes(text: str) -> F64:
    """Signed permutation of axes: `"x -z y"` takes x, minus z and y as first, second, third.

    Returns matrix with one entry of 1 or -1 in each row and column, shape `(3, 3)`.
    """
    words = text.split()
    letters = [word.removeprefix("-") for word in words]
    if sorted(letters) != ["x", "y", "z"]:
        raise InputError(
            f"image.gradient_axes = '{text}': x, y and z are needed in some order, each with a "
            "minus sign or without, such as 'x -y z'"
        )
    matrix = np.zeros((3, 3))
    for row, (word, letter) in enumerate(zip(words, letters, strict=True)):
        matrix[row, "xyz".index(letter)] = -1.0 if word.startswith("-") else 1.0
    return matrix


class Diffusion(NamedTuple):
    """Diffusion data of a deck."""

    tensor: Image  #: Tensors in the world frame, shape `(ni, nj, nk, 6)`
    #: Mean of the diffusion-weighted images, shape `(ni, nj, nk)`; None for a file of tensors
    mean: Image | None
    doubts: Sequence[str] = ()  #: Warnings about the images and their gradients


def read_tensors(table: Mapping[str, Any], folder: Path) -> Diffusion | None:
    """Tensors of a deck: from a file of tensors, or fitted to diffusion-weighted images.

    - `table`: table `image` of the deck: `tensor`, or `dwi`, see `read_diffusion`;
      `gradient_axes`
    - `folder`: where the deck's relative paths start
    - returns none where the deck names neither
    """
    axes = parse_axes(table["gradient_axes"])
    if "dwi" in table:
        dwi, gradients = read_diffusion(folder / table["dwi"])
        mean = Image(np.abs(np.nan_to_num(dwi.data)).mean(axis=-1), dwi.affine, dwi.name)
        tensor = turn_tensors(fit_tensors(dwi, gradients), axes)
        return Diffusion(tensor, mean, diffusion_doubts(dwi, gradients, tensor))
    if "tensor" not in table:
        return None
    tensor = read_image(folder / table["tensor"], values=6)
    return Diffusion(turn_tensors(tensor, axes), None)


def read_diffusion(path: Path) -> tuple[Image, GradientTable]:
    """Diffusion-weighted images and their gradients.

    - `path`: 4-D image with .bval and .bvec of the same name beside it, or found by the BIDS
      inheritance principle, or a folder of DICOM images, see `read_image`
    - returns images of shape `(ni, nj, nk, n)` and the gradients of the `n` volumes
    """
    folder, choice = split_choice(path)
    if folder.is_dir():
        with converted(folder, series_files(folder, choice), ".bvec") as file:
            dwi, gradients = read_diffusion(file)
        return replace(dwi, name=str(path)), gradients
    dwi = read_image(path, values=None)
    return dwi, read_gradients(*gradient_files(path), dwi.affine, dwi.data.shape[3])


def gradient_files(path: Path) -> tuple[Path, Path]:
    """Files of b values and of directions that belong to diffusion-weighted images."""
    stem = path.name.removesuffix(".gz").removesuffix(".nii")
    bval, bvec = (
        next(reversed(described_by(path, kind)), path.with_name(f"{stem}.{kind}"))
        for kind in ("bval", "bvec")
    )
    return bval, bvec


def turn_tensors(tensor: Image, axes: F64) -> Image:
    """Tensors in the world frame with the voxel axes of the gradients exchanged or flipped.

    - `tensor`: shape `(ni, nj, nk, 6)`
    - `axes`: signed permutation of the voxel axes, shape `(3, 3)`
    """
    columns = frame(tensor.affine)
    turn = columns @ axes @ columns.T
    if np.array_equal(turn, np.eye(3)):
        return tensor
    full = turn @ full_tensors(tensor.data) @ turn.T
    return Image(tensor_components(full), tensor.affine, tensor.name)
