"""Where answers of the full model are doubtful or lost, according to its solves nearby."""

from typing import NamedTuple

import numpy as np

from myork.types import F64, I64

#: Marks of full solves, larger is worse. A reduced model can reproduce a doubtful state, as where
#: ellipticity is lost at some points. Where the equilibrium is unstable, or was not found, there
#: are several states or none, and which one a solve reaches is chance.
ACCEPTED, DOUBTFUL, LOST = 1, 2, 3
#: Their names; no solve has the first one
NAMES = ("unknown", "accepted", "doubtful", "lost")
#: Why an answer near lost states is doubtful
NEAR_LOST = "full solves nearby are unstable or did not converge"


class Marks(NamedTuple):
    """Marks of full solves with their parameters."""

    values: F64  #: Values of the parameters, shape `(n, p)`
    mark: I64  #: Marks, shape `(n,)`

    def added(self, row: F64, mark: int) -> "Marks":
        """The marks with one more."""
        return Marks(np.vstack([self.values, row]), np.append(self.mark, mark))

    def worst(self, values: F64, scale: F64) -> I64:
        """The worst mark of the nearest solves, one more of them than there are parameters.

        - `values`: shape `(n, p)`
        - `scale`: widths of the ranges, shape `(p,)`
        - returns shape `(n,)`, 0 where no solve has a mark
        """
        return self._around(values, scale).max(axis=1, initial=0)

    def least(self, values: F64, scale: F64) -> I64:
        """The best mark of the same solves."""
        near = self._around(values, scale)
        return near.min(axis=1, initial=LOST) if near.size else np.zeros(len(values), np.int64)

    def _around(self, values: F64, scale: F64) -> I64:
        count = min(len(self.mark), values.shape[1] + 1)
        with np.errstate(over="ignore"):
            gap = (((values[:, None] - self.values[None]) / scale) ** 2).sum(axis=2)
        nearest = np.argsort(gap, axis=1, kind="stable")[:, :count]
        return np.asarray(self.mark[nearest], np.int64)
