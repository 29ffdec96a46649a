"""Reduced models of Basava (2015), chapter 6, and what came after.

Tables 6.1 to 6.10 are run as published: modes of the states along one path of loads, least squares
Galerkin projection of the collocation form, errors e1 and e2 summed over the states. Each path is
solved by the full model with dense QR, as published, and with the solver that `auto` takes; by the
reduced model with rows assembled in full and Cholesky's factor, as published, and with rows formed
in the span of the modes; and by the Galerkin form projected on its modes. A trained model, which
answers for parameters that it has not seen, stands beside the regression through the same states.

All times are of one thread. Those of dense QR are the time of one iteration times the number of
iterations. A model pays after so many solves that what it saves is what its training took: states
of the full model (by `auto`), modes and projection.
"""

from __future__ import annotations

import contextlib
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import numpy as np

from myork.bench.chapter_6 import GALERKIN, MODES, MOTIONS, PATHS, LoadPath, Motion
from myork.bench.runs import lattice
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback
from myork.core.scene import Scene
from myork.core.states import Fields
from myork.errors import ConvergenceError
from myork.files import INPUTS
from myork.reduced_fields import ReducedFields
from myork.report.bodies import reduced_figure
from myork.rom.basis import proper_orthogonal_modes, unit_states
from myork.rom.check import measure, solve_tests, started
from myork.rom.model import ReducedModel
from myork.rom.parameters import spread_points
from myork.rom.study import PathStates, reduced_fields, reduced_path
from myork.stations.build import build
from myork.stations.segment import segment
from myork.types import F64

__all__ = ["dense_iteration", "muscle_model", "run", "timed"]

_Value = TypeVar("_Value")

#: The trained model: a block with inclined fibers, and the range of its parameters
_TRAINED = (
    *lattice((5, 5, 9)),
    "material.muscle.fiber=[0.3420201433256687, 0.0, 0.9396926207859084]",
)
_RANGE = {
    "load.activation": (0.0, 1.0),
    "boundary.z1.u_z": (-0.2, 0.3),
    "material.muscle.sigma_max": (20.0, 40.0),
}
_QUICK_TRAINED = (*lattice((4, 4, 6)), _TRAINED[2])
_QUICK_RANGE = {"load.activation": (0.0, 0.3)}
_SEED = 7919


class _Full(NamedTuple):
    """States of the full model, their modes, those of unit states, and what they took."""

    path: PathStates
    cpu: float
    wall: float
    iterations: int
    modes: F64
    unit_modes: F64
    modes_s: float


class _Path(NamedTuple):
    """All models of a path, its proper orthogonal values, and states that are drawn by modes."""

    cases: list[dict[str, Any]]
    values: F64
    drawn: list[tuple[int, ReducedFields]]
    units: dict[str, str]


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Reduce all problems; see `myork.bench` for the result."""
    motions = [case for motion in MOTIONS for case in _motion_cases(motion, progress)]
    cases, decays, pictures = [], [], []
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as folder:
        model = Path(folder)
        paths = [path for path in PATHS if not quick or path.deck != "mg_muscle"]
        weak = [path for path in GALERKIN if not quick or path.deck != "mg_muscle"]
        if not quick:
            progress("medial gastrocnemius: from the phantom's images to points")
            muscle_model(model)
        for path in paths:
            found = _path_cases(path, model, progress, quick, strong=True)
            cases += found.cases
            decays.append((path.name, found.values))
            for r, fields in found.drawn:
                pictures += _picture(out, path, r, fields, found.units, progress)
        for path in weak:
            cases += _path_cases(path, model, progress, quick, strong=False).cases
    trained = _trained_cases(progress, quick)
    return {
        "title": "Reduced models: chapter 6, and models that outlive it",
        "about": __doc__,
        "motions": motions,
        "cases": cases,
        "trained": trained,
        "tables": [
            table(_MOTION_CAPTION, _MOTION_COLUMNS, motions),
            table(_ERROR_CAPTION, _ERROR_COLUMNS, [c for c in cases if c["shown"] == "errors"]),
            table(_TIME_CAPTION, _TIME_COLUMNS, [c for c in cases if c["model"]]),
            table(_TRAINED_CAPTION, _TRAINED_COLUMNS, trained),
        ],
        "plots": [*_error_plots(cases), _decay_plot(decays)],
        "pictures": pictures,
    }


def muscle_model(out: Path) -> None:
    """Write the model of `mg_muscle.toml` to a folder, from the phantom's images."""
    for station in (segment, build):
        station(INPUTS / "mg_muscle.toml", out, threads=1)


def timed(call: Callable[[], _Value]) -> tuple[_Value, float, float]:
    """What a call returns, its processor time and its wall time [s]."""
    wall, cpu = time.perf_counter(), time.process_time()
    value = call()
    return value, time.process_time() - cpu, time.perf_counter() - wall


