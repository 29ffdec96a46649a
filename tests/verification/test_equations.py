"""Equations of the dissertation: those that docs/equations.md corrects, and those that are right.

Each check derives the right formula, shows that the printed one is another, and compares ours with
the right one where there is a number of ours. The page names the checks. Exact solutions follow.
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
from benchmarks.truths.compiled import fiber_curves
from myork import load_deck
from myork.bench.materials import RUBBER
from myork.files import INPUTS
from myork.model.normals import surface_normals

PAGE = Path(__file__).parents[2] / "docs/equations.md"


# ---- errata --------------------------------------------------------------------------------------


def check_3_2_normal() -> None:
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


def check_3_36_gaussian() -> None:
    sigma, r, angle = sp.symbols("sigma r theta", positive=True)
    bell = sp.exp(-(r**2) / (2 * sigma**2))
    in_plane = sp.integrate(sp.integrate(bell * r, (r, 0, sp.oo)), (angle, 0, 2 * sp.pi))
    printed = in_plane / (sp.sqrt(2 * sp.pi) * sigma)
    assert sp.simplify(printed - sp.sqrt(2 * sp.pi) * sigma) == 0  # and not 1
    assert sp.simplify(in_plane / (2 * sp.pi * sigma**2)) == 1


def check_3_41_field() -> None:
    # one place of the field beside one voxel of either region: K is 1
    b, image, c, weight, inside = (
        sp.symbols(name, positive=True) for name in ("b", "I:2", "c:2", "lambda:2", "M:2")
    )
    parts = list(zip(image, c, weight, inside, strict=True))
    energy = sum(w * (i - b * mean) ** 2 * m for i, mean, w, m in parts)
    (least,) = sp.solve(energy.diff(b), b)
    below = sum(w * mean**2 * m for _, mean, w, m in parts)
    right = sum(w * i * mean * m for i, mean, w, m in parts) / below
    printed = right.subs({w: 1 for w in weight})
    assert sp.simplify(least - right) == 0
    assert sp.simplify(least - printed) != 0
    # they are the same where the weights are
    assert sp.simplify((least - printed).subs(weight[1], weight[0])) == 0


def check_4_23_stress_power() -> None:
    f = sp.Matrix(3, 3, sp.symbols("f:9"))
    rate = sp.Matrix(3, 3, sp.symbols("d:9"))
    energy = (f.T * f).trace() / 2 + (f.det() - 1) ** 2
    p = sp.Matrix(3, 3, [energy.diff(entry) for entry in f])
    power = sum(energy.diff(a) * b for a, b in zip(f, rate, strict=True))
    right = sum(rate[i, j] * p[i, j] for i in range(3) for j in range(3))
    printed = sum(rate[i, j] * p[j, i] for i in range(3) for j in range(3))
    assert sp.expand(power - right) == 0
    assert sp.expand(power - printed) != 0


def check_4_37_passive_force() -> None:
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


def check_4_38_active_force() -> None:
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


def check_5_25_cantilever() -> None:
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


def check_5_52_weight() -> None:
    f = sp.Matrix(3, 3, sp.symbols("f:9"))
    a, bulk = sp.symbols("A K", positive=True)
    j = f.det()
    energy = a * ((f.T * f).trace() * j ** sp.Rational(-2, 3) - 3) + bulk / 2 * (j - 1) ** 2
    rest = dict(zip(f, sp.eye(3), strict=True))
    # the printed weight is zero where the load starts; the largest modulus is not
    assert energy.subs(rest) == 0
    assert sp.simplify(energy.diff(f[0, 0], 2).subs(rest) - bulk - sp.Rational(8, 3) * a) == 0


def check_5_102_weights() -> None:
    a, first, weight, value, given = sp.symbols("a A alpha b g")
    residual = first * a + value - given  # a row of the boundary, weighted in (5.79)
    gradient = (weight / 2 * residual**2).diff(a)
    assert sp.expand(gradient - weight * first * residual) == 0
    assert sp.expand(gradient - first * residual) != 0  # (5.102) with the matrices of (5.65)


def check_6_41_weight() -> None:
    alpha, dt, n, young, length, x = sp.symbols("alpha Delta_t N_S E L x", positive=True)
    # the two terms of (6.36a) on the shortest wave that the points carry
    wave = sp.sin(sp.pi * n * x / length)
    ratio = sp.simplify(dt**2 * -young * wave.diff(x, 2) / (alpha * wave))
    product = sp.symbols("c", positive=True)
    assert n not in ratio.subs(dt, product / n).free_symbols
    assert dt not in ratio.subs(n, product / dt).free_symbols
    # table 6.1: 51 points, steps of 0.2
    assert max(1, 0.2**2, 51**2) == 2601 and max(1.0, 0.2**2 * 51**2) == pytest.approx(104.04)


def check_6_72_gradient_error() -> None:
    g = sp.Matrix(3, 3, sp.symbols("g:9"))
    # a turn is an error of the gradient that (6.72) does not see
    turn = {entry: 0 for entry in g} | {g[0, 1]: 1, g[1, 0]: -1}
    assert sum(g).subs(turn) == 0
    assert (g.T * g).trace().subs(turn) == 2


# ---- right as printed ----------------------------------------------------------------------------


def test_descent_of_eight_regions() -> None:
    """(3.21)-(3.23), (B.1)-(B.3): what is printed is the slope of (3.18), (4.3)."""
    h, lam = sp.symbols("h1:4"), sp.symbols("q1:9")
    # bits of the regions of (3.19): inside of the first, second, third level set
    inside = "111", "101", "011", "110", "001", "010", "100", "000"
    pairs = [zip(h, word, strict=True) for word in inside]
    member = [sp.prod(s if bit == "1" else 1 - s for s, bit in pair) for pair in pairs]
    energy = sum(q * m for q, m in zip(lam, member, strict=True))
    printed = {  # regions of the negative and of the positive terms, in the order of their factors
        0: ((1, 2, 4, 7), (3, 5, 6, 8)),
        1: ((1, 3, 4, 6), (2, 5, 7, 8)),
        2: ((1, 3, 2, 5), (4, 6, 7, 8)),
    }
    for level, (minus, plus) in printed.items():
        one, two = (s for k, s in enumerate(h) if k != level)
        factors = one * two, (1 - one) * two, one * (1 - two), (1 - one) * (1 - two)
        force = sum(
            (lam[q - 1] - lam[p - 1]) * factor
            for p, q, factor in zip(minus, plus, factors, strict=True)
        )
        assert sp.expand(force + energy.diff(h[level])) == 0


def test_distance_term_of_the_descent() -> None:
    """(3.42): gamma (laplacian - curvature) is the descent of P of (3.39), in the plane."""
    x, y = sp.symbols("x y")
    phi = sp.Function("phi")(x, y)
    fx, fy = sp.symbols("fx fy", positive=True)
    density = (sp.sqrt(fx**2 + fy**2) - 1) ** 2 / 2
    real = {fx: phi.diff(x), fy: phi.diff(y)}
    descent = density.diff(fx).subs(real).diff(x) + density.diff(fy).subs(real).diff(y)
    norm = sp.sqrt(phi.diff(x) ** 2 + phi.diff(y) ** 2)
    curvature = (phi.diff(x) / norm).diff(x) + (phi.diff(y) / norm).diff(y)
    printed = phi.diff(x, 2) + phi.diff(y, 2) - curvature
    probe = sp.exp(x / 3) * (y + 2) + x * y**2
    at = {x: sp.Rational(1, 3), y: sp.Rational(1, 5)}
    miss = (descent - printed).subs(phi, probe).doit().subs(at)
    assert abs(float(miss)) < 1e-12


def test_quintic_kernel() -> None:
    """(5.6): four times continuously differentiable, zero at the end of its support."""
    z = sp.symbols("z")
    rows = (
        ("11/20", 0, "-9/2", 0, "81/4", "-81/4"),
        ("17/40", "15/8", "-63/4", "135/4", "-243/8", "81/8"),
        ("81/40", "-81/8", "81/4", "-81/4", "81/8", "-81/40"),
        (0, 0, 0, 0, 0, 0),
    )
    pieces = [sum(sp.Rational(c) * z**k for k, c in enumerate(row)) for row in rows]
    for n, (one, other) in enumerate(itertools.pairwise(pieces), start=1):
        for k in range(5):
            assert (one - other).diff(z, k).subs(z, sp.Rational(n, 3)) == 0
        assert (one - other).diff(z, 5) != 0


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


def test_invariants_of_appendix_c() -> None:
    """(C.3), (C.8), (C.9), (C.13)-(C.17) along three directions, exactly."""
    f0 = sp.Matrix([[11, 2, -1], [1, 9, 3], [-2, 1, 10]]) / 10
    steps = [
        sp.Matrix([[1, 0, 2], [0, 1, -1], [3, 1, 0]]),
        sp.Matrix([[0, 1, 1], [2, 0, 1], [1, -1, 2]]),
        sp.Matrix([[2, 1, 0], [-1, 1, 1], [0, 2, 1]]),
    ]
    t = sp.symbols("t1:4")
    f = f0 + sum((s * step for s, step in zip(t, steps, strict=True)), sp.zeros(3))
    c = f.T * f
    j, i1 = f.det(), c.trace()
    rest = dict.fromkeys(t, 0)
    third, i2 = sp.Rational(1, 3), (i1**2 - (c * c).trace()) / 2
    wanted = {1: i1 * j ** (-2 * third), 2: i2 * j ** (-4 * third)}
    first, *others = (np.array(matrix.tolist(), float) for matrix in (f0, *steps))
    found = _printed_appendix(first, others)
    for k, invariant in wanted.items():
        for order in (1, 2, 3):
            exactly = float(invariant.diff(*t[:order]).subs(rest))
            assert found[k][order - 1] == pytest.approx(exactly, rel=1e-11), (k, order)


def _printed_appendix(f: Any, steps: list[Any]) -> dict[int, list[float]]:
    """First to third derivatives of the reduced invariants as printed, along directions."""
    g, inv, ein = f.T @ f, np.linalg.inv(f), np.einsum
    j, i1, fg = np.linalg.det(f), np.trace(g), f @ g
    i2 = 0.5 * (i1**2 - np.trace(g @ g))
    matrices = {"f": f, "inv": inv, "eye": np.eye(3), "fg": fg, "g": g, "left": f @ f.T}

    def o(text: str) -> Any:
        """Product of matrices by their indices, of the six indices iAjBkC or the first four."""
        pairs = [pair.split(".") for pair in text.split(",")]
        names = ",".join(name for _, name in pairs)
        size = "iAjBkC" if set(names) & set("kC") else "iAjB"
        return ein(f"{names}->{size}", *(matrices[key] for key, _ in pairs))

    first = {
        1: 2 * j ** (-2 / 3) * (f - i1 / 3 * inv.T),
        2: 2 * j ** (-4 / 3) * (i1 * f - fg - 2 / 3 * i2 * inv.T),
    }
    b1 = (
        -4 / 3 * o("inv.Bj,f.iA") + 2 * o("eye.ij,eye.AB") + 4 / 9 * i1 * o("inv.Ai,inv.Bj")
        - 4 / 3 * o("f.jB,inv.Ai") + 2 / 3 * i1 * o("inv.Aj,inv.Bi")
    )  # fmt: skip
    b2 = (
        -8 / 3 * i1 * o("inv.Bj,f.iA") + 8 / 3 * o("inv.Bj,fg.iA")
        + 16 / 9 * i2 * o("inv.Bj,inv.Ai") + 4 * o("f.iA,f.jB") + 2 * i1 * o("eye.ij,eye.AB")
        - 2 * o("eye.ij,g.BA") - 2 * o("f.iB,f.jA") - 2 * o("left.ij,eye.AB")
        - 8 / 3 * i1 * o("f.jB,inv.Ai") + 8 / 3 * o("fg.jB,inv.Ai")
        + 4 / 3 * i2 * o("inv.Aj,inv.Bi")
    )  # fmt: skip
    third1 = -2 / 3 * ein("Ck,iAjB->iAjBkC", inv, b1) + (
        -4 / 3 * (-o("inv.Bk,inv.Cj,f.iA") + o("inv.Bj,eye.ik,eye.AC"))
        + 4 / 9 * (2 * o("inv.Ai,inv.Bj,f.kC") - i1 * o("inv.Ak,inv.Bj,inv.Ci")
            - i1 * o("inv.Ai,inv.Bk,inv.Cj"))
        - 4 / 3 * (o("eye.jk,eye.BC,inv.Ai") - o("f.jB,inv.Ak,inv.Ci"))
        + 2 / 3 * (2 * o("f.kC,inv.Aj,inv.Bi") - i1 * o("inv.Ak,inv.Bi,inv.Cj")
            - i1 * o("inv.Aj,inv.Bk,inv.Ci"))
    )  # fmt: skip
    slope2 = (
        # (i) to (iii)
        -8 / 3 * (-i1 * o("inv.Bk,inv.Cj,f.iA") + 2 * o("f.kC,inv.Bj,f.iA")
            + i1 * o("inv.Bj,eye.ik,eye.AC"))
        + 8 / 3 * (-o("inv.Bk,inv.Cj,fg.iA") + o("inv.Bj,eye.ik,g.CA") + o("inv.Bj,f.iC,f.kA")
            + o("inv.Bj,left.ik,eye.AC"))
        + 16 / 9 * (-i2 * o("inv.Bk,inv.Cj,inv.Ai") + 2 * i1 * o("inv.Bj,f.kC,inv.Ai")
            - 2 * o("inv.Bj,fg.kC,inv.Ai") - i2 * o("inv.Bj,inv.Ak,inv.Ci"))
        # (iv) to (viii)
        + 4 * (o("eye.ik,eye.AC,f.jB") + o("f.iA,eye.jk,eye.BC")) + 4 * o("f.kC,eye.ij,eye.AB")
        - 2 * (o("eye.ij,eye.BC,f.kA") + o("eye.ij,f.kB,eye.AC"))
        - 2 * (o("eye.ik,eye.BC,f.jA") + o("f.iB,eye.jk,eye.AC"))
        - 2 * (o("f.jC,eye.ik,eye.AB") + o("f.iC,eye.jk,eye.AB"))
        # (ix) to (xi)
        - 8 / 3 * (2 * o("f.kC,f.jB,inv.Ai") + i1 * o("eye.jk,eye.BC,inv.Ai")
            - i1 * o("f.jB,inv.Ak,inv.Ci"))
        + 8 / 3 * (o("eye.jk,g.CB,inv.Ai") + o("f.jC,f.kB,inv.Ai") + o("left.jk,eye.BC,inv.Ai")
            - o("fg.jB,inv.Ak,inv.Ci"))
        + 4 / 3 * (2 * i1 * o("f.kC,inv.Aj,inv.Bi") - 2 * o("fg.kC,inv.Aj,inv.Bi")
            - i2 * o("inv.Ak,inv.Cj,inv.Bi") - i2 * o("inv.Aj,inv.Bk,inv.Ci"))
    )  # fmt: skip
    second = {1: j ** (-2 / 3) * b1, 2: j ** (-4 / 3) * b2}
    third = {
        1: j ** (-2 / 3) * third1,
        2: j ** (-4 / 3) * (-4 / 3 * ein("Ck,iAjB->iAjBkC", inv, b2) + slope2),
    }
    orders = ("iA,iA", first), ("iAjB,iA,jB", second), ("iAjBkC,iA,jB,kC", third)
    return {
        k: [float(ein(name, of[k], *steps[:n])) for n, (name, of) in enumerate(orders, 1)]
        for k in (1, 2)
    }


# ---- the page ------------------------------------------------------------------------------------

ERRATA = {name: check for name, check in globals().items() if name.startswith("check_")}


@pytest.mark.parametrize("name", ERRATA)
def test_erratum(name: str) -> None:
    ERRATA[name]()


def test_page_names_every_check() -> None:
    text = PAGE.read_text(encoding="utf-8")
    assert set(re.findall(r"`(check_\w+)`", text)) == set(ERRATA)
    rights = {name for name in globals() if name.startswith("test_") and f"`{name}`" in text}
    assert len(rights) == 5


CUBIC = {(1, 0): 37.3, (2, 0): -3.1, (3, 0): 0.5}
BOTH = {(1, 0): 6.43, (0, 1): -3.8, (2, 0): 0.94, (1, 1): -0.0043, (0, 2): 0.0005}


@pytest.mark.parametrize("terms", [CUBIC, BOTH])
def test_stress_is_the_slope_of_the_energy(terms: dict[tuple[int, int], float]) -> None:
    material = exact.Polynomial(terms, 1e3)
    lam = np.array([1.3, 0.8, 1.1])

    def energy(stretches: np.ndarray) -> complex:
        j = np.prod(stretches)
        i1 = np.sum(stretches**2)
        i2 = 0.5 * (i1**2 - np.sum(stretches**4))
        x, y = i1 * j ** (-2 / 3) - 3.0, i2 * j ** (-4 / 3) - 3.0
        return sum(a * x**m * y**n for (m, n), a in terms.items())

    slopes = [energy(lam + 1e-30j * np.eye(3)[k]).imag / 1e-30 for k in range(3)]
    # both are exact to rounding
    np.testing.assert_allclose(material.isochoric(lam), slopes, rtol=1e-12)


def test_known_values() -> None:
    """Closed forms of Basava (2015) and values at K = 1e8 that other codes agree on."""
    free = exact.Polynomial(CUBIC, np.inf)
    assert exact.simple_shear(free, 5.0) == pytest.approx(8198.0, rel=1e-12)
    assert exact.uniaxial(free, 6.0) == pytest.approx(107306.5, rel=1e-12)
    # 5.114 with lambda = 0.1
    first = 0.01 + 20.0
    slope = 37.3 - 6.2 * (first - 3.0) + 1.5 * (first - 3.0) ** 2
    assert exact.uniaxial(free, 0.1) == pytest.approx(2 * (0.01 - 10.0) * slope, rel=1e-12)
    stiff = exact.Polynomial(CUBIC, 1e8)
    assert exact.uniaxial(stiff, 6.0) == pytest.approx(107185.2, abs=0.1)
    assert exact.dilation(exact.Polynomial(CUBIC, 250.0), 6.0) == pytest.approx(53750.0)


@pytest.mark.parametrize("bulk", [1e3, 1e7, 1e10, np.inf])
def test_tube_is_in_equilibrium(bulk: float) -> None:
    place = np.linspace(6.0, 8.0, 9)
    tube = exact.tube(exact.Polynomial(CUBIC, bulk), 6.0, 8.0, 6.0, place)
    assert tube.radius[0] == pytest.approx(12.0, abs=1e-9)
    assert tube.radial[-1] == pytest.approx(0.0, abs=1e-6)
    if bulk == np.inf:
        # nothing but the radius itself moves: r^2 - R^2 is the same everywhere
        np.testing.assert_allclose(tube.radius**2 - place**2, 108.0, rtol=1e-8)
    known = {1e3: -15.58882, 1e7: -16.320351, 1e10: -16.320438, np.inf: -16.320438}
    assert tube.radial[0] == pytest.approx(known[bulk], abs=1e-5)
