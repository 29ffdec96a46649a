"""Bodies from label maps, and the same bodies as warped boxes for finite elements.

A label map is sampled at half the distance of the source points, the default of `build`. Curved
bodies are not aligned with the lattice, so that no voxel count is accurate by chance.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.truths.deck_parts import deck, force, held, probe
from myork.bench.materials import MUSCLE, RUBBER
from myork.bench.phantoms import strided_cloud
from myork.records import Labels, PointCloud
from myork.types import F64


class Body(NamedTuple):
    """A body of voxels."""

    name: str  #: Name in tables
    size: tuple[float, float, float]  #: Edges of the box that is warped into it [cm]
    tables: Mapping[str, Any]  #: Deck without points, with sets of a model
    #: Label at places of shape `(..., 3)` [cm]; zero is background
    label: Callable[[F64], NDArray[Any]]
    sizes: tuple[float, ...]  #: Distances of the source points, descending [cm]
    #: Finite elements along each edge of the box, ascending; each probe is a corner
    elements: tuple[tuple[int, int, int], ...]
    #: Map from positions in the box to the body, shape `(n, 3)` [cm]
    warp: Callable[[F64], F64] | None = None
    #: Label of a position in the box; by default one everywhere
    part: Callable[[F64], int] | None = None


def body_cloud(body: Body, voxel: float) -> PointCloud:
    """Points of a body, with source points at every second voxel of its label map.

    - `voxel`: distance of the source points, two edges of a voxel [cm]
    """
    fine = 0.5 * voxel
    # two layers of background around it; curved bodies shifted against the lattice
    shift = np.array([0.3, 0.17, 0.0]) * voxel if body.part is None else np.zeros(3)
    low = np.array([-2, -2, 0])
    count = np.rint(np.array(body.size) / fine).astype(int) - 2 * low
    axes = [
        (np.arange(n) + first + 0.5) * fine - off
        for n, first, off in zip(count, low, shift, strict=True)
    ]
    filled = body.label(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1))
    affine = np.diag([10 * fine] * 3 + [1.0])
    affine[:3, 3] = [10 * axis[0] for axis in axes]
    labels = Labels(filled.astype(np.int32), affine)
    return strided_cloud(labels, None)


def voxel_by_voxel(body: Body, voxel: float, elements: Sequence[tuple[int, int, int]]) -> Body:
    """A body with the stairs of its label map; of its probes, only the forces.

    - `voxel`: distance of the source points, as in `body_cloud` [cm]
    - `elements`: along each edge, ascending; each contains voxels of one tissue only
    """
    fine = 0.5 * voxel

    def part(x: F64) -> int:
        return int(body.label((np.floor(x / fine) + 0.5) * fine))

    forces = [entry for entry in body.tables["probe"] if entry["quantity"].startswith("force")]
    return body._replace(
        name=f"{body.name}, voxel by voxel", tables={**body.tables, "probe": forces},
        sizes=(voxel,), elements=tuple(elements), warp=None, part=part,
    )  # fmt: skip


def box_tables(body: Body) -> dict[str, Any]:
    """Deck of the box that finite elements warp into the body."""
    faces = {"bottom": "z0", "top": "z1"}
    deck = {
        **body.tables,
        "scene": {"dimension": 3, "method": "rkpm-gauss"},
        "geometry": {
            "kind": "box",
            "size": list(body.size),
            "source": [5, 5, 5],
            "collocation": [9, 9, 9],
        },
    }
    for table in ("boundary", "probe"):
        deck[table] = [
            {**entry, "set": faces.get(entry["set"], entry["set"])}
            if "set" in entry
            else dict(entry)
            for entry in body.tables[table]
        ]
    return deck


_LENGTH = 4.0


def _round(radius: Callable[[F64], F64]) -> dict[str, Any]:
    """Label and warp of a body of revolution about the line x = y = 1."""

    def label(x: F64) -> NDArray[Any]:
        return (x[..., 0] - 1) ** 2 + (x[..., 1] - 1) ** 2 < radius(x[..., 2]) ** 2

    def warp(x: F64) -> F64:
        a, b, r = x[:, 0] - 1, x[:, 1] - 1, radius(x[:, 2])
        across = (1 + r * a * np.sqrt(1 - b * b / 2), 1 + r * b * np.sqrt(1 - a * a / 2))
        return np.column_stack([*across, x[:, 2]])

    return {"label": label, "warp": warp, "size": (2.0, 2.0, _LENGTH)}


def _bent(x: F64) -> F64:
    """Layers normal to x, bent along z between the faces of the box."""
    move = 0.15 * np.sin(np.pi * x[..., 2] / _LENGTH) * x[..., 0] * (2 - x[..., 0])
    return np.stack([x[..., 0] + move, x[..., 1], x[..., 2]], axis=-1)


def _layer(x: F64) -> NDArray[Any]:
    """Muscle, fat, tendon: labels between the bent layers."""
    edges = [
        _bent(np.stack([np.full(x.shape[:-1], at), x[..., 1], x[..., 2]], -1)) for at in (1, 1.5)
    ]
    inside = np.all((x > 0) & (x < [2.0, 1.0, _LENGTH]), axis=-1)
    return inside * (1 + sum((x[..., 0] > edge[..., 0]).astype(int) for edge in edges))


def _arms(x: F64) -> NDArray[Any]:
    inside = np.all((x > 0) & (x < [3.0, 1.0, 3.0]), axis=-1)
    return inside & ((x[..., 0] < 1) | (x[..., 2] > 2))


def _body(
    name: str,
    material: Sequence[Mapping[str, Any]],
    boundary: Sequence[Mapping[str, Any]],
    probes: Sequence[Mapping[str, Any]],
    activation: float = 0.0,
    **rest: Any,
) -> Body:
    """A body of materials whose labels count from 1."""
    labelled = [{**table, "label": label} for label, table in enumerate(material, 1)]
    tables = deck(name, {"kind": "model"}, labelled, boundary, probes, activation)
    return Body(name, tables=tables, sizes=(0.25, 0.125), **rest)


_RUBBER = {**RUBBER, "K": 1e3}
_MUSCLE = {**MUSCLE, "fiber": [0, 0, 1]}
_FAT = {"name": "fat", "model": "neo-hookean", "mu": 1.0, "K": 100.0}

BODIES = (
    _body(
        "cylinder of voxels",  # sheared and pulled
        (_RUBBER,),
        (held("bottom"), held("top", u_x=0.8, u_z=0.2)),
        (
            probe("mid", "u_x", (1, 1, 2)),
            force("force x", "x", "top"),
            force("force z", "z", "top"),
        ),
        elements=((2, 2, 4), (4, 4, 8), (6, 6, 12)),
        **_round(np.ones_like),
    ),
    _body(
        "spindle of voxels",  # active, shortened
        (_MUSCLE,),
        (held("bottom"), held("top", u_z=-0.2)),
        (probe("quarter", "u_z", (1, 1, 1)), force("force z", "z", "top")),
        activation=0.2,
        elements=((2, 2, 4), (4, 4, 8), (6, 6, 12)),
        **_round(lambda z: 0.6 + 0.4 * np.sin(np.pi * z / _LENGTH)),
    ),
    _body(
        "bracket of voxels",  # under a dead load
        (_RUBBER,),
        (held("bottom"), {"set": "top", "traction": [0, 0, -0.4]}),
        (probe("tip", "u_z", (3, 0.5, 3)), force("force z", "z", "bottom")),
        size=(3.0, 1.0, 3.0),
        label=_arms,
        elements=((3, 2, 3), (6, 2, 6), (12, 4, 12)),
        part=lambda x: int(x[0] < 1 or x[2] > 2),
    ),
    _body(
        "three tissues of voxels",  # curved interfaces, pulled and active
        (
            {**_MUSCLE, "name": "muscle"},
            _FAT,
            {"name": "tendon", "model": "neo-hookean", "mu": 30.0, "K": 1e3},
        ),
        (held("bottom"), held("top", u_z=0.2)),
        (
            probe("interface", "u_z", (1.5 + 0.1125 * np.sqrt(0.5), 0.5, 1)),
            probe("side", "u_x", (2, 0.5, 2)),
            force("force z", "z", "top"),
        ),
        activation=0.1,
        size=(2.0, 1.0, _LENGTH),
        label=_layer,
        elements=((4, 2, 4), (4, 2, 8), (8, 4, 12)),
        warp=_bent,
        part=lambda x: 1 + int(x[0] > 1) + int(x[0] > 1.5),
    ),
)
