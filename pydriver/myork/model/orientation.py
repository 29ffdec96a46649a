"""Are the axes of the diffusion gradients right? Evidence from walls and from anatomy.

A flipped or exchanged axis gives smooth fibers that are wrong by tens of degrees. Each order of the
axes is tried, with one axis flipped or none (two flips equal the third: fibers have no sign):

- fibers run along the walls of muscles: with the long axis exchanged they cross them;
- going up, fibers of the gastrocnemius lean backwards, those of the soleus forwards, and the two
  heads of the gastrocnemius apart, where muscles have these names.

The length of tracts is no evidence: wrong axes make tracts in pennate muscles three times as long.
"""

from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from myork.imaging.diffusion import parse_axes, unit_vectors
from myork.imaging.geometry import frame, slice_axis, with_axis_at
from myork.model.normals import surface_normals
from myork.records import Image, Labels
from myork.types import F64, Mask

# How much more fibers may cross walls with the best candidate that leaves the long axis of the
# muscles in its place than with the best one that moves it. Correct tables gave at most 0.00 on
# phantoms and real muscles, exchanged ones at least 0.20.
_CROSSING = 0.1
# Fibers that cross walls more than this need not run along them; a third is random.
_ALONG = 0.2
# Agreement with anatomy: 1 if all fibers lean as they should, -1 if all lean the other way.
_CONTRADICTION = 0.5
# Candidates whose crossing differs by less count as equal.
_ALIKE = 0.1


class Orientation(NamedTuple):
    """Evidence for one order of the gradient axes."""

    axes: str  #: Value for `image.gradient_axes`
    #: Mean square cosine between fibers at the walls of muscles and the wall normals, 0 to 1: 0
    #: along the walls, a third at random [-]
    crossing: float
    #: Agreement with the anatomy of the calf, -1 to 1; None where no muscle has a known name [-]
    agreement: float | None


class Finding(NamedTuple):
    """Evidence of the fibers on the gradient axes."""

    evidence: list[Orientation]  #: Evidence for the axes of the files first
    doubt: str  #: A warning, empty without a doubt
    #: What was checked and what remains undecided; empty with a doubt or without fibers
    remark: str


def check_orientation(fibers: Image, muscles: Labels, affine: F64 | None = None) -> Finding:
    """Compare all orders and flips of the gradient axes.

    - `fibers`: fiber vectors in the world frame with the axes of the files, shape `(ni, nj, nk, 3)`
    - `muscles`: muscles whose walls are used; also their names, if known
    - `affine`: of the diffusion images, whose voxel axes are those of the gradients; by default
      that of the fibers
    """
    columns = frame(fibers.affine if affine is None else affine)
    fibers = replace(fibers, data=unit_vectors(fibers.data)[0])
    vector, normal = _at_walls(fibers, muscles)
    if not len(vector):
        return Finding([], "", "")
    rules = _rules(fibers, muscles)
    found = []
    for axes in _candidates():
        turn = columns @ parse_axes(axes) @ columns.T
        crossing = float((((vector @ turn.T) * normal).sum(axis=1) ** 2).mean())
        found.append(Orientation(axes, crossing, _agreement(fibers, turn, rules)))
    # walls have no normals along the axis of a long muscle
    long = "xyz"[int(((normal @ columns) ** 2).mean(axis=0).argmin())]
    doubt = _doubt(found, long)
    return Finding(found, doubt, "" if doubt else _remark(found[0]))


def _at_walls(fibers: Image, muscles: Labels) -> tuple[F64, F64]:
    """Fibers at the walls of each muscle and the wall normals in the world, `(n, 3)` each."""
    axis = slice_axis(muscles.spacing, muscles.data.shape)
    fibers, muscles = with_axis_at(fibers, axis, 2), with_axis_at(muscles, axis, 2)
    usable = np.asarray(fibers.data.any(axis=-1))
    parts = [(np.zeros((0, 3)), np.zeros((0, 3)))]
    for label in muscles.present:
        own = muscles.data == label
        slices = np.flatnonzero(own.any(axis=(0, 1)))
        # at the end of the image or of its outlines a muscle is cut; that is not a wall
        box = np.s_[:, :, slices[0] : slices[-1] + 1]
        inside = own[box]
        wall = inside & ~ndimage.binary_erosion(inside, border_value=1) & usable[box]
        if wall.any():
            normal = surface_normals(inside, muscles.spacing, np.argwhere(wall))
            parts.append((fibers.data[box][wall], normal @ frame(muscles.affine).T))
    vector, normal = (np.concatenate(side) for side in zip(*parts, strict=True))
    return vector, normal


