"""Reduced models: modes, projection, and their errors relative to the full model."""

import json
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

import myork
from myork.core.scene import Scene
from myork.rom import study
from myork.rom.basis import proper_orthogonal_modes
from tests.scenes import box, gripped, held, probes, refuses, solved
from tests.scenes import scene as tables_of

BLOCK = gripped(
    "rkcm", box(3, 3, 4, size=[1, 1, 2], places=(5, 5, 7)),
    {"name": "m", "model": "muscle", "A10": 6.43, "A20": 0.94, "K": 100.0, "curve": "smooth",
     "fiber": [0.5, 0.0, 0.866]}, "z0 z1",
    load={"steps": 5, "activation": 0.5}, solver={"tolerance": 1e-9},
)  # fmt: skip
RUBBER = gripped(
    "auto", box(4, 4, 4), {"name": "rubber", "model": "polynomial", "A10": 10.0, "A01": 2.0,
                           "K": 1000.0}, "z0 z1", load={"steps": 5}, u_x=0.2, u_z=-0.2,
)  # fmt: skip
SMALL = ("geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "load.steps=5")
WEAK = ["muscle_block", "rubber", "rubber, nodal cells"]


@pytest.fixture(scope="module", params=["collocation"])
def full(request, inputs: Path):
    """Scene of a form, its states, modes and proper orthogonal values."""
    tables = {
        "muscle_block": inputs / "muscle_block.toml", "collocation": BLOCK, "rubber": RUBBER,
        "rubber, nodal cells": {**RUBBER, "scene": {"dimension": 3, "method": "rkpm-scni"}},
    }[request.param]  # fmt: skip
    given = isinstance(tables, dict)
    scene = Scene.from_tables(tables, threads=1) if given else Scene(tables, SMALL, threads=1)
    assert (scene.deck["scene"]["method"] == "rkcm") == (request.param == "collocation")
    with scene:
        states = scene.solve(error=False)
        yield scene, states, *proper_orthogonal_modes(states.x)


def in_forms(*names):
    """Forms of the scene that a test uses, if not collocation alone."""
    return pytest.mark.parametrize("full", names, indirect=True)


def fields_of(scene, x, load):
    return [scene.fields(state, at) for state, at in zip(x, load, strict=True)]


def reduced_errors(scene, states, modes, linear):
    scene.reduce(modes)
    reduced = scene.solve_reduced(linear)
    assert reduced.load.tolist() == states.load.tolist()
    exact = fields_of(scene, states.x, states.load)
    found = fields_of(scene, reduced.x @ modes.T, states.load)
    return study.displacement_error(exact, found), study.gradient_error(exact, found)


def test_modes_are_orthonormal_and_span_the_snapshots(full):
    _, states, modes, values = full
    assert_allclose(modes.T @ modes, np.eye(5), rtol=0, atol=1e-14)
    assert (np.diff(values) <= 0).all()
    rest = states.x.T - modes @ (modes.T @ states.x.T)
    assert np.linalg.norm(rest) < 1e-14 * np.linalg.norm(states.x)
    # (6.22): the values are the snapshots' energies
    assert values.sum() == pytest.approx((states.x**2).sum() / 5, rel=1e-12)


@in_forms("collocation", *WEAK)
def test_as_many_modes_as_snapshots_give_the_full_solution(full):
    # Least squares iterations end within their tolerance, 1e-9, times the condition of the rows,
    # others at 1e-6 with quadratic convergence.
    scene, states, modes, _ = full
    squares = scene.deck["scene"]["method"] == "rkcm"
    errors = reduced_errors(scene, states, modes, "dgels" if squares else "")
    assert np.max(errors) < (1e-6 if squares else 1e-7)
    if not squares:
        # the tangent is the full one, and no error leaves the span of the modes; the full one ends
        # with corrections by its factorisation
        assert (scene.states.iterations <= states.iterations + 1).all()


@in_forms("collocation", *WEAK)
def test_projected_rows_are_the_product_of_rows_and_modes(full):
    """Shape functions projected once give A'U without A', tangents and forces along the modes."""
    scene, states, modes, _ = full
    squares = scene.deck["scene"]["method"] == "rkcm"
    scene.reduce(modes)
    on, state = (np.eye(scene.rows), 2) if squares else (modes.T, 1)
    amplitudes = modes.T @ states.x[state]
    x = modes @ amplitudes
    for k in range(modes.shape[1]):
        residual, product = scene.linearise(x, 0.6, modes[:, k])
        unit = np.eye(modes.shape[1])[k]
        reduced_residual, column = scene.linearise(amplitudes, 0.6, unit, reduced=True)
        size = np.abs(product).max(), np.abs(residual).max()
        assert_allclose(column, on @ product, rtol=0, atol=1e-12 * size[0])
        near = 1e-9 if squares else 1e-12
        assert_allclose(reduced_residual, on @ residual, rtol=0, atol=near * size[1])


@in_forms(*WEAK)
def test_fewer_modes_come_near_to_the_best_that_they_can(full):
    """Equilibrium among the modes compared with the projection of the solution on them."""
    scene, states, modes, _ = full
    exact = fields_of(scene, states.x, states.load)
    for r in (1, 2, 3):
        basis = modes[:, :r]
        best = fields_of(scene, states.x @ basis @ basis.T, states.load)
        e1, _ = reduced_errors(scene, states, basis, "")
        assert e1 < 2.0 * study.displacement_error(exact, best), r


def test_a_deck_without_a_method_or_steps_is_reduced(tmp_path):
    """One step would give only one snapshot."""
    tables = {key: value for key, value in RUBBER.items() if key != "load"}
    tables["probe"] = probes("pull force z1")
    lines: list[str] = []
    study = myork.run_rom(tables, tmp_path, threads=1, progress=lines.append)
    assert any("one load step gives one snapshot" in line for line in lines)
    assert study["snapshots"] == 10
    assert [model["r"] for model in study["models"]] == [1, 2, 5]
    assert {model["kind"] for model in study["models"]} == {"galerkin"}
    errors = [model["force_error"] for model in study["models"]]
    # one step and ten end at the same answer
    pull = solved(tables).ends()["pull"]
    assert errors[0] > 10 * errors[2]
    last = study["full"]["probes"]["pull"][-1]
    assert_allclose(last, pull, rtol=1e-6, atol=1e-6 * max(abs(pull)))


WAVE = Path(__file__).parents[2] / "inputs" / "wave_1d.toml"
STRONG = {**RUBBER, "scene": {"dimension": 3, "method": "rkcm"}}
RIGID = {**RUBBER, "material": [{**RUBBER["material"][0], "K": float("inf")}]}


@pytest.mark.parametrize(("deck", "projection", "why"), [
    # modes of displacement and pressure together need not be stable
    (RIGID, "auto", "K = inf.*finite K"),
    (STRONG, "galerkin", "projection: .*least-squares"),
    (RUBBER, "least-squares", 'projection: .*by "galerkin"'),
    (WAVE, "galerkin", "more equations than unknowns"),
    (WAVE.with_name("poisson_1d.toml"), "auto", "for nonlinear problems"),
])  # fmt: skip
def test_reductions_that_cannot_be(open_scene, deck, projection, why):
    scene = open_scene(deck)
    refuses(why, scene.reduce, np.linalg.qr(np.ones((scene.dofs, 1)))[0], projection)


def test_one_solve_leaves_nothing_to_save(tmp_path):
    refuses("at least one state that is not zero", proper_orthogonal_modes, np.zeros((3, 6)))
    refuses("nothing to gain", myork.run_rom, WAVE.with_name("poisson_1d.toml"), tmp_path)


# ---- modes (6.13)-(6.26), (6.32) -----------------------------------------------------------------


def test_the_method_of_snapshots_has_the_modes_of_the_singular_values(full) -> None:
    """Up to signs, and up to rounding of squared small values."""
    _, states, modes, values = full
    other, squares = proper_orthogonal_modes(states.x, states.x.T)
    assert_allclose(squares[:3], values[:3], rtol=1e-9, atol=1e-13 * values[0])
    for k in range(3):
        assert abs(modes[:, k] @ other[:, k]) == pytest.approx(1.0, abs=1e-6), k
    # rounding errors are not counted
    assert len(squares) <= len(values) and squares[-1] > 0


# ---- rows assembled in full (6.62)-(6.67) --------------------------------------------------------


def test_rows_assembled_in_full_are_those_of_the_span(full) -> None:
    scene, states, modes, _ = full
    answers = []
    for assembled in (False, True):
        scene.reduce(modes[:, :3], assembled=assembled)
        a = modes[:, :3].T @ states.x[2]
        rows = [scene.linearise(a, 0.6, e, start=0 * a, reduced=True) for e in np.eye(3)]
        answers.append((np.array(rows), scene.solve_reduced("normal").x))
    for span, full_rows, near in zip(*answers, (1e-9, 1e-6), strict=True):
        assert_allclose(full_rows, span, rtol=0, atol=near * np.abs(span).max())


# ---- motions (6.27)-(6.52) -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("deck", "method", "projection"),
    [("wave_1d", "rkcm", "auto"), ("bar_1d", "rkcm", "least-squares"),
     *(("bar_1d", "rkpm-gauss", way) for way in ("auto", "least-squares"))],
)  # fmt: skip
def test_motions_in_the_span_of_their_modes(inputs: Path, deck, method, projection):
    """Tables 6.1 and 6.2: errors decrease, and stay close to the best that the modes allow."""
    errors = []
    with Scene(inputs / f"{deck}.toml", [f"scene.method={method}"]) as scene:
        states = scene.solve(error=False)
        assert len(states.x) == 30
        full = study.PathStates.of(scene, states.x, states.load)
        modes, _ = proper_orthogonal_modes(states.x)
        for published in (False, True):
            found = [
                study.reduced_path(scene, full, modes[:, :r], projection, published=published)
                for r in (1, 5, 25)
            ]
            e1 = [model["e1"] for model in found]
            assert e1[0] > 2 * e1[1] > 1e3 * e1[2] and e1[2] < 1e-6
            for model in found:
                assert model["best_e1"] * 0.99 <= model["e1"] < 3 * model["best_e1"]
            errors.append(e1)
    assert_allclose(*errors, rtol=0.05)


