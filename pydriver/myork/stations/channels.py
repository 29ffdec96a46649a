"""Part of station one: images beside the anatomy, water and fat of echoes, what walks see.

Files in the output folder, where there is fat: `fat.nii.gz` (shading taken out as of the anatomy)
and `fat_fraction.nii.gz` (0 to 1, zero outside of the body).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from myork.errors import InputError
from myork.imaging.dixon import separate_images
from myork.imaging.geometry import check_same_grid
from myork.imaging.io import read_image, read_labels, write_image
from myork.records import Image, Labels
from myork.segmentation.channels import noise_level, noise_weight, scaled_values
from myork.segmentation.regions import body_mask
from myork.types import F64, Mask

__all__ = ["Beside", "fat_of_labels", "read_beside", "read_echoes"]


FILES = ("fat.nii.gz", "fat_fraction.nii.gz")


@dataclass(frozen=True)
class Beside:
    """Images beside the anatomy, on its grid.

    Attributes
    ----------
    fat : Image or None
        Fat, the anatomy being water.
    others : tuple of Image
        Further channels.
    weights : tuple of float
        Of the deck, fat first; empty: by the noise.
    echoes : bool
        Whether anatomy and fat were made of echoes.
    """

    fat: Image | None = None
    others: tuple[Image, ...] = ()
    weights: tuple[float, ...] = ()
    echoes: bool = False

    @property
    def images(self) -> list[Image]:
        """Channels in their order."""
        return [*([self.fat] if self.fat is not None else []), *self.others]

    def whole(self, image: Image) -> Image:
        """Image that shows the whole body: with fat the sum of both."""
        if self.fat is None:
            return image
        name = f"{image.name} and {self.fat.name}"
        return Image(image.data + np.maximum(self.fat.data, 0.0), image.affine, name)

    def divided(self, factor: F64) -> Beside:
        """The fat without the shading that the anatomy had as well."""
        if self.fat is None:
            return self
        return replace(self, fat=replace(self.fat, data=self.fat.data / factor))

    def fraction(self, image: Image, body: Mask | None) -> Image | None:
        """Fraction of fat in the user's body, or in that of a threshold; None without fat."""
        if self.fat is None:
            return None
        whole = self.whole(image)
        some = (body_mask(whole, rim=0.0) if body is None else body) & (whole.data > 0)
        part = np.divide(self.fat.data, whole.data, out=np.zeros(some.shape), where=some)
        return Image(np.clip(part, 0.0, 1.0), image.affine, "fraction of fat")

    def values(self, region: Mask, first: F64) -> tuple[list[F64], list[float]]:
        """Channels scaled to the region and their weights against the first channel."""
        images = self.images
        scaled = [scaled_values(one, region) for one in images]
        if self.weights:
            if len(self.weights) != len(images):
                raise InputError(
                    f"image.channel_weights has {len(self.weights)} weights; give "
                    f"{len(images)}, one for each of {[one.name for one in images]}"
                )
            return scaled, list(self.weights)
        noise = noise_level(first, region)
        return scaled, [noise_weight(noise, noise_level(one, region)) for one in scaled]

    def heights(self, image: Image, fraction: Image | None, region: Mask) -> F64 | None:
        """What walks see beside the logarithm of the whole image, times roots of weights.

        The fraction of fat knows no shading; of other channels the scaled values count.
        """
        shown = [*([fraction] if fraction is not None else []), *self.others]
        if not shown:
            return None
        scaled = [one.data if one is fraction else scaled_values(one, region) for one in shown]
        weights = list(self.weights)
        if not weights:
            noise = noise_level(scaled_values(self.whole(image), region), region)
            weights = [noise_weight(noise, noise_level(one, region)) for one in scaled]
        return np.stack(
            [one * min(1.0, w) ** 0.5 for one, w in zip(scaled, weights, strict=True)], -1
        )

    def write(self, fraction: Image | None, out: Path) -> dict[str, str]:
        """Write fat and its fraction; names of maps and their files."""
        if self.fat is None or fraction is None:
            return {}
        for name, one in zip(FILES, (self.fat, fraction), strict=True):
            write_image(out / name, one)
        return {"fat": FILES[0], "fat_fraction": FILES[1]}


def read_beside(table: Mapping[str, Any], folder: Path, image: Image, fat: Image | None) -> Beside:
    """Images that a deck names beside the anatomy.

    Parameters
    ----------
    table : mapping
        Table `image` of the deck.
    folder : Path
        Where its relative paths start.
    image : Image
        Anatomy.
    fat : Image or None
        Fat of echoes.
    """
    if "fat" in table:
        fat = read_image(folder / table["fat"])
    others = tuple(read_image(folder / name) for name in table["channels"])
    weights, echoes = tuple(table["channel_weights"]), fat is not None and "fat" not in table
    beside = Beside(fat, others, weights, echoes)
    for one in beside.images:
        check_same_grid(one, image)
    if weights and not beside.images:
        raise InputError("image.channel_weights needs image.fat, image.channels or [dixon]")
    return beside


def read_echoes(deck: Mapping[str, Any], folder: Path) -> tuple[Image, Image, str] | None:
    """Water, fat and doubts from the echoes of `[dixon]`; None without them."""
    keys, table = deck["dixon"], deck["image"]
    if "magnitude" not in keys and "phase" not in keys:
        return None
    if "magnitude" not in keys or "phase" not in keys:
        raise InputError("[dixon] needs magnitude and phase, two images each")
    for key in ("anatomy", "fat"):
        if key in table:
            raise InputError(
                f"[dixon] makes water and fat of its echoes; take image.{key} out, or list it in "
                "image.channels"
            )
    echoes = [[read_image(folder / name) for name in keys[kind]] for kind in ("magnitude", "phase")]
    first = echoes[0][0]
    for one in (*echoes[0], *echoes[1]):
        check_same_grid(one, first)
    if "body" in table:
        mask = read_labels(folder / table["body"])
        check_same_grid(mask, first)
        body = mask.data > 0
    else:
        both = Image(echoes[0][0].data + echoes[0][1].data, first.affine, first.name)
        body = body_mask(both, rim=0.0)
    found = separate_images(
        echoes[0],
        echoes[1],
        body,
        times=keys.get("echo_times", ()),
        strength=keys.get("field_strength", 0.0),
        rim=keys["rim"],
        turn=keys.get("turn"),
    )
    water, fat = (
        Image(data, first.affine, f"{name} of {first.name}")
        for name, data in (("water", found.water), ("fat", found.fat))
    )
    return water, fat, found.doubt


def fat_of_labels(labels: Labels, fraction: Image, whole: Image) -> dict[str, float]:
    """Fraction of fat of each label that has signal: of all its fat in all of its signal.

    Parameters
    ----------
    labels : Labels
        Shape `(ni, nj, nk)`.
    fraction, whole : Image
        Fraction of fat, and the sum of water and fat.
    """
    found = {}
    for number, name in labels.names.items():
        weight = np.maximum(whole.data[labels.data == number], 0.0)
        if weight.sum() > 0:
            inside = fraction.data[labels.data == number]
            found[name] = float(np.average(inside, weights=weight))
    return found
