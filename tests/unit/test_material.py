"""Materials: energy, stress, C4 and contracted C6 against formulas of the thesis, written here.

The stress of reference is the complex-step derivative of the energy (exact to rounding). Second
and third derivatives are checked by central differences of eighth order with step 2e-3: the
truncation is of the order (2e-3)^8 = 3e-22 times ninth derivatives (below 1e6 for the states used)
and the rounding 1e-16/2e-3 = 5e-14, both far below the tolerance of 1e-8 of the largest entry.
"""

import itertools
import math
import re

import numpy as np
import pytest
from scipy.optimize import brentq

from benchmarks.truths.peers import derivatives, fiber_pieces
from myork.core import material as cm
from myork.core.deck import load_deck
from myork.errors import MyorkError
from tests.scenes import PLANES, box, derivative, probes, refuses, scene, solved


def made(name, K, model="polynomial", **parameters):
    return cm.Material(name, float(K), model, **parameters)


RUBBER = made("rubber", 1e3, A10=37.3, A20=-3.1, A30=0.5)
MATRIX = {"A10": 6.43, "A01": -3.8, "A20": 0.94, "A02": 0.0005, "A11": -0.0043}
MUSCLE = made("muscle", 5e3, "muscle", **MATRIX)
CUBIC = {"A30": 0.5, "A21": 0.6, "A12": -0.2, "A03": 0.1}
FULL = made("full", 50, A10=3, A01=2, A20=0.7, A11=-0.3, A02=0.4, **CUBIC)
ISOTROPIC = [
    RUBBER, made("tissue", 5e4, A10=30, A20=80, A30=800), made("fat", 5e3, A10=3, A20=8, A30=80),
    FULL, made("second", 50, A01=2, A02=0.4), made("matrix", 5e3, **MATRIX),
]  # fmt: skip
#: Energies given as expressions, or under their names, with their formulas in Python
WRITTEN = {
    "neo": (made("neo", 50, "neo-hookean", mu=7.0), "mu/2*(I1-3)"),
    "mooney": (made("mooney", 50, "mooney-rivlin", C1=3.0, C2=-1.0), "C1*(I1-3) + C2*(I2-3)"),
    "yeoh": (made("yeoh", 50, "yeoh", C1=3.0, C2=-0.4, C3=0.1),
             "C1*(I1-3) + C2*(I1-3)**2 + C3*(I1-3)**3"),
    "gent": (made("gent", 50, "gent", mu=7.0, Jm=9.0), "-mu*Jm/2*log(1 - (I1-3)/Jm)"),
    "fung": (made("fung", 50, "fung", mu=7.0, k2=0.6), "mu/(2*k2)*(exp(k2*(I1-3)) - 1)"),
    "holzapfel": (made("holzapfel", 50, "holzapfel", mu=7.0, k1=3.0, k2=0.8),
                  "mu/2*(I1-3) + k1/(2*k2)*(exp(k2*maximum(I4-1, 0)**2) - 1)"),
    **{text: (made(text, 50, "energy", energy=text, mu=7.0, C2=0.4), python or text)
       for text, python in {
        "mu*(I1-3) + C2*mu*(I1-3)*(I2-3)*(I4-1)": "",
        "mu*sinh(I1-3) - C2*cosh(I2)/I4^-2 + tanh(I1*I4)":
            "mu*sinh(I1-3) - C2*cosh(I2)/I4**-2 + tanh(I1*I4)",
        "mu*(I1-3) - C2*sin(I1)*cos(I2) + sqrt(I1*I2)/I4 + I2^I4/ln(I2+pi)":
            "mu*(I1-3) - C2*sin(I1)*cos(I2) + sqrt(I1*I2)/I4 + I2**I4/log(I2+pi)",
        "mu*(I1-3) + C2*(activation + 0.5)^1.5*(I4 > 0.1)*(-min(I1, 0)^2 + abs(-I1*I4)^3)":
            "mu*(I1-3) + C2*(activation + 0.5)**1.5*(I1*I4)**3",
       }.items()},
}  # fmt: skip

