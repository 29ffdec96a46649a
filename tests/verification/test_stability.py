"""Hard cases: each ends in the right answer or in an error that says what to do.

A case is one run of a program in a process of its own, under a time limit. What counts as wrong is
an answer that is off and does not say so, a crash, and a run without an end. An error of more than
twice what it was before counts as worse. The volume ratio is judged beside the probes, in the mean
over the body: J has no limit at the end of a held face. A field of J that is off is said by a
warning; an answer that a deck asks for, a probe of J among them, by the verdict.

    python tests/verification/test_stability.py

prints those that end otherwise than known and how many end in which way, and writes each case to
`docs/results/hard_cases.md` and the errors by which later ones are judged to
`tests/verification/hard_measured.json`: look at them before they are committed.
"""

import json
import math
import sys
from dataclasses import replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks import runs
from benchmarks.problems import BY_NAME
from benchmarks.runner import sized_tables, solve_rivals
from benchmarks.runs import METHODS, solve_case
from benchmarks.truths import exact
from benchmarks.truths.bodies import box, graded, stretched
from benchmarks.truths.exact import along_fibers
from benchmarks.truths.manufactured import PROBLEMS
from benchmarks.truths.manufactured import solve as solve_manufactured
from myork.bench.machine import machine
from myork.bench.materials import RUBBER
from myork.bench.runs import lattice, read_deck
from myork.console import silent
from myork.results import Results

pytestmark = pytest.mark.nightly

#: A hang, not a measurement [s]
PATIENCE = 120.0
#: Ends: the answer is right and accepted; it is refused or not reached, and the message says why;
#: it is right and the run doubts it; it is off and the run says so
RIGHT, EXPLAINED, DOUBTED, WARNED = "right", "explained", "right, doubted", "off, warned"
#: All forms, the collocations first
FORMS = (*METHODS, "rkpm-gauss", "rkpm-scni")
WEAK = FORMS[2:]
#: What is written down of earlier runs: errors of probes and of J by case
MEASURED = Path(__file__).with_name("hard_measured.json")
#: What iterations leave of a homogeneous state: `solver.tolerance`
ITERATED = 1e-6
#: Error that a user who says nothing asks for: the default of `accuracy`
ASKED = 0.02
#: Error up to which an answer counts as right beside the limit of finite elements, which are
#: themselves some per mille off: that of docs/verdict.md
BESIDE = 0.05
#: Bounds of a homogeneous state
HOMOGENEOUS: Any = {"tolerance": ITERATED, "stray": ITERATED}


class Case(NamedTuple):
    """Deck, overrides and points; what is right, how near, and what a run that is not must say.

    `right` are values of probes, `rival` a problem of benchmarks whose right values finite elements
    give; without either the run must be refused. `volume` is the range of J of the right answer at
    full load, and `stray` by how much J may leave it, root mean square over the places of output.
    `words` stand in the message of a refusal or the reasons of a doubt. `expected` is the end,
    `RIGHT` or `EXPLAINED` by itself, and `why` says why it is neither. `manufactured` are a problem
    with a chosen solution and its form.
    """

    name: str
    deck: Any = ""
    overrides: tuple[str, ...] = ()
    cloud: Any = None
    right: Any = {}
    rival: str = ""
    tolerance: float = ASKED
    volume: tuple[float, float] = (1.0, 1.0)
    stray: float = BESIDE
    words: tuple[str, ...] = ()
    expected: str = ""
    why: str = ""
    manufactured: Any = None

    @property
    def wanted(self) -> str:
        return self.expected or (RIGHT if self.right or self.rival else EXPLAINED)

    def ends(self, expected: str, why: str, *words: str) -> "Case":
        """The same with another end."""
        return self._replace(expected=expected, why=why, words=words)


# ---- judgement -----------------------------------------------------------------------------------


@cache
def measured() -> Any:
    return json.loads(MEASURED.read_text(encoding="utf-8"))


