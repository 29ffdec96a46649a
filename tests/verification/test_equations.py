"""Equations of the dissertation: those that docs/equations.md corrects, and those that are right.

Each check derives the right formula, shows that the printed one is another, and compares ours with
the right one; what has no number of ours is argued on the page.
"""

import itertools
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sympy as sp
from numpy.testing import assert_allclose

from benchmarks.truths import exact
from myork import load_deck
from myork.bench.materials import RUBBER
from myork.files import INPUTS
from myork.model.normals import surface_normals
from tests.curves import fiber_curves

PAGE = Path(__file__).parents[2] / "docs/equations.md"


def test_3_2_normal() -> None:
    x = sp.Matrix(sp.symbols("x y z", positive=True))
    length = sp.sqrt(x.dot(x))
    phi = 1 - length  # a ball: positive inside, (3.1), (4.8)
    slope = sp.Matrix([phi.diff(component) for component in x])
    printed = slope / sp.sqrt(slope.dot(slope))
    assert sp.simplify(printed.dot(x) / length) == -1
    places = np.indices((25, 25, 25)).reshape(3, -1).T.reshape(25, 25, 25, 3) - 12.0
    ball = np.linalg.norm(places, axis=-1) < 9.5
    rim = np.argwhere(ball & ~np.roll(ball, 1, axis=0))
    rim = rim[rim[:, 2] == 12]
    ours = surface_normals(ball, np.ones(3), rim)
    assert (np.einsum("pi,pi->p", ours, rim - 12.0) > 0).all()


def test_4_37_passive_force() -> None:
    stretch, g1, g2 = sp.symbols("lambda gamma_1 gamma_2", positive=True)
    middle = g1 * (sp.exp(g2 * (stretch - 1)) - 1)
    end = sp.Rational(7, 5)
    growth = sp.exp(sp.Rational(2, 5) * g2)
    printed = g1 * g2 * growth * stretch + g1 * (growth - 1)
    right = g1 * g2 * growth * (stretch - end) + g1 * (growth - 1)
    jump = (printed - middle).subs(stretch, end)
    assert sp.simplify(jump - end * g1 * g2 * growth) == 0
    # 6.47 where the force is 0.65
    assert float(jump.subs({g1: 0.05, g2: 6.6})) == pytest.approx(6.474, abs=1e-3)
    for k in range(2):
        assert sp.simplify((right - middle).diff(stretch, k).subs(stretch, end)) == 0
    at = [1.2, 1.4, 1.5, 2.0]
    formula = sp.Piecewise((middle, stretch <= end), (right, True)).subs({g1: 0.05, g2: 6.6})
    ours = fiber_curves(at, curve="published", gamma1=0.05, gamma2=6.6).passive[1]
    assert_allclose(ours, [float(formula.subs(stretch, x)) for x in at], rtol=1e-12)


def test_4_38_active_force() -> None:
    stretch = sp.symbols("lambda", positive=True)
    rising, top = 9 * (stretch - sp.Rational(2, 5)) ** 2, 1 - 4 * (1 - stretch) ** 2
    joint = sp.Rational(3, 5)
    assert (rising - top).subs(stretch, joint) == 0
    # the printed branches rise again outside: as much as at full overlap at 0.067 and 1.933
    assert rising.subs(stretch, sp.Rational(1, 15)) == 1
    slopes = [branch.diff(stretch).subs(stretch, joint) for branch in (rising, top)]
    assert slopes == [sp.Rational(18, 5), sp.Rational(16, 5)]
    ours = fiber_curves([0.05, 0.39, 0.5, 0.8, 1.61, 2.0], curve="published").active[1]
    assert_allclose(ours, [0.0, 0.0, 0.09, 0.84, 0.0, 0.0], atol=1e-14)


