"""Twenty problems of somebody new to MyoRK, at the number of points that he would take.

Soft and stiff, thin and thick, of one to three materials; boxes, annuli and bodies from label maps.
No deck names a form, order, support, weights, a curve or load steps, and none chose a default.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.problems import Problem
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.voxel_bodies import BODIES, Body
from myork.bench.materials import MUSCLE, RUBBER

__all__ = ["DECKS"]

_GEL = {"name": "gel", "model": "neo-hookean", "mu": 2.0, "K": 6.0}
_SILICONE = {"name": "silicone", "model": "neo-hookean", "mu": 20.0, "K": 1e4}
_RUBBER = {**RUBBER, "K": 1e5}


def _box(*size: float) -> dict[str, Any]:
    return {"kind": "box", "size": list(size)}


def _ring(inner: float, outer: float) -> dict[str, Any]:
    return {"kind": "annulus", "inner_radius": inner, "outer_radius": outer}


def _muscle(angle: float) -> dict[str, Any]:
    return {**MUSCLE, "fiber_angle": angle}


_PLANES = ({"set": "x0", "u_x": 0.0}, {"set": "y0", "u_y": 0.0})


def _pulled_sheet(material: dict[str, Any]) -> dict[str, Any]:
    return deck(
        f"Sheet of {material['name']} pulled by half its length",
        _box(2, 1),
        (material,),
        (held("x0", 2), held("x1", 2, u_x=1.0)),
        (
            probe("waist", "u_y", (1, 1)),
            probe("middle", "cauchy_xx", (1, 0.5)),
            force("pull", "x", "x1"),
        ),
    )


_PLANE: tuple[Problem, ...] = (
    Problem("soft sheet", _pulled_sheet(_GEL), ((9, 5),), ((8, 4), (16, 8), (32, 16))),
    Problem("stiff sheet", _pulled_sheet(_RUBBER), ((17, 9),), ((8, 4), (16, 8), (32, 16))),
    Problem(
        "thin strip",
        deck(
            "Thin strip bent by the weight at its end",
            _box(10, 0.5),
            (_SILICONE,),
            (held("x0", 2), {"set": "x1", "traction": [0, -0.05]}),
            (
                probe("tip", "u_y", (10, 0.25)),
                probe("fiber", "cauchy_xx", (2.5, 0.5)),
                force("root", "y", "x0"),
            ),
        ),
        ((41, 3),),
        ((20, 2), (40, 2), (80, 4)),
    ),
    Problem(
        "pad between plates",
        deck(
            "Pad between glued plates, a quarter flatter",
            _box(3, 1),
            (_SILICONE,),
            (held("y0", 2), held("y1", 2, u_y=-0.25)),
            (
                probe("bulge", "u_x", (3, 0.5)),
                probe("middle", "cauchy_yy", (1.5, 0.5)),
                force("press", "y", "y1"),
            ),
        ),
        ((25, 9),),
        ((12, 4), (24, 8), (48, 16)),
    ),
    Problem(
        "block under shear traction",
        deck(
            "Glued block whose upper face is drawn sideways",
            _box(1, 1),
            (_GEL,),
            (held("y0", 2), {"set": "y1", "traction": [0.3, 0]}),
            (
                probe("top", "u_x", (0.5, 1)),
                probe("middle", "cauchy_xy", (0.5, 0.5)),
                force("base", "x", "y0"),
            ),
        ),
        ((9, 9),),
        ((4, 4), (8, 8), (16, 16)),
    ),
    Problem(
        "thick soft tube",
        deck(
            "Thick tube of gel, opened by a quarter of its bore",
            _ring(2, 6),
            (_GEL,),
            (*_PLANES, {"set": "inner", "radial": 0.5}),
            (
                probe("outer", "u_x", (6, 0)),
                probe("hoop on the inner wall", "cauchy_yy", (2, 0)),
                force("cut", "x", "x0"),
            ),
        ),
        ((13, 25),),
        ((8, 12), (16, 24), (32, 48)),
    ),
    Problem(
        "thin stiff tube",
        deck(
            "Thin tube of rubber, widened by a third",
            _ring(10, 10.5),
            (_RUBBER,),
            (*_PLANES, {"set": "inner", "radial": 3.0}),
            (
                probe("outer", "u_x", (10.5, 0)),
                probe("hoop on the outer wall", "cauchy_yy", (10.5, 0)),
                force("cut", "x", "x0"),
            ),
        ),
        ((4, 61),),
        ((2, 40), (4, 80), (8, 160)),
    ),
    Problem(
        "bent quarter ring",
        deck(
            "Quarter ring clamped at one end, the other one moved inwards",
            _ring(4, 5),
            (_SILICONE,),
            (held("y0", 2), held("x0", 2, u_y=-0.5)),
            (
                probe("end", "u_x", (4.5 * np.sqrt(0.5), 4.5 * np.sqrt(0.5))),
                force("push", "y", "x0"),
                force("across", "x", "x0"),
            ),
        ),
        ((7, 41),),
        ((2, 20), (4, 40), (8, 80)),
    ),
)

_SOLID: tuple[Problem, ...] = (
    Problem(
        "soft cube",
        deck(
            "Cube of gel between glued plates, a third flatter",
            _box(1, 1, 1),
            (_GEL,),
            (held("z0"), held("z1", u_z=-0.33)),
            (
                probe("bulge", "u_x", (1, 0.5, 0.5)),
                probe("middle", "cauchy_zz", (0.5, 0.5, 0.5)),
                force("press", "z", "z1"),
            ),
        ),
        ((6, 6, 6),),
        ((2, 2, 2), (4, 4, 4), (6, 6, 6)),
    ),
    Problem(
        "leaning post",
        deck(
            "Post of silicone pushed over at its head",
            _box(1, 1, 4),
            (_SILICONE,),
            (held("z0"), held("z1", u_x=1.0)),
            (
                probe("half way", "u_x", (0.5, 0.5, 2)),
                probe("quarter", "u_x", (0.5, 0.5, 1)),
                force("push", "x", "z1"),
            ),
        ),
        ((5, 5, 17),),
        ((2, 2, 8), (4, 4, 12), (4, 4, 20)),
    ),
    Problem(
        "tongue",
        deck(
            "Flat tongue under a load at its tip",
            _box(3, 1, 0.3),
            (_RUBBER,),
            (held("x0"), {"set": "x1", "traction": [0, 0, -0.3]}),
            (
                probe("tip", "u_z", (3, 0.5, 0)),
                force("root", "z", "x0"),
            ),
        ),
        ((16, 6, 3),),
        ((6, 2, 2), (12, 4, 2), (18, 6, 2)),
    ),
    Problem(
        "held muscle",
        deck(
            "Muscle of straight fibers between held ends",
            _box(1, 1, 3),
            (_muscle(0),),
            (held("z0"), held("z1")),
            (
                probe("waist", "u_x", (1, 0.5, 0.75)),
                probe("middle", "cauchy_zz", (0.5, 0.5, 1.5)),
                force("pull", "z", "z1"),
            ),
            activation=0.4,
        ),
        ((5, 5, 13),),
        ((2, 2, 4), (4, 4, 8), (4, 4, 12)),
    ),
    Problem(
        "free muscle",
        deck(
            "Muscle with a free end that shortens",
            _box(1, 1, 3),
            (_muscle(0),),
            (held("z0"), {"set": "z1", "u_x": 0.0, "u_y": 0.0}),
            (
                probe("end", "u_z", (0.5, 0.5, 3)),
                probe("belly", "u_x", (1, 0.5, 1.5)),
            ),
            activation=0.05,
        ),
        ((5, 5, 13),),
        ((2, 2, 4), (4, 4, 8), (4, 4, 12)),
    ),
    Problem(
        "pennate muscle",
        deck(
            "Muscle of inclined fibers, pulled and active",
            _box(1, 1, 2),
            (_muscle(20),),
            (held("z0"), held("z1", u_z=0.1)),
            (
                probe("side", "u_x", (1, 0.5, 1)),
                probe("middle", "cauchy_zz", (0.5, 0.5, 1)),
                force("pull", "z", "z1"),
            ),
            activation=0.1,
        ),
        ((6, 6, 11),),
        ((2, 2, 4), (4, 4, 8), (6, 6, 12)),
    ),
)

#: Box of the bodies below, and a voxel of theirs [cm]
_SIZE, _VOXEL = (2.0, 1.0, 2.0), 0.2


def _in_box(x: NDArray[np.float64]) -> NDArray[Any]:
    return np.all((x > 0) & (x < _SIZE), axis=-1)


def _beside(x: NDArray[np.float64]) -> NDArray[Any]:
    """Muscle below the middle, fat above it."""
    return np.asarray(_in_box(x) * (1 + (x[..., 0] > 1.0)))


def _cored(x: NDArray[np.float64]) -> NDArray[Any]:
    """A stiff bar along z between softer sides."""
    return np.asarray(_in_box(x) * (1 + (abs(x[..., 0] - 1.0) < 0.4)))


def _labels(*number: dict[str, Any]) -> Sequence[dict[str, Any]]:
    return [{**table, "label": label} for label, table in enumerate(number, 1)]


_MAPS: tuple[Body, ...] = (
    *(body._replace(sizes=body.sizes[:1]) for body in BODIES),
    Body(
        "muscle beside fat",
        size=_SIZE,
        tables=deck(
            "Muscle beside fat between held ends",
            {"kind": "model"},
            _labels(
                {**MUSCLE, "fiber": [0, 0, 1]},
                {"name": "fat", "model": "neo-hookean", "mu": 1.0, "K": 100.0},
            ),
            (held("bottom"), held("top", u_z=0.1)),
            (
                probe("within the muscle", "u_x", (0.5, 0.5, 1)),
                force("pull", "z", "top"),
            ),
            activation=0.15,
        ),
        label=_beside,
        sizes=(_VOXEL,),
        elements=((4, 2, 4), (8, 4, 8), (12, 4, 12)),
        part=lambda x: 1 + int(x[0] > 1.0),
    ),
    Body(
        "bar in gel",
        size=_SIZE,
        tables=deck(
            "Silicone bar in gel, sheared",
            {"kind": "model"},
            _labels(_GEL, _SILICONE),
            (held("bottom"), held("top", u_x=0.4)),
            (
                probe("middle", "u_x", (1, 0.5, 1)),
                force("push", "x", "top"),
            ),
        ),
        label=_cored,
        sizes=(_VOXEL,),
        elements=((10, 2, 4), (10, 4, 8), (20, 4, 12)),
        part=lambda x: 1 + int(abs(x[0] - 1.0) < 0.4),
    ),
)

#: All of them
DECKS: tuple[Problem | Body, ...] = _PLANE + _SOLID + _MAPS
