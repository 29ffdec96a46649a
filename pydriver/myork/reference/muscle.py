"""States of a muscle that is stretched along its fibers, its sides free of stress.

The material is that of the compiled core: what is checked is the discretisation, not the law.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import brentq

from myork.core.material import Material, stress

__all__ = ["along_fibers"]


def along_fibers(table: Mapping[str, Any], stretch: float, activation: float) -> float:
    """Cauchy stress along the fibers.

    Parameters
    ----------
    table : mapping
        Table `[[material]]` of a deck, with a finite bulk modulus.
    stretch : float
        Stretch of the fibers [-].
    activation : float
        Activation [-].

    Returns
    -------
    float
        Stress [stress].
    """
    material = Material.of_table(table)

    def cauchy(free: float) -> Any:
        f = np.diag([stretch, free, free])
        p = stress(material, f[np.newaxis], fiber=(1.0, 0.0, 0.0), activation=activation)[0]
        return p @ f.T / np.linalg.det(f)

    middle = stretch**-0.5
    free = brentq(lambda b: cauchy(b)[1, 1], 0.8 * middle, 1.2 * middle, xtol=1e-15)
    return float(cauchy(free)[0, 0])
