"""A calf with known ground truth: images, diffusion tensors and labels, from formulas.

The stack is a left calf in cross-sections: x points to the medial side, y forwards, z upwards.
Muscles are ellipses that change along z; no neighbour displaces the medial gastrocnemius, so that
its section is known in closed form. Fat fills the rest inside the skin, around two bones. On
request muscles contain fat and connective tissue in exact fractions of their volume.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.errors import InputError
from myork.imaging.diffusion import tensor_components
from myork.imaging.io import write_image, write_labels
from myork.records import Image, Labels
from myork.types import F64, I32, Mask

#: Labels of the materials a leg is made of
TISSUES = {1: "muscle", 2: "fat", 3: "connective_tissue", 4: "bone"}


class _Muscle(NamedTuple):
    """Cross-section (mm, degrees) and fibers of a muscle."""

    name: str
    centre: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float  # of the first axis against x
    taper: float  # relative loss of size at the far end of the stack
    belly: float  # height of the largest section, as a part of the stack
    pennation: float  # of the fibers against z
    azimuth: float  # of the fibers' slope in the section, against x


# A label is the position in this list, from 1
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
_SEPTUM = 2.6  # fat and fascia between muscles, unless asked for otherwise [mm]
_BONES = (((15.0, 21.0), 11.0, 3.2), ((-21.0, 13.0), 5.5, 1.8))  # centre, radius, cortex [mm]
_DIFFUSIVITY = (2.1e-3, 1.5e-3, 1.3e-3)  # along and across the fibers [mm^2/s]
_FREE = 0.2e-3  # diffusivity of everything else inside the skin [mm^2/s]

# Substances that follow the muscles 1 to 6, from 7
_SKIN_ID, _FAT_ID, _SEPTUM_ID, _CORTEX_ID, _MARROW_ID, _IMAT_ID, _IMCT_ID = range(7, 14)
#: T1-like signal of muscle and of fat
MUSCLE_SIGNAL, FAT_SIGNAL = 400.0, 1000.0


class _Substance(NamedTuple):
    """Signals of a substance in the four kinds of images, and its label in `TISSUES`."""

    anatomy: float  # T1-like
    fat: float  # a fat image of chemical shift encoding
    connective: float  # the difference of an ultrashort and a longer echo
    diffusion: float  # fat-saturated echo planar image without gradient
    tissue: int


_SUBSTANCES = (
    _Substance(0.0, 0.0, 0.0, 0.0, 0),
    *(_Substance(MUSCLE_SIGNAL * (0.97 + 0.012 * i), 40, 250, 400, 1) for i in range(1, 7)),
    _Substance(400.0, 100.0, 300.0, 120.0, 2),  # skin
    _Substance(FAT_SIGNAL, 1000.0, 120.0, 48.0, 2),  # fat
    _Substance(850.0, 850.0, 200.0, 48.0, 2),  # septum
    _Substance(60.0, 20.0, 700.0, 8.0, 4),  # cortex
    _Substance(930.0, 930.0, 120.0, 48.0, 4),  # marrow
    _Substance(900.0, 950.0, 120.0, 48.0, 2),  # fat in a muscle
    _Substance(150.0, 60.0, 1000.0, 40.0, 3),  # connective tissue
)


@dataclass(frozen=True)
class Phantom:
    """Images of the phantom and the ground truth behind them."""

    anatomy: Image  #: T1-like MR image with shading and Rician noise, shape `(ni, nj, nk)` [-]
    #: Images of special sequences in which fat, or connective tissue (and cortex), is bright;
    #: shading and noise as in `anatomy`
    fat: Image
    connective: Image
    #: Diffusion tensors with noise, xx, yy, zz, xy, xz, yz in the world frame, shape
    #: `(ni, nj, nk, 6)` [mm^2/s]
    tensor: Image
    truth: Labels  #: The six muscles, 1 to 6, with the fat and the connective tissue in them
    tissue: Labels  #: Tissues, as in `TISSUES`
    fiber: Image  #: True fiber directions, zero outside muscles, shape `(ni, nj, nk, 3)` [-]
    bias: Image  #: Factor of the shading, shape `(ni, nj, nk)` [-]
    #: Signal of a diffusion image without gradient and without noise, shape `(ni, nj, nk)` [-]
    still: Image
    clean_tensor: Image  #: Tensors without noise


#: Arguments of `make_phantom` for the kinds that decks can name
KINDS: dict[str, Mapping[str, Any]] = {
    "apart": {},
    "packed": {"septum": 0.0, "growth": 15.0},
    "aged": {"septum": 0.6, "growth": 15.0, "aponeurosis": 1.5, "imat": 0.03, "imct": 0.10},
}


def make_phantom(
    size: Sequence[int] = (96, 96, 15),
    spacing: Sequence[float] = (1.25, 1.25, 6.0),
    snr: float = 25.0,
    bias: float = 0.3,
    seed: int = 1,
    *,
    scale: float = 1.0,
    septum: float = _SEPTUM,
    growth: float = 0.0,
    aponeurosis: float = 0.0,
    imat: float = 0.0,
    imct: float = 0.0,
    pennation: float = 1.0,
) -> Phantom:
    """Make the images of the phantom; equal arguments give equal images.

    - `size`: columns, rows and slices
    - `spacing`: voxel size [mm]
    - `snr`: signal of muscle over the standard deviation of the noise [-]; the tensors' noise has
      the same ratio to the mean diffusivity
    - `bias`: amplitude of the multiplicative shading, 0 to 0.9 [-]
    - `scale`: in-plane scale of the calf, 1 for semi-axes of 54 and 52 mm [-]
    - `septum`: thickness of the fat and fascia between muscles; with 0 muscles touch [mm]
    - `growth`: growth of all muscles except the medial gastrocnemius into the fat between them,
      until they meet; 15 fills the calf completely [mm]
    - `aponeurosis`: thickness of the connective tissue around the medial gastrocnemius [mm]
    - `imat`, `imct`: part of each muscle's volume that is fat, or connective tissue, 0 to 0.5 [-]
    - `pennation`: factor of the angles of all fibers against z [-]
    """
    if not imat + imct < 1.0:
        raise InputError(f"phantom: imat + imct = {imat + imct:g} leaves no muscle; lower one")
    need = 2 * scale * max(_CALF) + 4.0
    field = size[0] * spacing[0], size[1] * spacing[1]
    if min(field) < need or size[2] < 3:
        raise InputError(
            f"phantom: size {tuple(size)} with spacing {tuple(spacing)} mm gives a field of "
            f"{field[0]:g} x {field[1]:g} mm and {size[2]} slices; it needs {need:g} x {need:g} mm "
            "and 3 slices"
        )
    affine = np.diag([*spacing, 1.0])
    affine[:2, 3] = [-0.5 * (n - 1) * h for n, h in zip(size[:2], spacing[:2], strict=True)]
    calf = _Calf(scale, (size[2] - 1) * spacing[2], septum, growth, aponeurosis)
    # world x and y [mm] and the height as a part of the stack [-]
    i, j, k = np.indices(size, float)
    x, y, t = i * spacing[0] + affine[0, 3], j * spacing[1] + affine[1, 3], k / (size[2] - 1)
    label = calf.muscles(x, y, t)
    levels = calf.inclusion_levels(label, x, y, t, imat, imct)
    substance = calf.substances(x, y, t, levels)

    # Partial volume: the signal of a voxel is the mean at four places in its slice.
    shifts = [(a * spacing[0] / 4, b * spacing[1] / 4) for a in (-1, 1) for b in (-1, 1)]
    parts = [calf.substances(x + dx, y + dy, t, levels) for dx, dy in shifts]
    table = np.array(_SUBSTANCES)
    signals = [np.mean([table[part, kind] for part in parts], axis=0) for kind in range(4)]

    shading = _shading(x / scale, y / scale, t)
    factor = 1.0 + bias * shading / np.abs(shading).max()
    random = np.random.default_rng(seed)
    sigma = MUSCLE_SIGNAL / snr
    anatomy = rician(signals[0] * factor, sigma, random)
    fiber = _fibers(label, x / scale, y / scale, t, pennation)
    body = signals[0] > 0
    clean = muscle_tensors(table[substance, -1] == 1, fiber, body)
    tensor = noisy_tensors(clean, body, snr, random)
    fat, connective = (rician(signals[kind] * factor, sigma, random) for kind in (1, 2))

    names = {i: muscle.name for i, muscle in enumerate(_MUSCLES, start=1)}
    tissue = table[substance, -1].astype(np.int32)
    return Phantom(
        anatomy=Image(anatomy, affine, "phantom anatomy"),
        fat=Image(fat, affine, "phantom fat image"),
        connective=Image(connective, affine, "phantom connective tissue image"),
        tensor=Image(tensor, affine, "phantom tensor"),
        truth=Labels(label, affine, names, "phantom truth"),
        tissue=Labels(tissue, affine, TISSUES, "phantom tissue"),
        fiber=Image(fiber, affine, "phantom fibers"),
        bias=Image(factor, affine, "phantom bias"),
        still=Image(signals[3], affine, "phantom diffusion image"),
        clean_tensor=Image(clean, affine, "phantom tensor without noise"),
    )


def write_phantom(folder: Path, phantom: Phantom) -> None:
    """Write the images of a phantom and its truth as NIfTI files.

    `tensor`, `fat`, `connective`; the ground truth in `truth` (muscles), `true_tissue`,
    `true_fibers` and `true_bias`. The anatomy is written by the caller that prepares it.
    """
    for name, image in (
        ("tensor", phantom.tensor),
        ("fat", phantom.fat),
        ("connective", phantom.connective),
        ("true_fibers", phantom.fiber),
        ("true_bias", phantom.bias),
    ):
        write_image(folder / f"{name}.nii.gz", image)
    write_labels(folder / "truth.nii.gz", phantom.truth)
    write_labels(folder / "true_tissue.nii.gz", phantom.tissue)


def rician(signal: F64, sigma: float, random: np.random.Generator) -> F64:
    """Magnitude of a signal with normal noise in both of its parts."""
    real, imaginary = random.normal(0.0, sigma, (2, *signal.shape))
    return np.hypot(signal + real, imaginary)


def _taper(muscle: _Muscle, t: F64) -> F64:
    """Size of a muscle's section relative to its belly [-]."""
    reach = max(muscle.belly, 1.0 - muscle.belly)
    return 1.0 - muscle.taper * ((t - muscle.belly) / reach) ** 2


