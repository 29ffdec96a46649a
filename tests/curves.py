"""Curves of fibers, from the energy, stress and tangents of a muscle."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from myork.core import material as cm
from myork.types import F64


class FiberCurves(NamedTuple):
    """Forces of fibers against their stretch."""

    #: Integral of the force from stretch 1, the force and its first two derivatives, shape
    #: `(4, n)` [-]
    active: F64
    passive: F64


def fiber_curves(stretch: ArrayLike, **parameters: float | str) -> FiberCurves:
    """Active and passive force of fibers (4.37), (4.38), as corrected, and their derivatives.

    - `stretch`: normalised stretches lambda*, shape `(n,)` [-]
    - `**parameters`: `curve`, `gamma1` and `gamma2` of a muscle; the schema's values where absent

    A stretch x along the fibers alone has the reduced stretch x^(2/3).
    """
    # soft, so that little of the digits is lost with the matrix
    muscle = cm.Material("muscle", 1.0, "muscle", sigma_max=1.0, A10=1e-3, **parameters)
    x = np.atleast_1d(np.asarray(stretch, float)) ** 1.5
    f, h = np.tile(np.eye(3), (len(x), 1, 1)), np.zeros((len(x), 3, 3, 3))
    f[:, 0, 0], h[:, 0, 0, 0] = x, 1.0

    def along(fiber: ArrayLike, activation: float) -> F64:
        """Energy and its derivatives by x, shape `(4, n)`."""
        where = {"fiber": fiber, "activation": activation, "volumetric": False}
        p, c4, t = cm.strong(muscle, f, h, **where)
        energy = cm.energy(muscle, f, **where)
        return np.stack([energy, p[:, 0, 0], c4[:, 0, 0, 0, 0], t[:, 0, 0, 0]])

    def curve(more: F64, less: F64) -> F64:
        """From derivatives by x to those by the reduced stretch."""
        one, two, three = 2 / 3 * x ** (-1 / 3), -2 / 9 * x ** (-4 / 3), 8 / 27 * x ** (-7 / 3)
        w = more - less
        force = w[1] / one
        slope = (w[2] - force * two) / one**2
        bend = (w[3] - 3 * slope * one * two - force * three) / one**3
        return np.stack([w[0], force, slope, bend])

    rest, passive, active = along((0, 0, 0), 0.0), along((1, 0, 0), 0.0), along((1, 0, 0), 1.0)
    return FiberCurves(curve(active, passive), curve(passive, rest))
