"""The least squares ladder on one scene: the same answer, and what each method says about it."""

import numpy as np
import pytest

from myork import Scene
from myork.errors import InputError
from tests.scenes import box, held, scene

#: Of the nonlinear iteration; it ends two orders below, as the last step is smaller than the one
#: that the criterion saw
TOLERANCE = 1e-7

BLOCK = scene(
    "rkcm", box(3, 3, 5, size=[1, 1, 2]), boundary=[held("z0"), held("z1", u_x=0.2, u_z=0.3)],
    material=[{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 100.0}],
    load={"steps": 2}, solver={"tolerance": TOLERANCE},
)  # fmt: skip
METHODS = ("dgels", "normal", "refined")


@pytest.fixture(scope="module")
def solved():
    """Scene, its states by method."""
    with Scene.from_tables(BLOCK, threads=1) as opened:
        yield opened, {method: opened.solve(method, error=False) for method in METHODS}


def condition(opened, x):
    """Condition of the column-scaled rows at a state."""
    unit = np.eye(opened.dofs)
    a = np.column_stack([opened.linearise(x, 1.0, column)[1] for column in unit])
    return np.linalg.cond(a / np.linalg.norm(a, axis=0))


@pytest.mark.slow
def test_all_methods_give_the_same_answer(solved):
    """Each step errs by rounding times the condition, squared for the normal equations; the
    iteration corrects that, and ends below its tolerance.
    """
    opened, states = solved
    yardstick = states["dgels"].x[-1]
    rcond = 1 / condition(opened, yardstick)
    assert np.finfo(float).eps / rcond**2 < 1e-2, "the normal equations keep two digits a step"
    for method in METHODS[1:]:
        error = np.linalg.norm(states[method].x[-1] - yardstick) / np.linalg.norm(yardstick)
        assert error < TOLERANCE, method


def test_refined_reaches_the_backward_error_of_qr(solved):
    """A few roundings for n columns; the normal equations are allowed to be worse."""
    _, states = solved
    assert states["dgels"].backward_error < 1e-14
    assert states["refined"].backward_error < 10 * states["dgels"].backward_error
    assert all(states[method].backward_error > 0.0 for method in METHODS)


def test_iterations_do_not_depend_on_the_method(solved):
    _, states = solved
    for method in METHODS[1:]:
        assert states[method].iterations.tolist() == states["dgels"].iterations.tolist()


def test_auto_is_at_the_level_of_qr(open_scene):
    assert open_scene(BLOCK).solve().backward_error < 1e-13


@pytest.mark.parametrize("name", ["dgelsx", "qr", "refined but longer"])
def test_unknown_methods_are_refused(open_scene, name):
    with pytest.raises(InputError, match="unknown least squares solver"):
        open_scene(BLOCK).solve(name)


def test_too_few_equations_are_refused(open_scene):
    """As many collocation points as source points, and hardly any on a boundary."""
    few = {**BLOCK, "geometry": box(9, 9, 9, size=[1, 1, 2], places=(3, 3, 3))}
    with pytest.raises(InputError, match="use more collocation points"):
        open_scene(few).solve()


def test_collocation_points_that_share_no_source_point_are_named(open_scene):
    """A support below the distance of collocation points: source points between them are in no
    equation, and nothing ties one layer of points to the next.
    """
    blind = {
        **BLOCK,
        "geometry": box(3, 3, 30, size=[1, 1, 2], places=(33, 33, 4)),
        "approximation": {"order": 1, "support": 2.0},
    }
    with pytest.raises(InputError, match="island: 1089 collocation points around"):
        open_scene(blind).solve()
