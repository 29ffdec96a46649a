"""Hard cases: each ends in the right answer or in an error that says what to do.

A case is one run of a program in a process of its own, under a time limit. What counts as wrong
is an answer that is not right and does not say so, a crash, and a run without an end.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.bench.runs import (
    METHODS,
    PUBLISHED_BLOCK,
    Deck,
    lattice,
    outcome_text,
    read_deck,
    run_command,
    solve_case,
)
from myork.bench.tables import Columns, table
from myork.console import ProgressCallback
from myork.core.deck import text_of_tables
from myork.records import PointCloud
from myork.reference import exact
from myork.reference.bodies import box, graded, jittered, stretched
from myork.reference.materials import RUBBER, along_fibers

__all__ = ["Case", "cases", "run", "run_case"]

#: Verdicts: the answer is right; it is refused or not reached and the message says why; else
RIGHT, EXPLAINED, WARNED = "right", "explained", "warned"


class Case(NamedTuple):
    """A hard case.

    Attributes
    ----------
    name : str
        What is hard.
    deck : Deck
        Name of an installed deck, or tables.
    overrides : tuple of str
        Overrides of the deck.
    cloud : PointCloud or None
        Points of the body, where it has no deck of its own.
    probe : str
        Probe whose value is judged.
    solution : float or None
        Right value of the probe; none where the input makes no sense.
    tolerance : float
        Relative error that still counts as right.
    words : tuple of str
        Texts that the message of a refusal contains: it names what is wrong.
    fast : bool
        Takes a second or two.
    station : str
        Command of the pipeline that is run on an image.
    damage : str
        What is wrong with the image.
    """

    name: str
    deck: Deck
    overrides: tuple[str, ...] = ()
    cloud: PointCloud | None = None
    probe: str = "stress"
    solution: float | None = None
    tolerance: float = 1e-3
    words: tuple[str, ...] = ()
    fast: bool = True
    station: str = "solve"
    damage: str = ""


_COLUMNS: Columns = (
    ("case", "name"),
    ("verdict", "verdict"),
    ("outcome", outcome_text),
    ("error", "error"),
    ("iterations", "iterations"),
    ("J", lambda record: [record["min_J"], record["max_J"]] if "min_J" in record else None),
    ("solver", "solver.used"),
    ("s", "seconds"),
    ("message", lambda record: record["message"][:300]),
)


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run all hard cases, the fast ones where `quick`; see `myork.bench` for the result."""
    chosen = [case for case in cases() if case.fast or not quick]
    records = []
    for number, case in enumerate(chosen):
        progress(f"case {number + 1}/{len(chosen)}  {case.name}")
        records.append(run_case(case, 60.0 if quick else 300.0))
    count = {v: sum(r["verdict"] == v for r in records) for v in (RIGHT, EXPLAINED, WARNED)}
    return {
        "title": "Stability",
        "about": f"{len(records)} hard cases: {count[RIGHT]} right, {count[EXPLAINED]} ended with "
        f"an error that names its reason, {count[WARNED]} are off and say so, "
        f"{len(records) - sum(count.values())} none of these.",
        "cases": records,
        "tables": [table("Hard cases, one line each.", _COLUMNS, records)],
    }


def run_case(case: Case, limit: float) -> dict[str, Any]:
    """Run a case and judge it.

    Returns
    -------
    dict
        The record with `name`, `error` and `verdict`: `right`, `explained`, `wrong` (an answer
        that is not right), `warned` (the same, but the run itself does not accept it),
        `unexplained` (an error without what it must name), `crashed`, `failed` or `time limit`.
    """
    if case.station == "solve":
        record = solve_case(case.deck, case.overrides, cloud=case.cloud, limit=limit, error=True)
    else:
        record = _run_station(case, limit)
    record["name"] = case.name
    if "probes" in record:
        record["value"] = record["probes"][case.probe]
    if record["outcome"] in ("converged", "done"):
        value = record.get("value")
        if case.solution is None or value is None:
            record["verdict"] = "wrong"
        else:
            record["error"] = abs(value / case.solution - 1.0)
            told = record["verdict"]["state"] != "accepted"
            wrong = WARNED if told else "wrong"
            record["verdict"] = RIGHT if record["error"] <= case.tolerance else wrong
    elif record["outcome"] in ("refused", "not converged"):
        message = record["message"]
        named = bool(message) and all(word in message for word in case.words)
        record["verdict"] = EXPLAINED if named else "unexplained"
    else:
        record["verdict"] = record["outcome"]
    return record


def cases() -> list[Case]:
    """All hard cases."""
    return [
        *_bulk_moduli(),
        *_large_strains(),
        *_muscle_loads(),
        *_fiber_curves(),
        *_clouds(),
        *_bad_points(),
        *_fibers(),
        *_images(),
        _too_large(),
    ]


def _method(name: str) -> str:
    return f"scene.method={name}"


