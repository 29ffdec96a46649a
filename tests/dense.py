"""Dense least squares by the core's ladder of solvers, of which decks name a step."""

from typing import NamedTuple

import numpy as np

from myork import _core
from myork.errors import check
from myork.types import F64

#: Names that a deck's `solver.linear` takes
SOLVERS = ("auto", "dgels", "dgelsy", "normal", "refined", "spqr", "sparse-normal")


class Fit(NamedTuple):
    """A solution with its backward error, its distance to the best one over the norm of the
    residual, the reciprocal condition, refinements, the solver that gave it and why.
    """

    x: F64
    backward_error: float
    misfit: float
    rcond: float
    iterations: int
    used: str
    why: str


def least_squares(a: F64, b: F64, method: str = "auto") -> Fit:
    """Minimise `|a x - b|`, shapes `(m, n)` and `(m,)`."""
    x, numbers, used, why, stat, message = _core.least_squares(
        np.asarray(a, float), np.asarray(b, float), method.encode()
    )
    check(stat, message)
    *errors, iterations = (float(number) for number in numbers)
    return Fit(x, *errors, int(iterations), used.decode().strip(), why.decode().strip())
