"""Random label maps: round bodies of one or two tissues, without form, points or blocks.

Finite elements of the true shape give the truths, `benchmarks/truths/unseen_maps.json`, beforehand.
The numbers below 32 are for tuning, the others for assessing the result.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.unseen import Wanted, answers, random_solid
from benchmarks.voxel_bodies import Body, box_tables
from myork.bench.runs import read_deck
from myork.console import ProgressCallback
from myork.errors import ConvergenceError
from myork.types import F64

NUMBERS = range(62)
#: The first number not used for any choice
OTHER = 32
#: The only form for a map, without overrides
AS_THEY_ARE: dict[str, tuple[str, ...]] = {"map": ()}
_SEED = 20261127
#: Limits of finite elements
TRUTHS = Path(__file__).parent / "truths" / "unseen_maps.json"
_FAT = {"name": "fat", "model": "neo-hookean", "mu": 1.0, "K": 100.0}

Rng = np.random.Generator


class _Shape:
    """Round body about a line from z = 0 on, warped from a box with edges `size`.

    Sections are ellipses, whole or half; their centre moves with z. Squares across the box become
    discs (u, v) = (a sqrt(1 - b^2/2), b sqrt(1 - a^2/2)), so that tissue borders given by a and b
    are curved.
    """

    def __init__(self, rng: Rng, half: bool) -> None:
        kind = str(rng.choice(["cylinder", "spindle", "ellipsoid"]))
        across = int(rng.integers(10, 21))
        radii = np.array([1.0, rng.uniform(0.8, 1.0)])
        self.voxel = 2.0 / across
        self.length = self.voxel * round(rng.uniform(2.0, 3.0) / self.voxel)
        tilt = rng.uniform(-0.25, 0.25, 2) * [not half, 1.0]
        self.name = f"{'half ' if half else ''}{kind}, {across} voxels across"
        self.half = half
        shares: dict[str, Callable[[F64], F64]] = {
            "cylinder": np.ones_like,
            "spindle": lambda t: 0.6 + 0.4 * np.sin(np.pi * t),
            "ellipsoid": lambda t: np.sqrt(1.0 - (0.8 * (2.0 * t - 1.0)) ** 2),
        }
        share = shares[kind]
        # the voxel lattice has any position relative to the body, except at a plane of symmetry
        lean = np.maximum(-tilt, 0.0) * self.length
        start = radii + lean + self.voxel * rng.uniform(0.0, 1.0, 2)
        if half:
            start[0] = 0.0
        self.middle = lambda z: start + tilt * z[..., None]
        self.radii = lambda z: radii * share(z / self.length)[..., None]
        wide = start + radii + np.maximum(tilt, 0.0) * self.length
        self.size = (*(self.voxel * np.ceil(wide / self.voxel)), self.length)

    def square(self, x: F64) -> F64:
        """a, b, z of positions in the box."""
        share = np.asarray(x)[..., :2] / self.size[:2]
        a = share[..., 0] if self.half else 2.0 * share[..., 0] - 1.0
        return np.stack([a, 2.0 * share[..., 1] - 1.0, x[..., 2]], axis=-1)

    def place(self, square: F64) -> F64:
        """Positions in the body for a, b, z."""
        a, b, z = np.moveaxis(np.asarray(square, float), -1, 0)
        disc = np.stack([a * np.sqrt(1 - b * b / 2), b * np.sqrt(1 - a * a / 2)], axis=-1)
        return np.concatenate([self.middle(z) + self.radii(z) * disc, z[..., None]], axis=-1)

    def back(self, x: F64) -> tuple[NDArray[Any], F64]:
        """Whether positions lie in the body, and their a, b, z."""
        z = x[..., 2]
        disc = (x[..., :2] - self.middle(z)) / self.radii(np.clip(z, 0.0, self.length))
        inside = (disc**2).sum(axis=-1) < 1.0
        inside &= (z > 0.0) & (z < self.length) & (x[..., 0] > 0.0 if self.half else True)
        u, v = np.moveaxis(np.where(inside[..., None], disc, 0.0), -1, 0)
        ab = [
            0.5 * (np.sqrt(2 + s + 2 * np.sqrt(2) * t) - np.sqrt(2 + s - 2 * np.sqrt(2) * t))
            for s, t in ((u * u - v * v, u), (v * v - u * u, v))
        ]
        return inside, np.stack([*ab, z], axis=-1)


def body_of(number: int) -> Body:
    """Random body of a number, identical on every machine."""
    rng = np.random.default_rng([_SEED, number])
    half, two = bool(rng.random() < 0.35), bool(rng.random() < 0.5)
    shape = _Shape(rng, half)
    tissue, part = "one tissue", _one
    materials = [random_solid(rng)]
    if two:
        tissue = "layer" if half else str(rng.choice(["layer", "core", "inclusion"]))
        part = partial(_PARTS[tissue], shape.length)
        soft = bool(rng.random() < 0.6)
        if materials[0]["model"] == "muscle":
            materials.append(_FAT)
        else:
            mu, bulk = (1.0, 100.0) if soft else (100.0, 3e3)
            materials.append({"name": "other", "model": "neo-hookean", "mu": mu, "K": bulk})
        tissue += f" of {'soft' if materials[1]['mu'] == 1.0 else 'stiff'}"
    activation = 0.0
    if materials[0]["model"] == "muscle":
        activation = float(np.round(rng.uniform(0.02, 0.15), 3))
        lean = np.radians(rng.uniform(0, 30))
        fiber = [0.0, np.sin(lean), np.cos(lean)] if half else [np.sin(lean), 0.0, np.cos(lean)]
        materials[0]["fiber"] = np.round(fiber, 4).tolist()
    boundary, way = _loads(rng, shape)
    if half:
        boundary.append({"set": "x0", "u_x": 0.0})
    middle = 0.5 if half else 0.0
    at = {
        name: np.round(shape.place(np.array([a, b, share * shape.length])), 12).tolist()
        for name, a, b, share in (
            ("middle", middle, 0.0, 0.5),
            ("side", 0.5, 0.5, 0.5),
            ("quarter", middle, 0.0, 0.25),
        )
    }
    probes = [
        probe("u_across", "u_x" if way == "sheared" and not half else "u_y", at["quarter"]),
        probe("u_side", "u_y" if half or way != "sheared" else "u_x", at["side"]),
        probe("u_quarter", "u_z", at["quarter"]),
        probe("s_middle", "cauchy_zz", at["middle"]),
        force("f_z", "z", "bottom"),
        force("f_y", "y", "bottom"),
    ]
    if not tissue.startswith("inclusion"):
        probes.append(probe("s_quarter", str(rng.choice(["cauchy_zz", "cauchy_yz"])),
                            at["quarter"]))  # fmt: skip
    title = f"{number}: {shape.name}, {materials[0]['model']}, {tissue}, {way}"
    labelled = [{**table, "label": label} for label, table in enumerate(materials, 1)]
    tables = deck(title, {"kind": "model"}, labelled, boundary, probes, activation)

    def label(x: F64) -> NDArray[Any]:
        inside, square = shape.back(x)
        return np.where(inside, part(square), 0)

    elements = tuple((n // 2 if half else n, n, n) for n in (4, 8))
    return Body(
        title, shape.size, tables, label, (2.0 * shape.voxel,), elements,
        lambda x: shape.place(shape.square(x)), lambda x: int(part(shape.square(x))),
    )  # fmt: skip


def _one(square: F64) -> NDArray[Any]:
    return np.ones(square.shape[:-1], int)


def _layer(_: float, square: F64) -> NDArray[Any]:
    return 1 + (square[..., 1] > 0.5).astype(int)


def _core(_: float, square: F64) -> NDArray[Any]:
    return 1 + (np.abs(square[..., :2]) < 0.5).all(axis=-1).astype(int)


def _inclusion(length: float, square: F64) -> NDArray[Any]:
    inside = np.abs(square[..., 2] - 0.5 * length) < 0.25 * length
    return 1 + (inside & (_core(length, square) == 2)).astype(int)


_PARTS: dict[str, Callable[[float, F64], NDArray[Any]]] = {
    "layer": _layer,
    "core": _core,
    "inclusion": _inclusion,
}


def _loads(rng: Rng, shape: _Shape) -> tuple[list[dict[str, Any]], str]:
    """Fixed bottom, and the load on the top; half bodies stay symmetric."""
    ways = ["pulled", "pressed", "sheared", "traction", "slipped"]
    way = str(rng.choice(ways if shape.half else [*ways, "twisted"]))
    pull = float(np.round(rng.uniform(0.05, 0.2) * shape.length, 4))
    push = (rng.uniform(-1.0, 2.0, 3) * [not shape.half, 1.0, 1.0]).round(3)
    about = [*shape.middle(np.array(shape.length)).round(6).tolist(), shape.length]
    across = "u_y" if shape.half else "u_x"
    far: dict[str, dict[str, Any]] = {
        "pulled": held("top", u_z=pull),
        "pressed": held("top", u_z=-0.5 * pull),
        "sheared": {**held("top"), across: 1.5 * pull},
        "traction": {"set": "top", "traction": push.tolist()},
        "slipped": {"set": "top", "u_z": pull},
        "twisted": {"set": "top", "rotation": 100.0 * pull, "axis": [0, 0, 1], "about": about},
    }
    return [held("bottom"), far[way]], way


def rows(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Solve all bodies that have truths, unchanged; with `quick` a few of them."""
    bodies = {number: body_of(number) for number in (NUMBERS[:6] if quick else NUMBERS)}
    return answers(bodies, TRUTHS, progress, range(OTHER, NUMBERS.stop), AS_THEY_ARE)


def _limits(number: int) -> dict[str, Any]:
    """Value of each probe and its doubt; empty if a mesh has none.

    Errors decrease with the spacing at rims and with its square or faster elsewhere: the remaining
    error lies between zero and the last change.
    """
    body = body_of(number)
    deck = read_deck(box_tables(body))
    try:
        coarse, fine = (
            solve_deck(deck, count, labels=body.part, warp=body.warp, symmetric=True)["probes"]
            for count in body.elements
        )
    except ConvergenceError:
        return {}
    changes = {name: 0.5 * (fine[name] - coarse[name]) for name in fine}
    return {name: [fine[name] + half, abs(half)] for name, half in changes.items()}


def wanted(numbers: range) -> list[Wanted]:
    """Bodies and their limits."""
    return [(body_of(number).name, partial(_limits, number)) for number in numbers]
