"""The whole way on one command: phantom images to a muscle force, its reduced model, a report."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback, silent
from myork.errors import RefusedError
from myork.files import INPUTS
from myork.summary import printed

__all__ = ["run_demo"]

_DECK = INPUTS / "mg_muscle.toml"


def run_demo(
    out: str | Path = "out/demo",
    *,
    overrides: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> str:
    """Run all commands on the deck `mg_muscle` and put their results into one folder.

    Parameters
    ----------
    out : str or Path
        Folder of the results; made if it is missing.
    overrides : sequence of str
        Overrides of the deck, `"table.key=value"`.
    threads : int, optional
        Number of threads; default all cores.
    progress : callable
        Called with every line of progress.

    Returns
    -------
    str
        Closing summary: forces with their error bars, volume ratios and balance of forces, verdict,
        errors and speed-up of the reduced models, path of the report.
    """
    from myork.core.deck import load_deck
    from myork.report import make_report
    from myork.rom import run_rom
    from myork.stations.build import build
    from myork.stations.segment import segment
    from myork.stations.solve import run_deck
    from myork.summary import read_summary

    out = Path(out)
    out.mkdir(parents=True, exist_ok=True)
    stations = {
        "phantom images to labels and fibers": segment,
        "labels to points": build,
        "full solution": run_deck,
        "reduced models": run_rom,
    }
    for number, (what, station) in enumerate(stations.items(), start=1):
        progress(f"station {number}/5  {what}")
        try:
            station(_DECK, out, overrides=overrides, threads=threads, progress=progress)
        except RefusedError as reason:
            # the answer is there, and the report shows why it is refused
            progress(str(reason))
    progress("station 5/5  report")
    page = make_report(out)
    summary = read_summary(out)
    deck = load_deck(_DECK, overrides)
    verdict = summary["verdict"]
    judged = "; ".join([f"verdict: {verdict['state']}", *verdict["reasons"]])
    parts = [*_forces(deck, summary), _checks(summary), judged, *_models(summary)]
    return "\n".join([*parts, f"report: {page}"])


def _forces(deck: dict[str, Any], summary: dict[str, Any]) -> list[str]:
    """One line for each force probed at full load, with its error bar where there is one."""
    last = summary["steps"][-1]
    names = [probe["name"] for probe in deck["probe"] if probe["quantity"].startswith("force")]
    return [
        f"{name} at load {last['load']:g}: {_numbers(printed(last)[name])}"
        f"{_bar(last['probe_errors'].get(name))} {summary['probe_units'][name]}"
        for name in names
    ]


def _bar(error: float | list[float] | None) -> str:
    """Error bar behind a value."""
    return "" if error is None else f" +- {_numbers(error, 2)}"


def _checks(summary: dict[str, Any]) -> str:
    """Volume ratios and balance of forces of a state."""
    last = summary["steps"][-1]
    return (
        f"J {last['min_J']:.3g} to {last['max_J']:.3g}, force imbalance "
        f"{summary['force_imbalance']:.1e} of the largest"
    )


def _models(summary: dict[str, Any]) -> list[str]:
    """One line for each reduced model."""
    from myork.rom.study import times_faster

    return [
        f"reduced model ({model['kind']}, r = {model['r']}): error e1 {model['e1']:.1e}, "
        f"e2 {model['e2']:.1e}, {times_faster(model['speedup_vs_full'])} times faster than the "
        f"full solution"
        for model in summary["rom"]["models"]
    ]


def _numbers(value: float | list[float], digits: int = 4) -> str:
    values = value if isinstance(value, list) else [value]
    return ", ".join(f"{number:.{digits}g}" for number in values)
