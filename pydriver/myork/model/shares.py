"""Fraction of each merged voxel that is body, and fraction of that for each label.

Points lie in whole blocks of one label. Volumes are counted in the voxels that were merged, or by
their fractions, so that those of the body and of each label are conserved: also for blocks that the
surface cuts, that are left out, and for sheets thinner than a block.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from myork.errors import InputError
from myork.imaging.geometry import block_sums, check_same_grid, to_voxels
from myork.model.points import first_voxel
from myork.records import Image, Labels
from myork.types import F64, I32, I64, Mask

# Fractions are written in single precision.
_SLACK = 1e-3
# Least filling of a voxel of the body [-]: an emptier one would be nearly free to move.
_LEAST = 0.1


def checked_parts(image: Image, labels: Labels) -> Image:
    """Refuse fractions that do not match the labels of a map, or are not fractions.

    - `image`: shape `(ni, nj, nk, nlabel)`
    - `labels`: label map; the fractions are of its labels above zero, one each, ascending
    """
    check_same_grid(image, labels)
    numbers = list(labels.present)
    if image.data.shape[3] != len(numbers):
        raise InputError(
            f"{image.name}: {image.data.shape[3]} volumes do not go with the labels {numbers} of "
            f"{labels.name}; give one volume for each, in ascending order"
        )
    # comparisons with not-a-number are false
    whole = image.data.sum(axis=3)
    fine = (image.data >= -_SLACK).all(axis=3) & (whole <= 1.0 + _SLACK)
    if not fine.all():
        at = tuple(np.argwhere(~fine)[0].tolist())
        raise InputError(
            f"{image.name}: parts of labels must be 0 at least and their sum 1 at most, but in "
            f"{int((~fine).sum())} voxels they are not, first in {at}: {image.data[at].tolist()}"
        )
    # Fractions differ from labels along borders; labels that were changed later have none inside.
    places = np.searchsorted(numbers, np.maximum(labels.data, numbers[0]))[..., np.newaxis]
    own = np.where(
        labels.data > 0, np.take_along_axis(image.data, places, axis=3)[..., 0], 1.0 - whole
    )
    low, high = (one(labels.data, 3) for one in (ndimage.minimum_filter, ndimage.maximum_filter))
    lost = (low == high) & (own <= _SLACK)
    if lost.any():
        raise InputError(
            f"{image.name}: {int(lost.sum())} voxels inside a label of {labels.name} have a "
            f"fraction of 0 of it, the first is {tuple(np.argwhere(lost)[0].tolist())}: the "
            "fractions belong to another label map; compute them from this one, or leave them out"
        )
    return Image(np.maximum(image.data, 0.0), image.affine, image.name)


class LabelParts(NamedTuple):
    """Fractions of labels in each voxel of an image."""

    image: Image  #: Fraction of each label, shape `(ni, nj, nk, nlabel)` [-]
    labels: I32  #: Labels, ascending, shape `(nlabel,)`

    def first(self, fine: Labels) -> I64:
        """Voxel at which a label map cut out of the image's grid begins, shape `(3,)`."""
        return np.rint(to_voxels(self.image.affine, fine.affine[:3, 3])).astype(np.int64)

    def volumes(self, fine: Labels) -> dict[int, float]:
        """Volumes of all labels within the slices of a label map [mm^3]."""
        low = int(self.first(fine)[2])
        slices = self.image.data[:, :, low : low + fine.data.shape[2]]
        sums = slices.sum(axis=(0, 1, 2)) * fine.spacing.prod()
        return dict(zip(self.labels.tolist(), sums.tolist(), strict=True))

    def of(self, label: int, fine: Labels, places: Sequence[I64]) -> F64:
        """Fraction of a label in voxels counted from the first one of a label map along each axis.

        Fractions in slices beyond those of the map are ignored.
        """
        data = self.image.data[..., int(np.searchsorted(self.labels, label))]
        along = [place + first for place, first in zip(places, self.first(fine), strict=True)]
        known = [one.clip(0, n - 1) for one, n in zip(along, data.shape, strict=True)]
        i, j, _ = (one == near for one, near in zip(along, known, strict=True))
        return np.asarray(data[np.ix_(*known)] * i[:, np.newaxis, np.newaxis] * j[:, np.newaxis])