FIBER = np.array([2.0, -1.0, 3.0]) / math.sqrt(14)
NO_FIBER = np.zeros(3)


def random_gradient(rng, plane=False):
    """Deformation gradient with J between 0.8 and 1.3."""
    size = 2 if plane else 3
    part = np.eye(size) + 0.25 * rng.standard_normal((size, size))
    if np.linalg.det(part) < 0:
        part[0] *= -1
    part *= (rng.uniform(0.8, 1.3) / np.linalg.det(part)) ** (1 / size)
    f = np.eye(3)
    f[:size, :size] = part
    return f


def random_rotation(rng):
    q, _ = np.linalg.qr(rng.standard_normal((3, 3)))
    return q * np.sign(np.linalg.det(q))


def fiber_stretch(f, fiber):
    """Isochoric stretch of the fiber, below (4.34); F may be complex."""
    return np.sqrt(fiber @ (f.T @ f) @ fiber) * np.linalg.det(f) ** (-1 / 3)


def invariants(f):
    """Isochoric I1 and I2 of C, and J; F may be complex."""
    c, j = f.T @ f, np.linalg.det(f)
    i1, i2 = np.trace(c), (np.trace(c) ** 2 - np.trace(c @ c)) / 2
    return i1 * j ** (-2 / 3), i2 * j ** (-4 / 3), j


def energy_of(material, f, fiber, activation, volumetric):
    """(4.35) with third order terms, or the formula of an expression; F may be complex."""
    i1, i2, j = invariants(f)
    if material.name in WRITTEN:
        names = {**vars(np), **material.parameters, "activation": activation, "I1": i1, "I2": i2}
        names["I4"] = fiber_stretch(f, fiber) ** 2 if fiber.any() else 1.0
        w = eval(WRITTEN[material.name][1], names)
    else:
        orders = [(m, n) for m in range(4) for n in range(4) if 1 <= m + n <= 3]
        w = sum(getattr(material, f"A{m}{n}") * (i1 - 3) ** m * (i2 - 3) ** n for m, n in orders)
    return w + (material.K / 2 * (j - 1) ** 2 if volumetric else 0)


def reference_stress(material, f, fiber, activation, volumetric=True):
    """Complex-step derivative of the energy, the fibers by (4.36) and dlambda/dF."""
    p, dlambda = np.zeros((2, 3, 3))
    fibered = material.model == "muscle" and fiber.any()
    for place in np.ndindex(3, 3):
        g = f.astype(complex)
        g[place] += 1e-30j
        p[place] = energy_of(material, g, fiber, activation, volumetric).imag / 1e-30
        if fibered:
            dlambda[place] = fiber_stretch(g, fiber).imag / 1e-30
    if fibered:
        s = fiber_stretch(f, fiber) / material.lambda_o
        active, passive = (at_stretch(one, s)[0] for one in fiber_pieces(material.parameters))
        p += material.sigma_max / material.lambda_o * (activation * active + passive) * dlambda
    return p


def at_stretch(pieces, s):
    """Force of a curve at a normalised stretch, and its derivatives."""
    return derivatives(next(piece for piece in reversed(pieces) if s > piece["start"]), s)


def slopes(function, f, *directions):
    """Derivatives by a gradient along directions, by central differences of eighth order, of a
    function of many gradients.
    """
    size = np.linalg.norm(directions, axis=(1, 2))[:, None, None]
    moves = np.array(directions) / size
    found = derivative(lambda h: function(f + h * moves), 2e-3)
    return found * size.reshape(-1, *[1] * (found.ndim - 1))


def curves(stretch, **parameters):
    """Energy and force of active and of passive fibers (4.37), (4.38), as corrected, at normalised
    stretches: of a uniaxial stress two thirds are deviatoric.
    """
    # soft, so that few digits are lost to the matrix
    muscle = made("muscle", 1.0, "muscle", sigma_max=30.0, A10=1e-3, **parameters)
    f = np.array([np.diag([s, s**-0.5, s**-0.5]) for s in stretch])

    def along(fiber, activation):
        where = {"fiber": fiber, "activation": activation, "volumetric": False}
        return np.stack(
            [cm.energy(muscle, f, **where) / 30, cm.stress(muscle, f, **where)[:, 0, 0] / 20]
        )

    rest, passive, active = along((0, 0, 0), 0.0), along((1, 0, 0), 0.0), along((1, 0, 0), 1.0)
    return active - passive, passive - rest


