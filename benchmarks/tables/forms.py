"""How settings of a form change its error, its iterations or its cost."""

from __future__ import annotations

import time
from collections.abc import Iterator
from functools import cache
from typing import Any

import numpy as np

from benchmarks.runner import sized_tables
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import Warp, solve_deck, solve_half_block
from benchmarks.truths.tubes import tube_deck, wall_stresses
from myork import Scene
from myork.bench.runs import lattice, read_deck
from myork.core.deck import load_deck
from myork.errors import MyorkError
from myork.files import INPUTS
from myork.types import F64

#: The head of a table, then its rows
Rows = Iterator[tuple[str, ...]]


def walls() -> Rows:
    """Stresses on the walls of a tube, and its force, by settings of the Galerkin form.

    Errors of the radial stress inside and the hoop stress outside at the cut, the same between the
    cuts, and of the force [%]; CPU seconds.
    """
    tube = (6.0, 8.0, 6.0, 1e3)
    truth = wall_stresses(*tube)
    truth["force"] = truth["inner"] * 12.0
    yield "order, support, kernel, window, Gauss points, penalty", "5x26", "9x51", "17x101"
    for order, support, kernel, window, gauss, penalty in (
        (1, 2, "cubic", "product", 2, 100),
        (2, 2.5, "cubic", "product", 2, 100),
        (2, 3, "cubic", "product", 3, 100),
        (2, 3, "quintic", "product", 2, 100),
        (2, 3, "quintic", "product", 3, 100),
        (2, 3, "quintic", "product", 3, 10),
        (2, 3, "quintic", "polar", 2, 10),
        (2, 3, "quintic", "polar", 3, 30),
        (2, 3, "quintic", "polar", 3, 10),
    ):
        choice = {"order": order, "support": support, "kernel": kernel, "window": window}
        settings = {
            "scene": {"dimension": 2, "method": "rkpm-gauss"},
            "approximation": choice,
            "galerkin": {"gauss": gauss, "penalty": float(penalty)},
        }
        cells = []
        for source in ((5, 26), (9, 51), (17, 101)):
            tables = sized_tables(tube_deck(*tube), source) | settings
            tables["probe"] = [*tables["probe"], force("force", "x", "x0")]
            before = time.process_time()
            with Scene.from_tables(tables, threads=1) as scene:
                states = scene.solve(error=False)
                found = scene.probes(states.x, states.load)[-1]
            spent = time.process_time() - before
            names = [probe["name"] for probe in tables["probe"]]
            values = dict(zip(names, found[:, 0], strict=True))
            off = {
                name: 100 * abs(value / truth[name.split()[0]] - 1)
                for name, value in values.items()
            }
            at, between = (
                ", ".join(f"{off[f'{wall} {angle}']:.2g}" for wall in ("inner", "outer"))
                for angle in ("x", "between")
            )
            cells.append(f"{at}; {between}; {off['force']:.1g}; {spent:.2f}")
        yield f"{order}, {support}, {kernel}, {window}, {gauss}, {penalty}", *cells


#: Activations of the inclined block, and distances from the edges at which J is judged [cm]
LEVELS, AWAY = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3), (0.25, 0.5)
LOAD = ("load.steps=6", "load.activation=0.3")
BLOCK = INPUTS / "muscle_fibers.toml"


