"""Station two: from a label map and fibers to the points of a model, `model.h5`.

It also writes `muscles.csv`: sizes, fat, diffusion and fibers of each muscle of the map.
"""

import hashlib
from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from myork.console import ProgressCallback
from myork.errors import FileError, InputError
from myork.files import write_csv
from myork.imaging.dicom import split_choice
from myork.imaging.diffusion import tensor_maps
from myork.imaging.geometry import length_factor
from myork.imaging.io import read_image, renew_images
from myork.model.architecture import COLUMNS, Maps, cut_sides, muscle_numbers
from myork.model.cloud import Body, build_cloud
from myork.model.fibers import fibers_of_labels
from myork.model.mesh import read_tracts, tract_fibers, voxelise
from myork.model.orientation import check_orientation
from myork.model.points import extruded
from myork.model_file import write_model
from myork.records import Image, Labels, PointCloud
from myork.segmentation.images import Images
from myork.stations.data import DeckFiles, OneGrid
from myork.stations.station import station

# So many voxels without a label inside the labels are no cavity worth a warning
_FEW = 8


@station("build", "model")
def build(deck: Mapping[str, Any], out: Path, progress: ProgressCallback) -> dict[str, Any]:
    """Build the model of a deck and write it to `model.h5`.

    The tables `build` and `units` are read. If the deck names no labels, the label map and fibers
    that `segment` wrote to the folder are used; for labels without fibers, the tensors of `image`.
    """
    table = deck["build"]
    measured = [f"build.{key}" for key in ("fibers", "tracts") if key in table]
    if table["flow"] and measured:
        raise InputError(
            f"build.flow makes fibers where none were measured, but there is {measured[0]}; leave "
            "one of them out"
        )
    own = {"labels", "surface"} & set(table)
    files = DeckFiles(deck, "build", OneGrid(progress), {} if own else _made(deck, out))
    body = _of_surface(files) if "surface" in table else _of_images(files, deck.get("material", []))
    if body.fibers is None and "labels" in table and not table["flow"]:
        body = body._replace(fibers=_of_diffusion(deck, body.labels, files.grid, out, progress))
    body = body._replace(activation=files.image("activation", body.labels))
    progress(f"points from {', '.join(path.name for path in files.read)}")
    sums = "\n".join(f"{path.name} {check_sum(path)}" for path in files.read)
    unit = deck["units"]["length"]
    maps, along = _maps(body, files, out), None
    if "extrude" in table:
        length, along = table["extrude"], 2
        body = Body(
            extruded(body.labels, length), *(one and extruded(one, length) for one in body[1:])
        )
        maps = Maps(*(one and extruded(one, length) for one in maps))
        progress(f"a prism of {length:g} mm: {body.labels.data.shape[2]} times the slice")
    cloud, warnings = build_cloud(*body[:2], table, unit, sums, *body[2:], progress, _held(deck))
    low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
    millimetres = " x ".join(f"{edge:.4g}" for edge in (high - low) / length_factor(unit))
    corners = (", ".join(f"{x:.4g}" for x in corner) for corner in (low, high))
    if cloud.activation is not None:
        mean = np.average(cloud.activation, weights=cloud.volume)
        progress(f"build.activation: {mean:.3g} on average over the model")
    progress("body of {} mm, from ({}) to ({}) {}".format(millimetres, *corners, unit))
    write_model(out / "model.h5", cloud)
    left_out = {*table["bone"]}
    if table["ids"]:
        left_out |= {*np.unique(body.labels.data).tolist()} - {*table["ids"]}
    materials = deck.get("material", [])
    warnings = [
        *_cut(body.labels, materials, along),
        *_cavities(body.labels, unit),
        *_without_material(body.labels, cloud, materials),
        *warnings,
    ]
    others = {
        body.labels.label_name(own["label"])
        for own in materials
        if "label" in own and own["model"] != "muscle"
    }
    model = _record(cloud, [*files.grid.doubts, *warnings])
    model["muscles"] = _muscles(body.labels, maps, left_out, along, others, unit, progress)
    heads = dict.fromkeys(head for row in model["muscles"] for head in row)
    write_csv(out / "muscles.csv", heads, [row.values() for row in model["muscles"]])
    progress(
        f"{model['source_points']} source points, {model['collocation_points']} collocation "
        f"points, boundary: {', '.join(f'{n} {s}' for s, n in model['boundary_points'].items())}"
    )
    for text in warnings:
        progress(f"warning: {text}")
    return {"model": model, "grid": files.grid}


