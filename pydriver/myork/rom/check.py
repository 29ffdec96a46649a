"""Comparison of a reduced model with the full one at parameters outside its training."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback
from myork.errors import ConvergenceError
from myork.rom.full import FullModel, FullState
from myork.rom.marks import LOST, Marks
from myork.rom.model import Batch, ReducedModel
from myork.rom.online import Answer
from myork.rom.parameters import spread_points, widths_of
from myork.rom.setting import Setting, force_values
from myork.types import F64, I64, Mask

#: Errors of forces are relative to the force, or to this share of the largest if it is smaller
LEAST_FORCE = 0.05
#: They are relative to this share of the largest force of any probe at least: a force that is zero
#: by symmetry consists of rounding errors
_LEAST_OF_ALL = 1e-3


class Tests(NamedTuple):
    """Full states at parameters that no training uses."""

    values: F64  #: Values of the parameters, shape `(n, p)`
    states: list[FullState]  #: Full states at these values
    #: Values at which the full model found no state, or an unstable one, shape `(m, p)`
    lost: F64
    seed: int  #: Seed of the random numbers that chose the values

    def some(self, rows: I64) -> "Tests":
        """The states of some rows."""
        return self._replace(values=self.values[rows], states=[self.states[k] for k in rows])


def compare(
    rom: ReducedModel, full: FullModel, points: int | F64, seed: int, progress: ProgressCallback
) -> dict[str, Any]:
    """Errors and times at unseen points: the content of `check.json`.

    Errors of displacement are in L2 over the body, relative to the same state (`median`, `p95`,
    `max`) and to the largest of all states (`max_of_largest`).

    - `points`: number of points spread over the range, or values of the parameters, shape `(n, p)`
    """
    values = spread_points(rom.parameters, points, seed) if isinstance(points, int) else points

    def guess(values: F64) -> list[F64 | None]:
        found = rom.batch(values)
        return started(found.amplitudes, found.converged, rom.basis)

    return measure(rom, solve_tests(full, rom.parameters, values, seed, guess, progress))


def started(amplitudes: F64, converged: Mask, basis: F64) -> list[F64 | None]:
    """Unknowns from which full solves may start; None where the reduced model has no state."""
    return [basis @ a if good else None for a, good in zip(amplitudes, converged, strict=True)]


def solve_tests(
    full: FullModel,
    parameters: Any,
    values: F64,
    seed: int,
    guess: Callable[[F64], list[F64 | None]],
    progress: ProgressCallback,
    marks: Marks | None = None,
) -> Tests:
    """Full states of a test, each started from the guess of a reduced model.

    Unstable states are no reference: which one a solve reaches is chance.
    Near lost `marks`, only limited effort is spent on them.

    - raises ConvergenceError: no state was reached
    """
    near = np.zeros(len(values), bool)
    if marks is not None:
        near = marks.worst(values, widths_of(parameters)) == LOST
    states, kept = [], []
    for i, (row, start) in enumerate(zip(values, guess(values), strict=True)):
        try:
            state = full.solve(parameters, row, start=start, doubted=bool(near[i]))
        except ConvergenceError as reason:
            progress(f"test {i + 1}/{len(values)}: the full model: {reason}; left out")
            continue
        if state.mark == LOST:
            progress(f"test {i + 1}/{len(values)}: the full model: unstable; left out")
            continue
        states.append(state)
        kept.append(i)
        progress(f"test {i + 1}/{len(values)}")
    if not states:
        raise ConvergenceError("no full solve of the test converged to a stable state")
    return Tests(values[kept], states, np.delete(values, kept, axis=0), seed)


def errors_of(
    tests: Tests, amplitudes: F64, basis: F64, force: F64, truth: F64, least: float
) -> tuple[F64, F64, F64]:
    """Errors of displacement, absolute in L2 over the body and relative, and of the force.

    - `force`, `truth`, `least`: as in `_force_errors`
    """
    size = np.sqrt([state.x[-1] @ state.mass for state in tests.states])
    overlap = np.array([basis.T @ state.mass for state in tests.states])
    a = amplitudes
    u_error = np.sqrt(np.maximum(size**2 - 2.0 * (a * overlap).sum(1) + (a * a).sum(1), 0.0))
    relative = u_error / np.maximum(size, np.finfo(float).tiny)
    return u_error / size.max(), relative, _force_errors(force, truth, least)


def largest_errors(
    tests: Tests, setting: Setting, answer: Answer, basis: F64, force: F64
) -> tuple[float, float]:
    """Largest errors of a model in training: displacement relative to the largest, and forces."""
    truth = np.array([force_values(setting, state.probes[-1:])[0] for state in tests.states])
    own = _first_probe(setting)
    of_largest, _, wrong = errors_of(
        tests, answer.amplitudes, basis, _forces(setting, tests.values, force)[:, own],
        truth[:, own], _least_force(truth, setting.rounding),
    )  # fmt: skip
    failed = not answer.converged.all()
    return (np.inf, np.inf) if failed else (float(of_largest.max()), float(wrong.max(initial=0.0)))


class CellErrors(NamedTuple):
    """Errors added by the reduced set of cells, measured as in the test; smaller is better."""

    failed: int  #: Number of states not found
    #: Largest errors of the others: of forces, and of displacements relative to the largest
    force: float
    u: float


def cell_errors(
    rom: ReducedModel, setting: Setting, values: F64, answer: Answer, force: F64
) -> CellErrors:
    """Errors of a model with few cells relative to one with the same modes and all cells.

    - `rom`: model with few cells
    - `setting`: setting of its training
    - `values`: values of the parameters, shape `(n, p)`
    - `answer`, `force`: converged states with all cells, and their forces without tractions, shape
      `(n, nf)`
    """
    batch = rom.batch(values)
    good = batch.converged
    off = np.linalg.norm(batch.amplitudes - answer.amplitudes, axis=1)
    size = np.linalg.norm(answer.amplitudes, axis=1).max(initial=0.0)
    every = _forces(setting, values, force)
    truth = every[:, _first_probe(setting)]
    # without a force, the model has no numbers for one
    force = np.asarray(batch.force).reshape(len(values), -1)[:, : truth.shape[1]]
    wrong = _force_errors(force, truth, _least_force(every, setting.rounding))
    return CellErrors(
        int((~good).sum()),
        float(wrong[good].max(initial=0.0)),
        float((off / size)[good].max(initial=0.0)),
    )


def _first_probe(setting: Setting) -> list[int]:
    """Indices of the wanted forces that belong to the first force probe, as in `measure`."""
    return [k for k, place in enumerate(setting.places) if place[0] == setting.places[0][0]]


def _forces(setting: Setting, values: F64, force: F64) -> F64:
    """Wanted forces of states with tractions added, from those without."""
    return np.asarray(force + setting.conditions(values).given @ setting.pushes.T)


def _least_force(forces: F64, rounding: float) -> float:
    """Force to which errors are relative at least, from the forces of all probes."""
    return max(_LEAST_OF_ALL * float(np.abs(forces).max(initial=0.0)), rounding)


def _force_errors(force: F64, truth: F64, least: float) -> F64:
    """Errors of forces, shape `(n, axes)`, relative to themselves or to a share of the largest.

    - `least`: smallest force to which they are relative
    """
    magnitude = np.linalg.norm(truth, axis=1)
    least = max(LEAST_FORCE * magnitude.max(initial=0.0), least)
    return np.asarray(np.linalg.norm(force - truth, axis=1) / np.maximum(magnitude, least or 1.0))


def measure(rom: ReducedModel, tests: Tests) -> dict[str, Any]:
    """Errors and times at test states, of a model and of a regression of its full solves."""
    from scipy.stats import spearmanr

    values, states = tests.values, tests.states
    seconds = _seconds(lambda: rom.batch(values))
    rough = rom.batch(values, 0)
    answer = rom.batch(values, indicator=True)
    estimate = answer.indicator
    truth = np.array([_force(rom, state.probes[-1]) for state in states])
    of_sets = [probe["index"] for probe in rom.head["probes"] if probe["rows"]]
    every = np.array([state.probes[-1][of_sets] for state in states])
    least = _least_force(np.nan_to_num(every), rom.head.get("rounding", 0.0))
    (of_largest, relative, wrong), (_, rough_u, rough_force) = (
        errors_of(
            tests,
            one.amplitudes,
            rom.basis,
            np.asarray(one.force).reshape(len(values), -1),
            truth,
            least,
        )
        for one in (answer, rough)
    )
    ratio = estimate / np.maximum(relative, np.finfo(float).tiny)
    good = answer.converged
    if not good.any():
        raise ConvergenceError("the reduced model did not converge at any test state")
    # relative like the tolerance; ratios to less than a hundredth of it are meaningless
    absolute = estimate * np.linalg.norm(answer.amplitudes, axis=1) / rom.largest
    over = np.maximum(of_largest, wrong) / np.maximum(absolute, 0.01 * rom.head["tolerance"])
    # near lost states nothing is certified
    tried = good & (answer.full < LOST)
    tried = tried if tried.any() else good
    over_estimate = float(over[tried].max())
    full = {}
    for probe in rom.head["probes"]:
        found = answer.probes[probe["name"]]
        seen = np.array([state.probes[-1][probe["index"]] for state in states])
        full[probe["name"]] = seen[:, : found.size // len(found)].reshape(found.shape)
    exact = answer._replace(probes=full).scalars()
    of_probes = {name: abs(x - exact[name])[tried].max() for name, x in answer.scalars().items()}
    sure = answer.certified
    if not rom.certificate:
        # answers that it will certify once these errors are its certificate
        sure = answer.inside & good & (answer.full < LOST)
        sure &= absolute * over_estimate <= rom.head["tolerance"]
    return {
        "points": len(values),
        "failed": int((~good).sum()),
        "lost": len(tests.lost),
        "lost_unmarked": int((rom.marks.worst(tests.lost, widths_of(rom.parameters)) < LOST).sum()),
        "u": {**_spread(relative[good]), "max_of_largest": float(of_largest[good].max())},
        "force": _spread(wrong[good]),
        "over_estimate": over_estimate,
        "probes": {name: float(error) for name, error in of_probes.items()},
        "certified": {
            "points": int(sure.sum()),
            "u": float(of_largest[sure].max(initial=0.0)),
            "force": float(wrong[sure].max(initial=0.0)),
        },
        "regression": {
            "u": _spread(rough_u),
            "force": _spread(rough_force),
            "cpu_us_per_state": 1e6 * _seconds(lambda: rom.batch(values, 0)),
        },
        "cpu_us_per_state": 1e6 * seconds,
        "indicator_ratio": {"min": float(ratio[good].min()), "max": float(ratio[good].max())},
        "spearman": float(spearmanr(estimate[good], relative[good])[0]),
        "full_cpu_s_per_state": float(np.mean([state.cpu_s for state in states])),
        "cells": rom.head["cells"],
        "modes": rom.modes,
        "parameters": values.tolist(),
        "seed": tests.seed,
    }


def _seconds(call: Callable[[], Batch]) -> float:
    """Processor time of a state [s], the smaller of two: the first call may load libraries."""
    found = []
    for _ in range(2):
        begin = time.process_time()
        states = len(call().converged)
        found.append((time.process_time() - begin) / states)
    return min(found)


def _force(rom: ReducedModel, probes: F64) -> F64:
    """The first force probe of a full state."""
    for probe in rom.head["probes"]:
        if probe["rows"]:
            return np.asarray(probes[probe["index"], : len(probe["rows"])])
    return np.zeros(1)


def _spread(values: F64) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "p95": float(np.quantile(values, 0.95)),
        "max": float(values.max()),
    }
