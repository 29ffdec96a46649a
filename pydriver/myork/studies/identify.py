"""Parameters that fit measured forces and displacements, with confidence intervals."""

import csv
import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.console import ProgressCallback, silent
from myork.errors import ConvergenceError, FileError, InputError
from myork.files import write_csv, write_json
from myork.studies.forward import Forward, open_forward, ranges_of
from myork.types import F64

#: Starts among which the best are tried, where a reduced model answers
_STARTS, _BEST = 64, 3
#: Step of the differences, of a range: above the tolerance of the states, below curvature
_STEP = 1e-3
_CONFIDENCE = 0.95
#: Parameters whose estimates go together as far as this are not distinguished by the data
_TOGETHER = 0.98


class _Data(NamedTuple):
    """Measurements: conditions by keys, values and their standard errors by names of probes."""

    keys: list[str]
    conditions: F64
    names: list[str]
    values: F64
    errors: F64 | None


def identify(
    source: str | Path,
    data: str | Path,
    free: Sequence[str],
    out: str | Path,
    *,
    fixed: Sequence[str] = (),
    seed: int = 0,
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Values of parameters by least squares.

    - `source`: reduced model, or a deck whose scene is solved in full
    - `data`: CSV with a row a measurement: a column for each key that was set, and one for each
      probe that was measured, by its name (`_x` behind that of a vector); `NAME_error` are standard
      errors. Without them all measurements of a probe are equally good, and the scatter about the
      fit says how good. Empty fields were not measured.
    - `free`: keys that are wanted, `KEY=LOW:HIGH` each; `KEY` takes the range of the training
    - `out`: folder of `identify.json` and `.csv` (measured and fitted)
    - `fixed`: `KEY=VALUE` each: other parameters, or overrides of the deck
    - returns what `identify.json` holds: values with intervals, correlations, warnings
    - raises InputError: a key or the data are wrong
    - raises ConvergenceError: a state that the fit asks for could not be found
    """
    out = Path(out)
    with closing(open_forward(source, fixed, threads, progress, out)) as forward:
        ranges = ranges_of(forward, free)
        if not ranges:
            raise InputError("give the parameters to fit: --free KEY=LOW:HIGH")
        measured = _read(Path(data), forward, list(ranges))
        summary, fitted = _fit(forward, measured, ranges, seed, progress)
    out.mkdir(parents=True, exist_ok=True)
    rows = zip(measured.conditions.tolist(), measured.values, fitted, strict=True)
    write_csv(
        out / "identify.csv",
        [*measured.keys, *(c for name in measured.names for c in (name, f"{name}_fitted"))],
        ([*c, *("" if np.isnan(x) else float(x) for x in np.ravel(v, "F"))] for c, *v in rows),
    )
    write_json(out / "identify.json", summary)
    return summary


def _read(path: Path, forward: Forward, free: Sequence[str]) -> _Data:
    """Read the measurements; each column is a key, a probe or a standard error."""
    try:
        with path.open(newline="", encoding="utf-8") as file:
            head, *rows = [row for row in csv.reader(file) if any(field.strip() for field in row)]
    except OSError as reason:
        raise FileError(f"{path}: cannot be read: {reason.strerror or reason}") from None
    except ValueError:
        raise InputError(f"{path}: a header line and one row per measurement are needed") from None
    head = [name.strip() for name in head]
    table = np.full((len(rows), len(head)), np.nan)
    for i, row in enumerate(rows):
        try:
            if len(row) != len(head):
                raise ValueError(f"{len(row)} fields")
            table[i] = [float(field) if field.strip() else np.nan for field in row]
        except ValueError as reason:
            raise InputError(
                f"{path}: row {i + 1}: {reason}: the header has {len(head)} fields; fields are "
                "separated by commas, decimals have a point"
            ) from None
    names = [name for name in head if name in forward.units]
    others = [n for n in head if n not in names and n.removesuffix("_error") not in names]
    if not names:
        raise InputError(
            f"{path}: no column has the name of a probe; there are {', '.join(forward.units)}"
        )
    keys = [forward.key_of(name) for name in others]
    if set(keys) & set(free):
        raise InputError(
            f"{path}: {', '.join(set(keys) & set(free))}: is fitted (--free) and has a column; "
            "leave one of them out"
        )
    missing = [key for key in forward.unfixed if key not in {*keys, *free}]
    if missing:
        raise InputError(f"{path}: a column or --set is needed for {', '.join(missing)}")
    conditions = table[:, [head.index(name) for name in others]]
    values = table[:, [head.index(name) for name in names]]
    if not np.isfinite(conditions).all() or not np.isfinite(values).any():
        raise InputError(
            f"{path}: every row needs a number for each key, and a probe must have measured values"
        )
    errors = None
    if any(f"{name}_error" in head for name in names):
        if not all(f"{name}_error" in head for name in names):
            raise InputError(f"{path}: give standard errors for all probes or for none")
        errors = table[:, [head.index(f"{name}_error") for name in names]]
        if not (errors[np.isfinite(values)] > 0.0).all():
            raise InputError(f"{path}: standard errors must be above 0")
    return _Data(keys, conditions, names, values, errors)


def _fit(
    forward: Forward,
    data: _Data,
    ranges: dict[str, tuple[float, float]],
    seed: int,
    progress: ProgressCallback,
) -> tuple[dict[str, Any], F64]:
    from scipy.optimize import least_squares
    from scipy.stats import qmc
    from scipy.stats import t as student

    keys = list(ranges)
    low, high = np.array(list(ranges.values())).T
    known = np.isfinite(data.values)
    # without errors: one for each probe, in proportion to the size of its values
    size = np.sqrt(np.nanmean(data.values**2, axis=0))
    scale = data.errors if data.errors is not None else np.where(size > 0, size, 1.0)
    scale = np.broadcast_to(scale, data.values.shape)
    cost: dict[str, Any] = {"states": 0, "cpu_s": 0.0, "by": forward.by}

    def model(shares: F64) -> F64:
        """Values of all measurements at shares of the ranges, from one on, shape `(n, m, k)`."""
        place = low + (high - low) * (np.atleast_2d(shares) - 1.0)
        rows = [np.hstack([data.conditions, np.tile(p, (len(data.values), 1))]) for p in place]
        cost["states"] += len(place) * len(data.values)
        start = time.process_time()
        found = forward.ask([*data.keys, *keys], np.concatenate(rows))
        cost["cpu_s"] += time.process_time() - start
        value = np.stack([found[name] for name in data.names], axis=1)
        return value.reshape(len(place), *data.values.shape)

    def residual(shares: F64) -> F64:
        value = model(shares)[0]
        left: F64 = ((value - data.values) / scale)[known]
        if not np.isfinite(left).all():
            place = low + (high - low) * (shares - 1.0)
            named = ", ".join(f"{k} = {v:.4g}" for k, v in zip(keys, place, strict=True))
            raise ConvergenceError(f"no state at {named}: narrow the ranges of --free")
        if not forward.ranges:
            spent = f"{cost['states']} states, {cost['cpu_s']:.1f} CPU s"
            progress(f"{spent}: misfit {left @ left:.4g}")
        return left

    starts = np.full((1, len(keys)), 1.5)
    if forward.ranges:
        tried = 1.0 + qmc.Sobol(len(keys), seed=seed).random(_STARTS)
        off = ((model(tried) - data.values) / scale)[:, known]
        misfit = np.where(np.isfinite(off).all(axis=1), (off**2).sum(axis=1), np.inf)
        starts = tried[np.argsort(misfit)[:_BEST]]
    fits = []
    for start in starts:
        fit = least_squares(
            residual, start, bounds=(1.0, 2.0), diff_step=_STEP, xtol=1e-8, ftol=1e-10
        )
        fits.append(fit)
        progress(f"fit {len(fits)}/{len(starts)}: misfit {2 * fit.cost:.4g}")
    fits.sort(key=lambda fit: fit.cost)
    best = fits[0]
    freedom = int(known.sum()) - len(keys)
    # (J^T J)^-1, infinite where data do not determine it
    _, s, right = np.linalg.svd(best.jac, full_matrices=False)
    determined = bool((s > 1e-10 * s[0]).all())
    inverse = (right.T / s**2) @ right if determined else np.full((len(keys),) * 2, np.inf)
    factor, spread = 1.96, 1.0
    if data.errors is None:
        factor = student.ppf(0.5 + 0.5 * _CONFIDENCE, max(freedom, 1))
        spread = np.sqrt(2.0 * best.cost / freedom) if freedom > 0 else np.nan
    sizes = np.sqrt(np.diag(inverse))
    error = spread * sizes * (high - low)
    value = low + (high - low) * (best.x - 1.0)
    with np.errstate(invalid="ignore"):
        together = inverse / np.outer(sizes, sizes)
    fitted = model(best.x)[0]
    warnings = _warnings(keys, best, fits, together, freedom, determined)
    if data.errors is not None and freedom > 0 and 2.0 * best.cost > 4.0 * freedom:
        warnings.append(
            f"the misfit is {np.sqrt(2.0 * best.cost / freedom):.2g} times the standard errors: "
            "the model or the errors are wrong, and the intervals too narrow"
        )
    summary = {
        "parameters": {
            key: {
                "value": float(value[k]),
                "standard_error": float(error[k]),
                "interval": [
                    float(value[k] - factor * error[k]),
                    float(value[k] + factor * error[k]),
                ],
                "range": list(ranges[key]),
            }
            for k, key in enumerate(keys)
        },
        "confidence": _CONFIDENCE,
        "correlation": np.where(np.isfinite(together), together, np.nan).tolist(),
        "measurements": int(known.sum()),
        "misfit": float(2.0 * best.cost),
        "largest_residual": float(np.abs(best.fun).max()),
        "residual_unit": "standard errors" if data.errors is not None else "rms of the probe",
        "warnings": warnings,
        "cost": cost,
    }
    return summary, fitted


def _warnings(
    keys: Sequence[str],
    best: Any,
    fits: Sequence[Any],
    together: F64,
    freedom: int,
    determined: bool,
) -> list[str]:
    """What the data do not say."""
    found = []
    if freedom <= 0:
        found.append(
            "there are no more measurements than parameters: no confidence interval can be given"
        )
    if not determined:
        found.append(
            "the data do not determine all parameters: some have no effect on the measurements"
        )
    for k, key in enumerate(keys):
        if best.active_mask[k]:
            found.append(f"{key} is at the end of its range: widen it")
        for j in range(k):
            if abs(together[k, j]) > _TOGETHER:
                found.append(
                    f"these data do not distinguish {keys[j]} from {key} "
                    f"(correlation {together[k, j]:.3f})"
                )
    near = [f for f in fits if f.cost < 1.5 * best.cost and np.abs(f.x - best.x).max() > 0.02]
    if near:
        found.append("another set of values fits almost as well: the data do not determine them")
    return found
