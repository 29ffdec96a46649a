"""Linear problems and motions by their properties: patch tests, orders, cantilevers, refusals.

Collocation (rkcm) and the Galerkin form (rkpm-gauss) use the same decks.
"""

import functools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork.core.scene import Scene
from myork.errors import MyorkError
from myork.results import Results
from myork.stations.solve import run_deck
from tests.scenes import box, explained, gripped, held, probes, refuses, scene, solved

#: Basis, support, Gauss points
LINEAR = {
    "approximation": {"order": 1, "support": 2.0, "kernel": "cubic"}, "galerkin": {"gauss": 2},
}  # fmt: skip
QUADRATIC = {
    "approximation": {"order": 2, "support": 2.5, "kernel": "cubic"}, "galerkin": {"gauss": 3},
}  # fmt: skip
POISSON = {"problem": "poisson"}
BAR = {"problem": "elasticity", "E": 3.0}
ELASTIC = {**BAR, "nu": 0.3}
STIFF = {**ELASTIC, "nu": 0.4999}
SIDES = ("x0", "x1", "y0", "y1", "z0", "z1")
SIZE = (1.0, 0.5, 2.0)
#: Gradients of polynomials (1 + a . x/size)^degree, those of a field starting at its number
DIRECTION = (0.7, -0.4, 0.5, 0.3, -0.6)


def derivative(nd: int, degree: int, field: int, *along: int) -> str:
    """A derivative of a component of the solution: of sines (degree 0) or of a polynomial."""
    order = [along.count(axis) for axis in range(nd)]
    if degree == 0:
        place = [f"(pi*({x} + {0.25 * field}))" for x in "xyz"[:nd]]
        turns = [(f"sin{at}", f"(pi*cos{at})", f"(-pi^2*sin{at})") for at in place]
        return "*".join(turn[k] for turn, k in zip(turns, order, strict=True))
    slope = [a / edge for a, edge in zip(DIRECTION[field : field + nd], SIZE, strict=False)]
    factor = math.perm(degree, len(along)) * math.prod(slope[axis] for axis in along)
    base = " + ".join(f"({a!r})*{x}" for a, x in zip(slope, "xyz", strict=False))
    return f"({factor!r})*(1 + {base})^{max(degree - len(along), 0)}"


