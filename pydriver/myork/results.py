"""Reader of the result file `results.vtkhdf`: arrays are read on request.

The file is written by fortran/results/h5/rk_results.f90; the data for VTK are in its group VTKHDF,
those for a restart in its group MyoRK.
"""

import operator
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from myork.arrays import UNREADABLE, dataset
from myork.errors import FileError, InputError, optional
from myork.summary import read_summary
from myork.types import F64, I32

_FILE = "results.vtkhdf"
# Positions of VTK's six components xx, yy, zz, xy, yz, xz in the tensor, row by row
_SYMMETRIC = [0, 3, 5, 3, 1, 4, 5, 4, 2]
# Components of scalars, vectors, symmetric and other tensors
_WIDTHS = (1, 3, 6, 9)
# Largest number of cells in the largest plane of a lattice, per point
_MOST_CELLS = 100


@dataclass(frozen=True)
class RestartState:
    """Data from which a solve can continue after a step."""

    step: int  #: Number of the step, 0 for the undeformed state
    load: float  #: Fraction of the full load [-]
    activation: float  #: Activation of the muscle fibers [-]
    coefficients: F64  #: Coefficients of the approximation, shape `(ndof,)`
    points: F64  #: Undeformed collocation points, shape `(np, 3)` [length]
    approximation: str  #: Description of the shape functions they belong to


