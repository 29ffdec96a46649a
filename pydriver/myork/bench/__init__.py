"""Benchmarks: tables and curves of the reference problems, solved anew in every run.

The package has the problems of the dissertation and full against reduced models, tables of its
module `studies`; all other comparisons stand in the folder `benchmarks` of a checkout. Each is a
function ``run(out, progress, quick) -> dict`` (folder for files, callable for lines of progress,
whether small cases are enough). Its result is written to `bench.json` as it is and drawn on
`bench.html` from these keys, all optional:

- ``title``, ``about``: text;
- ``ended``: why there is nothing else, of a benchmark that failed;
- ``cases``: one mapping a solve: ``problem``, ``method``, ``unknowns``, ``cpu_s``, ``error`` (by
  quantity) and more;
- ``tables``: mappings with ``caption``, ``head`` (texts) and ``rows`` (texts and numbers);
- ``plots``: mappings with ``title``, ``x``, ``y`` (axis labels with units) and ``series``: mappings
  with ``name``, ``x``, ``y`` and optionally ``rival`` (drawn grey), on logarithmic axes.
"""

import sys
from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback, silent
from myork.errors import InputError
from myork.files import alone_in, write_json

__all__ = ["BENCHES", "find_study", "run_benches"]

#: Benchmarks of the package: tables of its module `studies`
_PACKAGED = ("linear", "nonlinear", "rom")
#: Benchmarks of a checkout: views of its folder `benchmarks`
_CHECKOUT = ("trust", "methods", "curves", "newcomer", "certify", "race")
BENCHES = (*_PACKAGED, *_CHECKOUT)

#: What a benchmark is
Study = Callable[[Path, ProgressCallback, bool], dict[str, Any]]


def find_study(name: str) -> Study:
    """Function of a benchmark.

    - raises InputError: its name is unknown, or it belongs to a checkout and the working directory
      is none
    """
    if name not in BENCHES:
        raise InputError(
            f"there is no benchmark {name!r}; there are {', '.join([*BENCHES, 'all'])}"
        )
    if name in _PACKAGED:
        return partial(import_module("myork.bench.studies").run, name)
    folder = _checkout()
    if folder and str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    try:
        return partial(import_module("benchmarks.pivots").run, name)
    except ModuleNotFoundError as error:
        if not (error.name or "").startswith("benchmarks"):
            raise
        raise InputError(
            f"{name} ({error}) belongs to a checkout of MyoRK: call it in the folder that contains "
            "benchmarks/"
        ) from None


def _checkout() -> Path | None:
    """The working directory where it is a checkout."""
    folder = Path.cwd()
    return folder if (folder / "benchmarks" / "runner.py").is_file() else None


def run_benches(
    names: list[str], out: Path, *, quick: bool = False, progress: ProgressCallback = silent
) -> dict[str, Any]:
    """Run benchmarks and write `bench.json` and `bench.html`.

    - `names`: from `BENCHES`, or `all`: those of the package and, in a checkout, of it
    - `out`: folder of the results; made if it is missing
    - `quick`: small cases only
    - returns content of `bench.json`; a benchmark that failed has an entry `ended`
    - raises InputError: a name is unknown
    """
    from myork.bench.machine import machine
    from myork.bench.page import write_page

    if "all" in names:
        names = list(BENCHES if _checkout() else _PACKAGED)
    names = list(dict.fromkeys(names))
    studies = {name: find_study(name) for name in names}
    record: dict[str, Any] = {**machine(), "quick": quick, "benches": {}}
    with alone_in(out):
        for number, (name, study) in enumerate(studies.items(), start=1):
            progress(f"bench {number}/{len(names)}  {name}")
            try:
                record["benches"][name] = study(out, progress, quick)
            except Exception as reason:
                ended = f"{type(reason).__name__}: {reason}"
                record["benches"][name] = {"title": name, "ended": ended}
                progress(f"{name}: {ended}")
            # after each one: a later one that is stopped costs nothing that was measured
            write_json(out / "bench.json", record)
            write_page(out / "bench.html", record)
    return record
