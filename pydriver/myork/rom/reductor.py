"""From the full model and modes to the states of the reduced model."""

from __future__ import annotations

import time
from typing import NamedTuple

from myork.core.scene import Scene
from myork.types import F64

__all__ = ["ReducedStates", "solve_reduced"]

# The reduced least squares problem: Householder QR, or Cholesky of (A'U)^T A'U (6.67).
_SOLVERS = {"qr": "dgels", "cholesky": "normal"}


class ReducedStates(NamedTuple):
    """States of a reduced model at all load steps.

    Attributes
    ----------
    x : F64
        Unknowns of the full model that the amplitudes stand for, shape `(nstep, dofs)`.
    iterations : list of int
        Iterations of each step.
    offline_s, online_s : float
        Wall time of the projection, and of all load steps [s].
    cpu_s : float
        Processor time of all load steps [s].
    """

    x: F64
    iterations: list[int]
    offline_s: float
    online_s: float
    cpu_s: float


def solve_reduced(
    scene: Scene,
    modes: F64,
    solver: str = "qr",
    projection: str = "auto",
    assembly: str = "reduced",
) -> ReducedStates:
    """Project a scene on modes and solve all its load steps.

    Parameters
    ----------
    scene : Scene
        The full model.
    modes : F64
        Orthonormal columns, shape `(dofs, r)`.
    solver : str
        `qr` or `cholesky`.
    projection : str
        `auto`, `galerkin` or `least-squares`.
    assembly : str
        `reduced`, or `full` for rows that are assembled in full and then projected.
    """
    started = time.perf_counter()
    scene.reduce(modes, projection, assembled=assembly == "full")
    offline_s = time.perf_counter() - started
    started, cpu = time.perf_counter(), time.process_time()
    states = scene.solve_reduced(_SOLVERS[solver])
    online_s, cpu = time.perf_counter() - started, time.process_time() - cpu
    return ReducedStates(states.x @ modes.T, states.iterations.tolist(), offline_s, online_s, cpu)
