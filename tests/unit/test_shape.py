"""Shape functions: reproduction, derivatives, shared stencils, refusals.

Tolerances: a shape function is a moment matrix solved once, so that reproduction is exact up to
rounding times its condition number, 1e3 to 1e5 for the supports used here. Derivatives carry one
factor 1/spacing each; errors are measured in that unit.
"""

import itertools
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csr_array

from benchmarks.truths.compiled import shape_functions
from tests.scenes import refuses

KERNELS = ("quintic", "cubic")
WINDOWS = ("product", "radial")
#: Points per direction, enough that supports of order 4 do not contain the whole cloud
COUNT = {1: 21, 2: 12, 3: 8}
SECOND = {n: list(itertools.combinations_with_replacement(range(n), 2)) for n in (1, 2, 3)}


def grid(ndim, n, jitter=0.0, seed=1):
    """Grid over the unit box, moved by up to `jitter` spacings; and its spacing."""
    axis = np.linspace(0.0, 1.0, n)
    points = np.array(list(itertools.product(axis, repeat=ndim)))
    spacing = 1.0 / (n - 1)
    moves = np.random.default_rng(seed).uniform(-1.0, 1.0, points.shape)
    return points + jitter * spacing * moves, spacing


def places_in(ndim, n=40):
    return np.random.default_rng(2).uniform(0.0, 1.0, (n, ndim))


def dense(shape, nsource):
    """Values and derivatives as a full array `(nq, nplace, nsource)`."""
    size = len(shape.offset) - 1, nsource
    return np.stack([
        csr_array((one, shape.neighbour, shape.offset), size).toarray() for one in shape.value.T
    ])  # fmt: skip


def derivative(x, powers, along=()):
    """Derivative of a monomial along the coordinates listed."""
    powers, factor = np.array(powers), 1.0
    for d in along:
        factor *= powers[d]
        powers[d] = max(powers[d] - 1, 0)
    return factor * np.prod(x**powers, axis=1)


def assert_reproduces(source, support, place, spacing, order, tolerance=1e-11, **choice):
    ndim = source.shape[1]
    full = dense(shape_functions(source, support, place, order=order, **choice), len(source))
    kinds = [()] + [(i,) for i in range(ndim)] + SECOND[ndim]
    products = itertools.product(range(order + 1), repeat=ndim)
    for powers in (powers for powers in products if sum(powers) <= order):
        nodal = derivative(source, powers)
        for q, along in enumerate(kinds):
            error = (full[q] @ nodal - derivative(place, powers, along)) * spacing ** len(along)
            assert abs(error).max() < tolerance, (powers, along)


#: Dimension, order, jitter, support, tolerance, window; orders above 4 lose two digits to a
#: moment matrix of condition 1e7
REPRODUCED = [
    *((n, order, 0.2, order + 1.6, 1e-11, {}) for n in (1, 2, 3) for order in (1, 2, 3, 4)),
    *((2, order, 0.1, order + 1.6, 1e-9, {}) for order in (5, 6)),
    *((n, 2, 0.2, 4.1, 1e-11, {"kernel": kernel, "window": window})
      for n in (1, 2, 3) for kernel in KERNELS for window in WINDOWS),
]  # fmt: skip


@pytest.mark.parametrize(("ndim", "order", "jitter", "support", "tolerance", "choice"), REPRODUCED)
def test_reproduces_polynomials_and_their_derivatives(
    ndim, order, jitter, support, tolerance, choice
):
    source, spacing = grid(ndim, COUNT[ndim], jitter)
    place = places_in(ndim)
    assert_reproduces(source, support * spacing, place, spacing, order, tolerance, **choice)


@pytest.mark.parametrize("window", WINDOWS)
def test_supports_may_differ_by_direction_and_point(window):
    """Voxels of aspect ratio 1 : 20, and supports that vary from point to point."""
    stretch = np.array([1.0, 0.05, 0.3])
    source, spacing = grid(3, COUNT[3], jitter=0.2)
    vary = np.random.default_rng(3).uniform(3.6, 4.4, (len(source), 1))
    support = vary * spacing * stretch
    place = places_in(3)
    shape = shape_functions(source * stretch, support, place * stretch, order=2, window=window)
    full = dense(shape, len(source))
    assert_allclose(full[0].sum(axis=1), 1.0, rtol=0, atol=1e-12)
    assert_allclose(full[0] @ (source * stretch), place * stretch, rtol=0, atol=1e-11)
    # the second derivative along the thinnest direction, in its own unit
    thin = (full[7] @ (source[:, 1] ** 2)) * (stretch[1] * spacing) ** 2
    assert_allclose(thin, 2 * spacing**2, rtol=0, atol=1e-11)


def test_only_points_that_cover_a_place_contribute():
    source, spacing = grid(2, 10, jitter=0.2)
    place = places_in(2)
    support = 3.3 * spacing
    shape = shape_functions(source, support, place, order=2)
    full = dense(shape, len(source))
    covered = (abs(place[:, None] - source[None]) < support).all(axis=2)
    assert_array_equal(np.diff(shape.offset), covered.sum(axis=1))
    assert not full[0][~covered].any()


def assert_derivatives(source, support, place, spacing, first, second, **choice):
    """First derivatives are those of the values, second ones of the first, to central differences
    with step e: truncation e^2 and rounding 1e-15 condition/e balance near 1e-4 spacings.
    """
    ndim = source.shape[1]

    def at(points):
        return dense(shape_functions(source, support, points, order=2, **choice), len(source))

    centre = at(place)
    for d in range(ndim):
        move = 1e-4 * spacing * np.eye(ndim)[d]
        slope = (at(place + move) - at(place - move)) / (2e-4 * spacing)
        assert_allclose(centre[1 + d] * spacing, slope[0] * spacing, rtol=0, atol=first)
        for q, pair in enumerate(SECOND[ndim]):
            if d in pair:
                along = slope[1 + pair[pair[0] == d]]
                found = centre[1 + ndim + q] * spacing**2
                assert_allclose(found, along * spacing**2, rtol=0, atol=second)


