"""Benchmarks that `myork bench` runs, and the record that it writes.

A benchmark is a function ``run(name, progress, quick) -> dict`` (callable for lines of progress,
whether small cases are enough). Its result is written unchanged to `bench.json` and drawn on
`bench.html` from these keys:

- ``title``, ``about``: text;
- ``ended``: for a failed benchmark, the reason why there is nothing else;
- ``cases``: one mapping per solve: ``problem``, ``method``, ``unknowns``, ``cpu_s``, ``error`` (by
  quantity) and more;
- ``tables``: mappings with ``caption``, ``head`` (texts) and ``rows`` (texts and numbers);
- ``plots``: mappings with ``title``, ``x``, ``y`` (axis labels with units) and ``series``: mappings
  with ``name``, ``x``, ``y`` and optionally ``rival`` (drawn grey), on logarithmic axes.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from markupsafe import Markup
from matplotlib.figure import Figure

from benchmarks import pivots, studies
from benchmarks.page import body_of
from myork.bench.machine import machine
from myork.console import ProgressCallback
from myork.files import alone_in, write_json, write_text
from myork.report.frame import page_of_markdown


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
            write_text(out / "bench.html", _page(record))
    return record


def _page(record: Mapping[str, Any]) -> str:
    """The page `bench.html` of a record."""
    benches = record["benches"]
    without = [name for name, bench in benches.items() if "ended" in bench]
    again = " ".join(["myork bench", *benches, *(["--quick"] if record["quick"] else [])])
    text = (
        f"# Benchmarks\n\nMyoRK {record['version']}, {record['date'][:19]}, "
        f"{record['processor']}, {record['cores']} cores, one thread a solve, "
        f"{'small cases only' if record['quick'] else 'all cases'}; load of the machine at the "
        f"start {record['load_average']:.1f}. {len(benches) - len(without)} benchmarks have "
        f"results{'; without: ' if without else ''}{', '.join(without)}.\n\n"
    )
    pictures: dict[str, Figure] = {}
    for name, bench in benches.items():
        body, own = body_of(name, bench)
        about = f"No result: {bench['ended']}" if "ended" in bench else bench["about"]
        text += f"## {bench['title']}\n\n{about}\n{body}\n"
        pictures |= own
    footer = Markup("Made by <code>{}</code>; all numbers: <code>bench.json</code>").format(again)
    return page_of_markdown(text, pictures, footer)
