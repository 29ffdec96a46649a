"""Problems that a new user would bring: boxes and tubes that are stretched, bent, pressed, active.

None of them chose a default of MyoRK. No deck names a method, weights or a curve, so that what is
tried is what somebody gets who knows none of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from benchmarks.truths.deck_parts import deck, force, held, probe
from myork.bench.materials import MUSCLE, RUBBER

__all__ = ["PROBLEMS", "Problem", "probe_kind"]


class Problem(NamedTuple):
    """A problem with the sizes at which it is solved.

    Attributes
    ----------
    name : str
        What tables show.
    tables : mapping
        Deck without `geometry.source`.
    sizes : tuple
        Source points along each edge, rising.
    elements : tuple
        Finite elements along each edge, rising; each coordinate of a probe is a corner.
    """

    name: str
    tables: Mapping[str, Any]
    sizes: tuple[tuple[int, ...], ...]
    elements: tuple[tuple[int, ...], ...]


def probe_kind(entry: Mapping[str, Any], size: Sequence[float] | None = None) -> str:
    """What a probe tells: `displacement`, `force`, `surface stress` or `stress`.

    Parameters
    ----------
    entry : mapping
        Table `[[probe]]`.
    size : sequence of float, optional
        Edges of the box; of other bodies the probe's name says where its point lies.
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


def _rubber(bulk: float) -> dict[str, Any]:
    return {**RUBBER, "K": bulk}


def _box(size: Sequence[float]) -> dict[str, Any]:
    return {"kind": "box", "size": list(size)}


_SHEET = ((17, 5), (33, 9), (65, 17))
_SHEET_ELEMENTS = ((16, 4), (32, 8), (64, 16))
_CUBE = ((5, 5, 5), (7, 7, 7), (9, 9, 9))
_BLOCK = ((5, 5, 9), (7, 7, 13), (9, 9, 17))
_BLOCK_ELEMENTS = ((2, 2, 4), (4, 4, 8), (6, 6, 12))

