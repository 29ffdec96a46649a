"""Linear problems: convergence rates, patch tests, and decks that are refused."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork.bench import linear
from myork.core.scene import Scene
from myork.errors import InputError
from myork.results import Results
from myork.stations.explain import explain_deck
from myork.stations.solve import run_deck

POISSON = {"problem": "poisson", "solution": "sine"}
ELASTIC = {"problem": "elasticity", "solution": "sine", "E": 1, "nu": 0.3}
SIDES = ("x0", "x1", "y0", "y1", "z0", "z1")


@pytest.fixture
def write_linear(write_deck) -> Callable[..., Path]:
    """Write linear decks; values are prescribed on all sides unless `essential` names others."""

    def write(
        dimension: int,
        linear: dict[str, Any],
        *,
        collocation: int = 11,
        essential: tuple[str, ...] | None = None,
        **more: Any,
    ) -> Path:
        sides = SIDES[: 2 * dimension] if essential is None else essential
        return write_deck(
            {
                "scene": {"dimension": dimension, "method": "rkcm"},
                "geometry": {
                    "kind": "box",
                    "size": [1.0, 0.5, 2.0][:dimension],
                    "source": [6] * dimension,
                    "collocation": [collocation] * dimension,
                },
                "linear": {**linear, "essential": sides},
                **more,
            }
        )

    return write


def solve(path: Path, out: Path, *overrides: str) -> dict[str, Any]:
    """Summary of a solve with one thread."""
    return run_deck(path, out, overrides=overrides, threads=1, verbosity=-1)


def rates(path: Path, out: Path, sources: list[list[int]], points: list[list[int]], *more: str):
    """Fitted rates and the relative errors of the finest grid, each of L2 and H1."""
    errors = []
    for source, collocation in zip(sources, points, strict=True):
        sizes = f"geometry.source={source}", f"geometry.collocation={collocation}"
        summary = solve(path, out, *sizes, *more)
        errors.append([summary["errors"][f"relative_{norm}"] for norm in ("L2", "H1")])
    h = np.log([1.0 / (source[0] - 1) for source in sources])
    return np.polyfit(h, np.log(errors), 1)[0], errors[-1]


@pytest.mark.parametrize(
    ("deck", "published", "fitted", "bound"),
    [
        # published rates; fitted ones as measured with these shape functions; twice the errors
        # measured on the finest grid
        ("poisson_1d", (3.07, 2.49), (3.03, 2.47), (2.8e-6, 5.4e-5)),
        ("poisson_2d", (3.03, 2.43), (3.35, 2.63), (7.2e-7, 3.2e-5)),
    ],
)
def test_published_convergence(tmp_path, inputs, deck, published, fitted, bound):
    """The published sizes, support and weights give at least the published rates."""
    nd = len(solve(inputs / f"{deck}.toml", tmp_path)["deck"]["geometry"]["source"])
    sizes = (10, 15, 20, 25, 30)
    slopes, finest = rates(
        inputs / f"{deck}.toml",
        tmp_path,
        [[n] * nd for n in sizes],
        [[2 * n] * nd for n in sizes],
    )
    assert slopes[0] > 3.0 and slopes[1] > 2.4
    assert_allclose(slopes, fitted, atol=0.2)
    assert np.all(slopes > np.array(published) - 0.1)
    assert np.all(np.array(finest) < bound)


@pytest.mark.parametrize(
    ("order", "fitted", "bound"),
    # theory (5.18) is order + 1 in L2 and order in H1
    [(3, (4.4, 3.5), (1.1e-8, 7e-7)), (4, (4.7, 4.1), (2e-10, 1.2e-8))],
)
def test_higher_orders(tmp_path, inputs, order, fitted, bound):
    """Orders 3 and 4 reach their rates with four collocation points a source point."""
    sizes = (10, 15, 20, 25, 30)
    slopes, finest = rates(
        inputs / "poisson_1d.toml",
        tmp_path,
        [[n] for n in sizes],
        [[4 * n] for n in sizes],
        f"approximation.order={order}",
        f"approximation.support={order + 1}",
    )
    assert_allclose(slopes, fitted, atol=0.2)
    assert np.all(np.array(finest) < bound)


def test_poisson_3d(tmp_path, inputs):
    slopes, finest = rates(
        inputs / "poisson_3d.toml",
        tmp_path,
        [[n] * 3 for n in (5, 6, 8)],
        [[2 * n - 1] * 3 for n in (5, 6, 8)],
    )
    # far from the asymptotic range: only that they are not below theory
    assert slopes[0] > 2.8 and slopes[1] > 1.8
    assert finest[0] < 5e-3 and finest[1] < 2.2e-2


def test_cantilever(tmp_path, inputs):
    """Second order with the published support of 3h; theory says 3 in L2 and 2 in H1."""
    beam = [[17, 5], [25, 7], [33, 9], [41, 11]]
    points = [[35, 11], [51, 15], [67, 19], [83, 23]]
    slopes, finest = rates(inputs / "cantilever.toml", tmp_path, beam, points)
    assert_allclose(slopes, (1.95, 1.95), atol=0.2)
    assert max(finest) < 1.2e-2
    probes = json.loads((tmp_path / "summary.json").read_text())["steps"][0]["probes"]
    # 3P/(2D) and -P
    assert probes["shear_stress"] == pytest.approx(75.0, rel=0.03)
    assert probes["reaction"] == pytest.approx(-100.0, rel=0.03)


def test_cantilever_is_reproduced_by_a_cubic_basis(tmp_path, inputs):
    """The solution (5.25) has degree 3; conditions (5.24b) must then hold exactly."""
    summary = solve(
        inputs / "cantilever.toml",
        tmp_path,
        "geometry.source=[17,5]",
        "geometry.collocation=[35,11]",
        "approximation.order=3",
        "approximation.support=4",
    )
    assert summary["errors"]["relative_H1"] < 1e-10
    probes = summary["steps"][0]["probes"]
    e, v, force, length, depth = 3e7 / (1 - 0.25**2), 0.25 / 0.75, 100.0, 8.0, 2.0
    inertia = depth**3 / 12
    tip = force / (6 * e * inertia) * (2 * length**3 + (4 + 5 * v) * depth**2 * length / 4)
    assert probes["tip_deflection"] == pytest.approx(tip, rel=1e-9)
    assert probes["shear_stress"] == pytest.approx(75.0, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("dimension", [1, 2, 3])
@pytest.mark.parametrize("order", [2, 3])
def test_polynomials_are_reproduced(write_linear, tmp_path, dimension, order):
    """Polynomials of the order of the basis are solutions to rounding, fluxes included."""
    linear = {"problem": "poisson", "solution": "polynomial", "degree": order}
    path = write_linear(dimension, linear, essential=("x0",))
    summary = solve(
        path, tmp_path, f"approximation.order={order}", f"approximation.support={order + 1}"
    )
    assert summary["errors"]["relative_H1"] < 1e-10


@pytest.mark.parametrize(
    ("dimension", "plane"), [(2, {"plane": "strain"}), (2, {"plane": "stress"}), (3, {})]
)
@pytest.mark.parametrize("solver", ["auto", "dgels"])
def test_elastic_patch(write_linear, tmp_path, dimension, plane, solver):
    """A linear displacement is exact, and its stress is Hooke's."""
    point = [0.4, 0.2, 1.1][:dimension]
    path = write_linear(
        dimension,
        {**ELASTIC, "solution": "polynomial", "degree": 1, "E": 250, **plane},
        essential=("x0", "y1"),
        probe=[
            {"name": name, "quantity": f"cauchy_{name}", "point": point}
            for name in ("xx", "xy", "zz")
        ],
    )
    summary = solve(path, tmp_path, f"solver.linear={solver}")
    assert summary["errors"]["relative_H1"] < 1e-10
    # u_c = 1 + a_c . x/extent, the directions a_c of fortran/linear/rk_solutions.f90
    direction = (0.7, -0.4, 0.5, 0.3, -0.6)
    size = (1.0, 0.5, 2.0)[:dimension]
    grad = np.zeros((3, 3))
    for c in range(dimension):
        grad[c, :dimension] = np.array(direction[c : c + dimension]) / size
    strain = (grad + grad.T) / 2
    if plane == {"plane": "stress"}:
        strain[2, 2] = -0.3 / 0.7 * (strain[0, 0] + strain[1, 1])
    lame, mu = 250 * 0.3 / (1.3 * 0.4), 250 / 2.6
    stress = lame * np.trace(strain) * np.eye(3) + 2 * mu * strain
    found = summary["steps"][0]["probes"]
    expected = {"xx": stress[0, 0], "xy": stress[0, 1], "zz": stress[2, 2]}
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-9 * np.abs(stress).max())