def solution(
    nd: int, problem: dict[str, Any], degree: int, essential: Any, grows: bool
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """Tables of a problem with a known solution: its sources, and values or fluxes on sides.

    If `grows`, conductivity or Young's modulus are 1 + x times those of the problem.
    """
    axes = range(nd)
    u = functools.partial(derivative, nd, degree)
    if problem["problem"] == "poisson":
        fields, keys, load = range(1), ["u"], "flux"
        source = ["-(" + " + ".join(u(0, j, j) for j in axes) + ")"]
        flux = [[u(0, j)] for j in axes]
        grown = {"conductivity": "1 + x"}
    else:
        fields, keys, load = axes, [f"u_{axis}" for axis in "xyz"[:nd]], "traction"
        ratio = problem.get("nu", 0.0)
        mu = 0.5 * problem["E"] / (1 + ratio)
        lame = 2 * mu * ratio / (1 - 2 * ratio)
        source = [
            f"-{lame + mu!r}*({' + '.join(u(j, i, j) for j in axes)})"
            f" - {mu!r}*({' + '.join(u(i, j, j) for j in axes)})"
            for i in axes
        ]
        spread = f"{lame!r}*({' + '.join(u(j, j) for j in axes)})"
        shear = [[f"{mu!r}*({u(i, j)} + {u(j, i)})" for i in axes] for j in axes]
        flux = [
            [f"{spread} + {shear[j][i]}" if i == j else shear[j][i] for i in axes] for j in axes
        ]
        grown = {"E": f"{problem['E']!r}*(1 + x)"}
    if grows:
        source = [f"(1 + x)*({s}) - ({along})" for s, along in zip(source, flux[0], strict=True)]
        flux = [[f"(1 + x)*({part})" for part in row] for row in flux]
        problem = problem | grown
    values = dict(zip(keys, exact := [u(i) for i in fields], strict=True))
    boundary: list[dict[str, Any]] = []
    for k, side in enumerate(SIDES[: 2 * nd]):
        outward = [f"{'-+'[k % 2]}({part})" for part in flux[k // 2]]
        loads = {load: outward if load == "traction" else outward[0]}
        boundary.append({"set": side, **(values if side in essential else loads)})
    return {**problem, "source": source, "exact": exact}, boundary


def known(
    nd: int, problem: dict[str, Any], n: int = 6, method: str = "rkcm", essential: Any = SIDES,
    places: int = 11, degree: int = 0, grows: bool = False, **more: Any,
) -> dict[str, Any]:  # fmt: skip
    """A known solution in a box with unequal edges, prescribed on some sides."""
    geometry = box(*[n] * nd, size=SIZE[:nd], places=[places] * nd)
    linear, boundary = solution(nd, problem, degree, essential, grows)
    return scene(method, geometry, linear=linear, boundary=boundary) | more


def errors(deck: Any, *overrides: str) -> Any:
    return solved(deck, *overrides).states.errors


# ---- patch tests ---------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("order", [2, 3])
@pytest.mark.parametrize("grows", [False, True])
def test_polynomials_are_reproduced(dimension: int, order: int, grows: bool) -> None:
    """Polynomials of the order of the basis are solutions up to rounding, fluxes included."""
    tables = known(
        dimension, POISSON, essential=("x0",), degree=order, grows=grows,
        approximation={"order": order, "support": order + 1},
    )  # fmt: skip
    assert errors(tables)["relative_H1"] < 1e-10


@pytest.mark.parametrize("dimension", [1, 2, 3])
def test_functions_run_out_as_parabolas(dimension: int) -> None:
    """Functions of order 1 contain (1 + x)^2, up to the penalty; as natural splines they would
    leave 7.6e-3.
    """
    flux = {side: {"flux": "0"} for side in SIDES[2 : 2 * dimension]}
    sides = {"x0": {"u": "1"}, "x1": {"flux": "4"}, **flux}
    tables = scene(
        "rkpm-gauss", box(*[5] * dimension, size=[1] * dimension, places=[5] * dimension),
        linear={**POISSON, "source": "-2", "exact": "(1 + x)^2"}, galerkin={"penalty": 1e6},
        boundary=[{"set": side, **table} for side, table in sides.items()],
    )  # fmt: skip
    assert errors(tables)["relative_H1"] < 1e-7


@pytest.mark.parametrize("form", [LINEAR, QUADRATIC], ids=["linear", "quadratic"])
@pytest.mark.parametrize("essential", ["penalty", "transformation"])
@pytest.mark.parametrize(
    ("nd", "problem"), [*((nd, POISSON) for nd in (1, 2, 3)), (2, ELASTIC), (2, STIFF), (3, STIFF)]
)
def test_patch(nd: int, problem: Any, form: Any, essential: str) -> None:
    """A linear solution, prescribed on some sides and as tractions on the others; a nearly
    incompressible body amplifies rounding by its lambda over mu.
    """
    form = {**form, "galerkin": {**form["galerkin"], "essential": essential}}
    tables = known(nd, problem, 5, "auto", SIDES[: 2 * nd : 2], 5, 1, **form)
    with Scene.from_tables(tables) as opened:
        assert opened.deck["scene"]["method"] == "rkpm-gauss"
        assert errors(opened)["relative_H1"] < 1e-10


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize(
    ("method", "nu"), [("rkcm", 0.3), ("rkpm-gauss", 0.3), ("rkpm-gauss", -0.3)]
)
def test_elastic_patch(method: str, nu: float, dimension: int) -> None:
    """A linear displacement is exact, and its stress satisfies Hooke's law."""
    at = "0.4 0.2 1.1"[: 4 * dimension]
    tables = known(
        dimension, {**ELASTIC, "E": 250.0, "nu": nu}, method=method, essential=("x0", "y1"),
        degree=1, probe=probes(*(f"{axes} cauchy_{axes} {at}" for axes in ("xx", "xy", "zz"))),
    )  # fmt: skip
    found = solved(tables)
    assert found.states.errors["relative_H1"] < 1e-10
    grad = np.zeros((3, 3))
    for c in range(dimension):
        grad[c, :dimension] = np.array(DIRECTION[c : c + dimension]) / SIZE[:dimension]
    strain = (grad + grad.T) / 2
    stress = nu / (1 - 2 * nu) * np.trace(strain) * np.eye(3) + strain
    stress *= 250 / (1 + nu)
    near = 1e-9 * np.abs(stress).max()
    expected = stress[[0, 0, 2], [0, 1, 2]]
    assert list(found.last().values()) == pytest.approx(expected, rel=1e-9, abs=near)


def test_all_solvers_find_the_same_fit() -> None:
    """Rows are multiplied from both sides, dense, compressed or squared; residuals remain.

    They agree to 1e-14: rounding times the condition of the rows.
    """
    names = ("dgels", "spqr", "refined", "normal")
    fits = [solved(known(2, ELASTIC), f"solver.linear={name}").states.x[-1] for name in names]
    for name, fit in zip(names, fits, strict=True):
        assert_allclose(fit, fits[0], rtol=0, atol=1e-11 * abs(fits[0]).max(), err_msg=name)


# ---- orders --------------------------------------------------------------------------------------


@pytest.mark.parametrize(("deck", "sizes", "ratio", "words", "least", "fitted", "bound"), [
    # published sizes, support and weights: slightly less than the published rates, fitted
    # rates as measured with these shape functions, twice the errors measured on the finest grid
    ("poisson_1d", (10, 15, 20, 25, 30), 2, (), (3.0, 2.4), (3.03, 2.47), (2.8e-6, 5.4e-5)),
    ("poisson_2d", (10, 15, 20, 25, 30), 2, (), (3.0, 2.4), (3.35, 2.63), (7.2e-7, 3.2e-5)),
    # theory (5.18) is order + 1 in L2 and order in H1
    ("poisson_1d", (10, 15, 20, 25, 30), 4, (3, 4), (4, 3), (4.4, 3.5), (1.1e-8, 7e-7)),
    ("poisson_1d", (10, 15, 20, 25, 30), 4, (4, 5), (4, 3), (4.7, 4.1), (2e-10, 1.2e-8)),
    # far from the asymptotic range: only not below theory
    pytest.param("poisson_3d", (5, 6, 8), 0, (), (2.8, 1.8), None, (5e-3, 2.2e-2),
                 marks=pytest.mark.slow),
])  # fmt: skip
def test_rates_of_collocation(inputs, deck, sizes, ratio, words, least, fitted, bound):
    """L2 and H1 by ratio of collocation to source points per direction, 0 for half-way points."""
    nd, found = int(deck[-2]), []
    order = ["approximation.order={0}", "approximation.support={1}"] if words else []
    for n in sizes:
        points = (
            f"geometry.source={[n] * nd}",
            f"geometry.collocation={[ratio * n or 2 * n - 1] * nd}",
        )
        error = errors(inputs / f"{deck}.toml", *points, *(text.format(*words) for text in order))
        found.append([error["relative_L2"], error["relative_H1"]])
    slopes = -np.polyfit(np.log(np.array(sizes) - 1.0), np.log(found), 1)[0]
    assert np.all(slopes > np.array(least))
    assert fitted is None or np.allclose(slopes, fitted, rtol=0, atol=0.2)
    assert np.all(np.array(found[-1]) < bound)


@pytest.mark.parametrize(
    ("form", "least", "finest"), [(LINEAR, 1.9, 1e-2), (QUADRATIC, 2.9, 4e-3)], ids=["1", "2"]
)
@pytest.mark.parametrize(
    ("nd", "problem"), [(1, POISSON), (2, POISSON), (2, ELASTIC), (2, {**ELASTIC, "nu": 0.499})]
)
def test_orders(nd: int, problem: Any, form: Any, least: float, finest: float) -> None:
    """The error decreases with one order more than that of the basis."""
    found = [
        errors(known(nd, problem, n, "auto", ["x0", "x1"], n, **form))["relative_L2"]
        for n in (9, 17, 33)
    ]
    assert np.log2(found[1] / found[2]) > least, found
    assert found[2] < finest


# ---- variable coefficients -----------------------------------------------------------------------

#: Source points along an edge in one to three dimensions
SIZES = {1: (9, 17, 33), 2: (7, 13, 25), 3: (5, 9)}


def varied(nd: int, problem: dict[str, Any], n: int, method: str) -> dict[str, Any]:
    """A polynomial outside functions of second order, with values on all sides but x1."""
    held_sides = tuple(side for side in SIDES if side != "x1")
    return known(
        nd, problem, n, method, held_sides, 2 * n - 1, degree=5, grows=True,
        approximation={"order": 2},
    )  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(
    ("nd", "problem"), [*((nd, POISSON) for nd in (1, 2, 3)), (1, BAR), (2, ELASTIC), (3, ELASTIC)]
)
@pytest.mark.parametrize(("method", "rate"), [("rkpm-gauss", 2.5), ("rkcm", 1.4)])
def test_problems_with_varying_coefficients_converge(method, rate, nd, problem) -> None:
    """Nearly order 3 of the Galerkin form, 1 to 2 of collocation with tractions on a side."""
    found = [errors(varied(nd, problem, n, method))["relative_L2"] for n in SIZES[nd]]
    slope = -np.polyfit(np.log(np.array(SIZES[nd]) - 1.0), np.log(found), 1)[0]
    assert slope > rate, f"rate {slope:.2f} of {found}"
    assert found[-1] < 3e-3


def test_coefficients_that_jump_are_smoothed_for_collocation() -> None:
    """A bar of two stiffnesses, pulled: its end moves by F (L1/E1 + L2/E2), interpolated or not."""
    # the stiffness extends over half the support, where the soft side yields less
    for smoothing, near in (({}, 5e-3), ({"smoothing": 3.0}, 5e-2)):
        tables = scene(
            "rkpm-gauss", box(41), approximation={"order": 2}, probe=probes("end u_x 1"),
            linear={"problem": "elasticity", "E": "x < 0.5 ? 1 : 4", **smoothing},
            boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "traction": [0.01]}],
        )  # fmt: skip
        assert solved(tables).last()["end"] == pytest.approx(0.01 * (0.5 + 0.5 / 4), rel=near)


def test_without_a_known_solution_there_are_bars_from_other_points() -> None:
    tables = varied(2, POISSON, 13, "rkpm-gauss")
    del tables["linear"]["exact"]
    tables["probe"] = probes("middle u 0.5 0.25")
    found = solved(tables, error=True)
    assert found.states.errors == {} and found.states.verdict == "accepted"
    error = abs(found.last()["middle"] - (1 + 0.7 * 0.5 - 0.4 * 0.5) ** 5)
    assert error < found.bar("middle") < 0.05


# ---- cantilevers ---------------------------------------------------------------------------------

#: (5.25): deflection of the tip in plane strain, E = 3e7, nu = 0.25
_E, _NU = 3e7 / (1 - 0.25**2), 0.25 / 0.75
TIP = 100.0 / (6 * _E * 2.0**3 / 12) * (2 * 8.0**3 + (4 + 5 * _NU) * 2.0**2 * 8.0 / 4)


def test_cantilever_is_reproduced_by_a_cubic_basis(inputs: Path) -> None:
    """The solution (5.25) has degree 3; conditions (5.24b) must then hold exactly."""
    found = solved(
        inputs / "cantilever.toml", "geometry.source=[17,5]", "geometry.collocation=[35,11]",
        "approximation.order=3", "approximation.support=4",
    )  # fmt: skip
    assert found.states.errors["relative_H1"] < 1e-10
    assert found.last()["tip_deflection"] == pytest.approx(TIP, rel=1e-9)
    assert found.last()["shear_stress"] == pytest.approx(75.0, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2])
