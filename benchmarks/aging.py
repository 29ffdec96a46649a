"""Force of a young and an old medial gastrocnemius of three materials, as in section 4.2.6.

The muscles are the phantoms of `myork.bench.phantoms`, with both ends fixed.
Properties pass smoothly from tissue to tissue over two spacings; as in the reference every point
has the fiber measured there, so that fat and connective tissue do not contract (`own`). Beside it
stands the other reading, in which the muscle's share of such a point takes the fiber of the
nearest muscle (`nearest`): as much contracts as there is muscle.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from myork.bench.dissertation import TABLES
from myork.bench.phantoms import (
    AGED,
    CONNECTIVE,
    MUSCLE_TISSUE,
    OLD,
    PIXEL,
    YOUNG,
    Muscle,
    aged_cloud,
    labelled,
)
from myork.bench.runs import outcome_text, solve_case
from myork.bench.tables import table
from myork.console import ProgressCallback
from myork.core.scene import Scene
from myork.records import PointCloud

__all__ = ["run", "solve_muscle"]


#: Table 4.3 and figure 4.22, young and old
_PUBLISHED = {
    key: tuple(
        row.published
        for row in (*TABLES["4.3"].rows, *TABLES["figure-4.22"].rows)
        if row.name.startswith((f"{name}, young [", f"{name}, old ["))
        and isinstance(row.published, float)
    )
    for key, name in (
        ("muscle", "muscle"),
        ("fat", "IMAT"),
        ("connective", "IMCT"),
        ("force", "F_max"),
        ("per_volume", "force per total volume"),
    )
}
_SOFT = tuple(
    f"material.connective_tissue.{key}={value}"
    for key, value in (("A10", 3), ("A20", 8), ("A30", 80), ("K", 5000))
)
_NEAREST = ("approximation.interface_fibers=nearest",)
#: Pixels along the edge of a block, load steps
_SIZES = ((4, 4), (3, 4), (2, 2))
#: What is changed in both muscles: name, young, old, pixels, overrides of the deck
_CHANGES: tuple[tuple[str, Muscle, Muscle, int, tuple[str, ...]], ...] = (
    *(
        (f"interface {width:g}", YOUNG, OLD, 4, (f"approximation.interface={width:g}",))
        for width in (1.1, 3)
    ),
    ("interface 3", YOUNG, OLD, 2, ("approximation.interface=3",)),
    # blocks of 5 mm do not resolve the free surface at the held ends
    ("no outer layer", replace(YOUNG, layer=0.0), replace(OLD, layer=0.0), 2, ()),
    ("connective tissue as soft as fat", YOUNG, OLD, 4, _SOFT),
    ("half the fiber stress, 15 N/cm²", YOUNG, OLD, 4, ("material.muscle.sigma_max=15",)),
    (
        "size alone: old size, young composition",
        YOUNG,
        replace(YOUNG, name="small", scale=OLD.scale),
        4,
        (),
    ),
    (
        "composition alone: young size, old composition",
        YOUNG,
        replace(OLD, name="fibrous", scale=YOUNG.scale),
        4,
        (),
    ),
    *(
        (
            f"random arrangement {seed}{', nearest' if fibers else ''}",
            replace(YOUNG, seed=seed),
            replace(OLD, seed=seed),
            block,
            fibers,
        )
        for block, readings in ((4, ((), _NEAREST)), (3, ((),)))
        for seed in (1, 2, 3)
        for fibers in readings
    ),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run the study; see `myork.bench` for the result, which has the `pairs` as well."""
    pairs = [
        _pair(progress, reading, YOUNG, OLD, block, steps if reading == "own" else 2, overrides)
        for reading, overrides in (("own", ()), ("nearest", _NEAREST))
        for block, steps in _SIZES[: 1 if quick else None]
    ]
    changes = [
        _pair(progress, name, young, old, block, 2, overrides)
        for name, young, old, block, overrides in _CHANGES[: 0 if quick else None]
    ]
    return {
        "title": "Young and old medial gastrocnemius",
        "about": " ".join(__doc__.split("\n\n")[1].split()) + " Materials of tables 4.1 and 4.2; "
        "the fibers' stress (30 N/cm²) is not in the reference, so that ratios are compared.",
        "cases": [case for pair in [*pairs, *changes] for case in pair["cases"]],
        "pairs": [*pairs, *changes],
        "plots": [_plot([pairs[0], pairs[len(pairs) // 2]])],
        "tables": [_volumes(pairs[: len(pairs) // 2]), _forces(pairs), _drops([*pairs, *changes])],
    }


def solve_muscle(
    muscle: Muscle, block: int, steps: int, overrides: Sequence[str] = ()
) -> dict[str, Any]:
    """Contract a muscle between fixed ends.

    Parameters
    ----------
    muscle : Muscle
        What is contracted.
    block : int
        Pixels along the edge of a block; each block is a source point.
    steps : int
        Load steps up to full activation.
    overrides : sequence of str
        Overrides of the deck.

    Returns
    -------
    dict
        Record of the solve, with `volume` (by material, of the model), `images` (of the label
        map), `contracting` (volume of muscle that contracts) [cm^3], `interface` (area between
        muscle and passive tissue) [cm^2], `activation` and `force` (at both ends, shape
        `(2, nstep)`) [N].
    """
    labels, _ = labelled(muscle)
    cloud = aged_cloud(muscle, block)
    words = (f"load.steps={steps}", *overrides)
    case = solve_case(AGED, words, cloud=cloud)
    history = case.get("history", [])
    names = {number: name for number, name in labels.names.items() if number <= CONNECTIVE}
    voxel = labels.spacing.prod() / 1000.0
    return {
        "name": muscle.name,
        **case,
        "images": {n: float((labels.data == i).sum() * voxel) for i, n in names.items()},
        "volume": {n: cloud.label_volumes().get(i, 0.0) for i, n in names.items()},
        "contracting": _contracting(overrides, cloud),
        "interface": _interface_area(cloud),
        "activation": [step["activation"] for step in history],
        "force": [[step["probes"][end] for step in history] for end in ("bottom", "top")],
    }


def _contracting(overrides: Sequence[str], cloud: PointCloud) -> float:
    """Volume that contracts, by the share of sigma_max in the stress of each cell [cm^3].

    The undeformed body at full activation has the stress of fibers alone, sigma_max times share
    times the deviator of N N, whose norm is sqrt(2/3). Stress is given at the model's points: here
    those of the surface, too, lie in the middle of their cells.
    """
    assert cloud.voxels is not None
    cells = replace(cloud, points=cloud.voxels.centre)
    with Scene.from_tables(AGED, cells, overrides=overrides, threads=1) as scene:
        sigma_max = scene.deck["material"][0]["sigma_max"]
        stress = scene.fields(np.zeros(scene.dofs), 1.0).cauchy
    norm = np.sqrt((stress**2).sum(axis=1) + (stress[:, 3:] ** 2).sum(axis=1))
    return float(np.sqrt(1.5) * norm @ cloud.volume / sigma_max)


def _interface_area(cloud: PointCloud) -> float:
    """Area of the cell faces between muscle and passive tissue [cm^2]."""
    assert cloud.voxels is not None
    size = cloud.voxels.size
    place = cloud.voxels.index - cloud.voxels.index.min(axis=0)
    label = np.zeros(place.max(axis=0) + 1, dtype=np.int32)
    label[tuple(place.T)] = cloud.label
    area = 0.0
    for axis in range(3):
        one, other = (np.delete(label, end, axis=axis) for end in (0, -1))
        between = (one > 0) & (other > 0) & ((one == MUSCLE_TISSUE) != (other == MUSCLE_TISSUE))
        area += float(between.sum() * size.prod() / size[axis])
    return area


def _pair(
    progress: ProgressCallback,
    name: str,
    young: Muscle,
    old: Muscle,
    block: int,
    steps: int,
    overrides: Sequence[str] = (),
) -> dict[str, Any]:
    """Both muscles, and what the second has less than the first at the end of the ramp."""
    cases = []
    name = f"{name}, {block * PIXEL:g} mm"
    for muscle in (young, old):
        progress(f"{name}: {muscle.name}")
        cases.append(solve_muscle(muscle, block, steps, overrides))
    pair: dict[str, Any] = {"name": name, "block_mm": block * PIXEL, "cases": cases}
    if all(case["outcome"] == "converged" for case in cases):
        pair["force_drop"] = _drop([case["force"][1][-1] for case in cases])
        pair["contracting_drop"] = _drop([case["contracting"] for case in cases])
        for key in ("volume", "images"):
            pair[f"{key}_drop"] = _drop([case[key]["muscle"] for case in cases])
        full = [case["force"][1][-1] for case in cases]
        muscles = [case["volume"]["muscle"] for case in cases]
        pair["per_muscle"] = [f / v for f, v in zip(full, muscles, strict=True)]
        active = [case["contracting"] for case in cases]
        pair["per_contracting"] = [f / v for f, v in zip(full, active, strict=True)]
    return pair


def _drop(values: Sequence[float]) -> float:
    return 1.0 - values[1] / values[0]


def _plot(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Figure 4.22(c)."""
    return {
        "title": "Force against activation",
        "x": "activation [-]",
        "y": "force [N]",
        "scale": "linear",
        "series": [
            {
                "name": f"{case['name']}, {pair['name']}",
                "x": [0.0, *case["activation"]],
                "y": [0.0, *case["force"][1]],
            }
            for pair in pairs
            for case in pair["cases"]
        ],
    }


def _volumes(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Volumes of label maps and models beside the published ones."""
    rows: list[dict[str, Any]] = []
    for i, name in enumerate(("young", "old")):
        muscle, fat, inner = (_PUBLISHED[key][i] for key in ("muscle", "fat", "connective"))
        outer = _PUBLISHED["force"][i] / _PUBLISHED["per_volume"][i] - muscle - fat - inner
        volume = {"muscle": muscle, "fat": fat, "connective_tissue": inner + outer}
        rows.append({"name": f"{name}, published", "volume": volume, "outer": outer})
        # the layer alone: what the phantom without it has less
        bare = labelled(replace((YOUNG, OLD)[i], layer=0.0))[0]
        within = float((bare.data == CONNECTIVE).sum() * bare.spacing.prod() / 1000.0)
        volume = pairs[0]["cases"][i]["images"]
        outer = volume["connective_tissue"] - within
        rows.append({"name": f"{name}, label map", "volume": volume, "outer": outer})
        rows += [
            {**pair["cases"][i], "name": f"{name}, blocks of {pair['block_mm']:g} mm"}
            for pair in pairs
        ]
    return table(
        "Volumes [cm³]; the published outer layer is force over force per volume, less "
        "the three materials of table 4.3. What contracts (own) is the muscle less a layer along "
        "its interface with passive tissue, whose area is given per volume of muscle [cm²/cm³].",
        (
            ("", "name"),
            ("muscle", "volume.muscle"),
            ("fat", "volume.fat"),
            ("connective tissue", "volume.connective_tissue"),
            ("of it outer layer", "outer"),
            ("contracting", "contracting"),
            (
                "interface per muscle volume",
                lambda row: (
                    row["interface"] / row["volume"]["muscle"] if "interface" in row else None
                ),
            ),
        ),
        rows,
    )


def _force_at(activation: float) -> Callable[[Mapping[str, Any]], float | None]:
    """Force on the upper end at an activation [N]."""
    return lambda case: dict(zip(case["activation"], case["force"][1], strict=True)).get(activation)


def _imbalance(case: Mapping[str, Any]) -> float | None:
    """What both ends lack of balance relative to the force."""
    lack = [abs(b + t) / abs(t) for b, t in zip(*case["force"], strict=True)]
    return max(lack, default=None)


def _forces(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Force at each activation and balance of the ends."""
    return table(
        "Force on the upper end [N] by activation, what both ends lack of balance "
        "relative to it, and the volume ratio J.",
        (
            ("", "case"),
            ("outcome", outcome_text),
            ("source points", "source_points"),
            *((f"{level:g}", _force_at(level)) for level in (0.25, 0.5, 0.75, 1.0)),
            ("imbalance", _imbalance),
            ("least J", "min_J"),
            ("largest J", "max_J"),
        ),
        [
            {**case, "case": f"{case['name']}, {pair['name']}"}
            for pair in pairs
            for case in pair["cases"]
        ],
    )


def _drops(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Drop of the force beside that of the muscle's volume."""
    force, muscle = _PUBLISHED["force"], _PUBLISHED["muscle"]
    published = {"name": "published", "force_drop": _drop(force), "images_drop": _drop(muscle)}
    published["per_muscle"] = [f / v for f, v in zip(force, muscle, strict=True)]
    return table(
        "Drops at full activation, and force per volume of muscle and per volume of "
        "muscle that contracts [N/cm³]; the fibers are the points' own unless said.",
        (
            ("", "name"),
            ("drop of force", "force_drop"),
            ("drop of muscle volume, label map", "images_drop"),
            ("the same, model", "volume_drop"),
            ("drop of contracting volume", "contracting_drop"),
            ("force per muscle volume, young", _at("per_muscle", 0)),
            ("old", _at("per_muscle", 1)),
            ("per contracting volume, young", _at("per_contracting", 0)),
            ("old", _at("per_contracting", 1)),
        ),
        [published, *pairs],
    )


def _at(key: str, number: int) -> Callable[[Mapping[str, Any]], float | None]:
    """Entry for the young or the old muscle, where there is one."""
    return lambda pair: pair[key][number] if key in pair else None
