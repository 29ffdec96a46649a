"""Isometric contraction of a phantom's muscles: fiber directions, coarse and fine sections.

Section 5.3.10.3.3: a medial gastrocnemius whose fibers are measured ones, here the phantom's, and
the same with one direction for all. Section 4.2.5 and figure 4.18: a section of a calf of muscle,
fat and connective tissue between two cut planes, held sideways at its bones, from coarse and from
fine cross-sections; slices are not refined, as there. The reference tells neither the direction
that it assumed nor its forces of figure 4.18 in numbers. Each force is that of one end; the other
end has the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from myork.bench.dissertation import TABLES
from myork.bench.phantoms import GASTROCNEMIUS, gastrocnemius, inclined, strided_cloud
from myork.bench.runs import outcome_text, read_deck, solve_case
from myork.bench.tables import Columns, plot, table
from myork.console import ProgressCallback
from myork.imaging.phantom import make_phantom
from myork.records import Image

__all__ = ["run"]

#: Force of an assumed direction over that of the measured ones at half activation
_PUBLISHED_RATIO = TABLES["figure-5.36"].rows[0].published
#: Angles of an assumed direction from the long axis of the leg, in the plane of the measured mean
_ANGLES = (0.0, 10.0, 17.0)
#: Pixels of 1.25 mm along the edge of a block, which is a source point
_BLOCKS, _QUICK_BLOCKS = (4, 3, 2), (6,)
_CALF_BLOCKS, _QUICK_CALF_BLOCKS = (8, 4, 3), (12, 8)
_DIRECTIONS: Columns = (
    ("fibers", "fibers"),
    ("from the axis [degree]", "angle"),
    ("block [mm]", "block_mm"),
    ("source points", "source_points"),
    ("force at half activation [N]", "force"),
    ("over that of the measured fibers", "ratio"),
    ("published", "published"),
    ("outcome", outcome_text),
    ("verdict", "verdict.state"),
)
_SECTIONS: Columns = (
    ("block [mm]", "block_mm"),
    ("source points", "source_points"),
    ("activation reached", "load_activation"),
    ("force there [N]", "force"),
    ("largest difference from the finest [of its force]", "difference"),
    ("CPU [s]", "cpu_s"),
    ("outcome", outcome_text),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run both studies; see `myork.bench` for the result, which has `directions` and `sections`."""
    directions = [
        case
        for block in (_QUICK_BLOCKS if quick else _BLOCKS)
        for case in _direction_cases(block, progress)
    ]
    sections = _section_cases(_QUICK_CALF_BLOCKS if quick else _CALF_BLOCKS, progress, quick)
    axes = ("activation [-]", "force [N]")
    finest = [case for case in directions if case["block_mm"] == directions[-1]["block_mm"]]
    plots = [
        plot(title, axes, cases, "activation", "force", by="curve") | {"scale": "linear"}
        for title, cases in (
            ("Force by fiber direction (figure 5.36)", _points(finest, "fibers")),
            ("Force of coarse and fine sections (figure 4.18)", _points(sections, "name")),
        )
    ]
    return {
        "title": "Isometric contraction: fiber directions and resolution",
        "about": " ".join(__doc__.split("\n\n")[1].split()),
        "cases": [*directions, *sections],
        "directions": directions,
        "sections": sections,
        "plots": plots,
        "tables": [
            table("Fiber directions, section 5.3.10.3.3.", _DIRECTIONS, directions),
            table("A calf from coarse and fine sections, figure 4.18.", _SECTIONS, sections),
        ],
    }


def _direction_cases(block: int, progress: ProgressCallback) -> list[dict[str, Any]]:
    """The measured fibers, then one direction for all."""
    cloud = gastrocnemius(block)
    mean = cloud.fiber[cloud.label == 1].mean(axis=0)
    mean /= np.linalg.norm(mean)
    ways: list[tuple[str, NDArray[Any] | None]] = [
        ("measured", None),
        ("their mean", mean),
        *((f"assumed, {angle:g} degrees", inclined(mean, angle)) for angle in _ANGLES),
    ]
    cases: list[dict[str, Any]] = []
    for name, fiber in ways:
        progress(f"gastrocnemius, blocks of {1.25 * block:g} mm, fibers: {name}")
        points = cloud if fiber is None else gastrocnemius(block, fiber)
        case = solve_case(GASTROCNEMIUS, ("load.steps=5",), cloud=points, error=False)
        case |= {"fibers": name, "block_mm": 1.25 * block}
        case["angle"] = _angle(mean if fiber is None else fiber)
        _note_force(case)
        if fiber is not None and "force" in case and "force" in cases[0]:
            case["ratio"] = case["force"] / cases[0]["force"]
        if name.startswith("assumed"):
            case["published"] = _PUBLISHED_RATIO
        cases.append(case)
    return cases


def _angle(fiber: NDArray[Any]) -> float:
    return float(np.degrees(np.arccos(abs(fiber[2]))))


def _section_cases(
    blocks: Sequence[int], progress: ProgressCallback, quick: bool
) -> list[dict[str, Any]]:
    """The deck of the leg on the phantom's true tissues, coarse to fine."""
    values = read_deck("leg_section")
    keys = {key: values["phantom"][key] for key in ("spacing", "septum", "growth", "aponeurosis")}
    size = [*values["phantom"]["size"][:2], 5 if quick else values["phantom"]["size"][2]]
    parts = {key: values["phantom"][key] for key in ("imat", "imct")}
    phantom = make_phantom(size, **keys, **parts)
    fiber = Image(
        phantom.fiber.data * (phantom.tissue.data == 1)[..., np.newaxis], phantom.fiber.affine
    )
    tables = {name: values[name] for name in ("scene", "approximation", "material", "boundary")}
    tables |= {"title": values["title"], "geometry": {"kind": "model"}, "units": values["units"]}
    tables |= {"load": values["load"], "probe": values["probe"]}
    build = {key: values["build"][key] for key in ("ids", "bone", "normals", "merge", "islands")}
    cases = []
    for block in blocks:
        progress(f"calf, blocks of {1.25 * block:g} mm")
        cloud = strided_cloud(phantom.tissue, fiber, (block, block, 1), **build)
        words = ("load.activation=0.2", "load.steps=2") if quick else ()
        case = solve_case(tables, words, cloud=cloud, limit=1800.0)
        case |= {"name": f"blocks of {1.25 * block:g} mm", "block_mm": 1.25 * block}
        _note_force(case)
        cases.append(case)
    fine = cases[-1].get("path", {})
    for case in cases[:-1]:
        both = [a for a in case.get("path", {}) if a in fine]
        if both:
            case["difference"] = max(abs(case["path"][a] / fine[a] - 1.0) for a in both)
    return cases


def _note_force(case: dict[str, Any]) -> None:
    """Force at the upper end by activation, and the last of them [N]."""
    name = "top" if "top" in case.get("probes", {}) else "reaction_top"
    case["path"] = {step["activation"]: step["probes"][name] for step in case.get("history", [])}
    if case["path"]:
        case["load_activation"], case["force"] = list(case["path"].items())[-1]


def _points(cases: Sequence[Mapping[str, Any]], name: str) -> list[dict[str, Any]]:
    """One entry a load step, for curves."""
    return [
        {"curve": case[name], "activation": activation, "force": value}
        for case in cases
        for activation, value in {0.0: 0.0, **case["path"]}.items()
    ]
