"""From a deck to reduced models with their errors and timings."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.deck import load_deck, step_count, table_defaults
from myork.core.scene import Scene
from myork.core.states import Fields, States
from myork.errors import InputError
from myork.rom.basis import proper_orthogonal_modes
from myork.rom.probes import named_probes
from myork.stations.solve import refuse_other_model
from myork.summary import read_summary, renewing, update_summary
from myork.tables import NOT_TABLES, override_text
from myork.types import F64


def run_rom(
    deck: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Reduce the full model and compare both.

    The snapshots are the converged coefficients of all load steps of a solve, or of those that the
    deck chooses. The modes come from their singular values. Each reduced model solves all load
    steps again, whether or not they gave a snapshot. A deck with a single load step, such as those
    of the Galerkin form that give no number of steps, is solved in ten steps if more than one mode
    is wanted.

    - `deck`: deck file, or its tables as data; the table `rom` gives the numbers of modes
    - `out`: folder of `summary.json`, to which the entry `rom` is added
    - `overrides`: overrides of the deck, `"table.key=value"`
    - returns the entry `rom` of the summary: `snapshots`, `pov`, `full`, `models`
    - raises InputError: the deck is wrong, or more modes than snapshots are requested
    - raises ConvergenceError: the full or a reduced model did not converge
    """
    out = Path(out)
    asked, overrides = list(overrides), _with_steps(deck, overrides, progress)
    with renewing(out, "rom"), _open(deck, overrides, out, threads) as scene:
        refuse_other_model(scene.deck, out, asked)
        _check_modes(scene)
        progress(f"full model: {scene.dofs} unknowns, {scene.rows} equations")
        study = _study(scene, *_solved(scene, progress), progress)
        named = {
            "title": scene.deck["title"],
            "units": scene.deck["result_units"],
            "probe_units": scene.probe_units,
            "rom": study,
        }
        if "converged" not in read_summary(out):
            # no solve has recorded the request
            tables = {key: table for key, table in scene.deck.items() if key not in NOT_TABLES}
            named |= {"deck": tables, "dimension": scene.dimension, "overrides": asked}
        update_summary(out, named)
    return study


def _open(
    deck: str | Path | Mapping[str, Any], overrides: Sequence[str], out: Path, threads: int | None
) -> Scene:
    """Scene of a deck that is a file or data."""
    if isinstance(deck, Mapping):
        return Scene.from_tables(deck, overrides=overrides, out=out, threads=threads)
    return Scene(deck, overrides, out, threads)


def _solved(scene: Scene, progress: ProgressCallback) -> tuple[States, float]:
    """States of the full model, and wall time of the load steps without their checks [s]."""
    started = time.perf_counter()
    states = scene.solve(progress=progress, error=False)
    # a reduced state is not checked for warnings, and the largest stable time step of a motion is
    # not computed
    seconds = time.perf_counter() - started - states.checks_s
    for text in states.warnings:
        progress(f"warning: {text}")
    return states, states.solve_s if "dynamics" in scene.deck else seconds


def _with_steps(
    deck: str | Path | Mapping[str, Any], overrides: Sequence[str], progress: ProgressCallback
) -> Sequence[str]:
    """Overrides: as many states as modes, the penalty without given points."""
    tables = load_deck(deck, overrides, "rom")
    source = tables.get("geometry", {}).get("source")
    if source and tables.get("galerkin", {}).get("essential") == "transformation":
        said = load_deck(deck, [*overrides, override_text("geometry.source", source)], "rom")
        if said["galerkin"]["essential"] == "penalty":
            # exact prescription is only the default for unspecified points; modes need the penalty
            overrides = [*overrides, override_text("galerkin.essential", "penalty")]
    if "load" not in tables:
        return overrides
    steps, modes = step_count(tables), tables["rom"]["modes"]
    wanted = max(modes)
    if steps == tables["load"]["steps"]:
        if modes != table_defaults("rom")["modes"] or wanted <= steps:
            return overrides
        progress(f"rom.modes: {steps} load steps give at most {steps} modes")
        return [*overrides, override_text("rom.modes", sorted({min(n, steps) for n in modes}))]
    progress(
        f"rom.modes: one load step gives one snapshot, but {wanted} modes are requested: "
        f"using {steps} steps"
    )
    return [*overrides, f"load.steps={steps}"]


def _check_modes(scene: Scene) -> None:
    """Refuse too many modes, and decks without states, before anything is solved."""
    if "linear" in scene.deck and "dynamics" not in scene.deck:
        raise InputError(
            "reduced models are for nonlinear problems and motions: a static linear "
            "problem takes one solve, so there is nothing to gain"
        )
    wanted, limit = max(scene.deck["rom"]["modes"]), min(scene.steps, scene.dofs)
    if wanted > limit:
        raise InputError(
            f"rom.modes: {wanted} modes are requested, but {scene.steps} load steps give at most "
            f"{limit}: use more load.steps or fewer modes"
        )