def test_all_modes_give_the_motion_with_loads_in_time() -> None:
    """In the span of all unknowns nothing is lost, for any test space of the residual."""
    tables = tables_of(
        "rkcm", box(11), approximation={"order": 2},
        linear={"problem": "elasticity", "E": 2, "source": "2*sin(2*x) + 8*t^2*sin(2*x)"},
        dynamics={"density": 1, "time_step": 0.02, "end_time": 1, "velocity": "x"},
        boundary=[{"set": "x0", "u_x": 0}, {"set": "x1", "u_x": "t^2*sin(2) + t"}],
    )  # fmt: skip
    weak = {**tables, "scene": {"dimension": 1, "method": "rkpm-gauss"}}
    for deck, projection in ((tables, "auto"), (weak, "galerkin"), (weak, "least-squares")):
        with Scene.from_tables(deck) as scene:
            states = scene.solve(error=False)
            assert states.x.shape == (50, 11)
            assert_allclose(states.load, 0.02 * np.arange(1, 51), rtol=1e-12)
            for solver in ("dgels", "normal"):
                scene.reduce(np.eye(scene.dofs), projection)
                reduced = scene.solve_reduced(solver)
                assert_allclose(reduced.x, states.x, rtol=0, atol=1e-7 * abs(states.x).max())
            rows = [scene.linearise(e, 1.0, e, reduced=True)[1] for e in np.eye(scene.dofs)]
            assert np.linalg.matrix_rank(rows) == scene.dofs


