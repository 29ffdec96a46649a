"""An output folder with everything a report can show; the numbers are made up, not solved."""

import csv
import json
from pathlib import Path
from typing import Any

import h5py
import nibabel
import numpy as np
import pytest

from tests.report.grids import lattice_of, surface_of

STEPS = 10
UNITS = {"force": "N", "length": "cm", "stress": "N/cm^2", "volume": "cm^3"}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A converged demo: segmentation, full solution and reduced models."""
    write_segmentation(tmp_path)
    write_results(tmp_path / "results.vtkhdf")
    write_history(tmp_path / "history.csv")
    (tmp_path / "summary.json").write_text(json.dumps(summary()))
    return tmp_path


def summary() -> dict[str, Any]:
    """Summary as the contract has it."""
    loads = np.arange(1, STEPS + 1) / STEPS
    force = -4.5 * loads / (0.5 + loads)
    reference = [-1.05, -2.14, -3.02]
    places = [0.2, 0.5, 1.0]
    values = np.interp(places, loads, force)
    return {
        "title": "Muscle block, fibers inclined 30° <test>",
        "deck_sha256": "9f" * 32,
        "version": "0.1.0",
        "units": UNITS,
        "method": "rkcm",
        "dimension": 3,
        "solver": {"asked": "auto", "used": "refined", "why": "no matrix in memory",
                   "backward_error": 3e-13, "reciprocal_condition": 2.7e-7},
        "source_points": 1377,
        "collocation_points": 9537,
        "dofs": 4131,
        "rows": 36411,
        "threads": 2,
        "converged": True,
        "verdict": {"state": "accepted", "reasons": ["no error estimate: none was wanted"]},
        "force_imbalance": 2e-13,
        "overrides": ["load.steps=10"],
        "probe_units": {"reaction": "N", "stress_zz": "N/cm^2", "tip": "cm"},
        "steps": [
            {
                "load": load,
                "activation": 0.3 * load,
                "iterations": 3,
                "newton_decrement": 1e-9,
                "min_J": 0.98,
                "max_J": 1.02,
                "probe_errors": {"reaction": 0.015},
                "probes": {
                    "reaction": force[number],
                    "stress_zz": -force[number] * 1.02,
                    "tip": [-0.087 * load, 0.001 * load, 0.02 * load**2],
                },
            }
            for number, load in enumerate(loads)
        ],
        "deck": {
            "probe": [
                {"name": "reaction", "quantity": "force_z", "set": "bottom"},
                {"name": "stress_zz", "quantity": "cauchy_zz", "point": [0.5, 0.5, 1.0]},
                {"name": "tip", "quantity": "u", "point": [1.0, 0.5, 1.0]},
            ]
        },
        "exact": {"stress_zz": {"value": 3.06, "reference": 3.0617, "relative_error": 5.5e-4}},
        "reference": {
            "reaction": {
                "load": places,
                "activation": [0.3 * place for place in places],
                "value": values.tolist(),
                "reference": reference,
                "relative_error": (np.abs(values - reference) / 3.02).tolist(),
                "source": "mesh-converged finite elements",
            }
        },
        "timings_s": {
            "shape": 0.4, "assemble": 3.1, "solve": 14.2, "output": 0.3, "total": 18.6
        },
        "memory_peak_bytes": 1.45e9,
        "warnings": ["2 islands with 14 voxels are connected to neither end: left out"],
        "rom": {
            "snapshots": 20,
            "full": {"load": loads.tolist(), "probes": {"reaction": force.tolist()}},
            "pov": (10.0 ** -np.linspace(0.0, 14.0, 20)).tolist(),
            "models": [
                {
                    "kind": kind,
                    "r": r,
                    "points": points,
                    "e1": e1 * worse,
                    "e2": 4 * e1 * worse,
                    "stress_error": None,
                    "probes": {"reaction": (force * (1 + e1)).tolist()},
                    "force_error": 2 * e1 * worse,
                    "offline_s": 2.5,
                    "online_s_per_state": 0.002 * r * points / 9537,
                    "speedup_vs_full": 800.0 / r * 9537 / points,
                    "speedup_vs_dgels": 4000.0 / r * 9537 / points,
                }
                for kind, points, worse in (("galerkin", 9537, 1.0), ("hyper", 300, 3.0))
                for r, e1 in ((1, 5e-2), (2, 6e-3), (10, 2e-6))
            ],
        },
        "segmentation": {
            "labels": {"muscle": {"pixels": 40211, "volume": 376.978}},
            "scores": {"muscle": {"dice": 0.973, "pcc": 0.968}},
            "iterations": 120,
            "energy": (1000.0 * np.exp(-np.arange(30) / 6.0) + 400.0).tolist(),
        },
    }  # fmt: skip


def write_results(path: Path, plane: bool = False) -> None:
    """A twisted and shortened block, in the layout of fortran/results/h5/rk_results.f90."""
    corners = np.meshgrid(
        np.linspace(0, 1, 13), np.linspace(0, 1, 13), [0.0] if plane else np.linspace(0, 2, 25)
    )
    points = np.stack([part.ravel() for part in corners], axis=1)
    loads = np.arange(STEPS + 1) / STEPS
    n = len(points)
    with h5py.File(path, "w") as file:
        vtk, own = file.create_group("VTKHDF"), file.create_group("MyoRK")
        vtk["Points"] = points
        fields: dict[str, list[np.ndarray]] = {"u": [], "principal_stress": [], "J": []}
        for load in loads:
            angle = 0.6 * load * points[:, 2]
            x, y = points[:, 0] - 0.5, points[:, 1] - 0.5
            moved = np.stack(
                [
                    np.cos(angle) * x - np.sin(angle) * y + 0.5,
                    np.sin(angle) * x + np.cos(angle) * y + 0.5 + 0.3 * load * points[:, 0],
                    (1 - 0.15 * load) * points[:, 2],
                ],
                axis=1,
            )
            fields["u"].append(moved - points)
            stress = load * (1 + points[:, 2] + x * y * 8)
            fields["principal_stress"].append(np.stack([stress, stress / 2, -stress], axis=1))
            fields["J"].append(1.0 + 0.02 * load * np.sin(6 * x) * np.cos(3 * points[:, 2]))
        for name, steps in fields.items():
            vtk[f"PointData/{name}"] = np.concatenate(steps)
            vtk[f"Steps/PointDataOffsets/{name}"] = np.arange(len(loads)) * n
        vtk["Steps"].attrs["NSteps"] = len(loads)
        own["lattice"] = lattice_of(points)
        own["surface"] = surface_of(own["lattice"][:])
        own["load"] = loads
        own["activation"] = 0.3 * loads


def write_history(path: Path) -> None:
    """Three iterations a step."""
    names = "step,load,iteration,residual,gradient,step_norm,min_J,max_J,backward_error,solver"
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([*names.split(","), "seconds"])
        for step in range(1, STEPS + 1):
            for iteration in range(1, 4):
                small = 10.0 ** (-3 * iteration)
                writer.writerow(
                    [step, step / STEPS, iteration, 0.1 + small, 50 * small, small,
                     1 - 0.002 * step, 1 + 0.002 * step, 3e-13, "refined", 0.6]
                )  # fmt: skip


def write_segmentation(folder: Path) -> None:
    """A conical muscle in a bright calf, its voxel axes left, posterior, superior."""
    shape, spacing = (64, 60, 15), np.array([1.5, 1.5, 6.0])
    i, j, k = np.indices(shape)
    x, y = (i - 34) * spacing[0], (j - 28) * spacing[1]
    muscle = x**2 / 1.6 + y**2 < (22 - 0.8 * k) ** 2
    muscle &= (k > 1) & (k < 14)
    image = 200.0 * ((x**2 + y**2) < 40**2) - 130.0 * muscle
    image += np.random.default_rng(1).normal(0.0, 8.0, shape)
    fibers = np.where(muscle[..., None], [0.35, 0.2, 0.915], 0.0)
    affine = np.diag([-spacing[0], -spacing[1], spacing[2], 1.0])
    for name, data in (
        ("segmentation", muscle.astype(np.uint8)),
        ("anatomy", image.astype(np.float32)),
        ("fibers", fibers.astype(np.float32)),
    ):
        file = nibabel.Nifti1Image(data, affine)
        file.header.set_xyzt_units("mm")
        nibabel.save(file, folder / f"{name}.nii.gz")
    (folder / "segmentation.json").write_text('{"muscle": 1}')
