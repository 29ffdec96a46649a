"""Station one: images to a label map and fibers.

Files in the output folder: `anatomy.nii.gz` (the image that was segmented: bias corrected),
`bias.nii.gz` (the factor taken out), `regions.nii.gz` (numbers of the regions plus one),
`segmentation.nii.gz` with `segmentation.json` (names), `fat.nii.gz` and `fat_fraction.nii.gz`
(with fat only), `fractions.nii.gz` (parts of labels in each voxel, with `image.partial` only),
`fibers.nii.gz` (unit vectors in the world frame), `fa.nii.gz`, `md.nii.gz` and
`eigenvalues.nii.gz` (all with tensors only), `summary.json`; from the phantom also its images and
its truth (`write_phantom`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import myork
from myork.console import ProgressCallback, silent
from myork.core.deck import read_deck
from myork.core.level_sets import evolve_level_sets
from myork.core.threads import core_threads
from myork.errors import InputError
from myork.imaging.diffusion import read_tensors
from myork.imaging.geometry import check_same_grid, length_factor
from myork.imaging.io import (
    read_image,
    read_labels,
    read_reference,
    write_image,
    write_labels,
)
from myork.imaging.phantom import make_phantom, write_phantom
from myork.model.fibers import fiber_field
from myork.model.orientation import check_orientation
from myork.records import Image, Labels
from myork.segmentation.assign import (
    label_by_phase,
    label_by_reference,
    label_by_rules,
    label_by_seeds,
)
from myork.segmentation.bending import bend_labels
from myork.segmentation.bias import BiasField, check_positive, clustered_bias, n4_bias
from myork.segmentation.channels import fiber_channels, scaled_values, smoothed_tensor
from myork.segmentation.grouping import Muscle, check_seeds, rule_seeds
from myork.segmentation.level_sets import LevelSets, Regions, segment_regions
from myork.segmentation.regions import body_mask, box_mask, grown_mask, piece_with_seed
from myork.segmentation.scores import label_scores
from myork.segmentation.shading import shading
from myork.segmentation.starts import seeded_regions
from myork.stations.channels import FILES, Beside, fat_of_labels, read_beside, read_echoes
from myork.stations.partial import write_parts
from myork.stations.tensors import tensor_maps
from myork.stations.tissue import find_tissues
from myork.summary import renewing, update_summary

__all__ = ["segment"]

# Kind of voxels without a label that take no part in the segmentation
_BEYOND = (0,)
# Width of the Gaussian over the tensors before the fiber channels are taken [mm]
_SMOOTHING = 1.0
# Regions in which the true image is even, for a bias field by level sets
_EVEN = 3


def segment(
    deck: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Segment the image of a deck, or the phantom where the deck names no image.

    Parameters
    ----------
    deck : str, Path or mapping
        Deck file, or its tables as data; the tables `image`, `bias`, `muscle`, `phantom`, `tissue`
        and `units` are read.
    out : str or Path
        Folder of the results.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    threads : int, optional
        Number of threads of the level sets; default all cores.
    progress : callable
        Called with a line of text at a time.

    Returns
    -------
    dict
        What was added to `summary.json`.
    """
    values, out = read_deck(deck, overrides, "segment"), Path(out)
    with renewing(out, "segmentation", "tissue"), core_threads(threads):
        return _segment(values, Path(values["folder"]), out, progress)


