"""Are the axes of the diffusion gradients right? Evidence from tracts and from anatomy.

A table of gradients with a flipped or exchanged axis gives fibers that are wrong by tens of
degrees and yet smooth. Every candidate (six orders of the axes, each with one axis flipped or
none; two flips are the third, since a fiber has no sign) is tried on the same fibers:

- by the length of tracts inside the muscles: exchanged axes cut them short. A flip of a nearly
  even field does not, so lengths alone never accuse a flip;
- by anatomy where muscles have names: going up, the fibers of the gastrocnemius lean backwards
  and those of the soleus forwards, and the two heads of the gastrocnemius lean apart.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.imaging.diffusion import parse_axes
from myork.imaging.geometry import frame
from myork.model.tracts import tract_lengths
from myork.records import Image, Labels

__all__ = ["Orientation", "check_orientation"]

F64 = NDArray[np.float64]

# Exchanged axes shorten tracts by more than a half; a wrong order can be some tens of percent
# longer than the right one where muscles are wide (tests/imaging/test_orientation.py).
_MUCH_LONGER = 1.6
# Agreement with anatomy: 1 all fibers lean as they should, -1 all the other way.
_CONTRADICTION = 0.5


@dataclass(frozen=True)
class Orientation:
    """Evidence for one order of the gradient axes.

    Attributes
    ----------
    axes : str
        Value for `image.gradient_axes`.
    length : float
        Median length of tracts [mm].
    agreement : float or None
        With the anatomy of the calf, -1 to 1; None where no muscle has a known name [-].
    """

    axes: str
    length: float
    agreement: float | None

    def record(self) -> dict[str, Any]:
        """For `summary.json`."""
        return {"axes": self.axes, "tract_length_mm": self.length, "agreement": self.agreement}


def check_orientation(fibers: Image, muscles: Labels) -> tuple[list[Orientation], str]:
    """Compare all orders and flips of the gradient axes.

    Parameters
    ----------
    fibers : Image
        Fiber vectors in the world frame as the files say, shape `(ni, nj, nk, 3)`.
    muscles : Labels
        Where to follow them; names of muscles are used where they are known.

    Returns
    -------
    tuple
        The evidence, with the order of the files first, and a warning, empty without a doubt.
    """
    inside = (muscles.data > 0) & fibers.data.any(axis=-1)
    if not inside.any():
        return [], ""
    columns = frame(fibers.affine)
    rules = _rules(fibers, muscles)
    found = []
    for axes in _candidates():
        turn = columns @ parse_axes(axes) @ columns.T
        turned = Image(fibers.data @ turn.T, fibers.affine, fibers.name)
        length = float(np.median(tract_lengths(turned, inside)))
        found.append(Orientation(axes, length, _agreement(turned, rules)))
    return found, _doubt(found)


def _candidates() -> list[str]:
    """Values of `image.gradient_axes`, that of the files first."""
    flips = ("", "x", "y", "z")
    return [
        " ".join("-" + axis if axis == flip else axis for axis in order)
        for order in permutations("xyz")
        for flip in flips
    ]


def _rules(fibers: Image, muscles: Labels) -> list[tuple[NDArray[np.bool_], F64]]:
    """Voxels of a muscle and the direction in which its fibers lean going up."""
    usable = fibers.data.any(axis=-1)
    where = {}
    for label, name in muscles.names.items():
        mask = (muscles.data == label) & usable
        if mask.any():
            where[name.lower()] = mask
    heads = {
        side: mask
        for name, mask in where.items()
        for side in ("medial", "lateral")
        if "gastrocnemius" in name and side in name
    }
    rules = [(mask, np.array([0, -1.0, 0])) for name, mask in where.items() if "gastroc" in name]
    rules += [(mask, np.array([0, 1.0, 0])) for name, mask in where.items() if "soleus" in name]
    if len(heads) == 2:
        middle = {
            side: fibers.affine[0, :3] @ np.argwhere(mask).mean(axis=0)
            for side, mask in heads.items()
        }
        medial = np.sign(middle["medial"] - middle["lateral"])
        rules += [
            (heads["medial"], np.array([medial, 0, 0])),
            (heads["lateral"], np.array([-medial, 0, 0])),
        ]
    return rules


def _agreement(fibers: Image, rules: list[tuple[NDArray[np.bool_], F64]]) -> float | None:
    """Mean over the rules of how far fibers lean the right way, -1 to 1."""
    scores = []
    for mask, direction in rules:
        vector = fibers.data[mask]
        lean = (vector @ direction) * np.where(vector[:, 2] < 0, -1.0, 1.0)
        total = np.abs(lean).sum()
        scores.append(float(lean.sum() / total) if total > 0 else 0.0)
    return float(np.mean(scores)) if scores else None


def _doubt(found: list[Orientation]) -> str:
    """Sentence for the user where the evidence speaks against the files."""
    given = found[0]
    # Of candidates that anatomy likes alike, the one with the longer tracts
    best = max(found, key=lambda o: (round(o.agreement or 0.0, 1), o.length))
    if given.agreement is not None and best.agreement is not None:
        if best.agreement - given.agreement > _CONTRADICTION:
            return (
                "the diffusion gradients contradict anatomy: fibers of gastrocnemius and soleus "
                f"lean the right way by {given.agreement:+.2f} (of -1 to 1) as the files say, by "
                f'{best.agreement:+.2f} with image.gradient_axes = "{best.axes}" (tracts '
                f"{given.length:.0f} and {best.length:.0f} mm long); look at the fibers on the "
                "anatomy in the report"
            )
        return ""
    longest = max(found, key=lambda o: o.length)
    if longest.length > _MUCH_LONGER * given.length:
        return (
            f"the axes of the diffusion gradients may be exchanged: tracts are {given.length:.0f} "
            f"mm long as the files say and {longest.length:.0f} mm with image.gradient_axes = "
            f'"{longest.axes}"; look at the fibers on the anatomy in the report'
        )
    return ""
