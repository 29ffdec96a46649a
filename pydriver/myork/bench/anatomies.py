"""Real anatomy with diffusion tensors, for figures 4.5 and 4.6, from the files of two decks.

No images with diffusion tensors and an outline of a medial gastrocnemius are at hand, so that a
part is simulated:

- `surface`: shape and fiber directions of a medial gastrocnemius are measured (a surface and the
  tracts of diffusion tensors); simulated are the tensors along these directions, the T1 image, and
  what lies around: soleus on the deep side, as grey, fat elsewhere.
- `slice`: the T1 image of two calves and the outlines of twelve muscles are measured; simulated are
  the tensors, with the phantom's direction in each muscle. Deep muscles have no outline and no
  fibers.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from myork.imaging.io import read_image, read_labels
from myork.imaging.phantom import (
    FAT_SIGNAL,
    MUSCLE_SIGNAL,
    fiber_of,
    muscle_tensors,
    noisy_tensors,
    rician,
)
from myork.model.mesh import read_tracts, tract_fibers, voxelise
from myork.records import Image, Labels
from myork.segmentation.grouping import Muscle
from myork.segmentation.images import Images
from myork.segmentation.regions import body_mask
from myork.types import F64, Mask

#: 33 slices, as published, of the muscle that the deck `mg_tracts` names [mm]
_VOXEL = (1.25, 1.25, 5.6)
_SNR = 25.0  # of the simulated T1 image, as of the phantom
_DEEP, _FAT = 30.0, 8.0  # thickness of the soleus, and of the fat around both [mm]
#: Muscles of the phantom in the order of the labels of `calf_reference`, right before left; the
#: long extensor of the toes lies and leans as its neighbour
_OF_SLICE = (
    "soleus",
    "medial_gastrocnemius",
    "lateral_gastrocnemius",
    "tibialis_anterior",
    "tibialis_anterior",
    "peroneus",
)
_SEEDED = (0.1, 0.3, 0.5, 0.7, 0.9)  # places of seeds, parts of the height


class Anatomy(NamedTuple):
    """Images with their truth, and which of its labels are a medial gastrocnemius."""

    images: Images
    truth: Labels
    wanted: dict[str, int]


def surface(deck: Mapping[str, Any], snr: float) -> Anatomy:
    """The medial gastrocnemius of a surface with its tracts, soleus and fat beside it.

    - `deck`: has `surface` and `tracts` in its table `build`, in millimetres
    - `snr`: of the tensors
    """
    table = deck["build"]
    labels = voxelise(Path(table["surface"]), 1.0, _VOXEL, "medial_gastrocnemius")
    fibers = tract_fibers(read_tracts(Path(table["tracts"]), 1.0), labels)
    wide = [(int((_DEEP + _FAT) / h),) * 2 for h in _VOXEL[:2]]
    filled = labels.data.any(axis=(0, 1))
    muscle = np.pad(labels.data, [*wide, (0, 0)])[..., filled] > 0
    fiber = np.pad(fibers.data, [*wide, (0, 0), (0, 0)])[:, :, filled]
    affine = labels.affine.copy()
    affine[:3, 3] = labels.world(np.array([[-wide[0][0], -wide[1][0], filled.argmax()]]))[0]
    deep, body = np.zeros(muscle.shape, bool), muscle.copy()
    rows = np.arange(muscle.shape[0])[:, np.newaxis]
    for k in range(muscle.shape[2]):
        away, near = ndimage.distance_transform_edt(
            ~muscle[..., k], sampling=_VOXEL[:2], return_indices=True
        )
        # the side that x turns away from: fibers run down to it, to the aponeurosis on the soleus
        facing = (near[0] - rows) * _VOXEL[0] > 0.3 * away
        facing = ndimage.binary_opening(facing | muscle[..., k], np.ones((5, 5)))
        deep[..., k] = facing & (away < _DEEP) & ~muscle[..., k]
        body[..., k] |= deep[..., k] | (away < _FAT)
    # fibers of both muscles rise from the aponeurosis between them
    lean = fiber_of("soleus")
    fiber[deep] = -np.hypot(*lean[:2]), 0.0, lean[2]
    random = np.random.default_rng(1)
    even = np.where(muscle | deep, MUSCLE_SIGNAL, np.where(body, FAT_SIGNAL, 0.0))
    grey = Image(rician(even, MUSCLE_SIGNAL / _SNR, random), affine, "T1 around the surface")
    truth = Labels(
        np.where(muscle, 1, np.where(deep, 2, 0)).astype(np.int32),
        affine,
        {1: "medial_gastrocnemius", 2: "soleus"},
        "surface",
    )
    return _with_tensors(grey, truth, fiber, body, snr, {"surface": 1}, random)


def slice_of_calves(deck: Mapping[str, Any], snr: float) -> Anatomy:
    """Both medial gastrocnemii of a T1 slice with outlines.

    - `deck`: has `anatomy` and `truth` in its table `image`
    - `snr`: of the tensors
    """
    grey, drawn = (
        read_image(Path(deck["image"]["anatomy"])),
        read_labels(Path(deck["image"]["truth"])),
    )
    names, fiber = {}, np.zeros((*drawn.data.shape, 3))
    for number, name in enumerate(_OF_SLICE):
        for side, mirror in enumerate((-1.0, 1.0)):
            label = 2 * number + side + 1
            names[label] = f"{name}_{label}"
            fiber[drawn.data == label] = fiber_of(name) * [mirror, 1.0, 1.0]
    truth = Labels(drawn.data, drawn.affine, names, drawn.name)
    wanted = {"right": 3, "left": 4}
    return _with_tensors(grey, truth, fiber, body_mask(grey), snr, wanted, np.random.default_rng(1))


def _with_tensors(
    grey: Image,
    truth: Labels,
    fiber: F64,
    body: Mask,
    snr: float,
    wanted: dict[str, int],
    random: np.random.Generator,
) -> Anatomy:
    clean = muscle_tensors(truth.data > 0, fiber, body)
    tensor = Image(noisy_tensors(clean, body, snr, random), grey.affine, "simulated tensors")
    return Anatomy(Images(grey, tensor=tensor, truth=truth), truth, wanted)


def seeds_inside(truth: Labels) -> list[Muscle]:
    """A rule for each label: seeds where it is thickest, in slices over its height."""
    muscles = []
    for number, name in truth.names.items():
        own = truth.data == number
        filled = np.flatnonzero(own.any(axis=(0, 1)))
        places = []
        for k in sorted({filled[int(part * len(filled))] for part in _SEEDED}):
            depth = ndimage.distance_transform_edt(own[..., k], sampling=truth.spacing[:2])
            places.append([*np.unravel_index(depth.argmax(), depth.shape), k])
        muscles.append(Muscle(name, truth.world(np.array(places))))
    return muscles
