"""A calf with a known answer: anatomy, diffusion tensors and true labels, from formulas.

The stack is a left calf cut across: x points to the medial side, y forwards, z upwards. Muscles
are ellipses whose axes change along z; the medial gastrocnemius is a spindle that never yields
to a neighbour, so that its cross-section is known in closed form. Fat fills the rest inside the
skin; two bones have a dark cortex and bright marrow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from myork.errors import InputError
from myork.records import Image, Labels

__all__ = ["Phantom", "make_phantom", "mg_area"]

F64 = NDArray[np.float64]


class _Muscle(NamedTuple):
    """Cross-section (mm, degrees) and fibers of a muscle."""

    name: str
    centre: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float  # of the first axis against x
    taper: float  # loss of size at the far end of the stack
    belly: float  # height of the largest section, part of the stack
    pennation: float  # of the fibers against z
    azimuth: float  # of the fibers' slope in the section, against x


# Label = place in this list, from 1
_MUSCLES = (
    _Muscle("medial_gastrocnemius", (19.0, -27.0), (23.0, 11.0), 35.0, 0.3, 0.55, 22.0, -55.0),
    _Muscle("lateral_gastrocnemius", (-20.0, -27.0), (20.0, 9.5), -38.0, 0.4, 0.65, 18.0, -128.0),
    _Muscle("soleus", (0.0, -10.0), (35.0, 13.5), 0.0, 0.15, 0.35, 28.0, 90.0),
    _Muscle("tibialis_anterior", (-11.0, 29.0), (15.0, 11.0), 20.0, 0.25, 0.6, 10.0, 110.0),
    _Muscle("peroneus", (-34.0, 7.0), (8.5, 14.0), 8.0, 0.25, 0.6, 12.0, 180.0),
    _Muscle("tibialis_posterior", (-3.0, 9.0), (15.0, 9.0), 0.0, 0.2, 0.5, 14.0, 45.0),
)
_CALF = (54.0, 52.0)  # semi-axes of the skin [mm]
_SKIN = 1.6  # thickness [mm]
_FAT = 5.5  # thickness under the skin [mm]
_SEPTUM = 2.6  # fat and fascia between muscles [mm]
_BONES = (((15.0, 21.0), 11.0, 3.2), ((-21.0, 13.0), 5.5, 1.8))  # centre, radius, cortex [mm]
_SIGNAL = {"skin": 400.0, "fat": 1000.0, "septum": 850.0, "cortex": 60.0, "marrow": 930.0}
_MUSCLE_SIGNAL = 400.0
_DIFFUSIVITY = (2.1e-3, 1.5e-3, 1.3e-3)  # along and across the fibers [mm^2/s]
_FREE = 0.2e-3  # of everything else inside the skin [mm^2/s]


@dataclass(frozen=True)
class Phantom:
    """Images of the phantom and the answer behind them.

    Attributes
    ----------
    anatomy : Image
        T1-like MR image with shading and Rician noise, shape `(ni, nj, nk)` [-].
    tensor : Image
        Diffusion tensors with noise, xx, yy, zz, xy, xz, yz in the world frame, shape
        `(ni, nj, nk, 6)` [mm^2/s].
    truth : Labels
        The six muscles, 1 to 6.
    fiber : Image
        True fiber directions, zero outside muscles, shape `(ni, nj, nk, 3)` [-].
    bias : Image
        Factor of the shading, shape `(ni, nj, nk)` [-].
    """

    anatomy: Image
    tensor: Image
    truth: Labels
    fiber: Image
    bias: Image


def make_phantom(
    size: tuple[int, int, int] = (96, 96, 15),
    spacing: tuple[float, float, float] = (1.25, 1.25, 6.0),
    snr: float = 25.0,
    bias: float = 0.3,
    seed: int = 1,
) -> Phantom:
    """Make the images of the phantom; equal arguments give equal images.

    Parameters
    ----------
    size : tuple
        Columns, rows and slices.
    spacing : tuple
        Voxel size [mm].
    snr : float
        Signal of muscle over the standard deviation of the noise [-]; the tensors' noise has the
        same ratio to the mean diffusivity.
    bias : float
        Amplitude of the multiplicative shading, 0 to 0.9 [-].
    seed : int
        Start of the random numbers.
    """
    need = 2 * max(_CALF) + 4.0
    field = size[0] * spacing[0], size[1] * spacing[1]
    if min(field) < need or size[2] < 3:
        raise InputError(
            f"phantom: size {size} with spacing {spacing} mm gives a field of {field[0]:g} x "
            f"{field[1]:g} mm and {size[2]} slices; it needs {need:g} x {need:g} mm and 3 slices"
        )
    affine = np.diag([*spacing, 1.0])
    affine[:2, 3] = [-0.5 * (n - 1) * h for n, h in zip(size[:2], spacing[:2], strict=True)]
    x, y, t = _coordinates(size, affine)

    label, signal = _section(x, y, t)
    # Partial volume: the signal of a voxel is the mean of four places in its slice.
    shifts = [(a * spacing[0] / 4, b * spacing[1] / 4) for a in (-1, 1) for b in (-1, 1)]
    signal = np.mean([_section(x + dx, y + dy, t)[1] for dx, dy in shifts], axis=0)

    shading = _shading(x, y, t)
    factor = 1.0 + bias * shading / np.abs(shading).max()
    random = np.random.default_rng(seed)
    sigma = _MUSCLE_SIGNAL / snr
    real, imaginary = random.normal(0.0, sigma, (2, *size))
    anatomy = np.hypot(signal * factor + real, imaginary)

    fiber = _fibers(label, x, y, t)
    tensor = _tensors(label, fiber, signal > 0)
    noise = np.mean(_DIFFUSIVITY) / snr
    tensor += random.normal(0.0, noise, tensor.shape) * (signal > 0)[..., np.newaxis]

    names = {i: muscle.name for i, muscle in enumerate(_MUSCLES, start=1)}
    return Phantom(
        anatomy=Image(anatomy, affine, "phantom anatomy"),
        tensor=Image(tensor, affine, "phantom tensor"),
        truth=Labels(label, affine, names, "phantom truth"),
        fiber=Image(fiber, affine, "phantom fibers"),
        bias=Image(factor, affine, "phantom bias"),
    )


def mg_area(height: float) -> float:
    """Cross-section of the medial gastrocnemius [mm^2].

    Parameters
    ----------
    height : float
        Place along z: 0 the first, 1 the last slice of the stack.
    """
    mg = _MUSCLES[0]
    return float(np.pi * np.prod(mg.semi_axes) * _scale(mg, np.array(height)) ** 2)


def _coordinates(size: tuple[int, int, int], affine: F64) -> tuple[F64, F64, F64]:
    """World x and y [mm] and the height as a part of the stack [-] of all voxels."""
    i, j, k = np.meshgrid(*(np.arange(n, dtype=float) for n in size), indexing="ij")
    return i * affine[0, 0] + affine[0, 3], j * affine[1, 1] + affine[1, 3], k / (size[2] - 1)


def _scale(muscle: _Muscle, t: F64) -> F64:
    """Size of a muscle's section relative to its belly [-]."""
    reach = max(muscle.belly, 1.0 - muscle.belly)
    return 1.0 - muscle.taper * ((t - muscle.belly) / reach) ** 2


