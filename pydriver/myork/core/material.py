"""Materials at points: checks and conversions around the compiled core."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from myork import _core, errors
from myork.core.calls import called
from myork.core.deck import load_deck, text_of_tables
from myork.types import F64

#: Keys of a `[[material]]` table that assign the material to a part of a body
_PLACING = {"label", "where", "fiber", "fiber_angle", "activation", "amplitude"}


class Material:
    """Material law with the keys of a `[[material]]` table in a deck.

    Parameters that are not given take the defaults of the deck schema; `docs/decks.md` lists the
    parameters of each model. All of them can be read as attributes.

    - `name`: for messages
    - `K`: bulk modulus, positive; infinite only with `volumetric=False` below [stress]
    - `model`: `polynomial`, `muscle` or another model of decks
    - `**parameters`: those of the model, such as `A10` or `sigma_max`
    - raises InputError: a parameter that the schema does not allow

    >>> rubber = Material("rubber", K=1e3, A10=37.3)
    >>> rubber.A10, rubber.A20
    (37.3, 0.0)
    """

    def __init__(
        self, name: str, K: float, model: str = "polynomial", **parameters: float | str
    ) -> None:
        self.name = name
        self._given: dict[str, float | str] = {"K": K, "model": model, **parameters}
        self._tables = {"material": [{"name": name, **self._given}]}
        self.parameters = load_deck(self._tables)["material"][0]
        del self.parameters["name"]

    @classmethod
    def of_table(cls, table: Mapping[str, Any]) -> "Material":
        """Material from a `[[material]]` table, without its label and fiber direction."""
        return cls(**{key: value for key, value in table.items() if key not in _PLACING})

    def replace(self, **changes: float | str) -> "Material":
        """The same material with some parameters changed."""
        return Material(self.name, **{**self._given, **changes})  # type: ignore[arg-type]

    def __getattr__(self, key: str) -> Any:
        try:
            return self.__dict__["parameters"][key]
        except KeyError:
            raise AttributeError(f"material '{self.__dict__.get('name')}' has no {key}") from None


class Tangents(NamedTuple):
    """Quantities that a row of the strong form needs at each point."""

    stress: F64  #: First Piola-Kirchhoff stress `P[p, i, A]` [stress]
    tangent: F64  #: `C4[p, i, A, j, B] = dP_iA/dF_jB` [stress]
    #: `T[p, i, k, C]`, the sum of `C6[i, A, j, B, k, C] H[j, B, A]` [stress/length]
    contracted: F64


def energy(material: Material, gradient: ArrayLike, **where: Any) -> F64:
    """Energy per reference volume at points, shape `(n,)` [stress]; `where` as in `strong`."""
    return _at_points(material, gradient, **where)[0]


def stress(material: Material, gradient: ArrayLike, **where: Any) -> F64:
    """First Piola-Kirchhoff stress `P[p, i, A]`, shape `(n, 3, 3)` [stress]; as in `energy`."""
    return _at_points(material, gradient, **where)[1]


def strong(material: Material, gradient: ArrayLike, second: ArrayLike, **where: Any) -> Tangents:
    """Stress, tangent and contracted third derivative at points.

    - `material`: material of all points
    - `gradient`: deformation gradients `F[p, i, A]` with a positive determinant, shape `(n, 3, 3)`
      [-]
    - `second`: second derivatives of the displacement `H[p, j, B, A] = u_j,BA`, shape
      `(n, 3, 3, 3)` [1/length]
    - `**where`: `dimension` 3, or 2 for plane strain: `F[:, 2, 2] = 1`; then entries of the results
      with an index 2 are zero, apart from those of the stress; `fiber`, unit vectors in the
      reference body, shape `(n, 3)` or `(3,)`, zeros (the default) for none [-]; `activation` of
      the fibers, 0 to 1 [-]; `volumetric`, whether to include `K/2 (J - 1)^2` (the default)
    - raises InputError: impossible parameter of the material, or wrong shapes
    """
    return Tangents(*_at_points(material, gradient, second, **where)[1:])


def _at_points(
    material: Material,
    gradient: ArrayLike,
    second: ArrayLike | None = None,
    *,
    dimension: int = 3,
    fiber: ArrayLike = (0.0, 0.0, 0.0),
    activation: float = 0.0,
    volumetric: bool = True,
) -> list[F64]:
    """Energy, stress, tangent and contraction with second derivatives, the point as first axis."""
    if dimension not in (2, 3):
        raise errors.InputError(f"dimension must be 2 or 3, not {dimension}")
    f, n = _points(gradient, fiber)
    count = f.shape[-1]
    h = np.zeros((count, 3, 3, 3)) if second is None else np.asarray(second, float)
    if h.shape != (count, 3, 3, 3):
        raise errors.InputError(f"second must have shape ({count}, 3, 3, 3), not {h.shape}")
    found = called(
        _core.material_at_points,
        *_parameters(material, volumetric), dimension, f, _last(h), n, float(activation),
    )  # fmt: skip
    return [np.moveaxis(array, -1, 0) for array in found]


def _parameters(material: Material, volumetric: bool) -> tuple[object, ...]:
    """Arguments that describe a material to the core."""
    if volumetric and np.isposinf(material.K):
        raise errors.InputError(
            f"material '{material.name}': K = inf gives no volumetric stress: volumetric=False"
        )
    return (text_of_tables(material._tables).encode(), int(volumetric))


def _points(gradient: ArrayLike, fiber: ArrayLike) -> tuple[F64, F64]:
    """Deformation gradients and fibers with the point as last axis; InputError on wrong shapes."""
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


def _last(array: F64) -> F64:
    """Move the point to the last axis, in Fortran order, without transposing tensors."""
    return np.asfortranarray(np.moveaxis(array, 0, -1))
