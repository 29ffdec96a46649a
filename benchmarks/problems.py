"""Problems that a new user would bring: boxes, tubes and label maps, stretched, bent, active.

No deck names a form, order, support, weights, a curve or load steps, and none chose a default of
MyoRK, so that what is tried is what somebody gets who knows none of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.voxel_bodies import BODIES, TWO_TISSUES, Body
from myork.bench.materials import MUSCLE, RUBBER

Sizes = tuple[tuple[int, ...], ...]


class Problem(NamedTuple):
    """A problem with the sizes at which it is solved."""

    name: str  #: What tables show
    tables: Mapping[str, Any]  #: Deck without `geometry.source`
    sizes: Sizes  #: Source points along each edge, rising
    #: Finite elements along each edge, rising; each coordinate of a probe is a corner
    elements: Sizes


def probe_kind(entry: Mapping[str, Any], size: Sequence[float] | None = None) -> str:
    """What a probe tells: `displacement`, `force`, `surface stress` or `stress`.

    - `entry`: table `[[probe]]`
    - `size`: edges of the box; of other bodies the probe's name says where its point lies
    """
    quantity = str(entry["quantity"])
    if quantity.startswith("u_"):
        return "displacement"
    if quantity.startswith(("force", "torque")):
        return "force"
    if size is None:
        return "surface stress" if "wall" in entry["name"] else "stress"
    on = any(x in (0, edge) for x, edge in zip(entry["point"], size, strict=True))
    return "surface stress" if on else "stress"


def _problem(
    name: str,
    geometry: Mapping[str, Any],
    material: Mapping[str, Any],
    boundary: Sequence[Mapping[str, Any]],
    probes: Sequence[Mapping[str, Any]],
    sizes: Sizes,
    elements: Sizes,
    activation: float = 0.0,
) -> Problem:
    """A problem of one material."""
    tables = deck(name, geometry, (material,), boundary, probes, activation)
    return Problem(name, tables, sizes, elements)


def _box(*size: float) -> dict[str, Any]:
    return {"kind": "box", "size": list(size)}


def _ring(inner: float, outer: float) -> dict[str, Any]:
    return {"kind": "annulus", "inner_radius": inner, "outer_radius": outer}


def _muscle(angle: float) -> dict[str, Any]:
    return {**MUSCLE, "fiber_angle": angle}


_RUBBER = {**RUBBER, "K": 1e3}
_STIFF = {**RUBBER, "K": 1e5}
_GEL = {"name": "gel", "model": "neo-hookean", "mu": 2.0, "K": 6.0}
_SILICONE = {"name": "silicone", "model": "neo-hookean", "mu": 20.0, "K": 1e4}
_PLANES = ({"set": "x0", "u_x": 0.0}, {"set": "y0", "u_y": 0.0})

_SHEET = ((17, 5), (33, 9), (65, 17))
_SHEET_ELEMENTS = ((16, 4), (32, 8), (64, 16))
_TUBE_SIZES = ((5, 26), (9, 51), (17, 101))
_TUBE_ELEMENTS = ((4, 20), (8, 40), (16, 80))
_CUBE = ((5, 5, 5), (7, 7, 7), (9, 9, 9))
_CUBE_ELEMENTS = ((2, 2, 2), (4, 4, 4), (6, 6, 6))
_BLOCK = ((5, 5, 9), (7, 7, 13), (9, 9, 17))
_BLOCK_ELEMENTS = ((2, 2, 4), (4, 4, 8), (6, 6, 12))


def _tube(name: str, material: Mapping[str, Any]) -> Problem:
    """Quarter tube, inflated until its inner radius is doubled."""
    return _problem(
        name,
        _ring(6, 8),
        material,
        (*_PLANES, {"set": "inner", "radial": 6.0}),
        (
            probe("outer", "u_x", (8, 0)),
            probe("wall", "cauchy_rr", (6, 0)),
            probe("hoop_outer_wall", "cauchy_yy", (8, 0)),
            force("force", "x", "x0"),
        ),
        _TUBE_SIZES,
        _TUBE_ELEMENTS,
    )


def _block(name: str, angle: float, *moved: Mapping[str, Any]) -> Problem:
    """Active block between held ends."""
    return _problem(
        name,
        _box(1, 1, 2),
        _muscle(angle),
        (held("z0"), held("z1")),
        (
            *moved,
            probe("side", "cauchy_zz", (1, 0.5, 1)),
            probe("inside", "cauchy_zz", (0.5, 0.5, 1)),
            force("reaction_z", "z", "z0"),
        ),
        _BLOCK,
        _BLOCK_ELEMENTS,
        activation=0.15,
    )


#: Problems by what they try, each at three sizes
PROBLEMS = (
    _problem(
        "cantilever, dead traction",
        _box(4, 1),
        _RUBBER,
        (held("x0", 2), {"set": "x1", "traction": [0, 2.0]}),
        (
            probe("tip", "u_y", (4, 0.5)),
            probe("fiber", "cauchy_xx", (2, 0)),
            probe("inside", "cauchy_xx", (1, 0.25)),
            force("root", "y", "x0"),
        ),
        _SHEET,
        _SHEET_ELEMENTS,
    ),
    _problem(
        "clamped beam, end shear",
        _box(4, 1),
        _RUBBER,
        (held("x0", 2), held("x1", 2, u_y=1.0)),
        (
            probe("quarter", "u_y", (1, 0.5)),
            probe("fiber", "cauchy_xx", (1, 0)),
            probe("inside", "cauchy_xy", (2, 0.5)),
            force("force", "y", "x1"),
            force("pull", "x", "x1"),
        ),
        _SHEET,
        _SHEET_ELEMENTS,
    ),
    _problem(
        "near shear",  # a sheet with free ends
        _box(4, 1),
        _RUBBER,
        (held("y0", 2), held("y1", 2, u_x=1.0)),
        (
            probe("end", "u_x", (4, 0.5)),
            probe("free_edge", "cauchy_yy", (4, 0.5)),
            probe("middle", "cauchy_xy", (2, 0.5)),
            force("force", "x", "y1"),
        ),
        _SHEET,
        _SHEET_ELEMENTS,
    ),
    _tube("tube", _RUBBER),
    _tube("tube, K = 1e7", {**RUBBER, "K": 1e7}),
    _problem(
        "column, leaning load",
        _box(1, 1, 3),
        _RUBBER,
        (held("z0"), {"set": "z1", "traction": [0.5, 0.0, -3.0]}),
        (
            probe("lean", "u_x", (0.5, 0.5, 3)),
            probe("shortening", "u_z", (0.5, 0.5, 3)),
            probe("side", "cauchy_zz", (1, 0.5, 1.5)),
            probe("inside", "cauchy_zz", (0.5, 0.5, 1.5)),
            force("root", "x", "z0"),
        ),
        ((5, 5, 13), (7, 7, 19), (9, 9, 25)),
        ((2, 2, 6), (4, 4, 8), (4, 4, 12)),
    ),
    _problem(
        "twist",  # by 180 degrees
        _box(1, 1, 3),
        _RUBBER,
        (
            held("z0"),
            {"set": "z1", "rotation": 180.0, "axis": [0, 0, 1], "about": [0.5, 0.5, 3]},
        ),
        (
            probe("side", "u_x", (1, 0.5, 0.75)),
            probe("inside", "cauchy_zz", (0.5, 0.5, 1.5)),
            {"name": "torque", "quantity": "torque_z", "set": "z1", "about": [0.5, 0.5, 3]},
            force("force", "z", "z1"),
        ),
        ((5, 5, 9), (5, 5, 13), (7, 7, 19)),
        ((2, 2, 8), (4, 4, 8), (4, 4, 12)),
    ),
    _problem(
        "cube between plates",  # an eighth of it, compressed by 30 %
        _box(1, 1, 1),
        _RUBBER,
        (*_PLANES, {"set": "z0", "u_z": 0.0}, held("z1", u_z=-0.3)),
        (
            probe("bulge", "u_x", (1, 0, 0)),
            probe("side", "cauchy_zz", (1, 0, 0)),
            probe("centre", "cauchy_zz", (0.5, 0.5, 0.5)),
            force("force", "z", "z1"),
        ),
        _CUBE,
        _CUBE_ELEMENTS,
    ),
    _block(
        "inclined block",
        30,
        probe("side_u_x", "u_x", (1, 0.5, 1)),
        probe("side_u_z", "u_z", (1, 0.5, 1)),
    ),
    _block("straight block", 0),
    _problem(
        "stretched muscle",
        _box(1, 1, 2),
        _muscle(0),
        (held("z0"), held("z1", u_z=0.2)),
        (
            probe("waist", "u_x", (1, 0.5, 1)),
            probe("side", "cauchy_zz", (1, 0.5, 1)),
            probe("inside", "cauchy_zz", (0.5, 0.5, 1)),
            force("reaction", "z", "z1"),
        ),
        _BLOCK,
        _BLOCK_ELEMENTS,
        activation=0.1,
    ),
)


def _pulled_sheet(name: str, material: Mapping[str, Any], size: tuple[int, int]) -> Problem:
    """Sheet that is pulled by half its length."""
    return _problem(
        name,
        _box(2, 1),
        material,
        (held("x0", 2), held("x1", 2, u_x=1.0)),
        (
            probe("waist", "u_y", (1, 1)),
            probe("middle", "cauchy_xx", (1, 0.5)),
            force("pull", "x", "x1"),
        ),
        (size,),
        ((8, 4), (16, 8), (32, 16)),
    )


#: Twenty decks at the number of points that somebody new to MyoRK would take
DECKS: tuple[Problem | Body, ...] = (
    _pulled_sheet("soft sheet", _GEL, (9, 5)),
    _pulled_sheet("stiff sheet", _STIFF, (17, 9)),
    _problem(
        "thin strip",
        _box(10, 0.5),
        _SILICONE,
        (held("x0", 2), {"set": "x1", "traction": [0, -0.05]}),
        (
            probe("tip", "u_y", (10, 0.25)),
            probe("fiber", "cauchy_xx", (2.5, 0.5)),
            force("root", "y", "x0"),
        ),
        ((41, 3),),
        ((20, 2), (40, 2), (80, 4)),
    ),
    _problem(
        "pad between plates",  # a quarter flatter
        _box(3, 1),
        _SILICONE,
        (held("y0", 2), held("y1", 2, u_y=-0.25)),
        (
            probe("bulge", "u_x", (3, 0.5)),
            probe("middle", "cauchy_yy", (1.5, 0.5)),
            force("press", "y", "y1"),
        ),
        ((25, 9),),
        ((12, 4), (24, 8), (48, 16)),
    ),
    _problem(
        "block under shear traction",
        _box(1, 1),
        _GEL,
        (held("y0", 2), {"set": "y1", "traction": [0.3, 0]}),
        (
            probe("top", "u_x", (0.5, 1)),
            probe("middle", "cauchy_xy", (0.5, 0.5)),
            force("base", "x", "y0"),
        ),
        ((9, 9),),
        ((4, 4), (8, 8), (16, 16)),
    ),
    _problem(
        "thick soft tube",
        _ring(2, 6),
        _GEL,
        (*_PLANES, {"set": "inner", "radial": 0.5}),
        (
            probe("outer", "u_x", (6, 0)),
            probe("hoop on the inner wall", "cauchy_yy", (2, 0)),
            force("cut", "x", "x0"),
        ),
        ((13, 25),),
        ((8, 12), (16, 24), (32, 48)),
    ),
    _problem(
        "thin stiff tube",
        _ring(10, 10.5),
        _STIFF,
        (*_PLANES, {"set": "inner", "radial": 3.0}),
        (
            probe("outer", "u_x", (10.5, 0)),
            probe("hoop on the outer wall", "cauchy_yy", (10.5, 0)),
            force("cut", "x", "x0"),
        ),
        ((4, 61),),
        ((2, 40), (4, 80), (8, 160)),
    ),
    _problem(
        "bent quarter ring",  # one end moved inwards
        _ring(4, 5),
        _SILICONE,
        (held("y0", 2), held("x0", 2, u_y=-0.5)),
        (
            probe("end", "u_x", (4.5 * np.sqrt(0.5), 4.5 * np.sqrt(0.5))),
            force("push", "y", "x0"),
            force("across", "x", "x0"),
        ),
        ((7, 41),),
        ((2, 20), (4, 40), (8, 80)),
    ),
    _problem(
        "soft cube",  # between glued plates, a third flatter
        _box(1, 1, 1),
        _GEL,
        (held("z0"), held("z1", u_z=-0.33)),
        (
            probe("bulge", "u_x", (1, 0.5, 0.5)),
            probe("middle", "cauchy_zz", (0.5, 0.5, 0.5)),
            force("press", "z", "z1"),
        ),
        ((6, 6, 6),),
        _CUBE_ELEMENTS,
    ),
    _problem(
        "leaning post",
        _box(1, 1, 4),
        _SILICONE,
        (held("z0"), held("z1", u_x=1.0)),
        (
            probe("half way", "u_x", (0.5, 0.5, 2)),
            probe("quarter", "u_x", (0.5, 0.5, 1)),
            force("push", "x", "z1"),
        ),
        ((5, 5, 17),),
        ((2, 2, 8), (4, 4, 12), (4, 4, 20)),
    ),
    _problem(
        "tongue",
        _box(3, 1, 0.3),
        _STIFF,
        (held("x0"), {"set": "x1", "traction": [0, 0, -0.3]}),
        (probe("tip", "u_z", (3, 0.5, 0)), force("root", "z", "x0")),
        ((16, 6, 3),),
        ((6, 2, 2), (12, 4, 2), (18, 6, 2)),
    ),
    _problem(
        "held muscle",
        _box(1, 1, 3),
        _muscle(0),
        (held("z0"), held("z1")),
        (
            probe("waist", "u_x", (1, 0.5, 0.75)),
            probe("middle", "cauchy_zz", (0.5, 0.5, 1.5)),
            force("pull", "z", "z1"),
        ),
        ((5, 5, 13),),
        ((2, 2, 4), (4, 4, 8), (4, 4, 12)),
        activation=0.4,
    ),
    _problem(
        "free muscle",
        _box(1, 1, 3),
        _muscle(0),
        (held("z0"), {"set": "z1", "u_x": 0.0, "u_y": 0.0}),
        (probe("end", "u_z", (0.5, 0.5, 3)), probe("belly", "u_x", (1, 0.5, 1.5))),
        ((5, 5, 13),),
        ((2, 2, 4), (4, 4, 8), (4, 4, 12)),
        activation=0.05,
    ),
    _problem(
        "pennate muscle",
        _box(1, 1, 2),
        _muscle(20),
        (held("z0"), held("z1", u_z=0.1)),
        (
            probe("side", "u_x", (1, 0.5, 1)),
            probe("middle", "cauchy_zz", (0.5, 0.5, 1)),
            force("pull", "z", "z1"),
        ),
        ((6, 6, 11),),
        _BLOCK_ELEMENTS,
        activation=0.1,
    ),
    *(body._replace(sizes=body.sizes[:1]) for body in (*BODIES, *TWO_TISSUES)),
)

#: All problems, by what tables call them
BY_NAME: Mapping[str, Any] = {problem.name: problem for problem in (*DECKS, *PROBLEMS, *BODIES)}
