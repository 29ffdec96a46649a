"""A deck solved by dolfinx 0.5 (Debian's python3-dolfinx), in a separate process.

Run by the Python for which dolfinx is installed, which need not be that of MyoRK: a job as JSON on
standard input, a line of JSON for each mesh on standard output. Bodies are meshes of hexahedra or
quadrilaterals in their exact shape (annuli in polar coordinates); forms are `Q2`, `Q3`
(displacements alone), `Q2/Q1`, `Q2/P1` and `Q3/P2` (with pressures); tangents are UFL derivatives
of the energy, factorised by MUMPS. Import, compilation and the preceding work of UFL are not
included in the times.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import ufl
from dolfinx import fem, mesh
from dolfinx.fem import petsc
from mpi4py import MPI
from petsc4py import PETSc

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.truths.conditions import AXES, Ended, fiber_of, moved, side_of

#: Numbers of load steps to try, and limit of Newton iterations in each
_STEPS, _ITERATIONS = (1, 2, 4, 8, 16), 25
#: Relative residual of a converged load step [-]
_TOLERANCE = 1e-8
#: Tolerance for nodes at a place, relative to the body's size
_NEAR = 1e-9


#: Corners of an element of dolfinx, first axis slowest
_CORNERS = {2: [0, 2, 1, 3], 3: [0, 4, 2, 6, 1, 5, 3, 7]}


class _Diverged(Exception):
    """A load step that did not converge."""


def _energy(table: Mapping[str, Any], f: Any, activation: Any, curves: Any, fiber: Any) -> Any:
    """Isochoric energy of a material, as in `docs/theory/body.md`."""
    c, j = f.T * f, ufl.det(f)
    one = j ** (-2 / 3) * ufl.tr(c)
    two = j ** (-4 / 3) * (ufl.tr(c) ** 2 - ufl.tr(c * c)) / 2
    energy = 0.0
    for i in range(4):
        for k in range(4 - i):
            factor = table.get(f"A{i}{k}") or 0.0
            if factor:
                energy += factor * (one - 3) ** i * (two - 3) ** k
    if curves:
        along = ufl.as_vector(fiber)
        stretch = j ** (-1 / 3) * ufl.sqrt(ufl.dot(along, c * along)) / table["lambda_o"]
        active, passive = (_integral(pieces, stretch) for pieces in curves)
        energy += table["sigma_max"] * (activation * active + passive)
    return energy


def _integral(pieces: Sequence[Mapping[str, Any]], stretch: Any) -> Any:
    """Integral of a force over the stretch; constants of pieces are irrelevant."""
    total = 0.0 * stretch
    for piece in pieces:
        t = stretch - piece["centre"]
        own = sum(c / (k + 1) * t ** (k + 1) for k, c in enumerate(piece["c"]))
        if piece.get("amplitude"):
            own += piece["amplitude"] / piece["rate"] * ufl.exp(piece["rate"] * t)
        total = ufl.conditional(ufl.gt(stretch, piece["start"]), own, total)
    return total


class _Solve:
    """One mesh and form of a job."""

    def __init__(self, job: Mapping[str, Any], elements: Sequence[int]) -> None:
        self.apart = 0.0
        deck, geometry = job["deck"], job["deck"]["geometry"]
        self.deck, self.geometry = deck, geometry
        self.dim = int(deck["scene"]["dimension"])
        self.ring = geometry["kind"] == "annulus"
        if self.ring:
            low, high = [geometry["inner_radius"], 0.0], [geometry["outer_radius"], np.pi / 2]
        else:
            low, high = [0.0] * self.dim, list(geometry["size"])
        self.low, self.high = np.array(low, float), np.array(high, float)
        make = mesh.create_rectangle if self.dim == 2 else mesh.create_box
        kind = mesh.CellType.quadrilateral if self.dim == 2 else mesh.CellType.hexahedron
        self.mesh = make(MPI.COMM_WORLD, [self.low, self.high], list(elements), kind)
        order, _, pressure = job["form"].partition("/")
        self.order = int(order[1:])
        cell = self.mesh.ufl_cell()
        element = ufl.VectorElement("Q", cell, self.order)
        if pressure:
            family = {"Q": "Q", "P": "DPC"}[pressure[0]]
            element = ufl.MixedElement(element, ufl.FiniteElement(family, cell, int(pressure[1:])))
        self.space = fem.FunctionSpace(self.mesh, element)
        self.state = fem.Function(self.space)
        if pressure:
            part, self.dofs_of = self.space.sub(0).collapse()
            self.dofs_of = np.asarray(self.dofs_of, np.int64)
        else:
            part, self.dofs_of = self.space, None
        self.part = part
        self.places = part.tabulate_dof_coordinates()[:, : self.dim]
        if self.dofs_of is None:
            self.dofs_of = np.arange(self.dim * len(self.places))
        #: Indices of each node's components in the vector of unknowns, shape `(nodes, dim)`
        self.number = self.dofs_of.reshape(-1, self.dim)
        self.points = self._point(self.places)
        self._forms(bool(pressure), job["curves"])
        self.bounds = [(self._on(entry["set"]), entry) for entry in deck["boundary"]]

    def _point(self, place: Any) -> Any:
        """Positions in the body for coordinates of the mesh."""
        if not self.ring:
            return place
        return np.stack([place[:, 0] * np.cos(place[:, 1]), place[:, 0] * np.sin(place[:, 1])], 1)

    def _on(self, name: str) -> Any:
        """Numbers of the nodes of a set."""
        axis, side = side_of(name, self.ring)
        wall = (self.low, self.high)[side][axis]
        return np.flatnonzero(abs(self.places[:, axis] - wall) < _NEAR * self.high.max())

    def _forms(self, mixed: bool, curves: Any) -> None:
        table = self.deck["material"][0]
        x = ufl.SpatialCoordinate(self.mesh)
        p: Any
        u, p = ufl.split(self.state) if mixed else (self.state, None)
        slope: Any = ufl.grad(u)
        volume: Any = 1.0
        if self.ring:
            mapped = ufl.grad(ufl.as_vector([x[0] * ufl.cos(x[1]), x[0] * ufl.sin(x[1])]))
            slope, volume = slope * ufl.inv(mapped), ufl.det(mapped)
        size = range(self.dim)
        f = ufl.as_tensor(
            [[(slope[i, k] if i in size and k in size else 0) + int(i == k) for k in range(3)]
             for i in range(3)]
        )  # fmt: skip
        f = ufl.variable(f)
        fiber = fiber_of({"fiber_angle": 0.0} | table, self.dim == 2)
        self.load = fem.Constant(self.mesh, 0.0)
        activation = self.load * float(self.deck["load"].get("activation") or 0.0)
        shape = _energy(table, f, activation, curves, fiber)
        j: Any = ufl.det(f)
        bulk = float(table["K"])
        volumetric = p * (j - 1) - p * p / (2 * bulk) if mixed else bulk / 2 * (j - 1) ** 2
        dx = ufl.dx(metadata={"quadrature_degree": 2 * self.order})
        work = (shape + volumetric) * volume * dx
        inner = ufl.derivative(work, self.state)
        outer = self._tractions(u)
        self.residual = self._compiled(
            inner - ufl.derivative(outer, self.state) if outer else inner
        )
        self.inner = self._compiled(inner)
        self.tangent = self._compiled(ufl.derivative(inner, self.state))
        pressed = p if mixed else bulk * (j - 1)
        self.cauchy = ufl.diff(shape, f) * f.T / j + pressed * ufl.Identity(3)
        self.matrix = petsc.create_matrix(self.tangent)
        self.vector = petsc.create_vector(self.residual)
        self.solver = PETSc.KSP().create(MPI.COMM_WORLD)
        self.solver.setType("preonly")
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.solver.setOperators(self.matrix)
        preconditioner = self.solver.getPC()
        preconditioner.setType("cholesky")
        preconditioner.setFactorSolverType("mumps")

    def _tractions(self, u: Any) -> Any:
        """Work of the dead tractions."""
        work = None
        for number, entry in enumerate(self.deck["boundary"]):
            if entry.get("traction") is None:
                continue
            axis, side = side_of(entry["set"], self.ring)
            wall = (self.low, self.high)[side][axis]
            facets = mesh.locate_entities_boundary(
                self.mesh, self.dim - 1, lambda x, a=axis, w=wall: np.isclose(x[a], w)
            )
            tags = mesh.meshtags(
                self.mesh, self.dim - 1, np.sort(facets), np.full(len(facets), number, np.int32)
            )
            ds = ufl.Measure("ds", self.mesh, subdomain_data=tags)(number)
            own = self.load * ufl.dot(ufl.as_vector([float(t) for t in entry["traction"]]), u) * ds
            work = own if work is None else work + own
        return work

    def _compiled(self, form: Any) -> Any:
        begin = time.process_time()
        made = fem.form(form)
        self.apart += time.process_time() - begin
        return made

    def _prescribed(self, load: float) -> tuple[Any, Any]:
        """Numbers and values of the prescribed unknowns."""
        numbers, values = [], []
        for on, entry in self.bounds:
            for axis, value in moved(entry, self.points[on], load).items():
                numbers.append(self.number[on, axis])
                values.append(np.broadcast_to(value, len(on)))
        number, first = np.unique(np.concatenate(numbers), return_index=True)
        return number.astype(np.int32), np.concatenate(values)[first]

    def solve(self, steps: int) -> int:
        """Newton's method over equal load steps; returns the number of iterations."""
        x = self.state.vector
        x.set(0.0)
        change = x.duplicate()
        iterations = 0
        for step in range(1, steps + 1):
            self.load.value = step / steps
            numbers, values = self._prescribed(step / steps)
            first: Any = None
            for count in range(_ITERATIONS):
                with self.vector.localForm() as local:
                    local.set(0.0)
                petsc.assemble_vector(self.vector, self.residual)
                gap = x.array[numbers] - values
                size = np.linalg.norm(np.delete(self.vector.array, numbers))
                if not np.isfinite(size) or (first and size > 1e6 * first):
                    raise _Diverged
                if count == 1:
                    first = size
                if count > 1 and (size < _TOLERANCE * first or size < 1e-10):
                    break
                self.matrix.zeroEntries()
                petsc.assemble_matrix(self.matrix, self.tangent)
                self.matrix.assemble()
                # prescribed unknowns move by their gap, which enters the rows of the others
                change.array[numbers] = gap
                self.matrix.zeroRowsColumns(numbers, 1.0, change, self.vector)
                self.solver.solve(self.vector, change)
                if self.solver.getConvergedReason() < 0 or not np.isfinite(change.norm()):
                    raise _Diverged
                x.axpy(-1.0, change)
                iterations += 1
            else:
                raise _Diverged
        return iterations

    def probes(self) -> dict[str, float]:
        """Values of the deck's probes."""
        with self.vector.localForm() as local:
            local.set(0.0)
        petsc.assemble_vector(self.vector, self.inner)
        force = self.vector.array[self.number]
        ends = self.state.vector.array[self.number]

        def pull(name: str) -> tuple[Any, Any]:
            on = self._on(name)
            return on, force[on]

        near = 1e-6 * self.high.max()
        return Ended(self.points, ends, pull, self._stress, near).probes(self.deck)

    def _stress(self, node: int, component: str) -> float:
        """Cauchy stress at a node: mean over the adjacent elements."""
        unit = np.eye(3)
        ends = (0, 0) if component == "rr" else tuple(AXES.index(c) for c in component)
        if component == "rr":
            unit[0, : self.dim] = self.points[node] / np.linalg.norm(self.points[node])
        left, right = (ufl.as_vector(list(unit[end])) for end in ends)
        wanted = ufl.dot(left, self.cauchy * right)
        corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * self.dim, indexing="ij"), -1)
        corners = corners.reshape(-1, self.dim)
        begin = time.process_time()
        expression = fem.Expression(wanted, corners)
        self.apart += time.process_time() - begin
        nodes = self.mesh.geometry.x[:, : self.dim]
        values = []
        for cell in range(self.mesh.topology.index_map(self.dim).size_local):
            # corners of an element in the order of `corners`
            near = nodes[self.mesh.geometry.dofmap.links(cell)][_CORNERS[self.dim]]
            for corner in np.flatnonzero(
                np.linalg.norm(near - self.places[node], axis=1) < 1e-6 * self.high.max()
            ):
                values.append(expression.eval(np.array([cell], np.int32)).ravel()[corner])
        return float(np.mean(values))


