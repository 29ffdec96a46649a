"""Station two: a label map and fibers to the points of a model, `model.h5`."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import myork
from myork.console import ProgressCallback, silent
from myork.core.deck import load_deck
from myork.errors import FileError, InputError
from myork.imaging.dicom_choice import split_choice
from myork.imaging.geometry import canonical, check_same_grid, length_factor
from myork.imaging.io import read_image, read_labels
from myork.model.cloud import build_cloud
from myork.model.flow import flow_fibers
from myork.model.mesh import read_tracts, tract_fibers, voxelise
from myork.model.slices import extruded, finer_fibers, finer_labels, finer_values, slice_parts
from myork.model_file import write_model
from myork.records import Image, Labels, PointCloud
from myork.summary import renewing, update_summary

__all__ = ["build"]


def build(
    deck: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Build the model of a deck and write it to `model.h5`.

    Parameters
    ----------
    deck : str, Path or mapping
        Deck file, or its tables as data; the tables `build` and `units` are read.
    out : str or Path
        Folder of the results, in which `segment` left its label map and fibers.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    threads : int, optional
        As for all stations; points are made by one thread.
    progress : callable
        Called with a line of text at a time.

    Returns
    -------
    dict
        What was added to `summary.json`.
    """
    values, out = load_deck(deck, overrides, "build"), Path(out)
    with renewing(out, "model"):
        body = _prepared(_inputs(values, Path(values["folder"]), out), values["build"], progress)
        progress(f"points from {', '.join(path.name for path in body.paths)}")
        cloud, warnings = build_cloud(
            body.labels,
            body.fibers,
            values["build"],
            values["units"]["length"],
            "\n".join(f"{path.name} {_check_sum(path)}" for path in body.paths),
            body.activation,
            body.fractions,
        )
        write_model(out / "model.h5", cloud)
        summary = _summary(values, cloud, warnings)
        update_summary(out, summary)
    model = summary["model"]
    progress(
        f"{model['source_points']} source points, {model['collocation_points']} collocation "
        f"points, boundary: {', '.join(f'{n} {s}' for s, n in model['boundary_points'].items())}"
    )
    for text in warnings:
        progress(f"warning: {text}")
    return summary


class _Body(NamedTuple):
    """What points are made of: label map, what lies on its grid, and the files behind it."""

    labels: Labels
    paths: list[Path]
    fibers: Image | None = None
    activation: Image | None = None
    fractions: Image | None = None


def _prepared(body: _Body, table: Mapping[str, Any], progress: ProgressCallback) -> _Body:
    """The body as a prism, in thinner slices and with fibers of a flow, as the deck wants it."""
    labels, _, fibers, activation, fractions = body
    if "extrude" in table:
        length = table["extrude"]
        labels = extruded(labels, length)
        fibers, activation, fractions = (
            one and extruded(one, length) for one in (fibers, activation, fractions)
        )
        progress(f"a prism of {length:g} mm: {labels.data.shape[2]} times the slice")
    if "slice_thickness" in table:
        if fractions is not None:
            raise InputError(
                f"{fractions.name}: build.slice_thickness cuts slices by the shapes of labels, and "
                "parts of voxels have none; leave it out, or image.partial and build.fractions"
            )
        axis, parts = slice_parts(labels.spacing, table["slice_thickness"])
        finer = finer_labels(labels, axis, parts)
        fibers = fibers and finer_fibers(fibers, labels, finer, axis, parts)
        activation = activation and finer_values(activation, labels, finer, axis, parts)
        labels = finer
        size = " x ".join(map(str, labels.data.shape))
        progress(f"slices cut: {size} voxels of {labels.spacing.round(2)}")
    if table["flow"]:
        progress("fibers along a flow from end to end of each label")
        labels = canonical(labels)
        if labels.data.shape[2] == 1:
            raise InputError(
                f"{labels.name}: build.flow runs from the lowest slice to the highest, and there "
                "is one slice only; set build.extrude, or leave build.flow out"
            )
        fibers = flow_fibers(labels)
    return _Body(labels, body.paths, fibers, activation, fractions)


