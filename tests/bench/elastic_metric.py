"""Least squares of the balances of finer cells in the metric of elasticity, on contracting muscle.

    python tests/bench/elastic_metric.py [POINTS ORDER [KEY=VALUE...]]

Displacements and pressures are those of a coarse lattice of the block whose fibers are inclined
(points an edge, 5 without arguments; twice as many spacings along z); cells are those of the
lattice twice as fine. The squares are those of the balances of momentum in the norm of the inverse
of a stiffness of trilinear elements on the fine lattice (`metric=plain`: of the identity), of the
volumes of the cells less p/K, with weight `volume`, and of the displacement at points of the held
faces. Printed are errors against finite elements [%] (u_x, u_z, s_zz, s_xz, R_x, R_z, as
tests/verification/test_subdomain.py has them), iterations of Gauss and Newton, those of conjugate
gradients in the last of them with the coarse functions' stiffness as preconditioner, the condition,
J, unknowns and seconds of CPU. A study of a form that is not built: docs/decisions.md.
"""

from __future__ import annotations

import sys
import time
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from myork.core import material as core_material
from myork.core.shape import shape_functions
from myork.reference.materials import MUSCLE

SIZE = np.array([1.0, 1.0, 2.0])
FIBER = (0.5, 0.0, 0.75**0.5)
ACTIVATION = 0.15
#: Shear modulus of the muscle at rest; the held displacement's weight; supports as decks have them
MU, HELD, SUPPORT = 5.26, 100.0, {1: 2.5, 2: 2.6, 3: 4.0, 4: 5.5}
#: Finite elements: values, and what they change to their limit [%]
TRUTH = np.array([-0.0386972, -0.1339486, 2.590138, 1.374366, -1.013246, -2.646201])
LIMIT = TRUTH * (1 + np.array([0.37, 0.38, 0.50, -0.88, -1.70, 0.24]) / 100)
GAUSS = np.array([-1.0, 1.0]) / np.sqrt(3.0)
CORNERS = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), -1).reshape(-1, 3)
INSIDE = np.stack(np.meshgrid(*[GAUSS] * 3, indexing="ij"), -1).reshape(-1, 3)


def counted(count: Any) -> Any:
    """Places of a lattice in integers, shape (n, 3)."""
    return np.stack(np.meshgrid(*[np.arange(n) for n in count], indexing="ij"), -1).reshape(-1, 3)


