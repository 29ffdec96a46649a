"""Newton's method: exact second derivatives of the residuals, and what they buy.

Second derivatives are checked along random directions by central differences of eighth order of
the gradient A^T r. With the step used their truncation and rounding are below 1e-9 of the largest
entry (measured 5e-13 to 8e-10), so 1e-7 fails on any wrong term and not on rounding.
"""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.truths.compiled import hessian
from myork.core.scene import Scene
from myork.errors import ConvergenceError
from tests.dense import SOLVERS
from tests.scenes import derivative, execute, history, solved

TOLERANCE = 1e-7

#: Coarse versions of two decks: muscle with inclined fibers, and the tube in plane strain
FIBERS = ("geometry.source=[3,3,4]", "geometry.collocation=[4,4,6]", "approximation.support=2.5",
          "approximation.order=2", "material.curve=smooth")  # fmt: skip
TUBE = ("geometry.source=[4,5]", "geometry.collocation=[6,8]", "approximation.support=3")
ALL_TERMS = tuple(f"material.{term}" for term in (
    "A01=3", "A30=0.3", "A11=1", "A02=0.5", "A21=0.4", "A12=0.3", "A03=0.2"))  # fmt: skip

SCENES = {
    "muscle, mixed": ("muscle_fibers.toml", ("scene.method=rkcm-mixed", *FIBERS)),
    "muscle": ("muscle_fibers.toml", ("scene.method=rkcm", "material.K=50", *FIBERS)),
    "all terms": ("muscle_fibers.toml", ("scene.method=rkcm", *FIBERS, *ALL_TERMS)),
    "plane, mixed": ("tube.toml", ("scene.method=rkcm-mixed", *TUBE)),
    "plane": ("tube.toml", ("scene.method=rkcm", *TUBE)),
    "plane, all terms, mixed": ("tube.toml", ("scene.method=rkcm-mixed", *TUBE, *ALL_TERMS)),
}  # fmt: skip

#: Contraction at which the strain beside the clamped edges leaves large residuals
EDGES = (
    "scene.method=rkcm-mixed", "approximation.order=2", "approximation.support=3",
    "geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "material.curve=smooth",
    "load.steps=4", "load.activation=0.2",
)  # fmt: skip


