"""Full solutions at parameters of a reduced model that is trained."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from myork.core.galerkin import LoadParts, load_parts, modal_products
from myork.core.scene import Scene
from myork.errors import ConvergenceError
from myork.model_file import read_model, write_model
from myork.records import PointCloud
from myork.rom.parameters import Parameter, override

__all__ = ["FullModel", "FullState", "cloud_arrays", "full_model_of"]

F64Array = NDArray[np.float64]


class FullState(NamedTuple):
    """Converged states of one full solve on the way to its parameters.

    Attributes
    ----------
    x : F64Array
        Unknowns, shape `(steps, n)`.
    load : F64Array
        Part of the way, shape `(steps,)`.
    probes : F64Array
        Values of the probes, shape `(steps, probes, 3)`.
    mass : F64Array
        The last unknowns times the mass of density one, shape `(n,)`: their product is the square
        of the displacement over the body.
    cpu_s : float
        Processor time of the solve [s].
    """

    x: F64Array
    load: F64Array
    probes: F64Array
    mass: F64Array
    cpu_s: float


class FullModel:
    """A deck whose parameters are set before each solve.

    Parameters
    ----------
    deck : str
        Text of the deck.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    cloud : PointCloud or None
        Points of its model file.
    threads : int, optional
        Threads of a solve.
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
        with tempfile.TemporaryDirectory(prefix="myork-") as folder:
            path = Path(folder, "deck.toml")
            path.write_text(self.text, encoding="utf-8")
            if self.cloud is not None:
                write_model(Path(folder, "model.h5"), self.cloud)
                more = (*more, "geometry.file=model.h5")
            return Scene(path, [*self.overrides, *more], threads=self._threads)

    def loads(self, parameters: Sequence[Parameter]) -> tuple[LoadParts, list[LoadParts]]:
        """What is prescribed without the parameters, and what a unit of each one adds."""
        own = [p for p in parameters if p.kind == "load"]
        with self.open([override(p, 0.0) for p in own]) as scene:
            base = load_parts(scene)
        units = []
        for unit in own:
            values = [override(p, float(p is unit)) for p in own]
            with self.open(values) as scene:
                found = load_parts(scene)
            pairs = zip(found, base, strict=True)
            units.append(LoadParts(*(one - other for one, other in pairs)))
        return base, units

    def solve(
        self,
        parameters: Sequence[Parameter],
        values: F64Array,
        steps: int | None = None,
    ) -> FullState:
        """Solve at values of the parameters, in as many steps as the deck says or in `steps`.

        Raises
        ------
        ConvergenceError
            The solve ended before its full load.
        """
        more = [override(p, v) for p, v in zip(parameters, values, strict=True)]
        if steps is not None:
            more.append(f"load.steps={steps}")
        with self.open(more) as scene:
            start = time.process_time()
            states = scene.solve(error=False)
            cpu = time.process_time() - start
            if len(states.load) == 0 or states.load[-1] < 1.0:
                raise ConvergenceError("the full model ended before its full load")
            probes = scene.probes(states.x, states.load)
            mass = modal_products(scene, np.asfortranarray(states.x[-1:].T))[1][:, 0]
        return FullState(states.x, states.load, probes, mass, cpu)

    def lift(
        self,
        parameters: Sequence[Parameter],
        values: F64Array,
        x: F64Array,
        key: str,
        prescribed: float,
        step: float,
    ) -> F64Array:
        """How unknowns at values follow a value that is prescribed, by a small step of it.

        Raises
        ------
        ConvergenceError
            The solve did not follow.
        """
        more = [override(p, v) for p, v in zip(parameters, values, strict=True)]
        more += [f"{key}={prescribed + step!r}", "load.steps=1", "solver.tolerance=1e-8"]
        with self.open(more) as scene:
            states = scene.solve(start=x, error=False)
            if len(states.load) == 0 or states.load[-1] < 1.0:
                raise ConvergenceError("the full model did not follow a small step")
        return np.asarray((states.x[-1] - x) / step)


def cloud_arrays(cloud: PointCloud) -> dict[str, Any]:
    """The points of a model as one array: the bytes of its file."""
    with tempfile.TemporaryDirectory(prefix="myork-") as folder:
        path = Path(folder, "model.h5")
        write_model(path, cloud)
        return {"cloud": np.frombuffer(path.read_bytes(), np.uint8)}


def full_model_of(arrays: Mapping[str, Any], head: Mapping[str, Any], threads: int) -> FullModel:
    """The full model that a reduced one was made of."""
    cloud = None
    if "cloud" in arrays:
        with tempfile.TemporaryDirectory(prefix="myork-") as folder:
            path = Path(folder, "model.h5")
            path.write_bytes(np.asarray(arrays["cloud"]).tobytes())
            cloud = read_model(path)
    return FullModel(head["deck"], head["overrides"], cloud, threads or None)
