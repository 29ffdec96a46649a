"""Collocation by balances of nodal cells: rates, pressures, load steps, time.

Manufactured solutions in the plane and in space give the orders of displacement and stress. The
pressures are stable where the smallest eigenvalue of their Schur complement over the volumes of
their patches does not fall with the spacing. Loads are tried in one step each, larger ones until
none converges, beside the Galerkin form on the same points; the time of a step is that of Newton's
on a bar of 33 x 9 x 9 points.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.bench.runs import outcome_text, solve_case
from myork.bench.tables import Columns, table
from myork.bench.truths import lattice_text
from myork.console import ProgressCallback
from myork.core.scene import Scene
from myork.reference.manufactured import Problem, solve
from myork.reference.materials import MUSCLE
from myork.reference.measures import observed_order

__all__ = ["run", "volume_constraint"]

_METHOD = "rkcm-subdomain"
#: Support of each order, as decks have it
_SUPPORT = {1: 2.5, 2: 2.6, 3: 4.0, 4: 5.5}
#: Bulk moduli left and right [stress], the growth of volume that keeps their pressures near the
#: shear modulus, and the faces whose displacement is prescribed: with more growth or less held the
#: body is not stable under its dead loads
_BULK = {"500": (500.0, 500.0), "inf": (np.inf, np.inf), "500 to 2500": (500.0, 2500.0)}
_GROWTH = 0.05
_HELD = {2: ("x0", "x1", "y0"), 3: ("x0", "x1", "y0", "y1", "z0")}
_ACTIVATIONS = (0.15, 0.3, 0.6, 1.0)
_RATES: Columns = (
    ("dimension", "dimension"),
    ("order", "order"),
    ("K", "bulk"),
    ("jitter", "jitter"),
    ("points an edge", "source_per_edge"),
    ("outcome", "outcome"),
    ("error of u", "u_error"),
    ("its order", "u_order"),
    ("error of stress", "stress_error"),
    ("its order", "stress_order"),
    ("iterations", "iterations"),
    ("why there is none", "message"),
)
_VOLUME: Columns = (
    ("order", "order"),
    ("points", "size"),
    ("smallest eigenvalue", "smallest"),
    ("condition of the whole matrix", "condition"),
)
_STEPS: Columns = (
    ("problem", "problem"),
    ("form", "form"),
    ("largest load in one step", "largest"),
    ("iterations there", "most iterations"),
    ("iterations at the first", "iterations"),
    ("smallest J", "min_J"),
    ("largest J", "max_J"),
)
_SPEED: Columns = (
    ("form", "form"),
    ("unknowns", "dofs"),
    ("outcome", outcome_text),
    ("iterations", "iterations"),
    ("assembly a step [s]", "assembly"),
    ("solution a step [s]", "solution"),
    ("all [s]", "cpu_s"),
)
_FORMS = {
    **{
        f"{_METHOD}, order {order}": (f"scene.method={_METHOD}", f"approximation.order={order}")
        for order in (2, 3, 4)
    },
    f"{_METHOD}, order 3, local bulk 1": (f"scene.method={_METHOD}", "subdomain.local_bulk=1"),
    **{
        f"rkpm-gauss, order {order}": ("scene.method=rkpm-gauss", f"approximation.order={order}")
        for order in (1, 2)
    },
}


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run all four; see `myork.bench` for the result."""
    rates = _rates(progress, quick)
    volumes = [
        {"order": order, "size": lattice_text((2 * n - 1, n)), **volume_constraint(order, n)}
        for order in _SUPPORT
        for n in ((5, 7) if quick else (5, 7, 9, 13))
    ]
    steps = _steps(progress, quick)
    speeds = _speeds(progress, quick)
    tables = (
        ("Manufactured solutions: relative errors, order between the last two sizes", _RATES),
        ("Pressures of a body of 2 x 1 that is held at one end, K = 1e5 shear moduli", _VOLUME),
        (
            "Loads in one step: iterations and J at the first one, the largest that converges",
            _STEPS,
        ),
        ("Time of a step", _SPEED),
    )
    groups = (rates, volumes, steps, speeds)
    return {
        "title": "Balances of nodal cells",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": [*rates, *volumes, *steps, *speeds],
        "tables": [
            table(caption, columns, cases)
            for (caption, columns), cases in zip(tables, groups, strict=True)
        ],
    }


