"""Reduced models in the compiled core: arrays of a model, and its states."""

from typing import Any, NamedTuple

import numpy as np

from myork import _core
from myork.types import F64, I32, I64

#: Reordering of gradient and stress components between row-major and column-major
_COLUMNS = np.arange(9).reshape(3, 3).T.ravel()


class Cells(NamedTuple):
    """Cells of a reduced model, all of them or a sample; arrays in the layout of the core."""

    h: F64  #: Displacement gradients of the amplitudes, shape `(9, nc, s)`
    #: Volume times weight, local bulk modulus of the cell
    weight: F64
    local_bulk: F64
    a: F64  #: Coefficients of the polynomial, shape `(9, nc)`
    #: Number of fibers before each cell, and the tissue of each, from 1
    first: I32
    tissue: I32
    #: Fraction and direction of the fibers, shapes `(ne,)`, `(3, ne)`
    fraction: F64
    fiber: F64
    #: Derivatives of `a` and `local_bulk` by material parameters, shapes `(9, nc, nm)`,
    #: `(nc, nm)`
    a_slope: F64
    bulk_slope: F64

    def sample(self, kept: I64, factor: F64) -> "Cells":
        """Some of the cells, with their weights multiplied by factors."""
        counts = np.diff(self.first)[kept]
        entries = np.concatenate(
            [np.arange(self.first[q], self.first[q + 1]) for q in kept] or [np.zeros(0, int)]
        )
        if len(entries) == 0:
            entries = np.zeros(1, int)
        return Cells(
            np.asfortranarray(self.h[:, kept]),
            self.weight[kept] * factor,
            self.local_bulk[kept],
            np.asfortranarray(self.a[:, kept]),
            np.concatenate([[0], np.cumsum(counts)]).astype(np.int32),
            self.tissue[entries],
            self.fraction[entries],
            np.asfortranarray(self.fiber[:, entries]),
            np.asfortranarray(self.a_slope[:, kept]),
            np.asfortranarray(self.bulk_slope[kept]),
        )

    def modes(self, kept: I64) -> "Cells":
        """The same cells restricted to some of the amplitudes."""
        return self._replace(h=np.asfortranarray(self.h[:, :, kept]))


class Model(NamedTuple):
    """Data of a reduced model that the core needs."""

    r: int  #: Number of modes; the other amplitudes are prescribed
    cells: Cells  #: Cells that are evaluated
    constant: F64  #: Penalty and stabilisation, shape `(s, s)`
    constant_slope: F64  #: Its derivatives with respect to material parameters, shape `(s, s, nm)`
    #: Volume changes as cubic forms, shape `(s + 1, s + 1, s + 1, kept)`; only entries with
    #: ascending indices are used
    volume: F64
    #: Derivatives of the energy factor of each volume change, shape `(kept, nm)`, equal within each
    #: block of eight
    volume_slope: F64
    fibers: F64  #: As in `Laws`, shape `(7, nt)`


class Record(NamedTuple):
    """A model in the layout of the core, packed once: sizes and indices, then all other numbers."""

    whole: I32
    number: F64


def record(model: Model, cells: Cells) -> Record:
    """Pack a model with its own cells or others; its volume may already come from `triples`.

    Gradients are stored with the amplitudes first and their components column by column.
    """
    s, nc = cells.h.shape[2], cells.h.shape[1]
    volume = triples(model.volume) if model.volume.ndim == 4 else model.volume
    slope = model.volume_slope
    # energy factors per block of eight volume changes
    pieces = slope[::8] if len(slope) else np.zeros((1, slope.shape[1]))
    sizes = [model.r, s, nc, len(cells.tissue), volume.shape[2], volume.shape[1]]
    sizes += [model.fibers.shape[1], slope.shape[1]]
    h = np.moveaxis(cells.h[_COLUMNS], 2, 0)
    before = (h, *cells[1:4], *cells[6:], model.constant, model.constant_slope)
    flat = [np.ravel(a, order="F") for a in (*before, volume, pieces, model.fibers)]
    # align the volume with a cache line: most of the time of a state is spent on it
    count = sum(len(a) for a in flat)
    room = np.empty(count + 7)
    first = -(room.ctypes.data // 8 + sum(a.size for a in before)) % 8
    return Record(
        np.concatenate([sizes, cells.first, cells.tissue]).astype(np.int32),
        np.concatenate(flat, out=room[first : first + count]),
    )


def assemble(model: Model, wish: F64, z: F64) -> tuple[F64, F64, F64, float]:
    """Residual and tangent by all amplitudes, weighted stresses `(nc, 9)`, and smallest J.

    `wish` is one column of that of `online_states`; `z` contains its prescribed amplitudes.
    """
    residual, tangent, stress, min_j = _core.online_assemble(
        *record(model, model.cells), wish[:, 0], model.cells.h.shape[1], z
    )
    return residual, tangent, stress[_COLUMNS].T, float(min_j)


def cell_stresses(cells: Cells, fibers: F64, wish: F64, gradient: F64) -> F64:
    """Weighted stresses of states, shape `(n, nc, 9)`, from displacement gradients of that shape.

    The gradients in `cells` are ignored; `fibers` are those of a `Model`.
    """
    nc, moduli = gradient.shape[1], cells.bulk_slope.shape[1]
    # a single amplitude, equal to one, that gives the gradients, and no volume terms
    one = cells._replace(h=np.zeros((9, nc, 1)))
    none = np.zeros((1, 1, moduli))
    packed = record(
        Model(1, one, np.zeros((1, 1)), none, np.zeros((2, 2, 2, 1)), none[0], fibers), one
    )
    place = packed.number[: 9 * nc].reshape((9, nc), order="F")
    found = np.empty(gradient.shape)
    for i, h in enumerate(gradient):
        place[:] = h.T[_COLUMNS]
        found[i] = _core.online_assemble(*packed, wish[:, i], nc, np.ones(1))[2][_COLUMNS].T
    return found


def online_states(
    model: Record,
    whole: Record,
    wish: F64,
    start: F64,
    parts: I32,
    known: F64,
    limits: tuple[float, float],
    most: int,
    threads: int,
    wanted: I32,
    lift: F64,
) -> tuple[Any, ...]:
    """States by Newton's method, each with the forces on the `wanted` amplitudes, numbered from 1.

    `whole` has the cells from which forces are computed. `wish` is the request, one column per
    state: activation, maximal isometric stress and fiber angle [rad] of each tissue, parameters of
    materials less their values in the model, prescribed amplitudes; `known` are the requests of the
    states from which the iteration starts. `limits` are the size of the modal amplitudes below
    which they count as zero, and the tolerance; `lift` gives their dependence on the wanted
    amplitudes, shape `(r, nf, n)`. A single 0 in `wanted` asks for no force.

    Returns amplitudes `(s, n)`, iterations (negative where a state failed), relative size of the
    last step, smallest J, forces `(nf, n)`.
    """
    return tuple(
        _core.online_states(
            *model, *whole, wish, known, start, parts, limits, most, threads,
            wanted, lift,
        )
    )  # fmt: skip


def triples(volume: F64) -> F64:
    """Entries of the cubic form in the layout of the core, shape `(8, triples, pieces)`."""
    n, m, k = np.array(
        [(n, m, k) for n in range(len(volume)) for m in range(n + 1) for k in range(m + 1)]
    ).T
    kept = volume.shape[3]
    wide = np.zeros((len(n), 8 * max(1, -(-kept // 8))))
    wide[:, :kept] = volume[k, m, n]
    return np.asfortranarray(np.moveaxis(wide.reshape(len(n), -1, 8), (0, 1, 2), (1, 2, 0)))