def bound(case: Case, what: str) -> float:
    """Twice the `error`, `stray` or `way` that was measured, which is what twice the spacing costs
    at first order; not below what iterations leave. It finds what gets worse within the bounds of
    the case, which hold besides. A case that was not measured is new, and judged by these only.
    """
    known = measured().get(case.name, {})
    return max(2.0 * known.get(what, 0.0), ITERATED) if known else math.inf


def volume_error(case: Case, j: Any) -> float:
    """Root mean square of what volume ratios leave the right range of a case by."""
    low, high = case.volume
    return float(np.sqrt(np.mean((np.minimum(j - low, 0.0) + np.maximum(j - high, 0.0)) ** 2)))


def judge(case: Case, record: dict[str, Any]) -> str:
    """How a run ended: one of the four ends; `wrong`, an answer that is off and accepted; `worse`,
    one whose error is more than twice what it was; `unexplained`, an end without what it must
    name; or the outcome of a run that crashed, failed or has no end.

    A record has `stray` where J is known (`volume_error`). One that converged gets `error`, the
    largest of its probes, with that probe's name as `worst`, and `way`: the largest J by which it
    leaves the range and rest, in any state.
    """
    outcome = record["outcome"]
    reasons = (record.get("verdict") or {}).get("reasons", [])
    warned = [text for text in record.get("warnings", []) if text.startswith("J at points")]
    said = " ".join([record["message"], *reasons, *warned])
    named = bool(said) and all(word in said for word in case.words)
    if outcome in ("refused", "not converged"):
        return EXPLAINED if named else "unexplained"
    if outcome not in ("converged", "done"):
        return str(outcome)
    accepted = (record.get("verdict") or {}).get("state", "accepted") == "accepted"
    if "error" not in record:
        errors = errors_of(case, record.get("probes", {}))
        if not errors:
            # an answer to what has none
            return "wrong" if accepted else EXPLAINED if named else "unexplained"
        # what is not a number is no right answer
        errors = {name: e if math.isfinite(e) else math.inf for name, e in errors.items()}
        record["worst"] = max(errors, key=lambda name: errors[name])
        record["error"] = errors[record["worst"]]
    if "max_J" in record:
        low, high = case.volume
        record["way"] = max(min(low, 1.0) - record["min_J"], record["max_J"] - max(high, 1.0), 0.0)
    if record["error"] > case.tolerance or record.get("stray", 0.0) > case.stray:
        said = not accepted or (bool(warned) and record["error"] <= case.tolerance)
        return "wrong" if not said else WARNED if named else "unexplained"
    if any(record.get(what, 0.0) > bound(case, what) for what in ("error", "stray", "way")):
        return "worse"
    return RIGHT if accepted else DOUBTED if named else "unexplained"


@cache
def truths_of(name: str) -> Any:
    """Right values by two meshes of finite elements."""
    problem = BY_NAME[name]
    return solve_rivals(problem._replace(elements=problem.elements[:2]), silent)[0]


def errors_of(case: Case, probes: dict[str, float]) -> dict[str, float]:
    """Relative errors of the probes whose values are known."""
    if case.rival:
        return dict(truths_of(case.rival).errors(probes, {})["error"])
    return {name: abs(probes[name] / value - 1.0) for name, value in case.right.items()}


# ---- exact answers: bulk moduli, large strains, muscle loads, fiber curves -----------------------

CORNERS = (
    "J strays at the corners between held and free faces, which are singular; J = det F multiplies "
    "an error of F by |F| |F^-T|, which is 29 at this shear"
)
TORN = (
    "the tension is 700 times the shear modulus, where rubber has cavities from 2.5 times it on "
    "(doi:10.1098/rspa.1959.0016), and the tangent is not positive definite"
)
ALONE = "no second solution: nodal cells need a lattice or voxels"
FREE = "J at points is free where integration cells or patches keep the volume"
UNJUDGED = "loads set point by point leave no second solution"
UNSTABLE = "the polynomial loses ellipticity at this stretch; the homogeneous answer is right"


def by(form: str) -> str:
    return f"scene.method={form}"


