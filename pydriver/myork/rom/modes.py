"""Modes of the training states, and the reduced model with all cells built from them."""

from collections.abc import Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from myork.core.galerkin import modal_products
from myork.core.online import Model
from myork.core.scene import Scene
from myork.rom import projection
from myork.rom.basis import proper_orthogonal_modes
from myork.rom.full import FullState
from myork.rom.online import Answer, Regression, Solver
from myork.rom.parameters import Parameter, spread_points, widths_of
from myork.rom.sampling import force_lifts
from myork.rom.setting import Setting, Snapshots
from myork.types import F64

#: Largest number of modes; beyond it the volume and not the cells determines the time. Large bodies
#: need more: with 30 the calf's force was off by 1.7e-3 even with all cells, with 34 by 8e-4
MOST_MODES, MOST_OF_LARGE = 30, 34
#: Integration points from which on a body is large
LARGE = 2000
#: Additional modes of the error estimate
MORE_MODES = 12
#: Directions of volume in addition to the number of modes
MORE_VOLUME = 8
#: Part of the tolerance allowed for the projection error of the states: the error of the model is
#: several times larger, above all where the material is about to lose ellipticity
_SHARE = 0.1
#: Errors of states are relative to their size, or to this share of the largest if it is smaller
_LEAST = 0.2
#: Weight of the force fields among the snapshots
_LIFT_WEIGHT = 0.01
#: Weight of states beyond the range: with 1 they are better represented, those of the range worse
_BEYOND_WEIGHT = 0.7
#: Relative difference of parameter values, in their ranges, below which they are equal
_SAME = 1e-9
#: Range in which modes are to be valid: this times the largest sigma_max of the range
REACH = 1.75
#: States that fill the region beyond, and largest number of those with the largest active stress
_SPREAD, _MOST_FACE = 16, 9
#: Values of each load there, and largest number of loads whose values are all combined
_ENDS, _MOST_COMBINED = 5, 4
#: Modes of the model that finds them; fewer for large bodies, since its volume costs their cube
_MODES, _MODES_OF_LARGE = 80, 60


class Basis(NamedTuple):
    """Modes with the amplitudes of the snapshots."""

    modes: F64
    amplitudes: F64
    r: int
    lost: float


class Draft(NamedTuple):
    """The reduced model of the states so far, with all cells."""

    basis: Basis  #: Modes; the first `r` are those of the model
    #: Models with `r` modes and with all of them
    model: Model
    finer: Model
    known: Snapshots  #: States within the range
    amplitudes: F64  #: Their amplitudes, shape `(n, modes)`

    def solve(self, setting: Setting, values: F64) -> Answer:
        """States at values of the parameters."""
        from scipy.spatial import cKDTree

        scale = widths_of(setting.parameters)
        r = self.basis.r
        start = Regression(self.known.values, self.amplitudes, scale)(values)[:, :r]
        solver = Solver(self.model, self.model.cells, np.zeros(0, np.int64), setting.threads)
        nearest = cKDTree(self.known.values / scale).query(values / scale)[1]
        return solver.solve(
            setting.conditions(values), start, setting.conditions(self.known.values),
            self.amplitudes[:, :r], nearest,
        )  # fmt: skip

    def forces(self, setting: Setting, values: F64, answer: Answer) -> F64:
        """Stationary forces of states, without tractions, shape `(n, nf)`."""
        conditions = setting.conditions(values)
        r, count = self.basis.r, len(setting.wanted)
        lift = force_lifts(self.model, setting, values, answer.amplitudes)
        solver = Solver(self.model, self.model.cells, setting.wanted + r, setting.threads)
        return solver.newton(
            conditions, answer.amplitudes, tolerance=np.inf, most=1, lift=lift.reshape(-1, r, count)
        )[0].force

    def estimate(self, setting: Setting, values: F64, answer: Answer) -> F64:
        """Size of a Newton step in all modes."""
        begin = np.zeros((len(values), self.finer.r))
        begin[:, : self.basis.r] = answer.amplitudes
        better = Solver(self.finer, self.finer.cells, np.zeros(0, np.int64), setting.threads)
        found = better.newton(setting.conditions(values), begin, tolerance=np.inf, most=1)[0]
        return np.asarray(np.linalg.norm(found.amplitudes - begin, axis=1))


