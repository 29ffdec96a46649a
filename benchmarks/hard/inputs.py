"""Hard cases of input that makes no sense: points, fibers, sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from benchmarks.hard.case import DOUBTED, Case
from benchmarks.hard.known import HOMOGENEOUS, swells, tension
from benchmarks.truths.bodies import box, stretched
from myork.bench.materials import along_fibers
from myork.bench.runs import METHODS, lattice
from myork.records import PointCloud

__all__ = ["input_cases"]


def input_cases() -> list[Case]:
    """All of them."""
    return [*_bad_points(), *_fibers(), _too_large()]


def _bad_points() -> list[Case]:
    """Points that cannot carry an approximation, or a body that nothing holds."""
    cube = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7))
    bodies = [
        ("one layer of points", box((1.0, 1.0, 0.2), (5, 5, 1), (9, 9, 1)), "point"),
        ("an island that nothing holds", _with_island(cube), "island"),
        ("a coordinate that is NaN", _spoilt(cube, "points"), "point"),
        ("a source point that is NaN", _spoilt(cube, "source"), "finite numbers"),
    ]
    found = []
    for name, body, word in bodies:
        for method in METHODS:
            case = tension(f"{name}, {method}", body, (word,), method=method)
            found.append(case._replace(right={}))
    for support in ("1.01", "1.6"):
        name = f"support of {support} spacings at order 2"
        overrides = (f"approximation.support={support}",)
        case = tension(name, cube, ("support",))
        found.append(case._replace(right={}, overrides=overrides))
    return found


def _fibers() -> list[Case]:
    """Fiber fields as images give them."""
    body = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7), (1.0, 0.0, 0.0))
    random = np.random.default_rng(3)
    flipped = body.fiber * random.choice([-1.0, 1.0], (len(body.fiber), 1))
    zero, broken, long = body.fiber.copy(), body.fiber.copy(), body.fiber.copy()
    zero[100], broken[100], long[100] = 0.0, np.nan, 3.0
    deck = stretched(move=0.1, activation=0.2, curve="smooth")
    stress = along_fibers(deck["material"][0], 1.1, 0.2)
    wrong = {
        "a fiber that is NaN": broken,
        "a fiber of length 3": long,
        "a muscle point without fiber": zero,
    }
    return [
        Case(
            "fibers of random sign",
            deck,
            cloud=replace(body, fiber=flipped),
            right={"stress": stress},
            volume=swells(deck["material"][0]["K"], stress),
            **HOMOGENEOUS,
            words=("no error estimate",),
            expected=DOUBTED,
            why="no second solution: nodal cells need a lattice or voxels",
        ),
        *(
            Case(name, deck, cloud=replace(body, fiber=fiber), words=("fiber",))
            for name, fiber in wrong.items()
        ),
    ]


def _too_large() -> Case:
    """More than any memory holds, refused before it is allocated."""
    large = (*lattice((400, 400, 400)), "scene.method=rkcm")
    return Case("64 million source points", "muscle_block", large, words=("GB",))


def _with_island(cloud: PointCloud) -> PointCloud:
    """The same cloud with a second, free cube far away."""
    far = np.array([0.0, 0.0, 10.0])
    free = len(cloud.boundary_point)
    return replace(
        cloud,
        source=np.vstack([cloud.source, cloud.source + far]),
        points=np.vstack([cloud.points, cloud.points + far]),
        label=np.tile(cloud.label, 2),
        fiber=np.tile(cloud.fiber, (2, 1)),
        volume=np.tile(cloud.volume, 2),
        boundary_point=np.append(cloud.boundary_point, cloud.boundary_point + len(cloud.points)),
        boundary_set=np.append(cloud.boundary_set, np.full(free, 6, np.int32)),
        normal=np.tile(cloud.normal, (2, 1)),
        area=np.tile(cloud.area, 2),
        set_names=(*cloud.set_names, "island"),
    )


def _spoilt(cloud: PointCloud, name: str) -> PointCloud:
    values = getattr(cloud, name).copy()
    values[len(values) // 2, 1] = np.nan
    return replace(cloud, **{name: values})