class Results(AbstractContextManager["Results"]):
    """Result file of a solve, open for reading; a context manager.

    - `path`: result file, or the output folder with `results.vtkhdf` in it

    Attributes: `path`, the file, and

    - `nstep`: number of steps, the undeformed state (step 0) included
    - `npoint`: number of collocation points
    - `fields`: names for `field`

    >>> with Results("out/shear_3d") as results:  # doctest: +SKIP
    ...     sigma_xy = results.field("cauchy", step=-1)[:, 0, 1]
    """

    def __init__(self, path: str | Path) -> None:
        path = Path(path)
        self.path = path / _FILE if path.is_dir() else path
        self._file = _open(self.path)
        try:
            with _damage(self.path, "it"):
                vtk = self._file["VTKHDF"]
                self.nstep = int(vtk["Steps"].attrs["NSteps"])
                self.npoint = int(vtk["Points"].shape[0])
                self.fields: tuple[str, ...] = tuple(vtk["PointData"])
                steps = len(self._file["MyoRK/load"])
            if not 1 <= self.nstep <= steps or self.npoint < 1:
                raise FileError(
                    f"{self.path}: damaged: {self.nstep} steps, {self.npoint} points and "
                    f"{steps} loads do not fit together; solve again"
                )
        except FileError:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file; arrays that were already read stay valid."""
        self._file.close()

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"Results({str(self.path)!r}: {self.nstep} steps, {self.npoint} points)"

    @cached_property
    def points(self) -> F64:
        """Undeformed collocation points, shape `(np, 3)` [length]."""
        return self._read("VTKHDF/Points")

    @cached_property
    def label(self) -> I32:
        """Label of each point, shape `(np,)`."""
        return self._read("VTKHDF/PointData/label")

    @cached_property
    def fiber(self) -> F64:
        """Fiber directions, unit vectors or zero, shape `(np, 3)` [-]."""
        return self._read("VTKHDF/PointData/fiber")

    @cached_property
    def surface(self) -> I32:
        """Point indices at the corners of the surface triangles, counter-clockwise from outside.

        Triangles of a plane body fill it. Shape `(m, 3)`, no rows where points form no lattice.
        """
        found = self._joined("surface")
        if found.shape[1] != 3 or found.min(initial=0) < 0 or found.max(initial=0) >= self.npoint:
            raise FileError(f"{self.path}: damaged: the surface does not fit the points")
        return found

    @cached_property
    def lattice(self) -> I32:
        """Indices of each point in its lattice, shape `(np, dimension)`; `(0, 3)` without one."""
        found = self._joined("lattice")
        right = len(found) in (0, self.npoint)
        if right and len(found):
            # pictures allocate every cell of a plane, most of which lie in the body
            cells = np.ptp(found.astype(float), axis=0) + 1.0
            axes = np.flatnonzero(np.ptp(self.points, axis=0))
            right = axes.max(initial=0) < len(cells)
            right = right and cells.prod() / cells.min() <= _MOST_CELLS * self.npoint
        if not right:
            raise FileError(f"{self.path}: damaged: the lattice does not fit the points")
        return found

    def _joined(self, name: str) -> I32:
        """Rows of integers that describe the connectivity of points; none without a lattice."""
        self._check_open()
        with _damage(self.path, name):
            if f"MyoRK/{name}" not in self._file:
                return np.empty((0, 3), np.int32)
        found = self._read(f"MyoRK/{name}")
        if found.ndim != 2 or found.shape[1] not in (1, 2, 3) or found.dtype.kind != "i":
            raise FileError(f"{self.path}: damaged: {name} has shape {found.shape}")
        return found

    @cached_property
    def loads(self) -> F64:
        """Load of each step as a fraction of the full load, shape `(nstep,)` [-]."""
        return self._series("MyoRK/load")

    @cached_property
    def activations(self) -> F64:
        """Activation of the muscle fibers in each step, shape `(nstep,)` [-]."""
        return self._series("MyoRK/activation")

    def _series(self, name: str) -> F64:
        """One number per step."""
        values = self._read(name)
        if values.ndim != 1 or len(values) < self.nstep:
            raise FileError(
                f"{self.path}: damaged: {name} has shape {values.shape} for {self.nstep} steps; "
                "solve again"
            )
        return values[: self.nstep]

    def field(self, name: str, step: int = -1) -> NDArray[Any]:
        """Read a field at all points.

        - `name`: one of `fields`: `u` [length], `F` [-], `J` [-], `cauchy`, `principal_stress`
          (greatest first) and `pressure` [force/length^2], `fiber` [-], `label`
        - `step`: number of the step; negative numbers count from the last one
        - returns scalars `(np,)`, vectors `(np, 3)`, tensors `(np, 3, 3)`: `F[p, i, A]` is the
          derivative of component i of the position with respect to coordinate A
        """
        if name not in self.fields:
            raise InputError(
                f"{self.path}: no field {name!r}; available: {', '.join(sorted(self.fields))}"
            )
        step = self._step(step)
        self._check_open()
        with _damage(self.path, f"field {name}"):
            first = int(self._file[f"VTKHDF/Steps/PointDataOffsets/{name}"][step])
        values = self._read(f"VTKHDF/PointData/{name}", slice(first, first + self.npoint))
        width = values.shape[1] if values.ndim == 2 else 1
        if first < 0 or len(values) != self.npoint or values.ndim > 2 or width not in _WIDTHS:
            raise FileError(
                f"{self.path}: field {name} is damaged: shape {values.shape} of step {step} for "
                f"{self.npoint} points; solve again"
            )
        if values.ndim == 1 or width in (1, 3):
            return values
        if width == 6:
            values = values[:, _SYMMETRIC]
        return values.reshape(-1, 3, 3)

    def deformed(self, step: int = -1) -> F64:
        """Positions of the points in a step, shape `(np, 3)` [length]."""
        return self.points + self.field("u", step)

    def to_pyvista(self, step: int = -1, *, deformed: bool = False) -> Any:
        """Points of a step with all fields, for PyVista.

        - `step`: number of the step; negative numbers count from the last one
        - `deformed`: use the deformed positions of the points; the field `u` is included either way
        - returns `pyvista.PolyData`: a vertex for each point, and the surface triangles where
          known; tensors have nine components, row by row. `field_data` holds `step`,
          `load` and `activation`.
        - raises InstallationError: PyVista is missing

        >>> with Results("out/muscle_block") as results:  # doctest: +SKIP
        ...     results.to_pyvista(-1, deformed=True).plot(scalars="pressure")
        """
        step = self._step(step)
        cloud = optional("pyvista", "viz").PolyData(
            self.deformed(step) if deformed else self.points
        )
        if len(self.surface):
            cloud.faces = np.insert(self.surface, 0, 3, axis=1).ravel()
        for name in self.fields:
            values = self.field(name, step)
            cloud.point_data[name] = values.reshape(len(values), -1).squeeze()
        cloud.field_data["step"] = [step]
        cloud.field_data["load"] = [self.loads[step]]
        cloud.field_data["activation"] = [self.activations[step]]
        return cloud

    def history(self) -> Any:
        """Load steps of the summary with their probes, as a table.

        - returns `pandas.DataFrame`: a row per load step, indexed by number: `load`, `activation`,
          `iterations`, `min_J`, `max_J`, and a column for each probe (`force_x`, `force_y`,
          `force_z` for a probe `force` of three numbers) with its error bar, `force_x_error`, if
          any. Its `attrs["units"]` holds the units of these columns by name.
        - raises InstallationError: Pandas is missing
        - raises FileError: there is no `summary.json` beside the file
        """
        pandas = optional("pandas", "pandas")
        rows: list[dict[str, Any]] = []
        units: dict[str, str] = {}
        known = self.summary.get("probe_units", {})
        for step in self.summary.get("steps", []):
            names = ("load", "activation", "iterations", "min_J", "max_J")
            row = {name: step[name] for name in names if name in step}
            for ending, part in (("", "probes"), ("_error", "probe_errors")):
                for name, value in step.get(part, {}).items():
                    if isinstance(value, list):
                        parts = zip("xyz", value, strict=False)
                        found = {f"{name}_{axis}{ending}": one for axis, one in parts}
                    else:
                        found = {f"{name}{ending}": value}
                    row |= found
                    units |= dict.fromkeys(found, known.get(name, ""))
            rows.append(row)
        table = pandas.DataFrame(rows, index=pandas.RangeIndex(1, len(rows) + 1, name="step"))
        table.attrs["units"] = units
        return table

    def restart(self, step: int = -1) -> RestartState:
        """State from which a solve can continue.

        - `step`: number of the step; negative numbers count from the last one
        - returns load, activation, coefficients and the approximation they belong to
        """
        step = self._step(step)
        words = self._read("MyoRK/approximation")
        return RestartState(
            step=step,
            load=float(self.loads[step]),
            activation=float(self.activations[step]),
            coefficients=self._read("MyoRK/coefficients", step),
            points=self.points,
            approximation=words.tobytes().decode("utf-8", "replace"),
        )

    @cached_property
    def summary(self) -> dict[str, Any]:
        """`summary.json` of the same folder; FileError where there is none."""
        found = read_summary(self.path.parent)
        if not found:
            raise FileError(
                f"{self.path.parent / 'summary.json'}: cannot be read: there is no such file"
            )
        return found

    def probe(self, name: str) -> tuple[F64, F64]:
        """Values of a probe in all steps of the summary.

        - `name`: name of the probe in the deck
        - returns loads, shape `(n,)` [-], and values, shape `(n,)` or, for a vector, `(n, 3)`
        """
        steps = self.summary.get("steps", [])
        names = {key for step in steps for key in step.get("probes", {})}
        if name not in names:
            raise InputError(
                f"{self.path.parent / 'summary.json'}: no probe {name!r}; its probes: "
                f"{', '.join(sorted(names)) or 'none'}"
                f"{'' if steps else '; the run ended before it had an answer'}"
            )
        rows = [(step["load"], step["probes"][name]) for step in steps if name in step["probes"]]
        return (
            np.array([load for load, _ in rows], dtype=float),
            np.array([value for _, value in rows], dtype=float),
        )

    def _check_open(self) -> None:
        if not self._file:
            raise InputError(f"{self.path}: these results are closed: open the file again")

    def _step(self, step: int) -> int:
        try:
            number = operator.index(step)
        except TypeError:
            number = self.nstep
        if not -self.nstep <= number < self.nstep:
            raise InputError(f"{self.path}: no step {step!r}; the last one is {self.nstep - 1}")
        return number % self.nstep

    def _read(self, name: str, part: Any = ()) -> NDArray[Any]:
        """Values of a dataset; errors name the file."""
        self._check_open()
        with _damage(self.path, name):
            values = np.asarray(dataset(self._file, name)[part])
            if values.dtype.kind not in "iuf":
                raise TypeError("it does not contain numbers")
        return values


def restart_of(words: str | Path) -> RestartState:
    """State of a result file, given by a text.

    - `words`: result file or its folder, and after a colon the number of the step:
      `"out/block:3"`; without it the last one
    """
    path, colon, step = str(words).rpartition(":")
    if colon and path and step.isdecimal() and not Path(words).exists():
        with Results(path) as results:
            return results.restart(int(step))
    with Results(words) as results:
        return results.restart()


@contextmanager
def _damage(path: Path, what: str) -> Iterator[None]:
    """Name the file in any of the many errors that h5py raises for damaged files."""
    try:
        yield
    except (*UNREADABLE, InputError) as reason:
        raise FileError(
            f"{path}: not a result file of myork, or damaged: {what} cannot be read: "
            f"{reason}; give a file that 'myork solve' has written"
        ) from None


def _open(path: Path) -> h5py.File:
    """Open a file for reading; an error gives the reason and the remedy."""
    try:
        return h5py.File(path, "r")
    except FileNotFoundError as error:
        part = path.with_name(path.name + ".part")
        hint = f"; {part.name} is what an interrupted run has left" if part.exists() else ""
        raise FileError(f"{path}: no such file; run 'myork solve' first{hint}") from error
    except OSError as error:
        raise FileError(
            f"{path}: cannot be opened as an HDF5 file, it may be cut short: {error}"
        ) from error
