"""Parts of the compiled core, for tests and exact solutions."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from myork import _core
from myork.core.calls import called
from myork.core.deck import table_defaults


class ShapeFunctions(NamedTuple):
    """Shape functions at places in compressed sparse rows."""

    #: Row of place `i` is `offset[i]:offset[i + 1]`, shape `(nplace + 1,)`
    offset: NDArray[np.int64]
    neighbour: NDArray[np.int32]  #: Source points, shape `(nnz,)`
    #: Value, first derivatives, second derivatives in the order 11, 12, 13, 22, 23, 33, shape
    #: `(nnz, nq)` [1, 1/length, 1/length^2]
    value: NDArray[np.float64]
    stencils: int  #: Number of different stencils that were evaluated


def shape_functions(
    source: ArrayLike,
    support: ArrayLike,
    place: ArrayLike,
    *,
    order: int | None = None,
    kernel: str | None = None,
    window: str | None = None,
) -> ShapeFunctions:
    """Evaluate all shape functions and their derivatives at all places.

    - `source`: source points, shape `(nsource, ndim)` [length]
    - `support`: support sizes, broadcast to the shape of `source`, positive [length]
    - `place`: places, shape `(nplace, ndim)` [length]
    - `order`: order of the basis, 0 to 6; by default that of decks, like kernel and window
    - `kernel`, `window`: names in decks: `quintic` (5.6), `cubic`; `product`, `radial`
    - raises InputError: a place with a singular moment matrix; the message names it
    """
    source, place = np.ascontiguousarray(source, float), np.ascontiguousarray(place, float)
    support = np.broadcast_to(np.asarray(support, float), source.shape)
    default = table_defaults("approximation")
    args = (
        default["order"] if order is None else order,
        (kernel or default["kernel"]).encode(),
        (window or default["window"]).encode(),
    )
    points = (source.T, np.asfortranarray(support.T), place.T)
    ndim = source.shape[1]
    nq = 1 + ndim + ndim * (ndim + 1) // 2
    counts, *_ = called(_core.shape_values, *args, nq, 1, *points)
    offset = np.concatenate(([0], np.cumsum(counts, dtype=np.int64)))
    found = called(_core.shape_values, *args, nq, int(offset[-1]), *points)
    _, stencils, neighbour, value = found
    return ShapeFunctions(offset, neighbour, value.T, int(stencils))
