"""Bodies from voxels in the mixed form: a bar with known answers, and the phantom muscle refined.

The bar is the block of `muscle_fibers.toml` cut out of a voxel lattice that is turned about its
axis, so that its sides are stairs; its answers are the deck's finite element values. The muscle
has no known answer: its force must not depend on the strides, and must be the same in all sections.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.voxel_bodies import strided_cloud
from myork.bench.materials import MUSCLE
from myork.bench.runs import read_deck
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback
from myork.core.scene import Scene
from myork.imaging.phantom import make_phantom
from myork.records import Image, Labels, PointCloud

__all__ = ["bar", "run", "solve_bar"]

_FIXED = {"u_x": 0, "u_y": 0, "u_z": 0}
_SUPPORT = {2: 3, 3: 4}
#: Numbers compared: the deck's probes
_NAMES = ("side_u_x", "side_u_z", "stress_zz", "stress_xz", "reaction_x", "reaction_z")
_BAR_COLUMNS: Columns = (
    *((name, name) for name in ("voxel", "angle", "order", "sources")),
    *((name, f"error.{name}") for name in _NAMES),
    ("J", "J"),
)
_MUSCLE_COLUMNS: Columns = (
    ("collocation", lambda case: str(case["collocation"])),
    ("source", lambda case: str(case["source"])),
    *((name, name) for name in ("order", "sources", "force", "spread", "J")),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run the study; see `myork.bench` for the result."""
    bars = []
    orders = (2,) if quick else (2, 3)
    for voxel, angle in _BARS[: 2 if quick else None]:
        for order in orders:
            progress(f"bar of voxels of {voxel:.3f}, turned {angle:g} degrees, order {order}")
            bars.append(solve_bar(voxel, angle, order))
    muscles = []
    for collocation, source in _STRIDES[: 1 if quick else None]:
        for order in orders:
            progress(f"muscle, strides {collocation} and {source}, order {order}")
            muscles.append(_solve_muscle(collocation, source, order))
    return {
        "title": "Clouds from voxels",
        "about": "Mixed form on bodies with ragged surfaces, activation 0.05.",
        "cases": [*bars, *muscles],
        "tables": [
            table("Turned bar: relative difference from finite elements.", _BAR_COLUMNS, bars),
            table(
                "Phantom muscle: force, spread of section forces over the middle, J "
                "farther from the rims than half a radius.",
                _MUSCLE_COLUMNS,
                muscles,
            ),
        ],
    }


_BARS = ((1 / 8, 20.0), (1 / 8, 33.0), (1 / 12, 20.0), (1 / 12, 33.0))
_STRIDES = (
    ((2, 2, 1), (4, 4, 1)),
    ((2, 2, 1), (4, 4, 2)),
    ((1, 1, 1), (4, 4, 1)),
    ((1, 1, 1), (4, 4, 2)),
)


def bar(voxel: float, angle: float) -> PointCloud:
    """The block 1 x 1 x 2 cut out of cubic voxels turned about z, its axis at x = y = 0.

    The lattice is shifted so that as many voxels are kept as fill the block; a source point stands
    at every second one.
    """
    reach = int(1.0 / voxel) + 2
    axis = voxel * np.arange(-reach, reach + 1)
    turn = np.radians(angle)
    best = None
    for shift in np.ndindex(8, 8):
        x, y = np.meshgrid(*(axis + voxel * s / 8 for s in shift), indexing="ij")
        along = np.cos(turn) * x + np.sin(turn) * y, -np.sin(turn) * x + np.cos(turn) * y
        body = (abs(along[0]) <= 0.5) & (abs(along[1]) <= 0.5)
        missing = abs(body.sum() * voxel**2 - 1.0)
        if best is None or missing < best[0] - 1e-12:
            best = missing, body, np.array(shift) * voxel / 8
    assert best is not None
    layers = round(2.0 / voxel)
    data = np.repeat(best[1][:, :, np.newaxis], layers, axis=2).astype(np.int32)
    affine = np.diag([10 * voxel, 10 * voxel, 10 * voxel, 1.0])
    affine[:3, 3] = 10 * np.array([*(axis[0] + best[2]), 0.5 * voxel])
    fiber = np.zeros((*data.shape, 3))
    lean = np.radians(30.0)
    fiber[data > 0] = [
        np.sin(lean) * np.cos(turn),
        np.sin(lean) * np.sin(turn),
        np.cos(lean),
    ]
    return strided_cloud(Labels(data, affine), Image(fiber, affine), source_stride=[2, 2, 2])


