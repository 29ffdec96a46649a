"""Materials of Basava (2015) as tables of a deck, and a muscle stretched along its fibers.

The law of that state is the compiled core's: it checks the discretisation, not the law.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.optimize import brentq

from myork.core.material import Material, stress

#: Muscle of table 4.1, per N/cm2
MUSCLE = {
    "name": "muscle",
    "model": "muscle",
    "A10": 6.43,
    "A01": -3.8,
    "A20": 0.94,
    "A02": 0.0005,
    "A11": -0.0043,
    "K": 5e3,
}
#: Rubber of section 5.3.10 with a bulk modulus of its own, per N/cm2
RUBBER = {"name": "rubber", "model": "polynomial", "A10": 37.3, "A20": -3.1, "A30": 0.5, "K": 5e3}


def along_fibers(table: Mapping[str, Any], stretch: float, activation: float) -> float:
    """Cauchy stress along the fibers of a muscle whose sides are free of stress.

    - `table`: table `[[material]]` of a deck, with a finite bulk modulus
    - `stretch`: stretch of the fibers [-]
    - `activation`: activation [-]
    - returns stress [stress]
    """
    material = Material.of_table(table)

    def cauchy(free: float) -> Any:
        f = np.diag([stretch, free, free])
        p = stress(material, f[np.newaxis], fiber=(1.0, 0.0, 0.0), activation=activation)[0]
        return p @ f.T / np.linalg.det(f)

    middle = stretch**-0.5
    free = brentq(lambda b: cauchy(b)[1, 1], 0.8 * middle, 1.2 * middle, xtol=1e-15)
    return float(cauchy(free)[0, 0])