def at(material, f, second=None, **options):
    """All results at one point."""
    second = np.zeros((3, 3, 3)) if second is None else second
    return cm.Tangents(*(x[0] for x in cm.strong(material, f[None], second[None], **options)))


def cases():
    """Material, fiber, activation, requested lambda* (None: unspecified)."""
    found = {m.name: (m, NO_FIBER, 0.0, None) for m in ISOTROPIC}
    found["muscle-without-fiber"] = MUSCLE, NO_FIBER, 0.7, None
    # One lambda* in every branch of (4.37), (4.38), and in every zone of the smooth curves, which
    # are [0.4, 0.55], [0.55, 0.65], [1, 1.15], [1.35, 1.45], [1.45, 1.6]
    for curve, stretches in {
        "published": (0.3, 0.5, 0.8, 1.2, 1.5, 1.8),
        "smooth": (0.3, 0.475, 0.6, 0.85, 1.075, 1.25, 1.4, 1.525, 1.8),
    }.items():
        for s, level in itertools.product(stretches, (0.0, 0.7)):
            found[f"{curve}-{s}-at-{level}"] = MUSCLE.replace(curve=curve), FIBER, level, s
    for name, (material, _) in WRITTEN.items():
        for kind, fiber in (("without", NO_FIBER), ("with", FIBER)):
            found[f"{name}-{kind}-fiber"] = material, fiber, 0.7, None
    return [pytest.param(*case, id=name) for name, case in found.items()]


def placed(material, f, fiber, wanted):
    """The material with lambda_o such that the fiber has the requested normalised stretch."""
    if wanted is None:
        return material
    return material.replace(lambda_o=float(fiber_stretch(f, fiber)) / wanted)


def assert_close(actual, expected, tolerance):
    scale = np.abs(expected).max()
    np.testing.assert_allclose(actual, expected, rtol=0, atol=tolerance * scale)


@pytest.mark.parametrize("volumetric", [True, False])
@pytest.mark.parametrize(("material", "fiber", "activation", "wanted"), cases())
def test_energy_to_stress_to_tangents(material, fiber, activation, wanted, volumetric):
    rng = np.random.default_rng(11)
    for _ in range(3):
        f = random_gradient(rng)
        law = placed(material, f, fiber, wanted)
        check_derivatives(law, f, rng, fiber=fiber, activation=activation, volumetric=volumetric)


def check_derivatives(law, f, rng, **options):
    h = rng.standard_normal((3, 3, 3))  # H[j, B, A], deliberately without symmetry
    result = at(law, f, h, **options)
    expected = reference_stress(law, f, **options)
    # both exact to rounding; 1e-11 leaves room for cancellation in the reference
    assert_close(result.stress, expected, 1e-11)
    # v and -v are one fiber
    for fiber in (options["fiber"], -options["fiber"]):
        own = cm.stress(law, f[None], **options | {"fiber": fiber})[0]
        np.testing.assert_array_equal(own, result.stress)
    direction = rng.standard_normal((3, 3))
    slope = slopes(lambda g: cm.energy(law, g, **options), f, direction)[0]
    scale = np.linalg.norm(expected) * np.linalg.norm(direction)
    assert abs(slope - np.sum(expected * direction)) < 1e-8 * scale
    # the stress agrees with the reference at any gradient
    c4 = slopes(lambda g: cm.stress(law, g, **options), f, *np.eye(9).reshape(9, 3, 3))
    assert_close(result.tangent, c4.reshape(3, 3, 3, 3).transpose(2, 3, 0, 1), 1e-8)
    still = np.zeros((3, 3, 3, 3))
    changes = slopes(
        lambda g: cm.strong(law, g, still, **options).tangent, f, *np.moveaxis(h, 2, 0)
    )
    assert_close(result.contracted, np.einsum("aiajb->ijb", changes), 1e-8)


