"""Exact solutions for any bulk modulus, up to infinity.

They are independent of the compiled core except for `along_fibers`, which takes the material law
from it: that checks the discretisation, not the law.

In all problems the principal directions are fixed, so that an energy in the stretches is
sufficient. The pressure `p = K (J - 1)` is a separate unknown: nothing is lost to rounding
where K is large, and K = infinity needs no second formula. Equation numbers are those of Basava
(2015).
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_bvp
from scipy.optimize import brentq

from myork.core.material import Material, stress
from myork.errors import ConvergenceError
from myork.types import F64

# solve_bvp gives a warning for stricter tolerances
_TOLERANCE = 1e-9


class Polynomial(NamedTuple):
    """Polynomial in the isochoric invariants (4.35), `W = sum A_ij (I1-3)^i (I2-3)^j`."""

    coefficients: Mapping[tuple[int, int], float]  #: `A_ij` by `(i, j)` [stress]
    bulk: float  #: Bulk modulus, may be infinite [stress]

    @classmethod
    def from_deck(cls, material: Mapping[str, Any], bulk: float | None = None) -> "Polynomial":
        """Material of a `[[material]]` table, optionally with another bulk modulus."""
        terms = {
            (i, j): float(material.get(f"A{i}{j}", 0.0))
            for i in range(4)
            for j in range(4 - i)
            if i + j > 0
        }
        return cls(terms, float(material["K"]) if bulk is None else bulk)

    def slopes(self, first: Any, second: Any) -> tuple[Any, Any]:
        """Derivatives of W by the isochoric invariants, `W_1` and `W_2` [stress]."""
        x, y = first - 3.0, second - 3.0
        terms = self.coefficients.items()
        return (
            sum(a * i * x ** (i - 1) * y**j for (i, j), a in terms if i > 0),
            sum(a * j * x**i * y ** (j - 1) for (i, j), a in terms if j > 0),
        )

    def isochoric(self, stretches: Any) -> Any:
        """Isochoric first Piola-Kirchhoff stresses.

        - `stretches`: principal stretches in the first axis, shape `(3, ...)` [-]
        - returns principal stresses, same shape [stress]
        """
        lam = np.asarray(stretches)
        j = lam[0] * lam[1] * lam[2]
        square = lam**2
        i1 = square.sum(axis=0)
        i2 = 0.5 * (i1**2 - (square**2).sum(axis=0))
        bar1, bar2 = j ** (-2 / 3) * i1, j ** (-4 / 3) * i2
        w1, w2 = self.slopes(bar1, bar2)
        by_i1 = 2.0 * j ** (-2 / 3) * lam - 2 / 3 * bar1 / lam
        by_i2 = 2.0 * j ** (-4 / 3) * lam * (i1 - square) - 4 / 3 * bar2 / lam
        return w1 * by_i1 + w2 * by_i2


class Tube(NamedTuple):
    """Inflated tube in plane strain."""

    radius: F64  #: Deformed radii, shape `(n,)` [length]
    radial: F64  #: Radial Cauchy stress, shape `(n,)` [stress]
    hoop: F64  #: Hoop Cauchy stress, shape `(n,)` [stress]


def tube(
    material: Polynomial, inner: float, outer: float, radial: float, place: Any = None
) -> Tube:
    """Tube whose inner surface moves outwards (5.124), with a free outer surface.

    The equation `d(P_rr)/dR + (P_rr - P_tt)/R = 0` is solved for the radius and `P_rr`; the
    pressure follows from these two at each place.

    - `inner`, `outer`: undeformed radii [length]
    - `radial`: displacement of the inner surface [length]
    - `place`: undeformed radii at which the solution is evaluated; default the inner surface
    - raises ConvergenceError: the boundary value problem was not solved
    """
    compliance = 1.0 / material.bulk

    def state(big_r: F64, y: F64) -> tuple[F64, F64, F64]:
        """Radial stretch, pressure and hoop stress P_tt."""
        hoop, wanted = y[0] / big_r, y[1]
        p = np.zeros_like(hoop)
        for _ in range(30):
            # one complex step gives value and slope of the radial stress
            step = p + 1e-30j
            stress = material.isochoric(
                np.array([(1.0 + compliance * step) / hoop, hoop + 0j, np.ones_like(step)])
            )
            miss = stress[0] + step * hoop - wanted
            change = miss.real / (miss.imag / 1e-30)
            p = p - change
            if np.all(np.abs(change) <= 1e-14 * (1.0 + np.abs(p))):
                break
        stretch = (1.0 + compliance * p) / hoop
        p_tt = material.isochoric(np.array([stretch, hoop, np.ones_like(hoop)]))[1] + p * stretch
        return stretch, p, p_tt

    def slope(big_r: F64, y: F64) -> F64:
        stretch, _, p_tt = state(big_r, y)
        return np.vstack([stretch, (p_tt - y[1]) / big_r])

    def ends(ya: F64, yb: F64) -> F64:
        return np.array([ya[0] - inner - radial, yb[1]])

    mesh = np.linspace(inner, outer, 41)
    # starting from the incompressible tube, one call converges
    guess = np.vstack([np.sqrt(mesh**2 + (inner + radial) ** 2 - inner**2), np.zeros_like(mesh)])
    answer = solve_bvp(slope, ends, mesh, guess, tol=_TOLERANCE, max_nodes=20000)
    if answer.status != 0:
        raise ConvergenceError(f"radial boundary value problem of the tube: {answer.message}")
    at = np.atleast_1d(np.asarray(inner if place is None else place, float))
    y = answer.sol(at)
    stretch, _, p_tt = state(at, y)
    # Cauchy stress: P_rr over the hoop stretch, P_tt over the radial one
    return Tube(y[0], y[1] * at / y[0], p_tt / stretch)


def inner_stress(deck: Mapping[str, Any], bulk: float | None = None) -> float:
    """Radial Cauchy stress on the inner surface of a deck's tube [stress].

    A bulk modulus in place of the deck's may be infinite [stress].
    """
    geometry = deck["geometry"]
    moved = next(b["radial"] for b in deck["boundary"] if "radial" in b)
    material = Polynomial.from_deck(deck["material"][0], bulk)
    found = tube(material, geometry["inner_radius"], geometry["outer_radius"], moved)
    return float(found.radial[0])


def uniaxial(material: Polynomial, stretch: float) -> float:
    """Axial Cauchy stress of a bar with free sides; (5.114) for infinite K [stress]."""
    return float(homogeneous(material, (stretch,))[1][0])


def equibiaxial(material: Polynomial, stretch: float) -> float:
    """In-plane Cauchy stress of a sheet with free faces; (5.118) for infinite K [stress]."""
    return float(homogeneous(material, (stretch, stretch))[1][0])


def dilation(material: Polynomial, stretch: float) -> float:
    """Cauchy stress `K (J - 1)` (5.122) [stress]."""
    return material.bulk * (stretch**3 - 1.0)


def simple_shear(material: Polynomial, amount: float) -> float:
    """Shear stress of the infinitely wide block (5.110), the same for every K [stress]."""
    w1, w2 = material.slopes(3.0 + amount**2, 3.0 + amount**2)
    return 2.0 * amount * (w1 + w2)


def homogeneous(material: Polynomial, held: Sequence[float]) -> tuple[F64, F64]:
    """Principal stretches and Cauchy stresses, shape `(3,)` each [-], [stress].

    - `held`: stretches of the first axes; the others are stress-free
    """
    compliance = 1.0 / material.bulk
    free_axes = 3 - len(held)
    held_product = float(np.prod(held))

    def state(log_volume: float) -> tuple[F64, F64, float]:
        """Stretches, isochoric Cauchy stresses, and the pressure that frees the free axes."""
        volume = np.exp(log_volume)
        free = (volume / held_product) ** (1.0 / free_axes) if free_axes else 1.0
        lam = np.array([*held, *(free,) * free_axes])
        sigma = material.isochoric(lam) * lam / volume
        return lam, sigma, float(-sigma[-1])

    def miss(log_volume: float) -> float:
        return float(np.expm1(log_volume) - compliance * state(log_volume)[2])

    if not free_axes:
        lam, sigma, _ = state(np.log(held_product))
        return lam, sigma + material.bulk * (held_product - 1.0)
    # the body swells under tension and shrinks under compression
    far = 1e-12 if miss(0.0) < 0.0 else -1e-12
    while miss(far) * far < 0.0:
        far *= 2.0
    lam, sigma, pressure = state(brentq(miss, 0.0, far, xtol=1e-16, rtol=1e-15))
    return lam, sigma + pressure


def along_fibers(table: Mapping[str, Any], activation: float) -> float:
    """Cauchy stress along the fibers of a muscle that keep their length, with stress-free sides.

    - `table`: table `[[material]]` of a deck, with a finite bulk modulus
    - `activation`: activation [-]
    - returns stress [stress]
    """
    material = Material.of_table(table)

    def cauchy(free: float) -> Any:
        f = np.diag([1.0, free, free])
        p = stress(material, f[np.newaxis], fiber=(1.0, 0.0, 0.0), activation=activation)[0]
        return p @ f.T / np.linalg.det(f)

    free = brentq(lambda b: cauchy(b)[1, 1], 0.8, 1.2, xtol=1e-15)
    return float(cauchy(free)[0, 0])
