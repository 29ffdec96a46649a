"""The tissues of a limb from its images (thesis section 4.1.2).

Two-phase level sets find the skin, bone is marrow in a closed dark ring, fat and connective tissue
start from fuzzy clusters of separate images. Their borders are then drawn at a part of the
difference to the surrounding muscle, in the combination of images that separates both best
(Fisher). Remaining voxels with a diffusion tensor are muscle. Assumptions: see `Tissues.doubts`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.diffusion import finite_tensors, mean_diffusivity
from myork.imaging.geometry import check_same_grid, depth_in_slices
from myork.imaging.phantom import TISSUES
from myork.records import Image, Labels
from myork.segmentation.channels import local_means, scaled_values
from myork.segmentation.fuzzy import bright_cluster
from myork.segmentation.level_sets import LevelSets, segment_regions, wanted_phase
from myork.segmentation.regions import (
    body_mask,
    doubt_of_mixture,
    large_pieces,
    lost_part,
    seen_slices,
    whole_voxels,
)
from myork.segmentation.scores import dice
from myork.types import F64, Mask

# Area of marrow in a slice [mm^2]: larger than a femoral head, it is fat in a ring of muscles.
# Cortex has at most this thickness [mm], and is darker than the first of these parts of the median
# of dark tissue, or than three times its scatter below it, whichever is more; voxels darker than
# the second part are not used to find the grey value of muscle.
_MARROW = (15.0, 3000.0)
_CORTEX = 6.0
_COVERED = 0.6
_CORTICAL, _DARK = 0.8, 0.5
# Voxels that touch no other tissue are compared within this [mm]; this many of both are needed.
_AROUND = 15.0
_LEAST_WHOLE = 20
_ROUNDS = 5
# Limits of doubts: section of a limb, larger only with bone and with muscles in an ellipse of this
# area [mm^2] and ratio of axes (trunks: 30000, 1.4), and world axis along which limbs lie; Dice of
# two methods; part of a tissue that touches no other (half for muscle: a tenth of the rest on the
# wrong side then costs a Dice of 0.05); part of the body that a threshold finds beyond the level
# set's skin; part of the slices without a bone.
_LIMB, _LEAN, _ROUND = 35000.0, 25000.0, 1.35
_UPWARD = 2
_ALIKE = 0.93
_WHOLE = (0.36, 0.5)
_RIM = 0.018
_BONELESS = 0.1
# The bright cluster of the special sequence is connective tissue only if it is brighter than the
# other by this factor; without connective tissue, the two would be muscle and fat.
_STANDS_OUT = 2.5
# Connective tissue has at least this part of the full brightness above muscle. Dice is largest if
# voxels count from half of it on (Lipton, Elkan, Naryanaswamy 2014), 0.7 to 0.9 for thin sheets.
# Full is this percentile of the cluster; muscle darker than the last part is no reference.
_PART = 0.4
_FULL = 90
_SEEN = 0.1
# Skin, and pixels of mixed fat and air, are as grey as muscle, down to this depth [mm].
_SKIN = 3.0
# Two phases of a slice. The choice is fixed by this method: a leg has no keys for it.
_PHASES = LevelSets(regions=2, start="otsu", mu=0.01, tolerance=1e-4)


class Tissues(NamedTuple):
    """Tissues of a limb."""

    labels: Labels  #: As in `TISSUES`
    #: Memberships of voxels in `fat` and, with an image of it, in `connective_tissue`, 0 to 1, zero
    #: in bone and outside the body, shape `(ni, nj, nk)`
    memberships: dict[str, F64]
    doubts: list[str]  #: Assumptions of the rules that this image does not support


def leg_tissues(
    anatomy: Image,
    *,
    fat: Image | None = None,
    connective: Image | None = None,
    others: Sequence[Image] = (),
    tensor: Image | None = None,
    body: Mask | None = None,
    least_diffusivity: float = 0.0,
) -> Tissues:
    """Label every voxel of a limb with its tissue.

    - `anatomy`: MR image, shape `(ni, nj, nk)`; the others are on its grid
    - `fat`, `connective`: images in which fat, or connective tissue, is bright; without the first,
      fat is bright in the anatomy; without the second, no connective tissue is found
    - `others`: further images in which fat and muscle differ, such as other echoes
    - `tensor`: diffusion tensors; without them everything left is muscle, except for the skin
    - `body`: voxels to label, shape `(ni, nj, nk)`; by default those inside the skin
    - `least_diffusivity`: mean diffusivity of muscle, in the unit of the tensors
    """
    for other in (fat, connective, *others, tensor):
        if other is not None:
            check_same_grid(other, anatomy)
    found_body = body is None
    body = outer_boundary(anatomy) if body is None else body
    bone = find_bones(anatomy, body, fat)
    soft = body & ~bone
    inner = soft & ~_skin(body, anatomy.spacing[:2])
    memberships: dict[str, F64] = {}

    def clustered(name: str, image: Image, contrast: float = 0.0) -> Mask:
        found, (dark, bright) = bright_cluster(image.data, soft)
        if bright < contrast * dark:
            return np.zeros(soft.shape, dtype=bool)
        memberships[name] = found
        return np.asarray(found > 0.5)

    sheets = np.zeros(body.shape, dtype=bool)
    if connective is not None:
        sheets = clustered("connective_tissue", connective, _STANDS_OUT)
    shown = anatomy if fat is None else fat
    fatty = clustered("fat", shown)
    more = [one.data for one in (*([] if fat is None else [anatomy]), *others)]
    if connective is not None:
        sheets = _shaded_apart(connective, soft, sheets, fatty)
    inside = inner & ~sheets
    if not (inside & ~fatty).any():
        raise InputError(
            f"{shown.name}: all inside the skin is fat: without air around the limb its skin is "
            "not found (name the limb in image.body), or fat is not bright in this image"
        )
    fat_inside = _drawn_anew(shown.data, more, inside, fatty, anatomy.spacing)
    doubts = _doubts(shown, body, inside, fat_inside, bone)
    if found_body:
        doubts += _beyond(anatomy, body) + _boneless(anatomy, body, bone)
        doubts += [text for text in [lost_part(anatomy, body)] if text]
    fatty = np.where(inside, fat_inside, fatty)
    # A voxel that is bright in both images lies between fat and connective tissue.
    sheets &= ~fatty
    rest = soft & ~fatty & ~sheets
    muscle = rest & inner
    if tensor is not None:
        muscle = rest & (mean_diffusivity(finite_tensors(tensor.data)) > least_diffusivity)
        if not muscle.any():
            raise InputError(
                f"{tensor.name}: no voxel has a mean diffusivity above "
                f"tissue.least_diffusivity = {least_diffusivity:g}; check its unit"
            )
    masks = {"muscle": muscle, "fat": fatty | (rest & ~muscle), "connective_tissue": sheets,
             "bone": bone}  # fmt: skip
    data = np.zeros(body.shape, dtype=np.int32)
    for label, name in TISSUES.items():
        data[masks[name]] = label
    return Tissues(Labels(data, anatomy.affine, TISSUES, "tissue"), memberships, doubts)


def _drawn_anew(shown: F64, more: Sequence[F64], inner: Mask, fat: Mask, spacing: F64) -> Mask:
    """Fat with its border to muscle placed at half of their difference around each place."""
    fat = fat & inner
    for _ in range(_ROUNDS):
        whole = [whole_voxels(fat), whole_voxels(inner & ~fat)]
        # voxels without signal are not muscle
        whole[1] &= shown > _DARK * np.median(shown[inner & ~fat])
        if min(one.sum() for one in whole) < _LEAST_WHOLE:
            break
        values = _best_part(shown, more, *whole)
        high, low = (_around(values, one, spacing) for one in whole)
        new = inner & (values > 0.5 * (low + high))
        if (new == fat).all():
            break
        fat = new
    return fat


def _shaded_apart(image: Image, soft: Mask, sheets: Mask, fat: Mask) -> Mask:
    """Connective tissue by its signal relative to muscle nearby: shading is a factor of both."""
    muscle, data = whole_voxels(soft & ~sheets & ~fat), image.data
    if min(muscle.sum(), sheets.sum()) < _LEAST_WHOLE:
        return sheets
    low = _around(data, muscle, image.spacing)
    if low[soft].min() < _SEEN * data[sheets].mean():
        return sheets
    above = data / np.maximum(low, 1e-9 * np.ptp(data)) - 1.0
    return np.asarray(soft & (above > _PART * np.percentile(above[sheets], _FULL)))


def _best_part(shown: F64, more: Sequence[F64], fat: Mask, muscle: Mask) -> F64:
    """Combination of images in which fat and muscle differ most relative to their scatter."""
    if not more:
        return shown
    images = np.stack([shown, *more], axis=-1)
    scatter = np.cov(images[fat].T) + np.cov(images[muscle].T)
    scatter += 1e-6 * np.trace(scatter) * np.eye(len(scatter))
    weights = np.linalg.solve(scatter, images[fat].mean(axis=0) - images[muscle].mean(axis=0))
    return np.asarray(images @ weights)


def _around(values: F64, where: Mask, spacing: F64) -> F64:
    """Mean of the values of some voxels around each place in its slice."""
    return local_means(values, where, (*(_AROUND / spacing[:2]), 0.0), 1e-3)


def _doubts(shown: Image, body: Mask, inner: Mask, fat: Mask, bone: Mask) -> list[str]:
    """Assumptions on the border of fat and muscle that an image does not support."""
    found, muscle = [], inner & ~fat
    size, name = shown.spacing, shown.name
    pieces, n = ndimage.label(body)
    sections = ndimage.sum_labels(body, pieces, range(1, n + 1)) / body.any(axis=(0, 1)).sum()
    area = float(np.max(sections) * size[0] * size[1])
    # thick fat makes a thigh larger, slices along a limb are longer
    own = muscle & (pieces == 1 + int(np.argmax(sections)))
    wide = np.ptp(np.argwhere(own), axis=0)[:2] * size[:2] if own.any() else np.zeros(2)
    thigh = (
        bone.any(axis=(0, 1)).all()
        and 0.25 * np.pi * wide[0] * wide[1] < _LEAN
        and max(wide) < _ROUND * min(wide)
    )
    if area > _LIMB and not thigh and np.abs(shown.affine[:3, 2]).argmax() == _UPWARD:
        found.append(
            f"the section has {area / 100:.0f} cm^2, more than a limb: organs have the grey "
            "value of muscle and are labelled as muscle; limit it by image.body"
        )
    for label, own, least in zip(("fat", "muscle"), (fat, muscle), _WHOLE, strict=True):
        part = whole_voxels(own).sum() / max(own.sum(), 1)
        if part < least:
            found.append(
                f"only {100 * part:.0f} % of the voxels of {label} have no other tissue beside "
                "them: its volume depends on where borders are drawn; use finer voxels or "
                "image.partial"
            )
    if mixed := doubt_of_mixture(shown.data, fat, muscle):
        found.append(f"fat {mixed}")
    other = _bright(shown, inner)
    alike = min(dice(other, fat), dice(inner & ~other, muscle))
    if alike < _ALIKE:
        found.append(
            f"level sets of two regions and the border of fat and muscle disagree (Dice "
            f"{alike:.2f})"
        )
    depth = _depth(body, size[:2])
    rind = depth < 2 * _SKIN + size[0]
    shell, core = inner & rind, inner & (depth > 0.5 * depth[np.isfinite(depth)].max(initial=0.0))
    if shell.any() and core.any() and fat[shell].mean() < fat[core].mean():
        found.append(
            "what was labelled fat lies inside and not under the skin: is fat bright in this image?"
        )
    return [f"tissue of {name}: {text}" for text in found]


def _beyond(anatomy: Image, body: Mask) -> list[str]:
    """Warning where a threshold finds a part of the body beyond the skin."""
    rim = float((body_mask(anatomy, rim=1.0) & ~body).sum() / body.sum())
    if rim <= _RIM:
        return []
    return [
        f"tissue of {anatomy.name}: {100 * rim:.1f} % of the body by a threshold lies beyond "
        "what was taken for the skin, which is dark here; image.body says what is inside"
    ]


def _boneless(anatomy: Image, body: Mask, bone: Mask) -> list[str]:
    """Warning where slices of a limb have no bone."""
    slices, without = body.any(axis=(0, 1)), body.any(axis=(0, 1)) & ~bone.any(axis=(0, 1))
    if without.sum() <= _BONELESS * slices.sum():
        return []
    return [
        f"tissue of {anatomy.name}: no bone was found in {without.sum()} of {slices.sum()} slices: "
        "its wall and marrow are then labelled muscle and fat; exclude it with image.body"
    ]


def outer_boundary(anatomy: Image) -> Mask:
    """Voxels inside the skin: the bright phase of the whole image with its holes filled."""
    # in square roots muscle is closer to fat than to air
    even = replace(anatomy, data=np.sqrt(np.maximum(anatomy.data, 0.0)))
    seen = np.broadcast_to(seen_slices(anatomy.data), anatomy.data.shape)
    inside = _bright(even, seen)
    slices = np.moveaxis(inside, -1, 0)
    body = np.stack([ndimage.binary_fill_holes(section) for section in slices], axis=-1)
    return large_pieces(body, anatomy.name)


def find_bones(anatomy: Image, body: Mask, fat: Image | None = None) -> Mask:
    """Bones: fatty marrow enclosed by a ring of very dark cortex in every slice.

    Level sets separate fat and marrow from dark tissue; cortex is darker than the dark phase
    scatters. Beside an image of fat the anatomy may show fat as bright as muscle, or darker; a
    fraction of fat is noise in cortex, but its geometric mean with the signal is not.
    """
    fatty = anatomy
    if fat is not None:
        fatty = replace(fat, data=np.sqrt(np.maximum(fat.data * anatomy.data, 0.0)))
    bright = _bright(fatty, body)
    dark = body & ~bright
    if not dark.any():
        return np.zeros(body.shape, dtype=bool)
    middle = np.median(anatomy.data[dark])
    scatter = 1.4826 * np.median(np.abs(anatomy.data[dark] - middle))
    darkest = dark & (anatomy.data < max(_CORTICAL * middle, middle - 3.0 * scatter))
    pixel = float(anatomy.spacing[:2].prod())
    bone = np.zeros(body.shape, dtype=bool)
    for k in range(body.shape[2]):
        cortex = darkest[:, :, k]
        # One pixel of mixed cortex and fat may look like muscle: the ring is closed over it.
        ring = (
            ndimage.binary_closing(np.pad(cortex, 2), np.ones((3, 3)))[2:-2, 2:-2] & body[:, :, k]
        )
        pieces, n = ndimage.label(ndimage.binary_fill_holes(ring) & ~ring)
        for piece in range(1, n + 1):
            marrow = pieces == piece
            sized = _MARROW[0] <= marrow.sum() * pixel <= _MARROW[1]
            if sized and bright[:, :, k][marrow].mean() > 0.5:
                bone[:, :, k] |= marrow | _wall(marrow, ring, anatomy.spacing[:2])
    return bone


def _wall(marrow: Mask, ring: Mask, pixel: F64) -> Mask:
    """Cortex around marrow, shell by shell as long as most of a shell is dark.

    Fascia that touches the bone is equally dark, but covers little of a shell.
    """
    away = ndimage.distance_transform_edt(~marrow, sampling=pixel)
    shell = np.ceil(away / pixel.max()).astype(int)
    wall = np.zeros(ring.shape, dtype=bool)
    for number in range(1, int(_CORTEX / pixel.max()) + 1):
        here = shell == number
        if ring[here].mean() < _COVERED:
            break
        wall |= here & ring
    return wall


def _skin(body: Mask, pixel: F64) -> Mask:
    """Band of the body along the air in every slice; the border of the picture is not air."""
    return body & (_depth(body, pixel) <= _SKIN)


def _depth(body: Mask, pixel: F64) -> F64:
    """Distance to the outside in every slice, infinite without an outside [mm]."""
    # with nothing outside, SciPy gives distances to a place outside the array
    return np.where(body.all(axis=(0, 1)), np.inf, depth_in_slices(body, pixel, cut=True))


def _bright(image: Image, region: Mask) -> Mask:
    """Bright phase of a region, by a level set in every slice."""
    grey = scaled_values(image, region)
    found = segment_regions(
        grey[..., np.newaxis], region, _PHASES, spacing=image.spacing, name=image.name
    )
    return wanted_phase(found, grey, "bright")