def _rates(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Manufactured solutions on lattices and on moved points."""
    found = []
    for nd in (2,) if quick else (2, 3):
        for order, support in _SUPPORT.items():
            for name, bulk in _BULK.items():
                for jitter in (0.0, 0.2):
                    progress(f"{nd}-D, order {order}, K = {name}, jitter {jitter:g}")
                    problem = Problem(
                        f"{nd}-D, order {order}",
                        nd,
                        bulk,
                        order,
                        support,
                        (),
                        _HELD[nd],
                        _GROWTH,
                    )
                    sizes = ((5, 7, 9) if order < 4 else (7, 9)) if nd == 3 else (9, 17, 25)
                    own: list[dict[str, Any]] = []
                    for n in sizes[:2] if quick else sizes:
                        case = solve(problem, _METHOD, n, [f"geometry.jitter={jitter}"])
                        own.append({**case, "problem": problem.name, "bulk": name})
                        own[-1]["jitter"] = jitter
                        if all("u_error" in case for case in own[-2:]) and len(own) > 1:
                            for what in ("u", "stress"):
                                own[-1][f"{what}_order"] = observed_order(own, f"{what}_error")
                    found += own
    return found


def _bar(nd: int, source: Sequence[int], bulk: float, traction: float) -> dict[str, Any]:
    """Deck of a bar that is held at one end and pulled aside at the other."""
    return {
        "title": "Bar",
        "scene": {"dimension": nd},
        "geometry": {
            "kind": "box",
            "size": [4, 1, 1][:nd],
            "source": list(source),
            "collocation": list(source),
        },
        "material": [{"name": "rubber", "model": "neo-hookean", "mu": 1.0, "K": bulk}],
        "boundary": [
            {"set": "x0", **{f"u_{axis}": 0 for axis in "xyz"[:nd]}},
            {"set": "x1", "traction": [0.0, traction, 0.0][:nd]},
        ],
        "load": {"steps": 1, "max_halvings": 0},
    }


def volume_constraint(order: int, n: int) -> dict[str, float]:
    """Smallest eigenvalue of the pressures' Schur complement, and condition of the whole matrix.

    Parameters
    ----------
    order : int
        Order of the displacement.
    n : int
        Odd number of source points across a body of 2 x 1, held at one end.

    Returns
    -------
    dict
        `smallest`, by magnitude, over patch volumes; `least`, the smallest real part; `condition`.
    """
    tables = _bar(2, (2 * n - 1, n), 1e5, 0.0)
    tables["scene"]["method"] = _METHOD
    tables["geometry"]["size"] = [2, 1]
    tables["approximation"] = {"order": order}
    with Scene.from_tables(tables, threads=1) as scene:
        rest = np.zeros(scene.dofs)
        columns = [scene.linearise(rest, 1.0, one)[1] for one in np.eye(scene.dofs)]
    matrix = np.stack(columns, axis=1)
    u = 2 * n * (2 * n - 1)
    # rows and columns of pressures are scaled by the modulus over the spacing, h and mu = 1
    spacing = 1.0 / (n - 1)
    schur = matrix[u:, :u] @ np.linalg.solve(matrix[:u, :u], matrix[:u, u:]) * spacing**2
    edges = [np.full(k, span / (k - 1)) for k, span in ((n, 2.0), ((n + 1) // 2, 1.0))]
    for edge in edges:
        edge[[0, -1]] /= 2
    values = np.linalg.eigvals(schur / np.outer(*edges).reshape(-1, 1))
    return {
        "smallest": float(np.abs(values).min()),
        "least": float(values.real.min()),
        "condition": float(np.linalg.cond(matrix)),
    }


def _beam(load: float, points: Sequence[int]) -> dict[str, Any]:
    return _bar(2, points, 1e5, load)


def _block(load: float, points: Sequence[int]) -> dict[str, Any]:
    tables = _bar(3, points, 5e3, 0.0)
    tables["geometry"]["size"] = [1, 1, 2]
    tables["material"] = [{**MUSCLE, "curve": "smooth", "fiber": [0.5, 0, 0.75**0.5]}]
    tables["boundary"] = [{"set": face, "u_x": 0, "u_y": 0, "u_z": 0} for face in ("z0", "z1")]
    tables["load"]["activation"] = load
    return tables


def _steps(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Largest loads of a beam and of a block with inclined fibers, in one step each."""
    beams = 0.0125 * 2.0 ** np.arange(2 if quick else 7)
    found = []
    for name, deck, points, loads in (
        ("beam 4 x 1, traction in mu", _beam, (17, 5) if quick else (33, 9), beams),
        ("inclined block, activation", _block, (5, 5, 9), (0.15,) if quick else _ACTIVATIONS),
    ):
        for form, words in _FORMS.items():
            progress(f"{name}: {form}")
            case: dict[str, Any] = {"problem": name, "method": form, "form": form}
            for load in loads:
                solved = solve_case(deck(float(load), points), words, limit=300.0)
                if solved["outcome"] != "converged":
                    break
                case |= {"largest": float(load), "most iterations": solved["iterations"]}
                if load == loads[0]:
                    case |= {what: solved[what] for what in ("iterations", "min_J", "max_J")}
            found.append(case)
    return found


def _speeds(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """A bar in space, K = 1e5, by forms in one run."""
    tables = _bar(3, (9, 3, 3) if quick else (33, 9, 9), 1e5, 0.005)
    found = []
    for form, words in _FORMS.items():
        if "order 4" in form or "local" in form:
            continue
        progress(f"time of a step: {form}")
        case = solve_case(tables, words, limit=1200.0)
        found.append({"problem": "bar", "form": form, **case, **_per_step(case)})
    return found


def _per_step(case: Mapping[str, Any]) -> dict[str, float]:
    if not case.get("iterations") or "timings_s" not in case:
        return {}
    timings = case["timings_s"]
    return {
        "assembly": timings["assemble"] / case["iterations"],
        "solution": timings["solve"] / case["iterations"],
    }
