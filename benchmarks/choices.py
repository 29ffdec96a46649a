"""Small tables of docs/: how settings of a method change its error, its iterations or its cost.

    python benchmarks/choices.py [NAME...]

NAME is one of the functions below, all of them without one. Each prints one table of a page as
Markdown, with the version above it. One thread; processor times include the set-up of the scene.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from truths.finite_elements import solve_half_block  # type: ignore[import-not-found]

import myork
from myork import Scene
from myork.bench import exact
from myork.bench.materials import RUBBER
from myork.core.deck import load_deck
from myork.errors import MyorkError

INPUTS = Path(__file__).parents[1] / "inputs"
Row = list[str]


def show(head: Sequence[str], rows: Iterator[Row]) -> None:
    """Print a table row by row."""
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for row in rows:
        print(f"| {' | '.join(row)} |", flush=True)
    print()


def solved(deck: Any, *overrides: str) -> tuple[Any, dict[str, Any], float]:
    """States, probes of the last one by name, and processor time of a scene [s]."""
    before = time.process_time()
    opened = Scene.from_tables if isinstance(deck, dict) else Scene
    with opened(deck, overrides=list(overrides), threads=1) as scene:
        states = scene.solve(error=False)
        values = scene.probes(states.x, states.load)[-1]
        names = [probe["name"] for probe in scene.deck["probe"]]
    spent = time.process_time() - before
    return states, dict(zip(names, values[:, 0], strict=True)), spent


def walls() -> None:
    """Stresses on the walls of a tube, and its force, by settings of the Galerkin form."""
    radii, half = (6.0, 8.0), 2**-0.5
    deck: dict[str, Any] = {
        "scene": {"dimension": 2, "method": "rkpm-gauss"},
        "geometry": {"kind": "annulus", "inner_radius": radii[0], "outer_radius": radii[1]},
        "material": [{**RUBBER, "K": 1e3}],
        "boundary": [
            {"set": "x0", "u_x": 0.0},
            {"set": "y0", "u_y": 0.0},
            {"set": "inner", "radial": 6.0},
        ],
        "probe": [
            {"name": f"{stress} {angle}", "quantity": f"cauchy_{stress}", "point": place}
            for stress, radius in zip(("rr", "tt"), radii, strict=True)
            for angle, place in (
                ("at", [radius, 0.0]),
                ("between", [half * radius, half * radius]),
            )
        ]
        + [{"name": "force", "quantity": "force_x", "set": "x0"}],
    }
    found = exact.tube(exact.Polynomial.from_deck(RUBBER, 1e3), *radii, 6.0, list(radii))
    hoop = found.radius[1] / radii[1]
    material = exact.Polynomial.from_deck(RUBBER, 1e3)
    stretch, pressure = 1.0 / hoop, 0.0
    for _ in range(50):  # nothing pulls at the outer wall
        stress = material.isochoric(np.array([stretch, hoop, 1.0]))
        pressure = -stress[0] / hoop
        stretch = (1.0 + pressure / 1e3) / hoop
    truth = {"rr": float(found.radial[0]), "tt": float(stress[1] / stretch + pressure)}

    def rows() -> Iterator[Row]:
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
            cells = []
            for source in ([5, 26], [9, 51], [17, 101]):
                deck["geometry"] |= {"source": source, "collocation": [2 * n - 1 for n in source]}
                deck["approximation"] = {
                    "order": order, "support": support, "kernel": kernel, "window": window,
                }  # fmt: skip
                deck["galerkin"] = {"gauss": gauss, "penalty": float(penalty)}
                _, values, spent = solved(deck)
                off = {
                    name: 100 * abs(value / truth[name[:2]] - 1)
                    for name, value in values.items()
                    if name != "force"
                }
                at, between = (
                    ", ".join(f"{off[f'{stress} {angle}']:.2g}" for stress in ("rr", "tt"))
                    for angle in ("at", "between")
                )
                cut = 100 * abs(values["force"] / (truth["rr"] * 12.0) - 1)
                cells.append(f"{at}; {between}; {cut:.1g}; {spent:.2f}")
            yield [f"{order}, {support}, {kernel}, {window}, {gauss}, {penalty}", *cells]

    head = "order, support, kernel, window, Gauss points, penalty"
    show((head, "5x26", "9x51", "17x101"), rows())


def bulk() -> None:
    """Inner stress of the tube and iterations for large and infinite K."""

    def rows() -> Iterator[Row]:
        for k in ("1e3", "1e5", "1e8", "inf"):
            cells = []
            for method in ("rkpm-gauss", "rkpm-scni"):
                words = f"scene.method={method}", f"material.K={k}", "load.steps=12"
                free = "approximation.order=1", "approximation.support=2"
                kernel = "approximation.kernel=cubic", "galerkin.gauss=2"
                states, values, spent = solved(INPUTS / "tube.toml", *words, *free, *kernel)
                cells += [f"{values['radial_stress']:.5f}", f"{iterations(states)}, {spent:.1f}"]
            yield [k, *cells]

    print(f"quadrature at infinite K: {quadrature():.5f}\n")
    head = ("K", "Gauss points", "iterations, CPU [s]", "nodal cells", "iterations, CPU [s]")
    show(head, rows())


def quadrature() -> float:
    """Radial stress on the inner wall of the deck's tube where the volume is kept."""
    with Scene(INPUTS / "tube.toml") as scene:
        return float(exact.inner_stress(scene.deck, float("inf")))


