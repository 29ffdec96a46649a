"""Open scenes in the compiled core: solve, evaluate, reduce."""

import contextlib
import json
import os
import warnings
import weakref
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from myork import _core, errors
from myork.core.calls import Turn, answer, call_in_thread, listening
from myork.core.checks import finite, modes_of, shaped, unknowns_of
from myork.core.cloud import NO_CLOUD, check_cloud, model_of, packed, with_cloud
from myork.core.deck import (
    NAME_OF_TABLES,
    as_texts,
    check_deck,
    deck_values,
    load_deck,
    text_of_tables,
)  # fmt: skip
from myork.core.states import Fields, States, states_of
from myork.core.threads import checked_threads
from myork.records import PointCloud
from myork.results import RestartState
from myork.tables import override_text, read_only
from myork.types import F64, I32


class Scene(contextlib.AbstractContextManager["Scene"]):
    """A scene in memory: solve, evaluate and reduce it without files.

    `Scene(path)` opens a deck file, `Scene.from_tables` opens data.

    - `path`: deck file
    - `overrides`: `"table.key=value"` each
    - `out`: folder in which the model file of the deck is looked for first
    - `threads`: number of threads of a solve; default all cores
    - `progress`: called with every line of a search for points, which a deck without points starts
      when it is opened; without it lines go to the logger `myork`, those of a long search as
      warnings
    - raises InputError: the deck, the model or the points are wrong; the message says where
    - raises FileError: the model file is missing

    Attributes
    ----------
    - `deck`: the effective deck, defaults and overrides included; read-only
    - `dimension`: space dimension
    - `source_points`, `collocation_points`: numbers of points
    - `dofs`, `rows`: unknowns and equations
    - `steps`: load steps
    - `points_found`: overrides that give the deck the points that its search found; empty if
      nothing was searched

    >>> from myork import Scene
    >>> with Scene("inputs/shear_3d.toml", ["load.steps=20"]) as scene:  # doctest: +SKIP
    ...     states = scene.solve()
    ...     stress = scene.fields(states.x[-1], 1.0).cauchy
    """

    def __init__(
        self,
        path: str | Path,
        overrides: Sequence[str] = (),
        out: Path | None = None,
        threads: int | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        if isinstance(path, Mapping):
            raise errors.InputError(
                "Scene opens the file of a deck: use Scene.from_tables for its tables"
            )
        deck = load_deck(path, overrides, "solve")
        self._hold("", overrides, model_of(deck, Path(path).parent, out), threads)
        self._open(deck, overrides, progress)

    @classmethod
    def from_tables(
        cls,
        tables: Mapping[str, Any] | str,
        cloud: PointCloud | None = None,
        *,
        overrides: Sequence[str] = (),
        out: Path | None = None,
        threads: int | None = None,
        progress: Callable[[str], None] | None = None,
    ) -> "Scene":
        """Open a scene from data, without a file unless the tables name a model file.

        - `tables`: tables with the keys of a deck, arrays of tables as lists of mappings, or the
          text of a deck. Without `title` the title is "scene"; without `units`, forces are in N and
          lengths in cm, the units of the default muscle parameters, or in those of the cloud.
        - `cloud`: points of the body, in place of a model file; the table `geometry` is then left
          out
        - `overrides`, `out`, `threads`, `progress`: as in `Scene`

        >>> from myork import Scene
        >>> n = [7, 7]
        >>> square = {
        ...     "scene": {"dimension": 2},
        ...     "geometry": {"kind": "box", "size": [1, 1], "source": n, "collocation": n},
        ...     "material": [{"name": "rubber", "model": "polynomial", "A10": 10, "K": 500}],
        ...     "boundary": [{"set": "x0", "u_x": 0, "u_y": 0}, {"set": "x1", "u_x": 0.2}],
        ... }
        >>> with Scene.from_tables(square) as scene:  # doctest: +SKIP
        ...     states = scene.solve()
        """
        if isinstance(tables, Mapping):
            tables = text_of_tables(tables if cloud is None else with_cloud(tables, cloud))
        deck = deck_values(NAME_OF_TABLES, tables, overrides, "solve")
        cloud = model_of(deck, Path(), out) if cloud is None else check_cloud(deck, cloud)
        scene = cls.__new__(cls)
        scene._hold(tables, overrides, cloud, threads)
        scene._open(deck, overrides, progress)
        return scene

    def _hold(
        self,
        text: str,
        overrides: Sequence[str],
        model: PointCloud | None,
        threads: int | None,
    ) -> None:
        """Store what the scene is opened from; the text is empty where the deck is a file."""
        self._text, self._overrides, self._model = text, tuple(overrides), model
        self._changes: dict[str, str] = {}
        self._threads = checked_threads(threads)
        self._turn = Turn()

    def _open(
        self, deck: dict[str, Any], words: Sequence[str], progress: Callable[[str], None] | None
    ) -> None:
        """Pass deck, overrides and points to the core."""
        with listening(progress) as listener:
            handle, stat, message = _core.scene_open(
                os.fsencode(deck["path"]),
                self._text.encode() or b" ",
                as_texts(words),
                *packed(NO_CLOUD if self._model is None else self._model),
                listener,
            )
        check_deck(stat, message, self._text)
        self._address = handle
        self.points_found = tuple(answer(handle, "found")["overrides"].split())
        for word in self.points_found:
            key, _, value = word.partition("=")
            deck["geometry"][key.removeprefix("geometry.")] = json.loads(value)
        self.deck = read_only(deck)
        self._has_fields = False
        self._states: States | None = None
        self._close = weakref.finalize(self, _close, handle, self._turn)
        (
            self.dimension,
            self.source_points,
            self.collocation_points,
            self.dofs,
            self.rows,
            self._probes,
            self.steps,
            _,
        ) = answer(handle, "sizes")["sizes"].tolist()
        self._unknowns = 0

    @property
    def _handle(self) -> int:
        """Handle of the open scene."""
        if not self._close.alive:
            raise errors.InputError("this scene is closed")
        return self._address

    def _ask(self, question: str, *given: ArrayLike, word: str = "") -> dict[str, Any]:
        """Answer of the core about this scene, see `answer`."""
        with self._turn.short():
            return answer(self._handle, question, *given, word=word)

    def __repr__(self) -> str:
        return (
            f"Scene({self.deck['title']!r}: {self.dimension}-D, {self.source_points} source points,"
            f" {self.dofs} unknowns, {self.steps} load step{'s' * (self.steps != 1)})"
        )

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the memory; the scene cannot be used afterwards.

        A solve in another thread is stopped first.
        """
        if self._turn.is_mine:
            raise errors.InputError("a scene cannot be closed from the progress of its own solve")
        self._close()

    def update(self, changes: Mapping[str, Any]) -> None:
        """Open the scene again with other values of its keys; its points are kept.

        - `changes`: values by key, as in `--set`: `{"material.muscle.K": 100, "load.activation":
          0.4}`
        - raises InputError: a wrong value; the scene is unchanged

        >>> with Scene("inputs/muscle_block.toml") as scene:  # doctest: +SKIP
        ...     for bulk in (100, 1000):
        ...         scene.update({"material.muscle.K": bulk})
        ...         states = scene.solve()
        """
        if not isinstance(changes, Mapping):
            raise errors.InputError("changes must be values by key: {'material.muscle.K': 100}")
        if self._has_fields:
            raise errors.InputError("loads set by set_fields would be lost: open another scene")
        if self._model is not None and any(key.startswith("geometry.") for key in changes):
            raise errors.InputError("the points come from a model: open another scene")
        # a later value must override earlier ones set under another name of its key
        every = {k: word for k, word in self._changes.items() if k not in changes}
        every |= {key: override_text(key, value) for key, value in changes.items()}
        if every == self._changes:
            return
        found = self.points_found
        words = [*self._overrides, *found, *every.values()]
        deck = deck_values(self.deck["path"], self._text, words, "solve")
        with self._turn.short():
            before, close = self._handle, self._close
            self._open(deck, words, None)
            close.detach()
            _core.scene_close(before)
            self.points_found, self._changes = found, every

    @property
    def probe_units(self) -> dict[str, str]:
        """Unit of each probe by its name, empty for ratios."""
        return dict(self.deck["probe_units"])

    @property
    def states(self) -> States | None:
        """Converged states of the last solve, also of one that failed or was stopped."""
        return self._states

    def solve(
        self,
        linear: str = "",
        progress: Callable[[str], None] | None = None,
        *,
        error: bool = True,
        start: F64 | States | RestartState | str | Path | None = None,
    ) -> States:
        """Solve the full model through all load steps, and judge the answer.

        A refused answer raises no exception: check `verdict`.

        - `linear`: least squares solver; if empty, that of the deck
        - `progress`: called with a line after each load step
        - `error`: compute a second solution, which gives the probes their error bars
        - `start`: state from which the iteration begins instead of the state at rest: unknowns of
          shape `(dofs,)`, `States` (the last one), or a state of a result file, also as `"FILE"` or
          `"FILE:STEP"`. It must belong to the same points and approximation. A programme whose
          amplitudes begin with other values than 0 begins there, in equilibrium with what it
          prescribes at load time 0. Otherwise a start saves the path to the first load step, and
          decides which state is found where there are several: a body has no memory. Where no
          equilibrium is found from it the solve begins at rest.
        - raises ConvergenceError: a load step failed, also after halving; `states` has those
          before it
        - raises KeyboardInterrupt: Ctrl-C stopped the solve after its iteration; `states` has the
          converged states
        - raises InputError: the scene is being solved in another thread, or the start belongs to
          another scene
        """
        x = np.zeros(self.dofs) if start is None else self.unknowns_of(start)
        return self._run(linear, False, x, progress, error)

    def unknowns_of(self, state: F64 | States | RestartState | str | Path) -> F64:
        """Unknowns of a state from which `solve` can begin, shape `(dofs,)`.

        - raises InputError: it belongs to other points or to another approximation
        """
        approximation = self._ask("approximation")["text"]
        return unknowns_of(state, self.points(), approximation, self.dofs)

    def points(self) -> F64:
        """Collocation points, shape `(collocation_points, dimension)` [length]."""
        return np.asarray(self._ask("points")["place"].T)

    def surface(self) -> I32:
        """Corners of the surface's triangles among `points`, counter-clockwise from outside.

        The triangles of a plane body fill it; there are none where the points form no lattice.
        Shape `(m, 3)`.
        """
        return np.ascontiguousarray(self._ask("surface")["surface"].T)

    def field_points(self) -> F64:
        """Points at which `set_fields` takes values, shape `(field_points, dimension)` [length].

        Collocation points; in weak forms the integration points, then those of the surface.
        """
        return np.asarray(self._ask("field_points")["place"].T)

    def set_fields(self, body_force: F64, displacement: F64, stress: F64) -> None:
        """Set fields that vary from point to point, at full load; they scale with the load.

        - `body_force`: force per undeformed volume, shape `(field_points, 3)` [force/length^3]
        - `displacement`: taken at prescribed components of boundary points, same shape [length]
        - `stress`: first Piola-Kirchhoff stress `P[point, i, A]`; its traction acts on the other
          components of boundary points, shape `(field_points, 3, 3)` [stress]
        """
        n = len(self.field_points())
        finite("body_force", body_force, (n, 3))
        finite("displacement", displacement, (n, 3))
        finite("stress", stress, (n, 3, 3))
        self._ask("set_fields", body_force.T, displacement.T, np.moveaxis(stress, 0, -1))
        self._has_fields = True

    def reduce(self, modes: F64, projection: str = "auto", *, assembled: bool = False) -> None:
        """Project the model onto modes.

        - `modes`: orthonormal columns, shape `(dofs, r)`
        - `projection`: `galerkin`, `least-squares`, or `auto`: least squares for collocation
        - `assembled`: assemble the rows of nonlinear collocation in full before they are projected
        """
        modes = modes_of(modes, self.dofs)
        self._ask("reduce", assembled, modes, word=projection)
        self._unknowns = modes.shape[1]

    def solve_reduced(self, linear: str) -> States:
        """Solve the reduced model through all load steps; call `reduce` first."""
        return self._run(linear, True, np.zeros(self._unknowns), None, False)

    def linearise(
        self,
        x: F64,
        load: float,
        direction: F64,
        *,
        start: F64 | None = None,
        reduced: bool = False,
    ) -> tuple[F64, F64]:
        """Residual of a state, and the linearised rows times a direction.

        - `x`, `direction`: unknowns and a change of them, shape `(dofs,)`, or `(r,)` of the reduced
          model
        - `load`: fraction of the full load
        - `start`: state at the start of the load step, which fixes the row weights; default `x`
        - `reduced`: use the reduced model; call `reduce` first
        - returns `residual`, `product`: shape `(rows,)` each; of a reduced Galerkin form `(r,)`
        - raises InputError: a wrong shape, or a state with J <= 0
        """
        shape = (self._unknowns if reduced else self.dofs,)
        given = (x if start is None else start, x, direction)
        states = [shaped("states and directions", array, shape) for array in given]
        r, y = self._ask("linearise", reduced, load, *states).values()
        return r, y

    def fields(self, x: F64, load: float) -> Fields:
        """Fields of a state of the full model, coefficients of shape `(dofs,)`.

        - warns RuntimeWarning: some places have no finite value; where J <= 0 there is no stress
        """
        x = shaped("x", x, (self.dofs,))
        named = {name: values.T for name, values in self._ask("fields", load, x).items()}
        bad = np.flatnonzero(~np.isfinite(np.hstack(list(named.values()))).all(axis=1))
        if len(bad):
            warnings.warn(
                f"{len(bad)} of {self.collocation_points} points have fields that are not finite, "
                f"the first at {self.points()[bad[0]].tolist()}: J falls to "
                f"{named['J'].min():.3g}, and where it is not positive the material is "
                "inverted and has no stress; use more points there or less load",
                RuntimeWarning,
                stacklevel=2,
            )
        f = named["F"].reshape(-1, 3, 3)
        return Fields(named["u"], f, named["cauchy"], named)

    def probes(self, x: F64, load: F64) -> F64:
        """Probe values of states of the full model, shape `(nstep, nprobe, 3)`."""
        load = np.atleast_1d(np.asarray(load, float))
        x = shaped("x", x, (len(load), self.dofs))
        return np.moveaxis(self._ask("probes", x.T, load)["value"], (0, 1, 2), (2, 1, 0))

    def _run(
        self,
        linear: str,
        reduced: bool,
        start: F64,
        progress: Callable[[str], None] | None,
        estimate: bool,
    ) -> States:
        """Solve in a thread, so that Ctrl-C and progress are handled."""
        failed: list[errors.MyorkError] = []
        said = 0

        def work() -> None:
            try:
                answer(handle, "solve", self._threads, reduced, estimate, start, word=linear)
            except errors.MyorkError as reason:
                failed.append(reason)

        def poll() -> None:
            nonlocal said
            done, iterations = _core.scene_progress(handle, 0)
            if progress is not None and done > said:
                progress(f"step {done:3d}/{self.steps}  iterations so far {iterations}")
                said = done

        with self._turn.long():
            handle = self._handle
            self._states = None
            try:
                interrupted = call_in_thread(work, poll, lambda: _stop(handle))
            finally:
                # none where the solve was refused before it began
                with contextlib.suppress(errors.InputError):
                    self._states = states_of(answer(handle, "states"))
        if interrupted:
            raise KeyboardInterrupt
        if failed:
            raise failed[0]
        assert self._states is not None
        return self._states


def _stop(handle: int) -> None:
    """Ask a solve to stop after its current iteration."""
    _core.scene_progress(handle, 1)


def _close(handle: int, turn: Turn) -> None:
    """Close a scene when nothing runs in it; Python also calls this at exit."""
    with turn.last(lambda: _stop(handle)):
        _core.scene_close(handle)
