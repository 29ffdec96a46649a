"""A reduced model against the full one at parameters that its training did not see."""

import time
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback
from myork.errors import ConvergenceError, InputError
from myork.rom.full import FullModel, FullState
from myork.rom.model import ReducedModel
from myork.rom.online import Answer
from myork.rom.parameters import spread_points
from myork.rom.setting import Setting, force_values
from myork.types import F64, Mask

#: Forces are compared with their own size, but not with less than this share of the largest
LEAST_FORCE = 0.05


class Tests(NamedTuple):
    """Full states at values that no training sees."""

    values: F64  #: Values of the parameters, shape `(n, p)`
    states: list[FullState]  #: The states there
    failed: int  #: Further ones that the full model did not reach
    seed: int  #: Start of the random numbers that chose the values


def compare(
    rom: ReducedModel,
    full: FullModel,
    points: int,
    seed: int,
    progress: ProgressCallback,
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> dict[str, Any]:
    """Errors and times at unseen points of the range, or of other `ranges` by key or last word.

    Displacements are compared in L2 over the body, with that of the same state (`median`, `p95`,
    `max`) and with the largest of all states (`max_of_largest`).

    - returns what `check.json` holds; with other `ranges` also all ranges of the points, by key
    - raises InputError: a range of a key that is no parameter, or whose ends are exchanged
    """
    other = {rom.key_of(name): ends for name, ends in (ranges or {}).items()}
    for key, (low, high) in other.items():
        if not (np.isfinite([low, high]).all() and low <= high):
            raise InputError(f"{key}: a range needs LOW <= HIGH, not {low} and {high}")
    own = {p.key: (p.low, p.high) for p in rom.parameters} | other
    parameters = [p._replace(low=own[p.key][0], high=own[p.key][1]) for p in rom.parameters]

    def guess(values: F64) -> list[F64 | None]:
        found = rom.batch(values)
        return started(found.amplitudes, found.converged, rom.basis)

    values = spread_points(parameters, points, seed)
    found = measure(rom, solve_tests(full, rom.parameters, values, seed, guess, progress))
    if other:
        found["ranges"] = {key: list(ends) for key, ends in own.items()}
    return found


def started(amplitudes: F64, converged: Mask, basis: F64) -> list[F64 | None]:
    """Unknowns at which full solves may begin; none where the reduced model has no state."""
    return [basis @ a if good else None for a, good in zip(amplitudes, converged, strict=True)]


def solve_tests(
    full: FullModel,
    parameters: Any,
    values: F64,
    seed: int,
    guess: Callable[[F64], list[F64 | None]],
    progress: ProgressCallback,
) -> Tests:
    """Full states of a test, each from the state that a reduced model guesses.

    - raises ConvergenceError: none was reached
    """
    states, kept = [], []
    for i, (row, start) in enumerate(zip(values, guess(values), strict=True)):
        try:
            states.append(full.solve(parameters, row, start=start))
        except ConvergenceError as reason:
            progress(f"test {i + 1}/{len(values)}: the full model: {reason}; left out")
            continue
        kept.append(i)
        progress(f"test {i + 1}/{len(values)}")
    if not states:
        raise ConvergenceError("no full solve of the test converged")
    return Tests(values[kept], states, len(values) - len(kept), seed)


def errors_of(
    tests: Tests, amplitudes: F64, basis: F64, force: F64, truth: F64
) -> tuple[F64, F64, F64]:
    """Errors of displacement, absolute in L2 over the body and relative, and of the force."""
    size = np.sqrt([state.x[-1] @ state.mass for state in tests.states])
    overlap = np.array([basis.T @ state.mass for state in tests.states])
    a = amplitudes
    u_error = np.sqrt(np.maximum(size**2 - 2.0 * (a * overlap).sum(1) + (a * a).sum(1), 0.0))
    relative = u_error / np.maximum(size, np.finfo(float).tiny)
    return u_error / size.max(), relative, _force_errors(force, truth)


def largest_errors(
    tests: Tests, setting: Setting, answer: Answer, basis: F64, force: F64
) -> tuple[float, float]:
    """Largest errors of a model in training: of displacement, in the largest, and of forces."""
    truth = np.array([force_values(setting, state.probes[-1:])[0] for state in tests.states])
    own = _first_probe(setting)
    of_largest, _, wrong = errors_of(
        tests, answer.amplitudes, basis, _first_force(setting, tests.values, force), truth[:, own]
    )
    failed = not answer.converged.all()
    return (np.inf, np.inf) if failed else (float(of_largest.max()), float(wrong.max(initial=0.0)))


class CellErrors(NamedTuple):
    """What the few cells of a model add, as the test measures errors; smaller is better."""

    failed: int  #: States that are not found
    #: Largest errors of the others: of forces, of displacements in the largest one
    force: float
    u: float

    def within(self, u: float, force: float) -> bool:
        """Whether all states are found within these errors."""
        return self.failed == 0 and self.u <= u and self.force <= force


def cell_errors(
    rom: ReducedModel, setting: Setting, values: F64, answer: Answer, force: F64
) -> CellErrors:
    """Errors of a model with few cells against one of the same modes with all.

    - `rom`: model with few cells
    - `setting`: what it was trained in
    - `values`: values of the parameters, shape `(n, p)`
    - `answer`, `force`: converged states with all cells, and their forces without tractions, shape
      `(n, nf)`
    """
    batch = rom.batch(values)
    good = batch.converged
    off = np.linalg.norm(batch.amplitudes - answer.amplitudes, axis=1)
    size = np.linalg.norm(answer.amplitudes, axis=1).max(initial=0.0)
    truth = _first_force(setting, values, force)
    # a model without a force has no numbers for one
    force = np.asarray(batch.force).reshape(len(values), -1)[:, : truth.shape[1]]
    wrong = _force_errors(force, truth)
    return CellErrors(
        int((~good).sum()),
        float(wrong[good].max(initial=0.0)),
        float((off / size)[good].max(initial=0.0)),
    )


def _first_probe(setting: Setting) -> list[int]:
    """Wanted forces that are those of the first probe of one, as in `measure`."""
    return [k for k, place in enumerate(setting.places) if place[0] == setting.places[0][0]]


def _first_force(setting: Setting, values: F64, force: F64) -> F64:
    """The first force of states, tractions added, of all those wanted without them."""
    push = setting.conditions(values).given @ setting.pushes.T
    return np.asarray((force + push)[:, _first_probe(setting)])


def _force_errors(force: F64, truth: F64) -> F64:
    """Errors of forces, shape `(n, axes)`, in their own size or a share of the largest."""
    magnitude = np.linalg.norm(truth, axis=1)
    least = LEAST_FORCE * magnitude.max(initial=0.0)
    return np.asarray(np.linalg.norm(force - truth, axis=1) / np.maximum(magnitude, least or 1.0))


def measure(
    rom: ReducedModel, tests: Tests, corrections: int | str = "converged"
) -> dict[str, Any]:
    """Errors and times of a model, after some corrections, at the states of a test."""
    from scipy.stats import spearmanr

    values, states = tests.values, tests.states
    begin = time.process_time()
    answer = rom.batch(values, corrections)
    seconds = (time.process_time() - begin) / len(values)
    estimate = rom.batch(values, corrections, indicator=True).indicator
    truth = np.array([_force(rom, state.probes[-1]) for state in states])
    force = np.asarray(answer.force).reshape(len(values), -1)
    of_largest, relative, wrong = errors_of(tests, answer.amplitudes, rom.basis, force, truth)
    ratio = estimate / np.maximum(relative, np.finfo(float).tiny)
    return {
        "points": len(values),
        "failed": int((~answer.converged).sum()),
        "failed_full_solves": tests.failed,
        "u": {**_spread(relative), "max_of_largest": float(of_largest.max())},
        "force": _spread(wrong),
        "cpu_us_per_state": 1e6 * seconds,
        "indicator_ratio": {"min": float(ratio.min()), "max": float(ratio.max())},
        "spearman": float(spearmanr(estimate, relative)[0]),
        "full_cpu_s_per_state": float(np.mean([state.cpu_s for state in states])),
        "full_started": sum(state.started for state in states),
        "cells": rom.head["cells"],
        "modes": rom.modes,
        "parameters": values.tolist(),
        "seed": tests.seed,
    }


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
