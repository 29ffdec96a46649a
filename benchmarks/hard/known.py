"""Hard cases with exact answers: bulk moduli, large strains, muscle loads, fiber curves, clouds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.hard.case import DOUBTED, FORMS, ITERATED, WARNED, Case
from benchmarks.runner import sized_tables
from benchmarks.truths.bodies import box, graded, jittered, stretched
from benchmarks.truths.manufactured import PROBLEMS
from myork.bench import exact
from myork.bench.materials import RUBBER, along_fibers
from myork.bench.runs import METHODS, PUBLISHED_BLOCK, lattice, read_deck
from myork.records import PointCloud

__all__ = ["HOMOGENEOUS", "known_cases", "swells", "tension"]

#: Bounds of a homogeneous state
HOMOGENEOUS: Any = {"tolerance": ITERATED, "stray": ITERATED}

_LOCKS = "displacements alone lock where the material hardly changes its volume"
_CORNERS = "J strays at the corners between held and free faces, which are singular"
_ALONE = "no second solution: nodal cells need a lattice or voxels"
_FREE = "J at points is free where integration cells or patches keep the volume"
_UNJUDGED = "loads set point by point leave no second solution"
_UNSTABLE = "the polynomial loses ellipticity at this stretch; the homogeneous answer is right"


def known_cases() -> list[Case]:
    """All of them."""
    return [
        *_bulk_moduli(),
        *_large_strains(),
        *_softening(),
        *_muscle_loads(),
        *_fiber_curves(),
        *_clouds(),
        *_lattices(),
        *_curved(),
    ]


def _method(name: str) -> str:
    return f"scene.method={name}"


def _bulk_moduli() -> list[Case]:
    """Tube from compressible to incompressible, four points of the deck's published weights."""
    small = (*lattice((7, 39)), "load.steps=8")
    named = ("material.rubber.K", "rkcm-mixed")
    infinite = (*small, "material.K=inf", _method("rkcm"))
    found = [Case("tube, K = inf, rkcm", "tube", infinite, words=named)]
    deck = read_deck("tube")
    for bulk in ("1e3", "1e5", "1e7", "1e10", "1e300", "inf"):
        forms = FORMS if bulk in ("1e3", "1e7") else FORMS[1:] if bulk == "inf" else FORMS[1:2]
        for form in forms:
            case = Case(
                f"tube, K = {bulk}, {form}",
                "tube",
                (*small, f"material.K={bulk}", _method(form)),
                right={"radial_stress": exact.inner_stress(deck, float(bulk))},
                volume=_tube_volume(deck, float(bulk)),
                fast=form in METHODS[1:],
            )
            if (bulk, form) == ("1e3", "rkcm"):
                why = _LOCKS
                case = case._replace(expected=WARNED, words=("do not balance",), why=why)
            elif form == "rkcm":
                case = case._replace(right={}, words=("load",), why=_LOCKS)
            elif bulk == "1e300":
                why = "the square of this K overflows: the second solution ends"
                case = case._replace(expected=DOUBTED, words=("no error estimate",), why=why)
            elif form == "rkpm-scni":
                why = "the stress at a wall with half as many points is far off: a wide bar"
                case = case._replace(expected=DOUBTED, words=("radial_stress",), why=why)
            elif form == "rkpm-gauss" and bulk in ("1e3", "1e7", "inf"):
                why = "seven points across: the wall's stress moves by 8 to 10 % from 4x20 points"
                expected = DOUBTED if bulk == "1e3" else WARNED
                case = case._replace(expected=expected, words=("radial_stress",), why=why)
            found.append(case)
    return found


def _tube_volume(deck: Mapping[str, Any], bulk: float) -> tuple[float, float]:
    """Range of J of the inflated tube: deformed over undeformed rings."""
    geometry = deck["geometry"]
    inner, outer = geometry["inner_radius"], geometry["outer_radius"]
    moved = next(b["radial"] for b in deck["boundary"] if "radial" in b)
    material = exact.Polynomial.from_deck(deck["material"][0], bulk)
    place = np.linspace(inner, outer, 2001)
    found = exact.tube(material, inner, outer, moved, place)
    rings = np.diff(found.radius**2) / np.diff(place**2)
    return float(rings.min()), float(rings.max())