def solve_bar(voxel: float, angle: float, order: int) -> dict[str, Any]:
    """Solve the turned bar and compare it with the reference of the block."""
    deck = read_deck("muscle_fibers")
    right = {
        table["probe"]: np.interp(0.05, table["activation"], table["value"])
        for table in deck["reference"]
    }
    cosine, sine = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    side, centre = [0.5 * cosine, 0.5 * sine, 1], [0, 0, 1]
    probes = [{"name": f"u_{a}", "quantity": f"u_{a}", "point": side} for a in "xyz"]
    probes += [{"name": f"s_{a}z", "quantity": f"cauchy_{a}z", "point": centre} for a in "xyz"]
    probes += [{"name": f"r_{a}", "quantity": f"force_{a}", "set": "bottom"} for a in "xyz"]
    value, _, volume = _solve(bar(voxel, angle), order, probes)
    # along the bar's own x
    found = {
        "side_u_x": cosine * value["u_x"] + sine * value["u_y"],
        "side_u_z": value["u_z"],
        "stress_zz": value["s_zz"],
        "stress_xz": cosine * value["s_xz"] + sine * value["s_yz"],
        "reaction_x": cosine * value["r_x"] + sine * value["r_y"],
        "reaction_z": value["r_z"],
    }
    return {
        "voxel": voxel,
        "angle": angle,
        "order": order,
        "sources": volume["sources"],
        "error": {name: found[name] / right[name] - 1.0 for name in _NAMES},
        "J": volume["J"],
    }


def _solve_muscle(
    collocation: tuple[int, ...], source: tuple[int, ...], order: int
) -> dict[str, Any]:
    """Solve the medial gastrocnemius of the phantom with some strides."""
    phantom = make_phantom()
    strides = {"collocation_stride": list(collocation), "source_stride": list(source)}
    cloud = strided_cloud(phantom.truth, phantom.fiber, ids=[1], **strides)
    probes = [{"name": "force", "quantity": "force_z", "set": "bottom"}]
    value, sections, volume = _solve(cloud, order, probes)
    middle = sections[2:-2]
    return {
        "collocation": collocation,
        "source": source,
        "order": order,
        "sources": volume["sources"],
        "force": -value["force"],
        "spread": float(np.ptp(middle) / abs(middle.mean())),
        "J": volume["J"],
    }


def _solve(
    cloud: PointCloud, order: int, probes: list[dict[str, Any]]
) -> tuple[dict[str, float], NDArray[Any], dict[str, Any]]:
    """Probe values, force along z through each slice, and the range of J away from the rims."""
    tables = {
        "title": "Body from voxels",
        "scene": {"dimension": 3, "method": "rkcm-mixed"},
        "approximation": {"order": order, "support": _SUPPORT[order]},
        "material": [{**MUSCLE, "curve": "smooth"}],
        "boundary": [{"set": end, **_FIXED} for end in ("bottom", "top")],
        "load": {"steps": 1, "activation": 0.05},
        "probe": probes,
    }
    with Scene.from_tables(tables, cloud) as scene:
        states = scene.solve(error=False)
        value = scene.probes(states.x, states.load)[-1, :, 0]
        fields = scene.fields(states.x[-1], states.load[-1])
    volume = np.linalg.det(fields.f)
    # P e_z with the Cauchy stress's components zz, yz, xz: P = J sigma F^-T
    row = fields.cauchy[:, [5, 4, 2]]
    nominal = volume * np.einsum("na,na->n", np.linalg.inv(fields.f)[:, 2], row)
    skin = cloud.boundary_point[cloud.boundary_set == cloud.set_names.index("surface")]
    below = np.delete(cloud.points, skin, axis=0)
    ends = [cloud.points[:, 2].min(), cloud.points[:, 2].max()]
    thickness = (ends[1] - ends[0]) / (len(np.unique(below[:, 2].round(6))) - 1)
    layer = np.rint((cloud.points[:, 2] - ends[0]) / thickness).astype(int)
    sections = np.bincount(layer, nominal * cloud.volume) / thickness
    radius = np.sqrt(cloud.volume.sum() / (ends[1] - ends[0]) / np.pi)
    rim = cloud.points[skin][np.isin(cloud.points[skin, 2], ends)]
    near = np.linalg.norm(cloud.points[:, np.newaxis] - rim[np.newaxis], axis=2).min(axis=1)
    away = volume[near > 0.5 * radius]
    found = {"sources": len(cloud.source), "J": [float(away.min()), float(away.max())]}
    names = [probe["name"] for probe in probes]
    return dict(zip(names, value.tolist(), strict=True)), sections, found
