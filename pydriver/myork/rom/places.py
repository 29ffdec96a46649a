"""Stresses at the places of probes: arrays built once, evaluated from amplitudes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from myork.core.galerkin import place_parts
from myork.core.online import Cells, Model, cell_stresses
from myork.core.scene import Scene
from myork.rom import projection
from myork.rom.online import Conditions
from myork.rom.setting import Setting
from myork.types import F64

#: Iterations, their tolerance in the deformation gradient, and step of finite differences
_MOST, _EXACT, _SMALL = 20, 1e-9, 1e-7


def place_arrays(
    scene: Scene, setting: Setting, modes: F64, model: Model, probes: Sequence[int]
) -> dict[str, Any]:
    """Arrays of the places of probes.

    - `scene`: open scene
    - `setting`: data common to all models
    - `modes`: modes, shape `(n, r)`
    - `model`: the reduced model with all cells
    - `probes`: indices of probes of the deck, from 0
    - returns `places/pressure`, the pressures there as cubic forms of `(1, z)`, shape
      `(places, s + 1, s + 1, s + 1)`; on free faces the gradients along them, `places/face` of
      shape `(9, places, s)`, `places/normal` and `places/bulk`, otherwise zero; and the places as
      `Cells` of weight one
    """
    if not len(probes):
        return {}
    parts = setting.parts
    s, columns = model.cells.h.shape[2], modes.shape[1]
    roots = np.repeat(np.sqrt(parts.bulk), parts.polynomials)
    group = np.repeat(np.arange(len(parts.bulk)), parts.polynomials)
    order = np.concatenate([np.arange(count) for count in parts.polynomials])
    h, face = np.zeros((9, len(probes), s)), np.zeros((9, len(probes), s))
    found, pressure = [], np.zeros((len(roots), len(probes)))
    for k, probe in enumerate(probes):
        place = place_parts(scene, probe, modes)
        found.append(place)
        # gradients of shape functions ignore what is prescribed in cells at the surface
        h[:, k, :columns] = place.gradient
        face[:, k, :columns] = place.face
        h[:, k] += np.einsum("q,kqs->ks", place.weight, model.cells.h)
        pressure[:, k] = place.pressure[group, order] * roots
    cells = projection.cells_of(
        h,
        np.ones(len(probes)),
        np.array([place.local_bulk for place in found]),
        np.cumsum([0, *(len(place.tissue) for place in found)], dtype=np.int32),
        (
            np.concatenate([place.tissue for place in found]),
            np.concatenate([place.fraction for place in found]),
            np.concatenate([place.fiber for place in found]),
        ),
        setting.laws,
    )
    slopes = np.zeros((len(probes), model.cells.bulk_slope.shape[1]))
    directions = projection.Directions(pressure, slopes, (len(probes),))
    volume = projection.with_volume(model, parts, directions).volume
    # only entries with ascending indices are used
    at = np.sort(np.indices((s + 1,) * 3).reshape(3, -1), axis=0)
    forms = volume[at[0], at[1], at[2]].reshape(s + 1, s + 1, s + 1, -1)
    arrays: dict[str, Any] = {f"places/{key}": value for key, value in cells._asdict().items()}
    return arrays | {
        "places/pressure": np.moveaxis(forms, 3, 0),
        "places/face": face,
        "places/normal": np.array([place.normal for place in found]),
        "places/bulk": np.array([place.bulk for place in found]),
    }


class Places:
    """Stresses at places from the amplitudes of a reduced model.

    - `arrays`: those of `place_arrays`
    - `cells`: the places as cells of weight one
    - `fibers`: as in `Model`
    """

    def __init__(self, arrays: Mapping[str, Any], cells: Cells, fibers: F64) -> None:
        self._cells, self._fibers = cells, fibers
        self._pressure, self._face, self._normal, self._bulk = (
            np.asarray(arrays[f"places/{key}"]) for key in ("pressure", "face", "normal", "bulk")
        )

    def values(
        self, conditions: Conditions, amplitudes: F64, wanted: Mapping[int, str]
    ) -> dict[int, F64]:
        """Quantities of states, each of shape `(n,)`, by the number of the place."""
        z = np.hstack([amplitudes, conditions.given])
        one = np.hstack([np.ones((len(z), 1)), z])
        gradient = np.einsum("kqs,ns->nqk", self._cells.h, z)
        f = np.eye(3) + gradient.reshape(*gradient.shape[:2], 3, 3)
        j = np.linalg.det(f)
        pressure = np.empty_like(j)
        for k, form in enumerate(self._pressure):
            half = np.einsum("nab,nb->na", (form @ one.T).transpose(2, 0, 1), one)
            pressure[:, k] = np.einsum("na,na->n", half, one)
        stress = cell_stresses(self._cells, self._fibers, conditions.columns(), gradient)
        stress = stress.reshape(f.shape)
        with np.errstate(divide="ignore", invalid="ignore"):
            cauchy = stress @ f.transpose(0, 1, 3, 2) / j[..., None, None]
        cauchy += pressure[..., None, None] * np.eye(3)
        if self._bulk.any():
            along = np.eye(3) + np.einsum("kqs,ns->nqk", self._face, z).reshape(f.shape)
            self._release(conditions.columns(), along, cauchy)
        # no stress exists where J <= 0
        cauchy[~(j > 0.0)] = np.nan
        return {k: _quantity(name, cauchy[:, k], j[:, k]) for k, name in wanted.items()}

    def _release(self, wish: F64, f: F64, cauchy: F64) -> None:
        """Remove the traction from the stresses on free faces, as the full model does."""
        normal, bulk = self._normal, self._bulk[:, None, None]
        # directions in which a plane body can deform
        axes = [i for i in range(3) if self._cells.h[3 * i : 3 * i + 3].any()]

        def piola(g: F64) -> F64:
            p = cell_stresses(
                self._cells, self._fibers, wish, (g - np.eye(3)).reshape(*g.shape[:2], 9)
            ).reshape(g.shape)
            j = np.linalg.det(g)[..., None, None]
            return np.asarray(p + bulk * (j - 1) * j * np.linalg.inv(g).transpose(0, 1, 3, 2))

        def traction(g: F64) -> F64:
            return np.einsum("nkiA,kA->nki", piola(g), normal)[..., axes]

        g, found = f.copy(), np.zeros(f.shape[:2], bool)
        with np.errstate(all="ignore"):
            for _ in range(_MOST):
                r = traction(g)
                slope = np.empty((*r.shape, len(axes)))
                for k, i in enumerate(axes):
                    moved = g.copy()
                    moved[:, :, i] += _SMALL * normal
                    slope[..., k] = (traction(moved) - r) / _SMALL
                slope[:, self._bulk <= 0] = np.eye(len(axes))
                step = -np.linalg.solve(slope, r[..., None])[..., 0]
                found = (self._bulk > 0) & (np.abs(step).max(axis=-1) <= _EXACT)
                if found[:, self._bulk > 0].all():
                    break
                g[:, :, axes] += step[..., None] * (normal * (self._bulk > 0)[:, None])[:, None, :]
            j = np.linalg.det(g)[..., None, None]
            cauchy[found] = (piola(g) @ g.transpose(0, 1, 3, 2) / j)[found]


def _quantity(name: str, cauchy: F64, j: F64) -> F64:
    if name == "J":
        return j
    if name == "pressure":
        return np.asarray(-np.trace(cauchy, axis1=1, axis2=2) / 3.0)
    if name == "principal_max":
        found = np.full(len(j), np.nan)
        own = np.isfinite(cauchy).all(axis=(1, 2))
        found[own] = np.linalg.eigvalsh(cauchy[own])[:, -1]
        return found
    row, column = ("xyz".index(letter) for letter in name[-2:])
    return cauchy[:, row, column]
