"""Speed against error: orders, supports, formulations and sizes; each point a solve in this run.

The tube is compared with the exact solution; the muscle blocks with converged finite elements
(inclined fibers, the references of the deck) and with the exact state far from the ends (straight
fibers). Finite elements beside both are in the benchmark `race` of a checkout.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from myork.bench import exact
from myork.bench.materials import along_fibers
from myork.bench.runs import PUBLISHED_BLOCK, lattice, read_deck, solve_case
from myork.bench.tables import speed_plot, speed_table
from myork.console import ProgressCallback

__all__ = ["Choice", "block_cases", "choice", "curve_name", "run", "sweep", "tube_cases"]

#: Order, support and method of a curve
Choice = tuple[int, float, str]

_STEPS = 12
_TUBE = (
    (2, 4.0, "rkcm"),
    (3, 5.0, "rkcm"),
    (4, 6.0, "rkcm"),
    (5, 7.0, "rkcm"),
    (6, 8.0, "rkcm"),
    (2, 3.0, "rkcm-mixed"),
    (2, 4.0, "rkcm-mixed"),
    (3, 5.0, "rkcm-mixed"),
    (4, 6.0, "rkcm-mixed"),
    (5, 7.0, "rkcm-mixed"),
    (6, 8.0, "rkcm-mixed"),
)
# The coarsest cloud whose supports an order can fill comes first
_TUBE_SIZES = ((5, 26), (7, 38), (9, 51), (13, 76))
_BLOCK = ((2, 3.0, "rkcm"), (3, 4.0, "rkcm"), (2, 3.0, "rkcm-mixed"), (3, 4.0, "rkcm-mixed"))
# Order 2 of each method
_QUICK_TUBE = (_TUBE[0], _TUBE[6])
_QUICK_BLOCK = (_BLOCK[0], _BLOCK[2])
_BLOCK_SIZES = ((4, 4, 7), (5, 5, 9), (6, 6, 11))


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all points of all curves; see `myork.bench` for the result."""
    limit = 60.0 if quick else 600.0
    tubes, blocks = (_QUICK_TUBE, _QUICK_BLOCK) if quick else (_TUBE, _BLOCK)
    tube = tube_cases(progress, tubes, _TUBE_SIZES[: 2 if quick else 4], limit)
    sizes = _BLOCK_SIZES[: 1 if quick else 3]
    straight = block_cases(progress, "muscle_block", blocks, sizes, limit)
    inclined = block_cases(progress, "muscle_fibers", blocks, sizes, limit)
    return {
        "title": "Speed against error",
        "about": "Wall time of a whole solve with one thread, set-up included and output left "
        f"out. Points that did not converge are in the tables only. Tube: {_STEPS} load steps to "
        "the doubled radius, K = 1000.",
        "cases": [*tube, *straight, *inclined],
        "plots": [
            speed_plot("Tube: radial stress at the inner surface", tube),
            speed_plot("Muscle block, straight fibers: axial stress in the middle", straight),
            speed_plot("Muscle block, fibers inclined 30°: largest error of six probes", inclined),
        ],
        "tables": [
            speed_table("Tube.", tube),
            speed_table("Muscle block, straight fibers, activation 0.15.", straight),
            speed_table("Muscle block, inclined fibers, up to activation 0.15.", inclined),
        ],
    }


def sweep(
    progress: ProgressCallback,
    deck: str,
    choices: Sequence[Choice],
    sizes: Sequence[Sequence[int]],
    overrides: Sequence[str],
    error: Callable[[dict[str, Any], list[str]], float],
    *,
    limit: float,
    thin: bool = False,
) -> list[dict[str, Any]]:
    """Solve a deck with each choice at each size.

    Parameters
    ----------
    progress : callable
        Called with every line of progress.
    deck : str
        Name of an installed deck.
    choices : sequence of Choice
        One curve each.
    sizes : sequence of sequence of int
        Source points along each edge.
    overrides : sequence of str
        Further overrides of the deck.
    error : callable
        `error` of a case that converged, from its record and its overrides.
    limit : float
        Wall time after which a solve is ended [s].
    thin : bool
        Also sizes with too few points along an edge to fill the supports of a choice in a box.
    """
    cases = []
    for number, wanted in enumerate(choices):
        progress(f"{deck} {number + 1}/{len(choices)}  {curve_name(wanted)}")
        for size in sizes:
            if min(size) <= wanted[0] + 1 and not thin:
                continue
            words = [*lattice(size), *choice(wanted), *overrides]
            case = solve_case(deck, words, limit=limit)
            case |= {"curve": curve_name(wanted), "size": " x ".join(str(n) for n in size)}
            if case["outcome"] == "converged":
                case["error"] = error(case, words)
            cases.append(case)
    return cases


def tube_cases(
    progress: ProgressCallback,
    choices: Sequence[Choice],
    sizes: Sequence[tuple[int, int]],
    limit: float,
) -> list[dict[str, Any]]:
    """Inflate the tube; `error` is that of the inner radial stress. Parameters as of `sweep`."""
    solution = exact.inner_stress(read_deck("tube"))

    def error(case: dict[str, Any], _: list[str]) -> float:
        return float(abs(case["probes"]["radial_stress"] / solution - 1.0))

    steps = (f"load.steps={_STEPS}",)
    return sweep(progress, "tube", choices, sizes, steps, error, limit=limit, thin=True)


def block_cases(
    progress: ProgressCallback,
    name: str,
    choices: Sequence[Choice],
    sizes: Sequence[tuple[int, int, int]],
    limit: float,
) -> list[dict[str, Any]]:
    """Contract a block to activation 0.15. Parameters as of `sweep`.

    The name is `muscle_block` (`error` against the exact state far from the ends) or
    `muscle_fibers` (the largest against the references of the deck).
    """

    def error(case: dict[str, Any], words: list[str]) -> float:
        if name == "muscle_block":
            deck = read_deck(name, words)
            wanted = along_fibers(deck["material"][0], 1.0, deck["load"]["activation"])
            return float(abs(case["probes"]["stress_zz"] / wanted - 1.0))
        return float(max(max(entry["relative_error"]) for entry in case["reference"].values()))

    contracted: tuple[str, ...] = ("load.activation=0.15", "load.steps=6")
    if name == "muscle_block":
        contracted += PUBLISHED_BLOCK
    return sweep(progress, name, choices, sizes, contracted, error, limit=limit)


def choice(wanted: Choice) -> list[str]:
    """Overrides for a choice.

    A linear basis gets the cubic spline, as in section 4.2 of Basava (2015), and the two Gauss
    points a direction that are enough for it; higher ones the quintic spline and three.
    """
    order, support, method = wanted
    kernel, gauss = ("cubic", 2) if order == 1 else ("quintic", 3)
    return [
        f"approximation.order={order}",
        f"approximation.support={support}",
        f"approximation.kernel={kernel}",
        f"galerkin.gauss={gauss}",
        f"scene.method={method}",
    ]


def curve_name(wanted: Choice) -> str:
    """Name of a choice beside others."""
    order, support, method = wanted
    return f"{method}, order {order}, {support:g} h"