def _study(
    scene: Scene, full: States, seconds: float, progress: ProgressCallback
) -> dict[str, Any]:
    """Modes and reduced models of the full states."""
    table = scene.deck["rom"]
    started = time.perf_counter()
    modes, values = proper_orthogonal_modes(full.x)
    basis_s = time.perf_counter() - started
    path = PathStates.of(scene, full.x, full.load)
    models = []
    wanted = list(dict.fromkeys(table["modes"]))
    for number, r in enumerate(wanted, start=1):
        found = reduced_path(scene, path, modes[:, :r])
        del found["cpu_s"]
        online = found["online_s"] / scene.steps
        model = {
            "kind": "galerkin" if scene.deck["scene"]["method"].startswith("rkpm") else "reduced",
            "r": r,
            "points": scene.collocation_points,
            **found,
            "offline_s": found["offline_s"] + basis_s,
            # (6.32)
            "energy": float(values[:r].sum() / values.sum()),
            "online_s_per_state": online,
            "speedup_vs_full": seconds / scene.steps / online,
        }
        models.append(model)
        gradients = "" if model["e2"] is None else f"  e2 {model['e2']:.2e}"
        progress(
            f"model {number}/{len(wanted)}  r {r}  e1 {model['e1']:.2e}{gradients}"
            f"  speed-up {model['speedup_vs_full']:.1f}"
        )
    return {
        "snapshots": len(full.x),
        "pov": values.tolist(),
        "full": {
            "dofs": scene.dofs,
            "rows": scene.rows,
            "solver": scene.deck["solver"]["linear"],
            "seconds": seconds,
            "seconds_per_state": seconds / scene.steps,
            "iterations": full.iterations.tolist(),
            "load": full.load.tolist(),
            "probes": path.probes,
        },
        "models": models,
    }


class PathStates(NamedTuple):
    """States along a load path, with the data that errors need."""

    x: F64  #: Unknowns of the full model, shape `(nstep, dofs)`
    load: F64  #: Fractions of the full load, shape `(nstep,)`
    fields: list[Fields]  #: Fields of each state
    probes: dict[str, Any]  #: Probes by name

    @classmethod
    def of(cls, scene: Scene, x: F64, load: F64) -> "PathStates":
        """The states of a scene."""
        fields = [scene.fields(state, at) for state, at in zip(x, load, strict=True)]
        return cls(x, load, fields, named_probes(scene, x, load))


def reduced_path(
    scene: Scene, full: PathStates, modes: F64, projection: str = "auto", *, published: bool = False
) -> dict[str, Any]:
    """Project a scene onto modes and solve all its load steps; errors and times.

    - `scene`: the full model
    - `full`: its states
    - `modes`: orthonormal columns, shape `(dofs, r)`
    - `projection`: as in `Scene.reduce`
    - `published`: rows assembled in full and then projected, and the Cholesky factor of (A'U)^T A'U
      (6.67), instead of rows in the span of the modes and Householder QR
    """
    started = time.perf_counter()
    scene.reduce(modes, projection, assembled=published)
    offline_s = time.perf_counter() - started
    started, cpu = time.perf_counter(), time.process_time()
    states = scene.solve_reduced("normal" if published else "dgels")
    online_s, cpu = time.perf_counter() - started, time.process_time() - cpu
    found = PathStates.of(scene, states.x @ modes.T, full.load)
    best = PathStates.of(scene, full.x @ modes @ modes.T, full.load)
    forces = [
        largest_error(np.array(full.probes[name]), np.array(found.probes[name]))
        for name in (probe["name"] for probe in scene.deck["probe"] if "set" in probe)
    ]
    return {
        "e1": displacement_error(full.fields, found.fields),
        # linear problems have displacement fields only
        "e2": None if "linear" in scene.deck else gradient_error(full.fields, found.fields),
        "stress_error": largest_error(
            np.array([field.cauchy for field in full.fields]),
            np.array([field.cauchy for field in found.fields]),
        ),
        "force_error": max(forces) if forces else None,
        "best_e1": displacement_error(full.fields, best.fields),
        "probes": found.probes,
        "offline_s": offline_s,
        "online_s": online_s,
        "cpu_s": cpu,
        "iterations": states.iterations.tolist(),
    }


def displacement_error(full: list[Fields], reduced: list[Fields]) -> float:
    """Error e1 of the displacement (6.70), (6.71), over time (6.51), (6.52) [-]."""
    return _relative([a.u for a in full], [b.u for b in reduced])


def gradient_error(full: list[Fields], reduced: list[Fields]) -> float:
    """Error e2 of the displacement gradient (6.72) [-].

    The norm is over all points and components. As printed, components are summed at each point
    before the norm is taken; the published numbers do not follow from such sums: for the tube with
    two modes these give 0.596, all components 0.2917, in agreement with table 6.6.
    """
    return _relative([a.f - np.eye(3) for a in full], [b.f - np.eye(3) for b in reduced])


def largest_error(full: F64, reduced: F64) -> float:
    """Largest difference over the largest value of the full model, NaN if one of them is [-]."""
    scale = float(np.abs(full).max())
    return float(np.abs(full - reduced).max()) / scale if scale != 0.0 else 0.0


def _relative(full: list[F64], reduced: list[F64]) -> float:
    """Sum over the steps of |full - reduced| / |full|."""
    return float(
        sum(
            np.linalg.norm(a - b) / np.linalg.norm(a)
            for a, b in zip(full, reduced, strict=True)
            if np.linalg.norm(a) > 0.0
        )
    )
