"""Reduced models in the compiled core: arrays of a model, and its states."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from myork import _core
from myork.types import F64, I32, I64

__all__ = [
    "Cells",
    "Model",
    "Wish",
    "assemble",
    "cell_stresses",
    "online_states",
    "padded",
    "triples",
]


class Cells(NamedTuple):
    """Cells of a reduced model, all of them or a sample; arrays as the core takes them.

    Attributes
    ----------
    h : F64
        Displacement gradients of the amplitudes, shape `(9, nc, s)`.
    weight, local_bulk : F64
        Volume times weight, bulk modulus of the cell itself.
    a : F64
        Coefficients of the polynomial, shape `(9, nc)`.
    first, tissue : I32
        Fibers before each cell, and the tissue of each, from 1.
    fraction, fiber : F64
        Their fraction and direction, shapes `(ne,)`, `(3, ne)`.
    a_slope, bulk_slope : F64
        Derivatives of `a` and `local_bulk` by parameters of materials, shapes `(9, nc, nm)`,
        `(nc, nm)`.
    """

    h: F64
    weight: F64
    local_bulk: F64
    a: F64
    first: I32
    tissue: I32
    fraction: F64
    fiber: F64
    a_slope: F64
    bulk_slope: F64

    def sample(self, kept: I64, factor: F64) -> Cells:
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

    def modes(self, kept: I64) -> Cells:
        """The same cells with some of the amplitudes."""
        return self._replace(h=np.asfortranarray(self.h[:, :, kept]))


class Model(NamedTuple):
    """What the core needs of a reduced model.

    Attributes
    ----------
    r : int
        Number of modes; the other amplitudes are prescribed.
    cells : Cells
        Cells that are evaluated.
    constant : F64
        Penalty and stabilisation, shape `(s, s)`.
    constant_slope : F64
        Its derivatives by parameters of materials, shape `(s, s, nm)`.
    volume : F64
        Changes of volume as a cubic form, shape `(s + 1, s + 1, s + 1, kept)`; entries whose
        indices rise count.
    volume_slope : F64
        Derivatives of the factor on the energy of each change, shape `(kept, nm)`, those of eight
        in a row equal.
    fibers : F64
        As in `Laws`, shape `(7, nt)`.
    """

    r: int
    cells: Cells
    constant: F64
    constant_slope: F64
    volume: F64
    volume_slope: F64
    fibers: F64


class Wish(NamedTuple):
    """What states are asked for, by columns.

    Attributes
    ----------
    state : F64
        Activation, largest isometric stress and angle of the fibers [rad] of each tissue, shape
        `(nt, 3, n)`.
    modulus : F64
        Parameters of materials less their values in the model, shape `(nm, n)`.
    given : F64
        Prescribed amplitudes, shape `(s - r, n)`.
    """

    state: F64
    modulus: F64
    given: F64


def assemble(model: Model, wish: Wish, z: F64) -> tuple[F64, F64, F64, float]:
    """Residual and tangent by all amplitudes, stresses times weights `(nc, 9)`, and smallest J.

    `wish` holds one state; its prescribed amplitudes are those of `z`.
    """
    residual, tangent, stress, min_j = _core.online_assemble(
        model.r, *padded(model.cells), model.constant, model.constant_slope, triples(model.volume),
        _of_pieces(model.volume_slope), model.fibers, wish.state[:, :, 0], wish.modulus[:, 0], z,
    )  # fmt: skip
    return residual, tangent, stress.T, float(min_j)


def cell_stresses(cells: Cells, fibers: F64, wish: Wish, gradient: F64) -> F64:
    """Stresses times weights of states, shape `(n, nc, 9)`, of displacement gradients like that.

    The gradients of `cells` are not looked at; `fibers` are those of a `Model`.
    """
    moduli = len(wish.modulus)
    none = np.zeros((1, 1, moduli), order="F")
    # one amplitude, of size one, that makes the gradients, and no volume
    one = padded(cells._replace(h=np.zeros((9, gradient.shape[1], 1))))
    volume = triples(np.zeros((2, 2, 2, 1)))
    found = np.empty(gradient.shape)
    for i, h in enumerate(gradient):
        one.h[0] = h.T
        found[i] = _core.online_assemble(
            1, *one, none[..., 0], none, volume, none[0], fibers, wish.state[:, :, i],
            wish.modulus[:, i], np.ones(1),
        )[2].T  # fmt: skip
    return found


def online_states(
    model: Model,
    cells: Cells,
    volume: F64,
    whole: Cells,
    wish: Wish,
    start: F64,
    parts: I32,
    known: Wish,
    least: float,
    tolerance: float,
    most: int,
    threads: int,
    wanted: I32,
    lift: F64,
) -> tuple[Any, ...]:
    """States by Newton's iteration, each with the forces on the amplitudes wanted, from 1.

    Cells and volume are those of `padded` and `triples`; `wish` is what is asked for, `known` what
    states at which the way begins were asked for. Amplitudes of the modes below `least` are none;
    `lift` tells how they follow the amplitudes wanted, shape `(r, nf, n)`.

    Returns
    -------
    tuple
        Amplitudes `(s, n)`, iterations, negative where a state failed, relative size of the last
        step, smallest J, forces `(nf, n)`.
    """
    return tuple(
        _core.online_states(
            model.r, *cells, model.constant, model.constant_slope, volume,
            _of_pieces(model.volume_slope), model.fibers, *whole, *wish, start, parts, *known,
            least, tolerance, most, threads, wanted, lift,
        )
    )  # fmt: skip


def padded(cells: Cells) -> Cells:
    """Cells as the core takes them: amplitudes first, with zeros up to a multiple of eight."""
    s = cells.h.shape[2]
    wide = np.zeros((8 * (-(-s // 8)), 9, cells.h.shape[1]), order="F")
    wide[:s] = np.moveaxis(cells.h, 2, 0)
    return cells._replace(h=wide)


def triples(volume: F64) -> F64:
    """Entries of the cubic form as the core takes them, shape `(8, triples, pieces)`."""
    n, m, k = np.array(
        [(n, m, k) for n in range(len(volume)) for m in range(n + 1) for k in range(m + 1)]
    ).T
    kept = volume.shape[3]
    wide = np.zeros((len(n), 8 * max(1, -(-kept // 8))))
    wide[:, :kept] = volume[k, m, n]
    return np.asfortranarray(np.moveaxis(wide.reshape(len(n), -1, 8), (0, 1, 2), (1, 2, 0)))


def _of_pieces(slope: F64) -> F64:
    """Factors of pieces of eight changes from those of each."""
    return np.asfortranarray(slope[::8] if len(slope) else np.zeros((1, slope.shape[1])))