class Lattice:
    """Points of the block with their cells."""

    def __init__(self, count: Any) -> None:
        self.count = np.array(count)
        self.step = SIZE / (self.count - 1)
        self.index = counted(count)
        self.points = self.index * self.step
        self.low = np.maximum(self.points - self.step / 2, 0)
        self.high = np.minimum(self.points + self.step / 2, SIZE)

    def number(self, index: Any) -> Any:
        """Numbers of points."""
        return (index[..., 0] * self.count[1] + index[..., 1]) * self.count[2] + index[..., 2]

    def functions(self, order: int, places: Any, n: int) -> list[Any]:
        """Values of the functions of the points at places, and derivatives, n in all."""
        found = shape_functions(self.points, SUPPORT[order] * self.step, places, order=order)
        shape = (len(places), len(self.points))
        return [
            sparse.csr_matrix((found.value[:, k], found.neighbour, found.offset), shape=shape)
            for k in range(n)
        ]

    def facets(self) -> tuple[Any, Any, Any]:
        """Points of the inner facets, their areas, and the sum over the facets of each cell."""
        points, areas, sides = [], [], []
        for d in range(3):
            own = np.flatnonzero(self.index[:, d] < self.count[d] - 1)
            low, high = self.low[own].copy(), self.high[own]
            low[:, d] = high[:, d]
            across = [k for k in range(3) if k != d]
            for gauss in np.stack(np.meshgrid(GAUSS, GAUSS), -1).reshape(-1, 2):
                local = np.zeros(3)
                local[across] = gauss
                points.append((low + high) / 2 + local * (high - low) / 2)
                area = np.zeros(low.shape)
                area[:, d] = np.prod((high - low)[:, across], axis=1) / 4
                areas.append(area)
                sides.append(
                    np.stack([own, self.number(self.index[own] + np.eye(3, dtype=int)[d])])
                )
        side = np.concatenate(sides, axis=1)
        n = side.shape[1]
        signs = np.concatenate([np.ones(n), -np.ones(n)])
        total = sparse.csr_matrix(
            (signs, (side.ravel(), np.tile(np.arange(n), 2))), shape=(len(self.points), n)
        )
        return np.concatenate(points), np.concatenate(areas), total

    def gauss_points(self) -> tuple[Any, Any]:
        """Eight Gauss points of each cell, and the integral over each cell."""
        span = self.high - self.low
        places = (self.low + self.high) / 2 + INSIDE[:, None] * span / 2
        n = len(self.points)
        weight = np.tile(np.prod(span, axis=1) / 8, 8)
        integral = sparse.csr_matrix(
            (weight, (np.tile(np.arange(n), 8), np.arange(8 * n))), shape=(n, 8 * n)
        )
        return places.reshape(-1, 3), integral

    def stiffness(self) -> Any:
        """Trilinear elements, both of Lame's constants the shear modulus."""
        one = np.eye(3)
        law = MU * sum(np.einsum(f"{k},{m}->iajb", one, one) for k, m in PAIRS)
        element = np.zeros((24, 24))
        sign = 2 * CORNERS - 1
        for gauss in INSIDE:
            at = 1 + sign * gauss
            others = np.stack([at[:, 1] * at[:, 2], at[:, 0] * at[:, 2], at[:, 0] * at[:, 1]], 1)
            slope = sign * others / 4 / self.step
            element += np.einsum("Ia,iajb,Jb->IiJj", slope, law, slope).reshape(24, 24)
        element *= np.prod(self.step) / 8
        nodes = self.number(counted(self.count - 1)[:, None] + CORNERS)
        dof = (3 * nodes[:, :, None] + np.arange(3)).reshape(len(nodes), 24)
        entries = np.tile(element.ravel(), len(dof))
        return sparse.csc_matrix(
            (entries, (np.repeat(dof, 24, 1).ravel(), np.tile(dof, 24).ravel()))
        )


PAIRS = (("ia", "jb"), ("ij", "ab"), ("ib", "aj"))


def cofactor(f: Any) -> Any:
    """Cofactors of deformation gradients."""
    return np.linalg.det(f)[:, None, None] * np.swapaxes(np.linalg.inv(f), 1, 2)


