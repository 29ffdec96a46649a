"""Images that a deck names for `segment`, on the grid of the anatomy, or those of the phantom."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from myork.console import ProgressCallback
from myork.errors import InputError
from myork.imaging.dixon import water_and_fat
from myork.imaging.headers import read_header
from myork.imaging.phantom import make_phantom, write_phantom
from myork.records import Image, Labels
from myork.segmentation.images import Images
from myork.segmentation.regions import body_mask
from myork.stations.data import DeckFiles, OneGrid
from myork.types import Mask


def read_images(
    deck: Mapping[str, Any], out: Path, grid: OneGrid, progress: ProgressCallback
) -> Images:
    """Images of a deck; the phantom's are also written.

    - `deck`: tables `image`, `dixon` and `phantom`
    - `out`: folder of the results
    - `grid`: brings images onto the grid of the anatomy
    """
    table, files = deck["image"], DeckFiles(deck, "image", grid)
    found = _echoes(deck, files, progress)
    if found is None and "anatomy" not in table:
        stray = [key for key in ("tensor", "dwi", "truth", "fat") if key in table]
        stray += ["channels"] if table["channels"] else []
        if stray:
            raise InputError(
                f"image.{stray[0]} needs image.anatomy; without it the phantom and its own "
                f"{stray[0]} are used"
            )
        progress(f"phantom of {' x '.join(map(str, deck['phantom']['size']))} voxels")
        phantom = make_phantom(**deck["phantom"])
        write_phantom(out, phantom)
        found = Images(phantom.anatomy, tensor=phantom.tensor, truth=phantom.truth)
        like = found.anatomy
    else:
        if found is None:
            anatomy = files.image("anatomy")
            assert anatomy is not None
            found = Images(anatomy, fat=files.image("fat", anatomy), source=table["anatomy"])
        like, diffusion = found.anatomy, files.tensors()
        measured = diffusion and diffusion.tensor
        progress(f"{like.name}: {' x '.join(map(str, like.data.shape))} voxels")
        tensor = measured and grid.of(measured, like, "tensor-wise")
        truth = files.labels("truth", like, progress)
        found = replace(
            found,
            tensor=tensor,
            measured=None if tensor is measured else measured,
            truth=truth,
            others=tuple(files.images("channels", like)),
        )
    drawn_in = files.image("reference_anatomy")
    found = replace(
        found,
        reference=files.labels("reference", drawn_in or like, progress),
        drawn_in=drawn_in,
        seeds=files.labels("seeds", like, progress),
        region=files.labels("region", like),
    )
    _check_labels(found)
    body = files.labels("body", like)
    return found if body is None else replace(found, body=_checked_body(body, found.region))


def _check_labels(images: Images) -> None:
    """Refuse an empty truth and an empty reference."""
    truth, reference = images.truth, images.reference
    if truth is not None and not truth.data.any():
        raise InputError(f"{truth.name}: the truth is empty, no label is above zero")
    if reference is not None and not reference.data.any():
        raise InputError(
            f"{reference.name}: the reference is empty, no voxel has a label above zero; give the "
            "label map by which regions are to be grouped"
        )


def _checked_body(labels: Labels, region: Labels | None) -> Mask:
    """The body that the user names, which contains the region; a voxel at its rim is taken in."""
    body = labels.data > 0
    if not body.any():
        raise InputError(f"{labels.name}: image.body is empty, no label is above zero")
    if region is None:
        return body
    near = ndimage.binary_dilation(body, ndimage.generate_binary_structure(3, 3))
    beyond = np.argwhere((region.data > 0) & ~near)
    if len(beyond):
        raise InputError(
            f"{region.name}: {len(beyond)} voxels of image.region lie outside of image.body, the "
            f"first is {tuple(beyond[0].tolist())}; enlarge the body, or leave it out"
        )
    return body | (region.data > 0)


def _echoes(
    deck: Mapping[str, Any], beside: DeckFiles, progress: ProgressCallback
) -> Images | None:
    """Water and fat of the echoes of `[dixon]`; None without them."""
    files = DeckFiles(deck, "dixon", beside.grid)
    if "magnitude" not in files.table:
        return None
    for key in ("anatomy", "fat"):
        if key in beside.table:
            raise InputError(
                f"[dixon] makes water and fat of its echoes; take image.{key} out, or list it in "
                "image.channels"
            )
    magnitudes = files.images("magnitude")
    first = magnitudes[0]
    # a phase goes round: means of it are none
    phases, mask = files.images("phase", first, "nearest"), beside.labels("body", first)
    if mask is not None:
        body = mask.data > 0
    else:
        body = body_mask(Image(np.sum([m.data for m in magnitudes], axis=0), first.affine), rim=0.0)
    times, strength = _times(files, progress)
    found = water_and_fat(magnitudes, phases, body, times=times, strength=strength)
    return Images(
        Image(found.water, first.affine, f"water of {first.name}"),
        Image(found.fat, first.affine, f"fat of {first.name}"),
        None if found.decay is None else Image(found.decay, first.affine, "R2*"),
        source=files.table["magnitude"][0],
        doubt=found.doubt,
    )


def _times(files: DeckFiles, progress: ProgressCallback) -> tuple[Sequence[float], float]:
    """Echo times [ms] and field [T] of the deck, else of the headers; none where both lack them."""
    table = files.table
    times, strength = table.get("echo_times", ()), table.get("field_strength", 0.0)
    if times and strength:
        return times, strength
    headers = [read_header(files.folder / name) for name in table["magnitude"]]
    written = [one.echo_time for one in headers if one.echo_time is not None]
    fields = {one.field for one in headers if one.field is not None}
    if not times and len(written) == len(headers):
        times = written
    if not strength and len(fields) == 1:
        strength = fields.pop()
    if len(times) == 0 or not strength:
        if written and not table.get("echo_times"):
            files.grid.doubts.append(
                f"the headers of dixon.magnitude hold {len(written)} echo times and no field: the "
                "first echo is taken as in phase, the second as opposed; give dixon.field_strength"
            )
        return table.get("echo_times", ()), table.get("field_strength", 0.0)
    text = ", ".join(f"{time:.4g}" for time in times)
    progress(f"echo times {text} ms at {strength:.4g} T, of the headers where the deck has none")
    return times, strength
