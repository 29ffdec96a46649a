"""From the images of a limb to labels: shading, regions, and assignment of regions to labels.

The user's tables (`image`, `bias`, `muscle` of decks) are applied to arrays, without files.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import InputError
from myork.records import Image, Labels
from myork.segmentation.bending import bend_labels
from myork.segmentation.channels import (
    fiber_channels,
    noise_weights,
    scaled_values,
    smoothed_tensor,
)
from myork.segmentation.grouping import (
    BACKGROUND,
    Muscle,
    check_seeds,
    doubt_of_depth,
    doubt_of_phase,
    doubt_of_separation,
    label_by_phase,
    label_by_reference,
    label_by_rules,
    label_by_seeds,
    rule_seeds,
)
from myork.segmentation.level_sets import LevelSets, Regions, segment_regions, wanted_phase
from myork.segmentation.regions import body_mask, box_mask, grown_mask, lost_part
from myork.segmentation.shading import shading
from myork.segmentation.starts import seeded_regions
from myork.types import F64, Mask

# Width of the Gaussian applied to the tensors before the fiber channels are computed [mm]
_SMOOTHING = 1.0
# Weight of the misfit of fiber channels relative to that of the grey values
_FIBER_WEIGHT = 5.0
# Width that the blur before thresholding adds to the body [pixel]
_SKIN = 1.0
# Part of a label's seeds in the pixels removed at the skin from which on they are intentional
_AT_RIM = 0.1


@dataclass(frozen=True)
class Images:
    """Input images of a segmentation, slices last; missing ones are None or empty."""

    anatomy: Image  #: MR image; with fat it is the water image
    fat: Image | None = None  #: Fat of a Dixon sequence
    decay: Image | None = None  #: R2* of its water and fat [1/s]
    others: tuple[Image, ...] = ()  #: Further channels
    #: Diffusion tensors, and the original ones if measured on another grid
    tensor: Image | None = None
    measured: Image | None = None
    #: Reference for scores; known labels from which walks start
    truth: Labels | None = None
    seeds: Labels | None = None
    #: Labels that nearly fit, and the image in which they were drawn
    reference: Labels | None = None
    drawn_in: Image | None = None
    body: Mask | None = None  #: Body given by the user
    region: Labels | None = None  #: Region to which the user limits the segmentation
    source: str = "phantom"  #: Source of the anatomy
    doubt: str = ""  #: Why water and fat may be exchanged

    @property
    def channels(self) -> list[Image]:
        """Images in addition to the anatomy."""
        return [*([self.fat] if self.fat is not None else []), *self.others]

    @property
    def whole(self) -> Image:
        """Image that shows the whole body: with fat, the sum of both."""
        if self.fat is None:
            return self.anatomy
        name = f"{self.anatomy.name} and {self.fat.name}"
        data = self.anatomy.data + np.maximum(self.fat.data, 0.0)
        return Image(data, self.anatomy.affine, name)

    def divided(self, field: F64) -> "Images":
        """The same images, anatomy and fat divided by the shading, (3.45)."""
        even = [one and replace(one, data=one.data / field) for one in (self.anatomy, self.fat)]
        assert even[0] is not None
        return replace(self, anatomy=even[0], fat=even[1])

    def fraction(self) -> Image | None:
        """Fraction of fat within the user's body, or that of a threshold; None without fat."""
        if self.fat is None:
            return None
        whole = self.whole
        some = (body_mask(whole, rim=0.0) if self.body is None else self.body) & (whole.data > 0)
        part = np.divide(self.fat.data, whole.data, out=np.zeros(some.shape), where=some)
        return Image(np.clip(part, 0.0, 1.0), whole.affine, "fraction of fat")

    def values(self, region: Mask, first: F64) -> tuple[list[F64], list[float]]:
        """Channels scaled to the region and their weights relative to the first channel."""
        scaled = [scaled_values(one, region) for one in self.channels]
        return scaled, noise_weights(first, scaled, region)

    def heights(self, fraction: Image | None, region: Mask) -> F64 | None:
        """Channels for walks in addition to the log of the whole image, times roots of weights.

        The fraction of fat is independent of shading; of other channels the scaled values are used.
        """
        scaled = [] if fraction is None else [fraction.data]
        scaled += [scaled_values(one, region) for one in self.others]
        if not scaled:
            return None
        weights = noise_weights(scaled_values(self.whole, region), scaled, region)
        roots = np.sqrt(np.minimum(weights, 1.0))
        return np.stack(scaled, axis=-1) * roots


@dataclass(frozen=True)
class Segmentation:
    """Result of a segmentation."""

    images: Images  #: Without shading
    body: Mask  #: Voxels of the body, shape `(ni, nj, nk)`
    field: F64 | None  #: Shading that was removed, same shape [-]
    bias: dict[str, Any]  #: Method, range and residual of the shading
    regions: Regions  #: Of the level sets
    labels: Labels  #: Muscles, or other wanted labels
    values: F64  #: Anatomy and channels, scaled to the region, shape `(ni, nj, nk, nchannel)` [-]
    weights: list[float]  #: Weights of the channels besides the anatomy [-]
    fraction: Image | None  #: Fraction of fat
    warnings: list[str]  #: Sentences