@pytest.mark.parametrize(("material", "fiber", "activation", "wanted"), cases())
def test_plane_strain_is_the_part_of_space(material, fiber, activation, wanted):
    rng = np.random.default_rng(5)
    f = random_gradient(rng, plane=True)
    h = np.zeros((3, 3, 3))
    h[:2, :2, :2] = rng.standard_normal((2, 2, 2))
    law = placed(material, f, fiber, wanted)
    space = at(law, f, h, fiber=fiber, activation=activation)
    unread = np.full((3, 3, 3), np.nan)
    unread[:2, :2, :2] = h[:2, :2, :2]
    plane = at(law, f, unread, dimension=2, fiber=fiber, activation=activation)
    np.testing.assert_array_equal(plane.stress, space.stress)
    for flat, full in zip(plane[1:], space[1:], strict=True):
        inside = (slice(0, 2),) * flat.ndim
        assert_close(flat[inside], full[inside], 1e-14)
        outside = flat.copy()
        outside[inside] = 0
        assert not outside.any()


@pytest.mark.parametrize("curve", ["published", "smooth"])
def test_at_rest_nothing_pulls_but_active_fibers(curve):
    """Active fibers with sigma_max; energies of passive materials are zero there."""
    rest = np.eye(3)[None]
    muscle = MUSCLE.replace(curve=curve)
    named = [WRITTEN[name][0] for name in ("neo", "mooney", "yeoh", "gent", "fung", "holzapfel")]
    for law in (*ISOTROPIC, muscle, *named):
        assert np.abs(cm.stress(law, rest, fiber=FIBER)).max() < 1e-13 * law.K
        assert cm.energy(law, rest, fiber=FIBER)[0] == pytest.approx(0, abs=1e-13)
    p = cm.stress(muscle, rest, fiber=FIBER, activation=0.4)[0]
    assert_close(p, 30 * 0.4 * (np.outer(FIBER, FIBER) - np.eye(3) / 3), 1e-12)