def test_cantilever_by_the_galerkin_form(inputs: Path, order: int) -> None:
    """Tractions alone, three pins; deflection, shear stress 75 N/m^2 and reaction -P."""
    found = solved(
        inputs / "cantilever.toml", "scene.method=rkpm-gauss", "geometry.source=[33, 9]",
        "geometry.collocation=[33, 9]", f"approximation.order={order}",
        f"approximation.support={1.5 + 0.5 * order}", "approximation.kernel=cubic",
    )  # fmt: skip
    tip, stress, reaction = found.last().values()
    assert tip == pytest.approx(TIP, rel=0.003)
    assert stress == pytest.approx(75.0, rel=0.01)
    assert reaction == pytest.approx(-100.0, rel=1e-9)


# ---- files and output ----------------------------------------------------------------------------


def test_one_step_and_its_files(tmp_path: Path, inputs: Path) -> None:
    """One solve, one iteration, one state; Python gets what the executable writes."""
    summary = run_deck(inputs / "poisson_2d.toml", tmp_path, threads=1, verbosity=-1)
    (step,) = summary["steps"]
    assert step["iterations"] == 1 and summary["converged"] is True
    assert summary["dofs"] == 100 and summary["rows"] == 400
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 2
    states = solved(inputs / "poisson_2d.toml").states
    assert states.x.shape == (1, 100) and states.warnings == summary["warnings"] == []
    assert states.errors.keys() == {"L2", "H1", "relative_L2", "relative_H1"}
    assert states.errors == pytest.approx(summary["errors"], rel=1e-9)
    assert states.force_imbalance == 0 and np.isnan(states.min_acoustic).all()
    with Results(tmp_path) as results:
        x, y, z = results.points.T
        assert results.nstep == 1 and not z.any() and "cauchy" not in results.fields
        # 2e-4 was measured, at the corners
        assert_allclose(results.field("u"), np.exp(x * y), rtol=4e-4)
        assert_allclose(states.x[0], results.restart().coefficients, rtol=1e-12)
    assert step["probes"]["centre"] == pytest.approx(np.exp(0.25), rel=1e-4)