def mixed() -> Rows:
    """Mixed form of the inclined block: differences from finite elements [%], and J off its edges.

    FEBio's values are those in the deck, computed with the published curves; felupe solves half of
    the block with the curves of the deck. J: range, and the share of points within 2 % of 1.
    """

    def sized(n: int) -> tuple[str, str]:
        return lattice((n, n, 2 * n - 1))

    low = ("approximation.order=2", "approximation.support=3", *sized(5))
    third = ("approximation.order=3", "approximation.support=4", *sized(5))
    straight = "material.muscle.fiber_angle=0"
    cases = {
        "displacement form, order 2": ("scene.method=rkcm", *low),
        "order 2, no edge weights": ("mixed.edge_exponent=0", *low),
        "order 2": low,
        "order 3": third,
        **{f"order 4, edge exponent {power}": (f"mixed.edge_exponent={power}", *sized(5))
           for power in (0, 0.75, 1.5)},
        **{f"order 4, volume weight {weight}": (f"mixed.volume_weight={weight}", *sized(5))
           for weight in (3, 30)},
        **{f"order 4, {n} x {n} x {2 * n - 1}": sized(n) for n in (5, 6, 7)},
        **{f"straight fibers, {n} x {n} x {2 * n - 1}": (straight, *sized(n)) for n in (5, 6, 7)},
    }  # fmt: skip

    @cache
    def felupe(*words: str) -> list[list[float]]:
        loads = [level / LEVELS[-1] for level in LEVELS]
        found = solve_half_block(load_deck(BLOCK, [*LOAD, *words]), (6, 3, 12), loads)
        return list(found["probes"].values())

    names = ("u_x", "u_z", "stress zz", "xz", "R_x", "R_z", "largest")
    yield "form", "activation", "from", *names, *(f"J {d} off the edges" for d in AWAY)
    for name, words in cases.items():
        with Scene(BLOCK, [*LOAD, *words], threads=1) as scene:
            references, places = scene.deck["reference"], scene.points()
            try:
                states = scene.solve(error=False)
            except MyorkError:
                yield name, "not converged"
                continue
            found = scene.probes(states.x, states.load)[:, :, 0]
            volume = [scene.fields(x, at).named["J"][:, 0]
                      for x, at in zip(states.x, states.load, strict=True)]  # fmt: skip
        right = {"felupe": felupe(*[word for word in words if word == straight])}
        if straight not in words:
            right["FEBio"] = [
                np.interp(LEVELS, entry["activation"], entry["value"]) for entry in references
            ]
        wall = np.minimum(places - places.min(axis=0), places.max(axis=0) - places)
        rim = np.hypot(wall[:, 2], np.minimum(wall[:, 0], wall[:, 1]))
        for number, level in enumerate(LEVELS):
            k = int(np.argmin(abs(states.load - level / LEVELS[-1])))
            ranges = []
            for far in (volume[k][rim >= distance - 1e-9] for distance in AWAY):
                share = 100 * np.mean(abs(far - 1) <= 0.02)
                ranges.append(f"{share:.0f} % ({far.min():.4g} to {far.max():.4g})")
            for program, values in right.items():
                truth = np.array(values)[:, number]
                off = 100 * (found[k] - truth) / abs(truth)
                # what symmetry makes zero has no relative difference
                none = abs(truth) < 1e-9 * abs(truth).max()
                shown = ["" if zero else f"{one:+.2g}" for one, zero in zip(off, none, strict=True)]
                yield name, f"{level:g}", program, *shown, f"{abs(off[~none]).max():.2g}", *ranges


#: Points across the thinnest direction, and the bodies: size, far end, probes by name
ACROSS = range(4, 13)
_BODIES: dict[str, tuple[tuple[float, ...], dict[str, Any], dict[str, Any]]] = {
    "cube between plates": (
        (1.0, 1.0, 1.0),
        held("z1", u_z=-0.1),
        {"bulge": ("u_x", (1.0, 0.5, 0.5)), "force": ("z", "z1")},
    ),
    "block pulled": (
        (2.0, 1.0),
        held("x1", 2, u_x=0.4),
        {"neck": ("u_y", (1.0, 1.0)), "force": ("x", "x1")},
    ),
    "plate bent": (
        (6.0, 1.0),
        {"set": "x1", "traction": [0.0, 0.05]},
        {"tip": ("u_y", (6.0, 0.5)), "way in": ("u_x", (6.0, 0.5))},
    ),
    "column leaning": (
        (3.0, 1.0),
        {"set": "x1", "traction": [-0.4, 0.15]},
        {"lean": ("u_y", (3.0, 0.5)), "shortening": ("u_x", (3.0, 0.5))},
    ),
}
#: Elements across a plane body, and across an eighth of the cube
_FINE = {2: (16, 24), 3: (4, 6)}