def _large_strains() -> list[Case]:
    """Homogeneous states far from rest, and the shear block."""
    rubber = exact.Polynomial.from_deck(read_deck("shear_3d")["material"][0])
    swelling = read_deck("dilation")["material"][0]
    swollen = exact.dilation(exact.Polynomial.from_deck(swelling), 6.0)
    tension, compression = exact.uniaxial(rubber, 6.0), exact.uniaxial(rubber, 0.1)
    shear = exact.simple_shear(rubber, 5.0)
    kinds: tuple[tuple[str, str, tuple[str, ...], float, tuple[float, float]], ...] = (
        ("shear, gamma = 5", "shear_3d", (), shear, (1.0, 1.0)),
        ("tension to 6", "uniaxial_tension", (), tension, swells(rubber.bulk, tension)),
        (
            "tension to 6 in one step",
            "uniaxial_tension",
            ("load.steps=1",),
            tension,
            swells(rubber.bulk, tension),
        ),
        (
            "compression to 0.1",
            "uniaxial_compression",
            (),
            compression,
            swells(rubber.bulk, compression),
        ),
        ("dilation to 6", "dilation", lattice((4, 4, 4)), swollen, (216.0, 216.0)),
    )
    found = []
    for form in FORMS:
        for name, deck, overrides, solution, volume in kinds:
            sheared = deck == "shear_3d"
            found.append(
                Case(
                    f"{name}, {form}",
                    deck,
                    (*overrides, _method(form)),
                    right={"shear_stress" if sheared else "stress": solution},
                    volume=volume,
                    words=("J at points",) if sheared and "rkpm" in form else (),
                    expected=WARNED if sheared and "rkpm" in form else "",
                    why=_CORNERS if sheared and form != "rkcm" else "",
                    **({} if sheared else HOMOGENEOUS),
                    fast=deck != "uniaxial_compression" and not (sheared and "rkpm" in form),
                )
            )
    return found


def swells(bulk: float, stress: float) -> tuple[float, float]:
    """J of a bar under uniaxial tension [-], twice: a third of the stress is the pressure.

    Parameters
    ----------
    bulk, stress : float
        Bulk modulus and axial Cauchy stress.
    """
    ratio = 1.0 + stress / (3.0 * bulk)
    return ratio, ratio


def _softening() -> list[Case]:
    """Rubber whose stretched state is no longer the only one: homogeneous, and so still known."""
    soft = {"A20": -14.0, "A30": 0.0, "K": 1e8}
    law = exact.Polynomial.from_deck({**RUBBER, **soft})
    words = tuple(f"material.rubber.{key}={value:g}" for key, value in soft.items())
    small = (*lattice((4, 3, 3)), "load.steps=4", "boundary.x1.u_x=2.4")
    return [
        Case(
            f"tension of softening rubber, {form}",
            "uniaxial_tension",
            (*small, *words, _method(form)),
            right={"stress": exact.uniaxial(law, 1.6)},
            volume=swells(law.bulk, exact.uniaxial(law, 1.6)),
            **HOMOGENEOUS,
            words=("loses ellipticity",),
            expected=DOUBTED,
            why=_UNSTABLE,
        )
        for form in FORMS
    ]


def _muscle_loads() -> list[Case]:
    """Activation in one step; active stress far above the passive stiffness."""
    small = (*lattice((4, 4, 7)), "load.steps=1")
    kinds: tuple[tuple[str, tuple[str, ...]], ...] = (
        ("full activation in one step", ()),
        ("active stiffness above passive", ("material.sigma_max=300",)),
    )
    off = "the stress is right; the displacements, below a hundredth of the edge, are off"
    found = []
    for form in FORMS:
        for name, overrides in kinds:
            weights = PUBLISHED_BLOCK if form in METHODS else ()
            law = read_deck("muscle_block", overrides)["material"][0]
            case = Case(
                f"{name}, {form}",
                "muscle_block",
                (*small, *weights, *overrides, _method(form)),
                right={"stress_zz": along_fibers(law, 1.0, 1.0)},
                fast=form != METHODS[1],
            )
            stiff = bool(overrides)
            if stiff and form == "rkcm-mixed":
                why = "every fiber sits on the kink of the published passive curve"
                case = case._replace(right={}, words=("kinks", 'curve = "smooth"'), why=why)
            elif stiff and form == "rkpm-scni":
                words = ("loses ellipticity",)
                why = "beyond the activation at which the material loses ellipticity"
                case = case._replace(expected=WARNED, words=words, why=why)
            elif stiff or form not in ("rkpm-gauss", "rkpm-scni"):
                case = case._replace(expected=DOUBTED, words=("displacements",), why=off)
            found.append(case)
    return found


def _fiber_curves() -> list[Case]:
    """Stretches through all joints of the fiber curves, half activated."""
    found = []
    for form in FORMS:
        for curve in ("published", "smooth"):
            for stretch in (0.35, 1.7):
                deck = _on_lattice(
                    stretched(
                        method=form, move=stretch - 1.0, activation=0.5, steps=13, curve=curve
                    ),
                    (4, 4, 4),
                )
                deck["material"][0]["fiber"] = [1, 0, 0]
                law = deck["material"][0]
                stress = along_fibers(law, stretch, 0.5)
                case = Case(
                    f"fibers to {stretch}, {curve} curve, {form}",
                    deck,
                    right={"stress": stress},
                    volume=swells(law["K"], stress),
                    **HOMOGENEOUS,
                    fast=form in (METHODS[0], "rkpm-gauss"),
                )
                if stretch > 1:
                    words = ("loses ellipticity",)
                    case = case._replace(expected=DOUBTED, words=words, why=_UNSTABLE)
                found.append(case)
    return found


