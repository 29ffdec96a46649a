"""The mixed form on the block with inclined fibers: which choices matter, and how far it is right.

Every case is `muscle_fibers.toml` to an activation of 0.15 with some keys overridden, compared with
the finite element values of the deck. docs/mixed.md tells what follows from the table.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from myork.bench.runs import INPUTS, outcome_text, solve_case
from myork.console import ProgressCallback

__all__ = ["run"]

_LOAD = ("load.steps=6", "load.activation=0.15")


def _size(n: int) -> tuple[str, ...]:
    """Sources n x n x (2n-1) and collocation points at half their spacing."""
    fine = 2 * n - 1
    return (
        f"geometry.source=[{n},{n},{fine}]",
        f"geometry.collocation=[{fine},{fine},{4 * n - 3}]",
    )


_ORDER_2 = ("approximation.order=2", "approximation.support=3")
_ORDER_3 = ("approximation.order=3", "approximation.support=4")

_CASES: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("displacement form, order 2", ("scene.method=rkcm", *_ORDER_2)),
    ("displacement form, order 4", ("scene.method=rkcm",)),
    ("mixed, order 2, no edge weights", ("mixed.edge_exponent=0", *_ORDER_2)),
    ("mixed, order 2", _ORDER_2),
    ("mixed, order 3", _ORDER_3),
    ("mixed, order 4 (default of the deck)", ()),
    ("mixed, order 4, no edge weights", ("mixed.edge_exponent=0",)),
    ("mixed, order 4, edge exponent 1.5", ("mixed.edge_exponent=1.5",)),
    ("mixed, order 4, volume weight 50", ("mixed.volume_weight=50",)),
    ("mixed, order 4, 4x4x7", _size(4)),
    ("mixed, order 4, 6x6x11", _size(6)),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Solve all cases.

    Parameters
    ----------
    out : Path
        Not used; every solve has a folder of its own.
    progress : callable
        Called with every line of progress.
    quick : bool
        Only the small cases at low activation.
    """
    cases = []
    chosen = _CASES[:4] if quick else _CASES
    load = ("load.steps=2", "load.activation=0.05") if quick else _LOAD
    for number, (name, overrides) in enumerate(chosen):
        progress(f"case {number + 1}/{len(chosen)}  {name}")
        record = solve_case(INPUTS / "muscle_fibers.toml", (*load, *overrides), limit=1800.0)
        cases.append({"name": name, **record})
    return {
        "title": "Mixed form on the block with inclined fibers",
        "about": __doc__.split("\n\n")[1].replace("\n", " "),
        "cases": cases,
        "tables": [_table(cases, activation) for activation in (0.05, 0.15)],
    }


def _table(cases: list[dict[str, Any]], activation: float) -> dict[str, Any]:
    """Errors of all probes at one activation."""
    probes = list(next((case["reference"] for case in cases if case.get("reference")), {}))
    rows = []
    for case in cases:
        errors = [_error(case, probe, activation) for probe in probes]
        rows.append(
            [
                case["name"],
                case.get("dofs"),
                *errors,
                case.get("timings_s", {}).get("total"),
                outcome_text(case),
            ]
        )
    return {
        "caption": f"Relative difference from the finite element values at activation {activation}",
        "head": ["case", "unknowns", *probes, "time [s]", "outcome"],
        "rows": rows,
    }


def _error(case: dict[str, Any], probe: str, activation: float) -> float | None:
    """Signed relative difference of a probe; None where the run did not get there."""
    reference = (case.get("reference") or {}).get(probe)
    if not reference:
        return None
    for at, value, wanted in zip(
        reference["activation"], reference["value"], reference["reference"], strict=True
    ):
        if abs(at - activation) < 1e-9:
            return float((value - wanted) / abs(wanted))
    return None
