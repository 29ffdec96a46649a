"""A reduced model over a grid of its parameters: a table and a picture."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.files import write_csv, write_figure, write_json
from myork.rom.marks import LOST, NAMES, NEAR_LOST
from myork.rom.model import Batch, ReducedModel
from myork.rom.parameters import grid_in
from myork.types import F64

#: States of one call: their arrays stay small
_AT_ONCE = 20_000


def map_model(
    rom: ReducedModel, vary: Sequence[str], fixed: Mapping[str, float], out: Path
) -> dict[str, Any]:
    """Evaluate a model on a grid.

    - `rom`: model
    - `vary`: `KEY=LOW:HIGH:N` each
    - `fixed`: values of other parameters by key or short name; those without one are in the middle
      of their range
    - `out`: folder of `map.csv`, `map.json` and `map.png`
    - returns what `map.json` holds: numbers of states, of failures, times
    """
    keys = [p.key for p in rom.parameters]
    axes = {rom.key_of(key): axis for key, axis in map(grid_in, vary)}
    values = {p.key: 0.5 * (p.low + p.high) for p in rom.parameters}
    values |= {rom.key_of(name): float(value) for name, value in fixed.items()}
    columns = [axes.get(key, np.array([values[key]])) for key in keys]
    grid = np.stack([a.ravel() for a in np.meshgrid(*columns, indexing="ij")], axis=1)
    start, cpu = time.perf_counter(), time.process_time()
    found = [
        rom.batch(grid[i : i + _AT_ONCE], indicator=True) for i in range(0, len(grid), _AT_ONCE)
    ]
    wall, cpu = time.perf_counter() - start, time.process_time() - cpu
    probes = {name: np.concatenate([f.probes[name] for f in found]) for name in found[0].probes}
    force, _, *others = zip(*found, strict=True)
    joined = Batch(np.concatenate(force), probes, *map(np.concatenate, others))
    summary = {
        "states": len(grid),
        "failed": int((~joined.converged).sum()),
        "outside": int((~joined.inside).sum()),
        "certified": int(joined.certified.sum()),
        "full": {name: int((joined.full == k).sum()) for k, name in enumerate(NAMES)},
        "largest_indicator": float(np.nanmax(joined.indicator)),
        "wall_s": wall,
        "cpu_s": cpu,
        "cpu_us_per_state": 1e6 * cpu / len(grid),
        "vary": {key: [float(a[0]), float(a[-1]), len(a)] for key, a in axes.items()},
        "fixed": {key: values[key] for key in keys if key not in axes},
        "units": rom.units,
        "probe_units": rom.probe_units,
    }
    out.mkdir(parents=True, exist_ok=True)
    table = dict(zip(keys, grid.T, strict=True)) | joined.scalars()
    table |= {
        "indicator": joined.indicator,
        "inside": joined.inside.astype(int),
        "full": np.array(NAMES)[joined.full],
        "certified": joined.certified.astype(int),
        "converged": joined.converged.astype(int),
        "iterations": joined.iterations,
    }
    write_csv(out / "map.csv", table, zip(*(v.tolist() for v in table.values()), strict=True))
    _draw(rom, list(axes), grid, joined, out / "map.png")
    write_json(out / "map.json", summary)
    return summary


def _draw(rom: ReducedModel, axes: list[str], grid: F64, batch: Batch, path: Path) -> None:
    """Force and estimated error over the first one or two keys, the others at their first value.

    What lies near lost states is hatched, or red in a curve.
    """
    from matplotlib.figure import Figure

    keys = [p.key for p in rom.parameters]
    shown = [key for key in axes if len(np.unique(grid[:, keys.index(key)])) > 1][:2]
    if not shown:
        return
    rest = [j for j, key in enumerate(keys) if key not in shown]
    on = np.all(grid[:, rest] == grid[0, rest], axis=1)
    force = batch.force if batch.force.ndim == 1 else np.linalg.norm(batch.force, axis=1)
    force = np.where(batch.converged, force, np.nan)
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    named = next((q for q in rom.head["probes"] if q["quantity"].startswith("force")), None)
    label = "no force probe" if named is None else f"{named['name']} [{named['unit']}]"
    x = grid[on][:, keys.index(shown[0])]
    lost = batch.full[on] == LOST
    for axis, value, title in zip(
        figure.subplots(1, 2),
        (force[on], np.log10(np.maximum(batch.indicator[on], 1e-12))),
        (label, "log10 of the estimated relative error"),
        strict=True,
    ):
        axis.set_xlabel(shown[0])
        if len(shown) == 1:
            axis.plot(x, value)
            axis.plot(x, np.where(lost, value, np.nan), color="C3")
            axis.set_ylabel(title)
            axis.grid(alpha=0.3)
        else:
            y = grid[on][:, keys.index(shown[1])]
            shape = (len(np.unique(x)), len(np.unique(y)))
            drawn = axis.contourf(
                x.reshape(shape), y.reshape(shape), value.reshape(shape), levels=24
            )
            figure.colorbar(drawn, ax=axis, label=title)
            if lost.any():
                over = lost.reshape(shape).astype(float)
                axis.contourf(
                    x.reshape(shape), y.reshape(shape), over, levels=[0.5, 2.0], colors="none",
                    hatches=["//"],
                )  # fmt: skip
            axis.set_ylabel(shown[1])
    fixed = ", ".join(f"{keys[j]} = {grid[0, j]:.4g}" for j in rest)
    word = "red" if len(shown) == 1 else "hatched"
    note = f"\n{word}: {NEAR_LOST}" if lost.any() else ""
    figure.suptitle(f"{rom.head['title']}{': ' + fixed if fixed else ''}{note}")
    write_figure(path, figure)
