"""Train a reduced model: full solves, modes, volume, few cells, and a test on unseen states."""

import json
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.cloud import model_path
from myork.core.deck import deck_key, load_deck
from myork.core.online import triples
from myork.core.scene import Scene
from myork.core.threads import thread_count
from myork.errors import ConvergenceError, InputError
from myork.model_file import model_bytes, read_model
from myork.rom.check import (
    CellErrors,
    Tests,
    cell_errors,
    largest_errors,
    measure,
    solve_tests,
    started,
)
from myork.rom.full import FullModel
from myork.rom.marks import LOST, Marks
from myork.rom.model import ReducedModel
from myork.rom.modes import LARGE, Draft, joined, make_draft, states_beyond, values_beyond
from myork.rom.online import Answer, Regression, Solver
from myork.rom.parameters import (
    Parameter,
    as_parameters,
    parse_vary,
    spread_points,
    widths_of,
)
from myork.rom.places import place_arrays
from myork.rom.sampling import force_lifts, sample_cells, sample_forces
from myork.rom.setting import Setting, Snapshots, force_values, make_setting
from myork.stations.solve import refuse_other_model
from myork.tables import override_text
from myork.types import F64, I64

#: Load steps of the first solves, from rest to the corners of the range
RAY_STEPS = 8
#: Largest number of corners
MOST_RAYS = 16
#: States added at a time, and candidates from which they are chosen, half as many for
#: large bodies
BATCH, CANDIDATES = 8, 128
#: States at which the response to fixed sets is computed, and the step [length]
_LIFT_STATES, _LIFT_STEP = 4, 1e-3
#: Tolerances of the cubature relative to the requested one, until few cells are as good as all
_FINER = (1.0, 0.5)
#: Solutions of the model with all cells used to train the cubature, besides the full ones
VIRTUAL = 96
#: Tolerance of the cells of the error estimate relative to the model's: errors must not coincide
_ESTIMATE = 0.7


