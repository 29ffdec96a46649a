"""Hard cases: each ends in the right answer, or the run says that it may be off.

A case is one run of a program in a process of its own, under a time limit. What counts as wrong is
an answer that is off and does not say so, a crash, and a run without an end. The volume ratio is
judged beside the probes, in the mean over the body: J has no limit at the end of a held face.

    python tests/verification/test_stability.py

prints those that end otherwise than known and writes all to `docs/results/hard_cases.md`.
"""

import math
import sys
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2]))

from benchmarks.runner import sized_tables
from benchmarks.truths.bodies import stretched
from benchmarks.truths.manufactured import PROBLEMS
from benchmarks.truths.manufactured import solve as solve_manufactured
from myork.bench import exact, runs
from myork.bench.machine import machine
from myork.bench.materials import RUBBER, along_fibers
from myork.bench.runs import METHODS, lattice, read_deck, solve_case
from myork.results import Results

pytestmark = pytest.mark.nightly

#: A hang, not a measurement [s]
PATIENCE = 120.0
#: Ends: the answer is right and accepted; it is right and the run doubts it; it is off and the run
#: says so
RIGHT, DOUBTED, WARNED = "right", "right, doubted", "off, warned"
#: All forms, the collocations first
FORMS = (*METHODS, "rkpm-gauss", "rkpm-scni")
WEAK = FORMS[2:]
#: What iterations leave of a homogeneous state: `solver.tolerance`
ITERATED = 1e-6
#: Error that a user who says nothing asks for: the default of `accuracy`
ASKED = 0.02
#: Error up to which a volume ratio counts as right: that of docs/verdict.md
BESIDE = 0.05
#: Bounds of a homogeneous state
HOMOGENEOUS: Any = {"tolerance": ITERATED, "stray": ITERATED}


class Case(NamedTuple):
    """Deck and overrides; what is right, how near, and what a run that is not must say.

    `right` are values of probes. `volume` is the range of J of the right answer at full load, and
    `stray` by how much J may leave it, root mean square over the places of output. `words` stand in
    the reasons of a doubt. `expected` is the end, and `why` says why it is not `RIGHT`.
    `manufactured` are a problem with a chosen solution and its form.
    """

    name: str
    deck: Any = ""
    overrides: tuple[str, ...] = ()
    right: Any = {}
    tolerance: float = ASKED
    volume: tuple[float, float] = (1.0, 1.0)
    stray: float = BESIDE
    words: tuple[str, ...] = ()
    expected: str = RIGHT
    why: str = ""
    manufactured: Any = None

    def ends(self, expected: str, why: str, *words: str) -> "Case":
        """The same with another end."""
        return self._replace(expected=expected, why=why, words=words)


# ---- judgement -----------------------------------------------------------------------------------


def volume_error(case: Case, j: Any) -> float:
    """Root mean square of what volume ratios leave the right range of a case by."""
    low, high = case.volume
    return float(np.sqrt(np.mean((np.minimum(j - low, 0.0) + np.maximum(j - high, 0.0)) ** 2)))


def judge(case: Case, record: dict[str, Any]) -> str:
    """How a run ended: one of the three ends; `wrong`, an answer that is off and accepted;
    `unexplained`, an end without what it must name; or the outcome of a run that was refused,
    crashed, failed or has no end.

    A record has `stray` where J is known (`volume_error`). One that converged gets `error`, the
    largest of its probes.
    """
    outcome = record["outcome"]
    reasons = (record.get("verdict") or {}).get("reasons", [])
    warned = [text for text in record.get("warnings", []) if text.startswith("J at points")]
    said = " ".join([record["message"], *reasons, *warned])
    named = bool(said) and all(word in said for word in case.words)
    if outcome not in ("converged", "done"):
        return str(outcome)
    accepted = (record.get("verdict") or {}).get("state", "accepted") == "accepted"
    if "error" not in record:
        probes = record.get("probes", {})
        errors = {name: abs(probes[name] / value - 1.0) for name, value in case.right.items()}
        # what is not a number is no right answer
        errors = {name: e if math.isfinite(e) else math.inf for name, e in errors.items()}
        record["error"] = max(errors.values())
    if record["error"] > case.tolerance or record.get("stray", 0.0) > case.stray:
        said = not accepted or (bool(warned) and record["error"] <= case.tolerance)
        return "wrong" if not said else WARNED if named else "unexplained"
    return RIGHT if accepted else DOUBTED if named else "unexplained"


