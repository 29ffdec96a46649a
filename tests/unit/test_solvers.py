"""The least squares ladder on matrices with known answers."""

import numpy as np
import pytest

from myork.errors import InputError, LinalgError
from tests.dense import SOLVERS, least_squares
from tests.refusals import refuses
from tests.scenes import box, held, scene, solved

#: Solvers whose answers are as good as QR's
ACCURATE = [name for name in SOLVERS if name != "normal"]
#: Enough columns for several blocks of the envelope
SIZE = (500, 300)


def problem(condition, *, seed=3, shape=SIZE, residual=1.0):
    """Matrix with given condition, a right hand side that it does not meet, and the best fit.

    The fit is exact to rounding: b is the image of x plus a vector across the range of a.
    """
    rng = np.random.default_rng(seed)
    m, n = shape
    q = np.linalg.qr(rng.standard_normal((m, m)))[0]
    v = np.linalg.qr(rng.standard_normal((n, n)))[0]
    a = q[:, :n] * np.geomspace(1.0, 1.0 / condition, n) @ v.T
    x = rng.standard_normal(n)
    return a, a @ x + residual * q[:, n:] @ rng.standard_normal(m - n), x


@pytest.mark.parametrize("name", SOLVERS)
def test_every_solver_finds_the_answer(name):
    """The error of x is bounded by rounding times the condition, squared where residuals count."""
    condition = 1e3
    a, b, x = problem(condition)
    fit = least_squares(a, b, name)
    assert np.linalg.norm(fit.x - x) < 100 * np.finfo(float).eps * condition**2 * np.linalg.norm(x)
    assert 0.0 < fit.backward_error < 1e-14
    assert fit.used in {name, "refined"} if name != "auto" else fit.used == "dgels" or fit.why


@pytest.mark.parametrize("name", ACCURATE)
def test_accuracy_of_qr_at_a_condition_that_cannot_be_squared(name):
    """At 1e7 normal equations keep no digit; the others are at the level of QR."""
    a, b, _ = problem(1e7)
    yardstick = np.linalg.lstsq(a, b, rcond=None)[0]
    fit = least_squares(a, b, name)
    best = np.linalg.norm(a @ yardstick - b)
    # the residual of a fit is longer than the best one by the square of its distance
    assert np.linalg.norm(a @ fit.x - b) < best * (1 + 1e-12)
    assert fit.misfit < 1e-8 and fit.backward_error < 1e-12


def test_normal_equations_that_miss_are_refined_and_say_so():
    """They square the condition, which shows where the residual is small."""
    a, b, _ = problem(1e6, residual=1e-6)
    fit = least_squares(a, b, "normal")
    assert fit.used == "refined" and "normal reached" in fit.why and fit.iterations > 0


@pytest.mark.parametrize("name", SOLVERS)
def test_light_rows_count_beside_heavy_ones(name):
    """Rows weighted 1e10 fix two combinations of the unknowns; the light rows fix the rest.

    The answer is the light rows' fit within the constraints, up to the inverse of the weight. Each
    solver may lose rounding times weight, 1e-6, of it.
    """
    rng = np.random.default_rng(5)
    light, heavy = rng.standard_normal((40, 6)), rng.standard_normal((2, 6))
    b, c = rng.standard_normal(40), rng.standard_normal(2)
    basis = np.linalg.qr(heavy.T, mode="complete")[0][:, 2:]
    start = np.linalg.lstsq(heavy, c, rcond=None)[0]
    x = start + basis @ np.linalg.lstsq(light @ basis, b - light @ start, rcond=None)[0]
    weighted, right = np.vstack([light, 1e10 * heavy]), np.concatenate([b, 1e10 * c])
    fit = least_squares(weighted, right, name)
    assert np.linalg.norm(fit.x - x) < 1e-4 * np.linalg.norm(x), fit.why


#: Displacement form, nearly incompressible, fixed ends: rows from 1e2 to 1e10
STIFF = scene(
    "rkcm", box(4, 4, 7, size=[1, 1, 2]), boundary=[held("z0"), held("z1", u_x=0.2, u_z=0.3)],
    material=[{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 1e8}],
)  # fmt: skip


@pytest.mark.parametrize("name", SOLVERS)
def test_undetermined_unknowns_are_named(name):
    """Two columns that differ by a factor: their unknowns, and no others, are undetermined.

    DGELSY gives the smallest solution: with columns of the same norm scaling does not change which.
    """
    a, b, _ = problem(10.0, shape=(60, 20))
    a[:, 13] = a[:, 4] * (1.0 if name == "dgelsy" else 3.0)
    if name == "dgelsy":
        fit = least_squares(a, b, name)
        assert fit.x[13] == pytest.approx(fit.x[4], rel=1e-10)
        assert np.linalg.norm(a.T @ (a @ fit.x - b)) < 1e-12 * np.linalg.norm(b)
        assert "rank 19 of 20" in fit.why
        return
    text = refuses("rank 19 of 20", least_squares, a, b, name, kind=LinalgError)
    assert "unknown 5 of 20" in text and "unknown 14 of 20" in text
    assert text.count("unknown ") == 2


@pytest.mark.parametrize(("rows", "column", "value", "error", "message"), [
    (slice(None), 7, 0.0, InputError, "unknown 8 of 20 appears in no equation"),
    (3, 7, np.nan, LinalgError, "NaN or infinite"),
])  # fmt: skip
@pytest.mark.parametrize("name", SOLVERS)
def test_matrices_that_no_solver_takes(name, rows, column, value, error, message):
    a, b, _ = problem(10.0, shape=(60, 20))
    a[rows, column] = value
    refuses(message, least_squares, a, b, name, kind=error)


def test_condition_estimate_is_near_the_condition():
    """Norms differ from the 2-norm by the square root of the number of columns."""
    a, b, _ = problem(1e4)
    a /= np.linalg.norm(a, axis=0)
    condition = np.linalg.cond(a)
    for name in SOLVERS:
        rcond = least_squares(a, b, name).rcond
        assert 1.0 / rcond == pytest.approx(condition, rel=30.0) and rcond < 3.0 / condition


@pytest.mark.parametrize("name", ["dgelsx", "qr", "refined but longer"])
def test_unknown_methods_are_refused(open_scene, name):
    refuses("unknown least squares solver", open_scene(STIFF).solve, name)


@pytest.mark.parametrize(("changes", "message"), [
    # as many collocation points as source points, and hardly any on a boundary
    ({"geometry": box(9, 9, 9, size=[1, 1, 2], places=(3, 3, 3))}, "more collocation points"),
    # a support below their distance: source points between them are in no equation
    ({"geometry": box(3, 3, 30, size=[1, 1, 2], places=(33, 33, 4)),
      "approximation": {"order": 2, "support": 3.0}}, "island: 1089 collocation points around"),
])  # fmt: skip
def test_too_few_equations_are_refused(changes, message):
    refuses(message, solved, {**STIFF, **changes})
