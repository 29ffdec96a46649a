"""Tables of gradients with right and wrong axes."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from myork.imaging.diffusion import parse_axes
from myork.imaging.geometry import frame
from myork.imaging.phantom import make_phantom
from myork.model.fibers import fiber_field
from myork.model.mesh import read_tracts, tract_fibers, voxelise
from myork.model.orientation import Finding, check_orientation
from myork.records import Image, Labels

CALVES = 24
WRONG = 4
PARTS = {"calf": range(1, 7), "gastrocnemius": [1], "soleus": [3], "two muscles": [3, 4]}
MUSCLES = {"MG.stl": ("tracts_MG.npz", 1.0), "left_biceps_brachii_7x7fibers.vts": ("", 10.0)}
CUTS = ((0.0, 1.0), (0.1, 0.4), (0.3, 0.6), (0.5, 0.8))


def calves(first: int, last: int) -> Iterator[tuple[Image, Labels]]:
    """Fibers and labels of phantoms, whole and muscle by muscle."""
    for case in range(first, last):
        random = np.random.default_rng(case)
        h = float(random.choice([1.25, 1.5, 2.0]))
        scale = float(random.uniform(0.75, 1.0))
        n = int(np.ceil((108 * scale + 6) / h))
        calf = make_phantom(
            (n, n, int(random.integers(5, 16))),
            (h, h, float(random.choice([3.0, 4.0, 5.0, 6.0, 8.0]))),
            seed=case,
            scale=scale,
            snr=float(random.choice([10, 15, 25, 40])),
            pennation=float(random.uniform(0.3, 1.4)),
            growth=float(random.choice([0.0, 15.0])),
        )
        for numbers in PARTS.values():
            part = np.where(np.isin(calf.truth.data, list(numbers)), calf.truth.data, 0)
            fibers = fiber_field(calf.tensor, part > 0, 3.0).fibers
            yield fibers, Labels(part.astype(np.int32), calf.truth.affine, calf.truth.names)


def real(data: Path) -> Iterator[tuple[Image, Labels]]:
    """Fibers and labels of real muscles, whole and parts of their height."""
    for surface, (tracts, unit) in MUSCLES.items():
        paths = [next(data.rglob(name)) for name in (surface, tracts or surface)]
        labels = voxelise(paths[0], unit, [2, 2, 4], "muscle")
        fibers = tract_fibers(read_tracts(paths[1], unit), labels, paths[1].name)
        for low, high in CUTS:
            part = slice(*(int(a * labels.data.shape[2]) for a in (low, high)))
            yield (
                Image(fibers.data[:, :, part], fibers.affine),
                Labels(labels.data[:, :, part], labels.affine),
            )


def counts(cases: Iterator[tuple[Image, Labels]]) -> list[str]:
    """How many tables are doubted, and by how much right ones cross walls more than the best."""
    tables = {"right": [0, 0], "long axis exchanged": [0, 0], "others": [0, 0]}
    margin = 0.0
    random = np.random.default_rng(1)
    for fibers, labels in cases:
        found = check_orientation(fibers, labels)
        margin = max(margin, found.evidence[0].crossing - min(e.crossing for e in found.evidence))
        tables["right"][0] += bool(found.doubt)
        tables["right"][1] += 1
        for number in 1 + random.choice(len(found.evidence) - 1, WRONG, replace=False):
            axes = found.evidence[number].axes
            kind = "others" if axes.replace("-", "")[-1] == "z" else "long axis exchanged"
            tables[kind][0] += bool(checked_with(fibers, labels, axes).doubt)
            tables[kind][1] += 1
    return [*(f"{doubted} of {number}" for doubted, number in tables.values()), f"{margin:.2f}"]


def checked_with(fibers: Image, labels: Labels, axes: str) -> Finding:
    """The check on fibers of a table with other axes."""
    columns = frame(fibers.affine)
    turn = columns @ parse_axes(axes) @ columns.T
    return check_orientation(Image(fibers.data @ turn.T, fibers.affine), labels)


def gradient_axes(data: str = "") -> Iterator[tuple[str, ...]]:
    """How often `segment` doubts right and wrong gradient axes.

    Phantoms of many sizes, pennations and noises, with and without names, by themselves and by
    single muscles, each with its right table and with four wrong ones; with `data`, a folder with
    the surfaces and tracts of inputs/images, real muscles as well, whole and cut. The first half of
    the phantoms chose the bound of the walls, the second did not.
    """
    yield "tables", "right", "long axis exchanged", "other wrong ones", "right ones cross walls by"
    for half, (first, last) in (("chose", (0, CALVES // 2)), ("did not", (CALVES // 2, CALVES))):
        for known in (False, True):
            cases = (
                (fibers, labels if known else Labels(labels.data, labels.affine))
                for fibers, labels in calves(first, last)
            )
            names = "with names" if known else "no names"
            yield f"phantoms that {half}, {names}", *counts(cases)
    if data:
        yield "real muscles", *counts(real(Path(data)))
