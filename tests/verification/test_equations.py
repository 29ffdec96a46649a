"""Exact solutions of the dissertation: from the energy, by closed forms and in equilibrium."""

from typing import Any

import numpy as np
import pytest

from myork.bench import exact

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


@pytest.mark.parametrize(
    ("stretches", "printed", "ours"),
    [
        (lambda s: (s, s**-0.5, s**-0.5), lambda s: 2 * (s**2 - 1 / s), exact.uniaxial),
        (lambda s: (s, s, s**-2), lambda s: 2 * (s**2 - s**-4), exact.equibiaxial),
    ],
    ids=["(5.114)", "(5.118)"],
)
def test_homogeneous_states(stretches: Any, printed: Any, ours: Any) -> None:
    """Stresses of stretched rubber from the energy, one direction free of stress, as printed."""
    law, lam = exact.Polynomial(CUBIC, np.inf), np.array(stretches(1.7))
    cauchy = lam * law.isochoric(lam)
    assert ours(law, 1.7) == pytest.approx(cauchy[0] - cauchy[2], rel=1e-10)
    first = np.sum(lam**2) - 3
    slope = 37.3 - 6.2 * first + 1.5 * first**2
    assert ours(law, 1.7) == pytest.approx(printed(1.7) * slope, rel=1e-10)


def test_known_values() -> None:
    """Closed forms of Basava (2015) and values at K = 1e8 that other codes agree on."""
    free = exact.Polynomial(CUBIC, np.inf)
    assert exact.simple_shear(free, 5.0) == pytest.approx(8198.0, rel=1e-12)
    assert exact.uniaxial(free, 6.0) == pytest.approx(107306.5, rel=1e-12)
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
