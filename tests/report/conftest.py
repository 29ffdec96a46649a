"""An output folder with everything a report can show; the numbers of its summary are made up."""

import json
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork.records import Labels
from myork.stations.solve import run_deck
from tests.images import affine_of, save
from tests.scenes import RUBBER, box, held, probes, scene

STEPS = 10
UNITS = {"force": "N", "length": "cm", "stress": "N/cm^2", "volume": "cm^3"}


@pytest.fixture(scope="session")
def block(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A solved block that is twisted and shortened."""
    out = tmp_path_factory.mktemp("block")
    turn = {"u_z": -0.3, "rotation": 30, "axis": [0, 0, 1], "about": [0.5, 0.5, 2]}
    tables = scene(
        "rkpm-gauss", box(4, 4, 7, size=[1, 1, 2]), material=[RUBBER], load={"steps": 4},
        boundary=[held("z0"), {"set": "z1", **turn}],
    )  # fmt: skip
    run_deck(tables, out, threads=1, error=False)
    return out


@pytest.fixture
def folder(tmp_path: Path, block: Path) -> Path:
    """A converged demo: segmentation, full solution and reduced models."""
    write_segmentation(tmp_path)
    shutil.copy(block / "results.vtkhdf", tmp_path)
    (tmp_path / "summary.json").write_text(json.dumps(summary()))
    return tmp_path


def summary() -> dict[str, Any]:
    loads = np.arange(1, STEPS + 1) / STEPS
    force = -4.5 * loads / (0.5 + loads)
    places, reference = [0.2, 0.5, 1.0], [-1.05, -2.14, -3.02]
    values = np.interp(places, loads, force)
    return {
        "title": "Muscle block, fibers inclined 30° <test>", "deck_sha256": "9f" * 32,
        "version": "0.1.0", "units": UNITS, "method": "rkcm", "dimension": 3,
        "solver": {"asked": "auto", "used": "refined", "why": "no matrix in memory",
                   "backward_error": 3e-13, "reciprocal_condition": 2.7e-7},
        "source_points": 1377, "collocation_points": 9537, "dofs": 4131, "rows": 36411,
        "threads": 2, "converged": True,
        "verdict": {"state": "accepted", "reasons": ["no error estimate: none was wanted"]},
        "force_imbalance": 2e-13, "overrides": ["load.steps=10"],
        "probe_units": {"reaction": "N", "stress_zz": "N/cm^2", "tip": "cm"},
        "steps": [
            {
                "load": load, "activation": 0.3 * load, "iterations": 3,
                "newton_decrement": 1e-9, "min_J": 0.98, "max_J": 1.02,
                "probe_errors": {"reaction": 0.015},
                "probes": {"reaction": pull, "stress_zz": -pull * 1.02,
                           "tip": [-0.087 * load, 0.001 * load, 0.02 * load**2]},
            }
            for load, pull in zip(loads, force, strict=True)
        ],
        "deck": {"probe": probes("reaction force_z bottom", "stress_zz cauchy_zz 0.5 0.5 1",
                                 "tip u 1 0.5 1")},
        "exact": {"stress_zz": {"value": 3.06, "reference": 3.0617, "relative_error": 5.5e-4}},
        "reference": {"reaction": {
            "load": places, "activation": [0.3 * place for place in places],
            "value": values.tolist(), "reference": reference,
            "relative_error": (np.abs(values - reference) / 3.02).tolist(),
            "source": "mesh-converged finite elements",
        }},
        "timings_s": {"shape": 0.4, "assemble": 3.1, "solve": 14.2, "output": 0.3, "total": 18.6},
        "memory_peak_bytes": 1.45e9,
        "warnings": ["2 islands with 14 voxels are connected to neither end: left out"],
        "rom": {
            "snapshots": 20, "pov": (10.0 ** -np.linspace(0.0, 14.0, 20)).tolist(),
            "full": {"load": loads.tolist(), "probes": {"reaction": force.tolist()}},
            "models": [
                {
                    "kind": kind, "r": r, "points": points,
                    "e1": e1 * worse, "e2": 4 * e1 * worse, "stress_error": None,
                    "probes": {"reaction": (force * (1 + e1)).tolist()},
                    "force_error": 2 * e1 * worse, "offline_s": 2.5,
                    "online_s_per_state": 0.002 * r * points / 9537,
                    "speedup_vs_full": 800.0 / r * 9537 / points,
                }
                for kind, points, worse in (("galerkin", 9537, 1.0), ("reduced", 300, 3.0))
                for r, e1 in ((1, 5e-2), (2, 6e-3), (10, 2e-6))
            ],
        },
        "segmentation": {
            "labels": {"muscle": {"pixels": 40211, "volume": 376.978}},
            "scores": {"muscle": {"dice": 0.973, "pcc": 0.968}}, "iterations": 120,
            "energy": (1000.0 * np.exp(-np.arange(30) / 6.0) + 400.0).tolist(),
        },
    }  # fmt: skip


def write_segmentation(folder: Path) -> None:
    """A conical muscle in a bright calf, its voxel axes left, posterior, superior."""
    shape, spacing = (64, 60, 15), np.array([1.5, 1.5, 6.0])
    i, j, k = np.indices(shape)
    x, y = (i - 34) * spacing[0], (j - 28) * spacing[1]
    muscle = (x**2 / 1.6 + y**2 < (22 - 0.8 * k) ** 2) & (k > 1) & (k < 14)
    image = 200.0 * ((x**2 + y**2) < 40**2) - 130.0 * muscle
    image += np.random.default_rng(1).normal(0.0, 8.0, shape)
    fibers = np.where(muscle[..., None], [0.35, 0.2, 0.915], 0.0)
    affine = affine_of(spacing * [-1, -1, 1])
    labels = Labels(muscle.astype(np.int32), affine, {1: "muscle"})
    save(folder, affine, segmentation=labels, anatomy=image, fibers=fibers)