def _check_sum(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder of DICOM images."""
    folder, _ = split_choice(path)
    files = sorted(folder.rglob("*")) if folder.is_dir() else [path]
    found = hashlib.sha256()
    for file in files:
        if file.is_file():
            found.update(file.read_bytes())
    return found.hexdigest()


def _inputs(deck: Mapping[str, Any], folder: Path, out: Path) -> _Body:
    """Labels and what lies on their grid: of a surface and tracts, or of images."""
    table = deck["build"]
    measured = [f"build.{key}" for key in ("fibers", "tracts") if key in table]
    if table["flow"] and measured:
        raise InputError(
            f"build.flow makes fibers where none were measured, but there is {measured[0]}; leave "
            "one of them out"
        )
    body = _of_surface(table, folder) if "surface" in table else _of_images(deck, folder, out)
    if "activation" not in table:
        return body
    path = folder / table["activation"]
    activation = read_image(path)
    check_same_grid(activation, body.labels)
    return body._replace(activation=activation, paths=[*body.paths, path])


def _of_surface(table: Mapping[str, Any], folder: Path) -> _Body:
    """Voxels in a closed surface, and fibers along tracts."""
    unit = 1.0 / length_factor(table["surface_unit"], "build.surface_unit")
    path = folder / table["surface"]
    labels = voxelise(path, unit, table["voxel"], "muscle")
    if "tracts" not in table:
        return _Body(labels, [path])
    tracts = folder / table["tracts"]
    fibers = tract_fibers(read_tracts(tracts, unit), labels, str(tracts))
    return _Body(labels, [path, tracts], fibers)


def _of_images(deck: Mapping[str, Any], folder: Path, out: Path) -> _Body:
    """Files that the deck names, else those that `segment` left in the output folder."""
    table = deck["build"]
    stem, own = ("tissue", "tissue_") if deck["tissue"]["find"] else ("segmentation", "")

    def place(key: str, name: str) -> Path | None:
        if key in table:
            return Path(folder / table[key])
        made = out / f"{own}{name}.nii.gz"
        return made if "labels" not in table and made.is_file() else None

    path = folder / table["labels"] if "labels" in table else out / f"{stem}.nii.gz"
    if "labels" not in table and not path.is_file():
        raise FileError(
            f"{path}: there is no label map; run `myork segment` into the same folder first, or "
            "name one in build.labels"
        )
    body = _Body(read_labels(path), [path])
    fibers = None if table["flow"] else place("fibers", "fibers")
    if fibers is not None:
        vectors = read_image(fibers, values=3)
        check_same_grid(vectors, body.labels)
        body = body._replace(fibers=vectors, paths=[*body.paths, fibers])
    parts = place("fractions", "fractions")
    if parts is not None:
        fractions = read_image(parts, values=None)
        check_same_grid(fractions, body.labels)
        body = body._replace(fractions=fractions, paths=[*body.paths, parts])
    return body


def _summary(deck: Mapping[str, Any], cloud: PointCloud, warnings: list[str]) -> dict[str, Any]:
    """Entries for `summary.json`."""
    volume = {cloud.label_names[label]: volume for label, volume in cloud.label_volumes().items()}
    return {
        "title": deck["title"],
        "deck_sha256": deck["sha256"],
        "version": myork.__version__,
        "units": dict(deck["result_units"]),
        "model": {
            "source_points": len(cloud.source),
            "collocation_points": len(cloud.points),
            "boundary_points": {
                name: int((cloud.boundary_set == number).sum())
                for number, name in enumerate(cloud.set_names)
            },
            "volume": volume,
            "points_without_fiber": int((~cloud.fiber.any(axis=1)).sum()),
            "warnings": warnings,
        },
    }
