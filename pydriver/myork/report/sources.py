"""What an output folder holds, read into one record; what is absent or broken is left out."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from myork.errors import FileError, MyorkError
from myork.imaging.io import read_image, read_labels
from myork.records import Image, Labels
from myork.results import Results

__all__ = ["Deformation", "RunFolder", "read_folder"]

F64 = NDArray[np.float64]
T = TypeVar("T")


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
        Largest principal Cauchy stress in the last step, shape `(np,)` [force/length^2].
    volume_ratio : NDArray
        J in the last step, shape `(np,)` [-].
    loads, activations : NDArray
        Load and activation of all steps, shape `(nstep,)` [-].
    """

    points: F64
    displacement: F64
    stress: F64
    volume_ratio: F64
    loads: F64
    activations: F64


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
    labels, tissue, image, fibers : Labels, Image or None
        Output of `segment`: label map, materials of a leg, image and fiber vectors (three values
        a voxel).
    problems : tuple of str
        Files that are there and cannot be read, and why.
    """

    path: Path
    summary: dict[str, Any] = field(default_factory=dict)
    history: dict[str, NDArray[Any]] = field(default_factory=dict)
    deformation: Deformation | None = None
    labels: Labels | None = None
    tissue: Labels | None = None
    image: Image | None = None
    fibers: Image | None = None
    problems: tuple[str, ...] = ()


def read_folder(path: Path) -> RunFolder:
    """Read whatever of a run is in a folder.

    Parameters
    ----------
    path : Path
        Output folder of any command.

    Returns
    -------
    RunFolder
        Its content; a file that cannot be read becomes one of the `problems`.
    """
    if not path.is_dir():
        raise FileError(f"{path}: no such folder; give the output folder of a command")
    problems: list[str] = []

    def read(name: str, reader: Callable[[Path], T]) -> T | None:
        if not (path / name).exists():
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
        labels=read("segmentation.nii.gz", read_labels),
        tissue=read("tissue.nii.gz", read_labels),
        image=read("anatomy.nii.gz", read_image),
        fibers=read("fibers.nii.gz", lambda file: read_image(file, values=3)),
        problems=tuple(problems),
    )
    if not (folder.summary or folder.deformation or folder.labels or problems):
        raise FileError(
            f"{path}: nothing to report: neither summary.json nor results.vtkhdf nor "
            "segmentation.nii.gz is there; give the output folder of a command"
        )
    return folder


def _read_summary(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise FileError(f"{path}: cannot be read as JSON: {error}") from error
    if not isinstance(content, dict):
        raise FileError(f"{path}: not a summary: an object is needed")
    return content


def _read_history(path: Path) -> dict[str, NDArray[Any]]:
    """Columns as numbers where every entry is one; an empty entry is not a number."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            rows = list(csv.DictReader(file, restval=""))
    except (OSError, ValueError, csv.Error) as error:
        raise FileError(f"{path}: cannot be read as CSV: {error}") from error
    columns: dict[str, NDArray[Any]] = {}
    for name in rows[0] if rows else ():
        entries = [row[name] for row in rows]
        try:
            columns[name] = np.array([float(entry or "nan") for entry in entries])
        except ValueError:
            columns[name] = np.array(entries)
    return columns


def _read_deformation(path: Path) -> Deformation:
    with Results(path) as results:
        return Deformation(
            points=results.points,
            displacement=results.field("u"),
            stress=results.field("principal_stress")[:, 0],
            volume_ratio=results.field("J"),
            loads=results.loads,
            activations=results.activations,
        )
