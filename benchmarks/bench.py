"""Benchmarks that `myork bench` runs, and the record that it writes.

A benchmark is a function ``run(name, progress, quick) -> dict`` (callable for lines of progress,
whether small cases are enough). Its result is written unchanged to `bench.json` and drawn on
`bench.html` from these keys, all optional:

- ``title``, ``about``: text;
- ``ended``: for a failed benchmark, the reason why there is nothing else;
- ``cases``: one mapping per solve: ``problem``, ``method``, ``unknowns``, ``cpu_s``, ``error`` (by
  quantity) and more;
- ``tables``: mappings with ``caption``, ``head`` (texts) and ``rows`` (texts and numbers);
- ``plots``: mappings with ``title``, ``x``, ``y`` (axis labels with units) and ``series``: mappings
  with ``name``, ``x``, ``y`` and optionally ``rival`` (drawn grey), on logarithmic axes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks import pivots, studies
from benchmarks.page import write_page
from myork.bench.machine import machine
from myork.console import ProgressCallback
from myork.files import alone_in, write_json


def run_benches(
    names: Sequence[str], out: Path, quick: bool, progress: ProgressCallback
) -> dict[str, Any]:
    """Run benchmarks and write `bench.json` and `bench.html`; see `myork.bench`."""
    names = list(dict.fromkeys(names))
    record: dict[str, Any] = {**machine(), "quick": quick, "benches": {}}
    with alone_in(out):
        for number, name in enumerate(names, start=1):
            progress(f"bench {number}/{len(names)}  {name}")
            study = studies.run if name in studies.STUDIES else pivots.view
            try:
                record["benches"][name] = study(name, progress, quick)
            except Exception as reason:
                ended = f"{type(reason).__name__}: {reason}"
                record["benches"][name] = {"title": name, "ended": ended}
                progress(f"{name}: {ended}")
            # written after each one, so that a later one that is stopped loses no measurement
            write_json(out / "bench.json", record)
            write_page(out / "bench.html", record)
    return record
