"""Reduced models in the compiled core: arrays of a model, and its states."""

from typing import Any, NamedTuple

import numpy as np

from myork import _core
from myork.types import F64, I32, I64

#: Components of gradients and stresses column by column, where they stand row by row, and back
_COLUMNS = np.arange(9).reshape(3, 3).T.ravel()


class Cells(NamedTuple):
    """Cells of a reduced model, all of them or a sample; arrays as the core takes them."""

    h: F64  #: Displacement gradients of the amplitudes, shape `(9, nc, s)`
    #: Volume times weight, bulk modulus of the cell itself
    weight: F64
    local_bulk: F64
    a: F64  #: Coefficients of the polynomial, shape `(9, nc)`
    #: Fibers before each cell, and the tissue of each, from 1
    first: I32
    tissue: I32
    #: Their fraction and direction, shapes `(ne,)`, `(3, ne)`
    fraction: F64
    fiber: F64
    #: Derivatives of `a` and `local_bulk` by parameters of materials, shapes `(9, nc, nm)`,
    #: `(nc, nm)`
    a_slope: F64
    bulk_slope: F64

    def sample(self, kept: I64, factor: F64) -> "Cells":
        """Some of the cells, their weights times factors."""
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
        """The same cells with some of the amplitudes."""
        return self._replace(h=np.asfortranarray(self.h[:, :, kept]))


class Model(NamedTuple):
    """What the core needs of a reduced model."""

    r: int  #: Number of modes; the other amplitudes are prescribed
    cells: Cells  #: Cells that are evaluated
    constant: F64  #: Penalty and stabilisation, shape `(s, s)`
    constant_slope: F64  #: Its derivatives by parameters of materials, shape `(s, s, nm)`
    #: Changes of volume as a cubic form, shape `(s + 1, s + 1, s + 1, kept)`; entries whose indices
    #: rise count
    volume: F64
    #: Derivatives of the factor on the energy of each change, shape `(kept, nm)`, those of eight in
    #: a row equal
    volume_slope: F64
    fibers: F64  #: As in `Laws`, shape `(7, nt)`


class Record(NamedTuple):
    """A model as the core takes it, packed once: sizes and indices, then all other numbers."""

    whole: I32
    number: F64


def record(model: Model, cells: Cells) -> Record:
    """Pack a model with its own cells or others; its volume may be that of `triples` already.

    Gradients have the amplitudes first and their components column by column.
    """
    s, nc = cells.h.shape[2], cells.h.shape[1]
    volume = triples(model.volume) if model.volume.ndim == 4 else model.volume
    slope = model.volume_slope
    # factors of pieces of eight changes from those of each
    pieces = slope[::8] if len(slope) else np.zeros((1, slope.shape[1]))
    sizes = [model.r, s, nc, len(cells.tissue), volume.shape[2], volume.shape[1]]
    sizes += [model.fibers.shape[1], slope.shape[1]]
    h = np.moveaxis(cells.h[_COLUMNS], 2, 0)
    before = (h, *cells[1:4], *cells[6:], model.constant, model.constant_slope)
    flat = [np.ravel(a, order="F") for a in (*before, volume, pieces, model.fibers)]
    # the volume begins a line of the processor's cache: most of a state's time is spent on it
    count = sum(len(a) for a in flat)
    room = np.empty(count + 7)
    first = -(room.ctypes.data // 8 + sum(a.size for a in before)) % 8
    return Record(
        np.concatenate([sizes, cells.first, cells.tissue]).astype(np.int32),
        np.concatenate(flat, out=room[first : first + count]),
    )


def assemble(model: Model, wish: F64, z: F64) -> tuple[F64, F64, F64, float]:
    """Residual and tangent by all amplitudes, stresses times weights `(nc, 9)`, and smallest J.

    `wish` is one column, as `online_states` has many; its prescribed amplitudes are those of `z`.
    """
    residual, tangent, stress, min_j = _core.online_assemble(
        *record(model, model.cells), wish[:, 0], model.cells.h.shape[1], z
    )
    return residual, tangent, stress[_COLUMNS].T, float(min_j)


def cell_stresses(cells: Cells, fibers: F64, wish: F64, gradient: F64) -> F64:
    """Stresses times weights of states, shape `(n, nc, 9)`, of displacement gradients like that.

    The gradients of `cells` are not looked at; `fibers` are those of a `Model`.
    """
    nc, moduli = gradient.shape[1], cells.bulk_slope.shape[1]
    # one amplitude, of size one, that makes the gradients, and no volume
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
    """States by Newton's iteration, each with the forces on the amplitudes wanted, from 1.

    `whole` has the cells by which forces are found. `wish` is what is asked for, a column a state:
    activation, largest isometric stress and angle of the fibers [rad] of each tissue, parameters of
    materials less their values in the model, prescribed amplitudes; `known` is what states at which
    the way begins were asked for. `limits` are the size of amplitudes of the modes
    below which they are none, and the tolerance; `lift` says how they follow the amplitudes
    wanted, shape `(r, nf, n)`. One 0 in `wanted` asks for no force.

    Returns amplitudes `(s, n)`, iterations, negative where a state failed, relative size of the
    last step, smallest J, forces `(nf, n)`.
    """
    return tuple(
        _core.online_states(
            *model, *whole, wish, known, start, parts, limits, most, threads,
            wanted, lift,
        )
    )  # fmt: skip


def triples(volume: F64) -> F64:
    """Entries of the cubic form as the core takes them, shape `(8, triples, pieces)`."""
    n, m, k = np.array(
        [(n, m, k) for n in range(len(volume)) for m in range(n + 1) for k in range(m + 1)]
    ).T
    kept = volume.shape[3]
    wide = np.zeros((len(n), 8 * max(1, -(-kept // 8))))
    wide[:, :kept] = volume[k, m, n]
    return np.asfortranarray(np.moveaxis(wide.reshape(len(n), -1, 8), (0, 1, 2), (1, 2, 0)))