def train(
    deck: str | Path,
    parameters: Mapping[str, Sequence[float]] | Sequence[str],
    *,
    tolerance: float = 1e-3,
    full_solves: int = 60,
    tests: int = 16,
    seed: int = 0,
    out: str | Path | None = None,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> ReducedModel:
    """Train a reduced model of a deck.

    The first full solves go from rest to corners of the range, and give a state for each of their
    steps. All others start from the state predicted by the current reduced model. Half of them
    fill the range evenly; the rest are chosen where that model estimates its largest error. A test,
    which influences no choice, ends the training when it meets the tolerance; its errors are the
    certificate.

    - `deck`: deck file; its method is one of the Galerkin forms
    - `parameters`: ranges `(low, high)` by key, or texts `KEY=LOW:HIGH`
    - `tolerance`: target error: of the force relative, of the displacement relative to the largest
      one of the test
    - `full_solves`: largest number of full solves of the training, the corners included
    - `tests`: further full solves of the test; without them all full solves are used
    - `out`: folder in which the model file of the deck is looked for first
    - raises InputError: a parameter or the deck is not suitable for a reduced model
    - raises ConvergenceError: too few full solves converged
    """
    begin = time.process_time()
    deck = Path(deck)
    ranges = parameters if isinstance(parameters, Mapping) else parse_vary(parameters)
    values = load_deck(deck, overrides, "solve")
    kinds = as_parameters(ranges, values, lambda key: deck_key(deck, key, overrides))
    for key in ("pressure", "spring", "tendon"):
        if any(key in entry for entry in values["boundary"]):
            raise InputError(f"{deck}: boundary.{key}: reduced models do not support it")
    varied = {p.key for p in kinds}
    for entry in values["boundary"]:
        key = f"boundary.{entry['set']}.rotation"
        if "rotation" in entry and key not in varied:
            raise InputError(
                f"{deck}: {key}: reduced models support it as a parameter only: vary it"
            )
    for entry in values["material"]:
        if isinstance(entry.get("activation"), str):
            raise InputError(
                f"{deck}: material.{entry['name']}.activation: reduced models do not support "
                "expressions: all cells of a muscle have one activation"
            )
    named = {entry["name"] for entry in values["set"]}
    for probe in values["probe"]:
        if probe.get("set") in named:
            raise InputError(
                f"{deck}: probe.{probe['name']}.set: reduced models support forces on sides, not "
                f"on the [[set]] {probe['set']}: leave the probe out"
            )
    overrides = [*overrides, *_ramps(values)]
    if values.get("galerkin", {}).get("essential") == "transformation" or "refine" in values:
        first = values["geometry"].get("source")
        given = [] if first is None else [override_text("geometry.source", first)]
        # the choice of the deck itself, not a default for unspecified points
        said = load_deck(deck, [*overrides, *given], "solve")
        if said.get("galerkin", {}).get("essential") == "transformation":
            raise InputError(
                f'{deck}: galerkin.essential = "transformation": reduced models need '
                f'displacements prescribed by the penalty; use "penalty"'
            )
        if "refine" in said:
            # otherwise each state would start its own search for points
            raise InputError(
                f"{deck}: accuracy, [refine]: reduced models are trained on one set of points: "
                "leave both out; without geometry.source the target is 2 %"
            )
        if first is not None:
            overrides = [*overrides, override_text("galerkin.essential", "penalty")]
    if not 0.0 < tolerance < 0.5:
        raise InputError(f"tolerance must lie between 0 and 0.5, not {tolerance}")
    if full_solves < 4:
        raise InputError(f"at least 4 full solves are needed, not {full_solves}")
    path = model_path(values, deck.parent, None if out is None else Path(out))
    refuse_other_model(values, Path(deck.parent if out is None else out), overrides)
    cloud = None if path is None else read_model(path)
    if cloud is not None and cloud.activation is not None:
        raise InputError(f"{path}: activation: reduced models do not support activations of points")
    full = FullModel(deck.read_text(encoding="utf-8"), overrides, cloud, threads)
    with ExitStack() as opened:
        scene = opened.enter_context(full.open())
        if scene.points_found:
            # all states use the points that the search found necessary for the deck
            overrides = [*overrides, *scene.points_found]
            full = FullModel(full.text, overrides, cloud, threads)
            scene = opened.enter_context(full.open())
        setting, head = make_setting(scene, kinds, values, full, threads or thread_count(), opened)
        training = _Training(full, scene, setting, tolerance, full_solves, seed, progress)
        training.run(tests)
        sha256 = load_deck(deck, overrides, "solve")["sha256"]
        head |= {"deck": full.text, "overrides": list(overrides), "deck_sha256": sha256}
        points = {} if cloud is None else {"cloud": np.frombuffer(model_bytes(cloud), np.uint8)}
        rom = training.model(head, points, begin)
    return rom


def _ramps(values: Mapping[str, Any]) -> list[str]:
    """Overrides that replace every amplitude of a deck by a linear ramp to its last value.

    A state depends on the final values only, and the training approaches them proportionally.
    """
    return [
        override_text(f"amplitude.{entry['name']}.{key}", value)
        for entry in values["amplitude"]
        for key, value in (
            ("time", [0, 1]), ("value", [0, entry["value"][-1]]), ("curve", "linear")
        )
    ]  # fmt: skip


@dataclass
class _Training:
    """Full solves of a training, and the reduced model built from them."""

    full: FullModel
    scene: Scene  #: The unchanged deck, from which the parts are taken
    setting: Setting
    #: As in `train`
    tolerance: float
    full_solves: int
    seed: int
    progress: ProgressCallback
    #: Processor times of solves from rest, and of those from a state of the reduced model [s]
    cpu: list[float] = field(default_factory=list)
    started_cpu: list[float] = field(default_factory=list)
    failed: int = 0
    failed_cpu: float = 0.0
    snapshots: Snapshots | None = None
    tests: Tests | None = None
    draft: Draft | None = None

    def __post_init__(self) -> None:
        p = len(self.setting.parameters)
        self.marks = Marks(np.zeros((0, p)), np.zeros(0, np.int64))
        self.lifts = np.zeros((0, self.scene.dofs))

    def run(self, tests: int) -> None:
        """Solve until the test is passed or no solves are left."""
        kinds = self.setting.parameters
        self.solve(_corners(kinds, self.full_solves, self.seed), RAY_STEPS)
        if self.snapshots is None:
            raise ConvergenceError(
                "no full solve at a corner of the range converged to a stable state: narrow "
                "the range"
            )
        at = np.flatnonzero(self.snapshots.share >= 1.0)[:_LIFT_STATES]
        self.lifts = _lift_fields(
            self.full, self.setting, self.snapshots.values[at], self.snapshots.x[at], self.progress
        )
        # first, states that fill the range (half of the remaining ones), before the choice begins
        waiting = spread_points(kinds, max(1, self.left // 2), self.seed)
        while self.left > 0 and len(self.snapshots.x) >= 2:
            count = min(self.left, max(BATCH, self.full_solves // 4))
            self.draft = self.make_draft(final=False)
            if len(waiting):
                chosen, waiting = waiting[:count], waiting[count:]
                chosen = chosen[self.marks.least(chosen, widths_of(kinds)) < LOST]
            else:
                met = self.met(tests)
                if met and any(p.kind == "sigma_max" for p in kinds):
                    # modes that also hold beyond the range cost some accuracy inside
                    self.draft = self.make_draft(final=True)
                    met = self.met(tests)
                if met:
                    break
                chosen = self.choose(count)
            self.solve(chosen, None)
            self.draft = None
        if len(self.snapshots.x) < 4:
            raise ConvergenceError(
                "the full model has fewer than four stable states in the range: narrow the range"
            )
        self.draft = self.draft or self.make_draft(final=True)
        if tests and self.tests is None:
            self.solve_tests(tests)

    @property
    def left(self) -> int:
        """Number of full solves that remain."""
        return self.full_solves - len(self.cpu) - len(self.started_cpu) - self.failed

    def make_draft(self, *, final: bool) -> Draft:
        """The reduced model of the states so far; the last one includes states beyond the range."""
        assert self.snapshots is not None
        parts = self.scene, self.setting, self.snapshots, self.lifts
        beyond = states_beyond(*parts, self.seed) if final else None
        return make_draft(*parts, self.tolerance, beyond=beyond)

    def guess(self, values: F64) -> list[F64 | None]:
        """Unknowns from which full solves start."""
        if self.draft is None:
            return [None] * len(values)
        found = self.draft.solve(self.setting, values)
        return started(
            found.amplitudes, found.converged, self.draft.basis.modes[:, : self.draft.basis.r]
        )

    def solve(self, values: F64, steps: int | None) -> None:
        """Full states at values; those already known are left out."""
        kinds = self.setting.parameters
        values = self.unknown(values)
        for row, start in zip(values, self.guess(values), strict=True):
            begin = time.process_time()
            try:
                near = self.marks.worst(row[None], widths_of(kinds))[0] == LOST
                state = self.full.solve(kinds, row, steps, start, doubted=bool(near))
            except ConvergenceError as reason:
                self.failed += 1
                self.failed_cpu += time.process_time() - begin
                self.marks = self.marks.added(row, LOST)
                self.progress(f"full solve at {self.named(row)}: {reason}; left out")
                continue
            (self.started_cpu if state.started else self.cpu).append(state.cpu_s)
            self.marks = self.marks.added(row, state.mark)
            if state.mark == LOST:
                # its branch is arbitrary: no regression can be fitted through such states
                self.progress(f"full solve at {self.named(row)}: an unstable state; left out")
                continue
            self.snapshots = joined(self.snapshots, kinds, state, row)
            self.progress(
                f"full solve {self.full_solves - self.left}/{self.full_solves}: {self.named(row)}"
                + (", from the reduced model" if state.started else "")
            )

    def unknown(self, values: F64) -> F64:
        """Values at which no state is known yet."""
        if self.snapshots is None:
            return values
        known = self.snapshots.values[self.snapshots.share >= 1.0]
        scale = widths_of(self.setting.parameters)
        gap = np.abs((values[:, None] - known[None]) / scale).max(axis=2)
        return values[gap.min(axis=1, initial=np.inf) > 1e-9]

    def solve_tests(self, count: int) -> None:
        """Full states of the test."""
        self.progress(f"testing on {count} states not used in training")
        seed = self.seed + 7919
        values = spread_points(self.setting.parameters, count, seed)
        values = values[self.marks.least(values, widths_of(self.setting.parameters)) < LOST]
        self.tests = solve_tests(
            self.full, self.setting.parameters, values, seed, self.guess, self.progress, self.marks
        )
        for row in self.tests.lost:
            self.marks = self.marks.added(row, LOST)

    def met(self, tests: int) -> bool:
        """Whether the model of the states so far, with all cells, meets the tolerance."""
        if not tests:
            return False
        if self.tests is None:
            self.solve_tests(tests)
        assert self.tests is not None and self.draft is not None
        near = self.marks.worst(self.tests.values, widths_of(self.setting.parameters))
        tried = self.tests.some(np.flatnonzero(near < LOST))
        values = tried.values
        if len(values) == 0:
            return False
        answer = self.draft.solve(self.setting, values)
        force = self.draft.forces(self.setting, values, answer)
        modes = self.draft.basis.modes[:, : self.draft.basis.r]
        u, wrong = largest_errors(tried, self.setting, answer, modes, force)
        self.progress(
            f"after {self.full_solves - self.left} full solves, all cells: largest error of the "
            f"displacement {u:.1e}, of the force {wrong:.1e}"
        )
        return max(u, wrong) <= self.tolerance

    def sound(self, values: F64) -> F64:
        """Those of the values with no lost state nearby, or all if there are none."""
        good = self.marks.worst(values, widths_of(self.setting.parameters)) < LOST
        return values[good] if good.any() else values

    def choose(self, count: int) -> F64:
        """Well separated values at which the current reduced model estimates its largest errors."""
        assert self.draft is not None
        kinds = self.setting.parameters
        number = CANDIDATES // 2 if len(self.setting.parts.weight) > LARGE else CANDIDATES
        candidates = spread_points(kinds, number, self.seed + self.full_solves - self.left)
        values = self.unknown(candidates)
        answer = self.draft.solve(self.setting, values)
        gain = self.draft.estimate(self.setting, values, answer)
        found = answer.converged & np.isfinite(gain)
        gain[~found] = 2.0 * gain[found].max(initial=1.0)
        scale = widths_of(kinds)
        gain[self.marks.worst(values, scale) == LOST] = 0.0
        chosen = []
        for _ in range(count):
            best = int(np.argmax(gain))
            chosen.append(best)
            distance = np.linalg.norm((values - values[best]) / scale, axis=1)
            gain = gain * np.minimum(1.0, (distance / 0.35) ** 2)
        return values[np.unique(chosen)]

    def model(self, head: dict[str, Any], more: dict[str, Any], begin: float) -> ReducedModel:
        """The model with few cells and its certificate; the cells are chosen without the test."""
        assert self.draft is not None
        kinds = self.setting.parameters
        values = self.sound(spread_points(kinds, CANDIDATES // 2, self.seed + 7907))
        virtual = self.sound(spread_points(kinds, VIRTUAL, self.seed + 1))
        answer = self.draft.solve(self.setting, values)
        good = answer.converged
        values, answer = values[good], Answer._make(a[good] for a in answer)
        force = self.draft.forces(self.setting, values, answer)
        # cells need not be more accurate than the modes
        size = np.linalg.norm(answer.amplitudes, axis=1).max(initial=0.0)
        left = self.draft.estimate(self.setting, values, answer).max(initial=0.0) / size
        found: list[ReducedModel] = []
        off: list[CellErrors] = []
        for share in _FINER:
            arrays = finish(
                self.scene, self.setting, self.draft, virtual, share * self.tolerance, self.seed,
                self.progress,
            )  # fmt: skip
            found.append(self.rom(dict(arrays) | more, dict(head), begin))
            off.append(cell_errors(found[-1], self.setting, values, answer, force))
            self.progress(
                f"{found[-1].head['cells']['kept']} cells at {len(values)} other states: "
                f"{off[-1].failed} fail, displacement off by {off[-1].u:.1e} from all cells, which "
                f"are off by {left:.1e}, force by {off[-1].force:.1e}"
            )
            failed, wrong, u = off[-1]
            if failed == 0 and wrong <= self.tolerance and u <= max(self.tolerance, left):
                break
        # more cells are not always better
        best = found[off.index(min(off))]
        if self.tests is not None:
            best.set_certificate(measure(best, self.tests))
        return best

    def rom(self, arrays: dict[str, Any], head: dict[str, Any], begin: float) -> ReducedModel:
        """A model from its arrays."""
        head |= {
            "modes": int(arrays.pop("modes")),
            "indicator_modes": int(arrays.pop("indicator_modes")),
            "cells": {
                "all": len(self.setting.parts.weight),
                "kept": arrays["online/h"].shape[1],
                "force": arrays["force/h"].shape[1],
            },
            "full_solves": len(self.cpu) + len(self.started_cpu),
            "started_solves": len(self.started_cpu),
            "solves_cpu_s": sum(self.cpu) + sum(self.started_cpu) + self.failed_cpu,
            "full_cpu_s": float(np.mean(self.cpu or [0.0])),
            "offline_cpu_s": time.process_time() - begin,
            "tolerance": self.tolerance,
            "seed": self.seed,
        }
        arrays["tractions"] = self.setting.pushes
        arrays |= {"marks/values": self.marks.values, "marks/mark": self.marks.mark}
        arrays["head"] = json.dumps(head)
        return ReducedModel(arrays)

    def named(self, row: F64) -> str:
        """Values as text."""
        pairs = zip(self.setting.parameters, row, strict=True)
        return ", ".join(f"{p.key} = {v:.4g}" for p, v in pairs)


def _lift_fields(
    full: FullModel, setting: Setting, rows: F64, states: F64, progress: ProgressCallback
) -> F64:
    """Response of the body to a displacement of fixed sets whose forces are wanted.

    Without such fields among the modes the force on a fixed set is not stationary: its error is of
    the order of the displacement error, not of its square.
    """
    size = max(float(np.abs(setting.columns.value).max()), 1.0)
    found = []
    for key, value, end in setting.still:
        step = _LIFT_STEP * size / end
        for row, x in zip(rows, states, strict=True):
            try:
                found.append(full.lift(setting.parameters, row, x, key, value, step) / end)
            except ConvergenceError as reason:
                progress(f"{key} at {row.tolist()}: {reason}; left out")
        progress(f"forces by {key}: {len(found)} fields")
    return np.array(found).reshape(len(found), states.shape[1])


def _corners(kinds: Sequence[Parameter], most: int, seed: int) -> F64:
    """Corners of the range, all or some, that of the largest values first."""
    corners = np.array(list(product(*((p.high, p.low) for p in kinds))))
    count = min(MOST_RAYS, max(2, most // 2))
    if len(corners) > count:
        others = np.random.default_rng(seed).permutation(np.arange(1, len(corners)))
        corners = corners[np.concatenate([[0], np.sort(others[: count - 1])])]
    return corners


def finish(
    scene: Scene,
    setting: Setting,
    draft: Draft,
    values: F64,
    tolerance: float,
    seed: int,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Arrays of the model: modes, volume, few cells, trained at values besides the full states."""
    basis, model, finer, known, amplitudes = draft
    m, r = basis.modes.shape[1], basis.r
    progress(f"{r} modes of {len(known.x)} states; they leave {basis.lost:.1e} of them")
    values = np.vstack([values, values_beyond(setting, seed)])
    answer = draft.solve(setting, values)
    good = answer.converged
    progress(f"{good.sum()} of {len(good)} states of the model with all cells converged")
    some = np.unique(np.linspace(0, len(known.values) - 1, VIRTUAL).astype(int))
    at = np.vstack([known.values[some], values[good]])
    where = np.vstack([amplitudes[some], np.zeros((int(good.sum()), m))])
    where[len(some) :, :r] = answer.amplitudes[good]
    kept = sample_cells(model, setting, at, where[:, :r], tolerance, seed)
    more = sample_cells(finer, setting, at, where, _ESTIMATE * tolerance, seed)
    progress(
        f"{len(kept[0])} of {len(setting.parts.weight)} cells (residual {kept[2]:.1e}), "
        f"{len(more[0])} for the estimate of the error"
    )
    lifts = force_lifts(model, setting, at, where[:, :r])
    whole = finer.cells
    if len(setting.parts.weight) > LARGE and len(setting.wanted):
        # forces are evaluated at the states of few cells, and at others equally far off; the
        # response of the modes is known by regression
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
    scale = widths_of(setting.parameters)
    found = lifts.copy()
    for part, others in ((order[::2], order[1::2]), (order[1::2], order[::2])):
        if len(part) and len(others):
            found[part] = Regression(at[others], lifts[others], scale)(at[part])
    return found


def _shapes(scene: Scene, modes: F64, r: int) -> dict[str, F64]:
    """Displacements of modes at the collocation points and at displacement probes."""
    small = 1e-6 / np.abs(modes).max()
    fields = [scene.fields(small * mode, 0.0).u / small for mode in modes.T[:r]]
    found = {"shapes": np.stack(fields, axis=2), "points": scene.points()}
    probes = scene.deck["probe"]
    if probes:
        values = scene.probes(small * modes.T, np.zeros(modes.shape[1])) / small
        for i, probe in enumerate(probes):
            if probe["quantity"] in ("u", "u_x", "u_y", "u_z"):
                axes = scene.dimension if probe["quantity"] == "u" else 1
                found[f"probes/{probe['name']}"] = values[:, i, :axes].T
    return found
