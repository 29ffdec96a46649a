"""Speed against error: orders, supports, formulations and sizes; each point a solve in this run.

The tube is compared with the exact solution and with felupe's mixed finite elements; the muscle
blocks with converged finite elements (inclined fibers, the references of the deck) and with the
exact state far from the ends (straight fibers).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from myork.bench.runs import INPUTS, outcome_text, solve_case
from myork.console import ProgressCallback
from myork.core.deck import load_deck
from myork.reference import exact
from myork.reference.finite_elements import felupe_tube
from myork.reference.muscle import along_fibers

__all__ = ["Choice", "block_cases", "choice", "plot", "run", "seconds", "table", "tube_cases"]

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
_ELEMENTS = ((1, 2), (1, 4), (2, 8), (4, 16), (6, 24))
_BLOCK = ((2, 3.0, "rkcm"), (3, 4.0, "rkcm"), (2, 3.0, "rkcm-mixed"), (3, 4.0, "rkcm-mixed"))
_BLOCK_SIZES = ((4, 4, 7), (5, 5, 9), (6, 6, 11))


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all points of all curves; see `myork.bench` for the result."""
    limit = 60.0 if quick else 600.0
    tube = tube_cases(progress, _TUBE, _TUBE_SIZES[: 2 if quick else 4], limit)
    tube += _felupe(progress, _ELEMENTS[: 3 if quick else 5])
    sizes = _BLOCK_SIZES[: 1 if quick else 3]
    straight = block_cases(progress, "muscle_block", _BLOCK, sizes, limit)
    inclined = block_cases(progress, "muscle_fibers", _BLOCK, sizes, limit)
    return {
        "title": "Speed against error",
        "about": "Wall time of a whole solve with one thread, set-up included and output left "
        f"out. Points that did not converge are in the tables only. Tube: {_STEPS} load steps to "
        "the doubled radius, K = 1000.",
        "cases": [*tube, *straight, *inclined],
        "plots": [
            plot("Tube: radial stress at the inner surface", tube),
            plot("Muscle block, straight fibers: axial stress in the middle", straight),
            plot("Muscle block, fibers inclined 30°: largest error of six probes", inclined),
        ],
        "tables": [
            table("Tube.", tube),
            table("Muscle block, straight fibers, activation 0.15.", straight),
            table("Muscle block, inclined fibers, up to activation 0.15.", inclined),
        ],
    }


def tube_cases(
    progress: ProgressCallback,
    choices: Sequence[Choice],
    sizes: Sequence[tuple[int, int]],
    limit: float,
) -> list[dict[str, Any]]:
    """Inflate the tube with each choice at each size; `error` is that of the inner radial stress.

    Parameters
    ----------
    progress : callable
        Called with every line of progress.
    choices : sequence of Choice
        One curve each.
    sizes : sequence of tuple of int
        Radial and angular source points.
    limit : float
        Wall time after which a solve is ended [s].
    """
    deck = load_deck(INPUTS / "tube.toml", [])
    rubber = exact.Polynomial.from_deck(deck["material"][0])
    solution = float(exact.tube(rubber, 6.0, 8.0, 6.0).radial[0])
    cases = []
    for number, (order, support, method) in enumerate(choices):
        progress(f"tube {number + 1}/{len(choices)}  order {order}, {support:g} h, {method}")
        for radial, angular in sizes:
            case = solve_case(
                "tube",
                [
                    f"geometry.source=[{radial},{angular}]",
                    f"geometry.collocation=[{2 * radial - 1},{2 * angular - 1}]",
                    *choice((order, support, method)),
                    f"load.steps={_STEPS}",
                ],
                limit=limit,
            )
            case |= {"curve": f"{method}, order {order}, {support:g} h", "solution": solution}
            case["size"] = f"{radial} x {angular}"
            if case["outcome"] == "converged":
                case["error"] = abs(case["probes"]["radial_stress"] / solution - 1.0)
            cases.append(case)
    return cases