def _segment(
    deck: Mapping[str, Any], folder: Path, out: Path, progress: ProgressCallback
) -> dict[str, Any]:
    """All steps, on a deck whose relative paths start in a folder."""
    table = deck["image"]
    muscles = _muscles(deck)
    _check_rules(table, muscles)
    image, tensor, truth, beside, doubt = _inputs(deck, table, folder, out, progress)
    if truth is not None:
        _check_truth(truth, table["truth_labels"])
    reference, drawn_in = _reference(table, folder, image, progress)
    seeds = read_reference(folder / table["seeds"], progress) if "seeds" in table else None
    if seeds is not None:
        check_same_grid(seeds, image)
    body, wanted = _masks(beside.whole(image), table, folder)
    factor, bias = _shading(beside.whole(image), body, deck["bias"], out, progress)
    if factor is not None:
        image, beside = replace(image, data=image.data / factor), beside.divided(factor)
    lost = ""
    if reference is not None and drawn_in is not None:
        drawn = reference
        reference, moved = bend_labels(drawn, drawn_in, image, body)
        lost = _lost(drawn, reference, image)
        progress(
            f"reference bent onto the image: it moves by {np.median(moved):.1f} mm in the median, "
            f"{moved.max():.1f} mm at most"
        )
    region = _region(image, body, wanted, table)
    check_seeds(region, image, muscles)
    if reference is None and not muscles and "seed" in table:
        piece_with_seed(region, image, table["seed"])  # refuses one outside before the level sets
    grey = scaled_values(image, region)
    more, weights = beside.values(region, grey)
    record = [
        {"name": one.name, "weight": weight}
        for one, weight in zip(beside.images, weights, strict=True)
    ]
    channels, weights = [np.stack([grey, *more], axis=-1)], [1.0, *weights]
    if table["fiber_channels"] != "none":
        if tensor is None:
            raise InputError("image.fiber_channels needs image.tensor or image.dwi")
        smooth = smoothed_tensor(tensor, region, _SMOOTHING)
        channels.append(fiber_channels(smooth, region, table["fiber_channels"]))
        weights += [table["fiber_weight"]] * channels[1].shape[3]
    values = np.concatenate(channels, axis=3)
    start = _start_labels(table, image, region, muscles, values * np.sqrt(weights))
    choice = LevelSets.of_table(
        table, start="labels" if table["start"] == "seeds" else table["start"]
    )
    progress(f"segmenting {int(region.sum())} pixels in {image.data.shape[2]} slices")
    result = segment_regions(
        values,
        region,
        evolve_level_sets,
        choice,
        spacing=image.spacing,
        channel_weights=weights,
        labels=start,
        name=image.name,
    )
    if table["split"] != "pieces":
        progress(f"parting muscles: {table['split']}")
    warnings: list[str] = []
    seen = beside.whole(image)
    fraction = beside.fraction(image, body if "body" in table else None)
    others = beside.heights(image, fraction, region) if table["split"] == "walk" else None
    if reference is not None:
        labels = label_by_reference(table, seen, grey, result, reference, others)
    elif seeds is not None:
        labels, warnings = label_by_seeds(table, seen, result, seeds, others)
    elif muscles:
        labels, warnings = label_by_rules(table, seen, result, muscles, others)
    else:
        labels = label_by_phase(table, image, grey, result)
    inside = labels.data > 0
    if not inside.any():
        raise InputError(
            f"{image.name}: the segmentation is empty, no voxel got a label; look whether "
            "image.reference or the seeds of [[muscle]] lie in the body"
        )
    write_image(out / "anatomy.nii.gz", image)
    write_labels(out / "regions.nii.gz", Labels(result.region + 1, image.affine))
    write_labels(out / "segmentation.nii.gz", labels)

    maps = beside.write(fraction, out)
    warnings += [text for text in (doubt, bias.get("doubt"), lost) if text]
    warnings += [] if not result.unrest else [_unrest(result, choice.iterations)]
    for name in ("fractions", "fibers", "fa", "md", "eigenvalues"):
        (out / f"{name}.nii.gz").unlink(missing_ok=True)
    filled: dict[str, float] = {}
    if table["partial"]:
        progress("parts of labels in the voxels along their borders")
        maps["fractions"] = "fractions.nii.gz"
        filled = write_parts(
            out / maps["fractions"], labels, -1 - result.region, channels[0], _BEYOND
        )
    if tensor is not None:
        progress("fibers from the diffusion tensors")
        fibers, mended, far, distance, width = fiber_field(
            tensor, labels.data, table.get("fiber_smoothing"), table["tensor_frame"]
        )
        write_image(out / "fibers.nii.gz", fibers)
        for name, values_of in tensor_maps(tensor).items():
            write_image(out / f"{name}.nii.gz", values_of)
        axes = check_orientation(fibers, labels if truth is None else truth)
        warnings += [axes.doubt] if axes.doubt else []
        if axes.remark:
            progress(axes.remark)
        if mended:
            warnings.append(
                f"{tensor.name}: {mended} of {int(inside.sum())} tensors of the tissue are not "
                "finite or not positive; their neighbours were used"
            )
        if far:
            warnings.append(
                f"{tensor.name}: {far} of these have no usable tensor around them and took the "
                f"fiber of the nearest voxel that has, up to {distance:.3g} mm away"
            )
    fat = {} if fraction is None else fat_of_labels(labels, fraction, seen)
    if table["regions"] == 2 and reference is None and seeds is None and not muscles:
        warnings += _fat_doubts(fat, table["phase"])
    scores = {} if truth is None else _scores(table, labels, truth)
    summary = _summary(deck, labels, result, scores, warnings)
    summary["segmentation"]["bias"] = bias
    summary["segmentation"]["source"] = (
        deck["dixon"]["magnitude"][0] if beside.echoes else table.get("anatomy", "phantom")
    )
    if record:
        summary["segmentation"]["channels"] = record
    if maps:
        summary["segmentation"]["maps"] = maps
    entries = summary["segmentation"]["labels"]
    for name, mean in fat.items():
        entries[name]["fat_fraction"] = mean
    for name, n in filled.items():
        entries[name]["volume_of_parts"] = n * entries[name]["volume"] / entries[name]["pixels"]
    if tensor is not None:
        summary["segmentation"]["orientation"] = [entry.record() for entry in axes.evidence]
        summary["segmentation"]["fiber_smoothing"] = width
    if deck["tissue"]["find"]:
        progress("materials of the leg")
        summary["tissue"] = find_tissues(
            deck, folder, out, seen, tensor,
            body if "body" in table else None, None if wanted is None else wanted.data > 0,
            fraction,
        )  # fmt: skip
    update_summary(out, summary)
    for line in (*_lines(summary), *(f"warning: {text}" for text in warnings)):
        progress(line)
    return summary


