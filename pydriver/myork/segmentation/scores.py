"""Agreement of two segmentations."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def dice(found: ArrayLike, truth: ArrayLike) -> float:
    """Dice coefficient (4.6): twice the common voxels over the sum of both [-].

    Not a number where both are empty.
    """
    a, m = np.asarray(found, bool), np.asarray(truth, bool)
    total = int(a.sum()) + int(m.sum())
    return 2.0 * int((a & m).sum()) / total if total else float("nan")


def pearson(found: ArrayLike, truth: ArrayLike) -> float:
    """Pearson's correlation coefficient (4.7) of two images of one shape [-].

    Not a number where one of them is constant.
    """
    with np.errstate(invalid="ignore"):
        return float(np.corrcoef(np.ravel(found), np.ravel(truth))[0, 1])


def label_scores(
    found: ArrayLike, truth: ArrayLike, pairs: Mapping[str, tuple[int, Sequence[int]]]
) -> dict[str, dict[str, Any]]:
    """Dice and Pearson's coefficient of labels, over all slices and for each slice.

    - `found`, `truth`: label maps, shape `(ni, nj, nk)`; slices along the last axis
    - `pairs`: name to the label found and the labels of the truth to which it corresponds
    - returns name to `dice`, `pcc`, `dice_by_slice` and `pcc_by_slice`; not a number for a slice
      where both are empty
    """
    a, m = np.asarray(found), np.asarray(truth)
    scores: dict[str, dict[str, Any]] = {}
    for name, (label, wanted) in pairs.items():
        one, two = a == label, np.isin(m, wanted)
        slices = [(one[..., k], two[..., k]) for k in range(a.shape[2])]
        scores[name] = {
            "dice": dice(one, two),
            "pcc": pearson(one, two),
            "dice_by_slice": [dice(*pair) for pair in slices],
            "pcc_by_slice": [pearson(*pair) for pair in slices],
        }
    return scores
