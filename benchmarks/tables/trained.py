"""Trained reduced models at parameters outside their training."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from myork.files import INPUTS
from myork.rom.check import compare
from myork.rom.model import ReducedModel
from myork.rom.parameters import spread_points
from myork.stations.build import build
from myork.stations.segment import segment


class Trained(NamedTuple):
    """A deck with the ranges of a training, and other ranges at which the model is checked."""

    deck: str
    varied: dict[str, tuple[float, float]]
    overrides: tuple[str, ...] = ()
    stations: tuple[Any, ...] = ()  #: Stations that make its points
    beyond: dict[str, tuple[float, float]] | None = None


_MUSCLE = {"load.activation": (0.0, 1.0), "material.muscle.sigma_max": (20.0, 40.0)}
_STRONGER = {"load.activation": (0.3, 1.0), "material.muscle.sigma_max": (70.0, 70.0)}
#: Models to train, by name
MODELS = {
    "muscle block, nodal cells": Trained(
        "muscle_block",
        {**_MUSCLE, "boundary.z1.u_z": (-0.2, 0.3)},
        ("scene.method=rkpm-scni", "geometry.source=[5,5,9]"),
        beyond=_STRONGER,
    ),
    "gastrocnemius, nodal cells": Trained(
        "mg_muscle",
        {**_MUSCLE, "boundary.top.u_z": (-0.84, 1.26)},
        ("scene.method=rkpm-scni",),
        (segment, build),
        beyond=_STRONGER,
    ),
    "agonist and antagonist at a joint": Trained(
        "two_muscles",
        {
            "material.agonist.activation": (0.0, 0.3),
            "material.antagonist.activation": (0.0, 0.2),
            "boundary.top.rotation": (-8.0, 8.0),
        },
        stations=(build,),
    ),
}


def trained(points: str = "20", full_solves: str = "40") -> Iterator[tuple[str, ...]]:
    """Reduced models compared with full solves of the same form, by `myork rom train` and `check`.

    Median and largest errors at random points of the ranges: relative error of the first force,
    error of the displacement in L2 over the body relative to that state, and the ratio of estimate
    to this error. A second row of a model is at sigma_max 70 and activation 0.3 to 1, beyond the
    range of its training.
    """
    yield (
        "model", "cells, kept", "modes", "points", "failed", "force, median, most",
        "displacement, median, most", "estimate over error", "CPU [ms] a state, a full solve [s]",
    )  # fmt: skip
    for name, case in MODELS.items():
        deck = INPUTS / f"{case.deck}.toml"
        with tempfile.TemporaryDirectory() as folder:
            for station in case.stations:
                station(deck, Path(folder), overrides=case.overrides)
            rom = ReducedModel.train(
                deck, case.varied, full_solves=int(full_solves), tests=8, out=folder,
                overrides=case.overrides, threads=1,
            )  # fmt: skip
        for ranges in (None, case.beyond) if case.beyond else (None,):
            ends = {p.key: (p.low, p.high) for p in rom.parameters} | (ranges or {})
            at = [p._replace(low=ends[p.key][0], high=ends[p.key][1]) for p in rom.parameters]
            values = spread_points(at, int(points), 1)
            found = compare(rom, rom.full_model(), values, 1, lambda line: None)
            cells, ratio = found["cells"], found["indicator_ratio"]
            yield (
                name if ranges is None else f"{name}, beyond",
                f"{cells['all']}, {cells['kept']}",
                str(found["modes"]),
                str(found["points"]),
                str(found["failed"]),
                *(f"{found[key]['median']:.1e}, {found[key]['max']:.1e}" for key in ("force", "u")),
                f"{ratio['min']:.2f} to {ratio['max']:.2f}",
                f"{found['cpu_us_per_state'] / 1e3:.2f}, {found['full_cpu_s_per_state']:.1f}",
            )