def bulk_moduli():
    """Tube from compressible to incompressible, four points of the deck's published weights."""
    small = (*lattice((7, 39)), "load.steps=8")
    infinite = (*small, "material.K=inf", by("rkcm"))
    yield Case("tube, K = inf, rkcm", "tube", infinite, words=("material.rubber.K", "rkcm-mixed"))
    deck = read_deck("tube")
    overflows = "the square of this K overflows: the second solution ends"
    for bulk in ("1e3", "1e5", "1e7", "1e10", "1e300", "inf"):
        case = Case(
            f"tube, K = {bulk}, rkcm-mixed", "tube",
            (*small, f"material.K={bulk}", by("rkcm-mixed")),
            right={"radial_stress": exact.inner_stress(deck, float(bulk))},
            volume=tube_volume(deck, float(bulk)),
        )  # fmt: skip
        yield case.ends(DOUBTED, overflows, "no error estimate") if bulk == "1e300" else case


def tube_volume(deck, bulk):
    """Range of J of the inflated tube: deformed over undeformed rings."""
    geometry = deck["geometry"]
    inner, outer = geometry["inner_radius"], geometry["outer_radius"]
    moved = next(b["radial"] for b in deck["boundary"] if "radial" in b)
    material = exact.Polynomial.from_deck(deck["material"][0], bulk)
    place = np.linspace(inner, outer, 2001)
    found = exact.tube(material, inner, outer, moved, place)
    rings = np.diff(found.radius**2) / np.diff(place**2)
    return float(rings.min()), float(rings.max())


def swells(bulk, stress):
    """J of a bar under uniaxial tension: a third of the stress is the pressure."""
    ratio = 1.0 + stress / (3.0 * bulk)
    return ratio, ratio


def large_strains():
    """Homogeneous states far from rest, and the shear block."""
    rubber = exact.Polynomial.from_deck(read_deck("shear_3d")["material"][0])
    swollen = exact.dilation(exact.Polynomial.from_deck(read_deck("dilation")["material"][0]), 6.0)
    shear, tension = exact.simple_shear(rubber, 5.0), exact.uniaxial(rubber, 6.0)
    longer = swells(rubber.bulk, tension)
    kinds = (
        ("shear, gamma = 5", "shear_3d", (), shear, (1.0, 1.0)),
        ("tension to 6", "uniaxial_tension", (), tension, longer),
        ("tension to 6 in one step", "uniaxial_tension", ("load.steps=1",), tension, longer),
        ("dilation to 6", "dilation", lattice((4, 4, 4)), swollen, (216.0, 216.0)),
    )  # fmt: skip
    for form, (name, deck, overrides, solution, volume) in product(FORMS, kinds):
        sheared = deck == "shear_3d"
        if sheared and form in WEAK:
            continue  # its field of J is off, see asked_volumes
        case = Case(
            f"{name}, {form}", deck, (*overrides, by(form)), volume=volume,
            right={"shear_stress" if sheared else "stress": solution},
            why=CORNERS if sheared and form != "rkcm" else "", **({} if sheared else HOMOGENEOUS),
        )  # fmt: skip
        torn = deck == "dilation" and form in WEAK
        yield case.ends(DOUBTED, TORN, "unstable") if torn else case


def asked_volumes():
    """J where the field of a sheared block is off: a second solution may agree on it by chance."""
    off = {"rkpm-gauss": (0.0, 0.25, 0.5), "rkpm-scni": (0.25, 0.0, 0.0)}
    for form, (x, y, z) in off.items():
        asked = ("probe.shear_stress.quantity=J", f"probe.shear_stress.point=[{x},{y},{z}]")
        case = Case(
            f"J beside the end of a sheared block, {form}", "shear_3d", (*asked, by(form)),
            right={"shear_stress": 1.0}, tolerance=BESIDE,
        )  # fmt: skip
        yield case.ends(WARNED, CORNERS, "what the pressure allows")


