"""Random decks without points: boxes and rings of any material, with many kinds of conditions.

Finite elements give the truths, `benchmarks/truths/unseen.json`, beforehand. Numbers below
`_HELD_OUT` are for tuning; those from it on only judge the result and are not used for any choice.
From 300 on only sheets and rings have truths.
"""

from __future__ import annotations

import json
import signal
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from benchmarks.problems import Problem
from benchmarks.runner import Truth, Truths, record_of, solve_rivals
from benchmarks.runs import solve_case
from benchmarks.truths.deck_parts import deck, force, held, probe
from benchmarks.truths.finite_elements import solve_deck
from benchmarks.voxel_bodies import Body, body_cloud
from myork.bench.materials import MUSCLE
from myork.bench.runs import read_deck
from myork.console import ProgressCallback
from myork.files import write_text
from myork.types import F64

NUMBERS = range(402)
#: First number not used for tuning
_HELD_OUT = 140
#: Limits of the CPU time of a search, and of the wall time of a solve [s]
_COST, _LIMIT = 15.0, 900.0
#: CPU time after which the meshes of a deck are given up: it then has no truth [s]
_PATIENCE = 180.0
#: Elements along each edge of a solid for which stresses half-way are computed
_EVEN = (6, 8)
_SEED = 20261124
TRUTHS = Path(__file__).parent / "truths" / "unseen.json"

Rng = np.random.Generator
Parts = tuple[list[dict[str, Any]], str]
#: Name of a problem, and the function that finds the limits of its probes
Wanted = tuple[str, Callable[[], dict[str, Any]]]


def problem_of(number: int) -> Problem:
    """Random deck of a number, identical on every machine."""
    rng = np.random.default_rng([_SEED, number])
    kind = str(rng.choice(["plane", "ring", "solid"], p=[0.5, 0.2, 0.3]))
    material = random_solid(rng)
    boundary, name = _LOADS[kind](rng, 2.0 * float(material.get("A10", 0)) or 10.0)
    geometry, elements, probes = _BODIES[kind](rng, boundary)
    activation = 0.0
    if material["model"] == "muscle":
        activation = float(np.round(rng.uniform(0.02, 0.15), 3))
        angle = np.radians(rng.uniform(0, 90))
        fiber = [np.sin(angle), 0.0, np.cos(angle)] if kind == "solid" else [1.0, 0.0, 0.0]
        material["fiber"] = np.round(fiber, 4).tolist()
    title = f"{number}: {kind}, {material['model']}, {name}"
    tables = deck(title, geometry, (material,), boundary, probes, activation)
    return Problem(title, tables, ((),), elements)


def random_solid(rng: Rng) -> dict[str, Any]:
    """A solid with a shear modulus near 10, from compressible to nearly incompressible."""
    model = str(rng.choice(["neo-hookean", "mooney-rivlin", "yeoh", "polynomial", "muscle"]))
    models: dict[str, dict[str, Any]] = {
        "neo-hookean": {"mu": 10.0},
        "mooney-rivlin": {"C1": 4.0, "C2": 1.0},
        "yeoh": {"C1": 5.0, "C2": 0.5, "C3": 0.02},
        "polynomial": {"A10": 5.0, "A01": 0.0, "A20": 0.3},
        "muscle": MUSCLE,
    }
    own = models[model]
    return {"name": "m", "model": model, **own, "K": float(rng.choice([40.0, 300.0, 3e3]))}


def _box(rng: Rng, boundary: list[dict[str, Any]]) -> tuple[Any, ...]:
    """Sheet, at most twice as long as high where it may buckle."""
    length = float(rng.choice([1.0, 1.5, 2.0, 3.0]))
    _scale(boundary, length)
    size = [length, 1.0]
    count = (8, 16, 32) if length < 3 else (4, 8, 16)
    probes = [
        probe("u_end", "u_x", (0.75 * length, 0.25)),
        probe("u_side", "u_y", (0.5 * length, 1.0)),
        probe("s_middle", "cauchy_xx", (0.5 * length, 0.5)),
        probe("s_quarter", str(rng.choice(["cauchy_xy", "cauchy_yy"])), (0.25 * length, 0.25)),
        force("f_x", "x", boundary[0]["set"] if len(boundary) == 2 else "x0"),
        force("f_y", "y", boundary[0]["set"] if len(boundary) == 2 else "y0"),
    ]
    return {"kind": "box", "size": size}, tuple((round(n * length), n) for n in count), probes