def across() -> Rows:
    """Errors by the number of points across a body, and where they rise.

    Default form on even points, shear modulus 10. Errors [%] against finite elements graded towards
    the rims (in brackets the change from a coarser mesh), and how many times that of one point less
    they are, where both are above that change; rises: numbers of points where that is above 1.2.
    """
    yield "body", "K/mu", "probe", "truth", *map(str, ACROSS), "rises"
    for name, (size, far, wanted) in _BODIES.items():
        near = held("x0", 2) if len(size) == 2 else held("z0")
        for ratio in (30, 1000):
            law = {"name": "m", "model": "neo-hookean", "mu": 10.0, "K": 10.0 * ratio}
            tables = deck(name, _box(size), (law,), (near, far), _probes(wanted))
            errors: dict[str, list[float]] = {key: [] for key in wanted}
            truths = _graded(tables) if len(size) == 2 else _eighth(law)
            for n in ACROSS:
                source = [1 + round(edge * (n - 1)) for edge in size]
                with Scene.from_tables(sized_tables(tables, source), threads=1) as scene:
                    states = scene.solve(error=False)
                    values = scene.probes(states.x[-1:], states.load[-1:])[-1, :, 0]
                for key, value in zip(wanted, values, strict=True):
                    errors[key].append(100 * (value / truths[key][0] - 1))
            for key, own in errors.items():
                doubt = 100 * abs(truths[key][1] / truths[key][0])
                cells, rises = [f"{own[0]:+.2g}"], []
                for n, before, now in zip(ACROSS[1:], own, own[1:], strict=False):
                    grown = abs(now / before)
                    known = min(abs(now), abs(before)) > doubt
                    cells.append(f"{now:+.2g}" + (f" ({grown:.2g})" if known else ""))
                    if known and grown > 1.2:
                        rises.append(str(n))
                yield (name, str(ratio), key, f"{truths[key][0]:.5g} ({doubt:.1g} %)", *cells,
                       ", ".join(rises))  # fmt: skip


def _box(size: tuple[float, ...]) -> dict[str, Any]:
    return {"kind": "box", "size": list(size)}


def _probes(wanted: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        probe(key, quantity, at) if quantity.startswith("u") else force(key, quantity, at)
        for key, (quantity, at) in wanted.items()
    ]


def _graded(tables: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """Values of a plane body's probes, and their changes from a coarser mesh."""
    size = np.array(tables["geometry"]["size"])

    def to_ends(x: F64) -> F64:
        # elements at the ends are a tenth as long as they would be
        return np.asarray(x - 0.9 * size * np.sin(2 * np.pi * x / size) / (2 * np.pi))

    return _fine(tables, [[2 * round(n * e / 2) for e in size] for n in _FINE[2]], to_ends)


def _eighth(law: dict[str, Any]) -> dict[str, tuple[float, float]]:
    """The same of the cube, by an eighth of it that begins at its centre."""
    planes = [{"set": f"{axis}0", f"u_{axis}": 0.0} for axis in "xyz"]
    wanted = {"bulge": ("u_x", (0.5, 0.0, 0.0)), "force": ("z", "z1")}
    boundary = (*planes, held("z1", u_z=-0.05))
    tables = deck("eighth", _box((0.5, 0.5, 0.5)), (law,), boundary, _probes(wanted))

    def to_rim(x: F64) -> F64:
        return np.asarray(x + 0.4 * np.sin(2 * np.pi * x) / np.pi)

    found = _fine(tables, [[n] * 3 for n in _FINE[3]], to_rim)
    return {**found, "force": (4.0 * found["force"][0], 4.0 * found["force"][1])}


def _fine(
    tables: dict[str, Any], meshes: list[list[int]], warp: Warp
) -> dict[str, tuple[float, float]]:
    """Values of probes on the last mesh, and their changes from the first."""
    whole = read_deck(sized_tables(tables, [2] * len(meshes[0])))
    coarse, fine = (solve_deck(whole, mesh, warp=warp, symmetric=True)["probes"] for mesh in meshes)
    return {key: (fine[key][-1], abs(fine[key][-1] - coarse[key][-1])) for key in fine}
