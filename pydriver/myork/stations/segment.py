"""Station one: images to a label map and fibers.

Files in the output folder: `anatomy.nii.gz` (the image that was segmented: bias corrected),
`bias.nii.gz` (the factor taken out), `regions.nii.gz` (numbers of the regions plus one),
`segmentation.nii.gz` with `segmentation.json` (names), `fat.nii.gz` and `fat_fraction.nii.gz`
(with fat only), `r2star.nii.gz` ([1/s], of three echoes and more), `fractions.nii.gz` (parts of
labels in each voxel, with `image.partial` only),
`fibers.nii.gz` (unit vectors in the world frame), `fa.nii.gz`, `md.nii.gz` and
`eigenvalues.nii.gz` (all with tensors only), `summary.json`; from the phantom also its images and
its truth (`write_phantom`).
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from myork.console import ProgressCallback
from myork.errors import InputError
from myork.imaging.diffusion import tensor_maps
from myork.imaging.io import renew_images, write_image, write_labels
from myork.model.architecture import fat_of_label
from myork.model.fibers import fibers_of_labels
from myork.model.orientation import check_orientation
from myork.records import Image, Labels
from myork.segmentation.grouping import Muscle
from myork.segmentation.images import Segmentation, segment_images
from myork.segmentation.scores import label_scores
from myork.stations.data import OneGrid
from myork.stations.images import read_images
from myork.stations.station import station
from myork.stations.tissue import LabelRecord, find_tissues

# Kind of voxels without a label that take no part in the segmentation
_BEYOND = (0,)


@station("segment", "segmentation", "tissue")
def segment(deck: Mapping[str, Any], out: Path, progress: ProgressCallback) -> dict[str, Any]:
    """Segment the image of a deck, or the phantom where the deck names no image.

    The tables `image`, `bias`, `muscle`, `phantom`, `tissue` and `units` are read.
    """
    table, muscles = deck["image"], _muscles(deck)
    _check_rules(table, muscles)
    grid = OneGrid(progress)
    images = read_images(deck, out, grid, progress)
    bias = {"bias": deck["bias"]["method"], "gamma": deck["bias"]["gamma"]}
    found = segment_images(images, table, **bias, muscles=muscles, progress=progress)
    labels, affine, kinds = found.labels, found.labels.affine, found.regions.region
    record = _record(deck, found)
    maps: dict[str, Image | None] = dict.fromkeys(
        ("fractions", "fibers", "fa", "md", "eigenvalues")
    )
    if table["partial"]:
        progress("parts of labels in the voxels along their borders")
        maps["fractions"] = record.parts(-1 - kinds, found.values, _BEYOND, "fractions.nii.gz")
    if images.tensor is not None:
        progress("fibers from the diffusion tensors")
        maps |= tensor_maps(images.tensor)
        measured = images.measured or images.tensor
        maps["fibers"] = _fibers(measured, found, table, record, progress)
    if images.source != "phantom":  # that has a fat image of its own
        maps["fat"] = found.images.fat
    maps["bias"] = None if found.field is None else Image(found.field, affine)
    renew_images(out, fat_fraction=found.fraction, r2star=found.images.decay, **maps)
    write_image(out / "anatomy.nii.gz", found.images.anatomy)
    write_labels(out / "regions.nii.gz", Labels(kinds + 1, affine))
    write_labels(out / "segmentation.nii.gz", labels)
    parts: dict[str, Any] = {"segmentation": record, "grid": grid}
    if deck["tissue"]["find"]:
        progress("materials of the leg")
        parts["tissue"] = find_tissues(deck, out, found, grid)
        record["warnings"] += parts["tissue"].pop("warnings")
    record["warnings"] += grid.doubts
    for line in (*_lines(record, deck), *(f"warning: {text}" for text in record["warnings"])):
        progress(line)
    return parts


def _record(deck: Mapping[str, Any], found: Segmentation) -> LabelRecord:
    """Entry of the summary."""
    table, images, labels = deck["image"], found.images, found.labels
    record = LabelRecord(labels, deck)
    parts = {} if found.fraction is None else {
        name: fat_of_label(labels.data == number, found.fraction, images.whole)
        for number, name in labels.names.items()
    }  # fmt: skip
    fat = {name: part for name, part in parts.items() if part is not None}
    for name, part in fat.items():
        record["labels"][name]["fat_fraction"] = part
    warnings = list(found.warnings)
    if table["regions"] == 2 and images.reference is None and images.seeds is None:
        warnings += [] if deck.get("muscle") else _fat_doubts(fat, table["phase"])
    record |= {
        "scores": {} if images.truth is None else _scores(table, labels, images.truth),
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
    if found.fraction is not None:
        names = ["fat", "fat_fraction", *(["r2star"] if images.decay is not None else [])]
        record["maps"] = {name: f"{name}.nii.gz" for name in names}
    return record


def _fibers(
    tensor: Image,
    found: Segmentation,
    table: Mapping[str, Any],
    record: dict[str, Any],
    progress: ProgressCallback,
) -> Image:
    """Fibers of the labels; the record gets what was seen of them."""
    labels, truth, warnings = found.labels, found.images.truth, record["warnings"]
    way = fibers_of_labels(tensor, labels, table.get("fiber_smoothing"))
    axes = check_orientation(way.fibers, labels if truth is None else truth)
    warnings += [axes.doubt] if axes.doubt else []
    if axes.remark:
        progress(axes.remark)
    warnings += [f"{tensor.name}: {text}" for text in way.doubts()]
    record["orientation"] = [entry._asdict() for entry in axes.evidence]
    record["fiber_smoothing"] = way.smoothing
    return way.fibers


def _fat_doubts(fat: Mapping[str, float], phase: str) -> list[str]:
    """What to say where the wanted phase of the water is fat and is not called so."""
    other = "bright" if phase == "dark" else "dark"
    return [
        f"{name}: {100.0 * mean:.0f} % of its signal is fat; muscle is bright in the water of a "
        f"Dixon sequence: look whether image.phase should be '{other}'"
        for name, mean in fat.items()
        if mean > 0.5 and "fat" not in name.lower()
    ]


def _check_rules(table: Mapping[str, Any], muscles: list[Muscle]) -> None:
    """Refuse rules that contradict each other before anything is computed."""
    if table["start"] == "seeds" and not muscles:
        raise InputError("image.start = 'seeds' needs [[muscle]] with seeds or a rim")
    maps = [f"image.{key}" for key in ("seeds", "reference") if key in table]
    if muscles and maps:
        raise InputError(f"{maps[0]} and [[muscle]] both say what is where; take one out")
    if table["split"] == "walk" and not (muscles or "seeds" in table):
        raise InputError("image.split = 'walk' needs image.seeds or [[muscle]]")


def _muscles(deck: Mapping[str, Any]) -> list[Muscle]:
    """Rules of the deck."""
    muscles = []
    for rule in deck.get("muscle", []):
        name, seeds = rule["name"], np.array(rule.get("seeds", ()), float)
        if len(seeds) % 3:
            raise InputError(f"muscle.{name}.seeds: three coordinates a point, not {len(seeds)}")
        muscles.append(Muscle(name, seeds.reshape(-1, 3), rule.get("rim", 0.0)))
    return muscles


def _scores(table: Mapping[str, Any], labels: Labels, truth: Labels) -> dict[str, Any]:
    """Scores of the labels that the truth has as well."""
    there = np.unique(truth.data[truth.data > 0]).tolist()
    by_name = {truth.label_name(number): [number] for number in there}
    pairs: dict[str, tuple[int, list[int]]] = {}
    if set(labels.names.values()) == {table["label"]}:
        pairs[table["label"]] = (1, by_name.get(table["label"], there))
    else:
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