def softening():
    """Rubber whose stretched state is no longer the only one: homogeneous, and so still known."""
    soft = {"A20": -14.0, "A30": 0.0, "K": 1e8}
    law = exact.Polynomial.from_deck({**RUBBER, **soft})
    stress = exact.uniaxial(law, 1.6)
    words = tuple(f"material.rubber.{key}={value:g}" for key, value in soft.items())
    small = (*lattice((4, 3, 3)), "load.steps=4", "boundary.x1.u_x=2.4")
    for form in FORMS:
        case = Case(
            f"tension of softening rubber, {form}", "uniaxial_tension", (*small, *words, by(form)),
            right={"stress": stress}, volume=swells(law.bulk, stress), **HOMOGENEOUS,
        )  # fmt: skip
        yield case.ends(DOUBTED, UNSTABLE, "loses ellipticity")


def muscle_loads():
    """Activation in one step; active stress far above the passive stiffness."""
    small = (*lattice((4, 4, 7)), "load.steps=1")
    kinds = {
        "full activation in one step": (),
        "active stiffness above passive": ("material.sigma_max=300",),
    }
    off = "the stress is right; the displacements, below a hundredth of the edge, are off"
    beyond = "beyond the activation at which the material loses ellipticity"
    for form, (name, stiff) in product(("rkcm", *WEAK), kinds.items()):
        weights = runs.PUBLISHED_BLOCK if form in METHODS else ()
        law = read_deck("muscle_block", stiff)["material"][0]
        case = Case(
            f"{name}, {form}", "muscle_block", (*small, *weights, *stiff, by(form)),
            right={"stress_zz": along_fibers(law, 1.0, 1.0)},
        )  # fmt: skip
        if stiff and form == "rkpm-scni":
            case = case.ends(WARNED, beyond, "loses ellipticity")
        elif stiff and form in WEAK:
            case = case.ends(DOUBTED, beyond, "unstable")
        elif form in METHODS:
            case = case.ends(DOUBTED, off, "displacements")
        yield case


def fiber_curves():
    """Stretches through all joints of the fiber curves, half activated."""
    forms, curves = ("rkcm", "rkpm-gauss"), ("published", "smooth")
    for form, curve, stretch in product(forms, curves, (0.35, 1.7)):
        tables = stretched(method=form, move=stretch - 1.0, activation=0.5, steps=13, curve=curve)
        deck = on_lattice(tables, (4, 4, 4))
        law = deck["material"][0]
        law["fiber"] = [1, 0, 0]
        stress = along_fibers(law, stretch, 0.5)
        case = Case(
            f"fibers to {stretch}, {curve} curve, {form}", deck, right={"stress": stress},
            volume=swells(law["K"], stress), **HOMOGENEOUS,
        )  # fmt: skip
        yield case.ends(DOUBTED, UNSTABLE, "loses ellipticity") if stretch > 1 else case


# ---- clouds and lattices -------------------------------------------------------------------------


def on_lattice(tables, source, jitter=0.0):
    """The deck of a stretched box with a lattice of its own, and supports that forms choose."""
    geometry = {"kind": "box", "size": [1, 1, 1], "jitter": jitter}
    return sized_tables({**tables, "geometry": geometry, "approximation": {}}, source)


def tension(name, cloud, words=(), method="rkcm", answer=True):
    """Rubber under homogeneous tension; where there is no answer, `words` are the refusal's."""
    law = exact.Polynomial.from_deck(RUBBER)
    stress = exact.uniaxial(law, 1.2)
    return Case(
        name, stretched(method=method), cloud=cloud, right={"stress": stress} if answer else {},
        volume=swells(law.bulk, stress), words=words, **HOMOGENEOUS,
    )  # fmt: skip


def clouds():
    """Clouds that carry no approximation, under homogeneous tension; of others see test_clouds."""
    cube = box((1.0, 1.0, 1.0), (5, 5, 5), (9, 9, 9))
    sheet = box((1.0, 1.0, 0.2), (5, 5, 2), (9, 9, 3))
    alike = replace(graded(cube, 3.0), spacing=cube.spacing)
    for name, body, form, words in (
        *((f"sheet of two layers, {form}", sheet, form, ("point",)) for form in METHODS),
        ("points graded 1 : 37, supports all alike", alike, "rkcm", ("point", "support")),
        *((f"points without a lattice, {form}", cube, form, ("a model of voxels",))
          for form in WEAK),
    ):  # fmt: skip
        yield tension(name, body, words, form, answer=False)
    # accepted with 2 to 3 % of error at any number of points if it were solved
    low = ("approximation.order=1", "approximation.support=2", "geometry.jitter=0.3")
    yield Case("Poisson by functions of order 1, moved points", "poisson_1d", low, words=("order",))


