"""Points of a model from labels and fibers."""

from collections.abc import Collection, Mapping
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import InputError
from myork.imaging.geometry import canonical, frame, length_factor, to_voxels
from myork.model import points
from myork.model.architecture import long_axis
from myork.model.boundary import Boundary, bone_beside, boundary_sets, surface_offsets
from myork.model.fibers import activation_at_points, fibers_at_points
from myork.model.flow import flow_fibers
from myork.model.shares import LabelParts, checked_parts, label_shares
from myork.records import Image, Labels, PointCloud, Voxels

# A cut plane with fewer points supports the model poorly.
_FEW_AT_END = 6
# An end below this part of the largest section is a tip; other slices have at least the second part
_TIP, _BLUNT = 0.05, 0.2
# Ends of a model along x, y, z
_SIDES = ({"x0", "x1"}, {"y0", "y1"}, {"bottom", "top"})


class Body(NamedTuple):
    """Data from which points are made, on one grid."""

    labels: Labels  #: Label map, in any orientation
    fibers: Image | None = None  #: Fiber vectors in the world frame
    activation: Image | None = None  #: Fraction of its muscle's activation in each voxel
    #: Fraction of each voxel filled by each label above zero, labels ascending, shape
    #: `(ni, nj, nk, nlabel)`
    fractions: Image | None = None


