"""Manufactured solutions: displacement and stress in both formulations.

A large deformation is chosen; the required body force, `b = -Div P`, and the boundary values
are computed from it and prescribed. The material is active anisotropic muscle. In one case its
bulk modulus varies by a factor of five along X, as the program mixes two materials; the body
force then includes the gradient of the modulus.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.truths.compiled import shape_functions
from benchmarks.truths.deck_parts import held
from myork.core import material as core_material
from myork.core.scene import Scene
from myork.errors import MyorkError
from myork.types import F64

_ACTIVATION = 0.3
# Convex, unlike table 4.1 with its negative A01: the exact solution must be unique
_MUSCLE = {"A10": 6.43, "A01": 1.0, "A20": 0.94}
# Width of the transition between the materials; equal at all sizes, so that K(X) is [cm]
_INTERFACE = 1.0
_FIBER = {2: (0.6, 0.8, 0.0), 3: (0.48, 0.6, 0.64)}


class Problem(NamedTuple):
    """A manufactured problem on a unit square or cube."""

    name: str  #: Description
    dimension: int  #: 2 (plane strain) or 3
    bulk: tuple[float, float]  #: Bulk modulus far left and far right of X = 1/2 [stress]
    #: Basis and support over spacing
    order: int
    support: float


PROBLEMS = (
    Problem("2-D, order 2", 2, (500.0, 500.0), 2, 3.5),
    Problem("2-D, order 3", 2, (500.0, 500.0), 3, 4.5),
    Problem("2-D, order 4", 2, (500.0, 500.0), 4, 5.5),
    Problem("3-D, order 2", 3, (500.0, 500.0), 2, 3.5),
    Problem("3-D, order 2, K varies", 3, (500.0, 2500.0), 2, 3.5),
)


class _Exact(NamedTuple):
    """The chosen solution at points."""

    u: F64
    f: F64
    p: F64
    body_force: F64


def solve(problem: Problem, method: str, n: int, overrides: Sequence[str] = ()) -> dict[str, Any]:
    """Solve one problem.

    - `problem`: the problem
    - `method`: form. All but `rkcm` and `rkcm-mixed` begin near the solution: under such large dead
      loads the body has other equilibria, and the Galerkin forms need its whole surface prescribed.
    - `n`: source points along each edge; there are twice as many collocation points
    - `overrides`: `"table.key=value"` each
    - returns `outcome`, `h`, and of a solve that converged `u_error` and `stress_error` (relative,
      root mean square over the collocation points); otherwise `message`
    """
    case: dict[str, Any] = {"h": 1.0 / (n - 1), "outcome": "converged"}
    tables = _tables(problem, method, n)
    with Scene.from_tables(tables, overrides=overrides, threads=1) as scene:
        given = _exact(scene.field_points(), problem, n)
        scene.set_fields(given.body_force, given.u, given.p)
        exact = _exact(scene.points(), problem, n)
        try:
            squares = method in ("rkcm", "rkcm-mixed")
            start = None if squares else _beside(scene.dofs, problem, n)
            states = scene.solve(start=start)
        except MyorkError as error:
            return case | {"outcome": "not converged", "message": str(error)}
        fields = scene.fields(states.x[-1], 1.0)
    cauchy = exact.p @ np.swapaxes(exact.f, 1, 2) / np.linalg.det(exact.f)[:, None, None]
    voigt = cauchy[:, [0, 1, 2, 0, 1, 0], [0, 1, 2, 1, 2, 2]]
    return case | {
        "u_error": _relative(fields.u, exact.u),
        "stress_error": _relative(fields.cauchy, voigt),
    }


def _deformation(problem: Problem) -> Callable[[Any], Any]:
    """Deformed positions of undeformed ones, shape `(n, 3)`; works with complex numbers.

    A stretch along X with volume ratio `1 + 1.2 (X - 1/2)^2`, then volume-preserving shears along y
    and x, in space also along z and y.
    """

    def deform(x: NDArray[Any]) -> NDArray[Any]:
        y = np.empty(x.shape, x.dtype)
        y[:, 0] = x[:, 0] + 0.4 * (x[:, 0] - 0.5) ** 3 + 0.05
        y[:, 1] = x[:, 1] + 0.12 * np.sin(2.0 * y[:, 0])
        y[:, 2] = x[:, 2]
        y[:, 0] = y[:, 0] + 0.08 * np.cos(2.0 * y[:, 1])
        if problem.dimension == 3:
            y[:, 2] = y[:, 2] + 0.1 * np.sin(2.0 * y[:, 1] + y[:, 0])
            y[:, 1] = y[:, 1] + 0.06 * np.sin(2.0 * y[:, 2])
        return y

    return deform


def deformation_gradient(deform: Callable[[Any], Any], x: F64) -> F64:
    """Deformation gradient by complex steps, exact up to rounding, shape `(n, 3, 3)`."""
    f = np.empty((len(x), 3, 3))
    for a in range(3):
        moved = x.astype(complex)
        moved[:, a] += 1e-30j
        f[:, :, a] = deform(moved).imag / 1e-30
    return f


def _right_share(points: F64, n: int) -> tuple[F64, F64]:
    """Fraction of the right material and its gradient, as the program mixes materials.

    A source point has the material of its collocation point and of half of those beside it, a point
    on the border half of each. The fractions are the sums of its neighbours' functions of order 0,
    which are products over the directions: on a lattice, a fraction that is constant along y and z
    is a sum along x alone.
    """
    source = np.linspace(0.0, 1.0, n)[:, None]
    functions = shape_functions(source, _INTERFACE, np.ascontiguousarray(points[:, :1]), order=0)
    places = np.heaviside(np.arange(-1, 2 * n) - (n - 1), 0.5)
    right = np.convolve(places, (0.25, 0.5, 0.25), "valid")[::2][functions.neighbour]
    share = np.add.reduceat(functions.value[:, :2] * right[:, None], functions.offset[:-1])
    slope = np.zeros((len(points), 3))
    slope[:, 0] = share[:, 1]
    return share[:, 0], slope


def _bulk(points: F64, problem: Problem, n: int) -> tuple[F64, F64]:
    """Bulk modulus and its gradient."""
    left, right = problem.bulk
    if left == right:
        return np.full(len(points), left), np.zeros((len(points), 3))
    share, slope = _right_share(points, n)
    return left + share * (right - left), (right - left) * slope


def _exact(points: F64, problem: Problem, n: int) -> _Exact:
    """Solution, stress and body force at points."""
    deform = _deformation(problem)
    x = np.zeros((len(points), 3))
    x[:, : problem.dimension] = points
    law = core_material.Material(
        "muscle", problem.bulk[0], model="muscle", curve="smooth", **_MUSCLE
    )
    bulk, slope = _bulk(x, problem, n)

    def cofactor(f: F64) -> F64:
        return np.linalg.det(f)[:, None, None] * np.swapaxes(np.linalg.inv(f), 1, 2)

    def stress(at: F64) -> F64:
        """Stress at positions near the points, with the moduli of the points."""
        f = deformation_gradient(deform, at)
        p = core_material.stress(
            law, f, fiber=_FIBER[problem.dimension], activation=_ACTIVATION, volumetric=False
        )
        pressure = bulk * (np.linalg.det(f) - 1.0)
        return p + pressure[:, None, None] * cofactor(f)

    # central differences of sixth order: error below 1e-10 with this step
    step, weights = 2e-3, (3 / 4, -3 / 20, 1 / 60)
    f = deformation_gradient(deform, x)
    divergence = (np.linalg.det(f) - 1.0)[:, None] * np.einsum("piA,pA->pi", cofactor(f), slope)
    for a in range(problem.dimension):
        for k, weight in enumerate(weights, 1):
            shift = np.zeros(3)
            shift[a] = k * step
            divergence += weight * (stress(x + shift) - stress(x - shift))[:, :, a] / step
    return _Exact(deform(x) - x, f, stress(x), -divergence)


def _tables(problem: Problem, method: str, n: int) -> dict[str, Any]:
    """Deck of a unit square or cube, with two materials if the bulk modulus varies."""
    nd = problem.dimension
    # the chosen solution is smooth, so that rows near the edges have full weight
    tables: dict[str, Any] = {
        "title": "Manufactured solution",
        "scene": {"dimension": nd, "method": method},
        "approximation": {
            "order": problem.order,
            "support": problem.support,
            "interface": _INTERFACE * (n - 1),
        },
        # the other faces carry tractions
        "boundary": [held("x0", nd), held("x1", nd)],
        "load": {"steps": 1, "max_halvings": 0, "activation": _ACTIVATION},
        "solver": {"max_iterations": 60},
        "mixed": {"edge_exponent": 0},
    }
    tables["geometry"] = {
        "kind": "box",
        "size": [1] * nd,
        "source": [n] * nd,
        "collocation": [2 * n - 1] * nd,
    }
    muscle = {**_MUSCLE, "model": "muscle", "curve": "smooth", "fiber": list(_FIBER[nd])}
    left, right = problem.bulk
    tables["material"] = [{"name": "muscle", "K": left, **muscle}]
    if left != right:
        tables["material"].append({"name": "right", "K": right, "where": "x > 0.5", **muscle})
    return tables


def _beside(dofs: int, problem: Problem, n: int) -> F64:
    """Chosen displacement at the points of the lattice, with zero pressures."""
    nd = problem.dimension
    axis = np.linspace(0.0, 1.0, n)
    source = np.zeros((n**nd, 3))
    source[:, :nd] = np.stack(np.meshgrid(*[axis] * nd, indexing="ij"), axis=-1).reshape(-1, nd)
    start = np.zeros(dofs)
    start[: nd * len(source)] = (_deformation(problem)(source) - source)[:, :nd].ravel()
    return start


def _relative(value: F64, exact: F64) -> float:
    return float(np.linalg.norm(value - exact) / np.linalg.norm(exact))
