"""Warnings and checks are the same in memory, by `run_deck` and by the executable; ellipticity."""

import json
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from myork import Scene, run_deck
from myork.bench.runs import lattice
from myork.core import material as core_material
from myork.core.states import States
from myork.errors import ConvergenceError, InputError, MyorkError, RefusedError
from tests.scenes import execute

SMALL_MUSCLE = (*lattice([3, 3, 5]), "load.steps=2", "load.activation=0.3")

#: Deck, overrides, verdict, a part of each warning in its order, and the error that ends the run
CASES: dict[str, tuple[str, Any, str, Any, Any]] = {
    "stiff, and right in the displacement form": (
        "uniaxial_tension", ("scene.method=rkcm", *lattice([3, 3, 3])), "accepted", (), None,
    ),
    "too stiff for the displacement form": (
        "shear_3d", ("scene.method=rkcm", "material.K=1e4", *lattice([3, 3, 3]), "load.steps=2"),
        "refused", ("more work than the forces", "probe top_force differs"), RefusedError,
    ),
    "a coarse tube": (
        "tube", ("scene.method=rkcm", *lattice([3, 9]), "load.steps=4"), "refused",
        ("do not balance", "of their norm from", "probe radial_stress differs"), RefusedError,
    ),
    "ellipticity, nodal integration": (
        "muscle_fibers", (*SMALL_MUSCLE, "geometry.source=[5,5,9]", "scene.method=rkpm-scni",
                          "approximation.order=1", "approximation.support=2"),
        "doubtful", ("loses ellipticity at", "J at points is"), None,
    ),
    "ended early": (
        "shear_2d", ("load.steps=2", "load.max_halvings=0", "solver.max_iterations=3"), "refused",
        ("did not converge at load 0.5",), ConvergenceError,
    ),
    "a linear problem with too few equations": (
        "poisson_2d", ("geometry.source=[9,9]", "geometry.collocation=[5,5]"), "refused",
        ("fewer equations (25) than unknowns (81)",), InputError,
    ),
}  # fmt: skip


def in_memory(deck: Path, overrides: tuple[str, ...]) -> tuple[States, type[MyorkError] | None]:
    """States, and the error where the run did not get to its end."""
    with Scene(deck, overrides, threads=1) as scene:
        try:
            return scene.solve(), None
        except MyorkError as ended:
            assert scene.states is not None
            return scene.states, type(ended)


def by_executable(deck: Path, overrides: tuple[str, ...], out: Path) -> dict[str, Any]:
    return execute(deck, out, "-q", sets=overrides)[0]


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_all_ways_give_the_same_list(case: str, inputs: Path, tmp_path: Path) -> None:
    name, overrides, verdict, parts, error = CASES[case]
    deck = inputs / f"{name}.toml"
    states, ended_by = in_memory(deck, overrides)
    warnings = states.warnings
    # a refused answer is one, and whole: nothing is raised where it is at hand
    assert ended_by is (None if error is RefusedError else error)
    assert states.verdict == verdict, states.reasons
    assert len(warnings) == len(parts), warnings
    assert all(part in text for part, text in zip(parts, warnings, strict=True)), warnings
    summary = by_executable(deck, overrides, tmp_path / "executable")
    assert summary["warnings"] == warnings
    assert summary["verdict"] == {"state": verdict, "reasons": states.reasons}
    with pytest.raises(error) if error else nullcontext() as ended:
        run_deck(deck, tmp_path / "run", overrides=overrides, threads=1, verbosity=-1)
    if error:
        assert ended.type is error
    if error is RefusedError:
        assert all(reason in str(ended.value) for reason in states.reasons)
    through = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))
    assert through["warnings"] == warnings
    # the file has all digits of a number
    assert states.force_imbalance == summary["force_imbalance"]
    mismatch = None if np.isnan(states.work_mismatch) else states.work_mismatch
    assert summary.get("work_mismatch") == mismatch
    for k, step in enumerate(summary["steps"]):
        assert states.min_acoustic[k] == step["min_acoustic"]["value"]
        assert states.min_acoustic_point[k].tolist() == step["min_acoustic"]["point"]


def test_errors_of_a_linear_problem(inputs: Path, tmp_path: Path) -> None:
    overrides = lattice([9, 9])
    states, _ = in_memory(inputs / "poisson_2d.toml", overrides)
    summary = by_executable(inputs / "poisson_2d.toml", overrides, tmp_path)
    assert states.warnings == summary["warnings"] == []
    assert set(states.errors) == {"L2", "H1", "relative_L2", "relative_H1"}
    assert states.errors == summary["errors"]
    assert states.force_imbalance == 0
    assert np.isnan(states.min_acoustic).all() and np.isnan(states.min_acoustic_point).all()


