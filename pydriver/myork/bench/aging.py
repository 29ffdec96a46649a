"""Force of a young and an old medial gastrocnemius of three materials, as in section 4.2.6.

The muscles are phantoms with the volumes of table 4.3. Labels and fibers are the phantom's truth,
so that nothing but the muscles differs. The outer layer of connective tissue is as thick as the
published forces per total volume ask for: 159.9 and 128.4 cm^3 with it. Both ends are fixed.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from myork.bench.runs import outcome_text, solve_case
from myork.build import build_cloud
from myork.console import ProgressCallback
from myork.imaging.phantom import make_phantom
from myork.model.store import write_model
from myork.records import Image, Labels

__all__ = ["OLD", "YOUNG", "Muscle", "labelled", "run", "solve_muscle"]


@dataclass(frozen=True)
class Muscle:
    """A medial gastrocnemius.

    Attributes
    ----------
    name : str
        Whose it is.
    scale : float
        Size of the calf across [-].
    imat, imct : float
        Part of the muscle that is fat, or connective tissue [-].
    layer : float
        Thickness of the connective tissue around it in a calf of scale 1 [mm].
    """

    name: str
    scale: float
    imat: float
    imct: float
    layer: float = 1.9


YOUNG = Muscle("young", 1.0901, 0.0231, 0.1701)
OLD = Muscle("old", 0.9705, 0.0633, 0.2999)

#: Table 4.3 and section 4.2.6, young and old
_PUBLISHED = {
    "muscle": (98.93, 61.89),
    "fat": (2.83, 6.15),
    "connective": (20.86, 29.15),
    "force": (68.76, 37.74),
    "per_volume": (0.430, 0.294),
}
_PIXEL = 1.25  # [mm]
_SLICES, _SLICE = 26, 6.0  # number, [mm]
_MUSCLE, _CONNECTIVE = 1, 3

_DECK = """\
title = "Isometric contraction of a medial gastrocnemius of three materials"
[units]
force = "N"
length = "cm"
[scene]
dimension = 3
method = "rkpm-scni"
[geometry]
kind = "model"
[approximation]
order = 1
support = 2
kernel = "cubic"
interface = 2
[[material]]
name = "muscle"
label = 1
model = "muscle"
A10 = 6.43
A01 = -3.8
A20 = 0.94
A02 = 0.0005
A11 = -0.0043
K = 5000
sigma_max = 30
curve = "smooth"
[[material]]
name = "fat"
label = 2
model = "polynomial"
A10 = 3
A20 = 8
A30 = 80
K = 5000
[[material]]
name = "connective_tissue"
label = 3
model = "polynomial"
A10 = 30
A20 = 80
A30 = 800
K = 50000
[[boundary]]
set = "bottom"
u_x = 0
u_y = 0
u_z = 0
[[boundary]]
set = "top"
u_x = 0
u_y = 0
u_z = 0
[load]
steps = 4
activation = 1
[[probe]]
name = "bottom"
quantity = "force_z"
set = "bottom"
[[probe]]
name = "top"
quantity = "force_z"
set = "top"
"""
_SOFT = tuple(
    f"material.connective_tissue.{key}={value}"
    for key, value in (("A10", 3), ("A20", 8), ("A30", 80), ("K", 5000))
)
#: Pixels along the edge of a block, load steps
_SIZES = ((4, 4), (3, 4), (2, 2))
#: What is changed in both muscles: name, young, old, overrides of the deck
_CHANGES: tuple[tuple[str, Muscle, Muscle, tuple[str, ...]], ...] = (
    ("connective tissue as soft as fat", YOUNG, OLD, _SOFT),
    (
        "size alone: old size, young composition",
        YOUNG,
        replace(YOUNG, name="small", scale=OLD.scale),
        (),
    ),
    (
        "composition alone: young size, old composition",
        YOUNG,
        replace(OLD, name="fibrous", scale=YOUNG.scale),
        (),
    ),
    ("half the fiber stress, 15 N/cm2", YOUNG, OLD, ("material.muscle.sigma_max=15",)),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run the study.

    Parameters
    ----------
    out : Path
        Not used; every solve has a folder of its own.
    progress : callable
        Called with every line of progress.
    quick : bool
        Only the coarsest blocks.
    """
    pairs = []
    for block, steps in _SIZES[: 1 if quick else None]:
        name = f"blocks of {block * _PIXEL:g} mm"
        pairs.append(_pair(progress, name, YOUNG, OLD, block, steps))
    changes = [
        _pair(progress, name, young, old, _SIZES[0][0], 2, overrides)
        for name, young, old, overrides in _CHANGES[: 0 if quick else None]
    ]
    return {
        "title": "Young and old medial gastrocnemius",
        "about": " ".join(__doc__.split("\n\n")[1].split()) + " Materials of tables 4.1 and 4.2; "
        "the fibers' stress (30 N/cm2) is not in the reference, so that ratios are compared.",
        "cases": [case for pair in [*pairs, *changes] for case in pair["cases"]],
        "pairs": [*pairs, *changes],
        "plots": [_plot(pairs[0])],
        "tables": [_volumes(pairs), _forces(pairs), _drops([*pairs, *changes])],
    }