def _on_lattice(tables: dict[str, Any], source: Sequence[int], jitter: float = 0.0) -> Any:
    """The deck of a stretched box with a lattice of its own, and supports that forms choose."""
    geometry = {"kind": "box", "size": [1, 1, 1], "jitter": jitter}
    return sized_tables({**tables, "geometry": geometry, "approximation": {}}, source)


def _clouds() -> list[Case]:
    """Clouds that are not regular grids of cubes, under homogeneous tension."""
    cube = box((1.0, 1.0, 1.0), (5, 5, 5), (9, 9, 9))
    long = jittered(box((1.0, 1.0, 20.0), (5, 5, 5), (9, 9, 9)), 0.3)
    found = [
        tension(f"{name}, {method}", body, (), method=method)._replace(
            expected=DOUBTED, words=("no error estimate",), why=_ALONE
        )
        for name, body in (
            ("voxels of 1 : 20, jittered by 0.3 h", long),
            ("points graded 1 : 6", graded(cube, 1.6)),
        )
        for method in METHODS
    ]
    sheet = box((1.0, 1.0, 0.2), (5, 5, 2), (9, 9, 3))
    alike = replace(graded(cube, 3.0), spacing=cube.spacing)
    refused = [
        *((f"sheet of two layers, {form}", sheet, form, ("point",)) for form in METHODS),
        ("points graded 1 : 37, supports all alike", alike, "rkcm", ("point", "support")),
        *(
            (f"points without a lattice, {form}", cube, form, ("a model of voxels",))
            for form in FORMS[2:]
        ),
    ]
    # accepted with 2 to 3 % of error at any number of points if it were solved
    low = ("approximation.order=1", "approximation.support=2", "geometry.jitter=0.3")
    return [
        *found,
        *(
            tension(name, body, words, method=form)._replace(right={})
            for name, body, form, words in refused
        ),
        Case("Poisson by functions of order 1, moved points", "poisson_1d", low, words=("order",)),
    ]


def _lattices() -> list[Case]:
    """Homogeneous tension on points moved off a lattice, in flat cells and in two layers."""
    law = exact.Polynomial.from_deck(RUBBER)
    stress = exact.uniaxial(law, 1.2)
    swollen = swells(law.bulk, stress)
    kinds = (
        ("lattice moved by 0.4 h", (1.0, 1.0, 1.0), (5, 5, 5), 0.4, FORMS),
        ("cells of 1 : 20", (1.0, 1.0, 20.0), (5, 5, 5), 0.0, FORMS[2:]),
        ("cells of 1 : 20 moved by 0.4 h", (1.0, 1.0, 20.0), (5, 5, 5), 0.4, FORMS[2:]),
        ("two layers moved by 0.4 h", (1.0, 1.0, 0.2), (5, 5, 2), 0.4, FORMS[2:]),
    )
    found = []
    for name, size, source, jitter, forms in kinds:
        for form in forms:
            deck = _on_lattice(stretched(method=form), source, jitter)
            deck["geometry"]["size"] = list(size)
            point = [0.5, 0.5, 0.5 * size[2]]
            deck["probe"] = [{"name": "stress", "quantity": "cauchy_xx", "point": point}]
            found.append(
                Case(
                    f"{name}, {form}",
                    deck,
                    right={"stress": stress},
                    volume=swollen,
                    **HOMOGENEOUS,
                )
            )
    return found


def _curved() -> list[Case]:
    """Manufactured solutions on points moved off their lattice; in the Galerkin form all held."""
    problem = PROBLEMS[0]._replace(sizes=(13,))
    found = []
    for form in FORMS:
        weak = form not in METHODS
        own = problem._replace(
            order=2 if weak else 3,
            support=3.0 if weak else 4.5,
            held=("x0", "x1", "y0", "y1") if weak else problem.held,
        )
        for jitter in (0.0, 0.2, 0.4):
            found.append(
                Case(
                    f"curved solution, lattice moved by {jitter:g} h, {form}",
                    overrides=(f"geometry.jitter={jitter:g}", _method(form)),
                    right={"u": 0.0},
                    # of the chosen solution, 1 + 3 (0.4) (X - 1/2)^2; J is compared place by place
                    volume=(1.0, 1.3),
                    words=("point by point",),
                    expected=WARNED
                    if form == "rkpm-gauss" and jitter or form == "rkpm-scni" and jitter > 0.2
                    else DOUBTED,
                    why=_FREE if weak else _UNJUDGED,
                    manufactured=(own, form),
                )
            )
    return found


def tension(name: str, cloud: PointCloud, words: tuple[str, ...], method: str = "rkcm") -> Case:
    """Rubber under homogeneous tension.

    Parameters
    ----------
    name : str
        Of the case.
    cloud : PointCloud
        Points of the body.
    words : tuple of str
        What a refusal says.
    method : str
        Form.
    """
    law = exact.Polynomial.from_deck(RUBBER)
    stress = exact.uniaxial(law, 1.2)
    return Case(
        name,
        stretched(method=method),
        cloud=cloud,
        right={"stress": stress},
        volume=swells(law.bulk, stress),
        **HOMOGENEOUS,
        words=words,
    )
