"""Full solutions at parameter values of a reduced model in training."""

import time
from collections.abc import Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from myork.core.galerkin import LoadParts, load_parts, modal_products
from myork.core.scene import Scene
from myork.errors import ConvergenceError
from myork.records import PointCloud
from myork.rom.marks import ACCEPTED, DOUBTFUL, LOST
from myork.rom.parameters import Parameter
from myork.tables import override_text
from myork.types import F64

#: Relative change of the unknowns up to which a solution is the guessed one
_NEAR = 0.2
#: Iterations from a guess. Good ones take up to 8; those that take all have diverged, and cost
#: more than the path from rest: 13 to 19 CPU s instead of 2.5 in a muscle of 2,500 unknowns
_PATIENCE = 12
#: Halvings of a load step from rest, and near lost states: where the branch ends, more of
#: them only cost time
_HALVINGS, _FEW_HALVINGS = 5, 2
_FROM_GUESS = {"load.steps": 1, "load.max_halvings": 0, "solver.max_iterations": _PATIENCE}


class FullState(NamedTuple):
    """Converged states of one full solve along the path to its parameters."""

    x: F64  #: Unknowns, shape `(steps, n)`
    load: F64  #: Fraction of the path, shape `(steps,)`
    probes: F64  #: Values of the probes, shape `(steps, probes, 3)`
    #: The last unknowns times the mass matrix of unit density, shape `(n,)`; their product with the
    #: unknowns is the squared L2 norm of the displacement over the body
    mass: F64
    cpu_s: float  #: Processor time of the solve [s]
    started: bool = False  #: Whether the iteration began at a guess of the state and not at rest
    mark: int = 0  #: Verdict of the full model on the last state, see `Marks`


class FullModel:
    """A deck whose parameters are set before each solve.

    - `deck`: text of the deck
    - `cloud`: points of its model file
    - `threads`: threads of a solve
    """

    def __init__(
        self,
        deck: str,
        overrides: Sequence[str],
        cloud: PointCloud | None,
        threads: int | None = None,
    ) -> None:
        self.text = deck
        self.overrides = tuple(overrides)
        self.cloud = cloud
        self._threads = threads

    def open(self, more: Sequence[str] = ()) -> Scene:
        """Open the scene with further overrides."""
        return Scene.from_tables(
            self.text, self.cloud, overrides=[*self.overrides, *more], threads=self._threads
        )

    def loads(
        self, parameters: Sequence[Parameter], more: Sequence[str] = ()
    ) -> tuple[LoadParts, list[LoadParts]]:
        """Prescribed loads without the parameters, and the increment per unit of each parameter.

        A rotation has two fields: that of its sine and that of 1 - cosine.
        """
        own = [p for p in parameters if p.columns]

        def at(values: Mapping[str, float]) -> LoadParts:
            items = [override_text(p.key, values.get(p.key, 0.0)) for p in own]
            with self.open([*more, *items]) as scene:
                return load_parts(scene)

        base = at({})
        units = []
        for unit in own:
            if unit.kind == "rotation":
                right, left = (
                    _less(at({unit.key: angle / unit.end}), base) for angle in (90.0, -90.0)
                )
                units.append(LoadParts(*(0.5 * (r - m) for r, m in zip(right, left, strict=True))))
                units.append(LoadParts(*(0.5 * (r + m) for r, m in zip(right, left, strict=True))))
            else:
                units.append(_less(at({unit.key: 1.0 / unit.end}), base))
        return base, units

    def solve(
        self,
        parameters: Sequence[Parameter],
        values: F64,
        steps: int | None = None,
        start: F64 | None = None,
        *,
        doubted: bool = False,
    ) -> FullState:
        """Solve at values of the parameters, in the load steps of the deck or in `steps`.

        A guess `start` of the unknowns saves the path from rest. If the iteration from it fails,
        the path is followed, with few halvings where a state is `doubted`.

        - raises ConvergenceError: the solve stopped before its full load
        """
        begin = time.process_time()
        states = None
        if start is not None:
            scene = self._at(parameters, values, _FROM_GUESS)
            try:
                states = scene.solve(start=start, error=False)
            except ConvergenceError:
                states = None
            else:
                # a diverging iteration may have found another solution
                moved = np.linalg.norm(states.x[-1] - start)
                if moved > _NEAR * np.linalg.norm(states.x[-1]):
                    states = None
        started = states is not None
        if states is None:
            own = dict(self._from_rest)
            if steps is not None:
                own["load.steps"] = steps
            if doubted:
                own["load.max_halvings"] = min(own["load.max_halvings"], _FEW_HALVINGS)
            scene = self._at(parameters, values, own)
            states = scene.solve(error=False)
        cpu = time.process_time() - begin
        if len(states.load) == 0 or states.load[-1] < 1.0:
            raise ConvergenceError("the full model stopped before full load")
        mark = ACCEPTED if states.verdict == "accepted" else DOUBTFUL
        if states.unstable or states.verdict == "refused":
            mark = LOST
        return self._state(scene, states.x, states.load, cpu, started)._replace(mark=mark)

    @cached_property
    def _scene(self) -> Scene:
        """The scene that is updated from solve to solve."""
        return self.open()

    @cached_property
    def _from_rest(self) -> dict[str, Any]:
        """Settings of the deck for a solve from rest."""
        own = self._scene.deck
        return {
            "load.steps": own["load"]["steps"],
            "load.max_halvings": min(own["load"]["max_halvings"], _HALVINGS),
            "solver.max_iterations": own["solver"]["max_iterations"],
        }

    def _at(self, parameters: Sequence[Parameter], values: F64, own: Mapping[str, Any]) -> Scene:
        """The scene at values of the parameters, and with values of other keys."""
        wanted = {p.key: float(v) for p, v in zip(parameters, values, strict=True)}
        self._scene.update({**self._from_rest, **wanted, **own})
        return self._scene

    def _state(self, scene: Scene, x: F64, load: F64, cpu: float, started: bool) -> FullState:
        probes = scene.probes(x, load)
        mass = modal_products(scene, np.asfortranarray(x[-1:].T))[1][:, 0]
        return FullState(x, load, probes, mass, cpu, started)

    def lift(
        self,
        parameters: Sequence[Parameter],
        values: F64,
        x: F64,
        key: str,
        prescribed: float,
        step: float,
    ) -> F64:
        """Derivative of the unknowns with respect to a prescribed value, by a small step of it.

        - raises ConvergenceError: the solve with the step did not converge
        """
        before = {key: prescribed, "solver.tolerance": self._scene.deck["solver"]["tolerance"]}
        near = {"load.steps": 1, "load.max_halvings": 0, "solver.tolerance": 1e-8}
        scene = self._at(parameters, values, {**near, key: prescribed + step})
        try:
            states = scene.solve(start=x, error=False)
        finally:
            scene.update(before)
        if len(states.load) == 0 or states.load[-1] < 1.0:
            raise ConvergenceError(
                "the full model did not converge after a small change of the parameters"
            )
        return np.asarray((states.x[-1] - x) / step)


def _less(one: LoadParts, other: LoadParts) -> LoadParts:
    """Difference between the prescribed loads of two scenes."""
    return LoadParts(*(a - b for a, b in zip(one, other, strict=True)))
