"""Few cells with weights in place of all: non-negative least squares on their work.

Reference: Farhat, Chapman, Avery, Int. J. Numer. Meth. Engng 102 (2015), doi:10.1002/nme.4820
"""

import numpy as np

from myork.types import F64, I64


class Sketch:
    """Contributions of all cells to many equations, kept as random sums of a fixed number.

    The norm of a combination of cells is that of all equations within a few per cent, at a memory
    that does not grow with them.

    - `cells`: number of cells
    - `rows`: sums to keep
    """

    def __init__(self, cells: int, rows: int, seed: int) -> None:
        self._random = np.random.default_rng(seed)
        self.rows = np.zeros((rows, cells))

    def add(self, contribution: F64) -> None:
        """Add equations, shape `(equations, cells)`, whose targets are their sums."""
        mixed = self._random.standard_normal((len(self.rows), len(contribution)))
        self.rows += mixed @ contribution / np.sqrt(len(self.rows))


def few_cells(rows: F64, tolerance: float, most: int) -> tuple[I64, F64, float]:
    """Cells and positive weights that keep the sums of rows.

    - `rows`: contributions of the cells, shape `(equations, cells)`
    - `tolerance`: relative residual at which no cell is added any more
    - `most`: cells at most
    - returns `cells`: numbers of the cells, ascending
    - returns `weights`: their weights, above zero, in the same order
    - returns `residual`: relative residual that is left
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
            # as far as all weights stay positive; those that reach zero leave
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
            # rounding: the same cells would come and go without an end
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
    """Weights of least squares: by QR, ten times as fast as singular values, where it is safe."""
    q, r = np.linalg.qr(columns)
    size = np.abs(r.diagonal())
    if len(size) < columns.shape[1] or size.min() < 1e-12 * size.max():
        return np.asarray(np.linalg.lstsq(columns, target, rcond=None)[0])
    return np.linalg.solve(r, q.T @ target)