def _turned(muscle: _Muscle, x: F64, y: F64) -> tuple[F64, F64]:
    """Coordinates along the axes of a muscle's section [mm]."""
    c, s = np.cos(np.radians(muscle.angle)), np.sin(np.radians(muscle.angle))
    dx, dy = x - muscle.centre[0], y - muscle.centre[1]
    return c * dx + s * dy, c * dy - s * dx


def _depth(u: F64, v: F64, a: F64, b: F64) -> F64:
    """Distance to the edge of an ellipse, positive inside, to first order [mm]."""
    q = np.sqrt((u / a) ** 2 + (v / b) ** 2) + 1e-12
    return (1.0 - q) * q / np.sqrt((u / a**2) ** 2 + (v / b**2) ** 2 + 1e-18)


class _Calf(NamedTuple):
    """Anatomy by formulas: substance at any place; lengths are those of a calf of scale 1."""

    scale: float
    length: float  # of the stack [mm]
    septum: float  # [mm]
    growth: float  # [mm]
    aponeurosis: float  # [mm]

    def muscles(self, x: F64, y: F64, t: F64) -> I32:
        """Label of the muscle at places, 0 between muscles."""
        return self._sorted(x / self.scale, y / self.scale, t)[0]

    def inclusion_levels(self, label: I32, x: F64, y: F64, t: F64, imat: float, imct: float) -> F64:
        """Thresholds of both inclusion fields beyond which there is no muscle, shape `(6, 2)`."""
        levels = np.tile([np.inf, -np.inf], (len(_MUSCLES), 1))
        for number in range(len(_MUSCLES)):
            here = label == number + 1
            streaks, sheets = self._inclusions(number, x[here], y[here], t[here])
            if imct > 0:
                levels[number, 1] = np.quantile(sheets, imct)
            if imat > 0:
                rest = streaks[sheets >= levels[number, 1]]
                levels[number, 0] = np.quantile(rest, 1.0 - imat / (1.0 - imct))
        return levels

    def substances(self, x: F64, y: F64, t: F64, levels: F64) -> I32:
        """Index into `_SUBSTANCES` at given places."""
        xs, ys = x / self.scale, y / self.scale
        label, between, beside_mg = self._sorted(xs, ys, t)
        skin = self._skin(xs, ys, t)
        found = np.select([skin > _SKIN, skin > 0], [_FAT_ID, _SKIN_ID], 0).astype(np.int32)
        found[between] = _SEPTUM_ID
        found[label > 0] = label[label > 0]
        found[(beside_mg > 0) & (beside_mg < self.aponeurosis) & (skin > _SKIN)] = _IMCT_ID
        for number, (streak, sheet) in enumerate(levels):
            if not (np.isfinite(streak) or np.isfinite(sheet)):
                continue
            here = np.flatnonzero(label == number + 1)
            streaks, sheets = self._inclusions(number, x.flat[here], y.flat[here], t.flat[here])
            found.flat[here[streaks > streak]] = _IMAT_ID
            found.flat[here[sheets < sheet]] = _IMCT_ID
        for centre, radius, cortex in _BONES:
            distance = np.hypot(xs - centre[0], ys - centre[1])
            found[distance < radius] = _CORTEX_ID
            found[distance < radius - cortex] = _MARROW_ID
        return found

    def _skin(self, x: F64, y: F64, t: F64) -> F64:
        """Depth below the skin [mm]."""
        body = 1.0 - 0.1 * (t - 0.6) ** 2
        return _depth(x, y, _CALF[0] * body, _CALF[1] * body)

    def _sorted(self, x: F64, y: F64, t: F64) -> tuple[I32, Mask, F64]:
        """Muscle at places, whether they lie between two, distance from the first muscle [mm]."""
        bone = np.max([r - np.hypot(x - c[0], y - c[1]) for c, r, _ in _BONES], axis=0)
        inside = np.empty((len(_MUSCLES), *x.shape))
        for number, muscle in enumerate(_MUSCLES):
            a, b = (axis * _taper(muscle, t) for axis in muscle.semi_axes)
            inside[number] = _depth(*_turned(muscle, x, y), a, b)
        # The others stay clear of the medial gastrocnemius, the bones and the fat under the skin.
        apart = max(self.septum, self.aponeurosis)
        room = np.minimum.reduce(
            [self._skin(x, y, t) - _SKIN - _FAT, -bone - self.septum, -inside[0] - apart]
        )
        inside[1:] += self.growth
        inside[1:] = np.where(room > 0, inside[1:], np.minimum(inside[1:], room))
        order = np.sort(inside, axis=0)
        best = np.argmax(inside, axis=0)
        alone = (best == 0) | (order[-1] - np.maximum(order[-2], 0.0) > 0.5 * self.septum)
        label = np.where((order[-1] > 0) & alone, best + 1, 0).astype(np.int32)
        return label, (order[-1] > 0) & ~alone, -inside[0]

    def _inclusions(self, number: int, x: F64, y: F64, t: F64) -> tuple[F64, F64]:
        """Fields whose maxima are streaks of fat and whose minima are sheets [-].

        Both change little along z; wavelengths are in millimetres, independent of the scale.
        """
        u, v = _turned(_MUSCLES[number], x / self.scale, y / self.scale)
        u, v, z = u * self.scale, v * self.scale, t * self.length
        streaks = np.cos(0.9 * u + 0.02 * z + number) * np.cos(0.75 * v - 0.015 * z)
        streaks += 0.3 * np.sin(0.11 * z + 0.3 * u)
        sheets = np.abs(np.sin(0.42 * (v + 1.2 * np.sin(0.25 * u) + 0.02 * z) + 0.7 * number))
        sheets += 0.15 * (1.0 + np.sin(0.3 * u) * np.cos(0.1 * z))
        return streaks, sheets


