"""What is measured on a solution: order of an error, oscillation along a line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray


def observed_order(cases: Sequence[Mapping[str, Any]], key: str) -> float:
    """Slope of an error between the last two of several sizes of one problem.

    - `cases`: records with `h`, the spacing [length], and the error
    - `key`: name of the error
    """
    first, last = cases[-2:]
    return float(np.log(first[key] / last[key]) / np.log(first["h"] / last["h"]))


def oscillation(values: NDArray[np.float64]) -> float:
    """Largest second difference of neighbours relative to the mean: zero for a straight line.

    - `values`: values at equal distances along a line, shape `(n,)`, at least three
    """
    return float(np.abs(np.diff(values, 2)).max() / abs(np.mean(values)))