def test_5_25_cantilever() -> None:
    x, y, load, length, depth, young, nu = sp.symbols("x y P L D E nu", positive=True)
    bar_nu = nu / (1 - nu)

    def stress(modulus: Any) -> list[Any]:
        """Plane strain stress of (5.25) with a modulus."""
        stiff = 6 * modulus * depth**3 / 12
        u = [
            -load * y / stiff * ((6 * length - 3 * x) * x + (2 + bar_nu) * (y**2 - depth**2 / 4)),
            load / stiff * ((3 * length - x) * x**2 + 3 * bar_nu * y**2 * (length - x)
                            + (4 + 5 * bar_nu) * depth**2 * x / 4),
        ]  # fmt: skip
        e = [u[0].diff(x), u[1].diff(y), (u[0].diff(y) + u[1].diff(x)) / 2]
        lame = young * nu / (1 + nu) / (1 - 2 * nu)
        shear = young / 2 / (1 + nu)
        volume = lame * (e[0] + e[1])
        return [2 * shear * e[0] + volume, 2 * shear * e[1] + volume, 2 * shear * e[2]]

    end = 6 * load / depth**3 * (depth**2 / 4 - y**2)
    right, printed = stress(young / (1 - nu**2)), stress(young)
    # tractions (5.24b) at the loaded and at the held end, and free sides
    assert sp.simplify(right[2].subs(x, length) - end) == 0
    assert sp.simplify(right[0].subs(x, length)) == 0
    assert sp.simplify(-right[0].subs(x, 0) - 12 * load * length / depth**3 * y) == 0
    assert sp.simplify(right[1]) == 0 and sp.simplify(right[2].subs(y, depth / 2)) == 0
    ratio = sp.simplify(printed[2].subs(x, length) / end)
    assert sp.simplify(ratio - 1 / (1 - nu**2)) == 0
    assert float(ratio.subs(nu, sp.Rational(1, 4))) == pytest.approx(1.067, abs=5e-4)
    formula = load_deck(INPUTS / "cantilever.toml")["linear"]["exact"][0]
    given = {load: 100, length: 8, depth: 2, young: 3e7, nu: 0.25}
    stiff = 6 * young / (1 - nu**2) * depth**3 / 12
    first = -load * y / stiff * ((6 * length - 3 * x) * x + (2 + bar_nu) * (y**2 - depth**2 / 4))
    # the deck's y is measured from the lower side
    ours = eval(formula.replace("^", "**"), {}, {"x": 3.0, "y": 1.7})
    assert ours == pytest.approx(float(first.subs(given).subs({x: 3, y: 0.7})), rel=1e-9)


S, W1, W2 = sp.symbols("s W1 W2", positive=True)


@pytest.mark.parametrize(
    ("stretches", "printed", "ours"),
    [
        ((S, S ** sp.Rational(-1, 2), S ** sp.Rational(-1, 2)),
         2 * (S**2 - 1 / S) * (W1 + W2 / S), exact.uniaxial),
        ((S, S, S**-2), 2 * (S**2 - S**-4) * (W1 + S**2 * W2), exact.equibiaxial),
    ],
    ids=["(5.114)", "(5.118)"],
)  # fmt: skip
def test_homogeneous_states(stretches: Any, printed: Any, ours: Any) -> None:
    """Stresses of stretched rubber from the energy, one direction free of stress."""
    principal = sp.symbols("l1:4", positive=True)
    i1 = sum(p**2 for p in principal)
    i2 = sum(p**2 * q**2 for p, q in itertools.combinations(principal, 2))
    cauchy = [p * (W1 * i1.diff(p) + W2 * i2.diff(p)) for p in principal]
    state = dict(zip(principal, stretches, strict=True))
    found = (cauchy[0] - cauchy[2]).subs(state)
    assert sp.simplify(found - printed) == 0
    first, a10, a20, a30 = i1.subs(state) - 3, *(RUBBER[key] for key in ("A10", "A20", "A30"))
    slopes = {W1: a10 + 2 * a20 * first + 3 * a30 * first**2, W2: 0}
    value = float(printed.subs(slopes).subs(S, 1.7))
    assert ours(exact.Polynomial.from_deck(RUBBER, math.inf), 1.7) == pytest.approx(
        value, rel=1e-10
    )


def test_page_names_every_check() -> None:
    named = set(re.findall(r"`(test_\w+)`", PAGE.read_text(encoding="utf-8")))
    assert named == {name for name in globals() if name.startswith("test_")} - {
        "test_page_names_every_check"
    }
