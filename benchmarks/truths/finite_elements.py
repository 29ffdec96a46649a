"""Decks of boxes and annuli solved by felupe: an independent discretisation and code.

felupe (https://pypi.org/project/felupe) is an optional dependency: `pip install myork[bench]`.
Displacements are quadratic in each direction, pressure and volume ratio linear and continuous
(the Taylor-Hood pair), except for a jump where two materials meet. The materials are MyoRK's own,
so that differences of laws or force curves are excluded.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from benchmarks.truths.conditions import AXES, Ended, fiber_of, moved, side_of
from myork.core.material import Material, strong
from myork.errors import ConvergenceError, InputError, InstallationError
from myork.types import F64, Mask

#: Label of the material at a place, shape `(dim,)`; zero outside the body
Labels = Callable[[F64], int]
#: Maps nodes of a box, shape `(n, dim)`, to those of the body
Warp = Callable[[F64], F64]

#: Halvings of a load step that does not converge, and relative residual of convergence [-]
_HALVINGS, _TOLERANCE = 8, 1e-8
#: Tolerance for nodes on the surface, relative to an edge
_ON_FACE = 1e-9
#: Exceptions of a load step that is too large
_FAILURES = (ValueError, RuntimeError, ArithmeticError, np.linalg.LinAlgError)


def solve_deck(
    deck: Mapping[str, Any],
    elements: Sequence[int],
    *,
    labels: Labels | None = None,
    warp: Warp | None = None,
    symmetric: bool = False,
) -> dict[str, Any]:
    """Solve a deck with finite elements.

    - `deck`: all tables of the deck, defaults included, as `myork.load_deck` gives them; a box or
      an annulus whose probes lie on corners of elements
    - `elements`: elements along each edge of a box, radial and angular of an annulus, shape
      `(dim,)`
    - `labels`: material at each place; by default the deck's first one everywhere. Elements must
      not contain several materials; those with label zero are left out.
    - `warp`: moves the nodes of a box to their positions in another shape; probes lie there
    - `symmetric`: order the unknowns for symmetric matrices, whose factors in space are several
      times smaller than those of felupe's own solver
    - returns `probes` (values at the full load by name), `dofs` and `cpu_s`
    - raises InputError: the deck has something that is not supported here
    - raises ConvergenceError: a load step failed even when halved
    - raises InstallationError: felupe is missing
    """
    started = time.process_time()
    body = _Body(deck, elements, labels, warp)
    if symmetric:
        body.solver = {"solver": _solve_symmetric}
    body.advance()
    return {
        "probes": {probe["name"]: body.probe(probe) for probe in deck["probe"]},
        "dofs": int(sum(part.values.size for part in body.field.fields)),
        "cpu_s": time.process_time() - started,
    }


def _solve_symmetric(matrix: Any, side: F64) -> F64:
    """Solve by a factorisation without pivoting, with one step of iterative refinement."""
    matrix = matrix.tocsc()
    options = {"SymmetricMode": True}
    factor = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)
    found = factor.solve(side)
    return np.asarray(found + factor.solve(side - matrix @ found))


def _felupe() -> Any:
    """The package, imported on first use."""
    try:
        import felupe
    except ImportError as error:
        raise InstallationError(
            f"the rival needs felupe: {error}; pip install 'myork[bench]'"
        ) from error
    return felupe


class _Body:
    """Mesh, fields, conditions and iterations of a deck."""

    def __init__(
        self,
        deck: Mapping[str, Any],
        elements: Sequence[int],
        labels: Labels | None,
        warp: Warp | None,
    ) -> None:
        self.fem = _felupe()
        self.solver: dict[str, Any] = {}
        self.geometry = deck["geometry"]
        self.dim = int(deck["scene"]["dimension"])
        mesh, material = self._mesh(elements, deck, labels)
        self.warp = warp
        if warp:
            mesh.points[:] = warp(mesh.points)
        self.mesh, self.points = mesh, mesh.points
        plane = self.dim == 2
        template = "RegionBiQuadraticQuad" if plane else "RegionTriQuadraticHexahedron"
        region = getattr(self.fem, template)(mesh)
        element = "BiQuadraticQuad" if plane else "TriQuadraticHexahedron"
        self.element = getattr(self.fem, element)()
        self.dual = self._dual(material)
        self.field = self.fem.FieldsMixed(region, n=3, planestrain=plane, mesh=self.dual)
        self.law = _Law(deck["material"], material, plane)
        #: Activation of each material at full load
        self.activations = [
            float(table.get("activation") or deck["load"]["activation"])
            for table in deck["material"]
        ]
        bulk = np.array([float(table["K"]) for table in deck["material"]])[material]
        bulk = np.broadcast_to(bulk, (region.quadrature.npoints, len(bulk)))
        material_law = self.fem.NearlyIncompressible(self.law, bulk)
        # laws that differ from element to element need all elements at once
        material_law.chunksize = self.law.chunksize = None
        self.solid = self.fem.SolidBody(material_law, self.field)
        self.items = [self.solid]
        self.bounds: dict[str, Any] = {}
        #: Conditions that change with the load, and their values at full load
        self.pulls: list[tuple[Any, Callable[[float], Any]]] = []
        for entry in deck["boundary"]:
            self._hold(entry)

    def _mesh(
        self, elements: Sequence[int], deck: Mapping[str, Any], labels: Labels | None
    ) -> tuple[Any, NDArray[np.intp]]:
        """Quadratic elements and the index of each one's material in the deck."""
        count = tuple(n + 1 for n in elements)
        kind = self.geometry["kind"]
        if kind == "annulus":
            inner, outer = self.geometry["inner_radius"], self.geometry["outer_radius"]
            mesh = self.fem.Rectangle(a=(inner, 0.0), b=(outer, 0.5 * np.pi), n=count)
        elif kind == "box":
            box = self.fem.Rectangle if self.dim == 2 else self.fem.Cube
            mesh = box(b=tuple(self.geometry["size"]), n=count)
        else:
            raise InputError(f"finite elements take boxes and annuli, not geometry {kind!r}")
        material = np.zeros(mesh.ncells, np.intp)
        if labels is not None:
            number = {int(table["label"]): k for k, table in enumerate(deck["material"])}
            label = [labels(corners.mean(axis=0)) for corners in mesh.points[mesh.cells]]
            kept = np.flatnonzero(label)
            material = np.array([number[label[cell]] for cell in kept], np.intp)
            used, cells = np.unique(mesh.cells[kept], return_inverse=True)
            cells = cells.reshape(-1, mesh.cells.shape[1])
            mesh = self.fem.Mesh(mesh.points[used], cells, mesh.cell_type)
        mesh = mesh.add_midpoints_edges().add_midpoints_faces()
        if self.dim == 3:
            mesh = mesh.add_midpoints_volumes()
        #: Lattice coordinates of the nodes: radius and angle for an annulus
        self.place = mesh.points.copy()
        if kind == "annulus":
            radius, angle = self.place.T
            mesh.points[:] = radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        return mesh, material

    def _dual(self, material: NDArray[np.intp]) -> Any:
        """Mesh of the pressures: corners of the elements, one for each material at them."""
        cells = self.mesh.cells[:, : 2**self.dim]
        keys = cells * (material.max() + 1) + material[:, None]
        found, number = np.unique(keys, return_inverse=True)
        points = self.points[found // (material.max() + 1)]
        return self.fem.Mesh(points, number.reshape(cells.shape), self.mesh.cell_type)

    def on(self, name: str) -> Mask:
        """Nodes of a set of the deck."""
        low, high = self.place.min(axis=0), self.place.max(axis=0)
        axis, side = side_of(name, self.geometry["kind"] == "annulus")
        wall = (low, high)[side][axis]
        return np.asarray(abs(self.place[:, axis] - wall) < _ON_FACE * (high - low)[axis])

    def _hold(self, entry: Mapping[str, Any]) -> None:
        """Prescribed displacements and tractions of a set."""
        mask = self.on(entry["set"])
        held = partial(moved, entry, self.points[mask])
        for axis in (given := held()):
            skip = tuple(int(other != axis) for other in range(self.dim))
            bound = self.fem.Boundary(self.field[0], mask=mask, skip=skip)
            self.bounds[f"{entry['set']} {AXES[axis]}"] = bound
            self.pulls.append((bound, partial(_component, held, axis)))
        if entry.get("traction") is not None:
            force = self._areas(entry["set"], mask)[:, None] * np.asarray(entry["traction"], float)
            for axis in given:
                force[:, axis] = 0.0
            load = self.fem.PointLoad(self.field, np.flatnonzero(mask), values=force)
            self.items.append(load)
            self.pulls.append((load, lambda load: load * force))

    def _areas(self, name: str, mask: Mask) -> F64:
        """Area of each node of a box's face, warped or not: its weight in integrals over it."""
        if self.geometry["kind"] != "box":
            raise InputError("finite elements take tractions on boxes only")
        across = [axis for axis in range(self.dim) if axis != AXES.index(name[0])]
        area = np.ones(int(mask.sum()))
        for axis in across:
            lines, number = np.unique(np.round(self.place[mask, axis], 12), return_inverse=True)
            # Simpson's rule in each element
            weight = np.zeros(len(lines))
            for k in range(0, len(lines) - 2, 2):
                step = (lines[k + 2] - lines[k]) / 6.0
                weight[k : k + 3] += np.array([1.0, 4.0, 1.0]) * step
            area *= weight[number]
        if self.warp:
            place, small = self.place[mask], 1e-6 * np.ptp(self.place)
            edges = []
            for axis in across:
                move = small * np.eye(self.dim)[axis]
                edges.append((self.warp(place + move) - self.warp(place - move)) / (2.0 * small))
            normal = np.cross(*edges) if self.dim == 3 else edges[0]
            area *= np.linalg.norm(normal, axis=1)
        return area

    def advance(self) -> None:
        """Iterate to the full load; a failed step is halved."""
        step, reached = 1.0, 0.0
        while reached < 1.0 - 1e-12:
            at = min(1.0, reached + step)
            kept = [part.values.copy() for part in self.field.fields]
            try:
                self._solve(at)
                reached = at
            except _FAILURES:
                for part, values in zip(self.field.fields, kept, strict=True):
                    part.values[:] = values
                step *= 0.5
                if step < 0.5**_HALVINGS:
                    raise ConvergenceError(
                        f"finite elements: no convergence beyond load {reached:.4g}"
                    ) from None

    def _solve(self, load: float) -> None:
        """Iterate to equilibrium at a given load."""
        for bound, value in self.pulls:
            if isinstance(bound, self.fem.PointLoad):
                bound.update(value(load))
            else:
                bound.value = value(load)
        self.law.activations = [load * full for full in self.activations]
        dof0, dof1 = self.fem.dof.partition(self.field, self.bounds)
        prescribed = self.fem.dof.apply(self.field, self.bounds, dof0)
        with np.errstate(all="ignore"):
            self.fem.newtonraphson(
                items=self.items,
                dof0=dof0,
                dof1=dof1,
                ext0=prescribed,
                verbose=0,
                tol=_TOLERANCE,
                **self.solver,
            )

    def _pull(self, name: str) -> tuple[Mask, F64]:
        """Nodes of a set, and the nodal forces that balance the stress."""
        vector = self.solid.assemble.vector(self.field).toarray().ravel()
        on = self.on(name)
        return on, vector[: self.points.size].reshape(self.points.shape)[on]

    def probe(self, probe: Mapping[str, Any]) -> float:
        """Value of a probe of the deck."""
        near = 1e-6 * float(np.ptp(self.points))
        ended = Ended(self.points, self.field[0].values, self._pull, self._component, near)
        value = ended.probe(probe)
        if value is None:
            raise InputError(
                f"finite elements: no node at probe {probe['name']!r}, or no {probe['quantity']!r}"
            )
        return value

    def _component(self, node: int, component: str) -> float:
        """Cauchy stress at a corner, by the names of its axes or `rr`."""
        stress = self._stress(node)
        if component == "rr":
            unit = np.zeros(3)
            unit[: self.dim] = self.points[node] / np.linalg.norm(self.points[node])
            return float(unit @ stress @ unit)
        return float(stress[AXES.index(component[0]), AXES.index(component[1])])

    def _stress(self, node: int) -> F64:
        """Cauchy stress at a corner: mean over its elements.

        The gradients are extrapolated from the Gauss points of second order, where those of
        quadratic elements are most accurate.
        """
        u = self.field[0].values
        stress = []
        near = self._gauss_points()
        for cell in np.flatnonzero((self.mesh.cells == node).any(axis=1)):
            nodes = self.mesh.cells[cell]
            corner = int(np.argmax(nodes == node))
            weight = (1.0 + np.sqrt(3.0) * near * self.element.points[corner]) / 2.0
            f = np.eye(3)
            for place, share in zip(near / np.sqrt(3.0), weight.prod(axis=1), strict=True):
                slope = self.element.gradient(place)
                slope = slope @ np.linalg.inv(self.points[nodes].T @ slope)
                f[: self.dim, : self.dim] += share * (u[nodes].T @ slope)
            p = float(self.field[1].values[self.dual.cells[cell, corner], 0])
            nominal = self.law.at(f, int(cell))
            stress.append(nominal @ f.T / np.linalg.det(f) + p * np.eye(3))
        return np.asarray(np.mean(stress, axis=0))

    def _gauss_points(self) -> F64:
        """Signs of the coordinates of the Gauss points of second order."""
        signs = np.meshgrid(*[[-1.0, 1.0]] * self.dim, indexing="ij")
        return np.stack(signs, axis=-1).reshape(-1, self.dim)


def _component(held: Callable[[float], dict[int, Any]], axis: int, load: float) -> Any:
    """Prescribed value along an axis at a load."""
    return held(load)[axis]


class _Law:
    """Isochoric parts of the deck's materials in the form that felupe calls."""

    def __init__(
        self, tables: Sequence[Mapping[str, Any]], material: NDArray[np.intp], plane: bool
    ) -> None:
        self.materials = [Material.of_table(table) for table in tables]
        self.fibers = [fiber_of(table, plane) for table in tables]
        self.material = material
        self.activations = [0.0] * len(tables)
        #: Places evaluated at once: all, because labels identify elements by their place
        self.chunksize: int | None = None
        # felupe reads the shapes of the arguments and of the state variables from here
        self.x = [np.zeros((3, 3)), np.zeros(0)]

    def at(self, gradient: F64, cell: int) -> F64:
        """First Piola-Kirchhoff stress of one F[i, A] in an element."""
        return self._evaluate(gradient[:, :, None, None], [cell])[0][:, :, 0, 0]

    def gradient(self, x: list[Any]) -> list[Any]:
        """Stress and state variables of [F, state variables]."""
        return [self._evaluate(x[0])[0], x[-1]]

    def hessian(self, x: list[Any]) -> list[Any]:
        """Tangent of [F, state variables]."""
        return [self._evaluate(x[0])[1]]

    def _evaluate(
        self, gradient: F64, cells: Sequence[int] | slice = slice(None)
    ) -> tuple[F64, F64]:
        stress = np.empty_like(gradient)
        tangent = np.empty((3, 3, *gradient.shape))
        here = self.material[cells]
        for number in np.unique(here):
            own = gradient[..., here == number]
            f = np.moveaxis(own.reshape(3, 3, -1), -1, 0)
            found = strong(
                self.materials[number],
                f,
                np.zeros((len(f), 3, 3, 3)),
                fiber=self.fibers[number],
                activation=self.activations[number],
                volumetric=False,
            )
            stress[..., here == number] = np.moveaxis(found.stress, 0, -1).reshape(own.shape)
            tangent[..., here == number] = np.moveaxis(found.tangent, 0, -1).reshape(
                3, 3, *own.shape
            )
        return stress, tangent
