"""Content of an output folder, read into one record; missing parts are left out."""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from myork.errors import FileError, MyorkError
from myork.imaging.io import read_image, read_labels
from myork.records import Image, Labels
from myork.results import Results
from myork.summary import WAITING, read_summary
from myork.types import F64, I32

T = TypeVar("T")


@dataclass(frozen=True)
class Deformation:
    """Last state of a solve, and the load path to it."""

    points: F64  #: Undeformed points, shape `(np, 3)` [length]
    displacement: F64  #: Displacement, shape `(np, 3)` [length]
    #: Largest principal Cauchy stress, not a number where undefined (J <= 0), shape
    #: `(np,)` [force/length^2]
    stress: F64
    volume_ratio: F64  #: J, shape `(np,)` [-]
    #: Undeformed fiber directions, zero where there are none, shape `(np, 3)` [-]
    fiber: F64
    label: I32  #: Label of the material of each point, shape `(np,)`
    #: As in `Results`, without rows where unknown
    surface: I32
    lattice: I32
    #: Load and activation of all steps, shape `(nstep,)` [-]
    loads: F64
    activations: F64

    @property
    def moved(self) -> F64:
        """Deformed positions of the points, shape `(np, 3)` [length]."""
        return self.points + self.displacement

    @property
    def size(self) -> F64:
        """Length of the displacement, shape `(np,)` [length]."""
        return np.asarray(np.linalg.norm(self.displacement, axis=1))

    @property
    def is_plane(self) -> bool:
        """Whether all points lie in the plane of x and y."""
        return not np.ptp(self.points[:, 2])


@dataclass(frozen=True)
class RunFolder:
    """Content of an output folder."""

    path: Path  #: The folder
    summary: dict[str, Any] = field(default_factory=dict)  #: `summary.json`, empty without one
    deformation: Deformation | None = None  #: From `results.vtkhdf`
    #: Output of `segment`: label map, tissues of a leg, image and fiber vectors (three values per
    #: voxel)
    labels: Labels | None = None
    tissue: Labels | None = None
    image: Image | None = None
    fibers: Image | None = None


def read_folder(path: Path) -> RunFolder:
    """Read all results of a run in an output folder.

    - raises FileError: there is nothing to report, or files are damaged; the message names all of
      them
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

    summary = read("summary.json", lambda _: _known(read_summary(path))) or {}
    # results of an earlier run than that of the summary
    own = summary.get("steps", not (path / WAITING).exists())
    folder = RunFolder(
        path=path,
        summary=summary,
        deformation=read("results.vtkhdf", _read_deformation) if own else None,
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


def _known(value: Any) -> Any:
    """The value without null entries of its mappings."""
    if isinstance(value, dict):
        return {key: _known(own) for key, own in value.items() if own is not None}
    return [_known(own) for own in value] if isinstance(value, list) else value


def _read_deformation(path: Path) -> Deformation | None:
    """The last state of a body; None for a scalar field, of which nothing is drawn."""
    with Results(path) as results:
        displacement = results.field("u")
        if displacement.ndim == 1 or displacement.shape[1] == 1:
            return None
        return Deformation(
            points=results.points,
            displacement=displacement,
            stress=results.field("principal_stress")[:, 0],
            volume_ratio=results.field("J"),
            fiber=results.fiber,
            label=results.label,
            surface=results.surface,
            lattice=results.lattice,
            loads=results.loads,
            activations=results.activations,
        )