def _block(rng: Rng, boundary: list[dict[str, Any]]) -> tuple[Any, ...]:
    """Cube, or a block of twice its height."""
    height = float(rng.choice([1.0, 2.0]))
    _scale(boundary, height)
    probes = [
        probe("u_side", "u_x", (1.0, 0.5, 0.5 * height)),
        probe("u_inside", "u_z", (0.5, 0.5, 0.5 * height)),
        probe("s_side", "cauchy_zz", (1.0, 0.5, 0.5 * height)),
        probe("s_middle", str(rng.choice(["cauchy_zz", "cauchy_xz"])), (0.5, 0.5, 0.5 * height)),
        force("f_x", "x", "z1"),
        force("f_z", "z", "z1"),
    ]
    if "traction" in boundary[-1]:
        probes[-2:] = [force("f_x", "x", "z0"), force("f_z", "z", "z0")]
    geometry = {"kind": "box", "size": [1.0, 1.0, height]}
    return geometry, tuple((n, n, n) for n in (2, 4, 6)), probes


def _ring(rng: Rng, boundary: list[dict[str, Any]]) -> tuple[Any, ...]:
    """Quarter ring of inner radius 1, probed anywhere and at an end.

    The nodes of its meshes, at fifths, are between the usual points, in eighths: at lines of
    symmetry and in the middle errors are smaller than elsewhere.
    """
    outer = float(rng.choice([1.25, 1.5, 2.0, 3.0]))
    _scale(boundary, outer - 1.0)
    around = {1.25: 20, 1.5: 15, 2.0: 10, 3.0: 10}[outer]

    def place(angle: int) -> list[float]:
        radius = 1.0 + (outer - 1.0) * rng.integers(1, 5) / 5
        turn = 0.5 * np.pi * angle / around
        return [float(radius * np.cos(turn)), float(radius * np.sin(turn))]

    inside = place(int(rng.integers(1, around)))
    probes = [
        probe("u_inside", str(rng.choice(["u_x", "u_y"])), inside),
        probe("u_end", "u_y", [0.0, place(around)[1]]),
        probe("s_inside", str(rng.choice(["cauchy_xx", "cauchy_xy", "cauchy_yy"])), inside),
        probe("s_end", "cauchy_xx", [0.0, place(around)[1]]),
        force("f_x", "x", boundary[-1]["set"]),
        force("f_y", "y", boundary[-1]["set"]),
    ]
    elements = tuple((n, n * around // 5) for n in (5, 10, 20, 40))
    return {"kind": "annulus", "inner_radius": 1.0, "outer_radius": outer}, elements, probes


def _scale(boundary: list[dict[str, Any]], length: float) -> None:
    """Scale displacements for a body of length one to this length, and bending loads."""
    for entry in boundary:
        for key in entry:
            if key in ("u_x", "u_y", "u_z", "radial"):
                entry[key] = float(np.round(entry[key] * length, 4))
        if "about" in entry:
            plane = len(entry["about"]) == 2
            factors = [length] * 2 if plane else [1.0, 1.0, length]
            entry["about"] = np.multiply(entry["about"], factors).tolist()
        if "traction" in entry:
            entry["traction"] = np.round(np.divide(entry["traction"], length**2), 4).tolist()


def _box_loads(nd: int, rng: Rng, shear: float) -> Parts:
    """Loads of a sheet along x, of a block along z; the other side is clamped or a mirror."""
    last = "turned" if nd == 2 else "twisted"
    way = str(rng.choice(["pulled", "sheared", "traction", "plates", last, "slipped"]))
    pull = float(rng.choice([-1, 1, 1]) * rng.uniform(0.05, 0.2))
    push = shear * rng.uniform(-0.15, 0.3, nd) * ([1.0, 1.0] if nd == 2 else [1.0, 0.0, 1.0])
    along, across = ("x", "y") if nd == 2 else ("z", "x")
    end = f"{along}1"
    far: dict[str, dict[str, Any]] = {
        "pulled": held(end, nd, **{f"u_{along}": 2.0 * abs(pull)}),
        "sheared": held(end, nd, **{f"u_{across}": 2.0 * pull}),
        "traction": {"set": end, "traction": push.tolist()},
        "plates": held(end, nd, **{f"u_{along}": pull}),
        "turned": {"set": end, "rotation": 200 * pull, "about": [1.0, 0.5]},
        "twisted": {"set": end, "rotation": 300 * pull, "axis": [0, 0, 1],
                    "about": [0.5, 0.5, 1.0]},
        "slipped": {"set": end, f"u_{along}": pull},
    }  # fmt: skip
    if way == "plates":
        near = [{"set": f"{axis}0", f"u_{axis}": 0.0} for axis in "xyz"[:nd]]
        return [*near, far[way]], way
    return [held(f"{along}0", nd), far[way]], way


def _ring_loads(rng: Rng, _: float) -> Parts:
    way = str(rng.choice(["inflated", "turned", "bent", "pressed"]))
    amount = float(rng.uniform(0.1, 0.4))
    planes = [{"set": "x0", "u_x": 0.0}, {"set": "y0", "u_y": 0.0}]
    if way == "inflated":
        return [*planes, {"set": "inner", "radial": amount}], way
    if way == "pressed":
        return [*planes, {"set": "outer", "radial": -0.5 * amount}], way
    if way == "turned":
        turn = {"set": "outer", "rotation": 30 * amount, "about": [0.0, 0.0]}
        return [held("inner", 2), turn], way
    return [held("y0", 2), held("x0", 2, u_y=-amount, u_x=0.5 * amount)], way


_LOADS: Mapping[str, Callable[[Rng, float], Parts]] = {
    "plane": partial(_box_loads, 2),
    "solid": partial(_box_loads, 3),
    "ring": _ring_loads,
}
_BODIES: Mapping[str, Callable[..., tuple[Any, ...]]] = {
    "plane": _box,
    "solid": _block,
    "ring": _ring,
}


def known(name: str, file: Path = TRUTHS) -> Truths | None:
    """Limits of finite elements, if all meshes have one."""
    entry = _stored(file).get(name)
    if not entry:
        return None
    values = {name: Truth(*pair) for name, pair in entry.items()}
    kinds = {"u": "displacement", "f": "force", "s": "stress"}
    return Truths({name: kinds[name[0]] for name in values}, values)


def _stored(file: Path) -> dict[str, Any]:
    if not file.is_file():
        return {}
    found: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
    return found


def rows(progress: ProgressCallback, quick: bool) -> list[dict[str, Any]]:
    """Solve all decks that have truths at each target error; with `quick` a few of them.

    Errors are relative to the largest of their kind, including `off`, the part beyond the doubt.
    """
    numbers = NUMBERS[:6] if quick else NUMBERS
    problems = {number: problem_of(number) for number in numbers}
    return answers(problems, TRUTHS, progress, range(_HELD_OUT, NUMBERS.stop))


def at(*accuracies: float) -> dict[str, Sequence[str]]:
    """Overrides of each target error."""
    return {f"{one:.0%}": (f"accuracy={one}", f"cost={_COST}") for one in accuracies}


_ASKED = at(0.05, 0.02, 0.01)


def answers(
    problems: Mapping[int, Problem | Body],
    file: Path,
    progress: ProgressCallback,
    others: Sequence[int],
    forms: Mapping[str, Sequence[str]] = _ASKED,
) -> list[dict[str, Any]]:
    """Rows of the problems, by number, that have truths in a file, for each form.

    - `others`: numbers not used for tuning
    - `forms`: overrides by name
    """
    found = []
    for number, problem in problems.items():
        truths = known(problem.name, file)
        if truths is None:
            continue
        cloud = body_cloud(problem, problem.sizes[0]) if isinstance(problem, Body) else None
        for form, words in forms.items():
            progress(f"{problem.name}: {form}")
            case = record_of(solve_case(problem.tables, words, cloud=cloud, limit=_LIMIT))
            found.append(
                {
                    "problem": problem.name,
                    "form": form,
                    "size": "chosen",
                    "half": "other" if number in others else "tuned",
                    **case,
                    **truths.errors(case.pop("probes"), case.pop("bars"), least=1.0),
                }
            )
    return found


def _limits(problem: Problem) -> dict[str, Any]:
    """Value of each probe and its doubt; empty if a mesh has none.

    In space, meshes are refined towards all faces, where corners are singular, and the change due
    to another grading is part of the doubt. Stresses half-way, where such meshes are coarse, are
    taken from even meshes (13.4, 13.1, 12.7 at a side where even meshes give 13.1, 12.4, 12.5).
    """
    if "solid" not in problem.name:
        truths, rivals = solve_rivals(problem, lambda line: None)
        found = [truths] if all(rival["probes"] for rival in rivals) else []
        if found and _creeps([rival["probes"] for rival in rivals]):
            return {}
    else:
        found = []
        for share, meshes in ((0.8, problem.elements), (0.6, problem.elements[-1:])):
            warp = partial(_finer_ends, np.array(problem.tables["geometry"]["size"]), share)
            truths, rivals = solve_rivals(
                problem._replace(elements=meshes), lambda line: None, warp
            )
            found += [truths] if all(rival["probes"] for rival in rivals) else []
        if len(found) < 2:
            return {}
    values = {
        name: [truth.value, truth.doubt]
        for truths in found[:1]
        for name, truth in truths.values.items()
    }
    for truths in found[1:]:
        for name, own in values.items():
            own[1] = max(own[1], abs(truths.values[name].value - own[0]))
    if len(found) > 1:
        values |= _even_stresses(problem)
    return values


def _creeps(meshes: Sequence[Mapping[str, float]]) -> bool:
    """Whether forces have no limit, as where glued corners fold: their changes do not decrease.

    A fourth mesh of deck 324 changes all probes by more than the third did.
    """
    names = [name for name in meshes[-1] if name.startswith("f_")]
    first, second = np.diff([[mesh[name] for name in names] for mesh in meshes[-3:]], axis=0)
    most = max(abs(meshes[-1][name]) for name in names)
    grown = (first * second > 0) & (abs(second) > np.maximum(0.9 * abs(first), 0.002 * most))
    return bool(grown.any())


def _even_stresses(problem: Problem) -> dict[str, list[float]]:
    """Stresses of even meshes in space; their doubt is the change due to the last mesh."""
    tables = read_deck(dict(problem.tables))
    found = [solve_deck(tables, (n, n, n))["probes"] for n in _EVEN]
    names = [name for name in found[-1] if name.startswith("s_")]
    return {name: [found[-1][name], abs(found[-1][name] - found[-2][name])] for name in names}


def _finer_ends(size: F64, share: float, nodes: F64) -> F64:
    """Nodes of a box moved towards its faces; those in the middle stay."""
    place = nodes / size
    return size * (place - share * np.sin(2 * np.pi * place) / (2 * np.pi))


def _give_up(*_: Any) -> NoReturn:
    raise TimeoutError


def fill(file: Path, problems: Sequence[Wanted]) -> None:
    """Add the limits of problems that a file lacks, each given up after `_PATIENCE`."""
    signal.signal(signal.SIGPROF, _give_up)
    for name, find in problems:
        if name in _stored(file):
            continue
        begin = time.process_time()
        signal.setitimer(signal.ITIMER_PROF, _PATIENCE)
        try:
            limits = find()
        except TimeoutError:
            limits = {}
        finally:
            signal.setitimer(signal.ITIMER_PROF, 0)
        stored = _stored(file) | {name: limits}
        lines = ",\n".join(f"{json.dumps(key)}: {json.dumps(stored[key])}" for key in stored)
        write_text(file, f"{{\n{lines}\n}}\n")
        print(f"{name}: {time.process_time() - begin:.1f} CPU s", flush=True)


def wanted(numbers: range) -> list[Wanted]:
    """Decks and their limits; those in space, which take longest, last."""
    problems = sorted(map(problem_of, numbers), key=lambda problem: "solid" in problem.name)
    return [(problem.name, partial(_limits, problem)) for problem in problems]
