"""Compiled finite elements for comparison: dolfinx 0.5, in a separate process.

Debian's package `python3-dolfinx`; without it a row says so. It takes boxes and annuli of one
material.
"""

from __future__ import annotations

import json
import os
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.interpolate import BPoly, PPoly

#: Python of the system, for which Debian installs dolfinx
DOLFINX = "/usr/bin/python3"
#: Forms of dolfinx in the race
_FORMS = ("Q2", "Q3", "Q2/Q1", "Q2/P1", "Q3/P2")
#: Limit of the time of a form on all its meshes [s]
_LIMIT = 150.0


def compiled_peers(
    deck: Mapping[str, Any], elements: Sequence[Sequence[int]]
) -> list[dict[str, Any]]:
    """Solve a deck on its meshes by every form of dolfinx.

    - `deck`: all tables of the deck; a box or an annulus of one material
    - `elements`: elements along each edge, ascending
    - returns `form`, and for each mesh `elements`, `dofs`, `cpu_s` [s], `memory` [byte], `probes`,
      or an `outcome` without an answer
    """
    return [
        {"form": f"dolfinx {form}", **row}
        for form in _FORMS
        for row in solve_dolfinx(deck, elements, form)
    ]


def solve_dolfinx(
    deck: Mapping[str, Any], elements: Sequence[Sequence[int]], form: str, limit: float = _LIMIT
) -> list[dict[str, Any]]:
    """Rows of one form of dolfinx, as far as it came within the time limit [s]."""
    table = deck["material"][0]
    job = {
        "deck": deck,
        "elements": [list(count) for count in elements],
        "form": form,
        "curves": fiber_pieces(table) if table["model"] == "muscle" else None,
    }
    script = Path(__file__).with_name("dolfinx_solver.py")
    one = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS")}
    kept = {name: os.environ[name] for name in ("PATH", "HOME") if name in os.environ}
    if not Path(DOLFINX).is_file():
        return [{"outcome": "not installed: python3-dolfinx"}]
    try:
        ended = subprocess.run(
            [DOLFINX, str(script)], input=json.dumps(job, default=str), text=True,
            capture_output=True, timeout=limit, env={**kept, **one}, check=False,
        )  # fmt: skip
        printed, fault = ended.stdout, ended.stderr
    except subprocess.TimeoutExpired as late:
        printed = late.stdout.decode() if isinstance(late.stdout, bytes) else late.stdout or ""
        fault = f"ended after {limit:g} s"
    rows = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
    if len(rows) < len(elements):
        last = (fault.strip().splitlines() or ["no answer"])[-1]
        missing = last.startswith("ModuleNotFoundError")
        rows.append({"outcome": "not installed: python3-dolfinx" if missing else last})
    return rows


def fiber_pieces(table: Mapping[str, Any]) -> list[list[dict[str, Any]]]:
    """Active and passive force of a muscle's fibers, piece by piece (`rk_fiber.f90`)."""
    gamma, rate = float(table["gamma1"]), float(table["gamma2"])
    growth = gamma * np.exp(0.4 * rate)
    active = [
        {"centre": centre, "c": [top, 0.0, bend]}
        for centre, top, bend in ((0, 0, 0), (0.4, 0, 9), (1.0, 1, -4), (1.6, 0, 9), (0, 0, 0))
    ]
    passive = [
        {"centre": 0.0, "c": [0.0]},
        {"centre": 1.0, "c": [-gamma], "amplitude": gamma, "rate": rate},
        {"centre": 1.4, "c": [growth - gamma, growth * rate]},
    ]
    smooth = table["curve"] == "smooth"
    return [
        _blended(active, ((0.4, 0, 0.15), (0.6, 0.05, 0.05), (1.4, 0.05, 0.05), (1.6, 0.15, 0)),
                 smooth),
        _blended(passive, ((1.0, 0, 0.15), (1.4, 0.05, 0.05)), smooth),
    ]  # fmt: skip


def _blended(
    branches: Sequence[dict[str, Any]], breaks: Sequence[tuple[float, float, float]], smooth: bool
) -> list[dict[str, Any]]:
    """Branches joined by polynomials of degree 7 across their breaks."""
    pieces = [{"start": -1e9, **branches[0]}]
    for (at, below, above), before, after in zip(breaks, branches, branches[1:], strict=False):
        first, last = (at - below, at + above) if smooth else (at, at)
        if last > first:
            ends = [derivatives(before, first), derivatives(after, last)]
            across = PPoly.from_bernstein_basis(BPoly.from_derivatives([first, last], ends))
            pieces.append({"start": first, "centre": first, "c": across.c[::-1, 0].tolist()})
        pieces.append({"start": last, **after})
    return pieces


def derivatives(branch: Mapping[str, Any], at: float) -> list[float]:
    """Force of a branch and its first three derivatives."""
    t = at - branch["centre"]
    powers = np.polynomial.Polynomial(branch["c"])
    rate = branch.get("rate", 0.0)
    grown = branch.get("amplitude", 0.0) * np.exp(rate * t)
    return [float((powers.deriv(k) if k else powers)(t) + grown * rate**k) for k in range(4)]
