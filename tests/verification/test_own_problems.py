"""Linear problems with loads of one's own: manufactured solutions, their orders of convergence."""

from typing import Any

import numpy as np
import pytest

from myork import Scene
from myork.errors import InputError

#: Source points along an edge in one to three dimensions
SIZES = {1: (9, 17, 33), 2: (7, 13, 25), 3: (5, 9)}
#: Solution, source and boundary values of problems whose coefficients vary. Derived by hand from
#: -div(k grad u) = f and -div(stress) = f
POISSON = {
    1: {"u": "sin(2*x)", "k": "1 + x", "f": "4*(1 + x)*sin(2*x) - 2*cos(2*x)"},
    2: {
        "u": "sin(2*x)*exp(y)",
        "k": "1 + x",
        "f": "(3*(1 + x)*sin(2*x) - 2*cos(2*x))*exp(y)",
    },
    3: {
        "u": "sin(2*x)*exp(y) + z^2",
        "k": "1 + x",
        "f": "(3*(1 + x)*sin(2*x) - 2*cos(2*x))*exp(y) - 2*(1 + x)",
    },
}
POISSON_FLUX = {1: "4*cos(2)", 2: "4*cos(2)*exp(y)", 3: "4*cos(2)*exp(y)"}


def box(dimension: int, points: int, method: str, **tables: Any) -> dict[str, Any]:
    """Tables of a unit box, second order."""
    return {
        "scene": {"dimension": dimension, "method": method},
        "geometry": {
            "kind": "box",
            "size": [1.0] * dimension,
            "source": [points] * dimension,
            "collocation": [2 * points - 1] * dimension,
        },
        "approximation": {"order": 2},
    } | tables


def sides(dimension: int, *, but: str) -> list[str]:
    """All sides of a box except one."""
    names = [f"{axis}{end}" for axis in "xyz"[:dimension] for end in "01"]
    return [name for name in names if name != but]


def poisson(dimension: int, points: int, method: str) -> dict[str, Any]:
    problem = POISSON[dimension]
    return box(
        dimension,
        points,
        method,
        linear={
            "problem": "poisson",
            "conductivity": problem["k"],
            "source": problem["f"],
            "exact": problem["u"],
        },
        boundary=[
            *({"set": side, "u": problem["u"]} for side in sides(dimension, but="x1")),
            {"set": "x1", "flux": POISSON_FLUX[dimension]},
        ],
    )


def elastic(dimension: int, points: int, method: str) -> dict[str, Any]:
    """u_i = s sin(x + i) of a body whose stiffness grows with x: a column of shear and tension.

    With l and m at E = 1, the stress is E(x) times (l + 2m, m, m) u', its divergence (E u')'.
    """
    ratio = 0.3
    mu = 0.5 / (1 + ratio)
    tension = 2 * mu * ratio / (1 - 2 * ratio) + 2 * mu if dimension > 1 else 1.0
    moduli = [tension, mu, mu][:dimension]
    exact = [f"0.01*sin(x + {i})" for i in range(dimension)]
    load = [f"{0.01 * c!r}*((1 + x)*sin(x + {i}) - cos(x + {i}))" for i, c in enumerate(moduli)]
    end = [f"{0.02 * c!r}*cos(x + {i})" for i, c in enumerate(moduli)]
    linear: dict[str, Any] = {"problem": "elasticity", "E": "1 + x", "source": load, "exact": exact}
    if dimension > 1:
        linear["nu"] = ratio
    values = {f"u_{axis}": exact[i] for i, axis in enumerate("xyz"[:dimension])}
    return box(
        dimension,
        points,
        method,
        linear=linear,
        boundary=[
            *({"set": side, **values} for side in sides(dimension, but="x1")),
            {"set": "x1", "traction": end},
        ],
    )


def relative_errors(tables: dict[str, Any]) -> tuple[float, float]:
    """Of values and of values with slopes."""
    with Scene.from_tables(tables) as scene:
        errors = scene.solve().errors
    return errors["relative_L2"], errors["relative_H1"]


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize(
    ("method", "bound", "rate"), [("rkpm-gauss", 3e-3, 2.5), ("rkcm", 0.1, 1.4)]
)
@pytest.mark.parametrize("problem", [poisson, elastic])
def test_own_problems_converge(
    problem: Any, method: str, bound: float, rate: float, dimension: int
) -> None:
    """Nearly order 3 of the Galerkin form, 1 to 2 of collocation with tractions on a side."""
    sizes = SIZES[dimension]
    found = [relative_errors(problem(dimension, n, method))[0] for n in sizes]
    slope = -np.polyfit(np.log(np.array(sizes) - 1.0), np.log(found), 1)[0]
    assert slope > rate, f"rate {slope:.2f} of {found}"
    assert found[-1] < bound