def _felupe(
    progress: ProgressCallback, elements: tuple[tuple[int, int], ...]
) -> list[dict[str, Any]]:
    """Points of the rival; a first, unmeasured solve loads and compiles what it needs."""
    deck = load_deck(INPUTS / "tube.toml", [])
    material, geometry = deck["material"][0], deck["geometry"]
    solution = float(exact.tube(exact.Polynomial.from_deck(material), 6.0, 8.0, 6.0).radial[0])
    progress("felupe")
    felupe_tube((1, 2), material, geometry, 2)
    cases = []
    for size in elements:
        case = felupe_tube(size, material, geometry, _STEPS)
        case |= {"curve": "felupe, mixed Q2", "size": f"{size[0]} x {size[1]} elements"}
        case |= {"outcome": "converged", "message": "", "rival": True, "solution": solution}
        case["error"] = abs(case["value"] / solution - 1.0)
        cases.append(case)
    return cases


def block_cases(
    progress: ProgressCallback,
    name: str,
    choices: Sequence[Choice],
    sizes: Sequence[tuple[int, int, int]],
    limit: float,
) -> list[dict[str, Any]]:
    """Contract a block to activation 0.15 with each choice at each size that its order can fill.

    Parameters
    ----------
    progress : callable
        Called with every line of progress.
    name : str
        `muscle_block` (`error` against the exact state far from the ends) or `muscle_fibers`
        (the largest against the references of the deck).
    choices : sequence of Choice
        One curve each.
    sizes : sequence of tuple of int
        Source points.
    limit : float
        Wall time after which a solve is ended [s].
    """
    cases = []
    for number, (order, support, method) in enumerate(choices):
        progress(f"{name} {number + 1}/{len(choices)}  order {order}, {support:g} h, {method}")
        for size in sizes:
            if any(n <= order + 1 for n in size):
                continue
            overrides = [
                f"geometry.source=[{','.join(str(n) for n in size)}]",
                f"geometry.collocation=[{','.join(str(2 * n - 1) for n in size)}]",
                *choice((order, support, method)),
                "load.activation=0.15",
                "load.steps=6",
            ]
            case = solve_case(name, overrides, limit=limit)
            case |= {"curve": f"{method}, order {order}, {support:g} h"}
            case["size"] = " x ".join(str(n) for n in size)
            if case["outcome"] == "converged":
                case["error"] = _block_error(case, name, overrides)
            cases.append(case)
    return cases


def _block_error(case: dict[str, Any], name: str, overrides: list[str]) -> float:
    """Error against the exact state of straight fibers, or the largest against references."""
    if name == "muscle_block":
        deck = load_deck(INPUTS / f"{name}.toml", overrides)
        exact_stress = along_fibers(deck["material"][0], 1.0, deck["load"]["activation"])
        return abs(case["probes"]["stress_zz"] / exact_stress - 1.0)
    return max(max(entry["relative_error"]) for entry in case["reference"].values())


def choice(wanted: Choice) -> list[str]:
    """Overrides for a choice.

    A linear basis gets the cubic spline, as in section 4.2 of Basava (2015), and the two Gauss
    points a direction that are enough for it.
    """
    order, support, method = wanted
    linear = ["approximation.kernel=cubic", "galerkin.gauss=2"] if order == 1 else []
    return [
        f"approximation.order={order}",
        f"approximation.support={support}",
        f"scene.method={method}",
        *linear,
    ]


def seconds(case: Mapping[str, Any]) -> float:
    """Wall time without the output of files."""
    timings = case.get("timings_s")
    return float(timings["total"] - timings["output"] if timings else case["seconds"])


def plot(title: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Curves of error over time, one for each `curve` of the cases."""
    series = []
    for name in dict.fromkeys(case["curve"] for case in cases):
        points = [case for case in cases if case["curve"] == name and "error" in case]
        if points:
            series.append(
                {
                    "name": name,
                    "x": [seconds(case) for case in points],
                    "y": [case["error"] for case in points],
                    "rival": points[0].get("rival", False),
                }
            )
    return {"title": title, "x": "wall time [s]", "y": "relative error [-]", "series": series}


def table(caption: str, cases: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """All cases with outcome, error and time."""
    head = ["curve", "size", "outcome", "unknowns", "error", "iterations", "time [s]"]
    rows = [
        [
            case["curve"],
            case["size"],
            outcome_text(case),
            case.get("dofs"),
            case.get("error"),
            case.get("iterations"),
            seconds(case),
        ]
        for case in cases
    ]
    return {"caption": caption, "head": head, "rows": rows}
