"""Train a reduced model: full solves, modes, volume, few cells, and a test on unseen states."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from myork.console import ProgressCallback, silent
from myork.core.cloud import model_path
from myork.core.deck import load_deck
from myork.core.galerkin import (
    modal_products,
)
from myork.core.online import Model, triples
from myork.core.scene import Scene
from myork.core.threads import thread_count
from myork.errors import ConvergenceError, InputError
from myork.model_file import read_model
from myork.rom import projection
from myork.rom.check import compare
from myork.rom.full import FullModel, FullState, cloud_arrays
from myork.rom.model import ReducedModel
from myork.rom.online import Regression, Solver
from myork.rom.parameters import Parameter, as_parameters, parse_vary, spread_points
from myork.rom.sampling import force_lifts, sample_cells, sample_forces
from myork.rom.setting import Setting, Snapshots, make_setting

__all__ = ["train"]

F64Array = NDArray[np.float64]

#: Load steps of the first solves, from rest to the corners of the range
RAY_STEPS = 8
#: Corners at most
MOST_RAYS = 16
#: Modes at most; beyond, the volume and not the cells sets the time
MOST_MODES = 28
#: Modes that the error estimate has more
MORE_MODES = 12
#: Directions of volume beyond the number of modes
MORE_VOLUME = 8
#: States that are added at a time, and candidates among which they are chosen
BATCH, CANDIDATES = 8, 128
#: Solutions of the model with all cells that the cubature is trained on beside the full ones
VIRTUAL = 96
#: Cells up to which forces are found by all of them
ALL_CELLS = 2000
#: States at which the body is made to follow sets that stand still, and the step [length]
_LIFT_STATES, _LIFT_STEP = 4, 1e-3
#: Weight of such fields among the snapshots, in the largest of them
_LIFT_WEIGHT = 0.01


class Basis(NamedTuple):
    """Modes with the amplitudes of the snapshots."""

    modes: F64Array
    amplitudes: F64Array
    r: int
    lost: float


def train(
    deck: str | Path,
    parameters: Mapping[str, Sequence[float]] | Sequence[str],
    *,
    tolerance: float = 1e-3,
    full_solves: int = 60,
    tests: int = 16,
    seed: int = 0,
    out: str | Path | None = None,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> ReducedModel:
    """Train a reduced model of a deck.

    The first full solves go from rest to corners of the range, and give a state for each of their
    steps. Half of the others fill the range evenly; the rest are chosen where the reduced model of
    those before estimates its largest error. Further ones are a test that nothing was chosen by:
    its errors are the certificate.

    Parameters
    ----------
    deck : str or Path
        Deck file; its method is one of the Galerkin forms.
    parameters : mapping or sequence of str
        Ranges `(low, high)` by key, or texts `KEY=LOW:HIGH`.
    tolerance : float
        Wanted relative error of force and displacement.
    full_solves : int
        Full solves of the training, the corners included.
    tests : int
        Further full solves of the test.
    seed : int
        Start of the random numbers.
    out : str or Path, optional
        Folder in which the model file of the deck is looked for first.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    threads : int, optional
        Number of threads; default all cores.
    progress : callable
        Called with every line of progress.

    Raises
    ------
    InputError
        A parameter or the deck is wrong for a reduced model.
    ConvergenceError
        Too few full solves converged.
    """
    begin = time.process_time()
    deck = Path(deck)
    ranges = parameters if isinstance(parameters, Mapping) else parse_vary(parameters)
    values = load_deck(deck, overrides, "solve")
    kinds = as_parameters(ranges, values)
    for key in ("rotation", "pressure", "spring", "tendon"):
        if any(key in entry for entry in values.get("boundary", [])):
            raise InputError(f"{deck}: boundary.{key}: a reduced model does not know it")
    if values.get("amplitude"):
        raise InputError(
            f"{deck}: amplitude: a reduced model is trained on loads that grow together"
        )
    if not 0.0 < tolerance < 0.5:
        raise InputError(f"tolerance must lie between 0 and 0.5, not {tolerance}")
    if full_solves < 4:
        raise InputError(f"at least 4 full solves are needed, not {full_solves}")
    path = model_path(values, deck.parent, None if out is None else Path(out))
    cloud = None if path is None else read_model(path)
    full = FullModel(deck.read_text(encoding="utf-8"), overrides, cloud, threads)
    base, units = full.loads(kinds)
    with full.open() as scene:
        setting, head = make_setting(scene, kinds, values, base, units, threads or thread_count())
        corners = _corners(kinds, full_solves, seed)
        cpu: list[float] = []
        failed = 0
        snapshots: Snapshots | None = None
        lifts = np.zeros((0, scene.dofs))
        chosen = corners
        steps: int | None = RAY_STEPS
        while True:
            for row in chosen:
                try:
                    state = full.solve(kinds, row, steps)
                except ConvergenceError as reason:
                    failed += 1
                    progress(f"full solve at {_named(kinds, row)}: {reason}; left out")
                    continue
                cpu.append(state.cpu_s)
                snapshots = _joined(snapshots, kinds, state, row)
                progress(f"full solve {len(cpu)}/{full_solves}: {_named(kinds, row)}")
            left = full_solves - len(cpu) - failed
            if left <= 0:
                break
            if snapshots is None:
                raise ConvergenceError("no full solve of the corners of the range converged")
            if steps is not None:
                at = np.flatnonzero(snapshots.share >= 1.0)[:_LIFT_STATES]
                lifts = _lift_fields(full, setting, snapshots.values[at], snapshots.x[at], progress)
                # states that fill the range, half of what is left, before the choice begins
                chosen = spread_points(kinds, max(1, left // 2), seed)
            else:
                count = min(left, max(BATCH, full_solves // 4))
                chosen = _choose(
                    scene, setting, snapshots, lifts, tolerance, seed + len(cpu), count
                )
            steps = None
        if snapshots is None or len(snapshots.x) < 4:
            raise ConvergenceError("fewer than four states of the full model converged")
        arrays = _finish(scene, setting, snapshots, lifts, tolerance, seed, progress)
    arrays["tractions"] = head.pop("tractions")
    head |= {
        "modes": int(arrays.pop("modes")),
        "indicator_modes": int(arrays.pop("indicator_modes")),
        "cells": {"all": len(setting.parts.weight), "kept": arrays["online/h"].shape[1]},
        "full_solves": len(cpu),
        "failed_full_solves": failed,
        "full_cpu_s": float(np.mean(cpu)),
        "offline_cpu_s": time.process_time() - begin,
        "tolerance": tolerance,
        "seed": seed,
    }
    head |= {"deck": full.text, "overrides": list(overrides), "deck_sha256": values["sha256"]}
    arrays["head"] = json.dumps(head)
    if cloud is not None:
        arrays |= cloud_arrays(cloud)
    rom = ReducedModel(arrays)
    if tests:
        progress(f"test on {tests} states that the training did not see")
        rom.set_certificate(compare(rom, full, tests, seed + 7919, progress))
    return rom


def _lift_fields(
    full: FullModel, setting: Setting, rows: F64Array, states: F64Array, progress: ProgressCallback
) -> F64Array:
    """How the body follows sets whose forces are wanted but which nothing moves.

    Without such fields among the modes the force on a set that stands still is not stationary: it
    has the error of the displacement, not its square.
    """
    size = max(float(np.abs(setting.columns.value).max()), 1.0)
    found = []
    for key, value in setting.still:
        for row, x in zip(rows, states, strict=True):
            try:
                found.append(full.lift(setting.parameters, row, x, key, value, _LIFT_STEP * size))
            except ConvergenceError as reason:
                progress(f"{key} at {_named(setting.parameters, row)}: {reason}; left out")
        progress(f"forces by {key}: {len(found)} fields")
    return np.array(found).reshape(len(found), states.shape[1])


def _corners(kinds: Sequence[Parameter], most: int, seed: int) -> F64Array:
    """Corners of the range, all or some, those of the largest values first."""
    corners = np.array(list(product(*((p.high, p.low) for p in kinds))))
    count = min(MOST_RAYS, max(2, most // 2))
    if len(corners) > count:
        others = np.random.default_rng(seed).permutation(np.arange(1, len(corners)))
        corners = corners[np.concatenate([[0], np.sort(others[: count - 1])])]
    return corners


def _joined(
    before: Snapshots | None, kinds: Sequence[Parameter], state: FullState, row: F64Array
) -> Snapshots:
    """Snapshots with those of one more solve."""
    values = np.tile(row, (len(state.load), 1))
    for j, parameter in enumerate(kinds):
        if parameter.kind != "sigma_max":
            values[:, j] *= state.load
    new = Snapshots(values, state.load, state.x, state.probes)
    if before is None:
        return new
    return Snapshots(*(np.concatenate(pair) for pair in zip(before, new, strict=True)))


def _basis(scene: Scene, snapshots: Snapshots, lifts: F64Array, tolerance: float) -> Basis:
    """Modes of least squares, orthonormal by the mass."""
    x = snapshots.x
    mass = modal_products(scene, np.asfortranarray(x.T))[1]
    if len(lifts):
        product = modal_products(scene, np.asfortranarray(lifts.T))[1]
        size = np.sqrt((lifts.T * product).sum(axis=0))
        largest = np.sqrt((x.T * mass).sum(axis=0).max())
        factor = _LIFT_WEIGHT * largest / size
        x = np.vstack([x, lifts * factor[:, None]])
        mass = np.hstack([mass, product * factor])
    values, vectors = np.linalg.eigh(x @ mass)
    values, vectors = values[::-1], vectors[:, ::-1]
    real = values > 1e-13 * values[0]
    values, vectors = values[real], vectors[:, real]
    modes = x.T @ vectors / np.sqrt(values)
    rest = 1.0 - np.cumsum(values) / values.sum()
    r = int(np.searchsorted(-rest, -((0.25 * tolerance) ** 2)) + 1)
    r = max(1, min(r, MOST_MODES, len(values)))
    m = min(r + MORE_MODES, len(values))
    modes = np.asfortranarray(modes[:, :m])
    amplitudes = (modes.T @ mass[:, : len(snapshots.x)]).T
    return Basis(modes, amplitudes, r, float(np.sqrt(max(rest[r - 1], 0.0))))


def _with_all_cells(
    scene: Scene, setting: Setting, snapshots: Snapshots, basis: Basis
) -> tuple[Model, Model]:
    """Models of `r` and of all modes with all cells."""
    m = basis.modes.shape[1]
    model, rows, total = projection.project(
        scene, setting.parts, setting.laws, basis.modes, setting.columns
    )
    given = setting.conditions(snapshots.values, snapshots.share).given
    states = np.hstack([basis.amplitudes, given])
    some = states[:: max(1, len(states) // 60)]
    few = min(rows.shape[0], m + MORE_VOLUME)
    directions = projection.volume_directions(model.cells, rows, total, some.T, few)
    finer = projection.with_volume(model, rows, total, directions)
    return _with_modes(finer, basis.r, min(few, basis.r + MORE_VOLUME)), finer


def _with_modes(model: Model, r: int, kept: int) -> Model:
    """The same model with the first of its modes and of its directions of volume."""
    m = model.r
    s = model.cells.h.shape[2]
    few = np.concatenate([np.arange(r), np.arange(m, s)])
    one = np.concatenate([[0], few + 1])
    kept = model.volume.shape[3] if r == m else kept
    return Model(
        r,
        model.cells.modes(few),
        np.asfortranarray(model.constant[np.ix_(few, few)]),
        model.volume[np.ix_(one, one, one)][..., :kept],
        model.fibers,
    )


def _regression(setting: Setting, snapshots: Snapshots, values: F64Array) -> Regression:
    scale = np.array([p.high - p.low for p in setting.parameters])
    return Regression(snapshots.values, values, scale)


def _training(setting: Setting, snapshots: Snapshots, basis: Basis) -> tuple[Snapshots, F64Array]:
    """Snapshots that are states of the range with their amplitudes, and rest where it is one."""
    fixed = np.abs(setting.columns.value[:, :, 0]).max(initial=0.0) > 0 or (
        np.abs(setting.columns.force[:, 0]).max() > 0
    )
    active = {t for p in setting.parameters if p.kind == "activation" for t in p.tissues}
    fixed = fixed or any(a > 0 for t, a in enumerate(setting.laws.activation) if t not in active)
    if fixed:
        own = np.flatnonzero(snapshots.share >= 1.0)
        return Snapshots(*(a[own] for a in snapshots)), basis.amplitudes[own]
    rest = np.array([[p.low if p.kind == "sigma_max" else 0.0 for p in setting.parameters]])
    empty = Snapshots(
        rest, np.ones(1), np.zeros((1, snapshots.x.shape[1])), 0.0 * snapshots.probes[:1]
    )
    values = np.vstack([snapshots.values, rest])
    # states of different rays meet at rest
    _, own = np.unique(np.round(values, 12), axis=0, return_index=True)
    joined = [np.concatenate(pair)[own] for pair in zip(snapshots, empty, strict=True)]
    amplitudes = np.vstack([basis.amplitudes, np.zeros((1, basis.amplitudes.shape[1]))])
    return Snapshots(*joined), amplitudes[own]


def _choose(
    scene: Scene,
    setting: Setting,
    snapshots: Snapshots,
    lifts: F64Array,
    tolerance: float,
    seed: int,
    count: int,
) -> F64Array:
    """Parameters at which the reduced model so far estimates its largest errors, apart."""
    basis = _basis(scene, snapshots, lifts, tolerance)
    model, finer = _with_all_cells(scene, setting, snapshots, basis)
    known, amplitudes = _training(setting, snapshots, basis)
    large = len(setting.parts.weight) > ALL_CELLS
    values = spread_points(setting.parameters, CANDIDATES // 2 if large else CANDIDATES, seed)
    start = _regression(setting, known, amplitudes)(values)
    conditions = setting.conditions(values)
    none = np.zeros(0, np.int64)
    coarse = Solver(model, model.cells, none, setting.threads)
    answer = coarse.newton(conditions, start[:, : basis.r])[0]
    begin = np.zeros_like(start)
    begin[:, : basis.r] = answer.amplitudes
    better = Solver(finer, finer.cells, none, setting.threads)
    step = better.newton(conditions, begin, tolerance=np.inf, most=1)[0].amplitudes - begin
    gain = np.linalg.norm(step, axis=1)
    gain[~(answer.converged & np.isfinite(gain))] = 2.0 * np.nanmax(gain[np.isfinite(gain)])
    scale = np.array([p.high - p.low for p in setting.parameters])
    chosen = []
    for _ in range(count):
        best = int(np.argmax(gain))
        chosen.append(best)
        distance = np.linalg.norm((values - values[best]) / scale, axis=1)
        gain = gain * np.minimum(1.0, (distance / 0.35) ** 2)
    return values[chosen]


def _finish(
    scene: Scene,
    setting: Setting,
    snapshots: Snapshots,
    lifts: F64Array,
    tolerance: float,
    seed: int,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Arrays of the model: modes, volume, few cells."""
    basis = _basis(scene, snapshots, lifts, tolerance)
    m, r = basis.modes.shape[1], basis.r
    progress(f"{r} modes of {len(snapshots.x)} states; they leave {basis.lost:.1e} of them")
    model, finer = _with_all_cells(scene, setting, snapshots, basis)
    known, amplitudes = _training(setting, snapshots, basis)
    values = spread_points(setting.parameters, VIRTUAL, seed + 1)
    start = _regression(setting, known, amplitudes)(values)[:, :r]
    none = np.zeros(0, np.int64)
    answer = Solver(model, model.cells, none, setting.threads).newton(
        setting.conditions(values), start
    )[0]
    good = answer.converged
    progress(f"{good.sum()} of {len(good)} states of the model with all cells converged")
    some = np.unique(np.linspace(0, len(known.values) - 1, VIRTUAL).astype(int))
    at = np.vstack([known.values[some], values[good]])
    where = np.vstack([amplitudes[some], np.zeros((int(good.sum()), m))])
    where[len(some) :, :r] = answer.amplitudes[good]
    kept = sample_cells(model, setting, at, where[:, :r], tolerance, seed, 12 * MOST_MODES)
    more = sample_cells(finer, setting, at, where, tolerance, seed, 12 * MOST_MODES)
    progress(
        f"{len(kept[0])} of {len(setting.parts.weight)} cells (residual {kept[2]:.1e}), "
        f"{len(more[0])} for the estimate of the error"
    )
    whole = finer.cells
    if len(setting.parts.weight) > ALL_CELLS and len(setting.wanted):
        force = sample_forces(finer, setting, at, where, tolerance)
        whole = finer.cells.sample(*force[:2])
        progress(f"{len(force[0])} cells for the forces (residual {force[2]:.1e})")
    arrays: dict[str, Any] = {"modes": r, "indicator_modes": m, "wanted": setting.wanted}
    for name, one, cells in (
        ("online", model, model.cells.sample(*kept[:2])),
        ("indicator", finer, finer.cells.sample(*more[:2])),
    ):
        arrays |= {f"{name}/{key}": value for key, value in cells._asdict().items()}
        arrays |= {f"{name}/constant": one.constant, f"{name}/volume": triples(one.volume)}
    arrays |= {f"force/{key}": value for key, value in whole._asdict().items()}
    arrays |= {f"laws/{key}": value for key, value in setting.laws._asdict().items()}
    probes = scene.deck.get("probe", [])
    forces = _force_values(setting, probes, known.probes)
    arrays |= {
        "lifts/parameters": at,
        "lifts/values": force_lifts(model, setting, at, where[:, :r]),
    }
    arrays |= {
        "training/parameters": known.values,
        "training/amplitudes": amplitudes,
        "training/forces": forces,
    }
    arrays |= {"basis": basis.modes[:, :r], **_shapes(scene, basis.modes, r)}
    return arrays


