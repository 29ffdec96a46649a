"""Legs of three materials, large enough that the tangent is never formed."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator
from pathlib import Path

from myork.files import INPUTS
from myork.stations.build import build
from myork.stations.segment import segment
from myork.stations.solve import run_deck


def options(across: int, steps: int) -> list[str]:
    """Keys of a leg of 115 x 115 x 150 mm with so many voxels across."""
    slices = round(across * 25 / 72)
    keys = {
        "phantom.size": f"[{across},{across},{slices}]",
        "phantom.spacing": f"[{115.2 / across:.4g},{115.2 / across:.4g},{150 / slices:.4g}]",
        "build.source_stride": "[1,1,1]",
        "build.collocation_stride": "[1,1,1]",
        "approximation.support": "1.82",
        "galerkin.penalty": "10",
        "galerkin.direct_limit": "0",
        "load.steps": f"{steps}",
        "load.activation": f"{0.095 * steps}",
    }
    return [f"{key}={value}" for key, value in keys.items()]


def large_leg(steps: str = "1", threads: str = "2", *sizes: str) -> Iterator[tuple[str, ...]]:
    """Legs solved matrix-free: iterations and cost.

    A size is the number of voxels across the phantom of `inputs/leg_section.toml`, by default 54,
    since 36 do not resolve the bones; every voxel is a point. The load steps are the first of ten
    to activation 0.95.
    """
    yield "points", "unknowns", "iterations, solves a step", "CPU [s]", "wall [s]", "memory [GB]"
    deck, number = INPUTS / "leg_section.toml", int(steps)
    for across in sizes or ("54",):
        words, said = options(int(across), number), list[str]()
        with tempfile.TemporaryDirectory() as name:
            out = Path(name)
            for station in (segment, build):
                station(deck, out, overrides=words)
            found = run_deck(
                deck, out, overrides=words, threads=int(threads), progress=said.append,
                verbosity=1, error=False,
            )  # fmt: skip
        counts = [int(n) for n in re.findall(r"in (\d+) iterations", "\n".join(said))]
        yield (
            f"{found['source_points']:,}",
            f"{found['dofs']:,}",
            f"{sum(counts) / number:.0f}, {len(counts) / number:.1f}",
            f"{found['cpu_s']:.0f}",
            f"{found['timings_s']['total']:.0f}",
            f"{found['memory_peak_bytes'] / 1e9:.2f}",
        )