_CANTILEVER = deck(
    "Cantilever under a dead end traction",
    _box((4, 1)),
    (_rubber(1e3),),
    (held("x0", 2), {"set": "x1", "traction": [0, 2.0]}),
    (
        probe("tip", "u_y", (4, 0.5)),
        probe("fiber", "cauchy_xx", (2, 0)),
        probe("inside", "cauchy_xx", (1, 0.25)),
        force("root", "y", "x0"),
    ),
)
_END_SHEAR = deck(
    "Beam between two clamps, one moved sideways",
    _box((4, 1)),
    (_rubber(1e3),),
    (held("x0", 2), held("x1", 2, u_y=1.0)),
    (
        probe("quarter", "u_y", (1, 0.5)),
        probe("fiber", "cauchy_xx", (1, 0)),
        probe("inside", "cauchy_xy", (2, 0.5)),
        force("force", "y", "x1"),
        force("pull", "x", "x1"),
    ),
)
_SHEAR = deck(
    "Near simple shear of a sheet with free ends",
    _box((4, 1)),
    (_rubber(1e3),),
    (held("y0", 2), held("y1", 2, u_x=1.0)),
    (
        probe("end", "u_x", (4, 0.5)),
        probe("free_edge", "cauchy_yy", (4, 0.5)),
        probe("middle", "cauchy_xy", (2, 0.5)),
        force("force", "x", "y1"),
    ),
)
_COLUMN = deck(
    "Column under an end load that leans",
    _box((1, 1, 3)),
    (_rubber(1e3),),
    (held("z0"), {"set": "z1", "traction": [0.5, 0.0, -3.0]}),
    (
        probe("lean", "u_x", (0.5, 0.5, 3)),
        probe("shortening", "u_z", (0.5, 0.5, 3)),
        probe("side", "cauchy_zz", (1, 0.5, 1.5)),
        probe("inside", "cauchy_zz", (0.5, 0.5, 1.5)),
        force("root", "x", "z0"),
    ),
)
_TWIST = deck(
    "Bar whose end is turned by 180 degrees",
    _box((1, 1, 3)),
    (_rubber(1e3),),
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
)
_PLATES = deck(
    "An eighth of a cube between glued plates, compressed by 30 %",
    _box((1, 1, 1)),
    (_rubber(1e3),),
    (
        {"set": "x0", "u_x": 0.0},
        {"set": "y0", "u_y": 0.0},
        {"set": "z0", "u_z": 0.0},
        held("z1", u_z=-0.3),
    ),
    (
        probe("bulge", "u_x", (1, 0, 0)),
        probe("side", "cauchy_zz", (1, 0, 0)),
        probe("centre", "cauchy_zz", (0.5, 0.5, 0.5)),
        force("force", "z", "z1"),
    ),
)
_INCLINED = deck(
    "Active block with fibers at 30 degrees between held ends",
    _box((1, 1, 2)),
    ({**MUSCLE, "fiber_angle": 30},),
    (held("z0"), held("z1")),
    (
        probe("side_u_x", "u_x", (1, 0.5, 1)),
        probe("side_u_z", "u_z", (1, 0.5, 1)),
        probe("side", "cauchy_zz", (1, 0.5, 1)),
        probe("inside", "cauchy_zz", (0.5, 0.5, 1)),
        force("reaction_z", "z", "z0"),
    ),
    activation=0.15,
)
_STRAIGHT = {
    **_INCLINED,
    "title": "Active block with straight fibers between held ends",
    "material": [{**MUSCLE, "fiber_angle": 0}],
    "probe": [entry for entry in _INCLINED["probe"] if not entry["name"].startswith("side_u")],
}
_STRETCHED = deck(
    "Active muscle pulled by a tenth along its fibers",
    _box((1, 1, 2)),
    ({**MUSCLE, "fiber_angle": 0},),
    (held("z0"), held("z1", u_z=0.2)),
    (
        probe("waist", "u_x", (1, 0.5, 1)),
        probe("side", "cauchy_zz", (1, 0.5, 1)),
        probe("inside", "cauchy_zz", (0.5, 0.5, 1)),
        force("reaction", "z", "z1"),
    ),
    activation=0.1,
)
_TUBE = deck(
    "Quarter tube, inflated until its inner radius is doubled",
    {"kind": "annulus", "inner_radius": 6, "outer_radius": 8},
    (_rubber(1e3),),
    (
        {"set": "x0", "u_x": 0.0},
        {"set": "y0", "u_y": 0.0},
        {"set": "inner", "radial": 6.0},
    ),
    (
        probe("outer", "u_x", (8, 0)),
        probe("wall", "cauchy_rr", (6, 0)),
        probe("hoop_outer_wall", "cauchy_yy", (8, 0)),
        force("force", "x", "x0"),
    ),
)
_STIFF_TUBE = {**_TUBE, "title": f"{_TUBE['title']}, K = 1e7", "material": [_rubber(1e7)]}
_TUBE_SIZES = ((5, 26), (9, 51), (17, 101))
_TUBE_ELEMENTS = ((4, 20), (8, 40), (16, 80))

#: Problems by what they try
PROBLEMS = (
    Problem("cantilever, dead traction", _CANTILEVER, _SHEET, _SHEET_ELEMENTS),
    Problem("clamped beam, end shear", _END_SHEAR, _SHEET, _SHEET_ELEMENTS),
    Problem("near shear", _SHEAR, _SHEET, _SHEET_ELEMENTS),
    Problem("tube", _TUBE, _TUBE_SIZES, _TUBE_ELEMENTS),
    Problem("tube, K = 1e7", _STIFF_TUBE, _TUBE_SIZES, _TUBE_ELEMENTS),
    Problem(
        "column, leaning load",
        _COLUMN,
        ((5, 5, 13), (7, 7, 19), (9, 9, 25)),
        ((2, 2, 6), (4, 4, 8), (4, 4, 12)),
    ),
    Problem(
        "twist",
        _TWIST,
        ((5, 5, 9), (5, 5, 13), (7, 7, 19)),
        ((2, 2, 8), (4, 4, 8), (4, 4, 12)),
    ),
    Problem("cube between plates", _PLATES, _CUBE, ((2, 2, 2), (4, 4, 4), (6, 6, 6))),
    Problem("inclined block", _INCLINED, _BLOCK, _BLOCK_ELEMENTS),
    Problem("straight block", _STRAIGHT, _BLOCK, _BLOCK_ELEMENTS),
    Problem("stretched muscle", _STRETCHED, _BLOCK, _BLOCK_ELEMENTS),
)
