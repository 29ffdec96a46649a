"""Answers for values of parameters: by a reduced model, or by full solves of an open scene."""

import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.changing import ChangingScene
from myork.core.deck import deck_key
from myork.core.scene import Scene
from myork.errors import ConvergenceError, InputError
from myork.rom.model import ReducedModel
from myork.rom.parameters import numbers_in, numbers_of
from myork.rom.probes import places_of
from myork.types import F64, Mask


class Values(NamedTuple):
    """Answers for many sets of parameters."""

    #: Scalars by name, those of vectors with their axis behind (`pull_x`), shape `(n,)` each
    probes: dict[str, F64]
    good: Mask  #: Whether a state was found, shape `(n,)`


class Forward:
    """A model that answers for values of the keys asked for, others fixed.

    - `probes`, `dimension`, `units`: of the deck: its probes, and the unit of each by its name
    - `key_of`: full name of a key of the deck
    """

    is_reduced = False  #: Whether a reduced model answers

    def __init__(
        self,
        probes: Sequence[Mapping[str, Any]],
        dimension: int,
        units: Mapping[str, str],
        key_of: Callable[[str], str],
    ) -> None:
        self.key_of = key_of
        #: States asked for so far, and their processor time [s]
        self.states, self.cpu_s = 0, 0.0
        self._places = places_of(probes, dimension)
        named = {name: probes[i] for name, (i, _) in self._places.items()}
        #: Unit of each scalar, and those that are forces
        self.units = {name: units[probe["name"]] for name, probe in named.items()}
        self.forces = [name for name, probe in named.items() if "force" in probe["quantity"]]

    def range_of(self, key: str) -> tuple[float, float] | None:
        """Range of the training; none of a full model."""
        return None

    def ask(self, keys: Sequence[str], values: F64) -> Values:
        """Answers for rows of values of the keys, shape `(n, len(keys))`."""
        start = time.process_time()
        found = self._answer(keys, values)
        self.cpu_s += time.process_time() - start
        self.states += len(values)
        return found

    def unknown(self, keys: Sequence[str]) -> list[str]:
        """Keys that still need a value."""
        return []

    def close(self) -> None:
        """Give back what is open; the file of a reduced model is closed already."""

    def cost(self) -> dict[str, Any]:
        """States and processor time so far."""
        return {"states": self.states, "cpu_s": self.cpu_s, "by": "full solves"}

    def _answer(self, keys: Sequence[str], values: F64) -> Values:
        """What `ask` gives, without its count."""
        raise NotImplementedError


class _Reduced(Forward):
    is_reduced = True

    def __init__(self, path: Path, fixed: Sequence[str], threads: int) -> None:
        self._rom = rom = ReducedModel.load(path, threads=threads)
        super().__init__(rom.head["probes"], rom.head["dimension"], rom.probe_units, rom.key_of)
        self._fixed = {rom.key_of(name): v for name, v in numbers_of(fixed).items()}

    def range_of(self, key: str) -> tuple[float, float] | None:
        return next((p.low, p.high) for p in self._rom.parameters if p.key == key)

    def unknown(self, keys: Sequence[str]) -> list[str]:
        return [p.key for p in self._rom.parameters if p.key not in {*keys, *self._fixed}]

    def cost(self) -> dict[str, Any]:
        full = self._rom.head["full_cpu_s"]
        more = {"full_cpu_s_per_state": full, "full_cpu_s": full * self.states}
        return {**super().cost(), "by": "the reduced model", **more}

    def _answer(self, keys: Sequence[str], values: F64) -> Values:
        given = {**self._fixed, **dict(zip(keys, values.T, strict=True))}
        batch = self._rom.batch(self._rom.rows(given, len(values)))
        return Values(batch.scalars(), batch.converged)