def iterations(states: Any) -> int:
    """Iterations of all steps."""
    return int(np.sum(states.iterations))


def newton() -> None:
    """Iterations of all load steps by Gauss-Newton, Newton and what `auto` makes of them."""
    block = (
        "geometry.source=[4,4,7]",
        "geometry.collocation=[7,7,13]",
        "approximation.order=3",
        "approximation.support=4",
    )
    cases = (
        ("uniaxial tension to 6, `rkcm`", "uniaxial_tension", ("scene.method=rkcm",)),
        ("shear in the plane, `rkcm`", "shear_2d", ("scene.method=rkcm",)),
        ("tube, `rkcm`", "tube", ()),
        ("tube, `rkcm-mixed`", "tube", ("scene.method=rkcm-mixed",)),
        ("inclined block, order 3, 4x4x7, `rkcm-mixed`", "muscle_fibers", block),
    )

    def rows() -> Iterator[Row]:
        for name, deck, words in cases:
            row = [name]
            for kind in ("gauss-newton", "full", "auto"):
                try:
                    states, *_ = solved(INPUTS / f"{deck}.toml", *words, f"solver.newton={kind}")
                    row.append(str(iterations(states)))
                except MyorkError:
                    row.append("no convergence")
            yield row

    show(("problem", "`gauss-newton`", "`full`", "`auto`"), rows())


def error_of(deck: str, *overrides: str) -> str:
    """Relative error of a linear problem in L2 at its end."""
    with Scene(INPUTS / f"{deck}.toml", overrides=list(overrides), threads=1) as scene:
        return f"{scene.solve(error=False).errors['relative_L2']:.1e}"


def own_loads() -> None:
    """Error of inputs/poisson_own.toml by the number of points."""

    def rows() -> Iterator[Row]:
        for n in (9, 17, 33):
            size = f"geometry.source=[{n},{n}]", f"geometry.collocation=[{2 * n - 1},{2 * n - 1}]"
            words = "approximation.order=2", *size
            found = (
                error_of("poisson_own", f"scene.method={method}", *words)
                for method in ("rkpm-gauss", "rkcm")
            )
            yield [f"{n} x {n}", *found]

    show(("source points", "`rkpm-gauss`", "`rkcm`"), rows())


def wave() -> None:
    """Error of inputs/wave_1d.toml at its end by the time step."""

    def rows() -> Iterator[Row]:
        for step in (0.2, 0.1, 0.05):
            words = [f"dynamics.time_step={step}"]
            found = (
                error_of("wave_1d", f"scene.method={method}", *words)
                for method in ("rkcm", "rkpm-gauss")
            )
            yield [f"{step:g}", *found]

    show(("time step", "`rkcm`", "`rkpm-gauss`"), rows())


#: Activations of the inclined block, and distances from the edges at which J is judged [cm]
LEVELS, AWAY = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3), (0.25, 0.5)
LOAD = ("load.steps=6", "load.activation=0.3")


def mixed() -> None:
    """Mixed form of the inclined block: differences from finite elements [%], and J off its edges.

    FEBio's values are those of the deck, by the published curves; felupe solves half of the block
    with the curves of the deck. J: range, and the share of points within 2 % of 1.
    """

    def sized(n: int) -> tuple[str, ...]:
        source = [n, n, 2 * n - 1]
        places = [2 * k - 1 for k in source]
        return f"geometry.source={source}", f"geometry.collocation={places}"

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
        deck = load_deck(INPUTS / "muscle_fibers.toml", [*LOAD, *words])
        loads = [level / LEVELS[-1] for level in LEVELS]
        return list(solve_half_block(deck, (6, 3, 12), loads)["probes"].values())

    def rows() -> Iterator[Row]:
        for name, words in cases.items():
            with Scene(INPUTS / "muscle_fibers.toml", [*LOAD, *words], threads=1) as scene:
                references, places = scene.deck["reference"], scene.points()
                try:
                    states = scene.solve(error=False)
                except MyorkError:
                    yield [name, "not converged"]
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
                    shown = [f"{one:+.2g}" for one in off]
                    yield [name, f"{level:g}", program, *shown, f"{abs(off).max():.2g}", *ranges]

    names = ("u_x", "u_z", "stress zz", "xz", "R_x", "R_z", "largest")
    show(("form", "activation", "from", *names, *(f"J {d} off the edges" for d in AWAY)), rows())


TABLES: dict[str, Callable[[], None]] = {
    make.__name__: make for make in (walls, bulk, newton, own_loads, wave, mixed)
}


def main() -> None:
    """Print the tables that are named."""
    print(f"MyoRK {myork.__version__}\n")
    for name in sys.argv[1:] or TABLES:
        if name not in TABLES:
            sys.exit(f"no table {name!r}; there are {', '.join(TABLES)}")
        print(f"## {name}: {TABLES[name].__doc__}\n")
        TABLES[name]()


if __name__ == "__main__":
    main()
