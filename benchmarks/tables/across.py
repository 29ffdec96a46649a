"""Errors by the number of points across: rubber bodies with clamped rims, n points each way."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.runner import sized_tables
from benchmarks.truths.conditions import AXES
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.peers import solve_dolfinx
from myork.bench.materials import RUBBER
from myork.core.scene import Scene
from myork.types import F64

#: Points along each edge, and ratios of bulk to shear modulus
POINTS, RATIOS = range(4, 13), (50.0, 1e4)
#: Shear modulus of the rubber at rest, per N/cm2
SHEAR = 74.6


class Part(NamedTuple):
    """A body, and its part between planes of symmetry, used for the truth."""

    size: tuple[float, float, float]  #: Edges of the body
    folds: str  #: Axes normal to planes of symmetry through its middle
    boundary: Sequence[dict[str, Any]]  #: Conditions of the whole body
    part: Sequence[dict[str, Any]]  #: Conditions of the part, without planes of symmetry
    pull: tuple[str, str]  #: Force component and the set where it acts
    along: str  #: Displacement to compare
    meshes: Sequence[tuple[int, int, int]]  #: Elements of the part, coarser and finer
    middle: tuple[float, float, float]  #: Place in the part, relative to its edges
    side: Sequence[tuple[float, float, float]]  #: Places over the side, likewise


def _over(*shares: Sequence[float]) -> list[tuple[float, float, float]]:
    places = np.stack(np.meshgrid(*shares, indexing="ij"), -1).reshape(-1, 3)
    return [(float(x), float(y), float(z)) for x, y, z in places]


def _shares(parts: int, first: int, last: int) -> list[float]:
    return [k / parts for k in range(first, last + 1)]


# places over the sides are nodes of both meshes; few of them alias with the groups of cells
BODIES = {
    "cube, 30 % shorter": Part(
        (1, 1, 1), "xyz", (held("z0"), held("z1", u_z=-0.3)), (held("z1", u_z=-0.15),),
        ("z", "z1"), "u_x", ((3, 3, 3), (9, 9, 9)), (1, 0, 0),
        _over((1.0,), _shares(6, 0, 6), _shares(6, 0, 5)),
    ),
    "block 1 x 1 x 2, 30 % longer": Part(
        (1, 1, 2), "xyz", (held("z0"), held("z1", u_z=0.6)), (held("z1", u_z=0.3),),
        ("z", "z1"), "u_x", ((5, 5, 10), (10, 10, 20)), (1, 0, 0),
        _over((1.0,), _shares(10, 0, 10), _shares(20, 0, 19)),
    ),
    "plate 1 x 1 x 0.1, end moved by 0.1": Part(
        (1, 1, 0.1), "y", (held("x0"), {"set": "x1", "u_z": 0.1}),
        (held("x0"), {"set": "x1", "u_z": 0.1}),
        ("z", "x1"), "u_z", ((32, 16, 4), (48, 24, 4)), (0.5, 1, 0.5),
        _over(_shares(32, 5, 32), _shares(16, 0, 15), (0.5,)),
    ),
    "column 1 x 1 x 3, end moved by 0.6": Part(
        (1, 1, 3), "y", (held("z0"), held("z1", u_x=0.6)), (held("z0"), held("z1", u_x=0.6)),
        ("x", "z1"), "u_x", ((6, 3, 18), (12, 6, 36)), (1, 0, 0.5),
        _over((1.0,), _shares(6, 0, 6), _shares(36, 1, 35)),
    ),
}  # fmt: skip


def across() -> Iterator[tuple[str, ...]]:
    """Errors of n x n x n points that the deck gives, in the default form.

    Rubber of section 5.3.10 with K of 50 and 10,000 shear moduli. Force on the moved end, and
    displacement in the middle of a free side, normal to it (of the plate its deflection): signed
    errors [%]. Root mean square of the error of that displacement over the whole side, relative to
    the root mean square there [%]. Truth: the part between planes of symmetry by dolfinx, with the
    finer of two meshes of quadratic elements with pressures (Q2/P1). `change of truth` is its
    change from the coarser one; the truth may be off by that much, its forces upwards.
    """
    yield "body", "K/mu", "error of", "change of truth", *(f"n = {n}" for n in POINTS)
    for name, body in BODIES.items():
        for ratio in RATIOS:
            coarse, truth = _elements(body, ratio)
            errors = [_compare(_solve(body, ratio, n), truth) for n in POINTS]
            change = _compare(coarse, truth)
            for k, what in enumerate(("force", "middle", "side, r.m.s.")):
                yield name, f"{ratio:g}", what, *(f"{one[k]:.2g}" for one in (change, *errors))


def _compare(values: F64, truth: F64) -> tuple[float, float, float]:
    """Errors of force and middle displacement, and over the side [%]."""
    off = values - truth
    side = np.sqrt(np.mean(off[2:] ** 2) / np.mean(truth[2:] ** 2))
    return 100 * off[0] / truth[0], 100 * off[1] / truth[1], 100 * float(side)


def _tables(body: Part, ratio: float, size: Sequence[int], whole: bool) -> dict[str, Any]:
    """Deck of a body, or of its part."""
    folded = [axis in body.folds for axis in AXES]
    part = [length / (1 + fold) for length, fold in zip(body.size, folded, strict=True)]
    probes = [force("force", *body.pull)]
    for k, shares in enumerate((body.middle, *body.side)):
        place = [
            length * (share + (fold if whole else 0))
            for length, share, fold in zip(part, shares, folded, strict=True)
        ]
        probes.append(probe(f"{k}", body.along, place))
    geometry = {"kind": "box", "size": list(body.size if whole else part)}
    planes = [{"set": f"{axis}0", f"u_{axis}": 0.0} for axis in body.folds]
    boundary = body.boundary if whole else [*planes, *body.part]
    material = {**RUBBER, "K": ratio * SHEAR}
    return sized_tables(deck("across", geometry, (material,), boundary, probes), size)


def _solve(body: Part, ratio: float, points: int) -> F64:
    """Force and displacements of the whole body."""
    with Scene.from_tables(_tables(body, ratio, (points,) * 3, whole=True), threads=1) as scene:
        states = scene.solve(error=False)
        return np.asarray(scene.probes(states.x, states.load)[-1][:, 0])


def _elements(body: Part, ratio: float) -> list[F64]:
    """The same by finite elements of its part, on both meshes."""
    tables = {**_tables(body, ratio, (3, 3, 3), whole=False), "load": {}}
    rows = solve_dolfinx(tables, body.meshes, "Q2/P1", limit=600.0)
    if not all("probes" in row for row in rows):
        raise RuntimeError(f"no truth by dolfinx: {[row.get('outcome') for row in rows]}")
    values = [np.array(list(row["probes"].values())) for row in rows]
    for one in values:
        # planes of symmetry along the force divide the end that is moved
        one[0] *= 2 ** sum(axis != body.pull[1][0] for axis in body.folds)
    return values
