"""The arrays of a reduced model: modes, volume, few cells in place of all."""

from typing import Any

import numpy as np

from myork.console import ProgressCallback
from myork.core.online import triples
from myork.core.scene import Scene
from myork.rom.beyond import values_beyond
from myork.rom.modes import LARGE, Draft
from myork.rom.online import Regression, Solver
from myork.rom.parameters import spread_points
from myork.rom.places import place_arrays
from myork.rom.sampling import force_lifts, sample_cells, sample_forces
from myork.rom.setting import Setting, force_values
from myork.types import F64, I64

#: Solutions of the model with all cells that the cubature is trained on beside the full ones
VIRTUAL = 96
#: Tolerance of the cells that estimate the error, of that of the model: they are not to share it
_FINER = 0.7
#: Cells that are kept at most
_MOST_CELLS = 400


def finish(
    scene: Scene,
    setting: Setting,
    draft: Draft,
    tolerance: float,
    seed: int,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Arrays of the model: modes, volume, few cells."""
    basis, model, finer, known, amplitudes = draft
    m, r = basis.modes.shape[1], basis.r
    progress(f"{r} modes of {len(known.x)} states; they leave {basis.lost:.1e} of them")
    values = spread_points(setting.parameters, VIRTUAL, seed + 1)
    values = np.vstack([values, values_beyond(setting, seed)])
    answer = draft.solve(setting, values)
    good = answer.converged
    progress(f"{good.sum()} of {len(good)} states of the model with all cells converged")
    some = np.unique(np.linspace(0, len(known.values) - 1, VIRTUAL).astype(int))
    at = np.vstack([known.values[some], values[good]])
    where = np.vstack([amplitudes[some], np.zeros((int(good.sum()), m))])
    where[len(some) :, :r] = answer.amplitudes[good]
    kept = sample_cells(model, setting, at, where[:, :r], tolerance, seed, _MOST_CELLS)
    more = sample_cells(finer, setting, at, where, _FINER * tolerance, seed, _MOST_CELLS)
    progress(
        f"{len(kept[0])} of {len(setting.parts.weight)} cells (residual {kept[2]:.1e}), "
        f"{len(more[0])} for the estimate of the error"
    )
    lifts = force_lifts(model, setting, at, where[:, :r])
    whole = finer.cells
    if len(setting.parts.weight) > LARGE and len(setting.wanted):
        # forces are asked for at the states of few cells, and others as far off; how
        # the modes follow them is known by regression
        few = Solver(
            model._replace(cells=model.cells.sample(*kept[:2])), model.cells,
            np.zeros(0, np.int64), setting.threads,
        )  # fmt: skip
        rough = few.newton(setting.conditions(at), where[:, :r])[0]
        off = rough.amplitudes - where[:, :r]
        own = np.flatnonzero(rough.converged & np.isfinite(off).all(axis=1))
        order = np.random.default_rng(seed).permutation(own)
        near = np.vstack([where[:, :r], rough.amplitudes[own], where[own, :r] + off[order]])
        rows = np.concatenate([np.arange(len(at)), own, own])
        follow = np.vstack([lifts, _by_others(setting, at, lifts, order)[own], lifts[own]])
        force = sample_forces(model, setting, at[rows], near, follow, tolerance)
        whole = finer.cells.sample(*force[:2])
        progress(f"{len(force[0])} cells for the forces (residual {force[2]:.1e})")
    arrays: dict[str, Any] = {"modes": r, "indicator_modes": m, "wanted": setting.wanted}
    for name, one, cells in (
        ("online", model, model.cells.sample(*kept[:2])),
        ("indicator", finer, finer.cells.sample(*more[:2])),
    ):
        arrays |= {f"{name}/{key}": value for key, value in cells._asdict().items()}
        arrays |= {
            f"{name}/constant": one.constant,
            f"{name}/constant_slope": one.constant_slope,
            f"{name}/volume": triples(one.volume),
            f"{name}/volume_slope": one.volume_slope,
        }
    arrays |= {f"force/{key}": value for key, value in whole._asdict().items()}
    arrays |= {f"laws/{key}": value for key, value in setting.laws._asdict().items()}
    arrays |= {"lifts/parameters": at, "lifts/values": lifts}
    arrays |= {
        "training/parameters": known.values,
        "training/amplitudes": amplitudes,
        "training/forces": force_values(setting, known.probes),
    }
    arrays |= {"basis": basis.modes[:, :r], **_shapes(scene, basis.modes, r)}
    return arrays | place_arrays(scene, setting, basis.modes[:, :r], model, setting.stresses)


def _by_others(setting: Setting, at: F64, lifts: F64, order: I64) -> F64:
    """Lifts predicted by a regression through half of the others."""
    scale = np.array([p.high - p.low for p in setting.parameters])
    found = lifts.copy()
    for part, others in ((order[::2], order[1::2]), (order[1::2], order[::2])):
        if len(part) and len(others):
            found[part] = Regression(at[others], lifts[others], scale)(at[part])
    return found


def _shapes(scene: Scene, modes: F64, r: int) -> dict[str, F64]:
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
