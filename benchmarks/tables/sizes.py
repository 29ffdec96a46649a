"""Cost against size: an eighth of a cube between plates, pressed by 10 %."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from benchmarks.problems import BY_NAME
from benchmarks.runner import sized_tables
from benchmarks.truths.peers import solve_dolfinx
from myork.bench.runs import read_deck
from myork.core.deck import text_of_tables
from myork.stations.solve import run_deck

#: Points along an edge if the tangent is factorised, and if it is never formed
FACTORISED, NOT_FORMED = (7, 11, 15, 19, 25), (7, 11, 15, 19, 25, 31, 37, 43)
#: Elements along an edge, and forms of dolfinx that use them
ELEMENTS, FORMS = (3, 5, 8, 11, 15, 19), ("Q2", "Q2/P1")
#: Limit of the wall time of a peer's solve [s]
_LIMIT = 900.0


def sizes() -> Iterator[tuple[str, ...]]:
    """CPU time and memory of one thread without error bars, and the force on the plate."""
    yield "program", "along an edge", "unknowns", "CPU [s]", "memory [GB]", "force [N]"
    tables: dict[str, Any] = dict(BY_NAME["cube between plates"].tables)
    tables["boundary"] = [
        {**condition, "u_z": -0.1} if condition.get("u_z") == -0.3 else condition
        for condition in tables["boundary"]
    ]
    for name, limit, points in (
        ("MyoRK, factorised", 10**7, FACTORISED),
        ("MyoRK, not formed", 0, NOT_FORMED),
    ):
        for n in points:
            words = [f"galerkin.direct_limit={limit}"]
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "deck.toml"
                path.write_text(text_of_tables(sized_tables(tables, (n, n, n))), encoding="utf-8")
                found = run_deck(path, folder, overrides=words, threads=1, error=False)
            force = found["steps"][-1]["probes"]["force"]
            yield _row(name, f"{n} points", found, found["memory_peak_bytes"], force)
    deck = read_deck(sized_tables(tables, (5, 5, 5)))
    for form in FORMS:
        for n in ELEMENTS:
            for row in solve_dolfinx(deck, [(n, n, n)], form, _LIMIT):
                name, size = f"dolfinx {form}", f"{n} elements"
                if row.get("probes"):
                    yield _row(name, size, row, row["memory"], row["probes"]["force"])
                else:
                    yield name, size, "", str(row["outcome"]), "", ""


def _row(
    program: str, size: str, found: Mapping[str, Any], memory: float, force: float
) -> tuple[str, ...]:
    """Row of a solve; memory in bytes."""
    counts = f"{found['dofs']:,}", f"{found['cpu_s']:.3g}", f"{memory / 1e9:.3g}"
    return program, size, *counts, f"{force:.3f}"