def _bulk_moduli() -> list[Case]:
    """Tube from compressible to incompressible."""
    small = (*lattice((7, 39)), "load.steps=8")
    named = ("material.rubber.K", "rkcm-mixed")
    infinite = (*small, "material.K=inf", _method("rkcm"))
    found = [Case("tube, K = inf, rkcm", "tube", infinite, probe="radial_stress", words=named)]
    deck = read_deck("tube")
    for bulk in ("1e3", "1e5", "1e7", "1e10", "1e300", "inf"):
        for method in METHODS if bulk in ("1e3", "1e7") else METHODS[1:]:
            found.append(
                Case(
                    f"tube, K = {bulk}, {method}",
                    "tube",
                    (*small, f"material.K={bulk}", _method(method)),
                    probe="radial_stress",
                    solution=exact.inner_stress(deck, float(bulk)),
                    tolerance=0.01,
                    words=("load",),
                    fast=method == METHODS[1],
                )
            )
    return found


def _large_strains() -> list[Case]:
    """Homogeneous states far from rest, and the shear block."""
    rubber = exact.Polynomial.from_deck(read_deck("shear_3d")["material"][0])
    tension, compression = exact.uniaxial(rubber, 6.0), exact.uniaxial(rubber, 0.1)
    shear = exact.simple_shear(rubber, 5.0)
    kinds: tuple[tuple[str, str, tuple[str, ...], float], ...] = (
        ("shear, gamma = 5", "shear_3d", (), shear),
        ("tension to 6", "uniaxial_tension", (), tension),
        ("tension to 6 in one step", "uniaxial_tension", ("load.steps=1",), tension),
        ("compression to 0.1", "uniaxial_compression", (), compression),
    )
    return [
        Case(
            f"{name}, {method}",
            deck,
            (*overrides, _method(method)),
            probe="shear_stress" if deck == "shear_3d" else "stress",
            solution=solution,
            tolerance=5e-3 if deck == "shear_3d" else 1e-5,
            fast=deck != "uniaxial_compression",
        )
        for method in METHODS
        for name, deck, overrides, solution in kinds
    ]


def _muscle_loads() -> list[Case]:
    """Activation in one step; active stress far above the passive stiffness."""
    small = (*lattice((4, 4, 7)), "load.steps=1", *PUBLISHED_BLOCK)
    kinds: tuple[tuple[str, tuple[str, ...]], ...] = (
        ("full activation in one step", ()),
        ("active stiffness above passive", ("material.sigma_max=300",)),
    )
    return [
        Case(
            f"{name}, {method}",
            "muscle_block",
            (*small, *overrides, _method(method)),
            probe="stress_zz",
            solution=along_fibers(read_deck("muscle_block", overrides)["material"][0], 1.0, 1.0),
            tolerance=0.02,
            fast=method == METHODS[0],
        )
        for method in METHODS
        for name, overrides in kinds
    ]


def _fiber_curves() -> list[Case]:
    """Stretches through all joints of the fiber curves, half activated."""
    body = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7), (1.0, 0.0, 0.0))
    found = []
    for method in METHODS:
        for curve in ("published", "smooth"):
            for stretch in (0.35, 1.7):
                deck = stretched(
                    method=method, move=stretch - 1.0, activation=0.5, steps=13, curve=curve
                )
                found.append(
                    Case(
                        f"fibers to {stretch}, {curve} curve, {method}",
                        deck,
                        cloud=body,
                        solution=along_fibers(deck["material"][0], stretch, 0.5),
                        tolerance=1e-4,
                        fast=method == METHODS[0],
                    )
                )
    return found


def _clouds() -> list[Case]:
    """Clouds that are not regular grids of cubes, under homogeneous tension."""
    cube = box((1.0, 1.0, 1.0), (5, 5, 5), (9, 9, 9))
    long = box((1.0, 1.0, 20.0), (5, 5, 5), (9, 9, 9))
    bodies = {
        "voxels of 1 : 20": long,
        "voxels of 1 : 20, jittered by 0.3 h": jittered(long, 0.3),
        "points jittered by 0.3 h": jittered(cube, 0.3),
        "points jittered by 0.9 h": jittered(cube, 0.9),
        "points graded 1 : 6": graded(cube, 1.6),
        "points graded 1 : 37": graded(cube, 3.0),
        "sheet of two layers": box((1.0, 1.0, 0.2), (5, 5, 2), (9, 9, 3)),
    }
    found = [
        _tension(f"{name}, {method}", body, ("point",), method=method)
        for name, body in bodies.items()
        for method in METHODS
    ]
    alike = replace(graded(cube, 3.0), spacing=cube.spacing)
    name = "points graded 1 : 37, supports all alike"
    return [*found, _tension(name, alike, ("point", "support"))]


