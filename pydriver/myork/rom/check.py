"""A reduced model against the full one at parameters that its training did not see."""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.console import ProgressCallback
from myork.errors import ConvergenceError
from myork.rom.full import FullModel
from myork.rom.model import ReducedModel
from myork.rom.parameters import spread_points

__all__ = ["compare"]

F64Array = NDArray[np.float64]

#: Forces are compared with their own size, but not with less than this share of the largest
LEAST_FORCE = 0.05


def compare(
    rom: ReducedModel, full: FullModel, points: int, seed: int, progress: ProgressCallback
) -> dict[str, Any]:
    """Errors and times at unseen points of the range.

    Displacements are compared in L2 over the body, with that of the same state (`median`, `p95`,
    `max`) and with the largest of all states (`max_of_largest`).

    Returns
    -------
    dict
        What `check.json` holds.
    """
    from scipy.stats import spearmanr

    values = spread_points(rom.parameters, points, seed)
    states, kept = [], []
    for i, row in enumerate(values):
        try:
            states.append(full.solve(rom.parameters, row))
        except ConvergenceError as reason:
            progress(f"test {i + 1}/{points}: the full model: {reason}; left out")
            continue
        kept.append(i)
        progress(f"test {i + 1}/{points}")
    if not states:
        raise ConvergenceError("no full solve of the test converged")
    values = values[kept]
    begin = time.process_time()
    answer = rom.batch(values)
    seconds = (time.process_time() - begin) / len(values)
    estimate = rom.batch(values, indicator=True).indicator
    size = np.sqrt([state.x[-1] @ state.mass for state in states])
    overlap = np.array([rom.basis.T @ state.mass for state in states])
    a = answer.amplitudes
    u_error = np.sqrt(np.maximum(size**2 - 2.0 * (a * overlap).sum(1) + (a * a).sum(1), 0.0))
    relative = u_error / np.maximum(size, np.finfo(float).tiny)
    truth = np.array([_force(rom, state.probes[-1]) for state in states])
    force = np.asarray(answer.force).reshape(len(values), -1)
    magnitude = np.linalg.norm(truth, axis=1)
    least = LEAST_FORCE * magnitude.max(initial=0.0)
    force_error = np.linalg.norm(force - truth, axis=1) / np.maximum(magnitude, least or 1.0)
    ratio = estimate / np.maximum(relative, np.finfo(float).tiny)
    return {
        "points": len(values),
        "failed": int((~answer.converged).sum()),
        "failed_full_solves": points - len(values),
        "u": {**_spread(relative), "max_of_largest": float(u_error.max() / size.max())},
        "force": _spread(force_error),
        "cpu_us_per_state": 1e6 * seconds,
        "indicator_ratio": {"min": float(ratio.min()), "max": float(ratio.max())},
        "spearman": float(spearmanr(estimate, relative)[0]),
        "full_cpu_s_per_state": float(np.mean([state.cpu_s for state in states])),
        "cells": rom.head["cells"],
        "modes": rom.modes,
        "parameters": values.tolist(),
        "seed": seed,
    }


def _force(rom: ReducedModel, probes: F64Array) -> F64Array:
    """The first force probe of a full state."""
    for probe in rom.head["probes"]:
        if probe["rows"]:
            return np.asarray(probes[probe["index"], : len(probe["rows"])])
    return np.zeros(1)


def _spread(values: F64Array) -> dict[str, float]:
    return {
        "median": float(np.median(values)),
        "p95": float(np.quantile(values, 0.95)),
        "max": float(values.max()),
    }