def _shading(x: F64, y: F64, t: F64) -> F64:
    """Smooth field of a surface coil behind the calf [-]."""
    r = max(_CALF)
    return 0.5 * x / r - 0.8 * y / r + 0.35 * np.cos(2.0 * x / r + 1.5 * t) + 0.3 * (t - 0.5)


def _fibers(label: I32, x: F64, y: F64, t: F64, pennation: float) -> F64:
    """Fiber directions: pennate, slightly fanned across the muscle, flatter towards the top."""
    fiber = np.zeros((*label.shape, 3))
    for number, muscle in enumerate(_MUSCLES, start=1):
        here = label == number
        across = _turned(muscle, x, y)[0] / muscle.semi_axes[0]
        slope = np.radians(pennation * muscle.pennation * (1.15 - 0.3 * t[here]))
        azimuth = np.radians(muscle.azimuth + 12.0 * across[here])
        fiber[here] = np.stack(
            [np.sin(slope) * np.cos(azimuth), np.sin(slope) * np.sin(azimuth), np.cos(slope)], -1
        )
    return fiber


def fiber_of(name: str) -> F64:
    """Mean direction of a muscle's fibers in a left calf, shape `(3,)` [-].

    - `name`: one of the phantom's muscles
    """
    muscle = next(muscle for muscle in _MUSCLES if muscle.name == name)
    slope, azimuth = np.radians([muscle.pennation, muscle.azimuth])
    across = np.sin(slope)
    return np.array([across * np.cos(azimuth), across * np.sin(azimuth), np.cos(slope)])


