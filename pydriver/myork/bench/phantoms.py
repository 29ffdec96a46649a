"""Phantom muscles in place of those of the dissertation, whose images are not public.

The medial gastrocnemius of section 5.3.10.3, and the young and the old one of section 4.2.6, with
the volumes of table 4.3. Labels and fibers are the phantom's ground truth, so that only the muscles
differ. The thickness of the outer layer of connective tissue follows from the published forces per
total volume: 159.9 and 128.4 cm^3 with the layer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork.bench.materials import MUSCLE
from myork.core.deck import table_defaults
from myork.imaging.phantom import make_phantom
from myork.model.cloud import build_cloud
from myork.records import Image, Labels, PointCloud


@dataclass(frozen=True)
class Muscle:
    """A medial gastrocnemius."""

    name: str  #: Name of its owner
    scale: float  #: In-plane scale of the calf [-]
    #: Fraction of the muscle that is fat, or connective tissue [-]
    imat: float
    imct: float
    layer: float = 1.9  #: Thickness of the connective tissue around it in a calf of scale 1 [mm]


YOUNG = Muscle("young", 1.0901, 0.0231, 0.1701)
OLD = Muscle("old", 0.9705, 0.0633, 0.2999)

#: Edge of a pixel [mm]
PIXEL = 1.25
_SLICES, _SLICE = 26, 6.0  # number, [mm]
#: Labels of the materials
MUSCLE_TISSUE, FAT, CONNECTIVE = 1, 2, 3

_FIXED = {"u_x": 0, "u_y": 0, "u_z": 0}
_ENDS = {
    "boundary": [{"set": end, **_FIXED} for end in ("bottom", "top")],
    "probe": [{"name": end, "quantity": "force_z", "set": end} for end in ("bottom", "top")],
}
#: Deck of the aged muscles: properties vary smoothly from tissue to tissue over two spacings, and
#: every point has the fiber measured there, so that fat and connective tissue do not contract
AGED = {
    "title": "Isometric contraction of a medial gastrocnemius of three materials",
    "scene": {"dimension": 3, "method": "rkpm-scni"},
    "approximation": {
        "order": 1,
        "support": 2,
        "kernel": "cubic",
        "interface": 2,
        "interface_fibers": "own",
    },
    "material": [
        {**MUSCLE, "label": MUSCLE_TISSUE, "sigma_max": 30, "curve": "smooth"},
        {"name": "fat", "label": FAT, "model": "polynomial"}
        | {"A10": 3, "A20": 8, "A30": 80, "K": 5000},
        {"name": "connective_tissue", "label": CONNECTIVE, "model": "polynomial"}
        | {"A10": 30, "A20": 80, "A30": 800, "K": 50000},
    ],
    "load": {"steps": 4, "activation": 1},
    **_ENDS,
}
#: Deck of the gastrocnemius of section 5.3.10.3.3
GASTROCNEMIUS: dict[str, Any] = {
    "title": "Isometric contraction of a medial gastrocnemius",
    "units": {"force": "N", "length": "cm"},
    "scene": {"dimension": 3},
    "geometry": {"kind": "model"},
    "material": [{**MUSCLE, "label": 1, "sigma_max": 30.0}],
    "load": {"activation": 0.5},
    **_ENDS,
}


def strided_cloud(
    labels: Labels, fiber: Image | None, stride: Sequence[int] = (), **keys: Any
) -> PointCloud:
    """Points of a label map as `build` makes them with these keys.

    `stride`: voxels along the edges of a block, which is a source and a collocation point.
    """
    strides = dict.fromkeys(("collocation_stride", "source_stride"), list(stride)) if stride else {}
    return build_cloud(labels, fiber, {**table_defaults("build"), **strides, **keys}, "cm")[0]


def aged_cloud(muscle: Muscle, block: int) -> PointCloud:
    """Points of a muscle of three materials, for the deck `AGED`.

    `block` is the number of pixels along the edge of a block; each block is a source point.
    """
    labels, fiber = labelled(muscle)
    return strided_cloud(labels, fiber, (block, block, 1), ids=[1, 2, 3], merge="sample")


def labelled(muscle: Muscle) -> tuple[Labels, Image]:
    """Materials of a muscle with its outer layer, and fibers of its muscle tissue."""
    pixels = int(np.ceil((108.0 * muscle.scale + 6.0) / PIXEL))
    phantom = make_phantom(
        (pixels, pixels, _SLICES),
        (PIXEL, PIXEL, _SLICE),
        scale=muscle.scale,
        aponeurosis=muscle.layer,
        imat=muscle.imat,
        imct=muscle.imct,
    )
    inside, tissue = phantom.truth.data == 1, phantom.tissue.data
    layer = (phantom.truth.data == 0) & (tissue == CONNECTIVE)
    label = np.where(inside | layer, tissue, 0).astype(np.int32)
    fiber = phantom.fiber.data * (label == MUSCLE_TISSUE)[..., np.newaxis]
    affine = phantom.tissue.affine
    return Labels(label, affine, phantom.tissue.names, muscle.name), Image(fiber, affine)


def gastrocnemius(fiber: ArrayLike | None = None) -> PointCloud:
    """Points of the phantom's medial gastrocnemius, for the deck `GASTROCNEMIUS`.

    `fiber` is one direction for all fibers, shape `(3,)`, by default the fibers of the phantom.
    """
    phantom = make_phantom()
    fibers = phantom.fiber
    if fiber is not None:
        one = np.where(phantom.truth.data[..., np.newaxis] == 1, np.asarray(fiber), 0.0)
        fibers = Image(one, fibers.affine)
    return strided_cloud(phantom.truth, fibers, (4, 4, 1), ids=[1])


def inclined(mean: NDArray[Any], angle: float) -> NDArray[Any]:
    """A direction at an angle in degrees to the leg axis, inclined to the side of a mean fiber."""
    side = mean[:2] / np.linalg.norm(mean[:2])
    turn = np.radians(angle)
    return np.array([*(np.sin(turn) * side), np.cos(turn)])