def test_units_do_not_matter(write_linear, tmp_path):
    """Young's modulus scales the rows, not the displacement."""
    errors = []
    for young in (1e-6, 1e9):
        path = write_linear(2, {**ELASTIC, "E": young}, essential=("x0",), collocation=21)
        size = "geometry.source=[11,11]"
        errors.append(solve(path, tmp_path, size)["errors"]["L2"])
    # the condition of the rows, about 1e-4, lies between rounding and the digits that agree
    assert errors[0] == pytest.approx(errors[1], rel=1e-8)


def test_one_step_and_its_files(tmp_path, inputs):
    """One assembly, one solve: one step, one iteration, one state of one field."""
    summary = solve(inputs / "poisson_2d.toml", tmp_path)
    assert len(summary["steps"]) == 1
    assert summary["steps"][0]["iterations"] == 1
    assert summary["converged"] is True
    assert summary["dofs"] == 100 and summary["rows"] == 400
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 2
    with Results(tmp_path) as results:
        assert results.nstep == 1
        x, y, z = results.points.T
        assert not z.any()
        assert "cauchy" not in results.fields
        # 2e-4 was measured, at the corners
        assert_allclose(results.field("u"), np.exp(x * y), rtol=4e-4)
    assert summary["steps"][0]["probes"]["centre"] == pytest.approx(np.exp(0.25), rel=1e-4)


