"""Proper orthogonal modes of snapshots (6.13)-(6.26)."""

import numpy as np

from myork.errors import InputError
from myork.types import F64

#: Eigenvalues of products below this, relative to the largest, are rounding errors
_ROUNDING = 1e-13


def proper_orthogonal_modes(snapshots: F64, image: F64 | None = None) -> tuple[F64, F64]:
    """Proper orthogonal modes of snapshots, and their values.

    - `snapshots`: one state per row, shape `(s, dofs)`
    - `image`: their products with the matrix that defines the inner product of the modes, shape
      `(dofs, s)`; then by the method of snapshots (6.19), which loses modes whose values are below
      rounding of the largest. Without it the product is Euclidean, and modes come from singular
      values (6.22).
    - returns `modes`: orthonormal columns, shape `(dofs, n)`
    - returns `values`: proper orthogonal values, shape `(n,)`, descending
    """
    if not (snapshots.any() and np.isfinite(snapshots).all()):
        raise InputError("modes need at least one state that is not zero")
    if image is None:
        modes, singular, _ = np.linalg.svd(snapshots.T, full_matrices=False)
        return modes, singular**2 / len(snapshots)
    values, vectors = np.linalg.eigh(snapshots @ image)
    values, vectors = values[::-1], vectors[:, ::-1]
    real = values > _ROUNDING * values[0]
    values, vectors = values[real], vectors[:, real]
    return snapshots.T @ vectors / np.sqrt(values), values / len(snapshots)
