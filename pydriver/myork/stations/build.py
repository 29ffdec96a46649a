"""Station two: a label map and fibers to the points of a model, `model.h5`."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import myork
from myork.console import ProgressCallback, silent
from myork.core.deck import read_deck
from myork.errors import FileError, InputError
from myork.imaging.dicom_choice import split_choice
from myork.imaging.geometry import canonical, check_same_grid, frame, length_factor, to_voxels
from myork.imaging.io import read_image, read_labels
from myork.model import points
from myork.model.boundary import Boundary, bone_beside, boundary_sets
from myork.model.fibers import activation_at_points, fibers_at_points
from myork.model.flow import flow_fibers
from myork.model.mesh import read_tracts, tract_fibers, voxelise
from myork.model.shares import LabelParts, label_shares
from myork.model.slices import extruded, finer_fibers, finer_labels, finer_values, slice_parts
from myork.model.surface import end_offsets, surface_offsets
from myork.model_file import write_model
from myork.records import Image, Labels, PointCloud, Voxels
from myork.stations.partial import read_parts
from myork.summary import renewing, update_summary

__all__ = ["build", "build_cloud"]

# A cut plane with fewer points can hold the model only badly.
_FEW_AT_END = 6
# The tip of a bent bracket moves 2 % too little with 4 source points across, 1 % with 8.
_FEW_ACROSS = 4


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
    values, out = read_deck(deck, overrides, "build"), Path(out)
    table = values["build"]
    with renewing(out, "model"):
        labels, fibers, paths = _inputs(values, table, Path(values["folder"]), out)
        activation = None
        if "activation" in table:
            paths.append(Path(values["folder"]) / table["activation"])
            activation = read_image(paths[-1])
            check_same_grid(activation, labels)
        parts = _parts_file(values, table, out)
        fractions = None
        if parts is not None:
            paths.append(parts)
            fractions = read_parts(parts, labels)
        if "extrude" in table:
            length = table["extrude"]
            fractions = None if fractions is None else extruded(fractions, length)
            labels = extruded(labels, length)
            fibers = None if fibers is None else extruded(fibers, length)
            activation = None if activation is None else extruded(activation, length)
            progress(f"a prism of {length:g} mm: {labels.data.shape[2]} times the slice")
        if "slice_thickness" in table:
            if fractions is not None:
                raise InputError(
                    f"{fractions.name}: build.slice_thickness cuts slices by the shapes of labels, "
                    "and parts of voxels have none; leave it out, or image.partial and "
                    "build.fractions"
                )
            labels, fibers, activation = _thinner(
                labels, fibers, activation, table["slice_thickness"]
            )
            shape, size = labels.data.shape, labels.spacing
            progress(f"slices cut: {shape[0]} x {shape[1]} x {shape[2]} voxels of {size.round(2)}")
        if table["flow"]:
            progress("fibers along a flow from end to end of each label")
            labels = canonical(labels)
            if labels.data.shape[2] == 1:
                raise InputError(
                    f"{labels.name}: build.flow runs from the lowest slice to the highest, and "
                    "there is one slice only; set build.extrude, or leave build.flow out"
                )
            fibers = flow_fibers(labels)
        progress(f"points from {', '.join(path.name for path in paths)}")
        source_images = "\n".join(f"{path.name} {_check_sum(path)}" for path in paths)
        cloud, warnings = build_cloud(
            labels, fibers, table, values["units"]["length"], source_images, activation, fractions
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


def _check_sum(path: Path) -> str:
    """SHA-256 of a file, or of all files of a folder of DICOM images."""
    folder, _ = split_choice(path)
    files = sorted(folder.rglob("*")) if folder.is_dir() else [path]
    found = hashlib.sha256()
    for file in files:
        if file.is_file():
            found.update(file.read_bytes())
    return found.hexdigest()


def _inputs(
    deck: Mapping[str, Any], table: Mapping[str, Any], folder: Path, out: Path
) -> tuple[Labels, Image | None, list[Path]]:
    """Labels, fibers and the files they come from: a surface and tracts, or images."""
    measured = [f"build.{key}" for key in ("fibers", "tracts") if key in table]
    if table["flow"] and measured:
        raise InputError(
            f"build.flow makes fibers where none were measured, but there is {measured[0]}; leave "
            "one of them out"
        )
    if "surface" in table:
        unit = 1.0 / length_factor(table["surface_unit"], "build.surface_unit")
        paths = [folder / table["surface"]]
        labels = voxelise(paths[0], unit, table["voxel"], table["surface_label"])
        if "tracts" not in table:
            return labels, None, paths
        paths.append(folder / table["tracts"])
        return labels, tract_fibers(read_tracts(paths[1], unit), labels, str(paths[1])), paths
    if "tracts" in table:
        raise InputError("build.tracts needs build.surface; for images give build.fibers")
    stem = "tissue" if deck["tissue"]["find"] else "segmentation"
    paths = [folder / table["labels"] if "labels" in table else out / f"{stem}.nii.gz"]
    if "labels" not in table and not paths[0].is_file():
        raise FileError(
            f"{paths[0]}: there is no label map; run `myork segment` into the same folder first, "
            "or name one in build.labels"
        )
    labels = read_labels(paths[0])
    own = out / ("tissue_fibers.nii.gz" if stem == "tissue" else "fibers.nii.gz")
    if table["flow"] or ("fibers" not in table and ("labels" in table or not own.is_file())):
        return labels, None, paths
    paths.append(folder / table["fibers"] if "fibers" in table else own)
    fibers = read_image(paths[1], values=3)
    check_same_grid(fibers, labels)
    return labels, fibers, paths


def _parts_file(deck: Mapping[str, Any], table: Mapping[str, Any], out: Path) -> Path | None:
    """File of the parts that labels have in each voxel; None without them."""
    if "fractions" in table:
        if "surface" in table:
            raise InputError("build.fractions are of a label map; take build.surface out")
        return Path(deck["folder"]) / table["fractions"]
    own = out / ("tissue_fractions.nii.gz" if deck["tissue"]["find"] else "fractions.nii.gz")
    made_here = "labels" not in table and "surface" not in table
    return own if made_here and own.is_file() else None


def _thinner(
    labels: Labels, fibers: Image | None, activation: Image | None, thickness: float
) -> tuple[Labels, Image | None, Image | None]:
    """All images on slices cut to a thickness [mm]."""
    axis, parts = slice_parts(labels.spacing, thickness)
    finer = finer_labels(labels, axis, parts)
    if fibers is not None:
        fibers = finer_fibers(fibers, labels, finer, axis, parts)
    if activation is not None:
        activation = finer_values(activation, labels, finer, axis, parts)
    return finer, fibers, activation


def build_cloud(
    labels: Labels,
    fibers: Image | None,
    table: Mapping[str, Any],
    unit: str,
    source_images: str = "",
    activation: Image | None = None,
    fractions: Image | None = None,
) -> tuple[PointCloud, list[str]]:
    """Make the points of a model from labels and fibers.

    Parameters
    ----------
    labels : Labels
        Label map, in any orientation.
    fibers : Image or None
        Fiber vectors in the world frame on the same grid.
    table : mapping
        Table `build` of the deck.
    unit : str
        Unit of length of the model.
    source_images : str
        Names and check sums of the files behind the arguments.
    activation : Image, optional
        Part of its muscle's activation that each voxel has, on the same grid.
    fractions : Image, optional
        Part of each voxel that each label above zero fills, labels ascending, on the same grid,
        shape `(ni, nj, nk, nlabel)`.

    Returns
    -------
    tuple
        The points and warnings.
    """
    block, stride = table["collocation_stride"], table["source_stride"]
    if any(s % b for s, b in zip(stride, block, strict=True)):
        raise InputError(
            f"build.source_stride = {list(stride)} must be a multiple of build.collocation_stride "
            f"= {list(block)} in each direction"
        )
    whole = canonical(labels)
    chosen = points.select(whole, table["ids"], table.get("slices"), table["bone"])
    part = points.trimmed(chosen)
    if part.data.shape[2] == 1:
        block, stride = [*block[:2], 1], [*stride[:2], 1]
    merged = points.coarsen(part, block, table["merge"])
    coarse, islands = points.connected_body(merged, table["islands"])
    body = coarse.data > 0
    left_out = (merged.data > 0) & ~body
    parts = None
    if fractions is not None:
        parts = LabelParts(canonical(fractions), np.unique(labels.data[labels.data > 0]))
    shares, numbers = label_shares(part, coarse, block, left_out, parts)
    filled = shares.sum(axis=1)
    volumes = dict(zip(numbers.tolist(), shares.sum(axis=0) * coarse.spacing.prod(), strict=True))
    warnings = points.changed_volumes(part, volumes, None if parts is None else parts.volumes(part))
    warnings += islands
    voxels = np.argwhere(body)
    step = [s // b for s, b in zip(stride, block, strict=True)]
    source = points.source_voxels(body, step)
    boundary = boundary_sets(coarse, table["normals"], bone_beside(chosen, coarse, block))
    label = coarse.data[body]
    place = points.positions(coarse, voxels)
    origin = points.positions(coarse, np.zeros(3, np.int32))
    wall = np.flatnonzero(np.isin(np.array(boundary.names)[boundary.set], ("surface", "bone")))
    # A point between skin and bone stands in both sets, with one normal.
    point, first = np.unique(boundary.point[wall], return_index=True)
    place[point] += surface_offsets(
        body, coarse.spacing, voxels[point], boundary.normal[wall[first]]
    )
    place += end_offsets(body, coarse.spacing, voxels)

    fiber = np.zeros((len(voxels), 3))
    world = voxels @ coarse.affine[:3, :3].T + coarse.affine[:3, 3]
    at = to_voxels(whole.affine, world)
    if fibers is not None:
        fiber = fibers_at_points(canonical(fibers), whole, at, label, block)

    warnings += _doubts(coarse, boundary, step)
    shares, numbers = shares[:, shares.any(axis=0)], numbers[shares.any(axis=0)]
    fraction = shares / filled[:, np.newaxis]
    factor = length_factor(unit)
    size = coarse.spacing * factor
    cloud = PointCloud(
        source=points.positions(coarse, source) * factor,
        spacing=size * step,
        points=place * factor,
        label=label,
        fiber=fiber,
        volume=filled * size.prod(),
        boundary_point=boundary.point.astype(np.int32),
        boundary_set=boundary.set.astype(np.int32),
        normal=boundary.normal,
        area=boundary.area * factor**2,
        set_names=boundary.names,
        label_names={int(i): coarse.label_name(int(i)) for i in numbers},
        length_unit=unit,
        source_images=source_images,
        voxels=Voxels(voxels.astype(np.int32), size, origin * factor),
        fraction=None if (fraction.max(axis=1) == 1.0).all() else fraction,
        activation=None
        if activation is None
        else activation_at_points(canonical(activation), whole, at, label, block),
    )
    return cloud, warnings


def _doubts(coarse: Labels, boundary: Boundary, step: Sequence[int]) -> list[str]:
    """Sentences about what may trouble the solution."""
    body = coarse.data > 0
    warnings = []
    if body.shape[2] == 1:
        warnings.append("the labels lie in one slice: a plane model, with the set surface only")
    for number, name in enumerate(boundary.names):
        count = int((boundary.set == number).sum())
        if name != "surface" and count < _FEW_AT_END:
            warnings.append(
                f"set {name} has {count} points only; cut the muscle where it is thicker "
                "(build.slices) or lower build.collocation_stride"
            )
    warnings += _slender(coarse, step)
    thin = points.thin_voxels(body)
    if len(thin):
        where = coarse.affine[:3, :3] @ thin[0] + coarse.affine[:3, 3]
        warnings.append(
            f"{len(thin)} of {int(body.sum())} points lie in sheets one point thick, the first "
            f"around ({', '.join(f'{c:.1f}' for c in where)}) mm; their normals and derivatives "
            "are poor (lower build.collocation_stride)"
        )
    if not np.array_equal(frame(coarse.affine), np.eye(3)):
        warnings.append(
            "the image is rotated against the world axes: the model's x, y, z are the voxel axes "
            "nearest to right, anterior, superior; fibers were turned with them"
        )
    return warnings


def _slender(coarse: Labels, step: Sequence[int]) -> list[str]:
    """Sentences about the body and tissues with few source points across."""
    body = coarse.data > 0
    numbers = np.unique(coarse.data[body]).tolist()
    parts = {"the body": body}
    if len(numbers) > 1:
        parts |= {coarse.label_name(number): coarse.data == number for number in numbers}
    across = {name: points.points_across(part, step) for name, part in parts.items()}
    return [
        f"{name} has {count:.2g} source points across its thickness; fewer than {_FEW_ACROSS} "
        "make it too stiff where it bends (lower build.source_stride, or give a finer label map)"
        for name, count in across.items()
        if count < _FEW_ACROSS
    ]


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