def test_scene_in_memory(inputs, tmp_path):
    """Python gets the same coefficients as the executable writes."""
    with Scene(inputs / "poisson_1d.toml", threads=1) as scene:
        states = scene.solve()
    solve(inputs / "poisson_1d.toml", tmp_path)
    assert states.x.shape == (1, 10)
    with Results(tmp_path) as results:
        assert_allclose(states.x[0], results.restart().coefficients, rtol=1e-12)


@pytest.mark.parametrize(
    ("dimension", "linear", "changes", "words"),
    [
        (1, {**POISSON, "solution": "exp_xy"}, {}, "exp_xy needs scene.dimension = 2"),
        (2, {**POISSON, "solution": "exp_x"}, {}, "exp_x needs scene.dimension = 1"),
        (2, {"problem": "poisson"}, {}, "linear.essential: only for solution"),
        (2, {**POISSON, "problem": "heat"}, {}, "poisson, elasticity"),
        (2, {"problem": "elasticity", "solution": "sine", "E": 1}, {}, "linear.nu"),
        (2, {**ELASTIC, "nu": 0.5}, {}, "less than 0.5"),
        (2, {**POISSON, "E": 1}, {}, "only for problem = elasticity"),
        (2, {**ELASTIC, "solution": "exp_xy"}, {}, "problem = poisson"),
        (2, POISSON, {"essential": ("top",)}, "'top' is not a side"),
        (2, POISSON, {"essential": ()}, "no value is prescribed"),
        (2, POISSON, {"boundary": [{"set": "x0", "u_x": 0}]}, "has no place in a linear problem"),
        (
            2,
            ELASTIC,
            {"essential": (), "pin": [{"point": [0, 0.33], "components": ["x"]}]},
            "no boundary point lies at",
        ),
        (
            2,
            POISSON,
            {"probe": [{"name": "s", "quantity": "cauchy_xx", "point": [0.5, 0.2]}]},
            "cauchy_xx is not known",
        ),
        (2, POISSON, {"collocation": 3}, "fewer equations"),
    ],
)
def test_wrong_decks_are_refused(write_linear, tmp_path, dimension, linear, changes, words):
    path = write_linear(dimension, linear, **changes)
    with pytest.raises(InputError, match=words):
        solve(path, tmp_path / "out")


def test_one_dimension_is_for_linear_problems(tmp_path, inputs):
    text = (inputs / "shear_2d.toml").read_text(encoding="utf-8")
    path = tmp_path / "deck.toml"
    path.write_text(text.replace("dimension = 2", "dimension = 1"), encoding="utf-8")
    with pytest.raises(InputError, match=r"\[linear\] is missing"):
        solve(path, tmp_path / "out")


def test_mixed_form_is_refused(tmp_path, inputs):
    with pytest.raises(InputError, match="must be rkpm-gauss or rkcm for a linear problem"):
        solve(inputs / "poisson_1d.toml", tmp_path, "scene.method=rkcm-mixed")


def test_explain_says_linear(inputs, tmp_path):
    lines: list[str] = []
    explain_deck(inputs / "cantilever.toml", progress=lines.append)
    text = "\n".join(lines)
    assert "linear elasticity in plane strain" in text
    assert "one least squares solve" in text
    assert "load steps" not in text


@pytest.mark.slow
def test_benchmark_returns_what_is_drawn(tmp_path):
    """The small benchmark: rates of every study, tables and curves of the same studies."""
    result = linear.run(tmp_path, lambda line: None, True)
    studies = [rate["study"] for rate in result["rates"]]
    assert len(set(studies)) == len(studies)
    assert {case["study"] for case in result["cases"]} == set(studies)
    for rate in result["rates"]:
        for norm, published in rate["published"].items():
            assert rate[norm] > published - 0.1
    (table,) = result["tables"]
    assert all(len(row) == len(table["head"]) for row in table["rows"])
    assert [plot["scale"] for plot in result["plots"]] == ["log-log", "log-log"]
