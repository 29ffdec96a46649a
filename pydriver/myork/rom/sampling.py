"""Hyperreduction: cell samples for the residual and for forces; lifts of the force amplitudes.

A few weighted cells that replace all are found by non-negative least squares on their work.

Reference: Farhat, Chapman, Avery, Int. J. Numer. Meth. Engng 102 (2015), doi:10.1002/nme.4820
"""

from collections.abc import Iterator

import numpy as np

from myork.core.online import Model, assemble
from myork.rom.setting import Setting
from myork.types import F64, I64

#: Random combinations that replace all equations in the cubature; they preserve the norm of a
#: combination of cells within a few per cent
SKETCH_ROWS = 900
#: Part of the tolerance for the displacement error of the cell sample, averaged over the states
_CELL_SHARE = 0.55
#: Largest number of cells
_MOST_CELLS = 400
#: States count as no smaller than this share of the largest
_LEAST = 0.1


def _contributions(
    model: Model, setting: Setting, values: F64, amplitudes: F64
) -> Iterator[tuple[F64, F64, F64]]:
    """Work of each cell's stress on all amplitudes, tangent and state, one state at a time."""
    conditions = setting.conditions(values)
    h = np.ascontiguousarray(np.moveaxis(model.cells.h, (0, 1, 2), (2, 1, 0)))
    for i, amplitude in enumerate(amplitudes):
        z = np.concatenate([amplitude, conditions.given[i]])
        _, tangent, stress, min_j = assemble(model, conditions.one(i).columns(), z)
        if min_j > 0.0:
            yield np.einsum("sqk,qk->sq", h, stress), tangent, z


def sample_cells(
    model: Model,
    setting: Setting,
    values: F64,
    amplitudes: F64,
    tolerance: float,
    seed: int,
) -> tuple[I64, F64, float]:
    """Cells and weights that reproduce the amplitudes, to `tolerance` relative to each state.

    A residual is measured by the step of the amplitudes that it causes: in L2 over the body, like
    errors. In the norm of the tangent, stiff modes, which hardly move, would require half of the
    cells. Forces use separate cells, or all.
    """
    r = model.r
    random = np.random.default_rng(seed)
    rows = np.zeros((SKETCH_ROWS, len(model.cells.weight)))
    seen = list(_contributions(model, setting, values, amplitudes))
    sizes = np.array([np.linalg.norm(z[:r]) for _, _, z in seen])
    sizes = np.maximum(sizes, _LEAST * sizes.max())
    for (work, tangent, _), size in zip(seen, sizes, strict=True):
        stiffness, vectors = np.linalg.eigh(0.5 * (tangent + tangent.T)[:r, :r])
        stiffness = np.abs(stiffness)
        stiffness = np.maximum(stiffness, 1e-3 * np.median(stiffness))
        step = (vectors / stiffness).T @ work[:r] / size
        rows += random.standard_normal((SKETCH_ROWS, r)) @ step / np.sqrt(SKETCH_ROWS)
    # scaled to the equations of all states: the target has unit size per state
    volume = model.cells.weight / model.cells.weight.sum() * np.sqrt(len(seen))
    return few_cells(np.vstack([rows, volume]), _CELL_SHARE * tolerance, _MOST_CELLS)


def force_lifts(model: Model, setting: Setting, values: F64, amplitudes: F64) -> F64:
    """Derivative of the modes by the amplitudes of forces, shape `(n, r nf)`.

    From the tangent of all cells: a sample is not made for amplitudes that stay zero.
    """
    conditions = setting.conditions(values)
    wanted = setting.wanted + model.r
    found = []
    for i, amplitude in enumerate(amplitudes):
        z = np.concatenate([amplitude, conditions.given[i]])
        tangent = assemble(model, conditions.one(i).columns(), z)[1]
        lift = -np.linalg.solve(tangent[: model.r, : model.r], tangent[: model.r, wanted])
        found.append(lift.ravel() if len(wanted) else np.zeros(model.r))
    return np.array(found)


def sample_forces(
    model: Model, setting: Setting, values: F64, amplitudes: F64, lifts: F64, tolerance: float
) -> tuple[I64, F64, float]:
    """Cells and weights that reproduce stationary forces; `lifts` are those of `force_lifts`."""
    r = model.r
    wanted = setting.wanted + r
    rows = []
    follow = lifts.reshape(len(lifts), r, -1)
    for i, amplitude in enumerate(amplitudes):
        for work, _, _ in _contributions(model, setting, values[i : i + 1], amplitude[None]):
            rows.append(work[wanted] + follow[i].T @ work[:r])
    volume = model.cells.weight / model.cells.weight.sum()
    stacked = np.vstack(rows)
    unit = np.abs(stacked.sum(axis=1)).max() or 1.0
    return few_cells(np.vstack([stacked / unit, volume]), 0.02 * tolerance, 600)


def few_cells(rows: F64, tolerance: float, most: int) -> tuple[I64, F64, float]:
    """Cells and positive weights that reproduce the sums of rows.

    - `rows`: contributions of the cells, shape `(equations, cells)`
    - `tolerance`: relative residual at which no more cells are added
    - `most`: largest number of cells
    - returns `cells`: numbers of the cells, ascending
    - returns `weights`: their weights, above zero, in the same order
    - returns `residual`: remaining relative residual
    """
    target = rows.sum(axis=1)
    size = np.linalg.norm(target)
    length = np.maximum(np.linalg.norm(rows, axis=0), np.finfo(float).tiny)
    kept: list[int] = []
    weight = np.zeros(rows.shape[1])
    best_weight = weight.copy()
    left = target.copy()
    while len(kept) < most and np.linalg.norm(left) > tolerance * size:
        gain = rows.T @ left / length
        gain[kept] = -1.0
        best = int(np.argmax(gain))
        if gain[best] <= 0.0:
            break
        kept.append(best)
        while True:
            trial = _weights(rows[:, kept], target)
            if trial.min() > 0.0:
                break
            # step as far as all weights stay positive; cells whose weights reach zero are removed
            old = weight[kept]
            negative = trial <= 0.0
            share = np.min(old[negative] / np.maximum(old[negative] - trial[negative], 1e-300))
            between = old + share * (trial - old)
            stay = between > 1e-12 * between.max()
            if stay.all():
                stay[int(np.argmin(between))] = False
            weight[kept] = np.where(stay, between, 0.0)
            kept = [cell for cell, stays in zip(kept, stay, strict=True) if stays]
        new = target - rows[:, kept] @ trial
        if not np.linalg.norm(new) < np.linalg.norm(left):
            # rounding: the same cells would enter and leave endlessly
            kept = sorted(np.flatnonzero(best_weight).tolist())
            weight = best_weight
            break
        weight[:] = 0.0
        weight[kept] = trial
        best_weight = weight.copy()
        left = new
    cells = np.sort(np.array(kept, dtype=np.int64))
    return cells, weight[cells], float(np.linalg.norm(left) / size)


def _weights(columns: F64, target: F64) -> F64:
    """Least squares weights: where it is safe by QR, ten times as fast as singular values."""
    q, r = np.linalg.qr(columns)
    size = np.abs(r.diagonal())
    if len(size) < columns.shape[1] or size.min() < 1e-12 * size.max():
        return np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0])
    return np.linalg.solve(r, q.T @ target)