def lattices():
    """Homogeneous tension on points moved off a lattice, in flat cells and in two layers."""
    for name, height, source, jitter, forms in (
        ("lattice moved by 0.4 h", 1.0, (5, 5, 5), 0.4, FORMS),
        ("cells of 1 : 20", 20.0, (5, 5, 5), 0.0, WEAK),
        ("cells of 1 : 20 moved by 0.4 h", 20.0, (5, 5, 5), 0.4, WEAK),
        ("two layers moved by 0.4 h", 0.2, (5, 5, 2), 0.4, WEAK),
    ):
        for form in forms:
            deck = on_lattice(stretched(method=form), source, jitter)
            deck["geometry"]["size"] = [1.0, 1.0, height]
            point = [0.5, 0.5, 0.5 * height]
            deck["probe"] = [{"name": "stress", "quantity": "cauchy_xx", "point": point}]
            yield tension(f"{name}, {form}", None)._replace(deck=deck)


def curved():
    """Manufactured solutions on points moved off their lattice; in the Galerkin form all held."""
    problem = PROBLEMS[0]._replace(sizes=(13,))
    around = {"order": 2, "support": 3.0, "held": ("x0", "x1", "y0", "y1")}
    for form, jitter in product(FORMS, (0.0, 0.2, 0.4)):
        weak = form in WEAK
        off = (form == "rkpm-gauss" and jitter > 0.0) or (form == "rkpm-scni" and jitter > 0.2)
        yield Case(
            f"curved solution, lattice moved by {jitter:g} h, {form}",
            overrides=(f"geometry.jitter={jitter:g}", by(form)),
            right={"u": 0.0},
            # of the chosen solution, 1 + 3 (0.4) (X - 1/2)^2; J is compared place by place
            volume=(1.0, 1.3),
            manufactured=(
                problem._replace(**(around if weak else {"order": 3, "support": 4.5})), form,
            ),
            expected=WARNED if off else DOUBTED, why=FREE if weak else UNJUDGED,
            words=("point by point",),
        )  # fmt: skip


# ---- beside finite elements: bending -------------------------------------------------------------

STRONG = "least squares of second derivatives hardly see bending (docs/theory/collocation.md)"
COARSE = "points this coarse do not resolve the stress at a point"
RIMS = "J strays where held faces end, which are singular"
CAUTION = "the answer is right, and its bar too wide to be sure of it"


def beside(name, form):
    """A problem of benchmarks with few points, moved off their lattice."""
    tables = sized_tables(BY_NAME[name].tables, (17, 5))
    tables["geometry"]["jitter"] = 0.3
    return Case(
        f"{name}, 17x5, lattice moved by 0.3 h, {form}", tables, (by(form),), rival=name,
        tolerance=BESIDE,
    )  # fmt: skip


def beams():
    """Plane beams; on lattices they are those of `myork bench trust`, as bodies in space are."""
    doubted, right = (DOUBTED, CAUTION), (RIGHT, RIMS)
    off, coarse = (WARNED, STRONG, "the stress does"), (WARNED, COARSE, "probe inside")
    for name, gauss, nodal in (
        ("cantilever, dead traction", doubted, right),
        ("clamped beam, end shear", right, coarse),
    ):
        for form, end in zip(FORMS, (off, off, gauss, nodal), strict=True):
            yield beside(name, form).ends(*end)


# ---- input that makes no sense: points, fibers, sizes --------------------------------------------


