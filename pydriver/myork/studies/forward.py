"""Answers for values of parameters: by a reduced model, or by full solves of an open scene."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.core.changing import ChangingScene
from myork.core.deck import deck_key
from myork.core.scene import Scene
from myork.errors import ConvergenceError, InputError
from myork.rom.model import ReducedModel
from myork.rom.parameters import numbers_in, numbers_of
from myork.rom.probes import places_of, units_of
from myork.types import F64


class Forward(NamedTuple):
    """A model that answers for values of the keys asked for, others fixed."""

    by: str  #: What answers
    units: dict[str, str]  #: Unit of each number of the probes
    key_of: Callable[[str], str]  #: Full name of a key of the deck
    #: Numbers of the probes by name, not a number where no state was found, shape `(n,)` each, for
    #: keys, the same ones in every call, and their values, shape `(n, keys)`
    ask: Callable[[Sequence[str], F64], dict[str, F64]]
    close: Callable[[], None]
    ranges: dict[str, tuple[float, float]]  #: Of the training by key; none of a full model
    unfixed: Sequence[str] = ()  #: Keys that need a value in every call


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
        return _reduced(source, fixed, threads)
    return _full(source, fixed, out, threads, progress)


def _reduced(path: Path, fixed: Sequence[str], threads: int | None) -> Forward:
    rom = ReducedModel.load(path, threads=threads or 0)
    own = {rom.key_of(name): value for name, value in numbers_of(fixed).items()}

    def ask(keys: Sequence[str], values: F64) -> dict[str, F64]:
        given = {**own, **dict(zip(keys, values.T, strict=True))}
        batch = rom.batch(rom.rows(given, len(values)))
        return {k: np.where(batch.converged, v, np.nan) for k, v in batch.scalars().items()}

    units = units_of(rom.head["probes"], rom.head["dimension"], rom.probe_units)
    ranges = {p.key: (p.low, p.high) for p in rom.parameters}
    unfixed = [key for key in ranges if key not in own]
    return Forward("the reduced model", units, rom.key_of, ask, lambda: None, ranges, unfixed)


def _full(
    deck: Path,
    overrides: Sequence[str],
    out: Path | None,
    threads: int | None,
    progress: ProgressCallback,
) -> Forward:
    full = ChangingScene(lambda more: Scene(deck, [*overrides, *more], out, threads))
    scene = full.scene
    probes, steps = scene.deck["probe"], scene.deck["load"]["steps"]
    units = units_of(probes, scene.dimension, scene.probe_units)
    places = places_of(probes, scene.dimension)
    known: list[tuple[F64, F64]] = []

    def state(changes: dict[str, float], row: F64) -> F64:
        """Unknowns: from the nearest known state in one step, else from rest."""
        if known:
            rows = np.array([own for own, _ in known])
            scale = np.maximum(np.ptp(np.vstack([rows, row]), axis=0), 1e-300)
            near = int(np.argmin((((rows - row) / scale) ** 2).sum(axis=1)))
            try:
                once = full.at({**changes, "load.steps": 1})
                return np.asarray(once.solve(error=False, start=known[near][1]).x[-1])
            except ConvergenceError:
                pass
        return np.asarray(full.at({**changes, "load.steps": steps}).solve(error=False).x[-1])

    def ask(keys: Sequence[str], values: F64) -> dict[str, F64]:
        found = {name: np.full(len(values), np.nan) for name in units}
        for i, row in enumerate(values):
            changes = dict(zip(keys, row.tolist(), strict=True))
            try:
                x = state(changes, row)
            except ConvergenceError as reason:
                place = ", ".join(f"{key} = {value:.4g}" for key, value in changes.items())
                progress(f"no state at {place}: {reason}")
                continue
            known.append((row, x))
            value = full.scene.probes(x[None], np.ones(1))[0]
            for name, at in places.items():
                found[name][i] = value[at]
        return found

    return Forward(
        "full solves", units, lambda name: deck_key(deck, name, overrides), ask,
        lambda: full.scene.close(), {},
    )  # fmt: skip


def ranges_of(forward: Forward, items: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Ranges from texts `KEY=LOW:HIGH`, or `KEY` alone for the range of the training."""
    found = {}
    for item in items:
        name, ends = item.strip(), list[float]()
        if "=" in item:
            name, ends = numbers_in(item, "KEY=LOW:HIGH", "--free")
        key = forward.key_of(name)
        low, high = ends or forward.ranges.get(key, (0.0, 0.0))
        if not low < high:
            raise InputError(f"--free {item}: KEY=LOW:HIGH is needed, LOW below HIGH")
        if key in found:
            raise InputError(f"--free {item}: the key is given twice; give it once")
        found[key] = (low, high)
    return found