class _Full(Forward):
    def __init__(
        self,
        deck: Path,
        overrides: Sequence[str],
        out: Path | None,
        threads: int | None,
        progress: ProgressCallback,
    ) -> None:
        self._open = lambda more: Scene(deck, [*overrides, *more], out, threads=threads)
        self._progress = progress
        self._full = ChangingScene(self._open)
        scene = self._full.scene
        super().__init__(
            scene.deck.get("probe", []), scene.dimension, scene.probe_units,
            lambda name: deck_key(deck, name, overrides),
        )  # fmt: skip
        self._steps = scene.deck["load"]["steps"]
        self._known: list[tuple[F64, F64]] = []
        self._keys: tuple[str, ...] = ()

    def close(self) -> None:
        self._full.scene.close()

    def _answer(self, keys: Sequence[str], values: F64) -> Values:
        if tuple(keys) != self._keys:
            if self._keys:
                # values of keys that are not asked for any more are the deck's
                self.close()
                self._full = ChangingScene(self._open)
            self._keys, self._known = tuple(keys), []
        good = np.zeros(len(values), bool)
        found = {name: np.full(len(values), np.nan) for name in self.units}
        for i, row in enumerate(values):
            try:
                x = self._solve(row)
            except ConvergenceError as reason:
                place = ", ".join(f"{k} = {v:.4g}" for k, v in zip(keys, row, strict=True))
                self._progress(f"no state at {place}: {reason}")
                continue
            good[i] = True
            value = self._full.scene.probes(x[None], np.ones(1))[0]
            for name, at in self._places.items():
                found[name][i] = value[at]
            self._progress(f"solve {i + 1}/{len(values)}")
        return Values(found, good)

    def _solve(self, row: F64) -> F64:
        """Unknowns of a state: from the nearest known one in one step, else from rest."""
        changes = dict(zip(self._keys, (float(v) for v in row), strict=True))
        starts: list[F64 | None] = [None]
        if self._known:
            rows = np.array([known for known, _ in self._known])
            scale = np.maximum(np.ptp(np.vstack([rows, row]), axis=0), 1e-300)
            near = int(np.argmin((((rows - row) / scale) ** 2).sum(axis=1)))
            starts.insert(0, self._known[near][1])
        for start in starts:
            steps = {"load.steps": self._steps if start is None else 1}
            scene = self._full.at({**changes, **steps})
            try:
                x = np.asarray(scene.solve(error=False, start=start).x[-1])
            except ConvergenceError:
                if start is None:
                    raise
                continue
            self._known.append((row, x))
            return x
        raise AssertionError("the last start raises or returns")


def open_forward(
    source: str | Path,
    fixed: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
    out: Path | None = None,
) -> Forward:
    """A reduced model (`.rom.h5`) or a deck, with `KEY=VALUE` of what is fixed.

    The model file of a deck is looked for in `out` first.

    - raises InputError: a key or a value is wrong
    """
    source = Path(source)
    if source.name.endswith(".h5"):
        return _Reduced(source, fixed, threads or 0)
    return _Full(source, fixed, out, threads, progress)


def ranges_of(
    forward: Forward, items: Sequence[str], option: str
) -> dict[str, tuple[float, float]]:
    """Ranges from texts `KEY=LOW:HIGH`, or `KEY` alone for the range of the training."""
    found = {}
    for item in items:
        name, ends = item.strip(), list[float]()
        if "=" in item:
            name, ends = numbers_in(item, "KEY=LOW:HIGH", option)
        key = forward.key_of(name)
        low, high = ends or forward.range_of(key) or (0.0, 0.0)
        if not (np.isfinite([low, high]).all() and low < high):
            raise InputError(f"{option} {item}: KEY=LOW:HIGH is needed, LOW below HIGH")
        if key in found:
            raise InputError(f"{option} {item}: the key is named twice; give it once")
        found[key] = (low, high)
    return found


def probe_of(forward: Forward, asked: str | None) -> str:
    """Name of the scalar asked for, the first force by default."""
    if asked is None:
        if not forward.forces:
            raise InputError(f"--probe: name one of {', '.join(forward.units) or 'none'}")
        return forward.forces[0]
    if asked not in forward.units:
        raise InputError(f"--probe {asked}: there are {', '.join(forward.units)}")
    return asked
