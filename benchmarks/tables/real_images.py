"""Real legs and arms; needs the data files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from myork.chain import run_chain
from myork.imaging.io import read_image, read_reference, write_image, write_labels
from myork.records import Image, Labels
from myork.segmentation.regions import body_mask
from myork.stations.data import data_overrides
from myork.stations.segment import segment

Places = NDArray[np.float64]  # origin of each pixel, shape (2, ni, nj) [pixel]

DECKS = Path(__file__).parents[2] / "inputs" / "images"

#: Decks of single muscles with public surfaces and fibers
MUSCLES = ("biceps", "mg_tracts")
# For each leg: shift [pixel] and rotation [degrees]; then the size of random bends [pixel]
RIGID = [(0, 0, 0), (3, 0, 0), (0, 4, 0), (-3, 3, 0), (0, -5, 0), (2, 2, 4), (-4, 0, -3)]
RIGID += [(4, -3, 5), (-5, 0, 5), (5, 5, 8)]
BENDS = [(3, 1), (3, 5), (4, 6), (5, 2), (5, 3), (5, 4)]


def displaced(labels: Labels, legs: NDArray[np.int32], shift: Sequence[float]) -> Places:
    """Labels with every leg shifted and rotated about the middle of its labels."""
    angle = np.radians(shift[2])
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    pixels = np.indices(legs.shape).astype(float)
    places = pixels.copy()
    for leg in range(1, legs.max() + 1):
        here = legs == leg
        centre = np.array(ndimage.center_of_mass(here & (labels.data[..., 0] > 0)))
        offset = centre - turn @ (centre + shift[:2])
        places[:, here] = turn @ pixels[:, here] + offset[:, np.newaxis]
    return places


def bent(labels: Labels, amount: float, seed: int) -> Places:
    """A smooth random displacement field with a maximum of `amount` pixels."""
    random = np.random.default_rng(seed)
    data = labels.data[..., 0]
    fields = [ndimage.gaussian_filter(random.normal(size=data.shape), 20) for _ in range(2)]
    fields = [amount * field / np.abs(field[data > 0]).max() for field in fields]
    return np.array(
        [axis + field for axis, field in zip(np.indices(data.shape), fields, strict=True)]
    )


def earlier(image: Image, labels: Labels, places: Places) -> tuple[Image, Labels]:
    """Image and labels of a simulated earlier visit: other position, shading and noise."""
    random = np.random.default_rng(3)
    label = ndimage.map_coordinates(labels.data[..., 0], places, order=0)
    grey = ndimage.map_coordinates(image.data[..., 0], places, order=1)
    shade = ndimage.gaussian_filter(random.normal(size=grey.shape), 60)
    grey = grey * np.exp(0.3 * shade / np.abs(shade).max())
    grey += random.normal(size=grey.shape) * np.median(image.data[labels.data > 0]) / 25
    return (
        Image(np.abs(grey)[..., np.newaxis], image.affine),
        Labels(label[..., np.newaxis], labels.affine, labels.names),
    )


def real_images(data: str, out: str) -> Iterator[tuple[str, ...]]:
    """Real legs and arms through `segment`, `build`, `solve` and `report`.

    `data` contains the files named in the decks of inputs/images, at any depth; `out` gets one
    folder per deck with its report (figures). Volumes and Dice coefficients with the manual labels
    of the calf are printed before the table. The table has the mean and least coefficient for
    displaced references, like those of a neighbouring slice or an earlier visit: as given, and
    registered by the image of that visit.
    """
    for path in sorted(DECKS.glob("*.toml")):
        print(f"{path.stem}:")
        overrides = data_overrides(path, Path(data))
        run_chain(path, Path(out) / path.stem, overrides=overrides, progress=print)
    deck, folder = DECKS / "calf_reference.toml", Path(out) / "displaced"
    where = data_overrides(deck, Path(data))
    files = dict(entry.removeprefix("image.").split("=", 1) for entry in where)
    truth = read_reference(Path(files["truth"]), print)
    image = read_image(Path(files["anatomy"]))
    pieces, _ = ndimage.label(body_mask(image, rim=0.0)[..., 0])
    nearest = ndimage.distance_transform_edt(
        pieces == 0, return_distances=False, return_indices=True
    )
    legs = np.asarray(pieces, np.int32)[tuple(nearest)]
    starts = [(str(shift), displaced(truth, legs, shift)) for shift in RIGID]
    starts += [(f"bent {amount} px", bent(truth, amount, seed)) for amount, seed in BENDS]
    folder.mkdir(parents=True, exist_ok=True)
    yield "displaced by", "lies", "bent"
    for title, places in starts:
        picture, reference = earlier(image, truth, places)
        write_labels(folder / "reference.nii.gz", reference)
        write_image(folder / "earlier.nii.gz", picture)
        lies = [f"image.reference={folder / 'reference.nii.gz'}"]
        bends = [*lies, f"image.reference_anatomy={folder / 'earlier.nii.gz'}"]
        row = [title]
        for keys in (lies, bends):
            found = segment(deck, folder / "moved", overrides=[*where, *keys])["segmentation"]
            scores = [score["dice"] for score in found["scores"].values()]
            row.append(f"{np.mean(scores):.3f} ({np.min(scores):.3f})")
        yield tuple(row)


class Run(NamedTuple):
    """Result of a command: exit status, lines, times [s], memory [MB]."""

    status: int
    said: list[str]
    wall: float
    cpu: float
    memory: float


def measured_run(words: Sequence[str], folder: Path) -> Run:
    """Run `myork` in a folder, on one thread."""
    start, log = time.perf_counter(), folder / "said.txt"
    with log.open("w") as said:
        run = subprocess.Popen(
            [sys.executable, "-m", "myork", *words, "--threads", "1"],
            cwd=folder, stdout=said, stderr=subprocess.STDOUT,
        )  # fmt: skip
        _, status, used = os.wait4(run.pid, 0)
    run.returncode = os.waitstatus_to_exitcode(status)
    lines, wall = log.read_text().splitlines(), time.perf_counter() - start
    log.unlink()
    cpu, memory = used.ru_utime + used.ru_stime, used.ru_maxrss / 1024
    return Run(run.returncode, lines, wall, cpu, memory)


def real_muscles(data: str) -> Iterator[tuple[str, ...]]:
    """Public data of muscles, one deck each, from the files in a folder to a force and a report.

    `myork run inputs/images/DECK.toml --data data` in an empty folder, one thread; `data` contains
    the files named in the decks, at any depth. The estimate is activation x PCSA x sigma_max; times
    and memory are of the whole command, with error bar and report.
    """
    yield ("deck", "points, sources", "volume [cm³]", "fiber [cm], angle", "PCSA [cm²]", "force",
           "estimate", "verdict", "wall [s]", "CPU [s]", "memory [MB]")  # fmt: skip
    for name in MUSCLES:
        with TemporaryDirectory() as folder:
            words = ["run", str(DECKS / f"{name}.toml"), "--data", str(Path(data).resolve())]
            run = measured_run(words, Path(folder))
            found = json.loads(Path(folder, "out", name, "summary.json").read_text())
        muscle = {key.split(" ")[0]: one for key, one in found["model"]["muscles"][0].items()}
        last, estimate = found["steps"][-1], found["pcsa_force"]
        force, bar = (last[key][estimate["probe"]] for key in ("probes", "probe_errors"))
        yield (
            name, f"{found['collocation_points']}, {found['source_points']}",
            f"{muscle['volume']:.1f}", f"{muscle['fiber_length']:.1f}, {muscle['pennation']:.0f}°",
            f"{muscle['PCSA']:.1f}", f"{abs(force):.3g} ± {bar:.2g} N",
            f"{estimate['value']:.3g} N", found["verdict"]["state"], f"{run.wall:.0f}",
            f"{run.cpu:.0f}", f"{run.memory:.0f}",
        )  # fmt: skip
