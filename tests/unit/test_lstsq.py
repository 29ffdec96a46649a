"""The least squares ladder on one scene: the same answer, and what each method says about it."""

import numpy as np
import pytest

from myork.errors import InputError

#: Of the nonlinear iteration; it ends two orders below, as the last step is smaller than the one
#: that the criterion saw
TOLERANCE = 1e-7

BLOCK = {
    "scene": {"dimension": 3, "method": "rkcm"},
    "geometry": {"kind": "box", "size": [1, 1, 2], "source": [3, 3, 5], "collocation": [5, 5, 9]},
    "material": [{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 100.0}],
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "u_x": 0.2, "u_y": 0, "u_z": 0.3},
    ],
    "load": {"steps": 2},
    "solver": {"tolerance": TOLERANCE},
    "probe": [{"name": "pull", "quantity": "force", "set": "z1"}],
}
METHODS = ("dgels", "normal", "refined")


@pytest.fixture
def solved(open_scene):
    """Scene, its states by method."""
    scene = open_scene(BLOCK)
    return scene, {method: scene.solve(method) for method in METHODS}


def condition(scene, x):
    """Condition of the column-scaled rows at a state."""
    unit = np.eye(scene.dofs)
    a = np.column_stack([scene.linearise(x, 1.0, column)[1] for column in unit])
    return np.linalg.cond(a / np.linalg.norm(a, axis=0))


@pytest.mark.slow
def test_all_methods_give_the_same_answer(solved):
    """Each step errs by rounding times the condition, squared for the normal equations; the
    iteration corrects that, and ends below its tolerance.
    """
    scene, states = solved
    yardstick = states["dgels"].x[-1]
    rcond = 1 / condition(scene, yardstick)
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
    scene = open_scene(BLOCK)
    assert scene.solve().backward_error < 1e-13


@pytest.mark.parametrize("name", ["dgelsx", "qr", "refined but longer"])
def test_unknown_methods_are_refused(open_scene, name):
    with pytest.raises(InputError, match="unknown least squares solver"):
        open_scene(BLOCK).solve(name)


def test_too_few_equations_are_refused(open_scene):
    """As many collocation points as source points, and hardly any on a boundary."""
    few = {
        **BLOCK,
        "geometry": {**BLOCK["geometry"], "source": [9, 9, 9], "collocation": [3, 3, 3]},
    }
    with pytest.raises(InputError, match="use more collocation points"):
        open_scene(few).solve()


def test_collocation_points_that_share_no_source_point_are_named(open_scene):
    """A support below the distance of collocation points: source points between them are in no
    equation, and nothing ties one layer of points to the next.
    """
    blind = {
        **BLOCK,
        "geometry": {**BLOCK["geometry"], "source": [3, 3, 30], "collocation": [33, 33, 4]},
        "approximation": {"order": 1, "support": 2.0},
    }
    with pytest.raises(InputError, match="island: 1089 collocation points around"):
        open_scene(blind).solve()
