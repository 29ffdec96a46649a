"""What `myork explain` forecasts for the decks of `inputs`, and what their solves took."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from myork import run_deck
from myork.errors import ConvergenceError
from myork.stations.explain import explain_deck

INPUTS = Path(__file__).parents[2] / "inputs"
#: Decks whose CPU times gave the prices of `rk_forecast.f90`, with words of an override, and others
HALVES: dict[str, list[tuple[str, ...]]] = {
    "fitted": [
        ("poisson_1d",), ("poisson_3d",), ("cantilever",), ("cantilever_load",),
        ("uniaxial_tension",), ("dilation",), ("tube",), ("cube_plates",), ("muscle_block",),
        ("twist",), ("cube_plates", "geometry.source=[17,17,17]"),
    ],
    "other": [
        ("bar_1d",), ("wave_1d",), ("poisson_own",), ("equibiaxial",), ("shear_2d",), ("shear_3d",),
        ("uniaxial_compression",), ("pressure_follower",), ("tendon",),
        ("shortening",), ("stretch_then_activate",), ("cube_plates", "geometry.source=[13,13,13]"),
        ("cube_plates", "scene.method=rkpm-scni"), ("cantilever_load", "geometry.source=[129,33]"),
        ("muscle_fibers",),
    ],
}  # fmt: skip


def forecasts() -> Iterator[list[Any]]:
    """CPU seconds with error bars: forecast, taken, and their ratio."""
    yield ["decks", "deck", "forecast s", "taken s", "ratio"]
    for half, decks in HALVES.items():
        for name, *words in decks:
            with TemporaryDirectory() as folder:
                said: list[str] = []
                explain_deck(INPUTS / f"{name}.toml", overrides=words, progress=said.append)
                found = re.search(r"about (\S+) CPU s", "\n".join(said))
                with suppress(ConvergenceError):
                    run_deck(INPUTS / f"{name}.toml", folder, overrides=words, threads=1)
                taken = json.loads(Path(folder, "summary.json").read_text())["cpu_s"]
            forecast = float(found[1]) if found else float("nan")
            yield [
                half, " ".join([f"`{name}`", *words]),
                f"{forecast:.2g}", f"{taken:.2g}", f"{forecast / taken:.2f}",
            ]  # fmt: skip
