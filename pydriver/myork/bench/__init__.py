"""Benchmarks: tables and curves of the reference problems, solved anew in every run.

The package has the problems of the dissertation, speed against error, and full against reduced
models, a module each; all other comparisons stand in the folder `benchmarks` of a checkout. Each is
a function ``run(out, progress, quick) -> dict`` (folder for files, callable for lines of progress,
whether small cases are enough). Its result is written to `bench.json` as it is and drawn on
`bench.html` from these keys, all optional:

- ``title``, ``about``: text;
- ``ended``: why there is nothing else, of a benchmark that failed or took too long;
- ``pictures``: mappings with ``file`` (beside the page) and ``caption``;
- ``cases``: one mapping a solve, with the names of `summary.json`;
- ``tables``: mappings with ``caption``, ``head`` (texts) and ``rows`` (texts and numbers);
- ``plots``: mappings with ``title``, ``x``, ``y`` (axis labels with units), ``scale`` (``log-log``
  by default, ``log-y`` or ``linear``) and ``series``: mappings with ``name``, ``x``, ``y`` and
  optionally ``rival`` (drawn grey), ``notes`` (a text a point);
- ``maps``: mappings with ``title``, ``x``, ``y``, ``value`` (a number a point) and ``label``.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any

from myork.console import ProgressCallback, silent
from myork.errors import InputError
from myork.files import claimed, read_json, write_json

__all__ = ["BENCHES", "find_study", "of_checkout", "run_benches"]

#: Benchmarks of the package: its modules
_PACKAGED = ("linear", "nonlinear", "curves", "rom")
#: Benchmarks of a checkout: module of its folder `benchmarks`, and function
_CHECKOUT = {
    "trust": "views.trust",
    "newcomer": "views.newcomer",
    "certify": "views.certify",
    "essential": "views.essential",
    "race": "views.race",
    "methods": "methods.run",
    "mms": "mms.run",
    "gallery": "gallery.run",
    "aging": "aging.run",
    "isometric": "isometric.run",
    "stability": "stability.run",
}
BENCHES = (*_PACKAGED, *_CHECKOUT)

#: What a benchmark is
Study = Callable[[Path, ProgressCallback, bool], dict[str, Any]]


def find_study(name: str) -> Study:
    """Function of a benchmark.

    Raises
    ------
    InputError
        Its name is unknown, or it belongs to a checkout and the working directory is none.
    """
    if name not in BENCHES:
        raise InputError(
            f"there is no benchmark {name!r}; there are {', '.join([*BENCHES, 'all'])}"
        )
    if name in _PACKAGED:
        study: Study = import_module(f"myork.bench.{name}").run
        return study
    module, function = _CHECKOUT[name].split(".")
    found: Study = getattr(of_checkout(module), function)
    return found


def of_checkout(module: str) -> ModuleType:
    """Module of the folder `benchmarks` of a checkout.

    Raises
    ------
    InputError
        The working directory is not a checkout.
    """
    folder = _checkout()
    if folder and str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    try:
        return import_module(f"benchmarks.{module}")
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("benchmarks"):
            raise
        raise InputError(
            f"benchmarks.{module} ({error}) belongs to a checkout of MyoRK: call it in the folder "
            "that contains benchmarks/"
        ) from None


def _checkout() -> Path | None:
    """The working directory where it is a checkout."""
    folder = Path.cwd()
    return folder if (folder / "benchmarks" / "runner.py").is_file() else None


def run_benches(
    names: list[str],
    out: Path,
    *,
    quick: bool = False,
    limit: float | None = None,
    resume: bool = False,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Run benchmarks and write `bench.json` and `bench.html`.

    Parameters
    ----------
    names : list of str
        From `BENCHES`, or `all`: those of the package and, in a checkout, of it.
    out : Path
        Folder of the results; made if it is missing.
    quick : bool
        Small cases only.
    limit : float, optional
        Time after which a benchmark is ended and the next one begins [s]; one that fails ends
        nothing then either. Default of `all` an hour each, ten minutes where `quick`; else none.
    resume : bool
        Benchmarks that `bench.json` in the folder has a result of keep it and are not run.
    progress : callable
        Called with every line of progress.

    Returns
    -------
    dict
        Content of `bench.json`.

    Raises
    ------
    InputError
        A name is unknown, or what is to be kept is of another version, machine or size.
    """
    if "all" in names:
        names = list(BENCHES if _checkout() else _PACKAGED)
        limit = limit or (600.0 if quick else 3600.0)
    for name in names:
        find_study(name)
    with claimed(out):
        record = _begun(out, quick, resume)
        return _run_all(names, out, record, limit, progress)


def _begun(out: Path, quick: bool, resume: bool) -> dict[str, Any]:
    """Record without benchmarks, or with those that ended with a result in the folder before."""
    from myork.bench.machine import machine

    record: dict[str, Any] = {**machine(), "quick": quick, "benches": {}}
    place = out / "bench.json"
    if not (resume and place.exists()):
        return record
    before = read_json(place)
    for key in ("version", "processor", "cores", "quick"):
        if before.get(key) != record[key]:
            raise InputError(
                f"{place}: {key} was {before.get(key)} and is {record[key]}: results of both do "
                "not belong into one table; run without --resume, or in another folder"
            )
    kept = {name: found for name, found in before["benches"].items() if "ended" not in found}
    return {**before, "resumed": [*before.get("resumed", []), record["date"]], "benches": kept}


def _run_all(
    names: list[str],
    out: Path,
    record: dict[str, Any],
    limit: float | None,
    progress: ProgressCallback,
) -> dict[str, Any]:
    """Run benchmarks in a folder of their own."""
    from myork.bench.limited import run_limited
    from myork.bench.page import write_page

    quick = record["quick"]
    names = list(dict.fromkeys(names))
    for number, name in enumerate(names):
        known = name in record["benches"]
        progress(f"bench {number + 1}/{len(names)}  {name}{', kept' if known else ''}")
        if known:
            continue
        if limit is None:
            record["benches"][name] = find_study(name)(out, progress, quick)
        else:
            record["benches"][name] = run_limited(name, out, progress, quick, limit)
            if ended := record["benches"][name].get("ended"):
                progress(f"{name}: {ended}")
        # after each one: a later one that fails or is stopped costs nothing that was measured
        write_json(out / "bench.json", record)
        write_page(out / "bench.html", record)
    return record
