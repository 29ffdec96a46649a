"""Materials at points: checks and conversions around the compiled core."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork import _core, errors

F64Array = NDArray[np.float64]


@dataclass(frozen=True)
class Material:
    """Material law with the keys of a `[[material]]` table in a deck.

    Attributes
    ----------
    name : str
        Name for messages.
    K : float
        Bulk modulus, positive; infinite only with `volumetric=False` below [stress].
    model : str
        `polynomial` or `muscle`.
    A10, A01, A20, A11, A02, A30, A21, A12, A03 : float
        Coefficients of the polynomial (4.35); `A10 + A01`, half the shear modulus, is positive
        [stress].
    sigma_max : float
        Largest isometric stress of the fibers, not negative [stress].
    lambda_o : float
        Stretch of optimal length, positive [-].
    gamma1, gamma2 : float
        Factor (not negative) and rate (positive) of the passive force (4.37) [-].
    curve : str
        `published` or `smooth` (three times continuously differentiable force).
    """

    name: str
    K: float
    model: str = "polynomial"
    A10: float = 0.0
    A01: float = 0.0
    A20: float = 0.0
    A11: float = 0.0
    A02: float = 0.0
    A30: float = 0.0
    A21: float = 0.0
    A12: float = 0.0
    A03: float = 0.0
    sigma_max: float = 30.0
    lambda_o: float = 1.0
    gamma1: float = 0.05
    gamma2: float = 6.6
    curve: str = "published"


class Tangents(NamedTuple):
    """What a row of the strong form needs at each point.

    Attributes
    ----------
    stress : F64Array
        First Piola-Kirchhoff stress `P[p, i, A]` [stress].
    tangent : F64Array
        `C4[p, i, A, j, B] = dP_iA/dF_jB` [stress].
    contracted : F64Array
        `T[p, i, k, C]`, the sum of `C6[i, A, j, B, k, C] H[j, B, A]` [stress/length].
    """

    stress: F64Array
    tangent: F64Array
    contracted: F64Array


class FiberCurves(NamedTuple):
    """Forces of fibers against their stretch.

    Attributes
    ----------
    active, passive : F64Array
        Integral of the force from stretch 1, the force and its first three derivatives, shape
        `(5, n)` [-].
    """

    active: F64Array
    passive: F64Array


def energy(
    material: Material,
    gradient: ArrayLike,
    *,
    fiber: ArrayLike = (0.0, 0.0, 0.0),
    activation: float = 0.0,
    volumetric: bool = True,
) -> F64Array:
    """Energy per reference volume at points.

    Parameters
    ----------
    material : Material
        Material of all points.
    gradient : ArrayLike
        Deformation gradients `F[p, i, A]` with a positive determinant, shape `(n, 3, 3)` [-].
    fiber : ArrayLike
        Unit vectors in the reference body, shape `(n, 3)` or `(3,)`; zeros: no fibers [-].
    activation : float
        Activation of the fibers, 0 to 1 [-].
    volumetric : bool
        Include `K/2 (J - 1)^2`?

    Returns
    -------
    F64Array
        Energies, shape `(n,)` [stress].

    Raises
    ------
    InputError
        Impossible parameter of the material, or wrong shapes.
    """
    f, n = _points(gradient, fiber)
    w, stat, message = _core.material_energy(
        *_parameters(material, volumetric), f, n, float(activation)
    )
    errors.check(stat, message)
    return np.asarray(w)


def stress(
    material: Material,
    gradient: ArrayLike,
    *,
    fiber: ArrayLike = (0.0, 0.0, 0.0),
    activation: float = 0.0,
    volumetric: bool = True,
) -> F64Array:
    """First Piola-Kirchhoff stress at points; parameters as for `energy`.

    Returns
    -------
    F64Array
        Stresses `P[p, i, A]`, shape `(n, 3, 3)` [stress].
    """
    f, n = _points(gradient, fiber)
    p, stat, message = _core.material_stress(
        *_parameters(material, volumetric), f, n, float(activation)
    )
    errors.check(stat, message)
    return np.moveaxis(p, -1, 0)


def strong(
    material: Material,
    gradient: ArrayLike,
    second: ArrayLike,
    *,
    dimension: int = 3,
    fiber: ArrayLike = (0.0, 0.0, 0.0),
    activation: float = 0.0,
    volumetric: bool = True,
) -> Tangents:
    """Stress, tangent and contracted third derivative at points; parameters as for `energy`.

    Parameters
    ----------
    second : ArrayLike
        Second derivatives of the displacement `H[p, j, B, A] = u_j,BA`, shape `(n, 3, 3, 3)`
        [1/length].
    dimension : int
        3, or 2 for plane strain: `F[:, 2, 2] = 1`; then entries of the results with an index 2
        are zero, apart from those of the stress.
    """
    f, n = _points(gradient, fiber)
    h = np.asarray(second, float)
    if h.shape != (f.shape[-1], 3, 3, 3):
        raise errors.InputError(f"second must have shape ({f.shape[-1]}, 3, 3, 3), not {h.shape}")
    if dimension not in (2, 3):
        raise errors.InputError(f"dimension must be 2 or 3, not {dimension}")
    p, c4, t, stat, message = _core.material_strong(
        *_parameters(material, volumetric), dimension, f, _last(h), n, float(activation)
    )
    errors.check(stat, message)
    return Tangents(*(np.moveaxis(array, -1, 0) for array in (p, c4, t)))


def fiber_curves(
    stretch: ArrayLike, *, curve: str = "published", gamma1: float = 0.05, gamma2: float = 6.6
) -> FiberCurves:
    """Active and passive force of fibers (4.37), (4.38), as corrected, and their derivatives.

    Parameters
    ----------
    stretch : ArrayLike
        Normalised stretches lambda*, shape `(n,)` [-].
    curve, gamma1, gamma2
        As in `Material`.
    """
    if curve not in ("published", "smooth"):
        raise errors.InputError(f"curve = '{curve}' must be 'published' or 'smooth'")
    if not gamma2 > 0.0:
        raise errors.InputError(f"gamma2 = {gamma2} must be greater than 0")
    return FiberCurves(
        *_core.fiber_curves(int(curve == "smooth"), gamma1, gamma2, np.atleast_1d(stretch))
    )


def _parameters(material: Material, volumetric: bool) -> tuple[object, ...]:
    """Arguments of the core that stand for a material."""
    if volumetric and np.isposinf(material.K):
        raise errors.InputError(
            f"material '{material.name}': K = inf gives no volumetric stress: volumetric=False"
        )
    a = np.zeros((4, 4), order="F")
    for i in range(4):
        for j in range(4 - i):
            if i + j > 0:
                a[i, j] = getattr(material, f"A{i}{j}")
    fibers = (material.sigma_max, material.lambda_o, material.gamma1, material.gamma2)
    return (material.model, material.name, a, material.K, fibers, material.curve, int(volumetric))


def _points(gradient: ArrayLike, fiber: ArrayLike) -> tuple[F64Array, F64Array]:
    """Deformation gradients and fibers with the point as last axis, or an InputError."""
    f = np.asarray(gradient, float)
    if f.ndim != 3 or f.shape[1:] != (3, 3) or len(f) == 0:
        raise errors.InputError(f"gradient must have shape (n, 3, 3), not {f.shape}")
    try:
        n = np.broadcast_to(np.asarray(fiber, float), (len(f), 3))
    except ValueError:
        raise errors.InputError(
            f"fiber must have shape ({len(f)}, 3) or (3,), not {np.shape(fiber)}"
        ) from None
    return _last(f), _last(n)


def _last(array: F64Array) -> F64Array:
    """Move the point to the last axis, in Fortran order, without transposing tensors."""
    return np.asfortranarray(np.moveaxis(array, 0, -1))
