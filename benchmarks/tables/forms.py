"""How settings of a form change its error, its iterations or its cost."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.runs import PUBLISHED_BLOCK
from benchmarks.truths.finite_elements import solve_half_block
from myork import Scene, run_deck
from myork.bench.runs import lattice
from myork.core.deck import load_deck
from myork.errors import ConvergenceError, MyorkError
from myork.files import INPUTS

#: The head of a table, then its rows
Rows = Iterator[tuple[str, ...]]


#: Activations of the inclined block, and distances from the edges at which J is judged [cm]
LEVELS, AWAY = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3), (0.25, 0.5)
LOAD = ("load.steps=6", "load.activation=0.3")
BLOCK = INPUTS / "muscle_fibers.toml"


def mixed() -> Rows:
    """Mixed form of the inclined block: differences from finite elements [%], and J off its edges.

    FEBio's values are those in the deck, computed with the published curves; felupe solves half of
    the block with the curves of the deck. J: range, and the share of points within 2 % of 1. The
    page has the largest difference of displacements, stresses and reactions at each activation, and
    J at the last one.
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


def solvers() -> Rows:
    """Each solver on the equations of the muscle block by collocation (docs/solvers.md).

    CPU seconds of the first iteration of a load step, and what the summary reports of it.
    """
    yield "solver", "s", "times `dgels`", "backward error", "distance", "condition"
    words = (*PUBLISHED_BLOCK, "scene.method=rkcm", "approximation.order=2",
             "approximation.support=3", "load.steps=10", "load.max_halvings=0",
             "solver.max_iterations=1")  # fmt: skip
    dgels = 0.0
    for name in ("dgels", "auto", "refined", "normal"):
        with TemporaryDirectory() as folder:
            with suppress(ConvergenceError):
                run_deck(INPUTS / "muscle_block.toml", folder, threads=1, error=False,
                         overrides=(*words, f"solver.linear={name}"))  # fmt: skip
            case = json.loads(Path(folder, "summary.json").read_text(encoding="utf-8"))
        said, times = case["solver"], case["timings_s"]
        # parts are wall times, of which the process had a share
        spent = case["cpu_s"] * times["solve"] / times["total"]
        dgels = dgels or spent
        found = (said["backward_error"], said["misfit"], said["reciprocal_condition"])
        yield f"`{name}`", f"{spent:.2f}", f"{dgels / spent:.1f}", *(f"{one:.3e}" for one in found)


def _largest(rows: list[list[str]]) -> list[list[str]]:
    """Largest difference at each activation, J at the last one, a row for each form and program."""
    head, *rows = rows
    shown = [["form", "from", *(f"largest at {level:g}" for level in LEVELS), *head[-len(AWAY) :]]]
    groups: dict[tuple[str, str], list[list[str]]] = {}
    for row in rows:
        # what did not converge has its outcome alone
        groups.setdefault((row[0], row[2] if len(row) > 2 else row[1]), []).append(row)
    for names, own in groups.items():
        largest = [row[head.index("largest")] for row in own if len(row) > 2]
        shown.append([*names, *largest, *(own[-1][-len(AWAY) :] if largest else [])])
    return shown


#: What the page of results shows
PIVOTS = {"mixed": _largest}