def noisy_tensors(clean: F64, body: Mask, snr: float, random: np.random.Generator) -> F64:
    """Tensors of a body with normal noise, the mean diffusivity of muscle over `snr` [mm^2/s]."""
    noise = np.mean(_DIFFUSIVITY) / snr
    return clean + random.normal(0.0, noise, clean.shape) * body[..., np.newaxis]


def muscle_tensors(muscle: Mask, fiber: F64, body: Mask) -> F64:
    """Diffusion tensors without noise, xx, yy, zz, xy, xz, yz, shape `(ni, nj, nk, 6)` [mm^2/s].

    - `muscle`, `body`: voxels of muscle, and of everything inside the skin, shape `(ni, nj, nk)`
    - `fiber`: unit vectors in muscle, shape `(ni, nj, nk, 3)` [-]
    """
    # Second direction: perpendicular to the fiber, in the section.
    second = np.stack([-fiber[..., 1], fiber[..., 0], np.zeros(muscle.shape)], -1)
    second /= np.maximum(np.linalg.norm(second, axis=-1, keepdims=True), 1e-12)
    along, middle, least = _DIFFUSIVITY
    full = (along - least) * fiber[..., :, None] * fiber[..., None, :]
    full += (middle - least) * second[..., :, None] * second[..., None, :]
    full *= muscle[..., None, None]
    base = np.where(muscle, least, np.where(body, _FREE, 0.0))
    full += base[..., None, None] * np.eye(3)
    return tensor_components(full)
