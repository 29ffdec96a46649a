"""Dense least squares by the core's ladder of solvers."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from myork import _core, errors
from myork.types import F64

#: Names that a deck's `solver.linear` and `solve` take
SOLVERS = ("auto", "dgels", "dgelsy", "normal", "refined", "spqr", "sparse-normal")


class Fit(NamedTuple):
    """A least squares solution and what is known of it.

    Attributes
    ----------
    x : F64
        Solution, shape `(n,)`.
    backward_error : float
        Upper bound of the smallest relative change of the column-scaled matrix that makes `x`
        exact.
    misfit : float
        Distance of the fit to the best one over the norm of the residual.
    rcond : float
        Estimate of the reciprocal condition of the column-scaled matrix.
    iterations : int
        Refinement iterations.
    used, why : str
        Solver that gave the solution, and the reason.
    """

    x: F64
    backward_error: float
    misfit: float
    rcond: float
    iterations: int
    used: str
    why: str


def least_squares(a: ArrayLike, b: ArrayLike, method: str = "auto") -> Fit:
    """Minimise `|a x - b|`.

    Parameters
    ----------
    a : ArrayLike
        Matrix, shape `(m, n)` with `m >= n`.
    b : ArrayLike
        Right hand side, shape `(m,)`.
    method : str
        One of `SOLVERS`.

    Raises
    ------
    InputError
        Wrong shapes, an unknown solver, a column of zeros, or a solver this build does not have.
    LinalgError
        The matrix has not full rank; the message names the unknowns.
    """
    matrix, right = np.asarray(a, float), np.asarray(b, float)
    if matrix.ndim != 2 or right.shape != matrix.shape[:1]:
        raise errors.InputError(
            f"a must have shape (m, n) and b (m,), not {matrix.shape} and {right.shape}"
        )
    x, numbers, used, why, stat, message = _core.least_squares(matrix, right, method.encode())
    errors.check(stat, message)
    backward, misfit, rcond, iterations = (float(number) for number in numbers)
    return Fit(
        x, backward, misfit, rcond, int(iterations), used.decode().strip(), why.decode().strip()
    )