def make_draft(
    scene: Scene,
    setting: Setting,
    snapshots: Snapshots,
    lifts: F64,
    tolerance: float,
    *,
    beyond: F64 | None = None,
    most: int | None = None,
    more: int = MORE_MODES,
) -> Draft:
    """The reduced model of snapshots and force fields, with all cells.

    - `scene`, `setting`, `snapshots`, `tolerance`: its input, and the desired error
    - `lifts`: force fields, shape `(n, dofs)`
    - `beyond`: states outside the range, which only enter the modes, shape `(n, dofs)`
    - `most`: largest number of modes
    - `more`: additional modes for the error estimate
    """
    if most is None:
        most = MOST_OF_LARGE if len(setting.parts.weight) > LARGE else MOST_MODES
    if beyond is None:
        beyond = np.zeros((0, scene.dofs))
    basis = _basis(scene, snapshots, lifts, beyond, tolerance, most, more)
    model, finer = _with_all_cells(scene, setting, snapshots, basis)
    known, amplitudes = _training(setting, snapshots, basis)
    return Draft(basis, model, finer, known, amplitudes)


def joined(
    before: Snapshots | None, kinds: Sequence[Parameter], state: FullState, row: F64
) -> Snapshots:
    """Snapshots with those of one more solve; states that are already there are dropped."""
    values = np.tile(row, (len(state.load), 1))
    for j, parameter in enumerate(kinds):
        if parameter.grows:
            values[:, j] *= state.load
    new = Snapshots(values, state.load, state.x, state.probes)
    if before is None:
        return new
    scale = widths_of(kinds)
    new_at = np.column_stack([values / scale, state.load])
    old_at = np.column_stack([before.values / scale, before.share])
    gap = np.abs(new_at[:, None] - old_at[None]).max(axis=2).min(axis=1)
    own = gap > _SAME
    return Snapshots(*(np.concatenate([a, b[own]]) for a, b in zip(before, new, strict=True)))


def _basis(
    scene: Scene,
    snapshots: Snapshots,
    lifts: F64,
    beyond: F64,
    tolerance: float,
    most: int,
    more: int,
) -> Basis:
    """Least squares modes, mass-orthonormal, of states with relative errors."""
    mass, size = _sizes(scene, snapshots.x)
    parts = [(snapshots.x, mass, 1.0 / np.maximum(size, _LEAST * size.max()))]
    if len(lifts):
        product, own = _sizes(scene, lifts)
        parts.append((lifts, product, _LIFT_WEIGHT / own))
    if len(beyond):
        weight = np.full(len(beyond), _BEYOND_WEIGHT / size.max())
        parts.append((beyond, _sizes(scene, beyond)[0], weight))
    scaled = np.vstack([fields * weight[:, None] for fields, _, weight in parts])
    image = np.hstack([product * weight for _, product, weight in parts])
    modes, values = proper_orthogonal_modes(scaled, image)
    rest = 1.0 - np.cumsum(values) / values.sum()
    r = int(np.searchsorted(-rest, -((_SHARE * tolerance) ** 2)) + 1)
    r = max(1, min(r, most, len(values)))
    m = min(r + more, len(values))
    modes = np.asfortranarray(modes[:, :m])
    return Basis(modes, (modes.T @ mass).T, r, float(np.sqrt(max(rest[r - 1], 0.0))))


def _sizes(scene: Scene, fields: F64) -> tuple[F64, F64]:
    """Fields, shape `(n, dofs)`, times the mass, shape `(dofs, n)`, and their norms."""
    product = modal_products(scene, np.asfortranarray(fields.T))[1]
    return product, np.sqrt((fields.T * product).sum(axis=0))


