"""Views of the runner's rows: which answers to trust, at what cost, compared with which peers."""

from __future__ import annotations

import json
import math
import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import numpy as np

from benchmarks import unseen, unseen_layers, unseen_maps
from benchmarks.page import plot, table
from benchmarks.problems import ALL, BY_NAME, Problem
from benchmarks.runner import KINDS, WRONG, Form, Truths, rows_of, solve_rivals
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.voxel_bodies import Body, voxel_by_voxel
from myork.console import ProgressCallback, silent
from myork.core.deck import deck_values, text_of_tables

Rows = Sequence[Mapping[str, Any]]

_STATES = ("accepted", "doubtful", "refused")
_FORMS: tuple[Form, ...] = (
    ("auto", ()),
    ("rkpm-scni", ("scene.method=rkpm-scni",)),
    ("rkcm-mixed", ("scene.method=rkcm-mixed",)),
    ("rkcm", ("scene.method=rkcm",)),
)
#: Limit of the difference between an answer and finite elements [-]
_NEAR = 0.01
#: Errors up to this are rounding errors [-]
_ROUNDED = 1e-9


def _of(rows: Rows, **wanted: Any) -> list[Mapping[str, Any]]:
    """Rows with these values."""
    return [row for row in rows if all(row.get(key) == value for key, value in wanted.items())]


def _mean(ratios: Sequence[float]) -> float | None:
    """Geometric mean."""
    return float(np.exp(np.mean(np.log(ratios)))) if ratios else None


def _median(values: Sequence[float]) -> float | None:
    return float(np.median(values)) if values else None


def _is_right(row: Mapping[str, Any]) -> bool:
    """Whether all probes are within 5 %, less the truth's doubt; failed solves are not."""
    return row["off"] is not None and row["off"] <= WRONG


def _wrong_and_accepted(rows: Rows) -> int:
    return sum(row["verdict"] == "accepted" and not _is_right(row) for row in rows)


def _bars(rows: Rows, start: str = "") -> tuple[int, int, Any]:
    """Number of bars that contain the error, of all bars, and 10 %, median, 90 % of bar over error.

    The ratios are taken where the error exceeds rounding and twice the truth's doubt; only probes
    whose names have this start.
    """
    pairs = [
        (row["bar"][name], row["error"][name], row["doubt"][name])
        for row in rows
        for name in row["bar"]
        if name.startswith(start)
    ]
    ratios = [bar / error for bar, error, doubt in pairs if error > max(2 * doubt, _ROUNDED)]
    spread = np.percentile(ratios, (10, 50, 90)).tolist() if ratios else [None] * 3
    return sum(error <= bar + doubt for bar, error, doubt in pairs), len(pairs), spread


def _sums(rows: Mapping[str, Any]) -> dict[str, Any]:
    return table("Sums", [{"of": name, "is": value} for name, value in rows.items()])


def _curve(problem: str, line: str, rows: Rows) -> dict[str, Any]:
    """Error over CPU time, one curve per form."""
    own = [
        {**row, "curve": row["form"]}
        for row in _of(rows, problem=problem)
        if row["cpu_s"] and row.get(f"error {line}")
    ]
    axes = ("CPU time [s]", f"relative error: {line} [-]")
    drawn = plot(f"{problem}: {line}", axes, own, "cpu_s", f"error {line}")
    return drawn | {"figure": problem}


# ---- trust, methods: every form on the problems of a new user ----------------------------