def test_explain_has_no_load_steps_of_a_linear_problem(inputs: Path) -> None:
    """The solution is known, and a single solve is needed."""
    text = explained(inputs / "cantilever.toml")
    says = "linear elasticity in plane strain", "one least squares solve", "of which error bars 0"
    assert all(line in text for line in says) and "load steps" not in text, text


def test_explain_forecasts_the_time(inputs: Path) -> None:
    """More points, steps and error bars take longer."""

    def forecast(*words: str) -> tuple[float, ...]:
        text = explained(inputs / "cube_plates.toml", *words)
        found = re.search(r"about (\S+) CPU s, of which error bars (\S+)$", text)
        return tuple(float(word) for word in found.groups())

    few, more = forecast("geometry.source=[7,7,7]"), forecast("geometry.source=[19,19,19]")
    steps = forecast("geometry.source=[19,19,19]", "load.steps=10")
    assert 0 < few[1] < few[0] < 0.2 * more[0] and few[1] < more[1]
    assert 3 < (steps[0] - steps[1]) / (more[0] - more[1]) < 10


@pytest.mark.parametrize("essential", ["penalty", "transformation"])
def test_a_slender_beam_whose_factor_has_too_few_digits(essential: str) -> None:
    """Bending is 1e9 times softer than the end supports: an iteration that looks at the sum of
    both placed the middle, half-way by symmetry, at -0.12.
    """
    tables = scene(
        "rkpm-gauss", box(101, 5, 5, size=[50, 1, 1]),
        linear={"problem": "elasticity", "E": 100.0, "nu": 0.4999},
        boundary=[held("x0"), {"set": "x1", "u_x": 0, "u_y": 0, "u_z": 1}],
        probe=probes("middle u_z 25 0.5 0.5"), galerkin={"essential": essential},
    )  # fmt: skip
    assert solved(tables).last()["middle"] == pytest.approx(0.5, abs=1e-6)


