"""What a force depends on: Sobol's indices over the ranges of parameters."""

import warnings
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import ConvergenceError, InputError
from myork.files import write_csv, write_figure, write_json
from myork.studies.forward import Forward, Values, open_forward, probe_of, ranges_of
from myork.types import F64

#: Part of the samples that may have no state; others take their places
_MOST_FAILED = 0.1
#: Confidence of the intervals, by resampling
_CONFIDENCE, _RESAMPLES = 0.95, 999


def sensitivity(
    source: str | Path,
    out: str | Path,
    *,
    vary: Sequence[str] = (),
    fixed: Sequence[str] = (),
    probe: str | None = None,
    samples: int = 256,
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Sobol's indices of a probe to parameters that are spread evenly over their ranges.

    The first-order index is the part of the variance that a parameter explains alone, the total one
    that of all in which it has a share (Saltelli 2010, by scipy).

    - `source`: reduced model, or a deck whose scene is solved in full
    - `out`: folder of `sensitivity.json`, `.csv` and `.png`
    - `vary`: `KEY=LOW:HIGH` each; of a reduced model the keys that are not fixed, by default
    - `fixed`: `KEY=VALUE` each: other parameters, or overrides of the deck
    - `probe`: name of the probe, with `_x` behind that of a vector; the first force by default
    - `samples`: samples, a power of two; `samples * (parameters + 2)` states are asked for
    - returns what `sensitivity.json` holds
    - raises InputError: a key, the probe or the number of samples is wrong
    - raises ConvergenceError: a tenth of the states or more could not be found
    """
    from scipy.stats import sobol_indices

    if samples < 8 or samples & (samples - 1):
        raise InputError(f"--samples {samples}: a power of two from 8 on is needed")
    out = Path(out)
    with closing(open_forward(source, fixed, threads, progress, out)) as forward:
        ranges = ranges_of(forward, vary or forward.unknown([]), "--vary")
        if not ranges:
            raise InputError("name parameters: --vary KEY=LOW:HIGH")
        keys = list(ranges)
        name = probe_of(forward, probe)
        low, high = np.array(list(ranges.values())).T
        f, failed = _states(forward, keys, low, high, name, samples, seed, progress)
    found = sobol_indices(func=f, n=samples)
    with warnings.catch_warnings():
        # an index that is zero in all samples has no distribution
        warnings.simplefilter("ignore")
        bars = found.bootstrap(confidence_level=_CONFIDENCE, n_resamples=_RESAMPLES)
    values = np.concatenate([f["f_A"][0], f["f_B"][0]])
    summary: dict[str, Any] = {
        "probe": name,
        "unit": forward.units[name],
        "samples": samples,
        "seed": seed,
        "failed": failed,
        "mean": float(values.mean()),
        "standard_deviation": float(values.std(ddof=1)),
        "range": {key: list(ends) for key, ends in ranges.items()},
        "fixed": list(fixed),
        "cost": forward.cost(),
        "indices": {
            key: {
                kind: _index(getattr(found, kind), getattr(bars, kind).confidence_interval, k)
                for kind in ("first_order", "total_order")
            }
            for k, key in enumerate(keys)
        },
    }
    out.mkdir(parents=True, exist_ok=True)
    kinds, ends = ("first_order", "total_order"), ("value", "low", "high")
    write_csv(
        out / "sensitivity.csv",
        ["key", "low", "high", *(k + end for k in kinds for end in ("", "_low", "_high"))],
        (
            [key, *ranges[key], *(entry[kind][end] for kind in kinds for end in ends)]
            for key, entry in summary["indices"].items()
        ),
    )
    _draw(summary, out / "sensitivity.png")
    write_json(out / "sensitivity.json", summary)
    return summary


def _index(values: F64, interval: Any, k: int) -> dict[str, float]:
    """An index with the ends of its interval; both are the value where all samples agree."""
    value = float(values.ravel()[k])
    low, high = (float(np.ravel(end)[k]) for end in (interval.low, interval.high))
    same = not (np.isfinite(low) and np.isfinite(high))
    return {"value": value, "low": value if same else low, "high": value if same else high}


def _states(
    forward: Forward,
    keys: Sequence[str],
    low: F64,
    high: F64,
    name: str,
    samples: int,
    seed: int,
    progress: ProgressCallback,
) -> tuple[dict[str, F64], int]:
    """Values at two samples and at those with one column of the other, and how many failed."""
    from scipy.stats import qmc

    d = len(keys)
    most = samples + max(1, int(_MOST_FAILED * samples))
    points = qmc.Sobol(2 * d, seed=seed).random_base2(int(np.log2(samples)) + 1)[:most]
    rows: list[F64] = []
    failed = 0
    while len(rows) < samples:
        block = points[len(rows) + failed : samples + failed]
        if len(block) == 0:
            raise ConvergenceError(
                f"no state was found at {failed} of {len(rows) + failed} samples: narrow the ranges"
            )
        a, b = (low + (high - low) * part for part in (block[:, :d], block[:, d:]))
        mixed = [np.where(np.arange(d) == k, b, a) for k in range(d)]
        found: Values = forward.ask(keys, np.concatenate([a, b, *mixed]))
        value = found.probes[name].reshape(d + 2, len(block)).T
        whole = found.good.reshape(d + 2, len(block)).all(axis=0)
        rows += list(value[whole])
        failed += int((~whole).sum())
        progress(f"{len(rows)} of {samples} samples, {forward.states} states")
    values = np.array(rows).T
    return {"f_A": values[:1], "f_B": values[1:2], "f_AB": values[2:, None]}, failed


def _draw(summary: dict[str, Any], path: Path) -> None:
    """Bars of the indices, the largest total one at the top."""
    from matplotlib.figure import Figure

    entries = sorted(summary["indices"].items(), key=lambda e: e[1]["total_order"]["value"])
    figure = Figure(figsize=(7, 1.4 + 0.55 * len(entries)), layout="constrained")
    axes = figure.subplots()
    at = np.arange(len(entries))
    for shift, kind, colour, label in (
        (0.19, "total_order", "#0b5c96", "with all it has a share in"),
        (-0.19, "first_order", "#e69f00", "alone"),
    ):
        value = np.array([entry[kind]["value"] for _, entry in entries])
        low = np.array([entry[kind]["low"] for _, entry in entries])
        high = np.array([entry[kind]["high"] for _, entry in entries])
        bars = np.abs(np.stack([np.maximum(value - low, 0), np.maximum(high - value, 0)]))
        axes.barh(at + shift, value, 0.36, color=colour, label=label)
        axes.errorbar(value, at + shift, xerr=bars, fmt="none", ecolor="#1d2733", capsize=3)
    axes.set_yticks(at, [key for key, _ in entries])
    axes.set_xlabel(f"part of the variance of {summary['probe']}")
    axes.legend(loc="lower right", frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    write_figure(path, figure)