def _candidates() -> list[str]:
    """Values of `image.gradient_axes`, that of the files first, then in order of simplicity."""
    flips = ("", "x", "y", "z")
    return [
        " ".join("-" + axis if axis == flip else axis for axis in order)
        for order in permutations("xyz")
        for flip in flips
    ]


def _rules(fibers: Image, muscles: Labels) -> list[tuple[Mask, F64]]:
    """Voxels of each muscle and the direction in which its fibers should lean going up."""
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


def _agreement(fibers: Image, turn: F64, rules: list[tuple[Mask, F64]]) -> float | None:
    """Mean over the rules of how far rotated fibers lean the right way, -1 to 1."""
    scores = []
    for mask, direction in rules:
        vector = fibers.data[mask] @ turn.T
        lean = (vector @ direction) * np.where(vector[:, 2] < 0, -1.0, 1.0)
        total = np.abs(lean).sum()
        scores.append(float(lean.sum() / total) if total > 0 else 0.0)
    return float(np.mean(scores)) if scores else None


def _doubt(found: list[Orientation], long: str) -> str:
    """Warning where the evidence contradicts the files; `long` is the muscles' long axis."""
    given = found[0]
    look = "look at the fibers on the anatomy in the report before you use it"
    if given.agreement is not None:
        # Among candidates with equal anatomical agreement, the one whose fibers cross walls least
        best = max(found, key=lambda o: (round(o.agreement or 0.0, 1), -o.crossing))
        if (best.agreement or 0.0) - given.agreement > _CONTRADICTION:
            return (
                "the diffusion gradients contradict anatomy: fibers of gastrocnemius and soleus "
                f"lean the right way by {given.agreement:+.2f} (of -1 to 1) as the files say, by "
                f'{best.agreement:+.2f} with image.gradient_axes = "{best.axes}"; {look}'
            )
    place = "xyz".index(long)
    kept = min(o.crossing for o in found if o.axes.split()[place].endswith(long))
    least = min(o.crossing for o in found)
    if kept - least <= _CROSSING:
        return ""
    # A plain exchange of two axes is more likely than one with a flip
    alike = [o for o in found if o.crossing < least + _ALIKE]
    best = min(alike, key=lambda o: (_moved(o.axes), o.crossing))
    return (
        "the axes of the diffusion gradients are swapped: fibers cross the walls of muscles, "
        f"mean square cosine with their normals {given.crossing:.2f} as the files say, "
        f'{best.crossing:.2f} with image.gradient_axes = "{best.axes}"; flips, and the order '
        f"of the two axes across the muscles, cannot be determined from this: {look}"
    )


def _moved(axes: str) -> int:
    """Number of axes that moved, and of flips."""
    words = axes.split()
    return sum(word[-1] != axis for word, axis in zip(words, "xyz", strict=True)) + axes.count("-")


def _remark(given: Orientation) -> str:
    """Result of a check without a doubt."""
    cosine = f"(mean square cosine to normals {given.crossing:.2f}"
    walls = f"fibers run along the walls of muscles {cosine})"
    if given.crossing > _ALONG:
        walls = (
            f"walls of muscles do not decide whether fibers run along them {cosine}, .33 at random)"
        )
    if given.agreement is not None:
        return f"gradient axes: fibers agree with anatomy {given.agreement:+.2f} (of 1); {walls}"
    return (
        f"gradient axes: {walls}; a flip, or an exchange of the two axes across, cannot be seen "
        "without muscles of known names: look at the fibers in the report"
    )