def _inputs(
    deck: Mapping[str, Any],
    table: Mapping[str, Any],
    folder: Path,
    out: Path,
    progress: ProgressCallback,
) -> tuple[Image, Image | None, Labels | None, Beside, str]:
    """Anatomy, tensor, truth, images beside it and doubts; the phantom's are also written."""
    echoes = read_echoes(deck, folder)
    if "anatomy" not in table and echoes is None:
        stray = [key for key in ("tensor", "dwi", "truth", "fat") if key in table]
        stray += ["channels"] if table["channels"] else []
        if stray:
            raise InputError(
                f"image.{stray[0]} needs image.anatomy; without it the phantom and its own "
                f"{stray[0]} are used"
            )
        keys = deck["phantom"]
        progress(f"phantom of {' x '.join(map(str, keys['size']))} voxels")
        phantom = make_phantom(**keys)
        write_phantom(out, phantom)
        (out / FILES[1]).unlink(missing_ok=True)
        return phantom.anatomy, phantom.tensor, phantom.truth, Beside(), ""
    if echoes is None:
        image, fat, doubt = read_image(folder / table["anatomy"]), None, ""
    else:
        image, fat, doubt = echoes
    progress(f"{image.name}: {' x '.join(map(str, image.data.shape))} voxels")
    tensor = read_tensors(table, folder)
    truth = read_reference(folder / table["truth"], progress) if "truth" in table else None
    for other in (tensor, truth):
        if other is not None:
            check_same_grid(other, image)
    beside = read_beside(table, folder, image, fat)
    if beside.fat is None:
        for name in FILES:
            (out / name).unlink(missing_ok=True)
    return image, tensor, truth, beside, doubt


def _masks(
    image: Image, table: Mapping[str, Any], folder: Path
) -> tuple[NDArray[np.bool_], Labels | None]:
    """The body, found by threshold where the deck names none, and the user's region, if any.

    Whatever the user calls body or region is kept whole: a threshold cuts off what the coil
    reaches badly, and its rim what lies under the skin.
    """
    maps = {key: read_labels(folder / table[key]) for key in ("body", "region") if key in table}
    for map_ in maps.values():
        check_same_grid(map_, image)
    wanted = maps.get("region")
    if "body" not in maps:
        found = body_mask(image)
        return found if wanted is None else found | (wanted.data > 0), wanted
    body = maps["body"].data > 0
    if not body.any():
        raise InputError(f"{maps['body'].name}: image.body is empty, no label is above zero")
    if wanted is not None and ((wanted.data > 0) & ~body).any():
        beyond = np.argwhere((wanted.data > 0) & ~body)
        raise InputError(
            f"{wanted.name}: {len(beyond)} voxels of image.region lie outside of image.body, the "
            f"first is {tuple(beyond[0].tolist())}; enlarge the body, or leave it out"
        )
    return body, wanted