def _force_values(
    setting: Setting, probes: Sequence[Mapping[str, Any]], values: F64Array
) -> F64Array:
    """Forces of the training without those of tractions, in the order of the wanted ones."""
    columns = []
    for i, probe in enumerate(probes):
        if probe["quantity"] == "force":
            columns += [values[:, i, axis] for axis in range(setting.columns.value.shape[1])]
        elif probe["quantity"] in ("force_x", "force_y", "force_z"):
            columns.append(values[:, i, 0])
    return np.stack(columns, axis=1) if columns else np.zeros((len(values), 0))


def _shapes(scene: Scene, modes: F64Array, r: int) -> dict[str, F64Array]:
    """Displacements of modes at the collocation points and at the probes of displacements."""
    small = 1e-6 / np.abs(modes).max()
    fields = [scene.fields(small * mode, 0.0).u / small for mode in modes.T[:r]]
    found = {"shapes": np.stack(fields, axis=2), "points": scene.points()}
    probes = scene.deck.get("probe", [])
    if probes:
        values = scene.probes(small * modes.T, np.zeros(modes.shape[1])) / small
        for i, probe in enumerate(probes):
            if probe["quantity"] in ("u", "u_x", "u_y", "u_z"):
                axes = scene.dimension if probe["quantity"] == "u" else 1
                found[f"probes/{probe['name']}"] = values[:, i, :axes].T
    return found


def _named(kinds: Sequence[Parameter], row: F64Array) -> str:
    return ", ".join(f"{p.key} = {v:.4g}" for p, v in zip(kinds, row, strict=True))