@pytest.mark.parametrize("bulk", [1e3, 1e7, 1e10])
def test_volumetric_part_is_exact_for_any_bulk_modulus(bulk):
    rng = np.random.default_rng(2)
    law = FULL.replace(K=bulk)
    # shear keeps the volume: no spurious pressure, even where 1e-16 K would be visible
    shear = np.eye(3) + np.outer([5.0, 0, 0], [0, 1, 0])
    with_k, without_k = (at(law, shear, volumetric=own).stress for own in (True, False))
    np.testing.assert_array_equal(with_k, without_k)
    # small dilation: J - 1 has an error of 3 roundings of J, 3.3e-16/3e-6 = 1e-10
    exact = bulk * (3e-6 + 3e-12 + 1e-18) * (1 + 1e-6) ** 2
    assert at(law, np.diag([1 + 1e-6] * 3)).stress[0, 0] == pytest.approx(exact, rel=1e-9)
    # the part of K is K (J - 1) cof F and its derivatives; the remainder does not depend on K
    f, h = random_gradient(rng), rng.standard_normal((3, 3, 3))
    full, rest = at(law, f, h), at(law, f, h, volumetric=False)
    soft = at(law.replace(K=1.0), f, h, volumetric=False)
    j = np.linalg.det(f)
    assert_close(full.stress - rest.stress, bulk * (j - 1) * j * np.linalg.inv(f).T, 1e-12)
    for a, b in zip(rest, soft, strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("j", [1e-2, 1e-4, 1e-6])
def test_nearly_singular_gradient_keeps_its_digits(j):
    rng = np.random.default_rng(4)
    q, r = random_rotation(rng), random_rotation(rng)
    f = q @ np.diag([j, 1.2, 0.9]) @ r
    p = at(FULL, f, volumetric=False).stress
    # F itself is rounded: relative errors of 1e-16/j in J, a few times that in W
    assert_close(p, reference_stress(FULL, f, NO_FIBER, 0.0, False), 1e-14 / j)


def test_points_are_independent():
    rng = np.random.default_rng(9)
    f = np.array([random_gradient(rng) for _ in range(64)])
    fibers = rng.standard_normal((64, 3))
    fibers /= np.linalg.norm(fibers, axis=1)[:, None]
    h = rng.standard_normal((64, 3, 3, 3))
    together = cm.strong(MUSCLE, f, h, fiber=fibers, activation=0.3)
    for i in (0, 17, 63):
        alone = at(MUSCLE, f[i], h[i], fiber=fibers[i], activation=0.3)
        for a, b in zip(together, alone, strict=True):
            np.testing.assert_array_equal(a[i], b)
    only = cm.stress(MUSCLE, f, fiber=fibers, activation=0.3)
    np.testing.assert_array_equal(only, together.stress)
    # a fiber that is not a number does not count as none
    assert np.isnan(cm.stress(MUSCLE, np.eye(3)[None], fiber=[np.nan, 0, 0])).all()


@pytest.mark.parametrize(("curve", "orders"), [("published", 1), ("smooth", 3)])
def test_forces_of_fibers_are_those_of_pieces_that_meet(curve, orders):
    """In value, smooth ones up to the second derivative; energies are their integrals."""
    stretch = np.linspace(0.2, 2.2, 2001)
    pieces = fiber_pieces(MUSCLE.replace(curve=curve).parameters)
    for (energy, found), own in zip(curves(stretch, curve=curve), pieces, strict=True):
        force = np.array([at_stretch(own, s)[0] for s in stretch])
        np.testing.assert_allclose(found, force, rtol=1e-9, atol=1e-9)
        means = 0.5 * (force[1:] + force[:-1]) * np.diff(stretch)
        np.testing.assert_allclose(np.diff(energy), means, rtol=0, atol=1e-6 * force.max())
        for before, after in itertools.pairwise(own):
            one, other = (derivatives(part, after["start"])[:orders] for part in (before, after))
            np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-6)


def test_smooth_curves_stay_near_the_published_ones():
    stretch = np.linspace(0.2, 2.2, 20001)
    (active, passive), published = (
        [force for _, force in curves(stretch, curve=c)] for c in ("smooth", "published")
    )
    # both have a peak or a scale of one
    for own, other in zip((active, passive), published, strict=True):
        assert np.abs(own - other).max() < 0.02
    assert active.min() > -1e-14  # rounding where the force vanishes at 1.6
    assert not active[(stretch <= 0.4) | (stretch > 1.6)].any()
    assert not passive[stretch <= 1].any() and np.diff(passive).min() >= 0
    inside = stretch <= 1.8
    mirrored = curves(2 - stretch[inside], curve="smooth")[0][1]
    np.testing.assert_allclose(active[inside], mirrored, rtol=0, atol=1e-13)
    assert np.diff(active[(stretch > 0.4) & (stretch < 1)]).min() > 0


#: Impossible parameters, and the messages
IMPOSSIBLE = [
    *(("muscle", {**MUSCLE.parameters, **changes}, words) for changes, *words in (
        ({"K": math.inf}, "K = inf", "volumetric=False"),
        ({"A01": -6.43}, "A10 + A01 = 0", "positive"),
    )),
    # a parameter that a model must have, according to the schema (test_deck)
    *(("soft", {"K": 50.0, "model": "neo-hookean", **changes}, words) for changes, *words in (
        ({}, "mu: missing: a number is needed for model = neo-hookean"),
        ({"model": "mooney-rivlin", "C1": 1, "C2": -1}, "C1 + C2 = 0", "positive"),
        ({"model": "yeoh", "C1": -1, "C2": 0, "C3": 1}, "C1 = -1", "positive"),
        *(({"model": "energy", "mu": 3, "energy": text}, f"energy = '{text}'", *words)
          for text, *words in (
            ("mu*(I1-3", "Missing parenthesis"),
            ("mu*(J-1)", "Unexpected token \"J\"", "Names are I1, I2, I4, activation, mu"),
            ("mu*atan2(I1, 1)", "atan2", "functions are abs, cos"),
            ("mu*sqrt(I1-3)", "no finite derivatives"),
            ("mu*I1 + (I1-3)^1.5", "no finite derivatives"),
            ("-mu*I1", "dW/dI1 + dW/dI2 = -3", "positive"),
            ("I1 > 3 ? mu*I1 : 0", "max(a, b), min(a, b) or (I4 > 1)*a instead of c ? a : b"),
            ("mu*I1, 2", "several values"),
            ("2*I1", "does not use all of its constants: mu"),
            ("mu*I1*(1 + activation)", "no fibers, I4"),
            ("mu*I1" + " + 2*I2" * 200, "is too long", "at most 400"),
        )),
    )),
]  # fmt: skip