def random_state(scene: Scene, rng: np.random.Generator) -> np.ndarray:
    """Coefficients of a state with J > 0 and pressures of the size of the moduli."""
    x = rng.standard_normal((scene.source_points, scene.dofs // scene.source_points))
    x[:, : scene.dimension] *= 0.005 if scene.dimension == 3 else 0.1
    x[:, scene.dimension :] *= 2
    return x.ravel()


@pytest.mark.parametrize("case", SCENES)
def test_second_derivatives(case: str, inputs: Path) -> None:
    deck, overrides = SCENES[case]
    rng = np.random.default_rng(1)
    with Scene(inputs / deck, overrides, threads=1) as scene:
        start = np.zeros(scene.dofs)
        x, way = random_state(scene, rng), random_state(scene, rng)
        expected = derivative(lambda h: hessian(scene, x + h * way, 0.7, start=start)[0], 1e-3)
        found = hessian(scene, x, 0.7, start=start)[1] @ way
    np.testing.assert_allclose(found, expected, rtol=0, atol=TOLERANCE * abs(expected).max())


@pytest.mark.parametrize("case", ["muscle, mixed", "plane"])
def test_second_derivatives_of_modes(case: str, inputs: Path) -> None:
    """The Hessian of a reduced model is the projection of the full one, to rounding."""
    deck, overrides = SCENES[case]
    rng = np.random.default_rng(2)
    with Scene(inputs / deck, overrides, threads=1) as scene:
        modes = np.linalg.qr(np.stack([random_state(scene, rng) for _ in range(3)], axis=1))[0]
        scene.reduce(modes)
        amplitude = modes.T @ random_state(scene, rng)
        gradient, second = hessian(scene, modes @ amplitude, 0.7, start=np.zeros(scene.dofs))
        found = hessian(scene, amplitude, 0.7, start=np.zeros(3), reduced=True)
    np.testing.assert_allclose(found[0], modes.T @ gradient, atol=1e-10 * abs(gradient).max())
    np.testing.assert_allclose(found[1], modes.T @ second @ modes, atol=1e-10 * abs(second).max())


def last_steps(deck: Path, out: Path, tolerance: float, *overrides: str) -> list[float]:
    """Steps of the last load step, until it goes on with the row weights of the state found.

    The iteration converges; an answer may be refused none the less.
    """
    summary, done = execute(deck, out, "--no-error", sets=overrides)
    assert summary["converged"], done.stderr
    last = history(out)[-1]["step"]
    steps = [float(row["step_norm"]) for row in history(out) if row["step"] == last]
    return steps[: 1 + next(i for i, step in enumerate(steps) if step < tolerance)]


@pytest.mark.slow
def test_newton_converges_quadratically(inputs: Path, tmp_path: Path) -> None:
    """The ratio of logarithms of the last contractions: 2 in the limit, above 1.5 where three
    iterations are in the region of convergence, 1 for Gauss-Newton.
    """
    order = {}
    for method in ("full", "gauss-newton"):
        words = (f"solver.newton={method}", *EDGES, "solver.tolerance=1e-8")
        steps = last_steps(inputs / "muscle_fibers.toml", tmp_path / method, 1e-8, *words)
        last = np.log(steps[-3:])
        order[method] = (last[2] - last[1]) / (last[1] - last[0])
    assert {row["solver"] for row in history(tmp_path / "full")} == {"newton"}
    assert order["full"] > 1.5
    assert 0.7 < order["gauss-newton"] < 1.3


#: A block so coarse that its displacement form is stationary, but no minimum, where it is
#: symmetric: the sum of squares falls to a quarter when the middle turns about the fibers
SADDLE = ("geometry.source=[4,4,5]", "geometry.collocation=[7,7,9]", "load.activation=0.05",
          "load.steps=2", "scene.method=rkcm", "solver.weight_essential=ns-c4",
          "solver.weight_traction=1", "material.curve=published")  # fmt: skip


def least_curvature(scene: Scene, x: np.ndarray, load: float, start: np.ndarray) -> float:
    """Least eigenvalue of the second derivatives, scaled to a unit diagonal."""
    second = hessian(scene, x, load, start=start)[1]
    size = np.sqrt(abs(np.diag(second)))
    return float(np.linalg.eigvalsh(second / np.outer(size, size))[0])


@pytest.mark.slow
def test_no_solver_ends_at_a_saddle(inputs: Path) -> None:
    """Second derivatives of a minimum are positive definite, whatever the way there."""
    middle = {}
    solvers = [f"linear={name}" for name in SOLVERS if name != "auto"]
    for choice in (*solvers, "newton=gauss-newton", "newton=full"):
        with Scene(inputs / "muscle_block.toml", [*SADDLE, f"solver.{choice}"], threads=1) as scene:
            states = scene.solve()
            start = np.zeros(scene.dofs)
            for x, load in zip(states.x, states.load, strict=True):
                assert least_curvature(scene, x, float(load), start) > 0, choice
                start = x
            middle[choice] = scene.fields(states.x[-1], 1.0).cauchy[:, 2].max()
            assert any("stopped at a saddle point of |r|" in line for line in states.warnings)
    values = np.array(list(middle.values()))
    np.testing.assert_allclose(values, values[0], rtol=1e-6, err_msg=str(middle))


@pytest.mark.slow
def test_minima_are_not_taken_for_saddles(inputs: Path) -> None:
    """The same block with points enough; and rubber whose residuals are rounding."""
    for deck, overrides in {
        "muscle_block": ["geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]", *SADDLE[2:]],
        "uniaxial_tension": ["load.steps=5", "scene.method=rkcm"],
    }.items():
        warnings = solved(inputs / f"{deck}.toml", *overrides, error=True).states.warnings
        assert not [line for line in warnings if "saddle" in line]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["gauss-newton", "full", "auto"])
def test_kinks_end_the_iteration(method: str, inputs: Path) -> None:
    """Fibers on the kink of the published curve make a cycle: it ends, with a cure."""
    overrides = [
        "scene.method=rkcm", "approximation.order=2", "approximation.support=3",
        "geometry.source=[5,5,9]", "geometry.collocation=[9,9,17]", "material.curve=published",
        "solver.max_iterations=25", f"solver.newton={method}",
    ]  # fmt: skip
    with pytest.raises(ConvergenceError, match='curve = "smooth"') as caught:
        solved(inputs / "muscle_fibers.toml", *overrides)
    assert "load 0.0833" in str(caught.value)