def labelled(muscle: Muscle) -> tuple[Labels, Image]:
    """Materials of a muscle with its outer layer, and fibers of its muscle tissue."""
    pixels = int(np.ceil((108.0 * muscle.scale + 6.0) / _PIXEL))
    phantom = make_phantom(
        (pixels, pixels, _SLICES),
        (_PIXEL, _PIXEL, _SLICE),
        scale=muscle.scale,
        aponeurosis=muscle.layer,
        imat=muscle.imat,
        imct=muscle.imct,
    )
    inside, tissue = phantom.truth.data == 1, phantom.tissue.data
    layer = (phantom.truth.data == 0) & (tissue == _CONNECTIVE)
    label = np.where(inside | layer, tissue, 0).astype(np.int32)
    fiber = phantom.fiber.data * (label == _MUSCLE)[..., np.newaxis]
    affine = phantom.tissue.affine
    return Labels(label, affine, phantom.tissue.names, muscle.name), Image(fiber, affine)


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
        map) [cm^3], `activation` and `force` (at both ends, shape `(2, nstep)`) [N].
    """
    labels, fiber = labelled(muscle)
    stride = [block, block, 1]
    table = {
        "ids": [1, 2, 3],
        "bone": [],
        "collocation_stride": stride,
        "source_stride": stride,
        "merge": "sample",
        "islands": "error",
        "normals": "distance",
    }
    cloud, _ = build_cloud(labels, fiber, table, "cm")
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as folder:
        write_model(Path(folder) / "model.h5", cloud)
        deck = Path(folder) / "aging.toml"
        deck.write_text(_DECK, encoding="utf-8")
        case = solve_case(deck, (f"load.steps={steps}", *overrides))
    history = case.get("history", [])
    names = {number: name for number, name in labels.names.items() if number <= _CONNECTIVE}
    voxel = labels.spacing.prod() / 1000.0
    return {
        "name": muscle.name,
        **case,
        "images": {n: float((labels.data == i).sum() * voxel) for i, n in names.items()},
        "volume": {n: float(cloud.volume[cloud.label == i].sum()) for i, n in names.items()},
        "activation": [step["activation"] for step in history],
        "force": [[step["probes"][end] for step in history] for end in ("bottom", "top")],
    }


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
    for muscle in (young, old):
        progress(f"{name}: {muscle.name}")
        cases.append(solve_muscle(muscle, block, steps, overrides))
    pair: dict[str, Any] = {"name": name, "block_mm": block * _PIXEL, "cases": cases}
    if all(case["outcome"] == "converged" for case in cases):
        pair["force_drop"] = _drop([case["force"][1][-1] for case in cases])
        for key in ("volume", "images"):
            pair[f"{key}_drop"] = _drop([case[key]["muscle"] for case in cases])
    return pair


def _drop(values: Sequence[float]) -> float:
    return 1.0 - values[1] / values[0]


def _plot(pair: Mapping[str, Any]) -> dict[str, Any]:
    """Figure 4.22(c)."""
    return {
        "title": f"Force against activation, {pair['name']}",
        "x": "activation [-]",
        "y": "force [N]",
        "scale": "linear",
        "series": [
            {"name": case["name"], "x": [0.0, *case["activation"]], "y": [0.0, *case["force"][1]]}
            for case in pair["cases"]
        ],
    }


def _volumes(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Volumes of label maps and models beside the published ones."""
    rows: list[list[Any]] = []
    for i, name in enumerate(("young", "old")):
        inner = [_PUBLISHED[key][i] for key in ("muscle", "fat", "connective")]
        outer = _PUBLISHED["force"][i] / _PUBLISHED["per_volume"][i] - sum(inner)
        rows.append([f"{name}, published", *inner[:2], inner[2] + outer, outer])
        # the layer alone: what the phantom without it has less
        bare = labelled(replace((YOUNG, OLD)[i], layer=0.0))[0]
        within = float((bare.data == _CONNECTIVE).sum() * bare.spacing.prod() / 1000.0)
        images = pairs[0]["cases"][i]["images"]
        rows.append([f"{name}, label map", *images.values(), images["connective_tissue"] - within])
        for pair in pairs:
            rows.append([f"{name}, {pair['name']}", *pair["cases"][i]["volume"].values(), None])
    return {
        "caption": "Volumes [cm3]; the published outer layer is force over force per volume, less "
        "the three materials of table 4.3.",
        "head": ["", "muscle", "fat", "connective tissue", "of it outer layer"],
        "rows": rows,
    }