def test_a_polynomial_of_the_order_is_reproduced() -> None:
    """u = 1 + x + y^2 with k = 2 + x: the Galerkin form finds it to rounding."""
    tables = box(
        2,
        6,
        "rkcm",
        linear={
            "problem": "poisson",
            "conductivity": "2 + x",
            "source": "-1 - 2*(2 + x)",
            "exact": "1 + x + y^2",
        },
        boundary=[{"set": side, "u": "1 + x + y^2"} for side in ("x0", "x1", "y0", "y1")],
    )
    assert relative_errors(tables) == pytest.approx((0, 0), abs=1e-9)


def test_coefficients_that_jump_are_smoothed_for_collocation() -> None:
    """A bar of two stiffnesses, pulled: its end moves by F (L1/E1 + L2/E2), interpolated or not."""
    ends = {}
    for smoothing in (None, 3.0):
        tables = box(
            1,
            41,
            "rkpm-gauss",
            linear={"problem": "elasticity", "E": "x < 0.5 ? 1 : 4"},
            boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "traction": [0.01]}],
            probe=[{"name": "end", "quantity": "u_x", "point": [1.0]}],
        )
        if smoothing is not None:
            tables["linear"]["smoothing"] = smoothing
        with Scene.from_tables(tables) as scene:
            states = scene.solve()
            ends[smoothing] = scene.probes(states.x, states.load)[-1, 0, 0]
    assert ends[None] == pytest.approx(0.01 * (0.5 + 0.5 / 4), rel=5e-3)
    # the stiffness reaches over half the support, where the soft side gives less way
    assert ends[3.0] == pytest.approx(0.01 * (0.5 + 0.5 / 4), rel=5e-2)


def test_without_a_known_solution_there_are_bars_from_other_points() -> None:
    tables = poisson(2, 13, "rkpm-gauss")
    del tables["linear"]["exact"]
    tables["probe"] = [{"name": "middle", "quantity": "u", "point": [0.5, 0.5]}]
    with Scene.from_tables(tables) as scene:
        states = scene.solve()
        found = scene.probes(states.x, states.load)[-1, 0, 0]
    assert states.errors == {}
    assert states.verdict == "accepted"
    error = abs(found - np.sin(1.0) * np.exp(0.5))
    assert error < states.probe_errors[-1, 0, 0] < 0.05


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"linear": {"E": 1}}, "linear.E: only for problem = elasticity; here problem = poisson"),
        ({"linear": {"source": ["1", "2"]}}, "linear.source: must have 1 item, one for each"),
        (
            {"linear": {"conductivity": "x - 0.5"}},
            "linear.conductivity: must be positive, not -0.5",
        ),
        ({"linear": {"conductivity": 0}}, "linear.conductivity: must be greater than 0, not 0"),
        (
            {"linear": {"solution": "sine"}},
            "boundary.x0: has no place in a linear problem with solution = sine",
        ),
        ({"boundary": [{"set": "x0", "u_x": 0}]}, "boundary.x0.u_x: is not known in a linear"),
        ({"boundary": [{"set": "x1", "flux": "1"}]}, "no value is prescribed anywhere: give u"),
        ({"linear": {"exact": "sqrt(x - 0.5)"}}, "linear.exact: 'sqrt(x - 0.5)' is not finite"),
    ],
)
def test_what_does_not_fit_is_refused(change: dict[str, Any], what: str) -> None:
    tables = poisson(2, 5, "rkpm-gauss")
    for name, content in change.items():
        tables[name] = tables[name] | content if isinstance(content, dict) else content
    if "solution" in tables["linear"]:
        for key in ("source", "exact", "conductivity"):
            del tables["linear"][key]
    with pytest.raises((InputError, RuntimeError)) as error, Scene.from_tables(tables) as scene:
        scene.solve()
    assert what in str(error.value)
