"""Real legs and arms through `segment`, `build`, `solve` and `report`, for whoever has the data.

    python tests/bench/real_images.py DATA OUT

DATA holds the files that the decks of inputs/images name, in any folders of it; OUT gets a folder
a deck with its report (pictures). Printed are volumes, Dice coefficients with the manual labels of
the calf, and these coefficients again for references that are displaced, as those of a neighbour
slice or an earlier visit are. No test: the data are not part of the project.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.chain import run_chain
from myork.imaging.io import read_image, read_reference, write_labels
from myork.records import Labels
from myork.segmentation.regions import body_mask
from myork.stations.data import data_overrides
from myork.stations.segment import segment

DECKS = Path(__file__).parents[2] / "inputs" / "images"

# Of each leg: shift [pixel] and turn [degrees]; then random bends of so many pixels
RIGID = [(0, 0, 0), (3, 0, 0), (0, 4, 0), (-3, 3, 0), (0, -5, 0), (2, 2, 4), (-4, 0, -3)]
RIGID += [(4, -3, 5), (-5, 0, 5), (5, 5, 8)]
BENDS = [(3, 1), (3, 5), (4, 6), (5, 2), (5, 3), (5, 4)]


def displaced(labels: Labels, legs: NDArray[np.int32], shift: Sequence[float]) -> Labels:
    """Label map with every leg shifted and turned about its middle."""
    result = np.zeros_like(labels.data)
    angle = np.radians(shift[2])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for leg in range(1, legs.max() + 1):
        part = np.where(legs == leg, labels.data, 0)[..., 0]
        centre = np.array(ndimage.center_of_mass(part > 0))
        offset = centre - turn @ (centre + shift[:2])
        part = ndimage.affine_transform(part, turn, offset=offset, order=0)
        result[..., 0] = np.where(part > 0, part, result[..., 0])
    return Labels(result, labels.affine, labels.names)


def bent(labels: Labels, amount: float, seed: int) -> Labels:
    """Label map bent by a smooth random field of at most so many pixels."""
    random = np.random.default_rng(seed)
    data = labels.data[..., 0]
    fields = [ndimage.gaussian_filter(random.normal(size=data.shape), 20) for _ in range(2)]
    fields = [amount * field / np.abs(field[data > 0]).max() for field in fields]
    places = [axis + field for axis, field in zip(np.indices(data.shape), fields, strict=True)]
    moved = ndimage.map_coordinates(data, places, order=0)
    return Labels(moved[..., np.newaxis], labels.affine, labels.names)


def calf(data: Path, out: Path) -> None:
    """Dice over the twelve muscles for displaced references."""
    name = "calf_reference"
    where = data_overrides(DECKS / f"{name}.toml", data)
    files = dict(entry.removeprefix("image.").split("=", 1) for entry in where)
    truth = read_reference(Path(files["truth"]), print)
    pieces, _ = ndimage.label(body_mask(read_image(Path(files["anatomy"])), rim=0.0))
    legs = np.asarray(pieces, np.int32)
    starts = [(str(shift), displaced(truth, legs, shift)) for shift in RIGID]
    starts += [(f"bent {amount} px", bent(truth, amount, seed)) for amount, seed in BENDS]
    out.mkdir(parents=True, exist_ok=True)
    for title, reference in starts:
        write_labels(out / "reference.nii.gz", reference)
        line = f"{title:14s}"
        for reach in (0, 8):
            # Without a reach the voxels of the muscle phase take the labels as they lie.
            keys = [f"image.reference={out / 'reference.nii.gz'}", f"image.reference_reach={reach}"]
            deck = DECKS / f"{name}.toml"
            found = segment(deck, out / "moved", overrides=[*where, *keys])["segmentation"]
            scores = [score["dice"] for score in found["scores"].values()]
            line += f"  reach {reach}: mean {np.mean(scores):.3f} least {np.min(scores):.3f}"
        print(line, flush=True)


def main(data: Path, out: Path) -> None:
    """All decks, then the displaced references."""
    for path in sorted(DECKS.glob("*.toml")):
        print(f"== {path.stem}")
        run_chain(path, out / path.stem, overrides=data_overrides(path, data), progress=print)
    print("== calf_reference, displaced references")
    calf(data, out / "displaced")


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