def _depth(centre: tuple[float, float], a: F64, b: F64, angle: float, x: F64, y: F64) -> F64:
    """Distance to the edge of an ellipse, positive inside, to first order [mm]."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    u, v = c * (x - centre[0]) + s * (y - centre[1]), c * (y - centre[1]) - s * (x - centre[0])
    q = np.sqrt((u / a) ** 2 + (v / b) ** 2) + 1e-12
    return (1.0 - q) * q / np.sqrt((u / a**2) ** 2 + (v / b**2) ** 2 + 1e-18)


def _section(x: F64, y: F64, t: F64) -> tuple[NDArray[np.int32], F64]:
    """Muscle label and noise-free signal at places."""
    body = 1.0 - 0.1 * (t - 0.6) ** 2
    skin = _depth((0.0, 0.0), _CALF[0] * body, _CALF[1] * body, 0.0, x, y)
    signal = np.zeros(x.shape)
    signal[skin > 0] = _SIGNAL["skin"]
    signal[skin > _SKIN] = _SIGNAL["fat"]

    bone = np.max([r - np.hypot(x - c[0], y - c[1]) for c, r, _ in _BONES], axis=0)
    inside = np.empty((len(_MUSCLES), *x.shape))
    for number, muscle in enumerate(_MUSCLES):
        a, b = (axis * _scale(muscle, t) for axis in muscle.semi_axes)
        inside[number] = _depth(muscle.centre, a, b, muscle.angle, x, y)
    # The others keep off the medial gastrocnemius, the bones and the fat under the skin.
    room = np.minimum(skin - _SKIN - _FAT, np.minimum(-bone, -inside[0]) - _SEPTUM)
    inside[1:] = np.minimum(inside[1:], room)
    order = np.sort(inside, axis=0)
    best = np.argmax(inside, axis=0)
    alone = (best == 0) | (order[-1] - np.maximum(order[-2], 0.0) > 0.5 * _SEPTUM)
    label = np.where((order[-1] > 0) & alone, best + 1, 0).astype(np.int32)

    signal[(order[-1] > 0) & ~alone] = _SIGNAL["septum"]
    tissue = label > 0
    signal[tissue] = _MUSCLE_SIGNAL * (0.97 + 0.012 * label[tissue])
    for centre, radius, cortex in _BONES:
        distance = np.hypot(x - centre[0], y - centre[1])
        signal[distance < radius] = _SIGNAL["cortex"]
        signal[distance < radius - cortex] = _SIGNAL["marrow"]
    return label, signal


def _shading(x: F64, y: F64, t: F64) -> F64:
    """Smooth field of a surface coil behind the calf [-]."""
    r = max(_CALF)
    return 0.5 * x / r - 0.8 * y / r + 0.35 * np.cos(2.0 * x / r + 1.5 * t) + 0.3 * (t - 0.5)


def _fibers(label: NDArray[np.int32], x: F64, y: F64, t: F64) -> F64:
    """Fiber directions: pennate, a little fanned across the muscle, flatter towards the top."""
    fiber = np.zeros((*label.shape, 3))
    for number, muscle in enumerate(_MUSCLES, start=1):
        here = label == number
        c, s = np.cos(np.radians(muscle.angle)), np.sin(np.radians(muscle.angle))
        across = (c * (x - muscle.centre[0]) + s * (y - muscle.centre[1])) / muscle.semi_axes[0]
        slope = np.radians(muscle.pennation * (1.15 - 0.3 * t[here]))
        azimuth = np.radians(muscle.azimuth + 12.0 * across[here])
        fiber[here] = np.stack(
            [np.sin(slope) * np.cos(azimuth), np.sin(slope) * np.sin(azimuth), np.cos(slope)], -1
        )
    return fiber


def _tensors(label: NDArray[np.int32], fiber: F64, body: NDArray[np.bool_]) -> F64:
    """Diffusion tensors without noise, xx, yy, zz, xy, xz, yz [mm^2/s]."""
    # Second direction: perpendicular to the fiber, in the section.
    second = np.stack([-fiber[..., 1], fiber[..., 0], np.zeros(label.shape)], -1)
    second /= np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-12)
    along, middle, least = _DIFFUSIVITY
    full = (along - least) * fiber[..., :, None] * fiber[..., None, :]
    full += (middle - least) * second[..., :, None] * second[..., None, :]
    base = np.where(label > 0, least, np.where(body, _FREE, 0.0))
    full += base[..., None, None] * np.eye(3)
    pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
    return np.stack([full[..., i, j] for i, j in pairs], -1)