def _every_form(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = []
    for problem in ALL[:2] if quick else ALL:
        rows += rows_of(problem, _forms_of(problem), progress, sizes=1 if quick else None)[1]
    return rows


def _forms_of(problem: Problem | Body) -> Callable[[Any], Sequence[Form]]:
    """Forms of each size: collocation, whose cost grows fastest, at fewer sizes of boxes only."""
    first, last = problem.sizes[0], problem.sizes[-1]

    def forms(size: Any) -> Sequence[Form]:
        if isinstance(problem, Body):
            return _FORMS[:2] if size == first else _FORMS[:1]
        if len(problem.sizes[0]) == 3 and size == last:
            return _FORMS[:2]
        return _FORMS

    return forms


def _trust(rows: Rows) -> dict[str, Any]:
    """Which answers can be trusted, and the cost of those of `auto`."""
    own = _of(rows, form="auto")
    held, bars, (_, sharp, _) = _bars(own)
    found = _nearest(rows)
    ratios = [entry["ratio"] for entry in found if entry["ratio"]]
    judged = [row for row in rows if not row.get("rival")]
    return {
        "title": "Which answers can be trusted",
        "about": "Each problem solved by `auto` and by each other form, at three sizes, and each "
        f"voxel model at two, from label maps. An accepted answer that is more than {WRONG:.0%} "
        "off is a fault of the verdict; a failed solve counts as wrong and refused.",
        "tables": [
            _sums(
                {
                    f"wrong and accepted, of {len(judged)} answers": _wrong_and_accepted(judged),
                    f"`auto` within {_NEAR:.0%} at its finest size, of {len(found)}": sum(
                        entry["error"] <= _NEAR for entry in found
                    ),
                    f"bars of `auto` that contain the error, of {bars}": held,
                    "their median over the error": sharp,
                    f"CPU of `auto` over felupe's at no larger error, mean of {len(ratios)}": _mean(
                        ratios
                    ),
                    "answers of `auto` nearer than any mesh": len(found) - len(ratios),
                }
            ),
            table(
                "`auto` at its finest size beside the cheapest mesh with no larger error; empty "
                "where no mesh had one",
                found,
            ),
        ],
    }


def _nearest(rows: Rows) -> list[dict[str, Any]]:
    """The finest answer of `auto` to each problem and the cheapest mesh with no larger error."""
    found = []
    for problem in dict.fromkeys(row["problem"] for row in rows):
        for kind in ("displacement", "force"):
            key = f"error {kind}"
            own = [r for r in _of(rows, problem=problem, form="auto") if r[key] is not None]
            if not own:
                continue
            best, meshes = own[-1], _of(rows, problem=problem, rival=True)
            times = [m["cpu_s"] for m in meshes if m[key] is not None and m[key] <= best[key]]
            peer = min(times, default=None)
            found.append(
                {
                    "problem": problem,
                    "of": kind,
                    "size": best["size"],
                    "error": best[key],
                    "CPU [s]": best["cpu_s"],
                    "felupe [s]": peer,
                    "ratio": best["cpu_s"] / peer if peer and best["cpu_s"] else None,
                }
            )
    return found


def _methods(rows: Rows) -> dict[str, Any]:
    """How often each form is right and accepted, its error, and its cost."""
    heads = [f"{key}, {state}" for key in ("right", "wrong") for state in _STATES]
    counted = []
    for form, _ in _FORMS:
        own = _of(rows, form=form)
        counts = Counter(
            f"{'right' if _is_right(row) else 'wrong'}, {row['verdict']}" for row in own
        )
        kinds = {
            kind: _median([row[f"error {kind}"] for row in own if row[f"error {kind}"] is not None])
            for kind in KINDS
        }
        seconds = _mean([row["cpu_s"] for row in own if row["cpu_s"]])
        none = dict.fromkeys(heads, 0)
        counted.append({"form": form, **none, **counts, **kinds, "CPU [s]": seconds})
    return {
        "title": "Which method when",
        "about": "The rows of `trust` by form: an answer is right if all probes are within "
        f"{WRONG:.0%} of the truth. Median errors and geometric means of CPU times cover "
        "different sizes and problems, because collocation is not solved at the finest size.",
        "tables": [table("Verdicts, and median errors of the probes", counted)],
    }


# ---- certify -------------------------------------------------------------------------------------

_CERTIFIED: tuple[Form, ...] = tuple(
    (form, (f"scene.method={form}",)) for form in ("rkpm-gauss", "rkcm-mixed")
)
#: Length of a box of height 1, and its source points
_BOXES = (
    (1.5, ((9, 7), (17, 13))),
    (3.0, ((13, 5), (25, 9))),
    (6.0, ((25, 5), (49, 9))),
)
#: Load on the far end, relative to the shear modulus 10 and to the length
_LOADS: Mapping[str, Callable[[float], dict[str, Any]]] = {
    "pulled by its end": lambda length: {"u_x": 0.25 * length, "u_y": 0},
    "pressed by a traction": lambda length: {"traction": [-4.0, 0]},
    "sheared with its end upright": lambda length: {"u_x": 0, "u_y": 0.3},
    "bent by a traction": lambda length: {"traction": [0, 0.6 / length**2]},
}


def _boxes(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Boxes on which no default was chosen, clamped at one end."""
    rows: list[dict[str, Any]] = []
    for length, sizes in _BOXES[1:2] if quick else _BOXES:
        for name, load in list(_LOADS.items())[: 2 if quick else None]:
            # probes at nodes of the meshes, away from corners
            point, middle = (0.75 * length, 0.75), (0.5 * length + 0.125, 0.25)
            tables = deck(
                f"{length:g} x 1 {name}",
                {"kind": "box", "size": [length, 1.0]},
                ({"name": "soft", "model": "neo-hookean", "mu": 10.0, "K": 400.0},),
                (held("x0", 2), {"set": "x1", **load(length)}),
                (
                    *(probe(f"u_{axis}", f"u_{axis}", point) for axis in "xy"),
                    *(force(f"force_{axis}", axis, "x0") for axis in "xy"),
                    *(probe(f"cauchy_x{axis}", f"cauchy_x{axis}", middle) for axis in "xy"),
                ),
            )
            tables["load"]["steps"] = 2
            elements = tuple((round(n * length), n) for n in (8, 16, 32))
            problem = Problem(tables["title"], tables, sizes, elements)
            rows += rows_of(problem, _CERTIFIED, progress)[1]
    return [row for row in rows if not row.get("rival")]


def _certify(rows: Rows) -> dict[str, Any]:
    """Coverage and sharpness of error bars."""
    starts = {"all": "", "displacement": "u_", "force": "force_", "stress": "cauchy_"}
    shown = []
    for form, _ in _CERTIFIED:
        for kind, start in starts.items():
            held, bars, (low, median, high) = _bars(_of(rows, form=form), start)
            share = held / bars if bars else None
            shown.append(
                {"form": form, "probes": kind, "pairs": bars, "covered": share,
                 "bar over error, median": median, "10 %": low, "90 %": high}
            )  # fmt: skip
    sums = _of(shown, probes="all")
    return {
        "title": "Error bars",
        "about": "Boxes of three proportions under loads of four kinds, each at two sizes and in "
        "two forms. A probe is covered if its error is within its bar plus the uncertainty of "
        "the reference; sharpness is the bar over the error, where the error is above twice that "
        "uncertainty.",
        "coverage": {e["form"]: e["covered"] for e in sums if e["covered"] is not None},
        "sharpness": {entry["form"]: entry["bar over error, median"] for entry in sums},
        "tables": [table("Bars beside errors", shown)],
    }


# ---- unseen: random decks without points ---------------------------------------------------------


#: Groups by parts of a problem's name, title and description of each view
_GROUPS: Mapping[str, tuple[dict[str, str], str, str]] = {
    "unseen": (
        {"all": "", "sheets": ": plane, ", "rings": ": ring, ", "solids": ": solid, "},
        "Decks without points",
        "Random boxes and rings without given form or points, with a target error and "
        "15 s of CPU time; finite elements of three meshes, for rings of four, are the truth.",
    ),
    "layers": (
        {"sheets": ": (?!box, )", "boxes in space": ": box, "},
        "Bodies of two materials",
        "Random sheets whose materials meet across, along or at a corner, and boxes in space with "
        "plates, bars and blocks, anywhere between points, moduli 1:20 to 20:1; no points are "
        "given, and finite elements of two meshes fitted to the interface are the truth.",
    ),
    "maps": (
        {"maps": ""},
        "Random label maps",
        "Random ellipsoids, cylinders and spindles, whole or half, of one tissue or two, with 10 "
        "to 20 voxels across; their decks give no form, points or blocks. Finite elements of the "
        "true shape on two meshes are the truth.",
    ),
}


def _halves(rows: Rows, view: str) -> dict[str, Any]:
    """Right and wrong, accepted and doubted, by groups of bodies and by halves."""
    groups, title, about = _GROUPS[view]
    shown = []
    for name, word in groups.items():
        group = [row for row in rows if re.search(word, row["problem"])]
        for half, accuracy in product(
            ("tuned", "other"), dict.fromkeys(row["form"] for row in group)
        ):
            own = _of(group, half=half, form=accuracy)
            right = [row for row in own if _is_right(row)]
            held, bars, (_, sharp, _) = _bars(own)
            doubted = sum(row["verdict"] != "accepted" for row in right)
            shown.append(
                {
                    "bodies": name,
                    "half": half,
                    "target error": accuracy,
                    "decks": len(own),
                    "right": len(right),
                    "wrong and accepted": _wrong_and_accepted(own),
                    "right and doubted": doubted,
                    "probes": bars,
                    "covered": held / bars if bars else None,
                    "bar over error": sharp,
                    "unknowns": _median([row["unknowns"] for row in own if row["unknowns"]]),
                    "CPU [s]": _median([row["cpu_s"] for row in own if row["cpu_s"]]),
                }
            )
    return {
        "title": title,
        "about": f"{about} A probe is wrong if it is off by more than {WRONG:.0%} of the size of "
        "its kind, beyond the uncertainty of the truth. The other half was not used for tuning. "
        "Bars over errors, unknowns and CPU times are medians.",
        "tables": [table("Halves", shown)],
    }


# ---- race ----------------------------------------------------------------------------------------

#: Target errors for which the time is wanted [-]
_ERRORS = (1e-2, 1e-3, 1e-4)
_SMALLEST = 1e-6
_DEFAULT: Form = ("default", ())
_PEERS = ("felupe", "dolfinx")
_STAIRS = ((8, 1, 16), (8, 2, 16), (8, 1, 32))
#: Problems of the race
_RACE = (
    "tube", "near shear", "tube, K = 1e7", "cantilever, dead traction", "inclined block",
    "straight block", "twist", "cube between plates",
)  # fmt: skip


class _Entry(NamedTuple):
    """A problem of the race: its forms, and the kinds of probes or single probes compared."""

    problem: Problem | Body
    forms: tuple[Form, ...]
    lines: tuple[str, ...]


def _race(progress: ProgressCallback, quick: bool) -> dict[str, Any]:
    """CPU time for a target error: MyoRK and finite elements, one after the other."""
    rows: list[dict[str, Any]] = []
    races: list[dict[str, Any]] = []
    plots = []
    # felupe imports its dependencies now: that is not part of a solution
    solve_rivals(BY_NAME["tube"]._replace(elements=((1, 4),)), silent)
    for entry in _entries(quick):
        truths, own = rows_of(entry.problem, entry.forms, progress, timed=True)
        rows += own
        for line in entry.lines:
            races += _races(entry, line, own, truths)
            plots.append(_curve(entry.problem.name, line, own))
    known = [found["ratio"] for found in races if found["ratio"] is not None]
    below = sum(ratio < 1.0 for ratio in known)
    return {
        "title": "CPU time for a target error",
        "about": "Each problem solved by all programs at increasing sizes, without error bars: "
        "MyoRK and felupe in one load step, dolfinx in the fewest load steps that converge, whose "
        "time alone counts. Compilation and import are excluded. For each program the best form "
        f"is used. {_absent(rows)}The time for an error is read off the work-precision curve "
        "between the last size that misses it and the next one, so that no lucky size counts; "
        "nothing is extrapolated beyond the finest size. Errors below the uncertainty of the truth "
        "have no line.",
        "cases": rows,
        "races": races,
        "tables": [
            table(
                f"CPU time for an error: below 1 on {below} of {len(known)} lines that both reach",
                [found for found in races if found["error"] >= 2.0 * found["doubt"]],
            ),
        ],
        "plots": plots,
    }


def _absent(rows: Rows) -> str:
    """The peers that are not installed, as a sentence."""
    found = {row["outcome"] for row in rows if str(row["outcome"]).startswith("not installed")}
    return "".join(f"{name[0].upper()}{name[1:]}. " for name in sorted(found))


def cost(rows: Rows, key: str, error: float) -> float | None:
    """CPU time for an error; `None` if the finest size does not reach it.

    - `rows`: solves with `cpu_s` and errors
    - `key`: the error of a row
    - `error`: target error [-]
    """
    points = sorted(
        (float(row["cpu_s"]), max(float(row[key]), 1e-300))
        for row in rows
        if row.get("cpu_s") and row.get(key) is not None and math.isfinite(row[key])
    )
    missed = [k for k, (_, found) in enumerate(points) if found > error]
    last = max(missed, default=-1)
    if last == len(points) - 1:
        return None
    if last == -1:
        return points[0][0]
    (low, above), (high, below) = points[last : last + 2]
    share = math.log(above / error) / math.log(above / below)
    return low * (high / low) ** share


def _entries(quick: bool) -> Iterator[_Entry]:
    """Problems of `trust` at the sizes of the race; the bar is only twisted by 90 degrees."""
    for name in _RACE[: 2 if quick else None]:
        problem = BY_NAME[name]
        lines, sizes, meshes = problem.race
        problem = problem._replace(
            sizes=sizes[1:4] if quick else sizes, elements=meshes[:4] if quick else meshes
        )
        if name == "twist":
            ends = [
                {**end, "rotation": 90.0} if "rotation" in end else end
                for end in problem.tables["boundary"]
            ]
            tables = {**problem.tables, "boundary": ends}
            problem = problem._replace(name="torsion by 90 degrees", tables=tables)
        # the order that is not the default
        order = 1 if problem.tables["geometry"]["kind"] == "annulus" else 2
        forms: list[Form] = [_DEFAULT, (f"order {order}", (f"approximation.order={order}",))]
        sides = _graded_sides(problem.tables)
        if sides:
            forms.append(("graded", (f"geometry.graded={json.dumps(sides)}",)))
        yield _Entry(problem, tuple(forms), lines)
    if not quick:
        # the map itself is 4 % off the true shape, which no code that reads it can correct
        body = voxel_by_voxel(BY_NAME["three tissues of voxels"], 0.5, _STAIRS)
        yield _Entry(body, (_DEFAULT, ("blocks", ("geometry.blocks=[4,2,8]",))), ("force",))


def _graded_sides(tables: Mapping[str, Any]) -> Any:
    """Sides towards which the points of a deck are refined by default."""
    body = {k: v for k, v in tables["geometry"].items() if k not in ("source", "collocation")}
    deck = deck_values("tables", text_of_tables({**tables, "geometry": body}), (), "solve")
    return deck["geometry"].get("graded")


def _races(entry: _Entry, line: str, rows: Rows, truths: Truths) -> Iterator[dict[str, Any]]:
    """Times for each error that the truth can resolve."""
    key = f"error {line}"
    doubt = max(
        truth.doubt / abs(truth.value)
        for name, truth in truths.values.items()
        if line in (name, truths.kinds[name])
    )
    # elements of another kind share no error with those of the truth: half of the difference
    others = [_of(rows, rival=True, form=form) for form in ("dolfinx Q2/P1", "dolfinx Q3/P2")]
    finest = [found[-1] for form in others if (found := [row for row in form if row.get(key)])]
    doubt = max(doubt, 0.5 * min((row[key] for row in finest), default=0.0))
    smallest = (_SMALLEST,) if line == "force" and "tube" in entry.problem.name else ()
    for error in (*_ERRORS, *smallest):
        rivals = {
            form: cost(_of(rows, rival=True, form=form), key, error)
            for form in dict.fromkeys(row["form"] for row in _of(rows, rival=True))
        }
        times = {form: seconds for form, seconds in rivals.items() if seconds}
        program = min(times, key=lambda form: times[form], default=None)
        peer = times[program] if program else None
        least = {
            name: min((t for form, t in times.items() if form.startswith(name)), default=None)
            for name in _PEERS
        }
        costs = {name: cost(_of(rows, form=name), key, error) for name, _ in entry.forms}
        own = {name: seconds for name, seconds in costs.items() if seconds}
        best = min(own, key=lambda name: own[name], default=None)
        known = error >= 2.0 * doubt
        reached = {(1, 1): "both", (1, 0): "MyoRK only", (0, 1): "peer only"}
        yield {
            "problem": entry.problem.name,
            "line": line,
            "error": error,
            "doubt": doubt,
            "method": best if known else None,
            "cpu_s": own[best] if best and known else None,
            "peer": program if known else None,
            "peer_cpu_s": peer if known else None,
            "ratio": own[best] / peer if best and peer and known else None,
            "outcome": reached.get((bool(own), bool(peer)), "neither")
            if known
            else "truth not known so well",
            **{f"{name} [s]": seconds if known else None for name, seconds in least.items()},
        }


# ---- all of them ---------------------------------------------------------------------------------

#: Modules of the views of random problems, whose truths are computed beforehand
RANDOM: Mapping[str, Any] = {"unseen": unseen, "layers": unseen_layers, "maps": unseen_maps}
#: Rows that a view shows, and what it makes of them; the race times them itself
PIVOTS: Mapping[str, tuple[Callable[..., Any], Callable[[Rows], dict[str, Any]] | None]] = {
    "trust": (_every_form, _trust),
    "methods": (_every_form, _methods),
    "certify": (_boxes, _certify),
    **{name: (module.rows, partial(_halves, view=name)) for name, module in RANDOM.items()},
    "race": (_race, None),
}


def view(
    name: str,
    progress: ProgressCallback,
    quick: bool,
    solved: dict[Any, Any] | None = None,
) -> dict[str, Any]:
    """A view of rows, which are solved if `solved` lacks them; see `benchmarks.bench`."""
    solve, shown = PIVOTS[name]
    solved = {} if solved is None else solved
    if solve not in solved:
        solved[solve] = solve(progress, quick)
    rows = solved[solve]
    return rows if shown is None else {"cases": rows, **shown(rows)}
