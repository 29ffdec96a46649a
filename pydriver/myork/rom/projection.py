"""From modes and an open scene to the arrays of a reduced model."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy import sparse

from myork.core.galerkin import (
    GalerkinParts,
    LoadParts,
    modal_gradients,
    modal_products,
    tissue_laws,
)
from myork.core.online import Cells, Model
from myork.core.scene import Scene
from myork.types import F64, I32, I64, Mask


class Laws(NamedTuple):
    """Materials of the tissues in the reduced model."""

    #: As returned by `tissue_laws`
    coefficients: F64
    fibers: F64
    fibered: Mask  #: Whether a tissue has fibers, shape `(nt,)`
    #: Maximal isometric stress, activation and `fiber_angle` [degree] of the deck, shape `(nt,)`
    sigma_max: F64
    activation: F64
    angle: F64
    #: Values in the deck of the parameters that are moduli; a single zero if there are none
    modulus: F64


class Variant(NamedTuple):
    """The full model at another value of a modulus that is a parameter."""

    step: float  #: That value less the value of the deck
    scene: Scene  #: Open scene
    #: Its Galerkin parts
    parts: GalerkinParts
    laws: Laws
    columns: "Columns"


class Directions(NamedTuple):
    """Directions of volume change, in blocks whose energy has one factor."""

    basis: F64  #: Columns, padded in each block to a multiple of eight, shape `(rows, kept)`
    slope: F64  #: Derivatives of their factors by material parameters, shape `(kept, nm)`
    blocks: tuple[int, ...]  #: Number of nonzero columns of each block

    def first(self, count: int) -> I64:
        """Indices of the first columns of each block, up to a multiple of eight."""
        found, start = [], 0
        for size in self.blocks:
            found.append(start + np.arange(_eights(min(size, count))))
            start += _eights(size)
        return np.concatenate(found)


class Columns(NamedTuple):
    """Amplitudes in addition to the modes: prescribed values, and those of requested forces."""

    given: F64  #: Displacement gradients at the integration points, shape `(np, 9, m)`
    force: F64  #: Forces on the unknowns, shape `(n, m)`
    value: F64  #: Prescribed displacements of the surface points, shape `(ms, nd, m)`

    @classmethod
    def of(cls, loads: Sequence[LoadParts]) -> "Columns":
        """Columns of several loads."""
        return cls(
            np.stack([load.given for load in loads], axis=2),
            np.stack([load.force for load in loads], axis=1),
            np.stack([load.value for load in loads], axis=2),
        )


def laws_of(scene: Scene, moduli: Sequence[float] = ()) -> Laws:
    """Materials of an open scene; `moduli` are the values of parameters."""
    coefficients, fibers, state = tissue_laws(scene)
    fibered, sigma_max, activation = state.T
    angle = [m.get("fiber_angle") or 0.0 for m in scene.deck["material"]]
    return Laws(
        coefficients, fibers, fibered > 0.0, sigma_max, activation, np.array(angle, float),
        np.array(list(moduli) or [0.0], float),
    )  # fmt: skip


def cells_of(
    h: F64,
    weight: F64,
    bulk: F64,
    first: I32,
    tissues: tuple[I32, F64, F64],
    laws: Laws,
) -> Cells:
    """Points as cells.

    - `h`: displacement gradients of the amplitudes, shape `(9, points, s)`
    - `weight`, `bulk`: weight of each point, and the local part of the bulk modulus there
    - `first`: number of tissue entries before each point, shape `(points + 1,)`
    - `tissues`: tissue of each entry, from 0, its fraction and fiber, as in `GalerkinParts`
    - `laws`: materials
    """
    tissue, fraction, fiber = tissues
    points = len(weight)
    owner = np.repeat(np.arange(points), np.diff(first))
    share = sparse.csr_matrix((fraction, (owner, tissue)), shape=(points, len(laws.fibered)))
    fibered = laws.fibered[tissue] & (np.abs(fiber).max(axis=1) > 0)
    counts = np.bincount(owner[fibered], minlength=points)
    # the core takes no empty arrays
    entries = np.flatnonzero(fibered) if fibered.any() else np.zeros(1, int)
    return Cells(
        np.asfortranarray(h),
        weight,
        bulk,
        np.asfortranarray((share @ laws.coefficients).T),
        np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
        tissue[entries] + 1,
        fraction[entries],
        np.asfortranarray(fiber[entries].T),
        np.zeros((9, points, 1), order="F"),
        np.zeros((points, 1), order="F"),
    )


def _all_cells(parts: GalerkinParts, laws: Laws, h: F64) -> Cells:
    """All integration points as cells."""
    tissues = parts.tissue, parts.fraction, parts.fiber
    return cells_of(h, parts.weight, parts.local_bulk, parts.first, tissues, laws)


def project(
    scene: Scene,
    parts: GalerkinParts,
    laws: Laws,
    modes: F64,
    columns: Columns,
    variants: Sequence[Variant] = (),
) -> Model:
    """The reduced model with all cells, but without its volume terms."""
    r = modes.shape[1]
    s = r + columns.force.shape[1]
    h = np.concatenate([modal_gradients(scene, modes), columns.given], axis=2)
    constant = _constant(scene, parts, modes, columns)
    h = np.asfortranarray(np.moveaxis(h, (0, 1, 2), (1, 0, 2)))
    cells = _all_cells(parts, laws, h)
    slope = np.zeros((s, s, max(1, len(variants))), order="F")
    if variants:
        for i, v in enumerate(variants):
            slope[..., i] = (_constant(v.scene, v.parts, modes, v.columns) - constant) / v.step
        others = [_all_cells(v.parts, v.laws, h) for v in variants]
        pairs = list(zip(variants, others, strict=True))
        cells = cells._replace(
            a_slope=np.stack([(o.a - cells.a) / v.step for v, o in pairs], axis=2),
            bulk_slope=np.stack([(o.local_bulk - cells.local_bulk) / v.step for v, o in pairs], 1),
        )
    return Model(
        r,
        cells,
        np.asfortranarray(constant),
        slope,
        np.zeros((s + 1, s + 1, s + 1, 0)),
        np.zeros((0, slope.shape[2])),
        np.asfortranarray(laws.fibers.T),
    )


def _constant(scene: Scene, parts: GalerkinParts, modes: F64, columns: Columns) -> F64:
    """Penalty and stabilisation matrix of all amplitudes."""
    stiff = modal_products(scene, modes)[0]
    side = -(modes.T @ columns.force)
    penalty = parts.penalty[:, None] * parts.essential
    corner = np.einsum("si,sil,sim->lm", penalty, columns.value, columns.value)
    constant = np.block([[modes.T @ stiff, side], [side.T, corner]])
    return np.asarray(0.5 * (constant + constant.T))


def with_volume(model: Model, parts: GalerkinParts, directions: Directions) -> Model:
    """Add the cubic form of the volume in some directions."""
    rows, total = volume_rows(parts)
    projected = np.ascontiguousarray(directions.basis.T @ rows)
    total = directions.basis.T @ total
    s = model.cells.h.shape[2]
    points = model.cells.h.shape[1]
    z = np.empty((s + 1, points, 3, 3))
    z[0] = np.eye(3)
    z[1:] = np.moveaxis(model.cells.h, (0, 1, 2), (2, 1, 0)).reshape(s, points, 3, 3)
    flat = z.reshape(s + 1, points, 9)
    volume = np.empty((s + 1, s + 1, s + 1, len(projected)))
    for m in range(s + 1):
        for k in range(m + 1):
            cross = _cross(z[k], z[m]).reshape(points, 9)
            form = np.einsum("qk,nqk->nq", cross, flat[m:], optimize=True) / 6.0
            volume[k, m, m:] = form @ projected.T
    volume[0, 0, 0] -= total
    return model._replace(volume=volume, volume_slope=directions.slope)


def volume_directions(
    cells: Cells, parts: GalerkinParts, variants: Sequence[Variant], states: F64, kept: int
) -> Directions:
    """Directions of volume change along states, shape `(s, n)`.

    Rows whose energy factors depend on moduli in the same way form a block.
    """
    slopes = _volume_slopes(parts, variants)
    size = np.abs(slopes).max(axis=0)
    rounded = np.round(slopes / np.where(size > 0.0, size, 1.0), 9)
    block_of = np.unique(rounded, axis=0, return_inverse=True)[1].ravel()
    found = _changes(cells, parts, states)
    columns, factors, blocks = [], [], []
    for block in range(block_of.max() + 1):
        own = np.flatnonzero(block_of == block)
        # ordered by size, even if all are kept: smaller models take the first ones
        left = np.linalg.svd(found[own], full_matrices=False)[0][:, :kept]
        wide = np.zeros((len(slopes), _eights(left.shape[1])))
        wide[own, : left.shape[1]] = left
        columns.append(wide)
        factors.append(np.tile(slopes[own[0]], (wide.shape[1], 1)))
        blocks.append(left.shape[1])
    return Directions(np.hstack(columns), np.vstack(factors), tuple(blocks))


def _changes(cells: Cells, parts: GalerkinParts, states: F64) -> F64:
    """Volume changes along states and their derivatives by the amplitudes."""
    rows, total = volume_rows(parts)
    found = []
    h = cells.h.reshape(-1, cells.h.shape[2], order="F")
    columns = np.moveaxis(cells.h, 0, 1)
    for z in states.T:
        f = (h @ z).reshape(-1, 3, 3) + np.eye(3)
        cofactor = 0.5 * _cross(f, f).reshape(-1, 9)
        # dy/dz, also by amplitudes that stay zero, because forces are these derivatives
        slope = rows @ np.einsum("qk,qkm->qm", cofactor, columns)
        change = rows @ ((cofactor * f.reshape(-1, 9)).sum(axis=1) / 3.0) - total
        # the changes themselves, scaled to the size that they may reach, however small they are
        size = np.linalg.norm(change)
        if size > 0.0:
            change *= np.linalg.norm(slope, axis=0).max() / size
        found += [slope, change[:, None]]
    return np.hstack(found)


def _eights(count: int) -> int:
    """The next multiple of eight."""
    return 8 * max(1, -(-count // 8))


def _volume_slopes(parts: GalerkinParts, variants: Sequence[Variant]) -> F64:
    """Derivatives of the energy factors of the rows by moduli, shape `(rows, nm)`."""
    own = np.repeat(np.arange(len(parts.bulk)), parts.polynomials)
    slopes = [(v.parts.bulk / parts.bulk - 1.0) / v.step for v in variants]
    return np.stack([slope[own] for slope in slopes] or [np.zeros(len(own))], axis=1)


def volume_rows(parts: GalerkinParts) -> tuple[sparse.csr_matrix, F64]:
    """Volume change of groups from J at points, scaled to roots of energy: `rows @ J - total`."""
    row, column, value = [], [], []
    total: list[float] = []
    for g, count in enumerate(parts.polynomials):
        points = np.arange(parts.group[g], parts.group[g + 1])
        root = np.sqrt(parts.bulk[g])
        for b in range(count):
            row.append(np.full(len(points), len(total)))
            column.append(points)
            value.append(root * parts.weight[points] * parts.basis[points, b])
            total.append(root * parts.total[g, b])
    matrix = sparse.csr_matrix(
        (np.concatenate(value), (np.concatenate(row), np.concatenate(column))),
        shape=(len(total), len(parts.weight)),
    )
    return matrix, np.array(total)


def _cross(a: F64, b: F64) -> F64:
    """Tensor cross product of `(..., 3, 3)`: half of A x A is the cofactor."""
    rows = [
        np.cross(a[..., i - 2, :], b[..., i - 1, :]) + np.cross(b[..., i - 2, :], a[..., i - 1, :])
        for i in range(3)
    ]
    return np.stack(rows, axis=-2)