def _bad_points() -> list[Case]:
    """Points that cannot carry an approximation, or a body that nothing holds."""
    cube = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7))
    twice = replace(cube, source=np.vstack([cube.source, cube.source[10:11]]))
    points = np.vstack([cube.points, cube.points[100:101]])
    place = replace(
        cube,
        points=points,
        label=np.append(cube.label, 1).astype(np.int32),
        fiber=np.vstack([cube.fiber, cube.fiber[:1]]),
        volume=np.append(cube.volume, 1.0),
    )
    bodies = [
        # duplicates are redundant, not contradictory: the answer may be right all the same
        ("a source point twice", twice, "point", True),
        ("a collocation point twice", place, "point", True),
        ("one layer of points", box((1.0, 1.0, 0.2), (5, 5, 1), (9, 9, 1)), "point", False),
        ("an island that nothing holds", _with_island(cube), "island", False),
        ("a coordinate that is NaN", _spoilt(cube, "points"), "point", False),
        ("a source point that is NaN", _spoilt(cube, "source"), "not finite", False),
    ]
    found = []
    for name, body, word, sound in bodies:
        for method in METHODS:
            case = _tension(f"{name}, {method}", body, (word,), method=method)
            found.append(case if sound else case._replace(solution=None))
    for support in ("1.01", "1.6"):
        name = f"support of {support} spacings at order 2"
        overrides = (f"approximation.support={support}",)
        found.append(_tension(name, cube, ("support",))._replace(overrides=overrides))
    return found


def _fibers() -> list[Case]:
    """Fiber fields as images give them."""
    body = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7), (1.0, 0.0, 0.0))
    random = np.random.default_rng(3)
    flipped = body.fiber * random.choice([-1.0, 1.0], (len(body.fiber), 1))
    zero, broken, long = body.fiber.copy(), body.fiber.copy(), body.fiber.copy()
    zero[100], broken[100], long[100] = 0.0, np.nan, 3.0
    deck = stretched(move=0.1, activation=0.2, curve="smooth")
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
            solution=along_fibers(deck["material"][0], 1.1, 0.2),
            tolerance=1e-6,
        ),
        *(
            Case(name, deck, cloud=replace(body, fiber=fiber), words=("fiber",))
            for name, fiber in wrong.items()
        ),
    ]


def _tension(name: str, cloud: PointCloud, words: tuple[str, ...], method: str = "rkcm") -> Case:
    """Rubber under homogeneous tension."""
    stress = exact.uniaxial(exact.Polynomial.from_deck(RUBBER), 1.2)
    deck = stretched(method=method)
    return Case(name, deck, cloud=cloud, solution=stress, tolerance=1e-4, words=words)


def _images() -> list[Case]:
    """Label maps and images that are broken."""
    labels = {**_PLAIN, "build": {"labels": "image.nii.gz"}}
    anatomy = {"anatomy": "image.nii.gz", "label": "muscle", "phase": "dark"}
    return [
        Case(name, labels, words=words, station="build", damage=damage)
        for name, damage, words in (
            ("NaN in the label map", "nan", ("image.nii",)),
            ("singular affine", "affine", ("affine",)),
            ("empty label", "empty", ("label",)),
        )
    ] + [
        Case(
            "NaN in the image",
            {**_PLAIN, "image": anatomy},
            words=("not finite",),
            station="segment",
            damage="nan",
        )
    ]


def _too_large() -> Case:
    """More than any memory holds, refused before it is allocated."""
    large = (*lattice((400, 400, 400)), _method("rkcm"))
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


_PLAIN: Mapping[str, Any] = {"title": "Damaged images", "scene": {"dimension": 3}}


def _run_station(case: Case, limit: float) -> dict[str, Any]:
    """One station of the pipeline on a damaged image; it has no value to be right about."""
    assert isinstance(case.deck, Mapping)
    if case.station == "build":
        data = np.zeros((12, 12, 8), np.float32 if case.damage == "nan" else np.int16)
        if case.damage != "empty":
            data[2:10, 2:10, :] = 1
    else:
        data = np.random.default_rng(1).uniform(100.0, 110.0, (12, 12, 8)).astype(np.float32)
        data[4:8, 4:8, :] -= 60.0
    if case.damage == "nan":
        data[5, 5, 4] = np.nan
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as name:
        folder = Path(name)
        _write_image(folder / "image.nii.gz", data, singular=case.damage == "affine")
        deck = folder / "deck.toml"
        deck.write_text(text_of_tables(case.deck), encoding="utf-8")
        words = ["-m", "myork", case.station, str(deck), "--out", str(folder / "out"), "-q"]
        return run_command([sys.executable, *words], limit)._asdict()


def _write_image(path: Path, data: Any, singular: bool) -> None:
    """Write an image; nibabel itself refuses to write a singular affine, so it is patched in."""
    import nibabel

    image = nibabel.Nifti1Image(data, np.diag([2.0, 2.0, 3.0, 1.0]))
    if singular:
        header = image.header
        header["sform_code"], header["qform_code"] = 1, 0
        header["srow_x"], header["srow_y"] = (2, 0, 0, 0), (2, 0, 0, 0)
        header["srow_z"] = (0, 0, 3, 0)
        image = nibabel.Nifti1Image(data, None, header)
    nibabel.save(image, path)