def bad_points():
    """Points that cannot carry an approximation, or a body that nothing holds."""
    cube = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7))
    bodies = {
        "one layer of points": (box((1.0, 1.0, 0.2), (5, 5, 1), (9, 9, 1)), "point"),
        "an island that nothing holds": (with_island(cube), "island"),
        "a coordinate that is NaN": (damaged(cube, "points"), "point"),
        "a source point that is NaN": (damaged(cube, "source"), "finite numbers"),
    }
    for (name, (body, word)), form in product(bodies.items(), METHODS):
        yield tension(f"{name}, {form}", body, (word,), form, answer=False)
    for support in ("1.01", "1.6"):
        name = f"support of {support} spacings at order 2"
        case = tension(name, cube, ("support",), answer=False)
        yield case._replace(overrides=(f"approximation.support={support}",))


def fibers():
    """Fiber fields as images give them."""
    body = box((1.0, 1.0, 1.0), (4, 4, 4), (7, 7, 7), (1.0, 0.0, 0.0))
    flip = np.random.default_rng(3).choice([-1.0, 1.0], (len(body.fiber), 1))
    deck = stretched(move=0.1, activation=0.2, curve="smooth")
    law = deck["material"][0]
    stress = along_fibers(law, 1.1, 0.2)
    yield Case(
        "fibers of random sign", deck, cloud=replace(body, fiber=body.fiber * flip),
        right={"stress": stress}, volume=swells(law["K"], stress), **HOMOGENEOUS,
    ).ends(DOUBTED, ALONE, "no error estimate")  # fmt: skip
    bad = {"a fiber that is NaN": np.nan, "a fiber of length 3": 3.0}
    for name, value in (bad | {"a muscle point without fiber": 0.0}).items():
        fiber = body.fiber.copy()
        fiber[100] = value
        yield Case(name, deck, cloud=replace(body, fiber=fiber), words=("fiber",))


def too_large():
    """More than any memory holds, refused before it is allocated."""
    large = (*lattice((400, 400, 400)), by("rkcm"))
    yield Case("64 million source points", "muscle_block", large, words=("GB",))


def with_island(cloud):
    """The same cloud with a second, free cube far away."""
    far = np.array([0.0, 0.0, 10.0])
    parts = ("source", "points", "label", "fiber", "volume", "normal", "area", "boundary_point")
    twice = {name: np.concatenate([getattr(cloud, name)] * 2) for name in parts}
    twice["source"][len(cloud.source) :] += far
    twice["points"][len(cloud.points) :] += far
    free = len(cloud.boundary_point)
    twice["boundary_point"][free:] += len(cloud.points)
    sets = np.append(cloud.boundary_set, np.full(free, 6, np.int32))
    return replace(cloud, **twice, boundary_set=sets, set_names=(*cloud.set_names, "island"))


def damaged(cloud, name):
    values = getattr(cloud, name).copy()
    values[len(values) // 2, 1] = np.nan
    return replace(cloud, **{name: values})


KINDS = (bulk_moduli, large_strains, asked_volumes, softening, muscle_loads, fiber_curves, clouds,
         lattices, curved, beams, bad_points, fibers, too_large)  # fmt: skip
CASES = [case for kind in KINDS for case in kind()]


# ---- tests ------------------------------------------------------------------------------------


def run_case(case: Case, limit: float) -> dict[str, Any]:
    """Record of a case with its `end`, what the run says of itself and why it ends so."""
    if case.manufactured is None:

        def look(folder: Path) -> dict[str, float]:
            with Results(folder) as results:
                return {"stray": volume_error(case, results.field("J"))}

        record = solve_case(
            case.deck, case.overrides, cloud=case.cloud, limit=limit, look=look, error=True
        )
    else:
        problem, form = case.manufactured
        record = {"seconds": 0.0}
        record |= solve_manufactured(problem, form, problem.sizes[0], case.overrides)
        if "u_error" in record:
            record |= {"error": record["u_error"], "stray": record["j_error"]}
    verdict = record.get("verdict") or {}
    texts = [*verdict.get("reasons", []), *record.get("warnings", [])]
    reported = "; ".join(dict.fromkeys(texts)) or record["message"]
    if verdict.get("state") != "accepted" and not reported:
        reported = runs.outcome_text(record)
    why, end = case.why, judge(case, record)
    if end == EXPLAINED and record["outcome"] == "refused":
        why = why or "this input has no answer: it is refused, and the message says what to change"
    return record | {"end": end, "name": case.name, "reported": reported, "why": why}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case: Case) -> None:
    record = run_case(case, PATIENCE)
    assert record["end"] == case.wanted, (
        f"{record['end']}: {record['outcome']}, error {record.get('error')}, J off by "
        f"{record.get('stray')}, at worst {record.get('way')}; {record['reported']}"
    )
    assert record["end"] == RIGHT or (record["reported"] and record["why"])
    if case.manufactured is None and "error" in record:
        assert record["worst"]


