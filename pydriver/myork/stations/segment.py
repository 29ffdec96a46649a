"""Station one: from images to a label map and fibers.

It writes to the output folder: the image without shading (`anatomy`) and the removed shading
(`bias`), `regions` (numbers plus one) and `segmentation`; with water and fat `fat`, `fat_fraction`
and `r2star` [1/s]; with tensors `fibers` (in the world frame), `fa`, `md` and `eigenvalues`; with
`image.partial` `fractions`; for the phantom also its images and its ground truth. `tissue.find`
adds `tissue`, `tissue_fibers`, `tissue_fractions` and memberships in fuzzy clusters.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from myork.console import ProgressCallback
from myork.errors import InputError
from myork.imaging.diffusion import tensor_maps
from myork.imaging.dixon import water_and_fat
from myork.imaging.geometry import length_factor
from myork.imaging.headers import described_by, read_header
from myork.imaging.io import read_image, read_labels, write_labels
from myork.imaging.phantom import KINDS, make_phantom, write_phantom
from myork.model.architecture import fat_of_label
from myork.model.fibers import fibers_of_labels
from myork.records import Image, Labels
from myork.segmentation.channels import scaled_values
from myork.segmentation.grouping import Muscle
from myork.segmentation.images import Images, Segmentation, segment_images
from myork.segmentation.leg import leg_tissues, outer_boundary
from myork.segmentation.partial import parts_of_labels
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import dice, label_scores
from myork.stations.data import DeckFiles, OneGrid
from myork.stations.station import station
from myork.types import Mask

# Kind of unlabelled voxels that take no part in the segmentation
_BEYOND = (0,)
_MUSCLE = 1
# Skin, between fat and air, is as grey as their mixture; bone is dark and bright.
_UNMIXED = (0, 4)
# Part by which echo times of a deck and of a header may differ; those of decks are often rounded
_OTHER_TIME = 0.1


@station("segment", "segmentation", "tissue")
def segment(deck: Mapping[str, Any], out: Path, progress: ProgressCallback) -> dict[str, Any]:
    """Segment the image of a deck, or the phantom where the deck names no image.

    The tables `image`, `dixon`, `bias`, `muscle`, `phantom`, `tissue` and `units` are read.
    """
    table, muscles = deck["image"], _muscles(deck)
    _check_rules(table, muscles)
    grid = OneGrid(progress, slices_last=True)
    images = read_images(deck, out, grid, progress)
    bias = deck["bias"]["method"]
    found = segment_images(images, table, bias=bias, muscles=muscles, progress=progress)
    labels, affine, kinds = found.labels, found.labels.affine, found.regions.region
    fractions: Image | None = None
    filled: dict[str, float] = {}
    if table["partial"]:
        progress("parts of labels in the voxels along their borders")
        fractions, filled = parts_of_labels(labels, -1 - kinds, found.values, _BEYOND)
    record = _record(deck, found, filled)
    maps = {"fat": found.images.fat, "fat_fraction": found.fraction, "r2star": images.decay,
            "fractions": fractions}  # fmt: skip
    if names := [name for name, one in maps.items() if one is not None]:
        record["maps"] = {name: f"{name}.nii.gz" for name in names}
    if images.source == "phantom":
        del maps["fat"]  # the folder has a separate fat image
    maps |= dict.fromkeys(("fibers", "fa", "md", "eigenvalues"))
    if images.tensor is not None:
        progress("fibers from the diffusion tensors")
        maps |= tensor_maps(images.tensor)
        measured = images.measured or images.tensor
        maps["fibers"] = _fibers(measured, found, table, record, progress)
    maps["bias"] = None if found.field is None else Image(found.field, affine)
    grid.renew(out, anatomy=found.images.anatomy, **maps)
    write_labels(out / "regions.nii.gz", grid.stored(Labels(kinds + 1, affine)))
    write_labels(out / "segmentation.nii.gz", grid.stored(labels))
    parts: dict[str, Any] = {"segmentation": record, "grid": grid}
    if deck["tissue"]["find"]:
        progress("materials of the leg")
        parts["tissue"] = find_tissues(deck, out, found, grid)
        record["warnings"] += parts["tissue"].pop("warnings")
    for line in (*_lines(record, deck), *(f"warning: {text}" for text in record["warnings"])):
        progress(line)
    record["warnings"] += grid.doubts
    return parts


def _record(
    deck: Mapping[str, Any], found: Segmentation, filled: Mapping[str, float]
) -> dict[str, Any]:
    """Entry of the summary; `filled` as in `_volumes`."""
    table, images, labels = deck["image"], found.images, found.labels
    entries, warnings = _volumes(labels, deck, filled), list(found.warnings)
    by_phase = table["regions"] == 2 and images.reference is None and images.seeds is None
    for number, name in labels.names.items():
        own = labels.data == number
        fraction = found.fraction
        fat = None if fraction is None else fat_of_label(own, fraction, images.whole)
        if fat is not None:
            entries[name]["fat_fraction"] = fat
            if by_phase and not deck.get("muscle"):
                warnings += _fat_doubt(name, fat, table["phase"])
    record = {
        "labels": entries,
        "scores": {} if images.truth is None else _scores(labels, images.truth),
        "iterations": int(found.regions.iterations.max()),
        "converged": not found.regions.unrest,
        "energy": found.regions.energy.tolist(),
        "warnings": warnings,
        "bias": found.bias,
        "source": images.source,
    }
    if images.channels:
        record["channels"] = [
            {"name": one.name, "weight": weight}
            for one, weight in zip(images.channels, found.weights, strict=True)
        ]
    return record


def _volumes(
    labels: Labels, deck: Mapping[str, Any], filled: Mapping[str, float]
) -> dict[str, dict[str, float]]:
    """Number of voxels and volume of each label, in the deck's unit of length, cubed.

    - `filled`: voxels filled by fractions of labels, where computed
    """
    voxel = float(np.prod(labels.spacing * length_factor(deck["units"]["length"])))
    count = {name: int((labels.data == n).sum()) for n, name in labels.names.items()}
    found = {name: {"pixels": n, "volume": n * voxel} for name, n in count.items()}
    for name, voxels in filled.items():
        found[name]["volume_of_parts"] = voxels * voxel
    return found


def _fibers(
    tensor: Image,
    found: Segmentation,
    table: Mapping[str, Any],
    record: dict[str, Any],
    progress: ProgressCallback,
) -> Image:
    """Fibers of the labels; findings about them are added to the record."""
    labels, truth, warnings = found.labels, found.images.truth, record["warnings"]
    way = fibers_of_labels(tensor, labels, table.get("fiber_smoothing"), truth)
    if way.axes.remark:
        progress(way.axes.remark)
    warnings += [f"{tensor.name}: {text}" for text in way.doubts()]
    record["orientation"] = [entry._asdict() for entry in way.axes.evidence]
    record["fiber_smoothing"] = way.smoothing
    return way.fibers


def _fat_doubt(name: str, fat: float, phase: str) -> list[str]:
    """Warning where the wanted phase of the water image is fat but has another name."""
    if fat <= 0.5 or "fat" in name.lower():
        return []
    other = "bright" if phase == "dark" else "dark"
    return [
        f"{name}: {100.0 * fat:.0f} % of its signal is fat; muscle is bright in the water of a "
        f"Dixon sequence: check whether image.phase should be '{other}'"
    ]


def _check_rules(table: Mapping[str, Any], muscles: list[Muscle]) -> None:
    """Refuse rules that contradict each other before anything is computed."""
    maps = [f"image.{key}" for key in ("seeds", "reference") if key in table]
    if muscles and maps:
        raise InputError(f"{maps[0]} and [[muscle]] both define the muscles; leave one of them out")
    if table["split"] == "walk" and not (muscles or "seeds" in table):
        raise InputError("image.split = 'walk' needs image.seeds or [[muscle]]")


def _muscles(deck: Mapping[str, Any]) -> list[Muscle]:
    """Rules of the deck."""
    muscles = []
    for rule in deck.get("muscle", []):
        name, seeds = rule["name"], np.array(rule.get("seeds", ()), float)
        if len(seeds) % 3:
            raise InputError(
                f"muscle.{name}.seeds: three coordinates per point are needed, not {len(seeds)}"
            )
        muscles.append(Muscle(name, seeds.reshape(-1, 3), rule.get("rim", 0.0)))
    return muscles


def _scores(labels: Labels, truth: Labels) -> dict[str, Any]:
    """Scores of the labels that the truth also has; a single label is compared with all of it."""
    by_name = {name: [number] for number, name in truth.present.items()}
    if len(labels.names) == 1:
        by_name.setdefault(next(iter(labels.names.values())), list(truth.present))
    pairs = {name: (n, by_name[name]) for n, name in labels.names.items() if name in by_name}
    return label_scores(labels.data, truth.data, pairs)


def _lines(record: Mapping[str, Any], deck: Mapping[str, Any]) -> list[str]:
    """Lines printed at the end."""
    unit = deck["result_units"]["volume"]
    lines = [
        f"{name}: {entry['pixels']} pixels, {entry['volume']:.4g} {unit}"
        for name, entry in record["labels"].items()
    ]
    lines += [
        f"{name}: Dice {score['dice']:.3f}, PCC {score['pcc']:.3f} against the truth"
        for name, score in record["scores"].items()
    ]
    return lines


def find_tissues(
    deck: Mapping[str, Any], out: Path, segmented: Segmentation, grid: OneGrid
) -> dict[str, Any]:
    """Label the tissues of a leg and write them and the muscle's fibers.

    - `out`: folder of the results, which has the phantom's images if it is used
    - `segmented`: images without shading; the fraction of fat is used for `tissue.fat` if
      the deck names none
    - returns voxels and volume of each tissue, and the Dice coefficients with the phantom's truth
    """
    files, keys, images = DeckFiles(deck, "tissue", grid), deck["image"], segmented.images
    phantom = images.source == "phantom"
    fat: Image | None
    connective: Image | None
    if phantom:
        fat, connective = (
            grid.of(read_image(out / f"{name}.nii.gz"), images.anatomy)
            for name in ("fat", "connective")
        )
    else:
        fat = files.image("fat", images.anatomy) or segmented.fraction
        connective = files.image("connective", images.anatomy)
    anatomy, body, tensor = images.whole, images.body, images.tensor
    if body is None and images.region is not None:
        body = outer_boundary(anatomy) | (images.region.data > 0)
    found, memberships, doubts = leg_tissues(
        anatomy, fat=fat, connective=connective, tensor=tensor, body=body,
        others=[one for one in images.others if one is not fat],
        least_diffusivity=files.table["least_diffusivity"],
    )  # fmt: skip
    muscle = found.data == _MUSCLE
    if not muscle.any():
        raise InputError(f"{anatomy.name}: no muscle was found; check the images of [tissue]")
    made: dict[str, Image | None] = dict.fromkeys(
        ("tissue_fibers", "tissue_fractions", "membership_fat", "membership_connective_tissue")
    )
    made |= {f"membership_{k}": Image(v, found.affine) for k, v in memberships.items()}
    filled: Mapping[str, float] = {}
    listed = {name: f"{name}.nii.gz" for name, one in made.items() if one is not None}
    if keys["partial"]:
        shown = [one for one in (anatomy, fat, connective) if one is not None]
        values = np.stack([scaled_values(one, found.data > 0) for one in shown], axis=-1)
        kinds = np.zeros_like(found.data)
        made["tissue_fractions"], filled = parts_of_labels(found, kinds, values, _UNMIXED)
        listed["fractions"] = "tissue_fractions.nii.gz"
    record = {"labels": _volumes(found, deck, filled), "warnings": doubts, "maps": listed}
    if tensor is not None:
        own = Labels(muscle.astype(np.int32), found.affine, {}, found.name)
        way = fibers_of_labels(images.measured or tensor, own, keys.get("fiber_smoothing"))
        made["tissue_fibers"] = way.fibers
        record["fibers"] = {"filled": way.filled, "far": way.far, "distance_mm": way.distance}
    write_labels(out / "tissue.nii.gz", grid.stored(found))
    grid.renew(out, **made)
    if phantom:
        truth = grid.of(read_labels(out / "true_tissue.nii.gz"), images.anatomy).data
        record["scores"] = {
            name: {"dice": dice(found.data == label, truth == label)}
            for label, name in found.names.items()
        }
    return record


def read_images(
    deck: Mapping[str, Any], out: Path, grid: OneGrid, progress: ProgressCallback
) -> Images:
    """Images of a deck, on the grid of the anatomy, slices last; the phantom's are also written."""
    table, files = deck["image"], DeckFiles(deck, "image", grid)
    found, anatomy = _echoes(deck, files, progress), files.image("anatomy")
    if anatomy is not None:
        found = Images(anatomy, fat=files.image("fat", anatomy), source=table["anatomy"])
        _check_different("image.anatomy and image.fat", [anatomy, found.fat])
    if found is None:
        stray = [key for key in ("tensor", "dwi", "truth", "fat") if key in table]
        stray += ["channels"] if table["channels"] else []
        if stray:
            raise InputError(
                f"image.{stray[0]} needs image.anatomy; without it the phantom and its own "
                f"{stray[0]} are used"
            )
        progress(f"phantom of {' x '.join(map(str, deck['phantom']['size']))} voxels")
        own = dict(deck["phantom"])
        phantom = make_phantom(**KINDS[own.pop("kind")], **own)
        write_phantom(out, phantom)
        like = grid.of(phantom.anatomy, None)
        found = Images(
            like, tensor=grid.of(phantom.tensor, None), truth=grid.of(phantom.truth, None)
        )
    else:
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
    body = files.labels("body", like)
    return found if body is None else replace(found, body=_checked_body(body, found.region))