def _region(
    image: Image, body: NDArray[np.bool_], wanted: Labels | None, table: Mapping[str, Any]
) -> NDArray[np.bool_]:
    """Pixels that take part: the user's region, and of its margin what lies in the body."""
    region = body
    if wanted is not None:
        region = body & grown_mask(wanted, table["region_margin"])
    if "box" in table:
        region = region & box_mask(image, table["box"])
    return region


def _start_labels(
    table: Mapping[str, Any],
    image: Image,
    region: NDArray[np.bool_],
    muscles: list[Muscle],
    values: NDArray[np.float64],
) -> NDArray[np.int32] | None:
    """Regions to start from, where seeds tell them."""
    if table["start"] != "seeds":
        return None
    everywhere = np.where(region, 0, -1).astype(np.int32)
    known = rule_seeds(everywhere, image, muscles, table["seed_radius"])[1]
    return seeded_regions(values, region, known, table["regions"])


def _fat_doubts(fat: Mapping[str, float], phase: str) -> list[str]:
    """What to say where the wanted phase of the water is fat and is not called so."""
    other = "bright" if phase == "dark" else "dark"
    return [
        f"{name}: {100.0 * mean:.0f} % of its signal is fat; muscle is bright in the water of a "
        f"Dixon sequence: look whether image.phase should be '{other}'"
        for name, mean in fat.items()
        if mean > 0.5 and "fat" not in name.lower()
    ]


def _unrest(result: Regions, limit: int) -> str:
    return (
        f"{result.unrest} of {len(result.iterations)} blocks of slices still changed after "
        f"image.iterations = {limit}; raise it, or image.tolerance"
    )


def _shading(
    image: Image,
    mask: NDArray[np.bool_],
    keys: Mapping[str, Any],
    out: Path,
    progress: ProgressCallback,
) -> tuple[NDArray[np.float64] | None, dict[str, Any]]:
    """Shading told by the body (None: none), and what to say about it; the field is written."""
    path = out / "bias.nii.gz"
    if keys["method"] == "none":
        path.unlink(missing_ok=True)
        return None, {"method": "none"}
    progress(f"bias field by {keys['method']}")
    check_positive(image, mask)
    more: dict[str, Any] = {}
    try:
        if keys["method"] == "auto":
            best = shading(image.data, mask, spacing=image.spacing)
            found = BiasField(best.field, np.array([]), True)
            more = {"start": best.candidates[0].start, "doubt": best.doubt}
        elif keys["method"] == "n4":
            found = n4_bias(image.data, mask, spacing=image.spacing, shrink=keys["shrink"])
        else:
            found = clustered_bias(
                image.data,
                mask,
                evolve_level_sets,
                spacing=image.spacing,
                regions=_EVEN,
                shrink=keys["shrink"],
            )
    except InputError as reason:
        raise InputError(f"{image.name}: {reason}") from None
    write_image(path, replace(image, data=found.field))
    inside = found.field[mask]
    record = {
        "method": keys["method"],
        "range": [float(inside.min()), float(inside.max())],
        "converged": found.converged,
        "energy": found.energy.tolist(),
        **more,
    }
    return found.field, record


def _check_rules(table: Mapping[str, Any], muscles: list[Muscle]) -> None:
    """Refuse rules that contradict each other before anything is computed."""
    split, rims = table["split"], [muscle.name for muscle in muscles if muscle.rim]
    if table["start"] == "seeds" and not muscles:
        raise InputError("image.start = 'seeds' needs [[muscle]] with seeds or a rim")
    if "reference" not in table:
        for key in ("reference_reach", "reference_anatomy"):
            if table.get(key):
                raise InputError(f"image.{key} needs image.reference")
    if "seeds" in table:
        if muscles or "reference" in table:
            other = "[[muscle]]" if muscles else "image.reference"
            raise InputError(f"image.seeds and {other} both say what is where; take one out")
        if split != "walk":
            raise InputError("image.seeds needs image.split = 'walk'")
        return
    if "reference" in table:
        if muscles:
            raise InputError("image.reference and [[muscle]] both group the regions; take one out")
        return
    if rims and split != "walk":
        raise InputError(f"muscle.{rims[0]}.rim needs image.split = 'walk'")
    if muscles and split == "nearest":
        raise InputError("image.split = 'nearest' needs image.reference; seeds go with 'walk'")
    if not muscles and split != "pieces":
        raise InputError(
            f"image.split = '{split}' needs image.reference, image.seeds or [[muscle]] with seeds"
        )