@pytest.mark.parametrize(("name", "parameters", "words"), IMPOSSIBLE)
def test_impossible_parameters_are_refused_by_name(name, parameters, words):
    """Checks made by the law itself."""
    said = "".join(f"(?=.*{re.escape(word)})" for word in (name, *words))
    refuses(f"(?s){said}", lambda: cm.stress(cm.Material(name, **parameters), np.eye(3)[None]))


@pytest.mark.parametrize("call", [
    lambda: cm.stress(RUBBER, np.eye(3)),
    lambda: cm.stress(RUBBER, np.zeros((0, 3, 3))),
    lambda: cm.stress(RUBBER, np.eye(3)[None], fiber=np.zeros((2, 3))),
    lambda: cm.strong(RUBBER, np.eye(3)[None], np.zeros((1, 3, 3))),
    lambda: cm.strong(RUBBER, np.eye(3)[None], np.zeros((1, 3, 3, 3)), dimension=1),
    lambda: curves([1.0], curve="rough"),
    lambda: curves([1.0], gamma2=-1),
])  # fmt: skip
def test_wrong_shapes_and_choices_are_refused(call):
    refuses(".", call)


@pytest.mark.parametrize("model", ["polynomial", "muscle"])
def test_defaults_are_those_of_decks(model):
    """Values have a single source: a deck without a key and a material without it have the same."""
    deck = load_deck({"material": [{"name": "it", "model": model, "K": 7.0}]})["material"][0]
    own = made("it", 7.0, model)
    assert own.parameters == {k: deck[k] for k in deck if k != "name"}
    assert ("gamma2" in deck) == (model == "muscle")
    with pytest.raises(AttributeError, match="has no stiffness"):
        _ = own.stiffness


def test_a_law_with_a_limit_is_not_left_by_a_step():
    """Gent's rubber stretched to 1.35 keeps I1 - 3 below Jm = 0.4; at 1.6 no state exists, and none
    is written."""

    def pulled(stretch):
        return solved(scene(
            "rkpm-gauss", box(3, 3, 3), load={"steps": 1}, probe=probes("f force_z z1"),
            material=[{"name": "it", "model": "gent", "mu": 10, "Jm": 0.4, "K": 1000}],
            boundary=[*PLANES, {"set": "z1", "u_z": stretch - 1}],
        )).last()["f"]  # fmt: skip

    def drawn(side):
        gent = made("it", 1000, "gent", mu=10, Jm=0.4)
        return cm.stress(gent, np.diag([side, side, 1.35])[None])[0]

    side = brentq(lambda side: drawn(side)[0, 0], 0.85, 0.9, xtol=1e-13)
    assert pulled(1.35) == pytest.approx(drawn(side)[2, 2], rel=1e-6)
    refuses(".", pulled, 1.6, kind=MyorkError)


def test_where_a_material_lies_is_no_parameter() -> None:
    """`myork check` evaluates the law of a table that fills a part of a box."""
    table = {"name": "gel", "model": "neo-hookean", "mu": 2.0, "K": 10.0, "where": "x > 1"}
    assert cm.energy(cm.Material.of_table(table), [1.1 * np.eye(3)])[0] > 0.0