def build_cloud(
    labels: Labels,
    fibers: Image | None,
    table: Mapping[str, Any],
    unit: str,
    source_images: str = "",
    activation: Image | None = None,
    fractions: Image | None = None,
    progress: ProgressCallback = silent,
    held: Collection[str | None] = (None,),
) -> tuple[PointCloud, list[str]]:
    """Make the points of a model from labels and fibers.

    Before that, as the table asks for it, slices are cut and fibers follow a flow.

    - `labels`, `fibers`, `activation`, `fractions`: as in `Body`
    - `table`: table `build` of the deck
    - `unit`: unit of length of the model
    - `source_images`: names and checksums of the files behind the arguments
    - `progress`: called with a line of text at a time
    - `held`: constrained sides, None for any; free tips need no warning
    - returns the points and warnings
    """
    block, stride = table["collocation_stride"], table["source_stride"]
    if any(s % b for s, b in zip(stride, block, strict=True)):
        raise InputError(
            f"build.source_stride = {list(stride)} must be a multiple of build.collocation_stride "
            f"= {list(block)} in each direction"
        )
    if table["flow"]:
        labels, fibers = _along_flow(labels, progress, held)
    whole = canonical(labels)
    chosen = points.select(whole, table["ids"], table.get("slices"), table["bone"])
    part = points.trimmed(chosen)
    if part.data.shape[2] == 1:
        block, stride = [*block[:2], 1], [*stride[:2], 1]
    merged = points.coarsen(part, block, table["merge"])
    coarse, islands = points.connected_body(merged)
    body = coarse.data > 0
    left_out = (merged.data > 0) & ~body
    parts = None
    if fractions is not None:
        whole_parts = checked_parts(canonical(fractions), whole)
        parts = LabelParts(whole_parts, np.array(list(labels.present)))
    shares, numbers = label_shares(part, coarse, block, left_out, parts)
    filled = shares.sum(axis=1)
    volumes = dict(zip(numbers.tolist(), shares.sum(axis=0) * coarse.spacing.prod(), strict=True))
    # islands change the volume, and say so
    wanted = None if parts is None else parts.volumes(part)
    warnings = islands or points.changed_volumes(part, volumes, wanted)
    voxels = np.argwhere(body)
    step = [s // b for s, b in zip(stride, block, strict=True)]
    source = points.source_voxels(body, step)
    boundary = boundary_sets(coarse, bone_beside(chosen, coarse, block))
    label = coarse.data[body]
    place = points.positions(coarse, voxels)
    origin = points.positions(coarse, np.zeros(3, np.int32))
    wall = np.flatnonzero(np.isin(np.array(boundary.names)[boundary.set], ("surface", "bone")))
    # A point between skin and bone belongs to both sets, with one normal.
    point, first = np.unique(boundary.point[wall], return_index=True)
    place[point] += surface_offsets(
        body, coarse.spacing, voxels[point], boundary.normal[wall[first]]
    )
    if body.shape[2] > 1:  # move centres of the end slices onto the ends; a single slice is plane
        place[voxels[:, 2] == 0, 2] -= 0.5 * coarse.spacing[2]
        place[voxels[:, 2] == body.shape[2] - 1, 2] += 0.5 * coarse.spacing[2]

    fiber = np.zeros((len(voxels), 3))
    at = to_voxels(whole.affine, coarse.world(voxels))
    if fibers is not None:
        fiber = fibers_at_points(canonical(fibers), whole, at, label, block)

    warnings += [*_tips(chosen, held), *_doubts(coarse, boundary)]
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


def _along_flow(
    labels: Labels, progress: ProgressCallback, held: Collection[str | None]
) -> tuple[Labels, Image]:
    """Labels with their axes in the order of the world, and fibers along a flow through them."""
    labels = canonical(labels)
    axis = _flow_axis(labels, held)
    progress(f"fibers along a flow from end to end of each label, along {'xyz'[axis]}")
    if labels.data.shape[axis] == 1:
        raise InputError(
            f"{labels.name}: build.flow runs from the first slice to the last along "
            f"{'xyz'[axis]}, and there is one slice only; set build.extrude, or leave "
            "build.flow out"
        )
    return labels, flow_fibers(labels, axis)


def _flow_axis(labels: Labels, held: Collection[str | None]) -> int:
    """Axis from end to end: between constrained sides, else the long axis of all labels, else z."""
    for axis, sides in ((2, _SIDES[2]), (0, _SIDES[0]), (1, _SIDES[1])):
        if sides <= set(held):
            return axis
    long, axis = long_axis(labels, labels.data > 0)
    return 2 if long is None or _SIDES[2] & set(held) else axis


def _tips(chosen: Labels, held: Collection[str | None]) -> list[str]:
    """Warnings about constrained ends much smaller than the largest section, with remedies."""
    body = chosen.data > 0
    area = body.sum(axis=(0, 1))
    filled = np.flatnonzero(area)
    first, last = int(filled[0]), int(filled[-1])
    low, high = points.blunt_ends(body, _BLUNT)
    ends = [
        f"{name} end has {area[k]} voxels in slice {k}"
        for name, side, k in (("lower", "bottom", first), ("upper", "top", last))
        if {None, side} & set(held) and len(filled) > 2 and area[k] < _TIP * area.max()
    ]
    if not ends:
        return []
    return [
        f"the muscle ends in a tip: its {' and its '.join(ends)}, of {area.max()} in the largest: "
        "what is fixed there carries the whole force, with stresses that no points resolve; use "
        f"build.slices = [{low}, {high}], whose ends have a fifth of it, or fix it along its "
        "surface (springs of an aponeurosis, the set bone)"
    ]


def _doubts(coarse: Labels, boundary: Boundary) -> list[str]:
    """Warnings about features that may impair the solution."""
    body = coarse.data > 0
    warnings = []
    if body.shape[2] == 1:
        warnings.append("the labels lie in one slice: a plane model, with the set surface only")
    for number, name in enumerate(boundary.names):
        count = int((boundary.set == number).sum())
        if name != "surface" and count < _FEW_AT_END:
            warnings.append(
                f"set {name} has {count} points only; lower build.collocation_stride, or cut the "
                "muscle where it is thicker (build.slices)"
            )
    if not np.array_equal(frame(coarse.affine), np.eye(3)):
        warnings.append(
            "the image is rotated against the world axes: the model's x, y, z are the voxel axes "
            "nearest to right, anterior, superior; fibers of images were turned with them, fibers "
            "in [[material]] and all loads and points of the deck are in x, y, z of the model"
        )
    return warnings