# ---- motions: tables 6.1 and 6.2 -----------------------------------------------------------------


def _motion_cases(motion: Motion, progress: ProgressCallback) -> list[dict[str, Any]]:
    """A motion in the span of its modes, by QR and by Cholesky's factor."""
    progress(motion.name)
    cases = []
    with Scene(INPUTS / f"{motion.deck}.toml", motion.overrides, threads=1) as scene:
        states = scene.solve(error=False)
        full = PathStates.of(scene, states.x, states.load)
        modes, values = proper_orthogonal_modes(states.x)
        for k, r in enumerate(MODES):
            case: dict[str, Any] = {"name": motion.name, "r": r}
            case["energy_lost"] = float(max(1.0 - values[:r].sum() / values.sum(), 0.0))
            if motion.published:
                case["published_e1"] = motion.published[k]
            for solver, published in (("qr", False), ("cholesky", True)):
                found, _ = reduced_path(
                    scene, full, modes[:, :r], motion.projection, published=published
                )
                case |= {f"e1_{solver}": found["e1"], "best_e1": found["best_e1"]}
            case["full_error"] = states.errors.get("relative_L2")
            cases.append(case)
    return cases


_MOTION_CAPTION = (
    "Tables 6.1 and 6.2: e1 (6.51) of 30 states. The error of the modes is that of the full states "
    "projected on them; the lost energy is what (6.32) lacks of 1; the error of the full solution "
    "at the end is against d'Alembert's."
)
_MOTION_COLUMNS: Columns = (
    ("problem", "name"),
    ("r", "r"),
    ("e1 published", "published_e1"),
    ("e1, QR", "e1_qr"),
    ("e1, Cholesky", "e1_cholesky"),
    ("error of the modes", "best_e1"),
    ("lost energy", "energy_lost"),
    ("error of the full solution", "full_error"),
)


# ---- paths of loads: tables 6.3 to 6.10 ----------------------------------------------------------


def _path_cases(
    path: LoadPath, model: Path, progress: ProgressCallback, quick: bool, *, strong: bool
) -> _Path:
    """Full and reduced models of a path."""
    form = "collocation" if strong else "Galerkin form"
    progress(f"{path.name}, {form}: full model")
    overrides = (*path.overrides, *(path.quick if quick else ()))
    with Scene(INPUTS / f"{path.deck}.toml", overrides, model, threads=1) as scene:
        states, cpu, wall = timed(lambda: scene.solve(error=False))
        all_states = PathStates.of(scene, states.x, states.load)
        (modes, values), _, modes_s = timed(lambda: proper_orthogonal_modes(states.x))
        unit, _ = proper_orthogonal_modes(unit_states(states.x))
        iterations = int(states.iterations.sum())
        full = _Full(all_states, cpu, wall, iterations, modes, unit, modes_s)
        cases = [_full_case(path, form, scene, full)]
        ways = ["full", "reduced"] if strong else ["projected"]
        last: dict[int, Fields] = {}
        for way in ways:
            for k, r in enumerate(path.modes):
                progress(f"{path.name}, {form}: r = {r}, rows {way}")
                cases.append(_reduced_case(path, form, scene, full, k, way, last))
        drawn = [
            (r, reduced_fields(scene, [r], [full.path.fields[-1], last[r]]))
            for r in path.drawn[1]
            if r in last
        ]
        if strong:
            # last: the scene keeps the single load step
            cases.insert(1, _dense_case(path, form, scene, full))
    dense = cases[1]["cpu"] if strong else full.cpu
    for case in cases:
        if case["cpu"] is not None:
            case["saved"] = 100.0 * (1.0 - case["cpu"] / dense)
    return _Path(cases, values, drawn, dict(scene.deck["result_units"]))


def _full_case(path: LoadPath, form: str, scene: Scene, full: _Full) -> dict[str, Any]:
    return {
        "name": path.name,
        "form": form,
        "shown": "",
        "model": "full, auto",
        "dofs": scene.dofs,
        "rows": scene.rows,
        "states": len(full.path.x),
        "iterations": full.iterations,
        "cpu": full.cpu,
        "wall": full.wall,
    }


def _dense_case(path: LoadPath, form: str, scene: Scene, full: _Full) -> dict[str, Any]:
    """The full model by dense QR: one iteration at full load, times their number."""
    cpu, wall = dense_iteration(scene, full.path.x[-1])
    case = _full_case(path, form, scene, full)
    return case | {
        "model": "full, dgels",
        "cpu": cpu * full.iterations,
        "wall": wall * full.iterations,
    }