def label_shares(
    fine: Labels,
    coarse: Labels,
    block: Sequence[int],
    left_out: Mask,
    parts: LabelParts | None = None,
) -> tuple[F64, I32]:
    """Volume of each label in each merged voxel of a body, relative to that of the voxel.

    The content of blocks that are not part of the body is given in equal parts to adjacent blocks:
    those that share a face or, if there are none, an edge or a corner. The content of blocks
    without any adjacent block of the body is lost.

    - `fine`: label map
    - `coarse`: its merged blocks; those above zero are the body
    - `block`: voxels per block in each direction
    - `left_out`: merged voxels that are left out with their content, shape of `coarse.data`
    - `parts`: fractions of labels in each voxel, on the grid that `fine` was cut out of; without it
      each voxel of `fine` contains its label only
    - returns shares in lexicographic order of the body's voxels, shape `(nbody, nlabel)` [-] (the
      sum of a row exceeds 1 where a neighbour was left out), and the labels, ascending
    """
    body = coarse.data > 0
    numbers = np.unique(fine.data[fine.data > 0])
    if max(block) == 1 and parts is None:
        return (coarse.data[body][:, np.newaxis] == numbers).astype(float), numbers
    size = np.array(block)
    first = first_voxel(fine, coarse, block)
    last = first + size * body.shape - fine.data.shape
    # whole additional blocks on all sides, at least one: the map may reach beyond the merged body
    before = np.maximum(-(-first // size), 1)
    after = np.maximum(-(last // size), 1)
    pad = np.stack([before * size - first, after * size + last], axis=1)
    # beyond the end slices the body continues to the end of its blocks
    slices = fine.data.shape[2]
    along = np.arange(-pad[2, 0], slices + pad[2, 1])
    inside = (along >= min(first[2], 0)) & (along < slices + max(last[2], 0))
    places = [np.arange(-low, count + high) for (low, high), count
              in zip(pad[:2], fine.data.shape[:2], strict=True)]  # fmt: skip
    places.append(along.clip(0, slices - 1))
    data = np.pad(fine.data, [*pad[:2].tolist(), (0, 0)])[:, :, places[2]]
    n = np.array(data.shape) // size
    middle = tuple(slice(b, b + s) for b, s in zip(before, body.shape, strict=True))
    kept, gone = np.zeros(n, dtype=bool), np.zeros(n, dtype=bool)
    kept[middle], gone[middle] = body, left_out
    shares = np.empty((int(body.sum()), len(numbers)))
    for column, number in enumerate(numbers):
        filled = (data == number) if parts is None else parts.of(int(number), fine, places)
        share = np.where(gone, 0.0, block_sums(filled * inside, size) / size.prod())
        shares[:, column] = _given_on(share, kept)[kept]
    total = shares.sum(axis=1)
    empty = total == 0
    shares[empty] = (coarse.data[body][empty, np.newaxis] == numbers) * _LEAST
    total[empty] = _LEAST
    return shares * np.maximum(_LEAST / total, 1.0)[:, np.newaxis], numbers


def _given_on(share: F64, kept: Mask) -> F64:
    """Add the shares of voxels that are not kept to those of their neighbours."""
    given, rest = np.where(kept, share, 0.0), np.where(kept, 0.0, share)
    for corners in (1, 3):
        beside = ndimage.generate_binary_structure(3, corners).astype(float)
        takers = ndimage.convolve(kept.astype(float), beside, mode="constant")
        part = np.where(takers > 0, rest / np.maximum(takers, 1.0), 0.0)
        given += kept * ndimage.convolve(part, beside, mode="constant")
        rest = np.where(takers > 0, 0.0, rest)
    return np.asarray(given)