# ---- linear dynamics by central differences ------------------------------------------------------

INPUTS = Path(__file__).parents[2] / "inputs"


def string(points: int, step: float, **dynamics: Any) -> dict[str, Any]:
    """A free string of unit length, stiffness and density whose functions are finite elements."""
    return scene(
        "rkpm-gauss", box(points, places=(points,)), linear={"problem": "elasticity", "E": 1},
        approximation={"order": 1, "support": 1.0001}, boundary=[],
        dynamics={"density": 1, "time_step": step, "end_time": 10 * step} | dynamics,
    )  # fmt: skip


@pytest.mark.parametrize(("method", "rate"), [("rkcm", 1.5), ("rkpm-gauss", 1.85)])
def test_wave_against_d_alembert(method: str, rate: float) -> None:
    """Order 2 in time; collocation keeps a spatial error."""
    deck, steps = INPUTS / "wave_1d.toml", [0.2, 0.1, 0.05]
    form = f"scene.method={method}"
    found = [errors(deck, form, f"dynamics.time_step={step}")["relative_L2"] for step in steps]
    assert found[0] < 0.02
    slope = np.polyfit(np.log(steps), np.log(found), 1)[0]
    assert slope > rate, f"order {slope:.2f} of {found}"


def test_limit_is_that_of_a_uniform_lattice() -> None:
    """Linear elements of a free bar: h/(c sqrt 3)."""
    limit = 1 / 20 / np.sqrt(3)
    solved(string(21, 0.999 * limit, velocity="cos(pi*x)"))
    with pytest.raises(MyorkError) as error:
        solved(string(21, 1.01 * limit, velocity="cos(pi*x)"))
    said = str(error.value).split("at most ")[1].split()[0]
    assert float(said) == pytest.approx(limit, rel=1e-3)


