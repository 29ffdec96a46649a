"""Linear problems by the Galerkin form: patch tests, orders, cantilevers, nearly incompressible."""

import numpy as np
import pytest

from myork.core.scene import Scene

#: Basis, support, Gauss points
LINEAR = {
    "approximation": {"order": 1, "support": 2.0, "kernel": "cubic"},
    "galerkin": {"gauss": 2},
}
QUADRATIC = {
    "approximation": {"order": 2, "support": 2.5, "kernel": "cubic"},
    "galerkin": {"gauss": 3},
}
POISSON = {"problem": "poisson"}
ELASTIC = {"problem": "elasticity", "E": 3.0, "nu": 0.3}
STIFF = {**ELASTIC, "nu": 0.4999}


def solve(open_scene, nd, problem, n, form, essential=None, jitter=0.0):
    """Errors of a solve in a box whose edges differ."""
    scene = open_scene(
        {
            "scene": {"dimension": nd},
            "geometry": {
                "kind": "box",
                "size": [1.0, 0.5, 2.0][:nd],
                "source": [n] * nd,
                "collocation": [n] * nd,
                "jitter": jitter,
            },
            "linear": {**problem, "essential": essential or [f"{axis}0" for axis in "xyz"[:nd]]},
            **form,
        }
    )
    assert scene.deck["scene"]["method"] == "rkpm-gauss"
    states = scene.solve()
    return states.errors


@pytest.mark.parametrize("held", ["penalty", "transformation"])
@pytest.mark.parametrize("form", [LINEAR, QUADRATIC], ids=["linear", "quadratic"])
@pytest.mark.parametrize(
    ("nd", "problem"),
    [
        (1, POISSON),
        (2, POISSON),
        (3, POISSON),
        (2, ELASTIC),
        (2, {**ELASTIC, "plane": "stress"}),
        (2, STIFF),
        (3, STIFF),
    ],
)
def test_patch(open_scene, nd, problem, form, held):
    """A linear solution, prescribed on some sides and as tractions on the others, also where the
    points are jittered; a nearly incompressible body amplifies rounding by its lambda over mu.
    """
    problem = {**problem, "solution": "polynomial", "degree": 1}
    form = {**form, "galerkin": {**form["galerkin"], "essential": held}}
    for jitter in (0.0, 0.3):
        errors = solve(open_scene, nd, problem, 5, form, jitter=jitter)
        assert errors["relative_H1"] < 1e-10


@pytest.mark.parametrize(
    ("form", "least", "finest"), [(LINEAR, 1.9, 1e-2), (QUADRATIC, 2.9, 4e-3)], ids=["1", "2"]
)
@pytest.mark.parametrize(
    ("nd", "problem"), [(1, POISSON), (2, POISSON), (2, ELASTIC), (2, {**ELASTIC, "nu": 0.499})]
)
def test_orders(open_scene, nd, problem, form, least, finest):
    """The error falls with one order more than that of the basis."""
    problem = {**problem, "solution": "sine"}
    errors = [
        solve(open_scene, nd, problem, n, form, ["x0", "x1"])["relative_L2"] for n in (9, 17, 33)
    ]
    assert np.log2(errors[1] / errors[2]) > least, errors
    assert errors[2] < finest


@pytest.mark.parametrize("order", [1, 2])
def test_cantilever(inputs, order):
    """(5.25): tractions alone, three pins; deflection, shear stress 75 N/m^2 and reaction -P."""
    overrides = [
        "scene.method=rkpm-gauss",
        "geometry.source=[33, 9]",
        "geometry.collocation=[33, 9]",
        f"approximation.order={order}",
        f"approximation.support={1.5 + 0.5 * order}",
        "approximation.kernel=cubic",
    ]
    with Scene(inputs / "cantilever.toml", overrides, threads=1) as scene:
        states = scene.solve()
        tip, stress, reaction = scene.probes(states.x[-1:], np.ones(1))[0, :, 0]
    young, ratio = 3e7 / (1 - 0.25**2), 0.25 / 0.75
    inertia = 2.0**3 / 12.0
    exact = 100.0 / (6 * young * inertia) * (2 * 8.0**3 + (4 + 5 * ratio) * 2.0**2 * 8.0 / 4)
    assert tip == pytest.approx(exact, rel=0.003)
    assert stress == pytest.approx(75.0, rel=0.01)
    assert reaction == pytest.approx(-100.0, rel=1e-9)


def test_a_clamped_cantilever_bends(open_scene):
    """4 x 1, K = 13 shear moduli, a traction on its end so small that strains are: its tip moves
    by 71.4 tractions over the shear modulus in finite elements.
    """
    traction = 1e-6
    scene = open_scene(
        {
            "scene": {"dimension": 2},
            "geometry": {
                "kind": "box",
                "size": [4, 1],
                "source": [33, 9],
                "collocation": [9, 3],
            },
            "material": [{"name": "rubber", "model": "polynomial", "A10": 0.5, "K": 13.0}],
            "boundary": [
                {"set": "x0", "u_x": 0, "u_y": 0},
                {"set": "x1", "traction": [0, traction]},
            ],
            "probe": [{"name": "tip", "quantity": "u_y", "point": [4, 0.5]}],
        }
    )
    states = scene.solve()
    tip = scene.probes(states.x[-1:], np.ones(1))[0, 0, 0]
    assert tip / traction == pytest.approx(71.4, rel=0.01)
