"""Hard cases: each ends in the right answer or in an error that says what to do.

A case is one run of a program in a process of its own, under a time limit. What counts as wrong
is an answer that is not right and does not say so, a crash, and a run without an end.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.bench.runs import INPUTS, outcome_text, run_command, solve_case
from myork.console import ProgressCallback
from myork.core.deck import load_deck
from myork.records import PointCloud
from myork.reference import exact
from myork.reference.bodies import box, graded, jittered, write_body
from myork.reference.muscle import along_fibers

__all__ = ["Case", "cases", "run", "run_case"]

METHODS = ("rkcm", "rkcm-mixed")

#: Verdicts: the answer is right; it is refused or not reached and the message says why; else
RIGHT, EXPLAINED, WARNED = "right", "explained", "warned"


class Case(NamedTuple):
    """A hard case.

    Attributes
    ----------
    name : str
        What is hard.
    run : callable
        Takes a folder and a time limit, returns a record with `outcome`, `message`, `seconds`
        and, of a solve, what `solve_case` returns.
    solution : float or None
        Right value of the record's `value`; none where the input makes no sense.
    tolerance : float
        Relative error that still counts as right.
    words : tuple of str
        Texts that the message of a refusal contains: it names what is wrong.
    fast : bool
        Takes a second or two.
    """

    name: str
    run: Callable[[Path, float], dict[str, Any]]
    solution: float | None = None
    tolerance: float = 1e-3
    words: tuple[str, ...] = ()
    fast: bool = True


def run(out: Path, progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """Run all hard cases, the fast ones where `quick`; see `myork.bench` for the result."""
    chosen = [case for case in cases() if case.fast or not quick]
    records = []
    for number, case in enumerate(chosen):
        progress(f"case {number + 1}/{len(chosen)}  {case.name}")
        records.append(run_case(case, 60.0 if quick else 300.0))
    head = ["case", "verdict", "outcome", "error", "iterations", "J", "solver", "s", "message"]
    rows = [
        [
            record["name"],
            record["verdict"],
            outcome_text(record),
            record.get("error"),
            record.get("iterations"),
            [record["min_J"], record["max_J"]] if "min_J" in record else None,
            record.get("solver", {}).get("used"),
            record["seconds"],
            record["message"][:300],
        ]
        for record in records
    ]
    count = {v: sum(r["verdict"] == v for r in records) for v in (RIGHT, EXPLAINED, WARNED)}
    return {
        "title": "Stability",
        "about": f"{len(records)} hard cases: {count[RIGHT]} right, {count[EXPLAINED]} ended with "
        f"an error that names its reason, {count[WARNED]} are off and warn that they lock, "
        f"{len(records) - sum(count.values())} none of these.",
        "cases": records,
        "tables": [{"caption": "Hard cases, one line each.", "head": head, "rows": rows}],
    }


def run_case(case: Case, limit: float) -> dict[str, Any]:
    """Run a case and judge it.

    Returns
    -------
    dict
        The record with `name`, `error` and `verdict`: `right`, `explained`, `wrong` (an answer
        that is not right), `warned` (the same, but the run warns that its form locks),
        `unexplained` (an error without what it must name), `crashed`, `failed` or `time limit`.
    """
    with tempfile.TemporaryDirectory(prefix="myork-bench-") as folder:
        record = case.run(Path(folder), limit)
    record["name"] = case.name
    if record["outcome"] in ("converged", "done"):
        value = record.get("value")
        if case.solution is None or value is None:
            record["verdict"] = "wrong"
        else:
            record["error"] = abs(value / case.solution - 1.0)
            warned = any("lock" in warning for warning in record.get("warnings", []))
            wrong = WARNED if warned else "wrong"
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


def _bulk_moduli() -> list[Case]:
    """Tube from compressible to incompressible."""
    small = ("geometry.source=[7,39]", "geometry.collocation=[13,77]", "load.steps=8")
    found = [
        Case(
            "tube, K = inf, rkcm",
            _deck("tube", "radial_stress", *small, "material.K=inf"),
            words=("material.rubber.K", "rkcm-mixed"),
        )
    ]
    for bulk in ("1e3", "1e5", "1e7", "1e10", "1e300", "inf"):
        deck = load_deck(INPUTS / "tube.toml", [])
        rubber = exact.Polynomial.from_deck(deck["material"][0], float(bulk))
        solution = float(exact.tube(rubber, 6.0, 8.0, 6.0).radial[0])
        for method in METHODS if bulk in ("1e3", "1e7") else METHODS[1:]:
            found.append(
                Case(
                    f"tube, K = {bulk}, {method}",
                    _deck("tube", "radial_stress", *small, f"material.K={bulk}", method=method),
                    solution,
                    0.01,
                    words=("load",),
                    fast=method == METHODS[1],
                )
            )
    return found


def _large_strains() -> list[Case]:
    """Homogeneous states far from rest, and the shear block."""
    rubber = exact.Polynomial.from_deck(load_deck(INPUTS / "shear_3d.toml", [])["material"][0])
    tension, compression = exact.uniaxial(rubber, 6.0), exact.uniaxial(rubber, 0.1)
    found = []
    for method in METHODS:
        found += [
            Case(
                f"shear, gamma = 5, {method}",
                _deck("shear_3d", "shear_stress", method=method),
                exact.simple_shear(rubber, 5.0),
                5e-3,
            ),
            Case(
                f"tension to 6, {method}",
                _deck("uniaxial_tension", "stress", method=method),
                tension,
                1e-5,
            ),
            Case(
                f"tension to 6 in one step, {method}",
                _deck("uniaxial_tension", "stress", "load.steps=1", method=method),
                tension,
                1e-5,
            ),
            Case(
                f"compression to 0.1, {method}",
                _deck("uniaxial_compression", "stress", method=method),
                compression,
                1e-5,
                fast=False,
            ),
        ]
    return found


def _muscle_loads() -> list[Case]:
    """Activation in one step; active stress far above the passive stiffness."""
    small = ("geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "load.steps=1")
    found = []
    for method in METHODS:
        for what, overrides in (
            ("full activation in one step", ()),
            ("active stiffness above passive", ("material.sigma_max=300",)),
        ):
            deck = load_deck(INPUTS / "muscle_block.toml", overrides)
            found.append(
                Case(
                    f"{what}, {method}",
                    _deck("muscle_block", "stress_zz", *small, *overrides, method=method),
                    along_fibers(deck["material"][0], 1.0, 1.0),
                    0.02,
                    fast=method == METHODS[0],
                )
            )
    return found


def _fiber_curves() -> list[Case]:
    """Stretches through all joints of the fiber curves, half activated."""
    body = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7), (1.0, 0.0, 0.0))
    found = []
    for method in METHODS:
        for curve in ("published", "smooth"):
            for stretch in (0.35, 1.7):
                settings: dict[str, Any] = {"move": stretch - 1.0, "activation": 0.5}
                settings |= {"steps": 13, "curve": curve}
                muscle = load_deck(INPUTS / "muscle_block.toml", [f"material.curve={curve!r}"])
                found.append(
                    Case(
                        f"fibers to {stretch}, {curve} curve, {method}",
                        _body(body, method=method, **settings),
                        along_fibers(muscle["material"][0], stretch, 0.5),
                        1e-4,
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
    solution = _rubber_tension(1.2)
    return [
        Case(f"{name}, {method}", _body(body, method=method), solution, 1e-4, words=("point",))
        for name, body in bodies.items()
        for method in METHODS
    ] + [
        Case(
            "points graded 1 : 37, supports all alike",
            _body(replace(graded(cube, 3.0), spacing=cube.spacing)),
            solution,
            1e-4,
            words=("point", "support"),
        )
    ]


def _bad_points() -> list[Case]:
    """Points that cannot carry an approximation, or a body that nothing holds."""
    cube = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7))
    twice = replace(cube, source=np.vstack([cube.source, cube.source[10:11]]))
    points = np.vstack([cube.points, cube.points[100:101]])
    place = replace(
        cube,
        points=points,
        centre=points,
        label=np.append(cube.label, 1).astype(np.int32),
        fiber=np.vstack([cube.fiber, cube.fiber[:1]]),
        volume=np.append(cube.volume, 1.0),
    )
    bodies = [
        # duplicates are redundant, not contradictory: the answer may be right all the same
        ("a source point twice", twice, ("point",), _rubber_tension(1.2)),
        ("a collocation point twice", place, ("point",), _rubber_tension(1.2)),
        ("one layer of points", box((1.0, 1.0, 0.2), (5, 5, 1), (9, 9, 1)), ("point",), None),
        ("an island that nothing holds", _with_island(cube), ("island",), None),
        ("a coordinate that is NaN", _spoilt(cube, "points"), ("point",), None),
        ("a source point that is NaN", _spoilt(cube, "source"), ("point",), None),
    ]
    found = [
        Case(f"{name}, {method}", _body(body, method=method), solution, 1e-4, words=words)
        for name, body, words, solution in bodies
        for method in METHODS
    ]
    for support in ("1.01", "1.6"):
        found.append(
            Case(
                f"support of {support} spacings at order 2",
                _body(cube, extra=(f"approximation.support={support}",)),
                _rubber_tension(1.2),
                1e-4,
                words=("support",),
            )
        )
    return found


def _fibers() -> list[Case]:
    """Fiber fields as images give them."""
    body = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7), (1.0, 0.0, 0.0))
    random = np.random.default_rng(3)
    flipped = body.fiber * random.choice([-1.0, 1.0], (len(body.fiber), 1))
    zero, broken, long = body.fiber.copy(), body.fiber.copy(), body.fiber.copy()
    zero[100], broken[100], long[100] = 0.0, np.nan, 3.0
    muscle = load_deck(INPUTS / "muscle_block.toml", ["material.curve='smooth'"])["material"][0]
    solution = along_fibers(muscle, 1.1, 0.2)
    settings: dict[str, Any] = {"move": 0.1, "activation": 0.2, "curve": "smooth"}
    return [
        Case(
            "fibers of random sign",
            _body(replace(body, fiber=flipped), **settings),
            solution,
            1e-6,
        ),
        Case(
            "a fiber that is NaN", _body(replace(body, fiber=broken), **settings), words=("fiber",)
        ),
        Case("a fiber of length 3", _body(replace(body, fiber=long), **settings), words=("fiber",)),
        Case(
            "a muscle point without fiber",
            _body(replace(body, fiber=zero), **settings),
            words=("fiber",),
        ),
    ]


def _images() -> list[Case]:
    """Label maps and images that are broken."""
    return [
        Case("NaN in the label map", _build("nan"), words=("labels.nii",)),
        Case("NaN in the image", _segment("nan"), words=("not finite",)),
        Case("singular affine", _build("affine"), words=("affine",)),
        Case("empty label", _build("empty"), words=("label",)),
    ]


def _too_large() -> Case:
    """More than any memory holds, refused before it is allocated."""
    large = ("geometry.source=[400,400,400]", "geometry.collocation=[799,799,799]")
    return Case(
        "64 million source points", _deck("muscle_block", "stress_zz", *large), words=("GB",)
    )


def _deck(
    name: str, probe: str, *overrides: str, method: str = "rkcm"
) -> Callable[[Path, float], dict[str, Any]]:
    """Solve an installed deck."""

    def work(folder: Path, limit: float) -> dict[str, Any]:
        return _solved(solve_case(name, [*overrides, f"scene.method={method}"], limit=limit), probe)

    return work


def _body(
    cloud: PointCloud, *, extra: tuple[str, ...] = (), **settings: Any
) -> Callable[[Path, float], dict[str, Any]]:
    """Solve a body from a model file; `settings` are those of `write_body`."""

    def work(folder: Path, limit: float) -> dict[str, Any]:
        return _solved(
            solve_case(write_body(folder, cloud, **settings), extra, limit=limit), "stress"
        )

    return work


def _solved(record: dict[str, Any], probe: str) -> dict[str, Any]:
    if "probes" in record:
        record["value"] = record["probes"][probe]
    return record


def _rubber_tension(stretch: float) -> float:
    """Stress of the rubber of `write_body`."""
    return exact.uniaxial(exact.Polynomial({(1, 0): 37.3, (2, 0): -3.1, (3, 0): 0.5}, 5e3), stretch)


def _with_island(cloud: PointCloud) -> PointCloud:
    """The same cloud with a second, free cube far away."""
    far = np.array([0.0, 0.0, 10.0])
    free = len(cloud.boundary_point)
    return replace(
        cloud,
        source=np.vstack([cloud.source, cloud.source + far]),
        points=np.vstack([cloud.points, cloud.points + far]),
        centre=np.vstack([cloud.centre, cloud.centre + far]),
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


def _build(damage: str) -> Callable[[Path, float], dict[str, Any]]:
    """Run `myork build` on a damaged label map."""

    def work(folder: Path, limit: float) -> dict[str, Any]:
        data = np.zeros((12, 12, 8), np.float32 if damage == "nan" else np.int16)
        if damage != "empty":
            data[2:10, 2:10, :] = 1
        if damage == "nan":
            data[5, 5, 4] = np.nan
        _write_image(folder / "labels.nii.gz", data, singular=damage == "affine")
        deck = folder / "body.toml"
        deck.write_text(_BUILD_DECK, encoding="utf-8")
        return _station("build", deck, limit)

    return work


def _segment(damage: str) -> Callable[[Path, float], dict[str, Any]]:
    """Run `myork segment` on a damaged image."""

    def work(folder: Path, limit: float) -> dict[str, Any]:
        data = np.random.default_rng(1).uniform(100.0, 110.0, (12, 12, 8)).astype(np.float32)
        data[4:8, 4:8, :] -= 60.0
        if damage == "nan":
            data[5, 5, 4] = np.nan
        _write_image(folder / "anatomy.nii.gz", data, singular=False)
        deck = folder / "body.toml"
        deck.write_text(_SEGMENT_DECK, encoding="utf-8")
        return _station("segment", deck, limit)

    return work


_HEAD = """\
title = "Damaged images"
[units]
force = "N"
length = "cm"
[scene]
dimension = 3
"""
_BUILD_DECK = _HEAD + '[build]\nlabels = "labels.nii.gz"\n'
_SEGMENT_DECK = _HEAD + '[image]\nanatomy = "anatomy.nii.gz"\nlabel = "muscle"\nphase = "dark"\n'


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


def _station(name: str, deck: Path, limit: float) -> dict[str, Any]:
    """One station of the pipeline as a record; it has no value to be right about."""
    words: list[str | Path] = [
        sys.executable,
        "-m",
        "myork",
        name,
        deck,
        "--out",
        deck.parent / "out",
        "-q",
    ]
    return run_command(words, limit)._asdict()