def _reference(
    table: Mapping[str, Any], folder: Path, image: Image, progress: ProgressCallback
) -> tuple[Labels | None, Image | None]:
    """Label map by which regions are grouped, and the image it was drawn in, where named."""
    if "reference" not in table:
        return None, None
    reference = read_reference(folder / table["reference"], progress)
    if not reference.data.any():
        raise InputError(
            f"{reference.name}: the reference is empty, no voxel has a label above zero; give the "
            "label map by which regions are to be grouped"
        )
    if "reference_anatomy" not in table:
        check_same_grid(reference, image)
        return reference, None
    drawn_in = read_image(folder / table["reference_anatomy"])
    check_same_grid(reference, drawn_in)
    return reference, drawn_in


def _lost(drawn: Labels, bent: Labels, image: Image) -> str:
    """A sentence about labels of a reference that bending left no voxel; empty without any."""
    gone = np.setdiff1d(drawn.data[drawn.data > 0], bent.data).tolist()
    if not gone:
        return ""
    names = ", ".join(drawn.label_name(number) for number in gone)
    return f"{drawn.name}: bent onto {image.name} nothing is left of {names}; none will be found"


def _muscles(deck: Mapping[str, Any]) -> list[Muscle]:
    """Rules of the deck."""
    return [Muscle(rule["name"], _points(rule), rule["rim"]) for rule in deck.get("muscle", [])]


def _points(rule: Mapping[str, Any]) -> NDArray[np.float64]:
    """Seeds of a rule, shape `(nseed, 3)` [mm]."""
    if len(rule["seeds"]) % 3:
        raise InputError(
            f"muscle.{rule['name']}.seeds: three coordinates a point, not {len(rule['seeds'])}"
        )
    return np.reshape(np.asarray(rule["seeds"], float), (-1, 3))


def _check_truth(truth: Labels, numbers: list[int]) -> None:
    """Refuse a truth without a voxel of what should be found."""
    there = np.unique(truth.data[truth.data > 0]).tolist()
    if not there or (numbers and not set(numbers) & set(there)):
        raise InputError(
            f"{truth.name}: no voxel has one of image.truth_labels = {list(numbers)}; "
            f"the labels there are: {there}"
        )


def _scores(table: Mapping[str, Any], labels: Labels, truth: Labels) -> dict[str, Any]:
    """Scores of the labels that the truth has as well."""
    there = np.unique(truth.data[truth.data > 0]).tolist()
    by_name = {truth.label_name(number): [number] for number in there}
    pairs: dict[str, tuple[int, list[int]]] = {}
    if set(labels.names.values()) == {table["label"]}:
        pairs[table["label"]] = (1, table["truth_labels"] or there)
    else:
        pairs = {name: (n, by_name[name]) for n, name in labels.names.items() if name in by_name}
    return label_scores(labels.data, truth.data, pairs)


def _summary(
    deck: Mapping[str, Any],
    labels: Labels,
    result: Regions,
    scores: Mapping[str, Any],
    warnings: list[str],
) -> dict[str, Any]:
    """Entries for `summary.json`; volumes in the deck's unit of length, cubed."""
    voxel = float(np.prod(labels.spacing * length_factor(deck["units"]["length"])))
    pixels = {name: int((labels.data == number).sum()) for number, name in labels.names.items()}
    return {
        "title": deck["title"],
        "deck_sha256": deck["sha256"],
        "version": myork.__version__,
        "units": dict(deck["result_units"]),
        "segmentation": {
            "labels": {name: {"pixels": n, "volume": n * voxel} for name, n in pixels.items()},
            "scores": dict(scores),
            "iterations": int(result.iterations.max()),
            "converged": not result.unrest,
            "energy": result.energy.tolist(),
            "warnings": warnings,
        },
    }


def _lines(summary: Mapping[str, Any]) -> list[str]:
    """What to tell at the end."""
    found = summary["segmentation"]
    unit = summary["units"]["volume"]
    lines = [
        f"{name}: {entry['pixels']} pixels, {entry['volume']:.4g} {unit}"
        for name, entry in found["labels"].items()
    ]
    lines += [
        f"{name}: Dice {score['dice']:.3f}, PCC {score['pcc']:.3f} against the truth"
        for name, score in found["scores"].items()
    ]
    return lines