def test_an_error_that_is_not_a_number_is_not_zero() -> None:
    """Where J <= 0 there is no stress to compare."""
    assert study.largest_error(np.zeros(2), np.ones(2)) == 0.0
    assert np.isnan(study.largest_error(np.array([1.0, np.nan]), np.ones(2)))


# ---- which states are snapshots ------------------------------------------------------------------


@pytest.mark.parametrize(("change", "message"), [
    ({"modes": [7]}, r"7 modes are requested, but 6 load steps give at most 6"),
])  # fmt: skip
def test_impossible_snapshots_are_refused_before_a_solve(change, message, tmp_path) -> None:
    tables = {**RUBBER, "load": {"steps": 6}, "rom": {"modes": [1], **change}}
    refuses(message, myork.run_rom, tables, tmp_path)
    summary = tmp_path / "summary.json"
    assert not summary.exists() or "rom" not in json.loads(summary.read_text())


def test_a_path_of_amplitudes_is_reduced(tmp_path) -> None:
    """Activation first, then the plate: the modes represent both."""
    muscle = {"name": "muscle", "time": [0, 0.5], "value": [0, 1]}
    plate = {"name": "plate", "time": [0, 0.5, 1], "value": [0, 0, 1]}
    tables = tables_of(
        "rkpm-gauss", box(3, 3, 4, size=[1, 1, 2], places=False), material=BLOCK["material"],
        boundary=[held("z0"), held("z1", u_z=-0.1, amplitude="plate")],
        load={"steps": 4, "activation": 0.3, "amplitude": "muscle"}, amplitude=[muscle, plate],
        rom={"modes": [1, 4]},
    )  # fmt: skip
    one, all_ = myork.run_rom(tables, tmp_path, threads=1)["models"]
    assert all_["e1"] < 1e-4 < 0.1 < one["e1"]