def _forces(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Force at each activation and balance of the ends."""
    rows = []
    for pair in pairs:
        for case in pair["cases"]:
            at = dict(zip(case["activation"], case["force"][1], strict=True))
            lack = [abs(b + t) / abs(t) for b, t in zip(*case["force"], strict=True)]
            rows.append(
                [f"{case['name']}, {pair['name']}", outcome_text(case), case.get("source_points")]
                + [at.get(activation) for activation in (0.25, 0.5, 0.75, 1.0)]
                + [max(lack, default=None), case.get("min_J"), case.get("max_J")]
            )
    return {
        "caption": "Force on the upper end [N] by activation, what both ends lack of balance "
        "relative to it, and the volume ratio J.",
        "head": ["", "outcome", "source points", "0.25", "0.5", "0.75", "1", "imbalance"]
        + ["least J", "largest J"],
        "rows": rows,
    }


def _drops(pairs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Drop of the force beside that of the muscle's volume."""
    force, muscle = _PUBLISHED["force"], _PUBLISHED["muscle"]
    published = [f / v for f, v in zip(force, muscle, strict=True)]
    rows: list[list[Any]] = [
        ["published", _drop(force), _drop(muscle), None, *published, *_PUBLISHED["per_volume"]]
    ]
    for pair in pairs:
        ends = [case["force"][1][-1] if case["force"][1] else np.nan for case in pair["cases"]]
        volumes = [case["volume"] for case in pair["cases"]]
        rows.append(
            [pair["name"]]
            + [pair.get(f"{key}_drop") for key in ("force", "images", "volume")]
            + [f / v["muscle"] for f, v in zip(ends, volumes, strict=True)]
            + [f / sum(v.values()) for f, v in zip(ends, volumes, strict=True)]
        )
    changed = _SIZES[0][0] * _PIXEL
    return {
        "caption": "Drops at full activation, and force per volume [N/cm3]; changes of the muscles "
        f"with blocks of {changed:g} mm.",
        "head": ["", "drop of force", "drop of muscle volume, label map", "the same, model"]
        + ["per muscle volume, young", "old", "per total volume, young", "old"],
        "rows": rows,
    }