def test_warnings_are_those_of_the_last_solve(inputs: Path) -> None:
    """A reduced model has no checks of its own."""
    overrides = CASES["a coarse tube"][1]
    with Scene(inputs / "tube.toml", overrides, threads=1) as scene:
        full = scene.solve()
        assert len(full.warnings) == 3 and full.checks_s > 0
        scene.reduce(np.linalg.qr(full.x.T)[0])
        reduced = scene.solve_reduced("dgels")
        assert reduced.warnings == [] and reduced.checks_s == 0
        assert reduced.verdict == "" and reduced.reasons == []
        assert np.isnan(reduced.min_acoustic).all()


SMALL = (
    "geometry.size=[1,1,1]", "geometry.source=[3,3,3]", "geometry.collocation=[5,5,5]",
    "load.steps=4", "boundary.x1.u_x=0.6", "probe.stress.point=[0.5,0.5,0.5]",
)  # fmt: skip
MODULI = {"A10": 37.3, "A20": -3.1, "A30": 0.5}


def solve(inputs: Path, out: Path, *overrides: str) -> dict[str, Any]:
    deck = inputs / "uniaxial_tension.toml"
    summary, done = execute(deck, out, "-q", sets=(*SMALL, *overrides))
    assert done.returncode == 0, done.stderr
    return summary


def dense_search(f: np.ndarray, bulk: float, **moduli: float) -> float:
    """Least eigenvalue over many directions; an infinite K leaves motions across cof F N."""
    rigid = bulk == np.inf
    material = core_material.Material("rubber", bulk, **moduli)
    flat = np.zeros((1, 3, 3, 3))
    c4 = core_material.strong(material, f[np.newaxis], flat, volumetric=not rigid).tangent[0]
    n = np.random.default_rng(1).normal(size=(40000, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    q = np.einsum("iAkB,pA,pB->pik", c4, n, n)
    if not rigid:
        return float(np.linalg.eigvalsh(q).min())
    across = n @ np.linalg.inv(f)
    across /= np.linalg.norm(across, axis=1)[:, None]
    normal = np.einsum("pi,pk->pik", across, across)
    plane = np.eye(3) - normal
    # the direction that is taken out gets an eigenvalue that is never the least
    return float(np.linalg.eigvalsh(plane @ q @ plane + 1e6 * normal).min())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "bulk"), [("rkcm", "100"), ("rkcm", "1e8"), ("rkcm-mixed", "inf")]
)
def test_least_eigenvalue(inputs: Path, tmp_path: Path, method: str, bulk: str) -> None:
    summary = solve(inputs, tmp_path, f"scene.method={method}", f"material.K={bulk}")
    assert not any("ellipticity" in warning for warning in summary["warnings"])
    modulus = float(bulk)
    for step in summary["steps"]:
        stretch = 1 + 0.6 * step["load"]
        # the volume ratio is the same at all points
        f = np.diag([stretch, *[(step["min_J"] / stretch) ** 0.5] * 2])
        wanted = dense_search(f, modulus, **MODULI) / (2 * MODULI["A10"])
        found = step["min_acoustic"]["value"]
        assert wanted - 1e-3 <= found <= wanted + 1e-4


def test_loss_is_reported_once(inputs: Path, tmp_path: Path) -> None:
    """A polynomial that softens: from some stretch on W_1 + 2 W_11 (v F N)^2 is negative."""
    summary = solve(inputs, tmp_path, "material.A20=-14", "material.A30=0", "scene.method=auto")
    values = [step["min_acoustic"]["value"] for step in summary["steps"]]
    lost = next(i for i, value in enumerate(values) if value <= 0)
    warnings = [text for text in summary["warnings"] if "ellipticity" in text]
    assert len(warnings) == 1
    assert f"from load {summary['steps'][lost]['load']:g}" in warnings[0]
    assert all(value > 0 for value in values[:lost])
    assert summary["verdict"]["state"] == "doubtful"
    assert "the answer is not unique" in " ".join(summary["verdict"]["reasons"])


@pytest.mark.slow
def test_an_accepted_answer_is_not_called_ambiguous(inputs: Path, tmp_path: Path) -> None:
    """A glued end loses ellipticity in its corners alone, far from the probe."""
    summary, done = execute(inputs / "uniaxial_tension.toml", tmp_path, sets=(
        "geometry.size=[2,1,1]", "geometry.source=[13,7,7]", "geometry.collocation=[13,7,7]",
        "scene.method=rkpm-gauss", "approximation.order=1", "approximation.support=2",
        "load.steps=4", "boundary.x1.u_x=0.62", "boundary.x1.u_y=0", "boundary.x1.u_z=0",
        "material.A20=-14", "material.A30=0", "material.K=500", "probe.stress.point=[1,0.5,0.5]",
    ))  # fmt: skip
    assert done.returncode == 0, done.stderr
    verdict = summary["verdict"]
    assert verdict["state"] == "accepted"
    assert ["loses ellipticity" in text for text in verdict["reasons"]] == [True]
    last = done.stdout.splitlines()[-1]
    assert last.startswith("accepted (numerical error; fibers and attachments are yours): ")
    assert "loses ellipticity" in last and "unique" not in done.stdout