class Squares:
    """Residuals of the block and their derivatives."""

    def __init__(self, points: int, order: int, metric: str, volume: float, spacing: int) -> None:
        count = np.array([points, points, 2 * points - 1])
        self.law = core_material.Material.of_table({**MUSCLE, "curve": "published"})
        self.bulk = MUSCLE["K"]
        coarse, fine = Lattice(count), Lattice(2 * count - 1)
        self.coarse, self.order = coarse, order
        self.pressures = Lattice((count - 1) // spacing + 1)
        places, self.area, self.total = fine.facets()
        self.slope = coarse.functions(order, places, 4)[1:]
        (self.psi,) = self.pressures.functions(min(order - 1, 2), places, 1)
        inside, self.integral = fine.gauss_points()
        self.slope_inside = coarse.functions(order, inside, 4)[1:]
        (self.psi_inside,) = self.pressures.functions(min(order - 1, 2), inside, 1)
        height = fine.points[:, 2]
        self.walls = height < 1e-9, height > SIZE[2] - 1e-9
        wall = self.walls[0] | self.walls[1]
        self.free = ~wall
        self.ns = len(coarse.points)
        (there,) = coarse.functions(order, fine.points, 1)
        spacing_of = float(np.prod(fine.step) ** (1 / 3))
        stiffness = fine.stiffness()
        unit = np.sqrt(HELD * MU * spacing_of)
        self.held = unit * sparse.kron(there[wall], sparse.eye(3)).toarray()
        own = np.repeat(self.free, 3)
        inverse = splu(stiffness[own][:, own].tocsc())
        self.inverse = (
            inverse.solve if metric == "elastic" else lambda rows: rows / (MU * spacing_of)
        )
        self.weight = np.sqrt(volume * MU / np.asarray(self.integral.sum(1)).ravel())
        wide = sparse.kron(there, sparse.eye(3))
        weights = np.asarray(self.integral.sum(0)).ravel()
        mass = (self.psi_inside.T @ sparse.diags(weights) @ self.psi_inside).toarray()
        self.preconditioner = linalg.block_diag(
            (wide.T @ (stiffness @ wide)).toarray() + self.held.T @ self.held, mass / MU
        )

    def gradients(self, x: Any, slope: Any) -> Any:
        """Deformation gradients."""
        d = x[: 3 * self.ns].reshape(-1, 3)
        return np.eye(3) + np.stack([one @ d for one in slope], 2)

    def stress(self, f: Any, pressure: Any) -> Any:
        """First Piola-Kirchhoff stress."""
        own = core_material.stress(
            self.law, f, fiber=FIBER, activation=ACTIVATION, volumetric=False
        )
        return own + pressure[:, None, None] * cofactor(f)

    def residuals(self, x: Any) -> tuple[Any, Any, Any] | None:
        """Balances of all cells, changes of volume, held displacements; none where J <= 0."""
        f, inside = self.gradients(x, self.slope), self.gradients(x, self.slope_inside)
        j = np.linalg.det(inside)
        if min(np.linalg.det(f).min(), j.min()) <= 0:
            return None
        p = x[3 * self.ns :]
        flux = np.einsum("qia,qa->qi", self.stress(f, self.psi @ p), self.area)
        growth = self.integral @ (j - 1 - self.psi_inside @ p / self.bulk)
        return self.total @ flux, self.weight * growth, self.held @ x[: 3 * self.ns]

    def value(self, rows: tuple[Any, Any, Any]) -> float:
        """Sum of the squares."""
        free = rows[0][self.free].ravel()
        return float(free @ self.inverse(free) + rows[1] @ rows[1] + rows[2] @ rows[2])

    def derivatives(self, x: Any) -> tuple[Any, Any]:
        """Of the balances that count, and of the volumes."""
        f, inside = self.gradients(x, self.slope), self.gradients(x, self.slope_inside)
        none = np.zeros((len(f), 3, 3, 3))
        law = core_material.strong(
            self.law, f, none, fiber=FIBER, activation=ACTIVATION, volumetric=False
        )
        turn = np.cross(np.eye(3)[:, None], np.eye(3)[None])  # e_ijk
        tangent = law.tangent + np.einsum(
            "q,ijk,abc,qkc->qiajb", self.psi @ x[3 * self.ns :], turn, turn, f
        )
        tangent = np.einsum("qa,qiajb->qijb", self.area, tangent)
        push = np.einsum("qia,qa->qi", cofactor(f), self.area)
        rows = np.zeros((len(self.free), 3, self.ns, 3))
        for i, j in np.ndindex(3, 3):
            one = sum(sparse.diags(tangent[:, i, j, b]) @ self.slope[b] for b in range(3))
            rows[:, i, :, j] = (self.total @ one).toarray()
        columns = [(self.total @ sparse.diags(push[:, i]) @ self.psi).toarray() for i in range(3)]
        momentum = np.concatenate(
            [rows.reshape(*rows.shape[:2], -1), np.stack(columns, 1)], axis=2
        )[self.free]
        c = cofactor(inside)
        volume = np.zeros((len(self.free), self.ns, 3))
        for j in range(3):
            one = sum(sparse.diags(c[:, j, b]) @ self.slope_inside[b] for b in range(3))
            volume[:, :, j] = (self.integral @ one).toarray()
        part = -(self.integral @ self.psi_inside).toarray() / self.bulk
        volume = np.concatenate([volume.reshape(len(volume), -1), part], axis=1)
        return momentum.reshape(-1, momentum.shape[2]), self.weight[:, None] * volume

    def step(self, x: Any, rows: tuple[Any, Any, Any]) -> tuple[Any, Any]:
        """Step of Gauss and Newton, with its matrix."""
        momentum, volume = self.derivatives(x)
        turned = self.inverse(momentum)
        n = 3 * self.ns
        matrix = momentum.T @ turned + volume.T @ volume
        matrix[:n, :n] += self.held.T @ self.held
        slope = turned.T @ rows[0][self.free].ravel() + volume.T @ rows[1]
        slope[:n] += self.held.T @ rows[2]
        matrix = (matrix + matrix.T) / 2
        return -linalg.solve(matrix, slope, assume_a="sym"), matrix

    def probes(self, x: Any, rows: tuple[Any, Any, Any]) -> Any:
        """What `LIMIT` has."""
        places = np.array([[1.0, 0.5, 1.0], [0.5, 0.5, 1.0]])
        value, *slope = self.coarse.functions(self.order, places, 4)
        u = value @ x[: 3 * self.ns].reshape(-1, 3)
        f = self.gradients(x, slope)
        (psi,) = self.pressures.functions(min(self.order - 1, 2), places, 1)
        stress = self.stress(f, psi @ x[3 * self.ns :])
        cauchy = stress[1] @ f[1].T / np.linalg.det(f[1])
        force = -rows[0][self.walls[0]].sum(0)
        return np.array([u[0, 0], u[0, 2], cauchy[2, 2], cauchy[0, 2], force[0], force[2]])


def conjugate_gradients(matrix: Any, preconditioner: Any) -> tuple[int, float]:
    """Iterations to 1e-8 of the residual, and the condition, preconditioned."""
    lower = linalg.cholesky(preconditioner, lower=True)
    half = linalg.solve_triangular(lower, matrix, lower=True)
    inner = linalg.solve_triangular(lower, half.T, lower=True)
    values = linalg.eigvalsh((inner + inner.T) / 2)
    residual = inner @ np.ones(len(inner))
    first, direction, n = residual @ residual, residual.copy(), 0
    square = first
    while square > 1e-16 * first:
        product = inner @ direction
        residual -= square / (direction @ product) * product
        before, square = square, residual @ residual
        direction = residual + square / before * direction
        n += 1
    return n, values[-1] / values[0]


def run(
    points: int, order: int, metric: str = "elastic", volume: float = 1.0, spacing: int = 1
) -> str:
    """Solve the block; a line of the table."""
    before = time.process_time()
    squares = Squares(points, order, metric, volume, spacing)
    x = np.zeros(len(squares.preconditioner))
    rows = squares.residuals(x)
    assert rows is not None
    value, n = squares.value(rows), 0
    flat = False
    while not flat:
        n += 1
        dx, matrix = squares.step(x, rows)
        share, flat = 1.0, True
        while flat and share > 1e-3:
            new = squares.residuals(x + share * dx)
            if new is not None and (found := squares.value(new)) < value:
                flat = found > (1 - 1e-8) * value
                x, rows, value = x + share * dx, new, found
                break
            share /= 2
    iterations, condition = conjugate_gradients(matrix, squares.preconditioner)
    error = 100 * (squares.probes(x, rows) / LIMIT - 1)
    j = np.linalg.det(squares.gradients(x, squares.slope))
    return (
        f"| {points}, {order}, {metric}, volume {volume:g}, pressures at every {spacing} | "
        f"{' '.join(f'{one:+.1f}' for one in error)} | {n} | {iterations}, {condition:.0f} | "
        f"{j.min():.2f}..{j.max():.2f} | {len(x)} | {time.process_time() - before:.0f} |"
    )


def main(words: list[str]) -> None:
    """Print what is asked for, or the table of docs/decisions.md."""
    if words:
        more = dict(word.split("=") for word in words[2:])
        given: dict[str, Any] = {"volume": float(more.pop("volume", 1.0))}
        given["spacing"] = int(more.pop("spacing", 1))
        print(run(int(words[0]), int(words[1]), **given, **more))
        return
    for points, order, changes in (
        (4, 2, {}),
        (5, 2, {}),
        (5, 2, {"metric": "plain"}),
        (5, 2, {"volume": 0.1}),
        (5, 2, {"volume": 10.0}),
        (5, 2, {"spacing": 2}),
        (5, 3, {}),
    ):
        print(run(points, order, **changes), flush=True)  # type: ignore[arg-type]


if __name__ == "__main__":
    main(sys.argv[1:])
