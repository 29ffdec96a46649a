"""Checks of a scene before it calls the core: shapes and starting states."""

from pathlib import Path

import numpy as np

from myork import errors
from myork.core.states import States
from myork.results import RestartState, restart_of
from myork.types import F64


def shaped(name: str, array: F64, shape: tuple[int, ...]) -> F64:
    """An array of the wanted shape; the wrapper would silently flatten any other."""
    array = np.asarray(array, float)
    if array.shape != shape:
        raise errors.InputError(f"{name} must have shape {shape}, not {array.shape}")
    return array


def finite(name: str, array: F64, shape: tuple[int, ...]) -> None:
    """Refuse an array of another shape, or with numbers that are not finite."""
    if array.shape != shape or not np.all(np.isfinite(array)):
        raise errors.InputError(f"{name} must be finite and have shape {shape}, not {array.shape}")


def modes_of(modes: F64, dofs: int) -> F64:
    """Modes checked to be finite and to match the unknowns of the model, shape `(dofs, r)`."""
    modes = np.asarray(modes, float)
    if modes.ndim != 2 or modes.shape[0] != dofs or modes.shape[1] == 0:
        raise errors.InputError(f"modes must have shape ({dofs}, r), not {modes.shape}")
    if not np.isfinite(modes).all():
        raise errors.InputError("modes must be finite numbers")
    return modes


def unknowns_of(
    start: F64 | States | RestartState | str | Path, points: F64, approximation: str, dofs: int
) -> F64:
    """Unknowns of the state from which a scene starts its iteration.

    - `start`: unknowns, or a state that contains them
    - `points`: collocation points of the scene, shape `(np, dimension)` [length]
    - `approximation`: description of its shape functions
    - `dofs`: number of its unknowns
    """
    if isinstance(start, str | Path):
        start = restart_of(start)
    if isinstance(start, States):
        if len(start.x) == 0:
            raise errors.InputError("start: there are no states")
        return shaped("start", start.x[-1], (dofs,))
    if not isinstance(start, RestartState):
        start = np.asarray(start, float)
        finite("start", start, (dofs,))
        return start
    if not np.array_equal(start.points[:, : points.shape[1]], points):
        raise errors.InputError("start: its points are not those of this scene")
    if start.approximation != approximation:
        raise errors.InputError(
            f"start: its approximation is {start.approximation}, that of this scene is "
            f"{approximation}"
        )
    return shaped("start", start.coefficients, (dofs,))
