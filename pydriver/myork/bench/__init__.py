"""Tables and figures of the dissertation, and access to the benchmarks of a checkout.

`reproduce` computes the tables again wherever myork is installed. All other comparisons, with exact
solutions and with finite elements, are in the folder `benchmarks` of a checkout.
"""

import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback, silent
from myork.errors import InputError

__all__ = ["BENCHES", "run_benches"]

#: Benchmarks of a checkout
BENCHES = ("linear", "nonlinear", "rom", "trust", "methods", "certify", "race")


def run_benches(
    names: list[str], out: Path, *, quick: bool = False, progress: ProgressCallback = silent
) -> dict[str, Any]:
    """Run benchmarks of the checkout in the working directory or around the environment.

    - `names`: from `BENCHES`, or `all`
    - `out`: folder of `bench.json` and `bench.html`; made if it is missing
    - `quick`: small cases only
    - returns content of `bench.json`; a benchmark that failed has an entry `ended`
    - raises InputError: a name is unknown, or there is no checkout
    """
    for name in names:
        if name not in (*BENCHES, "all"):
            raise InputError(
                f"unknown benchmark {name!r}; choose one of {', '.join([*BENCHES, 'all'])}"
            )
    places = (Path.cwd(), Path(sys.prefix).parent)
    folder = next((one for one in places if (one / "benchmarks" / "runner.py").is_file()), None)
    if folder is None:
        raise InputError(
            f"{', '.join(names)}: benchmarks belong to a checkout of MyoRK: call them in the "
            "folder that contains benchmarks/; `myork reproduce` computes the tables of the "
            "dissertation anywhere"
        )
    if str(folder) not in sys.path:
        sys.path.insert(0, str(folder))
    run = import_module("benchmarks.bench").run_benches
    found: dict[str, Any] = run(BENCHES if "all" in names else names, out, quick, progress)
    return found