def _with_all_cells(
    scene: Scene, setting: Setting, snapshots: Snapshots, basis: Basis
) -> tuple[Model, Model]:
    """Models with `r` modes and with all modes, with all cells."""
    m, r = basis.modes.shape[1], basis.r
    model = projection.project(
        scene, setting.parts, setting.laws, basis.modes, setting.columns, setting.variants
    )
    given = setting.conditions(snapshots.values, snapshots.share).given
    states = np.hstack([basis.amplitudes, given])
    some = states[:: max(1, len(states) // 60)]
    directions = projection.volume_directions(
        model.cells, setting.parts, setting.variants, some.T, m + MORE_VOLUME
    )
    finer = projection.with_volume(model, setting.parts, directions)
    s = finer.cells.h.shape[2]
    few = np.concatenate([np.arange(r), np.arange(m, s)])
    one = np.concatenate([[0], few + 1])
    kept = directions.first(r + MORE_VOLUME)
    coarse = finer._replace(
        r=r,
        cells=finer.cells.modes(few),
        constant=np.asfortranarray(finer.constant[np.ix_(few, few)]),
        constant_slope=np.asfortranarray(finer.constant_slope[np.ix_(few, few)]),
        volume=np.asfortranarray(finer.volume[np.ix_(one, one, one)][..., kept]),
        volume_slope=finer.volume_slope[kept],
    )
    return coarse, finer


def _training(setting: Setting, snapshots: Snapshots, basis: Basis) -> tuple[Snapshots, F64]:
    """Snapshots within the range with their amplitudes, and the state at rest if among them."""
    fixed = np.abs(setting.columns.value[:, :, 0]).max(initial=0.0) > 0 or (
        np.abs(setting.columns.force[:, 0]).max() > 0
    )
    active = {t for p in setting.parameters if p.kind == "activation" for t in p.tissues}
    fixed = fixed or any(a > 0 for t, a in enumerate(setting.laws.activation) if t not in active)
    if fixed:
        own = np.flatnonzero(snapshots.share >= 1.0)
        return Snapshots(*(a[own] for a in snapshots)), basis.amplitudes[own]
    rest = np.array([[0.0 if p.grows else p.low for p in setting.parameters]])
    empty = Snapshots(
        rest, np.ones(1), np.zeros((1, snapshots.x.shape[1])), 0.0 * snapshots.probes[:1]
    )
    values = np.vstack([snapshots.values, rest])
    # states of different rays coincide at rest
    _, own = np.unique(np.round(values, 12), axis=0, return_index=True)
    joined = [np.concatenate(pair)[own] for pair in zip(snapshots, empty, strict=True)]
    amplitudes = np.vstack([basis.amplitudes, np.zeros((1, basis.amplitudes.shape[1]))])
    return Snapshots(*joined), amplitudes[own]


def values_beyond(setting: Setting, seed: int) -> F64:
    """Values of parameters with sigma_max beyond its range, shape `(n, p)`; none if it is fixed."""
    kinds = setting.parameters
    if not any(p.kind == "sigma_max" for p in kinds):
        return np.zeros((0, len(kinds)))
    beyond = [
        p._replace(low=p.high, high=REACH * p.high) if p.kind == "sigma_max" else p for p in kinds
    ]
    most = [p._replace(low=p.high) if p.kind in ("sigma_max", "activation") else p for p in beyond]
    if sum(p.low < p.high for p in most) > _MOST_COMBINED:
        face = spread_points(most, _MOST_FACE, seed + 1)
    else:
        ends = [np.unique(np.linspace(p.low, p.high, _ENDS)) for p in most]
        face = np.array(list(product(*ends)))
        if len(face) > _MOST_FACE:
            face = np.random.default_rng(seed).permutation(face)[:_MOST_FACE]
    return np.vstack([face, spread_points(beyond, _SPREAD, seed)])


def states_beyond(
    scene: Scene, setting: Setting, snapshots: Snapshots, lifts: F64, seed: int
) -> F64:
    """States at these values, shape `(n, dofs)`.

    A muscle constant that nobody measures is more often needed outside the range than a load. The
    snapshots represent such states three times better than the modes kept of them, which were
    selected by states of the range: instead of full solves, a model with nearly all modes gives
    states there, which enter the selection.
    """
    values = values_beyond(setting, seed)
    if len(values) == 0:
        return np.zeros((0, scene.dofs))
    most = _MODES_OF_LARGE if len(setting.parts.weight) > LARGE else _MODES
    wide = make_draft(scene, setting, snapshots, lifts, 0.0, most=most, more=0)
    answer = wide.solve(setting, values)
    return np.asarray(answer.amplitudes[answer.converged] @ wide.basis.modes.T)