# ---- exact answers: bulk moduli, large strains, muscle loads, fiber curves -----------------------

CORNERS = (
    "J strays at the corners between held and free faces, which are singular; J = det F multiplies "
    "an error of F by |F| |F^-T|, which is 29 at this shear"
)
TORN = (
    "the tension is 700 times the shear modulus, where rubber has cavities from 2.5 times it on "
    "(doi:10.1098/rspa.1959.0016), and the tangent is not positive definite"
)
FREE = "J at points is free where integration cells or patches keep the volume"
UNJUDGED = "loads set point by point leave no second solution"


def by(form: str) -> str:
    return f"scene.method={form}"


def bulk_moduli():
    """Tube from compressible to incompressible, four points of the deck's published weights."""
    small = (*lattice((7, 39)), "load.steps=8")
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


# ---- lattices ------------------------------------------------------------------------------------


def on_lattice(tables, source, jitter=0.0):
    """The deck of a stretched box with a lattice of its own, and supports that forms choose."""
    geometry = {"kind": "box", "size": [1, 1, 1], "jitter": jitter}
    return sized_tables({**tables, "geometry": geometry, "approximation": {}}, source)


def lattices():
    """Homogeneous tension on points moved off a lattice, in flat cells and in two layers."""
    law = exact.Polynomial.from_deck(RUBBER)
    stress = exact.uniaxial(law, 1.2)
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
            yield Case(
                f"{name}, {form}", deck, right={"stress": stress},
                volume=swells(law.bulk, stress), **HOMOGENEOUS,
            )  # fmt: skip


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


KINDS = (bulk_moduli, large_strains, asked_volumes, muscle_loads, lattices, curved)  # fmt: skip
CASES = [case for kind in KINDS for case in kind()]


# ---- tests ------------------------------------------------------------------------------------


def run_case(case: Case, limit: float) -> dict[str, Any]:
    """Record of a case with its `end`, what the run says of itself and why it ends so."""
    if case.manufactured is None:

        def look(folder: Path) -> dict[str, float]:
            with Results(folder) as results:
                return {"stray": volume_error(case, results.field("J"))}

        record = solve_case(case.deck, case.overrides, limit=limit, look=look, error=True)
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
    return record | {"end": judge(case, record), "reported": reported}


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case(case: Case) -> None:
    record = run_case(case, PATIENCE)
    assert record["end"] == case.expected, (
        f"{record['end']}: {record['outcome']}, error {record.get('error')}, J off by "
        f"{record.get('stray')}; {record['reported']}"
    )
    assert record["end"] == RIGHT or record["reported"]


def test_no_line_is_unexplained() -> None:
    """What is not right has a reason."""
    assert len({case.name for case in CASES}) == len(CASES)
    for case in CASES:
        assert case.expected == RIGHT or (case.why and case.words), case.name
        # nothing is right that a user would not call right
        assert max(case.tolerance, case.stray) <= BESIDE == 0.05, case.name


#: What the table of all cases calls the ends; a crash or an end without its reason has its own name
ENDS = {
    RIGHT: "right, accepted",
    DOUBTED: "right, doubted",
    WARNED: "off, and the run says so",
    "wrong": "wrong and accepted",
}
PAGE = Path(__file__).parents[2] / "docs" / "results" / "hard_cases.md"


def main() -> None:
    """Run all cases, count how they end, and write them."""
    cases, counts = [], dict.fromkeys(ENDS.values(), 0)
    for case in CASES:
        record = run_case(case, 300.0)
        if record["end"] != case.expected:
            print(f"{case.name}: {record['end']}, not {case.expected}: {record['reported']}")
        end = ENDS.get(record["end"], record["end"])
        counts[end] = counts.get(end, 0) + 1
        off = [f"{record[what]:.2g}" if what in record else "" for what in ("error", "stray")]
        why = "" if record["end"] == RIGHT else str(record["reported"]).replace("\n", " ")
        cases.append(f"| {case.name} | {end} | {' | '.join(off)} | {why.replace('|', '/')} |")
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
