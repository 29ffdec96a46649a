"""From a deck to reduced models with their errors and timings."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.scene import Fields, Scene, States, pod_basis
from myork.errors import InputError
from myork.rom.errors_of import displacement_error, gradient_error, largest_error
from myork.summary import update_summary

__all__ = ["run_rom"]

# The reduced least squares problem: Householder QR, or Cholesky of (A'U)^T A'U (6.67).
_SOLVERS = {"qr": "dgels", "cholesky": "normal"}


def run_rom(
    deck: str | Path | Mapping[str, Any],
    out: str | Path,
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Solve the full model, reduce it, and compare.

    The snapshots are the converged coefficients of all load steps; the modes come from their
    singular values. Each reduced model solves the same load steps again.

    Parameters
    ----------
    deck : str, Path or mapping
        Deck file, or its tables as data; the table `rom` says how many modes.
    out : str or Path
        Folder of `summary.json`, to which the entry `rom` is added.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    threads : int, optional
        Number of threads; default all cores.
    progress : callable
        Called with every line of progress.

    Returns
    -------
    dict
        The entry `rom` of the summary: `snapshots`, `pov`, `full`, `models`.

    Raises
    ------
    InputError
        The deck is wrong, or more modes than snapshots are asked for.
    ConvergenceError
        The full or a reduced model did not converge.
    """
    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    with _open(deck, overrides, out, threads) as scene:
        study = _study(scene, progress)
    update_summary(out, {"title": scene.deck["title"], "units": scene.deck["units"], "rom": study})
    return study


def _open(
    deck: str | Path | Mapping[str, Any], overrides: Sequence[str], out: Path, threads: int | None
) -> Scene:
    """Scene of a deck that is a file or data."""
    if isinstance(deck, Mapping):
        return Scene.from_tables(deck, overrides=overrides, out=out, threads=threads)
    return Scene(deck, overrides, out, threads)


def _study(scene: Scene, progress: ProgressCallback) -> dict[str, Any]:
    """Full solve, modes, reduced solves."""
    wanted = scene.deck["rom"]["modes"]
    limit = min(scene.steps, scene.dofs)
    if max(wanted) > limit:
        raise InputError(
            f"rom.modes: {max(wanted)} modes are wanted, but {scene.steps} load steps give at most "
            f"{limit}: take more load.steps or fewer modes"
        )
    progress(f"full model: {scene.dofs} unknowns, {scene.rows} equations")
    started = time.perf_counter()
    full = scene.solve(progress=progress)
    full_s = time.perf_counter() - started
    started = time.perf_counter()
    modes, values = pod_basis(full.x)
    pod_s = time.perf_counter() - started
    full_fields = [scene.fields(x, load) for x, load in zip(full.x, full.load, strict=True)]

    models = []
    for number, r in enumerate(wanted):
        model = _reduced(scene, full, full_fields, modes[:, :r])
        model["offline_s"] += pod_s
        model["speedup_vs_full"] = full_s / scene.steps / model["online_s_per_state"]
        models.append(model)
        progress(
            f"model {number + 1}/{len(wanted)}  r {r}  e1 {model['e1']:.2e}  e2 {model['e2']:.2e}  "
            f"speed-up {model['speedup_vs_full']:.0f}"
        )
    return {
        "snapshots": len(full.x),
        "pov": values.tolist(),
        "full": {
            "dofs": scene.dofs,
            "rows": scene.rows,
            "solver": scene.deck["solver"]["linear"],
            "seconds": full_s,
            "seconds_per_state": full_s / scene.steps,
            "iterations": full.iterations.tolist(),
            "load": full.load.tolist(),
            "probes": _named_probes(scene, full.x, full.load),
        },
        "models": models,
    }


def _reduced(
    scene: Scene, full: States, full_fields: list[Fields], modes: np.ndarray
) -> dict[str, Any]:
    """Solve a reduced model and compare it with the full one."""
    started = time.perf_counter()
    scene.reduce(modes)
    offline_s = time.perf_counter() - started
    started = time.perf_counter()
    states = scene.solve_reduced(_SOLVERS[scene.deck["rom"]["solver"]])
    online_s = time.perf_counter() - started
    x = states.x @ modes.T
    fields = [scene.fields(state, load) for state, load in zip(x, full.load, strict=True)]
    probes = _named_probes(scene, x, full.load)
    full_probes = _named_probes(scene, full.x, full.load)
    forces = [
        largest_error(np.array(full_probes[name]), np.array(probes[name]))
        for name in probes
        if _is_force(scene, name)
    ]
    return {
        "kind": "reduced",
        "r": modes.shape[1],
        "points": scene.collocation_points,
        "e1": displacement_error(full_fields, fields),
        "e2": gradient_error(full_fields, fields),
        "stress_error": largest_error(
            np.array([field.cauchy for field in full_fields]),
            np.array([field.cauchy for field in fields]),
        ),
        "force_error": max(forces) if forces else None,
        "offline_s": offline_s,
        "online_s": online_s,
        "online_s_per_state": online_s / scene.steps,
        "iterations": states.iterations.tolist(),
        "probes": probes,
    }


def _named_probes(scene: Scene, x: np.ndarray, load: np.ndarray) -> dict[str, Any]:
    """Probe values by name: a list of numbers, or of vectors."""
    values = scene.probes(x, load)
    named = {}
    for i, probe in enumerate(scene.deck.get("probe", [])):
        vector = probe["quantity"] in ("u", "force")
        named[probe["name"]] = (
            values[:, i, : scene.dimension] if vector else values[:, i, 0]
        ).tolist()
    return named


def _is_force(scene: Scene, name: str) -> bool:
    return any(p["name"] == name and "set" in p for p in scene.deck["probe"])