def dense_iteration(scene: Scene, start: F64) -> tuple[float, float]:
    """Processor and wall time of an iteration at full load by dense QR [s].

    The scene keeps a single load step.
    """
    scene.update({"load.steps": 1, "load.max_halvings": 0, "solver.max_iterations": 1})

    def once() -> None:
        # one iteration seldom converges, and need not
        with contextlib.suppress(ConvergenceError):
            scene.solve("dgels", error=False, start=start)

    _, cpu, wall = timed(once)
    return cpu, wall


def _reduced_case(
    path: LoadPath,
    form: str,
    scene: Scene,
    full: _Full,
    k: int,
    way: str,
    last: dict[int, Fields],
) -> dict[str, Any]:
    """One reduced model with modes of the states; the error with modes of unit states beside it.

    Its last fields are added to `last` by the number of modes.
    """
    r = path.modes[k]
    case = _full_case(path, form, scene, full) | {
        "model": f"r = {r}, " + ("Galerkin" if way == "projected" else f"LSG, rows {way}"),
        "r": r,
    }
    try:
        found, last[r] = reduced_path(scene, full.path, full.modes[:, :r], published=way == "full")
    except ConvergenceError as reason:
        return case | {"outcome": str(reason), "iterations": None, "cpu": None, "wall": None}
    errors = ("e1", "e2", "force_error")
    case |= {
        "iterations": sum(found["iterations"]),
        "cpu": found["cpu_s"],
        "wall": found["online_s"],
        "offline": full.modes_s + found["offline_s"],
        **{name: found[name] for name in errors},
    }
    if full.cpu > found["cpu_s"]:
        case["pays_after"] = (full.cpu + case["offline"]) / (full.cpu - found["cpu_s"])
    if way == "full":
        return case
    case |= {"shown": "errors", "best_e1": found["best_e1"]}
    if path.e1:
        case |= {"published_e1": path.e1[k], "published_e2": path.e2[k]}
    other, _ = reduced_path(scene, full.path, full.unit_modes[:, :r])
    return case | {f"{name}_unit": other[name] for name in errors}


_ERROR_CAPTION = (
    "Tables 6.4, 6.6, 6.8 and 6.10: e1 (6.70) and e2 (6.72), summed over the load steps. Unit "
    "states: each snapshot divided by its norm. The error of the modes is e1 of the full states "
    "projected on them. The forces are those of the probes, relative to the largest."
)
_ERROR_COLUMNS: Columns = (
    ("problem", "name"),
    ("form", "form"),
    ("r", "r"),
    ("e1 published", "published_e1"),
    ("e1", "e1"),
    ("e1, unit states", "e1_unit"),
    ("error of the modes", "best_e1"),
    ("e2 published", "published_e2"),
    ("e2", "e2"),
    ("e2, unit states", "e2_unit"),
    ("force error", "force_error"),
)
_TIME_CAPTION = (
    "Tables 6.3, 6.5, 6.7 and 6.9: times of the whole path on one thread. LSG, rows full: "
    "assembled in full, then projected, and Cholesky's factor, as published; rows reduced: formed "
    "in the span of the modes, and QR. The share of time saved is against dense QR, beside the "
    "published one by `myork reproduce 6.3 6.5 6.7 6.9`; in the Galerkin form against the full "
    "model."
)
_TIME_COLUMNS: Columns = (
    ("problem", "name"),
    ("form", "form"),
    ("unknowns", "dofs"),
    ("model", "model"),
    ("iterations", lambda case: case.get("outcome", case["iterations"])),
    ("CPU [s]", "cpu"),
    ("wall [s]", "wall"),
    ("saved [%]", "saved"),
    ("modes and projection [s]", "offline"),
    ("pays after solves", "pays_after"),
)


# ---- a trained model -----------------------------------------------------------------------------


