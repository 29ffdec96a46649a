"""One point of a sweep, solved in a process of its own."""

from __future__ import annotations

import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from myork.errors import ConvergenceError, MyorkError
from myork.rom.probes import probe_columns

__all__ = ["solve_point"]


def solve_point(deck: str, overrides: Sequence[str], out: str | None) -> dict[str, Any]:
    """Solve a deck with overrides; what goes wrong is a message, not raised.

    Returns
    -------
    dict
        `probes`: values of the last step by name, vectors by components; `errors`: their error
        bars; `verdict`, `message`, `cpu_s`.
    """
    start = time.process_time()
    row: dict[str, Any] = {"probes": {}, "errors": {}, "verdict": "failed", "message": ""}
    try:
        from myork.core.scene import Scene

        with Scene(deck, overrides, Path(out) if out else None, threads=1) as scene:
            try:
                states = scene.solve()
                row["verdict"] = states.verdict
                row["message"] = "; ".join(states.reasons)
                values = scene.probes(states.x[-1:], states.load[-1:])[0]
                for i, probe in enumerate(scene.deck.get("probe", [])):
                    bars = states.probe_errors[-1, i]
                    for k, name in enumerate(probe_columns(probe, scene.dimension)):
                        row["probes"][name] = float(values[i, k])
                        row["errors"][name] = float(bars[k])
            except ConvergenceError as ended:
                row["message"] = str(ended)
    except (MyorkError, OSError) as wrong:
        row["message"] = str(wrong)
    row["cpu_s"] = time.process_time() - start
    return row