def _held(deck: Mapping[str, Any]) -> set[str | None]:
    """Sides with boundary conditions, None for any side."""
    sides = {own["name"]: own.get("side") for own in deck.get("set", [])}
    return {sides.get(own["set"], own["set"]) for own in deck.get("boundary", [])} or {None}


def check_sum(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder of DICOM images."""
    folder, _ = split_choice(path)
    files = sorted(folder.rglob("*")) if folder.is_dir() else [path]
    found = hashlib.sha256()
    for file in files:
        if file.is_file():
            found.update(file.read_bytes())
    return found.hexdigest()


def _made(deck: Mapping[str, Any], out: Path) -> dict[str, Path]:
    """Files that `segment` wrote to the output folder, by the keys that they replace."""
    names = {"labels": "segmentation", "fibers": "fibers", "fractions": "fractions"}
    if deck["tissue"]["find"]:
        names = {"labels": "tissue", "fibers": "tissue_fibers", "fractions": "tissue_fractions"}
    paths = {key: out / f"{name}.nii.gz" for key, name in names.items()}
    if not paths["labels"].is_file():
        raise FileError(
            f"{paths['labels']}: there is no label map; run `myork segment` into the same folder "
            "first, or name one in build.labels"
        )
    return {key: path for key, path in paths.items() if path.is_file()}


def _of_surface(files: DeckFiles) -> Body:
    """Voxels inside a closed surface, and fibers along tracts."""
    table = files.table
    unit = 1.0 / length_factor(table["surface_unit"], "build.surface_unit")
    surface, tracts = files.path("surface"), files.path("tracts")
    assert surface is not None
    labels = voxelise(surface, unit, table["voxel"], "muscle")
    if tracts is None:
        return Body(labels)
    return Body(labels, tract_fibers(read_tracts(tracts, unit), labels, str(tracts)))


def _of_diffusion(
    deck: Mapping[str, Any], labels: Labels, grid: OneGrid, out: Path, progress: ProgressCallback
) -> Image | None:
    """Fibers of the labels from the tensors of `image.dwi` or `image.tensor`; None without them."""
    images = DeckFiles(deck, "image", grid)
    found = images.tensors()
    if found is None:
        return None
    progress(f"{found.tensor.name}: fibers from the diffusion tensors")
    way = fibers_of_labels(found.tensor, labels, images.table.get("fiber_smoothing"))
    if way.axes.remark:
        progress(way.axes.remark)
    for text in way.doubts():
        grid.doubt(f"{found.tensor.name}: {text}")
    renew_images(out, fibers=way.fibers, **tensor_maps(found.tensor))
    return way.fibers


def _of_images(files: DeckFiles, materials: Sequence[Mapping[str, Any]]) -> Body:
    """Label map, fibers and fractions of labels; a label without a name takes its material's."""
    labels = files.labels("labels")
    assert labels is not None
    names = {own["label"]: own["name"] for own in materials if "label" in own}
    for label, name in names.items():
        if label not in labels.present:
            files.grid.doubt(
                f"material.{name}.label: no voxel of {labels.name} has label {label}; the labels "
                f"there are {', '.join(map(str, labels.present))}"
            )
    for own in materials:
        name, drawn = own["name"], labels.names.get(own.get("label", 0), own["name"])
        one, other = (text.casefold().replace("_", " ") for text in (name, drawn))
        # a muscle with a name of its own may be called muscle in the map
        if one not in other and other not in one and drawn != own["model"]:
            files.grid.doubt(
                f"{labels.name}: label {own['label']} is {drawn} in the map, but {name} in "
                "[[material]]: if they are not the same tissue, change material.label"
            )
    labels = replace(labels, names=names | labels.names)
    fibers = None if files.table["flow"] else files.image("fibers", labels, 3)
    if fibers is not None and "fibers" in files.table:
        found = check_orientation(fibers, labels)
        if found.doubt:
            files.grid.doubt(
                f"{fibers.name}: fibers cross the walls of muscles, mean square cosine with their "
                f"normals {found.evidence[0].crossing:.2f} (.33 at random): its volumes must be "
                "the components to the right, anterior and superior"
            )
    return Body(labels, fibers, fractions=files.image("fractions", labels, None))


def _cut(labels: Labels, materials: Sequence[Mapping[str, Any]], along: int | None) -> list[str]:
    """Warnings about muscles that reach beyond the sides of the image."""
    muscles = [own for own in materials if own["model"] == "muscle"]
    numbers = {own["label"] for own in muscles if "label" in own} or {*labels.present}
    sides = {
        name: cut_sides(labels, n, along) for n, name in labels.present.items() if n in numbers
    }
    return [
        f"{name}: the {' and '.join(own)} side of {labels.name} cuts the muscle: the model and its "
        "force are those of the part in the image; use an image that contains the whole section"
        for name, own in sides.items()
        if muscles and own
    ]


def _without_material(
    labels: Labels, cloud: PointCloud, materials: Sequence[Mapping[str, Any]]
) -> list[str]:
    """Warnings about labels of the model that a solve will refuse."""
    if not all("label" in own for own in materials):
        return []  # one material for all labels
    known = {own["label"] for own in materials}
    return [
        f"{labels.name}: label {label} ({name}) has no [[material]], so that `myork solve` refuses "
        f"the model: add one with label = {label}, or leave it out of build.ids"
        for label, name in cloud.label_names.items()
        if known and label not in known
    ]


def _cavities(labels: Labels, unit: str) -> list[str]:
    """Warning about voxels without a label that labels enclose on all sides."""
    inside = ndimage.binary_fill_holes(labels.data > 0) & (labels.data <= 0)
    count = int(inside.sum())
    if count <= _FEW:
        return []
    volume = count * float((labels.spacing * length_factor(unit)).prod())
    return [
        f"{labels.name}: {count} voxels without a label ({volume:.3g} {unit}^3) are enclosed by "
        "labels: they are a cavity of the model; give them a label if they are tissue"
    ]


def _maps(body: Body, files: DeckFiles, out: Path) -> Maps:
    """Measured fibers, and maps that `segment` wrote to the folder."""
    found: dict[str, Image] = {}
    for name in ("fat_fraction", "anatomy", "fat", "fa", "md"):
        path = out / f"{name}.nii.gz"
        if path.is_file():
            with suppress(InputError):  # maps of another body
                found[name] = files.grid.of(read_image(path), body.labels)
    fraction, signal = found.get("fat_fraction"), None
    if fraction is not None and "anatomy" in found:
        signal = Images(found["anatomy"], found.get("fat")).whole
    return Maps(body.fibers, fraction, signal, found.get("fa"), found.get("md"))


def _muscles(
    labels: Labels,
    maps: Maps,
    left_out: Collection[int],
    along: int | None,
    others: Collection[str],
    unit: str,
    progress: ProgressCallback,
) -> list[dict[str, Any]]:
    """Rows of `muscles.csv`: name and numbers with their units, None where missing.

    - `others`: names of labels of which no fibers are expected
    """
    factor, rows = length_factor(unit), []
    for own in muscle_numbers(labels, maps, left_out, along):
        if own.cut and maps.fibers is not None and own.muscle not in others:
            what = "fiber length and PCSA are" if own.fiber_length is None else "its PCSA is"
            progress(f"{own.muscle}: the image cuts it, so that {what} left out")
        row: dict[str, Any] = {"muscle": own.muscle}
        for name, (head, fixed, power) in COLUMNS.items():
            value = getattr(own, name)
            length = unit if power == 1 else f"{unit}^{power}"
            known = None if value is None else float(f"{value * factor**power:.5g}")
            row[f"{head} [{fixed or length}]"] = known
        rows.append(row)
    return rows


def _record(cloud: PointCloud, warnings: list[str]) -> dict[str, Any]:
    """Entry of the summary."""
    volume = {cloud.label_names[label]: volume for label, volume in cloud.label_volumes().items()}
    return {
        "source_points": len(cloud.source),
        "collocation_points": len(cloud.points),
        "boundary_points": {
            name: int((cloud.boundary_set == number).sum())
            for number, name in enumerate(cloud.set_names)
        },
        "volume": volume,
        "points_without_fiber": int((~cloud.fiber.any(axis=1)).sum()),
        "warnings": warnings,
    }