def test_free_bodies_fly() -> None:
    """A uniform velocity is constant."""
    found = solved(string(11, 0.02, velocity=2.0) | {"probe": probes("end u_x 1")})
    assert found.probes["end"][:, 0] == pytest.approx(2.0 * found.states.load, rel=1e-9)


def pulled(method: str, end: dict[str, Any]) -> dict[str, Any]:
    """u = t^2 sin(2x) + x t: a fixed wall, and an end that is pulled or moved."""
    return scene(
        method, box(21), boundary=[{"set": "x0", "u_x": 0}, {"set": "x1"} | end],
        linear={"problem": "elasticity", "E": 2, "source": "2*sin(2*x) + 8*t^2*sin(2*x)"},
        dynamics={"density": 1, "time_step": 0.01, "end_time": 1, "velocity": "x"},
    )  # fmt: skip


def forces_of(tables: dict[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """Times and forces of a body through x0 and x1, shape (times, 2)."""
    states, found, *_ = solved(tables | {"probe": probes("low force_x x0", "high force_x x1")})
    return np.asarray(states.load), np.stack([f[:, 0] for f in found.values()], axis=1)


#: Conditions of the end with u = t^2 sin(2x) + x t
MOVED, PULLED = {"u_x": "t^2*sin(2) + t"}, {"traction": ["4*t^2*cos(2) + 2*t"]}


@pytest.mark.parametrize("end", [MOVED, PULLED])
@pytest.mark.parametrize("method", ["rkcm", "rkpm-gauss"])
def test_loads_in_time(method: str, end: dict[str, Any]) -> None:
    """Values, traction and source that change with time, and the forces of wall and end."""
    tables = pulled(method, end)
    linear = tables["linear"] | {"exact": "t^2*sin(2*x) + x*t"}
    more = tables | {"approximation": {"order": 2}, "linear": linear}
    assert errors(more)["relative_L2"] < 3e-3
    if method == "rkpm-gauss":
        time, force = forces_of(tables)
        pull = 4 * time**2 * np.cos(2) + 2 * time
        near = 0.005 if end is MOVED else 1e-12
        np.testing.assert_allclose(force[:, 1], pull, rtol=0, atol=near)
        np.testing.assert_allclose(force[:, 0], -4 * time**2 - 2 * time, rtol=0, atol=3e-4)


@pytest.mark.parametrize("dimension", [1, 2])
def test_reactions_of_a_bar_that_swings(dimension: int) -> None:
    """u = sin(pi x) sin(pi t)/pi between two walls, with reactions sin(pi t): order 2."""
    found = []
    for cells in (10, 20):
        n = [cells + 1, 3][:dimension]
        tables = gripped(
            "rkpm-gauss", box(*n, size=[1, 0.2][:dimension], places=n), [], "x0 x1",
            linear={"problem": "elasticity", "E": 1} | ({"nu": 0} if dimension > 1 else {}),
            dynamics={"density": 1, "time_step": 0.4 / cells, "end_time": 1,
                      "velocity": ["sin(pi*x)", "0"][:dimension]},
        )  # fmt: skip
        time, force = forces_of(tables)
        height = 0.2 if dimension > 1 else 1.0
        found.append(np.abs(force / height + np.sin(np.pi * time)[:, np.newaxis]).max())
    assert found[1] < 7e-4
    assert np.log2(found[0] / found[1]) > 1.8


def test_membrane_in_the_plane() -> None:
    """With Poisson's operator the motion is a membrane's: sin(pi x) sin(pi y) sin(sqrt 2 pi t)."""
    tables = scene(
        "rkpm-gauss", box(25, 25, places=(25, 25)),
        linear={"problem": "poisson", "exact": "sin(pi*x)*sin(pi*y)*sin(sqrt(2)*pi*t)"},
        dynamics={"density": 1, "time_step": 0.01, "end_time": 0.5,
                  "velocity": "sqrt(2)*pi*sin(pi*x)*sin(pi*y)"},
        boundary=[{"set": side, "u": 0} for side in ("x0", "x1", "y0", "y1")],
    )  # fmt: skip
    assert errors(tables)["relative_L2"] < 0.03


def vibrating(unit: float, end: float, **linear: Any) -> dict[str, Any]:
    """A string that vibrates with period 2, its time in a given unit."""
    return scene(
        "rkpm-gauss", box(21), linear={"problem": "elasticity", "E": 1} | linear,
        boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "u_x": 0}],
        dynamics={"density": unit**2, "time_step": 0.01 * unit, "end_time": end * unit,
                  "every": 5, "velocity": f"pi/{unit}*sin(pi*x)"},
        probe=probes("middle u_x 0.5"),
    )  # fmt: skip


