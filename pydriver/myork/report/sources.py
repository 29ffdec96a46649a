"""What an output folder holds, read into one record; what is absent is left out."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from myork.errors import FileError, MyorkError
from myork.imaging.io import read_image, read_labels
from myork.records import Image, Labels
from myork.reduced_fields import REDUCED_FILE, ReducedFields, read_reduced
from myork.report.structure import check_summary
from myork.results import Results
from myork.summary import SOLUTION, WAITING, read_summary
from myork.types import F64, I32

__all__ = ["Deformation", "RunFolder", "read_folder"]

T = TypeVar("T")

# Columns of history.csv that are no numbers
_TEXTS = ("solver",)
# Fields of a deformation that not every result file has
_OTHERS = ("cauchy", "fiber", "label")
# Those that have no value where the material is turned inside out
_STRESSES = ("stress", "cauchy")
# Beyond this a number is damage, or of no use in a picture
_LARGEST = 1e150


@dataclass(frozen=True)
class Deformation:
    """Last state of a solve, and the way to it.

    Attributes
    ----------
    points : NDArray
        Undeformed points, shape `(np, 3)` [length].
    displacement : NDArray
        Displacement in the last step, shape `(np, 3)` [length].
    stress : NDArray
        Largest principal Cauchy stress in the last step, not a number where there is none: where
        J <= 0, shape `(np,)` [force/length^2].
    volume_ratio : NDArray
        J in the last step, shape `(np,)` [-].
    loads, activations : NDArray
        Load and activation of all steps, shape `(nstep,)` [-].
    cauchy : NDArray or None
        Cauchy stress in the last step, shape `(np, 3, 3)` [force/length^2].
    fiber : NDArray or None
        Undeformed fiber directions, zero where there are none, shape `(np, 3)` [-].
    label : NDArray or None
        Label of the material of each point, shape `(np,)`.
    """

    points: F64
    displacement: F64
    stress: F64
    volume_ratio: F64
    loads: F64
    activations: F64
    cauchy: F64 | None = None
    fiber: F64 | None = None
    label: I32 | None = None


@dataclass(frozen=True)
class RunFolder:
    """Content of an output folder.

    Attributes
    ----------
    path : Path
        The folder.
    summary : dict
        `summary.json`, empty without one.
    history : dict
        Columns of `history.csv` by name, each of shape `(niteration,)`; text where the file has
        text. Empty without the file.
    deformation : Deformation or None
        From `results.vtkhdf`.
    reduced : ReducedFields or None
        Fields of reduced models beside the full one.
    labels, tissue, image, fibers : Labels, Image or None
        Output of `segment`: label map, materials of a leg, image and fiber vectors (three values
        a voxel).
    """

    path: Path
    summary: dict[str, Any] = field(default_factory=dict)
    history: dict[str, NDArray[Any]] = field(default_factory=dict)
    deformation: Deformation | None = None
    reduced: ReducedFields | None = None
    labels: Labels | None = None
    tissue: Labels | None = None
    image: Image | None = None
    fibers: Image | None = None


def read_folder(path: Path) -> RunFolder:
    """Read whatever of a run is in a folder.

    Parameters
    ----------
    path : Path
        Output folder of any command.

    Returns
    -------
    RunFolder
        Its content.

    Raises
    ------
    FileError
        There is nothing to report, or files are damaged: the message names all of them.
    """
    if not path.is_dir():
        raise FileError(f"{path}: no such folder; give the output folder of a command")
    problems: list[str] = []
    # of an earlier run than the one that the summary is about
    others = SOLUTION if (path / WAITING).exists() else ()

    def read(name: str, reader: Callable[[Path], T]) -> T | None:
        if name in others or not (path / name).exists():
            return None
        try:
            return reader(path / name)
        except MyorkError as error:
            problems.append(str(error))
            return None

    folder = RunFolder(
        path=path,
        summary=read("summary.json", _read_summary) or {},
        history=read("history.csv", _read_history) or {},
        deformation=read("results.vtkhdf", _read_deformation),
        reduced=read(REDUCED_FILE, read_reduced),
        labels=read("segmentation.nii.gz", read_labels),
        tissue=read("tissue.nii.gz", read_labels),
        image=read("anatomy.nii.gz", read_image),
        fibers=read("fibers.nii.gz", lambda file: read_image(file, values=3)),
    )
    if problems:
        rest = "run the command again, or remove the file to see a report of the rest"
        raise FileError("\n".join([*problems, rest]))
    if not (folder.summary or folder.deformation or folder.labels):
        raise FileError(
            f"{path}: nothing to report: neither summary.json nor results.vtkhdf nor "
            "segmentation.nii.gz is there; give the output folder of a command"
        )
    return folder


def _read_summary(path: Path) -> dict[str, Any]:
    return check_summary(path, read_summary(path.parent))


def _read_history(path: Path) -> dict[str, NDArray[Any]]:
    """Columns as numbers, but for the names of solvers; an empty entry is not a number."""
    try:
        text = path.read_bytes().decode("utf-8")
        rows = list(csv.reader(text.splitlines(keepends=True), strict=True))
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"{path}: cannot be read as CSV: {error}") from None
    head = rows[0] if rows else []
    if not {"step", "load"} <= set(head) or len(set(head)) < len(head):
        raise FileError(f"{path}: damaged: its first line is no head with the columns step, load")
    if not text.endswith("\n"):
        raise FileError(f"{path}: cut off in the middle of its last line")
    for line, row in enumerate(rows[1:], 2):
        if len(row) != len(head):
            raise FileError(f"{path}:{line}: {len(head)} entries are needed, not {len(row)}")
    columns: dict[str, NDArray[Any]] = {}
    if len(rows) == 1:
        return columns
    for name, *entries in zip(*rows, strict=True):
        if name in _TEXTS:
            columns[name] = np.array(entries)
            continue
        numbers = [_number_of(entry) for entry in entries]
        if None in numbers:
            line = numbers.index(None) + 2
            raise FileError(f"{path}:{line}: {name}: {entries[line - 2]!r:.60} is not a number")
        columns[name] = np.array(numbers, float)
    return columns


def _number_of(entry: str) -> float | None:
    """Number of an entry, None where it is none: also one that cannot be drawn."""
    try:
        value = float(entry or "nan")
    except ValueError:
        return None
    return value if not abs(value) > _LARGEST else None


def _read_deformation(path: Path) -> Deformation | None:
    """The last state of a body; None for a scalar field, of which nothing is drawn."""
    with Results(path) as results:
        displacement = results.field("u")
        if displacement.ndim == 1 or displacement.shape[1] == 1:
            return None
        others: dict[str, Any] = {
            name: results.field(name) for name in _OTHERS if name in results.fields
        }
        found = Deformation(
            points=results.points,
            displacement=displacement,
            stress=results.field("principal_stress")[:, 0],
            volume_ratio=results.field("J"),
            loads=results.loads,
            activations=results.activations,
            **others,
        )
    n, steps = len(displacement), results.nstep
    shapes: tuple[tuple[int, ...], ...]
    shapes = ((n, 3), (n, 3), (n,), (n,), (steps,), (steps,), (n, 3, 3), (n, 3), (n,))
    for (name, values), shape in zip(vars(found).items(), shapes, strict=True):
        if values is None:
            continue
        sound = np.abs(values) <= _LARGEST
        if name in _STRESSES:
            sound |= np.isnan(values)
        if values.shape != shape or not sound.all():
            raise FileError(
                f"{path}: {name}: finite numbers of shape {shape} are needed; the file is damaged"
            )
    return found
