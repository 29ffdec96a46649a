"""Table of a reduced model on a grid of its parameters."""

import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from myork.files import write_csv, write_json
from myork.rom.marks import NAMES
from myork.rom.model import Batch, ReducedModel
from myork.rom.parameters import grid_in

#: States per call, so that arrays stay small
_AT_ONCE = 20_000


def map_model(
    rom: ReducedModel, vary: Sequence[str], fixed: Mapping[str, float], out: Path
) -> dict[str, Any]:
    """Evaluate a model on a grid.

    - `rom`: model
    - `vary`: `KEY=LOW:HIGH:N` each
    - `fixed`: values of other parameters by key or short name; those not given take the middle of
      their range
    - `out`: folder of `map.csv` and `map.json`
    - returns the content of `map.json`: numbers of states, of failures, times
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
    write_json(out / "map.json", summary)
    return summary