def _trained_cases(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Regression, corrections and converged states of a trained model, sampled and not."""
    deck = INPUTS / "muscle_block.toml"
    overrides, ranges = (_QUICK_TRAINED, _QUICK_RANGE) if quick else (_TRAINED, _RANGE)
    rom, offline, _ = timed(
        lambda: ReducedModel.train(
            deck,
            ranges,
            overrides=overrides,
            full_solves=6 if quick else 60,
            tests=0,
            threads=1,
            progress=progress,
        )
    )
    full = rom.full_model()
    values = spread_points(rom.parameters, 3 if quick else 24, _SEED)
    every = rom.with_all_cells()
    found = rom.batch(values)

    def from_reduced(_: F64) -> list[F64 | None]:
        return started(found.amplitudes, found.converged, rom.basis)

    def from_rest(_: F64) -> list[F64 | None]:
        return [None] * len(values)

    cases: list[dict[str, Any]] = []
    for name, guess in (
        ("full, from the reduced state", from_reduced),
        ("full, from rest", from_rest),
    ):
        tests = solve_tests(full, rom.parameters, values, _SEED, guess, progress)
        cpu = float(np.mean([state.cpu_s for state in tests.states]))
        cases.insert(0, {"model": name, "points": len(tests.states), "cpu_us": 1e6 * cpu})
    kept, cells = rom.head["cells"]["kept"], rom.head["cells"]["all"]
    ways: Sequence[tuple[str, ReducedModel, int | str, int]] = (
        ("regression alone", rom, 0, 0),
        ("one correction, sampled", rom, 1, kept),
        ("converged, sampled", rom, "converged", kept),
        ("converged, all cells", every, "converged", cells),
    )
    for name, model, corrections, count in ways:
        # the first call makes what all share
        model.batch(tests.values[:1], corrections)
        case = measure(model, tests, corrections) | {"model": name, "cells": count}
        if corrections != "converged":
            # nothing says whether a fixed number of corrections is enough
            del case["failed"], case["indicator_ratio"]
        saved = cpu - 1e-6 * case["cpu_us_per_state"]
        cases.append(
            case
            | {
                "cpu_us": case["cpu_us_per_state"],
                "faster": 1e6 * cpu / max(case["cpu_us_per_state"], 1.0),
                "offline": offline,
                "pays_after": offline / max(saved, 1e-9),
            }
        )
    return cases


_TRAINED_CAPTION = (
    "A block of muscle with fibers inclined by 20°, trained for activation, length and sigma_max, "
    "at parameters that the training did not see: errors of displacement (L2 over the body) and "
    "force, each relative to its own state, forces not below a twentieth of the largest. Times are "
    "of a state; faster, and after how many solves the training is paid, are against the full "
    "model from rest, in as many load steps as it needs. The training is full solves, modes and "
    "cells together."
)
_TRAINED_COLUMNS: Columns = (
    ("model", "model"),
    ("points", "points"),
    ("modes", "modes"),
    ("cells", "cells"),
    ("failed", "failed"),
    ("u median", "u.median"),
    ("95 %", "u.p95"),
    ("maximum", "u.max"),
    ("force median", "force.median"),
    ("95 %", "force.p95"),
    ("maximum", "force.max"),
    ("u maximum, of the largest", "u.max_of_largest"),
    ("estimated over true, least", "indicator_ratio.min"),
    ("largest", "indicator_ratio.max"),
    ("CPU [us]", "cpu_us"),
    ("faster", "faster"),
    ("training CPU [s]", "offline"),
    ("pays after solves", "pays_after"),
)


# ---- pictures ------------------------------------------------------------------------------------


def _picture(
    out: Path,
    path: LoadPath,
    r: int,
    fields: ReducedFields,
    units: Mapping[str, str],
    progress: ProgressCallback,
) -> list[dict[str, str]]:
    """The last state beside that of the full model, as a report shows it."""
    file = f"rom_{path.deck}_{r}.png"
    reduced_figure(fields, 0, units).savefig(out / file, dpi=110, facecolor="white")
    caption = (
        f"{path.name.split(' (')[0]}, r = {r} ({path.drawn[0]}): the last state of the full and of "
        "the reduced model, deformed to scale, in one scale of colours, and their difference."
    )
    return [{"file": file, "caption": caption}]


def _error_plots(cases: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """e1 over the number of modes: published, ours, and ours with unit states; one each problem."""
    plots = []
    shown = [case for case in cases if case["shown"] == "errors" and case["form"] == "collocation"]
    for name in dict.fromkeys(case["name"] for case in shown):
        own = [case for case in shown if case["name"] == name]
        curves = (
            ("published", "published_e1"),
            ("MyoRK", "e1"),
            ("MyoRK, unit states", "e1_unit"),
            ("error of the modes", "best_e1"),
        )
        plots.append(
            {
                "title": f"Error e1 of reduced collocation: {name.split(' (')[0]}",
                "x": "modes r [-]",
                "y": "e1, summed over the load steps [-]",
                "scale": "log-y",
                "series": [
                    {
                        "name": label,
                        "x": [case["r"] for case in own if case.get(key)],
                        "y": [case[key] for case in own if case.get(key)],
                        "rival": label == "published",
                    }
                    for label, key in curves
                ],
            }
        )
    return plots


def _decay_plot(decays: Sequence[tuple[str, F64]]) -> dict[str, Any]:
    """Figures 6.9, 6.11, 6.14 and 6.17."""
    series = []
    for name, values in decays:
        share = values / values[0]
        kept = share > np.finfo(float).eps ** 2
        series.append(
            {
                "name": name.split(" (")[0],
                "x": (np.flatnonzero(kept) + 1).tolist(),
                "y": share[kept].tolist(),
            }
        )
    return {
        "title": "Decay of proper orthogonal values (figures 6.9, 6.11, 6.14, 6.17)",
        "x": "number [-]",
        "y": "value over the largest [-]",
        "scale": "log-y",
        "series": series,
    }