# 191 steps: the second solution, with half as many, ends later
@pytest.mark.parametrize(
    ("end", "known"), [(2.0, {}), (2.0, {"exact": "sin(pi*x)*sin(pi*t)"}), (1.91, {})]
)
def test_a_motion_that_ends_at_rest_is_judged_by_its_amplitude(
    end: float, known: dict[str, str], tmp_path: Path
) -> None:
    """The string passes through its straight line at time 2; bars are the largest errors so far."""
    found = run_deck(vibrating(1.0, end, **known), tmp_path, threads=1, verbosity=-1)
    assert found["verdict"]["state"] == "accepted"
    bars = np.array([step["probe_errors"]["middle"] for step in found["steps"]])
    values = np.array([step["probes"]["middle"] for step in found["steps"]])
    time = np.array([step["load"] for step in found["steps"]])
    assert 0 < bars[-1] < 0.001
    # between the times that are judged the error may be slightly larger
    assert (np.abs(values - np.sin(np.pi * time)) < bars + 1e-5).all()


def test_bars_of_a_motion_do_not_depend_on_the_unit_of_time(tmp_path: Path) -> None:
    steps = [
        run_deck(vibrating(unit, 1.3), tmp_path, threads=1, verbosity=-1)["steps"]
        for unit in (1.0, 100.0)
    ]
    for one, other in zip(*steps, strict=True):
        for key in ("probes", "probe_errors"):
            assert one[key]["middle"] == pytest.approx(other[key]["middle"], rel=1e-6)


def test_more_points_take_shorter_time_steps(tmp_path: Path) -> None:
    """Four cells across a plane beam are compared with eight, which need half the step."""
    tables = scene(
        "rkpm-gauss", box(9, 3, size=[2, 0.5]), boundary=[{"set": "x0", "u_x": 0, "u_y": 0}],
        linear={"problem": "elasticity", "E": 1, "nu": 0},
        dynamics={"density": 1, "time_step": 0.1, "end_time": 2, "velocity": ["0", "x^2"]},
        probe=probes("tip u_y 2 0.25"),
    )  # fmt: skip
    found = run_deck(tables, tmp_path, threads=1, verbosity=-1)
    assert 0 < found["steps"][-1]["probe_errors"]["tip"] < 0.1


def poisson(**change: Any) -> dict[str, Any]:
    """A problem of the Galerkin form with a changed entry of `[linear]`."""
    tables = known(2, POISSON, 5, "rkpm-gauss", places=9)
    return tables | {"linear": tables["linear"] | change}


@pytest.mark.parametrize(("tables", "words"), [
    (known(2, POISSON, essential=()), "no value is prescribed"),
    (known(2, ELASTIC, essential=(), pin=[{"point": [0, 0.33], "components": ["x"]}]),
     "no boundary point lies at"),
    (poisson(source=["1", "2"]), r"linear.source: must have 1 item \(linear.pro"),
    (poisson(conductivity="x - 0.5"), "linear.conductivity: must be positive, not -0.5"),
    (poisson(exact="sqrt(x - 0.5)"), r"linear.exact: 'sqrt\(x - 0.5\)' is not finite"),
    (known(2, POISSON) | {"boundary": [{"set": "x1", "flux": "1"}]}, "prescribed anywhere: gi"),
    (string(11, 0.01, end_time=0.033), "dynamics.end_time: must be a whole number of"),
    (string(11, 0.01, velocity=["1", "2"]), "dynamics.velocity: must have 1 item"),
    (string(11, 0.01, density="x - 1"), "dynamics.density: must be positive, not"),
    (string(11, 0.01, velocity="t"), "Unexpected token \"t\""),
    # time is meaningless in a static problem
    (pulled("rkpm-gauss", {"u_x": "t"}) | {"dynamics": None}, "Unexpected token \"t\""),
    (pulled("rkcm", {}) | {"probe": probes("pull force_x x0")}, "quantity: force_x is not known"),
])  # fmt: skip
def test_wrong_decks_are_refused(tables: Any, words: str) -> None:
    refuses(words, solved, {key: table for key, table in tables.items() if table is not None})