@pytest.mark.parametrize("kernel", KERNELS)
@pytest.mark.parametrize("window", WINDOWS)
def test_derivatives_are_those_of_the_values(window, kernel):
    source, spacing = grid(3, 6, jitter=0.2)
    place = 0.1 + 0.8 * places_in(3, 15)
    # the cubic spline's second derivative has kinks
    second = 1e-6 if kernel == "quintic" else 1e-3
    choice = {"kernel": kernel, "window": window}
    assert_derivatives(source, 3.2 * spacing, place, spacing, 1e-6, second, **choice)


def test_equal_stencils_are_evaluated_once():
    """On a grid with a support of 2.5 spacings only the two rows next to each face are special:
    5 positions per direction, 5^3 stencils for 9^3 places.
    """
    for jitter, count in ((0.0, 5), (1e-3, 9)):
        source, _ = grid(3, 9, jitter=jitter)
        assert shape_functions(source, 2.5 / 8, source, order=2).stencils == count**3


def test_shared_stencils_do_not_change_values():
    """Displaced points share no stencil: values differ to first order in the displacement."""
    place, spacing = grid(2, 9)
    shared, *own = (
        dense(shape_functions(grid(2, 9, jitter)[0], 3.3 * spacing, place, order=2), len(place))[0]
        for jitter in (0.0, 1e-3, 1e-2)
    )
    difference = [abs(one - shared).max() for one in own]
    assert 1e-5 < difference[0] < 1e-2
    assert difference[1] == pytest.approx(10 * difference[0], rel=0.1)


#: A square of points 0.1 apart
SQUARE = grid(2, 11)[0]
REFUSALS = {
    "order 7": ({"order": 7}, "0..6, not 7"),
    "no support": ({"support": 0.0}, "positive"),
    "infinite support": ({"support": np.inf}, "positive"),
    "NaN source": ({"source": np.where(SQUARE == 0.5, np.nan, SQUARE)}, "finite"),
    "NaN place": ({"place": [[np.nan, 0.5]]}, "finite"),
    "too few neighbours": ({"support": 0.11}, "point 1 at"),
    "far away": ({"place": [[0.5, 0.5], [7.0, 7.0]]}, "point 2 at (7, 7)"),
    "unknown kernel": ({"kernel": "sextic"}, "quintic cubic"),
    "unknown window": ({"window": "round"}, "product radial"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_refusals_say_what_is_wrong(case):
    changes, message = REFUSALS[case]
    arguments = {"source": SQUARE, "support": 0.32, "place": [[0.51, 0.52]], **changes}
    refuses(re.escape(message), shape_functions, **arguments)


def test_order_that_wants_more_points_across_says_so():
    """Three points across support a basis of order 2, with any support."""
    source = np.array([[x, 0.5 * y] for x in range(7) for y in range(3)], float)
    said = "along y there are 3: use more of them, or order 2"
    refuses(said, shape_functions, source, 9.0, [[0.51, 0.52]], order=4)
    shape_functions(source, 9.0, [[0.51, 0.52]], order=2)


def test_support_that_is_too_small_is_refused():
    said = "singular moment matrix with 4 neighbours.*use a larger support"
    refuses(said, shape_functions, SQUARE, 0.105, [[0.51, 0.52]], order=2)


def test_flat_and_repeated_points_have_no_cure():
    """Points in a plane, and ten copies of five points: no support makes these regular."""
    flat, spacing = grid(3, 6)
    flat[:, 2] = 0.5
    support, place = 3.2 * spacing, [[0.5, 0.5, 0.5]]
    refuses("line or plane", shape_functions, flat, support, place, order=2)
    copies = np.repeat(grid(2, 3)[0][::2], 10, axis=0)
    refuses("coincide", shape_functions, copies, 4.0, [[0.2, 0.5]], order=2)


def ring(radial=6, angular=13):
    """Quarter of a ring of points from radius 1 to 2; their radii; spacings in radius and angle."""
    r, t = np.meshgrid(np.linspace(1.0, 2.0, radial), np.linspace(0.0, 0.5 * np.pi, angular))
    return around(r, t), r.ravel(), 1.0 / (radial - 1), 0.5 * np.pi / (angular - 1)


def around(radius, angle):
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=-1).reshape(-1, 2)


@pytest.mark.parametrize("kernel", KERNELS)
def test_windows_of_radius_and_angle(kernel):
    """They reproduce polynomials with their derivatives, and turn with the position."""
    source, r, step, turn = ring()
    support = np.stack([np.full_like(r, 3.1 * step), 3.1 * turn * r], axis=1)
    choice = {"kernel": kernel, "window": "polar"}
    place = around(np.repeat([1.0, 1.37, 1.9], 6), np.tile(np.arange(6) * turn + 3.3 * turn, 3))
    assert_reproduces(source, support, place, step, 2, **choice)
    full = dense(shape_functions(source, support, place, order=2, **choice), len(source))
    # 6 points lie on each radius, one radius after the other
    assert_allclose(full[0, 1, 6:], full[0, 0, :-6], rtol=0, atol=1e-12)
    # third derivatives of the cubic spline jump
    assert_derivatives(source, support, place, step, 1e-7, 1e-5, **choice)