def _checked_body(labels: Labels, region: Labels | None) -> Mask:
    """The user's body, which contains the region; a voxel at its rim is included."""
    body = labels.data > 0
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
    """Water and fat from the echoes of `[dixon]`; None without them."""
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
    # a phase is cyclic: its mean is meaningless
    phases, mask = files.images("phase", first, "nearest"), beside.labels("body", first)
    _check_different("dixon.magnitude", magnitudes)
    for pair in zip(magnitudes, phases, strict=False):
        _check_different("dixon.magnitude and dixon.phase", pair)
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


def _check_different(keys: str, images: Sequence[Image | None]) -> None:
    """Refuse an image that is given twice, in place of one of another kind."""
    for one, other in combinations([own for own in images if own is not None], 2):
        if np.array_equal(one.data, other.data):
            raise InputError(
                f"{keys}: {one.name} and {other.name} have the same values in all voxels; give "
                "the image of each kind"
            )


def _times(files: DeckFiles, progress: ProgressCallback) -> tuple[Sequence[float], float]:
    """Echo times [ms] and field [T] from the deck, else from headers; empty if both lack them."""
    table = files.table
    times, strength = table.get("echo_times", ()), table.get("field_strength", 0.0)
    paths = [files.folder / name for name in table["magnitude"]]
    try:
        headers = [read_header(path) for path in paths]
    except InputError:
        if times and strength:
            return times, strength
        raise
    for path, time, own in zip(paths, times, headers, strict=False):
        if own.echo_time is not None and abs(own.echo_time - time) > _OTHER_TIME * time:
            files.grid.doubt(
                f"dixon.echo_times has {time:g} ms for {path.name}, its header {own.echo_time:.4g} "
                "ms: look at the order of dixon.magnitude, dixon.phase and dixon.echo_times"
            )
    if times and strength:
        return times, strength
    for path in paths:
        files.grid.tell_strangers(path, described_by(path, "json"))
    written = [one.echo_time for one in headers if one.echo_time is not None]
    fields = {one.field for one in headers if one.field is not None}
    found = times or written, strength or (fields.pop() if len(fields) == 1 else 0.0)
    if len(found[0]) == len(paths) and found[1]:
        text = ", ".join(f"{time:.4g}" for time in found[0])
        progress(
            f"echo times {text} ms at {found[1]:.4g} T, of the headers where the deck has none"
        )
        return found
    if written and not times:
        files.grid.doubt(
            f"the headers of dixon.magnitude contain {len(written)} echo times but no field: the "
            "first echo is taken as in phase, the second as opposed; give dixon.field_strength"
        )
    return times, strength