def _peak() -> int:
    """Peak memory of this process [byte]; `getrusage` includes that of the forking process."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def _record(
    job: Mapping[str, Any], elements: Sequence[int], steps: Sequence[int]
) -> dict[str, Any]:
    """One mesh: the fewest load steps that converge; only their time counts."""
    begin = time.process_time()
    body = _Solve(job, elements)
    setup = time.process_time() - begin - body.apart
    for count in steps:
        body.apart, begin = 0.0, time.process_time()
        try:
            iterations = body.solve(count)
        except (_Diverged, PETSc.Error):
            continue
        probes = body.probes()
        return {
            "elements": list(elements),
            "dofs": body.space.dofmap.index_map.size_global * body.space.dofmap.index_map_bs,
            "cpu_s": setup + time.process_time() - begin - body.apart,
            "iterations": iterations,
            "steps": count,
            "memory": _peak(),
            "probes": probes,
        }
    return {"elements": list(elements), "outcome": f"no convergence in {steps[-1]} load steps"}


def main() -> None:
    """Solve the meshes of a job, the first one twice to compile beforehand."""
    job = json.load(sys.stdin)
    steps = list(_STEPS)
    for number, elements in enumerate([job["elements"][0], *job["elements"]]):
        record = _record(job, elements, steps)
        steps = [n for n in _STEPS if n >= record.get("steps", 1)]
        if number:
            print(json.dumps(record), flush=True)


if __name__ == "__main__":
    main()
