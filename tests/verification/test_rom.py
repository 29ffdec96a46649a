"""Reduced models: modes, projection, and what they lose against the full model."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from myork.core.scene import pod_basis
from myork.rom.errors_of import displacement_error, gradient_error

BLOCK = {
    "scene": {"dimension": 3, "method": "rkcm"},
    "geometry": {"kind": "box", "size": [1, 1, 2], "source": [3, 3, 4], "collocation": [5, 5, 7]},
    "material": [
        {"name": "m", "model": "muscle", "A10": 6.43, "A20": 0.94, "K": 100.0, "curve": "smooth"}
        | {"fiber": [0.5, 0.0, 0.866]}
    ],
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "u_x": 0, "u_y": 0, "u_z": 0},
    ],
    "load": {"steps": 5, "activation": 0.5},
    "solver": {"tolerance": 1e-9},
}


@pytest.fixture
def full(open_scene):
    """Scene, its states, modes and proper orthogonal values."""
    scene = open_scene(BLOCK)
    states = scene.solve()
    return scene, states, *pod_basis(states.x)


def fields_of(scene, x, load):
    return [scene.fields(state, at) for state, at in zip(x, load, strict=True)]


def reduced_errors(scene, states, modes, linear):
    scene.reduce(modes)
    reduced = scene.solve_reduced(linear)
    assert reduced.load.tolist() == states.load.tolist()
    exact = fields_of(scene, states.x, states.load)
    found = fields_of(scene, reduced.x @ modes.T, states.load)
    return displacement_error(exact, found), gradient_error(exact, found)


def test_modes_are_orthonormal_and_span_the_snapshots(full):
    _, states, modes, values = full
    assert_allclose(modes.T @ modes, np.eye(5), rtol=0, atol=1e-14)
    assert (np.diff(values) <= 0).all()
    rest = states.x.T - modes @ (modes.T @ states.x.T)
    assert np.linalg.norm(rest) < 1e-14 * np.linalg.norm(states.x)
    # (6.22): the values are the snapshots' energies
    assert values.sum() == pytest.approx((states.x**2).sum() / 5, rel=1e-12)


def test_as_many_modes_as_snapshots_give_the_full_solution(full):
    """The full solution lies in the span of the modes and minimises there too: both iterations
    end within their tolerance, 1e-9, times the condition of the rows.
    """
    scene, states, modes, _ = full
    e1, e2 = reduced_errors(scene, states, modes, "dgels")
    assert e1 < 1e-6
    assert e2 < 1e-6


def test_errors_fall_with_the_number_of_modes(full):
    """The first mode alone is good to some per cent, as in table 6.8."""
    scene, states, modes, _ = full
    errors = [reduced_errors(scene, states, modes[:, :r], "dgels")[0] for r in (1, 2, 3)]
    assert errors[0] < 1.0
    assert errors[1] < 0.3 * errors[0]
    assert errors[2] < 0.3 * errors[1]


def test_qr_and_cholesky_agree(full):
    """Modes are few and orthonormal, so that squaring the condition costs little."""
    scene, states, modes, _ = full
    scene.reduce(modes[:, :3])
    by_qr = scene.solve_reduced("dgels").x
    by_cholesky = scene.solve_reduced("normal").x
    assert np.linalg.norm(by_qr - by_cholesky) < 1e-7 * np.linalg.norm(by_qr)


def test_projected_rows_are_the_product_of_rows_and_modes(full):
    """Shape functions projected once give the numbers of A'U without A'."""
    scene, states, modes, _ = full
    scene.reduce(modes)
    amplitudes = modes.T @ states.x[2]
    x = modes @ amplitudes
    for k in range(modes.shape[1]):
        residual, product = scene.linearise(x, 0.6, modes[:, k])
        unit = np.eye(modes.shape[1])[k]
        reduced_residual, column = scene.linearise(amplitudes, 0.6, unit, reduced=True)
        assert_allclose(column, product, rtol=0, atol=1e-12 * abs(product).max())
        assert_allclose(reduced_residual, residual, rtol=0, atol=1e-9 * abs(residual).max())