def segment_images(
    images: Images,
    table: Mapping[str, Any],
    *,
    bias: str = "none",
    muscles: Sequence[Muscle] = (),
    progress: ProgressCallback = silent,
) -> Segmentation:
    """Segment the images of a limb.

    - `images`: the available images
    - `table`: table `image` of decks
    - `bias`: method of the shading: `auto` or `none`
    - `muscles`: rules by which regions are grouped
    """
    body, doubts = images.body, []
    if body is None:
        # A region given by the user is kept whole: a threshold removes parts with weak coil signal,
        # and its rim removes the parts under the skin.
        body = _body_of(images)
        doubts.append(lost_part(images.whole, body))
    shade, record = None, {"method": bias}
    if bias == "auto":
        progress("estimating the bias field")
        shade, record = _shading(images.whole, body)
    images = images if shade is None else images.divided(shade)
    image = images.anatomy
    reference, lost = _bent(images, body, progress)
    region = body
    if images.region is not None:
        region = body & grown_mask(images.region, table["margin"])
    if "box" in table:
        region = region & box_mask(image, table["box"])
    check_seeds(region, image, muscles)
    grey = scaled_values(image, region)
    more, weights = images.values(region, grey)
    shown = np.stack([grey, *more], axis=-1)
    fibers = _fiber_channels(images.tensor, region, table["fiber_channels"])
    values = np.concatenate([shown, fibers], axis=3)
    every = [1.0, *weights, *[_FIBER_WEIGHT] * fibers.shape[3]]
    known = None
    if table["split"] == "pieces" and 2 < table["regions"] >= len(muscles) > 0:
        everywhere = np.where(region, 0, -1).astype(np.int32)
        seeds = rule_seeds(everywhere, image, muscles, table["seed_radius"])[1]
        known = seeded_regions(values * np.sqrt(every), region, seeds, table["regions"])
    choice = LevelSets.of_table(table)
    progress(f"segmenting {int(region.sum())} pixels in {image.data.shape[2]} slices")
    result = segment_regions(
        values,
        region,
        choice,
        spacing=image.spacing,
        channel_weights=every,
        labels=known,
        name=image.name,
    )
    wanted = wanted_phase(result, grey, table["phase"])
    if table["split"] != "pieces":
        progress(f"separating muscles: {table['split']}")
    fraction, seen = images.fraction(), images.whole
    others = images.heights(fraction, region) if table["split"] == "walk" else None
    if reference is not None:
        labels = label_by_reference(table, seen, grey, result, reference)
    elif images.seeds is not None:
        labels, more_doubts = label_by_seeds(table, seen, result, images.seeds, others)
        doubts += more_doubts
    elif muscles:
        labels, more_doubts = label_by_rules(table, seen, result, muscles, others)
        doubts += more_doubts
        if table["regions"] == 2:
            doubts.append(doubt_of_phase(labels, wanted, table["phase"]))
    else:
        labels = label_by_phase(table, image, grey, result)
        if table["regions"] == 2 and images.fat is None:  # a fraction of fat says more
            doubts.append(doubt_of_depth(labels, body, table["phase"]))
    if not (labels.data > 0).any():
        raise InputError(
            f"{image.name}: the segmentation is empty, no voxel got a label; check whether "
            "image.reference or the seeds of [[muscle]] lie in the body"
        )
    if table["regions"] == 2 and table["split"] != "walk":
        other = (result.region >= 0) & ~wanted
        doubts.append(doubt_of_separation(wanted, other, grey, table["phase"]))
    doubts += [images.doubt, record.get("doubt", ""), lost]
    if result.unrest:
        doubts.append(
            f"{result.unrest} of {len(result.iterations)} blocks of slices still changed after "
            f"{choice.iterations} iterations; raise image.tolerance, or image.mu"
        )
    warnings = [text for text in doubts if text]
    return Segmentation(
        images, body, shade, record, result, labels, shown, weights, fraction, warnings
    )


def _body_of(images: Images) -> Mask:
    """The body by threshold, with its rim if seeds are drawn there, and the user's region."""
    body = body_mask(images.whole)
    if images.seeds is not None:
        whole = body_mask(images.whole, rim=_SKIN)
        for number, name in images.seeds.present.items():
            own = images.seeds.data == number
            if name != BACKGROUND and (own & whole & ~body).sum() > _AT_RIM * own.sum():
                body = whole
    return body if images.region is None else body | (images.region.data > 0)


def _shading(image: Image, mask: Mask) -> tuple[F64, dict[str, Any]]:
    """Shading estimated in the body, and its record."""
    try:
        best = shading(image.data, mask, spacing=image.spacing)
    except InputError as reason:
        raise InputError(f"{image.name}: {reason}") from None
    inside = best.field[mask]
    return best.field, {
        "method": "auto",
        "range": [float(inside.min()), float(inside.max())],
        "start": best.start,
        "doubt": best.doubt,
    }


def _bent(images: Images, body: Mask, progress: ProgressCallback) -> tuple[Labels | None, str]:
    """Reference on the anatomy, deformed if the image it was drawn in is known; lost labels."""
    drawn = images.reference
    if drawn is None or images.drawn_in is None:
        return drawn, ""
    progress("bending the reference onto the image")
    bent = bend_labels(drawn, images.drawn_in, images.anatomy, body)
    kept = bent.present
    gone = [name for number, name in drawn.present.items() if number not in kept]
    where = f"{drawn.name}: bent onto {images.anatomy.name}"
    lost = f"{where} nothing is left of {', '.join(gone)}; none will be found" if gone else ""
    return bent, lost


def _fiber_channels(tensor: Image | None, region: Mask, kind: str) -> F64:
    """Channels of the fibers; empty if the deck wants none."""
    if kind == "none":
        return np.zeros((*region.shape, 0))
    if tensor is None:
        raise InputError("image.fiber_channels needs image.tensor or image.dwi")
    return fiber_channels(smoothed_tensor(tensor, region, _SMOOTHING), region, kind)
