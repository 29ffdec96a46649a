"""Self-checks of a deck: properties that every solution must have, measured on the deck itself."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.cloud import model_of
from myork.core.deck import load_deck
from myork.core.material import Material, energy
from myork.core.scene import Scene
from myork.errors import ConvergenceError, InputError
from myork.files import write_json
from myork.stations.solve import refuse_other_model
from myork.types import F64

#: Accuracy of central differences with a step of 1e-6 of the state
_TANGENT = 1e-5
#: Forces balance to the tolerance of the iteration
_BALANCE = 1e-4
#: Stretches and shears at which the material curves are evaluated
_STRETCHES = np.linspace(0.6, 1.6, 41)
_SHEARS = np.linspace(0.0, 1.0, 41)


class Check(NamedTuple):
    """Outcome of one check."""

    name: str  #: What was checked
    passed: bool | None  #: Whether it passed; None where the deck has nothing to check
    detail: str  #: The number behind it, or the reason why there is none


def check_deck(
    deck: str | Path,
    out: str | Path | None = None,
    *,
    overrides: Sequence[str] = (),
    quick: bool = False,
    progress: ProgressCallback = silent,
) -> list[Check]:
    """Check tangents, balance, restart, fibers and material curves of a deck.

    - `out`: folder of `check.json`, in which the model file is looked for first
    - `quick`: leave out the checks that solve the deck: balance and restart
    - `progress`: called with one line per check
    - returns the outcomes
    """
    folder = None if out is None else Path(out)
    values = load_deck(deck, overrides, "solve")
    refuse_other_model(values, folder or Path(values["folder"]), overrides)
    found: list[Check] = []

    def note(name: str, run: Callable[..., tuple[bool | None, str]], *given: Any) -> None:
        try:
            passed, detail = run(*given)
        except ConvergenceError as reason:
            passed, detail = False, str(reason)
        found.append(Check(name, passed, detail))
        word = {True: "ok", False: "FAILED", None: "-"}[passed]
        progress(f"{name:<22} {word:<7} {detail}")

    with Scene(deck, overrides, folder, threads=1) as scene:
        note("tangent", _tangent, scene)
        for table in values.get("material", []):
            note(f"material {table['name']}", _curves, table)
        note("fibers", _fibers, values, Path(deck).parent, folder)
        if not quick:
            note("solve and balance", _balance, scene)
            states = scene.states
            if states is not None and len(states.load) and states.load[-1] >= 1.0:
                note("restart", _restart, deck, overrides, folder, states.x[-1])
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
        write_json(folder / "check.json", {"checks": [check._asdict() for check in found]})
    return found


def _tangent(scene: Scene) -> tuple[bool | None, str]:
    """Compare the linearised rows with differences of the residual, along a random direction."""
    if "linear" in scene.deck:
        return None, "a linear problem has no tangent to check"
    random = np.random.default_rng(0)
    size = float(np.ptp(scene.points(), axis=0).max())
    spacing = size / max(scene.source_points ** (1.0 / scene.dimension) - 1.0, 1.0)
    x = 1e-3 * spacing * random.standard_normal(scene.dofs)
    direction = 1e-3 * spacing * random.standard_normal(scene.dofs)
    step, left = 1e-3, ""
    displacements = scene.dimension * scene.source_points
    if scene.deck["scene"]["method"].startswith("rkpm") and scene.dofs > displacements:
        # some pressure entries have no unknown; their rows are only padding
        direction[displacements:] = 0.0
        left = "; along pressures of infinite K not checked: their rows are padded"
    try:
        product = scene.linearise(x, 0.0, direction)[1]
        ahead, behind = (
            scene.linearise(x + sign * step * direction, 0.0, direction, start=x)[0]
            for sign in (1.0, -1.0)
        )
    except InputError as reason:
        return False, str(reason)
    error = np.linalg.norm((ahead - behind) / (2.0 * step) - product) / np.linalg.norm(product)
    detail = f"differences agree to {error:.1e} (at most {_TANGENT:.0e}){left}"
    return bool(error < _TANGENT), detail


def _curves(table: dict[str, Any]) -> tuple[bool | None, str]:
    """Whether stress increases with stretch, along and across the fibers, and with shear."""
    material = Material.of_table(table)
    unstable = []
    for name, states in (
        ("stretch", [np.diag([s, s**-0.5, s**-0.5]) for s in _STRETCHES]),
        ("shear", [np.eye(3) + np.outer([g, 0, 0], [0, 1, 0]) for g in _SHEARS]),
    ):
        amounts = _STRETCHES if name == "stretch" else _SHEARS
        stored = energy(material, np.array(states), volumetric=False)
        # in isochoric states the energy decides: its slope is the stress
        slope = np.diff(stored) / np.diff(amounts)
        bad = np.flatnonzero(np.diff(slope) < -1e-9 * np.abs(slope).max())
        if len(bad):
            unstable.append(f"{name} {amounts[bad[0] + 1]:.2f} to {amounts[bad[-1] + 1]:.2f}")
    if unstable:
        return False, "passive matrix softens at " + ", ".join(unstable)
    return True, (
        f"passive matrix stiffens for stretches {_STRETCHES[0]:g} to {_STRETCHES[-1]:g} and shears "
        f"up to {_SHEARS[-1]:g}"
    )


def _fibers(deck: dict[str, Any], folder: Path, out: Path | None) -> tuple[bool | None, str]:
    """Unit lengths and directions of the muscles' fibers."""
    muscles = [m for m in deck.get("material", []) if m["model"] == "muscle"]
    if not muscles:
        return None, "no material is a muscle"
    cloud = model_of(deck, folder, out)
    own = all("fiber" in m or "fiber_angle" in m for m in muscles)
    if cloud is None or own:
        without = [m["name"] for m in muscles if not ("fiber" in m or "fiber_angle" in m)]
        if without:
            return False, f"no fibers of {', '.join(without)}: its active stress has no direction"
        return True, "one direction per muscle"
    labels = {m.get("label") for m in muscles if not ("fiber" in m or "fiber_angle" in m)}
    of = np.ones(len(cloud.label), bool) if None in labels else np.isin(cloud.label, list(labels))
    if not of.any():
        return False, "no point of the model has the label of a muscle"
    length = np.linalg.norm(cloud.fiber[of], axis=1)
    none = int((length < 1e-6).sum())
    wrong = int((np.abs(length[length >= 1e-6] - 1.0) > 1e-3).sum())
    mean = np.linalg.eigh(cloud.fiber[of].T @ cloud.fiber[of])[1][:, -1]
    detail = (
        f"{of.sum()} points, {none} without a fiber, {wrong} not of length 1, mean direction "
        f"({mean[0]:.2f}, {mean[1]:.2f}, {mean[2]:.2f})"
    )
    return none <= 0.01 * of.sum() and wrong == 0, detail


def _balance(scene: Scene) -> tuple[bool | None, str]:
    states = scene.solve()
    if states.errors:
        return True, f"relative error of the known solution {states.errors['relative_L2']:.1e}"
    detail = f"{states.verdict}; forces on all sets balance to {states.force_imbalance:.1e}"
    if states.reasons:
        detail += f"; {'; '.join(states.reasons)}"
    # tractions and body forces also act on the body: only with fixed bodies do the sets balance
    return states.verdict != "refused" and states.force_imbalance < _BALANCE, detail


def _restart(
    deck: str | Path, overrides: Sequence[str], out: Path | None, last: F64
) -> tuple[bool | None, str]:
    """A solve that starts from the solution must stay there."""
    if "linear" in load_deck(deck, overrides, "solve"):
        return None, "a linear problem has one state"
    with Scene(deck, [*overrides, "load.steps=1"], out, threads=1) as scene:
        again = scene.solve(start=last, error=False).x[-1]
    change = np.linalg.norm(again - last) / max(np.linalg.norm(last), 1e-300)
    return bool(change < 1e-4), f"restarting from the last state changes the answer by {change:.1e}"