def test_no_line_is_unexplained() -> None:
    """What is neither right nor refused has a reason, as has J that strays in a right answer."""
    names = {case.name for case in CASES}
    assert len(names) == len(CASES) and measured().keys() <= names
    for case in CASES:
        assert case.wanted in (RIGHT, EXPLAINED, DOUBTED, WARNED), case.name
        assert case.why or case.wanted not in (DOUBTED, WARNED), case.name
        assert case.words or case.wanted != EXPLAINED, case.name
        # nothing is right that a user would not call right
        assert max(case.tolerance, case.stray) <= BESIDE == 0.05, case.name
        found = measured().get(case.name, {})
        # a single place may stray further than their mean may, but from twice that on with a reason
        assert case.why or found.get("way", 0.0) <= 2 * BESIDE, case.name
        if case.wanted in (RIGHT, DOUBTED):
            # without numbers of before it can get worse and nobody sees it; one by which an answer
            # that is off would be no worse is of another day
            assert found["error"] <= case.tolerance, case.name
            assert found.get("stray", 0.0) <= case.stray, case.name


def test_a_case_that_should_end_otherwise_is_found() -> None:
    some = next(case for case in CASES if case.name == "64 million source points")
    assert run_case(some, PATIENCE)["end"] == EXPLAINED != some._replace(expected=RIGHT).wanted


#: What the table of all cases calls the ends; a crash or an end without its reason has its own name
ENDS = {
    RIGHT: "right, accepted",
    DOUBTED: "right, doubted",
    WARNED: "off, and the run says so",
    EXPLAINED: "stopped with the reason",
    "wrong": "wrong and accepted",
}
PAGE = Path(__file__).parents[2] / "docs" / "results" / "hard_cases.md"


def main() -> None:
    """Run all cases, count how they end, and write them and their errors."""
    known, cases, counts = {}, [], dict.fromkeys(ENDS.values(), 0)
    for case in CASES:
        record = run_case(case, 300.0)
        if record["end"] != case.wanted:
            print(f"{case.name}: {record['end']}, not {case.wanted}: {record['reported']}")
        if "error" in record:
            kept = [what for what in ("error", "stray", "way") if what in record]
            known[case.name] = {what: float(f"{record[what]:.2g}") for what in kept}
        end = ENDS.get(record["end"], record["end"])
        counts[end] = counts.get(end, 0) + 1
        off = [f"{record[what]:.2g}" if what in record else "" for what in ("error", "stray")]
        why = "" if record["end"] == RIGHT else str(record["reported"]).replace("\n", " ")
        cases.append(f"| {case.name} | {end} | {' | '.join(off)} | {why.replace('|', '/')} |")
    rows = [f"  {json.dumps(name)}: {json.dumps(values)}" for name, values in known.items()]
    MEASURED.write_text("{\n" + ",\n".join(rows) + "\n}\n", encoding="utf-8")
    sums = [f"| {end} | {count} |" for end, count in counts.items()]
    about = machine()
    lines = [
        "# Hard cases\n",
        f"Written by `python tests/verification/test_stability.py` on {about['date'][:10]} (MyoRK "
        f"{about['version']}): {len(cases)} cases in all four forms. Error: the largest relative "
        "one of the probes; J: root mean square off its range.\n",
        *("| end | cases |", "|---|---|", *sums, ""),
        *("| case | end | error | J | what the run says |", "|---|---|---|---|---|", *cases),
    ]
    PAGE.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(sums))


if __name__ == "__main__":
    main()
