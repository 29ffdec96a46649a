"""Real anatomy with diffusion tensors, for figures 4.5 and 4.6; needs the data files.

No images with both diffusion tensors and an outline of a medial gastrocnemius are available, so
that a part is simulated:

- `surface`: measured are shape and fiber directions of a medial gastrocnemius (a surface and the
  tracts of diffusion tensors); simulated are the tensors along these directions, the T1 image, and
  the surroundings: soleus of equal grey on the deep side, fat elsewhere.
- `slice`: measured are the T1 image of two calves and the outlines of twelve muscles; simulated are
  the tensors, with the phantom's direction in each muscle. Deep muscles have no outline and no
  fibers.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage

from myork.bench.reproduce import by_slice
from myork.core.deck import load_deck
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
from myork.segmentation.images import Images, segment_images
from myork.segmentation.regions import body_mask
from myork.segmentation.scores import label_scores
from myork.stations.data import data_overrides
from myork.types import F64, Mask

DECKS = Path(__file__).parents[2] / "inputs" / "images"
#: The published method: three level sets from clusters, grey values and (e1, e2, e3) of the fibers
_LEVEL_SETS = ("image.regions=8",)
_SEEDS = ("image.regions=3", "image.fiber_channels=dyad")
_FIBERS = "image.fiber_channels=aligned"
_LENGTH = ("image.mu=0.1", "image.tolerance=0.001")
_SURFACE = ("mg_tracts", *_LENGTH, "bias.method=none")
_SLICE = ("calf_reference", *_LENGTH)
#: Deck with its overrides, and SNR of the tensors
RUNS: dict[str, tuple[tuple[str, ...], float]] = {
    "surface": ((*_SURFACE, *_LEVEL_SETS, _FIBERS), 5.0),
    "surface, SNR 25": ((*_SURFACE, *_LEVEL_SETS, _FIBERS), 25.0),
    "surface, seeds": ((*_SURFACE, *_SEEDS), 5.0),
    "surface, without fibers": ((*_SURFACE, *_LEVEL_SETS), 5.0),
    "slice": ((*_SLICE, *_LEVEL_SETS, _FIBERS), 5.0),
    "slice, without fibers": ((*_SLICE, *_LEVEL_SETS), 5.0),
}
#: 33 slices, as published, of the muscle that the deck `mg_tracts` names [mm]
_VOXEL = (1.25, 1.25, 5.6)
_SNR = 25.0  # SNR of the simulated T1 image, as of the phantom
_DEEP, _FAT = 30.0, 8.0  # thickness of the soleus, and of the fat around both [mm]
#: Muscles of the phantom in the order of the labels of `calf_reference`, right before left; the
#: long extensor of the toes has the position and inclination of its neighbour
_OF_SLICE = (
    "soleus",
    "medial_gastrocnemius",
    "lateral_gastrocnemius",
    "tibialis_anterior",
    "tibialis_anterior",
    "peroneus",
)
_SEEDED = (0.1, 0.3, 0.5, 0.7, 0.9)  # heights of seeds, as parts of the height


class Anatomy(NamedTuple):
    """Images with their truth, and the labels that are a medial gastrocnemius."""

    images: Images
    truth: Labels
    wanted: dict[str, int]


def surface(deck: Mapping[str, Any], snr: float) -> Anatomy:
    """The medial gastrocnemius of a surface with its tracts, soleus and fat beside it.

    - `deck`: has `surface` and `tracts` in its table `build`, in millimetres
    - `snr`: SNR of the tensors
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
        # the side facing away from x: fibers run down to it, to the aponeurosis on the soleus
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
    - `snr`: SNR of the tensors
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
    """A rule for each label: seeds at its thickest places, in slices over its height."""
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


def scores(name: str, data: Path) -> dict[str, dict[str, Any]]:
    """Scores of a run of `RUNS` by muscle, with the deck's files in a folder.

    Without seeds each component of a region is assigned to the muscle that most
    of it belongs to, which is the best that manual grouping can do.
    """
    (stem, *words), snr = RUNS[name]
    path = DECKS / f"{stem}.toml"
    deck = load_deck(path, [*words, *data_overrides(path, data, words)])
    real = (surface if "surface" in deck["build"] else slice_of_calves)(deck, snr)
    by_seeds = _SEEDS[0] in words
    found = segment_images(
        real.images if by_seeds else replace(real.images, reference=real.truth),
        {**deck["image"], "split": "pieces"},
        bias=deck["bias"]["method"],
        muscles=seeds_inside(real.truth) if by_seeds else (),
    )
    # in both cases labels are numbered as in the truth
    rules = {side: (n, [n]) for side, n in real.wanted.items()}
    each = label_scores(found.labels.data, real.truth.data, rules)
    return {side: by_slice(each[side]) for side in real.wanted}


def real_anatomy(data: str) -> Iterator[tuple[str, ...]]:
    """Medial gastrocnemius of real anatomy by level sets against its outline (figures 4.5, 4.6).

    `data` contains the files named in the decks mg_tracts and calf_reference. Means over the slices
    of Dice and Pearson's coefficient, and both in the slices at 15/33 and 30/33 of the height.
    Tensors are simulated along measured fibers or the phantom's; the noise is their mean
    diffusivity over the SNR, by default 5: the median error of a voxel's direction before smoothing
    is then 28°, and 6° at an SNR of 25. `seeds` has a region for each muscle, started at five
    seeds, and for fat.
    """
    yield "run", "muscle", "Dice", "PCC", "Dice of slices 15, 30", "PCC of slices 15, 30"
    yield "published", "", "0.874", "0.874", "0.90, 0.84", "0.89, 0.84"
    for name in RUNS:
        for side, own in scores(name, Path(data)).items():
            two = [[own[f"{key}_{n}"] for n in (15, 30)] for key in ("dice", "pcc")]
            pairs = (f"{one:.3f}, {other:.3f}" for one, other in two)
            yield name, side, f"{own['dice']:.3f}", f"{own['pcc']:.3f}", *pairs
