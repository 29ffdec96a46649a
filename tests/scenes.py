"""Short functions for decks, the answers of a solve by name, and checks common to all forms."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.testing import assert_allclose

from benchmarks.truths.deck_parts import held
from myork import Scene
from myork.bench import materials
from myork.core.deck import table_defaults, text_of_tables
from myork.core.states import Fields, States
from myork.errors import InputError
from myork.model.cloud import build_cloud
from myork.records import Image, Labels, PointCloud
from myork.stations.explain import explain_deck
from myork.stations.solve import find_executable
from myork.types import F64

if sys.version_info >= (3, 11):
    import tomllib  # noqa: F401
else:
    from pip._vendor import tomli as tomllib  # noqa: F401

#: Rubber of the reference, with a bulk modulus that needs no special treatment
RUBBER = {**materials.RUBBER, "K": 1e3}
#: Smooth, and soft enough for all forms
MUSCLE = {**materials.MUSCLE, "K": 500.0, "curve": "smooth"}
#: Planes of symmetry at three sides of a box
PLANES = [{"set": f"{axis}0", f"u_{axis}": 0} for axis in "xyz"]
#: Approximation of a linear basis
LINEAR = {"order": 1, "support": 2.0, "kernel": "cubic"}


_BLOCK = ("geometry.source=[4,4,7]", "geometry.collocation=[7,7,13]", "load.steps=2",
          "load.activation=0.01")  # fmt: skip
#: Enough points for threads to share rows of values, and for sums of several blocks
_ROWS = ("geometry.source=[8,8,16]", "geometry.collocation=[8,8,16]", "load.steps=1",
         "load.activation=0.01")  # fmt: skip
_ORDERS = ("approximation.order=1", "approximation.support=2")
_LINEAR = (*_ORDERS, *_BLOCK)
_MIXED = ("scene.method=rkcm-mixed", "approximation.order=2", "approximation.support=3", *_BLOCK)

_BEAM = ("geometry.source=[25,7]", "geometry.collocation=[49,13]")

#: Deck and overrides of a small body for every method, and for every solver of least squares
CASES: dict[str, tuple[str, tuple[str, ...]]] = {
    "linear": ("poisson_2d", ("scene.method=rkcm", "solver.linear=dgels")),
    "linear, elastic": ("cantilever", ("scene.method=rkcm", "solver.linear=spqr", *_BEAM)),
    "linear, Gauss cells": ("poisson_2d", ("scene.method=rkpm-gauss",)),
    "linear, elastic, Gauss cells": ("cantilever", ("scene.method=rkpm-gauss", *_BEAM)),
    "mixed": ("muscle_fibers", _MIXED),
    "Gauss cells": ("muscle_fibers", ("scene.method=rkpm-gauss", *_LINEAR)),
    "Gauss cells, incompressible": (
        "uniaxial_tension",
        ("scene.method=rkpm-gauss", "material.K=inf", "load.steps=1", *_ORDERS),
    ),
    "nodal cells": ("muscle_fibers", ("scene.method=rkpm-scni", *_LINEAR)),
    "nodal cells, not formed": (
        "muscle_fibers",
        ("scene.method=rkpm-scni", "galerkin.direct_limit=0", *_LINEAR),
    ),
    "nodal cells, rows and sums shared by threads": (
        "muscle_fibers",
        ("scene.method=rkpm-scni", "galerkin.direct_limit=0", *_ORDERS, *_ROWS),
    ),
    **{
        f"displacement, {solver}": (
            "muscle_block",
            ("scene.method=rkcm", *_BLOCK, f"solver.linear={solver}"),
        )
        for solver in ("dgels", "dgelsy", "normal", "refined", "spqr")
    },
}

_LATTICE = ("geometry.source=[6,5]", "geometry.collocation=[11,9]", "load.steps=1")
_SPACE = ("geometry.source=[4,4,5]", "geometry.collocation=[7,7,9]")
_TUBE = ("geometry.source=[5,12]", "geometry.collocation=[9,24]", "approximation.support=3",
         "load.steps=1")  # fmt: skip

#: The same, and bodies on a line, in the plane and around an axis
BODIES = CASES | {
    "line": (
        "poisson_1d",
        ("scene.method=rkcm", "geometry.source=[9]", "geometry.collocation=[17]"),
    ),
    "space": ("poisson_3d", ("scene.method=rkpm-gauss", *_SPACE, *_ORDERS)),
    "plane, displacement": ("shear_2d", ("scene.method=rkcm", *_LATTICE)),
    "plane, mixed": ("shear_2d", ("scene.method=rkcm-mixed", "solver.linear=spqr", *_LATTICE)),
    "plane, Gauss cells": ("shear_2d", ("scene.method=rkpm-gauss", *_LATTICE)),
    "plane, nodal cells": ("shear_2d", ("scene.method=rkpm-scni", *_LATTICE, *_ORDERS)),
    "tube, displacement": ("tube", ("scene.method=rkcm", *_TUBE)),
    "tube, mixed": ("tube", ("scene.method=rkcm-mixed", *_TUBE)),
}


def box(*source: int, size: Any = 1.0, places: Any = None, **more: Any) -> dict[str, Any]:
    """Table `[geometry]` of a box; twice as many collocation points unless given.

    Without source points, or with `places=False`, the deck gives none of these.
    """
    size = np.broadcast_to(size, len(source) or len(size)).tolist()
    given: dict[str, Any] = {"source": list(source)} if source else {}
    if source and places is not False:
        given["collocation"] = list(places or [2 * n - 1 for n in source])
    return {"kind": "box", "size": size} | given | more


def annulus(
    *source: int, radii: tuple[float, float] = (6, 8), places: Any = None
) -> dict[str, Any]:
    """Table `[geometry]` of a quarter of an annulus."""
    table = box(*source, places=places, inner_radius=radii[0], outer_radius=radii[1])
    return {key: table[key] for key in table if key != "size"} | {"kind": "annulus"}


def scene(method: str, geometry: Mapping[str, Any], **tables: Any) -> dict[str, Any]:
    """Tables of a deck; with given points the geometry is empty, and the body three-dimensional."""
    nd = len(geometry.get("source") or geometry.get("size", "xyz"))
    return {"scene": {"dimension": nd, "method": method}, "geometry": dict(geometry)} | tables


def neo(mu: float, bulk: float, name: str = "rubber", **more: Any) -> dict[str, Any]:
    """A neo-Hookean material."""
    return {"name": name, "model": "neo-hookean", "mu": mu, "K": bulk} | more


def slip(axes: str) -> list[dict[str, Any]]:
    """Both sides normal to each of these axes stay in their planes."""
    return [{"set": f"{axis}{end}", f"u_{axis}": 0} for axis in axes for end in (0, 1)]


def loaded(
    method: str, geometry: Mapping[str, Any], material: Any, ends: str, end: Mapping[str, Any],
    *wanted: str, **tables: Any,
) -> dict[str, Any]:  # fmt: skip
    """A body of one or more materials, fixed at one set, with a condition at the other.

    Probes are those of `probes`.
    """
    deck, (first, second) = scene(method, geometry), ends.split()
    deck["material"] = [material] if isinstance(material, dict) else list(material)
    deck["boundary"] = [held(first, deck["scene"]["dimension"]), {"set": second, **end}]
    return deck | {"probe": probes(*wanted)} | tables


def gripped(
    method: str, geometry: Mapping[str, Any], material: Any, ends: str, *wanted: str, **more: Any
) -> dict[str, Any]:
    """The same, with the other set also constrained; `u_x` and so on among `more` move it."""
    moved = {key: more.pop(key) for key in ("u_x", "u_y", "u_z") if key in more}
    deck = loaded(method, geometry, material, ends, {}, *wanted)
    deck["boundary"][1] = held(ends.split()[1], deck["scene"]["dimension"], **moved)
    return deck | more


def sheared(
    nd: int, method: str, material: Mapping[str, Any] = RUBBER, n: int = 5, **tables: Any
) -> dict[str, Any]:
    """A block with a clamped end and one that is stretched and sheared.

    Displacements are exact at source points, which are also the output points.
    """
    last = "xyz"[nd - 1]
    sides = (f"{last}0", f"{last}1")
    return scene(
        method, box(*[n] * nd, size=[1, 1, 2][:nd], places=[n] * nd), approximation=LINEAR,
        material=[material], load={"steps": 1}, solver={"tolerance": 1e-10},
        boundary=[
            held(sides[0], nd), {"set": sides[1], "u_x": 0.1, f"u_{last}": 0.3},
            {"set": "x1", "traction": [0.5] * nd},
        ],
        galerkin={"gauss": 2, "essential": "transformation"},
        probe=forces(*sides),
    ) | tables  # fmt: skip


def forces(*sets: str) -> list[dict[str, Any]]:
    """Probes of the forces on sets, by the names of the sets."""
    return probes(*(f"{name} force {name}" for name in sets))


def probes(*lines: str | dict[str, Any]) -> list[dict[str, Any]]:
    """Probes as tables, or by name, quantity and location: a set, a point or none."""
    found: list[dict[str, Any]] = []
    for line in lines:
        if isinstance(line, dict):
            found.append(line)
            continue
        name, quantity, *place = line.split()
        probe: dict[str, Any] = {"name": name, "quantity": quantity}
        try:
            probe |= {"point": [float(x) for x in place]} if place else {}
        except ValueError:
            probe["set"] = place[0]
        found.append(probe)
    return found


def strip(*source: int, method: str = "auto", places: Any = None, **tables: Any) -> dict[str, Any]:
    """A strip of rubber in tension, quick to solve in any form."""
    body = box(*source, size=[2, 1], places=places)
    deck = gripped(method, body, neo(10, 1000), "x0 x1", "pull force_x x1", u_x=0.2)
    return {"title": "strip"} | deck | tables


def cantilever(method: str = "auto", *source: int, **tables: Any) -> dict[str, Any]:
    """A soft beam of 4 x 1 under a dead traction on its end.

    Its tip moves up by 0.9145, the limit of the Galerkin form (0.9017, 0.9104, 0.9132 and 0.9141 at
    17x5 to 129x33 points) and of felupe's Q2/P1.
    """
    rubber = {"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 1e3}
    return loaded(
        method, box(*(source or (17, 5)), size=[4, 1]), rubber, "x0 x1", {"traction": [0, 1]},
        "tip u_y 4 0.5", "root force x0", load={"steps": 2},
    ) | tables  # fmt: skip


#: Tip of the rubber beam: felupe's quadratic elements with projected pressure, 4, 8 and 16
#: across, extrapolated
BEAM_TIP = 1.6485


def beam(*source: int, load: float = 2.0, places: Any = None, **tables: Any) -> dict[str, Any]:
    """A rubber beam of 4 x 1 under a dead traction on its end; nothing else is specified."""
    body, end = box(*source, size=[4, 1], places=places), {"traction": [0, load]}
    return loaded("auto", body, RUBBER, "x0 x1", end, "tip u_y 4 0.5") | tables


def pushed(push: float, **tables: Any) -> dict[str, Any]:
    """A block between rollers, compressed by 43 %, and then under a transverse dead load."""
    return scene(
        "rkpm-gauss", box(9, 9), material=[neo(1.0, 33.0)],
        boundary=[*PLANES[:2], {"set": "y1", "u_y": -0.43, "amplitude": "press"},
                  {"set": "x1", "traction": [push, 0], "amplitude": "push"}],
        amplitude=[{"name": "press", "time": [0, 0.5], "value": [0, 1]},
                   {"name": "push", "time": [0, 0.5, 1], "value": [0, 0, 1]}],
    ) | {"load": {"steps": 2}} | tables  # fmt: skip


def contracting(*source: int, **tables: Any) -> dict[str, Any]:
    """A deck of a block of active muscle with inclined fibers, one end of which moves."""
    muscle = {**materials.MUSCLE, "sigma_max": 30, "fiber_angle": 20}
    return gripped(
        "rkpm-scni", box(*source, size=[1, 1, 2], places=source), muscle, "z0 z1", u_z=0.1,
        title="block", units={"force": "N", "length": "cm"}, load={"steps": 3, "activation": 0.5},
    ) | tables  # fmt: skip


class Answer(NamedTuple):
    """Result of a solve: states, probes by name of each state, fields of the last one."""

    states: States
    probes: dict[str, F64]
    bars: dict[str, F64]
    fields: Fields

    def last(self) -> dict[str, float]:
        """First component of each probe in the last state."""
        return {name: float(value[-1, 0]) for name, value in self.probes.items()}

    def ends(self) -> dict[str, F64]:
        """Each probe in the last state, shape `(3,)`."""
        return {name: value[-1] for name, value in self.probes.items()}

    def bar(self, name: str) -> float:
        """Error bar of the first component of a probe in the last state."""
        return float(self.bars[name][-1, 0])


def solved(
    deck: Mapping[str, Any] | Path | Scene, *overrides: str, cloud: PointCloud | None = None,
    error: bool = False,
) -> Answer:  # fmt: skip
    """Solve tables, a deck or an open scene; error bars only on request."""
    if isinstance(deck, Scene):
        states = deck.solve(error=error)
        names = [probe["name"] for probe in deck.deck.get("probe", [])]
        values = deck.probes(states.x, states.load) if names else np.zeros((len(states.x), 0, 3))
        bars = states.probe_errors
        return Answer(
            states,
            {name: values[:, i] for i, name in enumerate(names)},
            {name: bars[:, i] for i, name in enumerate(names)},
            deck.fields(states.x[-1], float(states.load[-1])),
        )
    if isinstance(deck, Path):
        opened = Scene(deck, overrides, threads=1)
    else:
        opened = Scene.from_tables(deck, cloud, overrides=overrides, threads=1)
    with opened:
        return solved(opened, error=error)


def refused(
    tables: Mapping[str, Any], cloud: PointCloud | None = None, overrides: Iterable[str] = ()
) -> str:
    """Error message for tables that cannot be opened."""
    return refuses(".", lambda: Scene.from_tables(tables, cloud, overrides=overrides).close())


def refuses(
    said: str, call: Callable[..., Any], *args: Any, kind: Any = InputError, **keys: Any
) -> str:
    """A call with these arguments must raise an error of one of some kinds, with this message.

    Returns the whole message.
    """
    with pytest.raises(kind, match=said) as caught:
        call(*args, **keys)
    return str(caught.value)


def deck_file(path: Path, tables: Mapping[str, Any]) -> Path:
    """Write tables as a deck."""
    path.write_text(text_of_tables(tables), encoding="utf-8")
    return path


def myork(*words: object, **more: Any) -> subprocess.CompletedProcess[str]:
    """Run the command in a separate process; `more` goes to `subprocess.run`."""
    usual: dict[str, Any] = {"capture_output": True, "text": True, "timeout": 300}
    return subprocess.run([sys.executable, "-m", "myork", *map(str, words)], **usual | more)


def execute(
    deck: Path, out: Path, *words: str, sets: Iterable[str] = (), **more: Any
) -> tuple[dict[str, Any], subprocess.CompletedProcess[str]]:
    """Run the executable on one thread; returns the summary it wrote, if any, and its output.

    `more` goes to `subprocess.run`.
    """
    overrides = [word for text in sets for word in ("--set", text)]
    done = subprocess.run(
        [str(find_executable()), str(deck), "-o", str(out), "-t", "1", *words, *overrides],
        capture_output=True, text=True, timeout=300, **more,
    )  # fmt: skip
    path = out / "summary.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {}, done


def explained(deck: Path, *overrides: str) -> str:
    """Output of `myork explain` for a deck."""
    lines: list[str] = []
    explain_deck(deck, overrides=overrides, progress=lines.append)
    return "\n".join(lines)


def rows_of(table: Path) -> list[dict[str, str]]:
    """Rows of a CSV file by the names of their columns."""
    with table.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def history(out: Path) -> list[dict[str, str]]:
    """Iterations of a run."""
    return rows_of(out / "history.csv")


def start(deck: Path, out: Path, *words: str) -> subprocess.Popen[str]:
    """The executable on one thread, with all output in one stream."""
    return subprocess.Popen(
        [find_executable(), deck, "-o", out, "-t", "1", *words],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
    )  # fmt: skip


def stop_behind(child: subprocess.Popen[str], number: int = signal.SIGKILL) -> None:
    """Stop a run as soon as it has three load steps."""
    assert child.stdout is not None
    for line in child.stdout:
        if line.startswith("step   3"):
            child.send_signal(number)
            break
    child.communicate()


def wait_for(met: Callable[[], Any]) -> None:
    """Wait for something that takes a second or two: a failure, not a measurement."""
    end = time.monotonic() + 120.0
    while not met():
        assert time.monotonic() < end
        time.sleep(0.02)


def voxels(
    data: Any, edge: Any = 10.0, unit: str = "cm", said: list[str] | None = None,
    activation: Any = None, **build: Any,
) -> PointCloud:  # fmt: skip
    """Points of a label map with voxels of given edges [mm], each a source point by default.

    `activation` is the fraction of the activation in each voxel.
    """
    affine = np.diag([*np.broadcast_to(edge, 3), 1.0])
    table = {**table_defaults("build"), "source_stride": [1] * 3, **build}
    parts = None if activation is None else Image(np.asarray(activation, float), affine)
    labels = Labels(np.asarray(data, np.int32), affine)
    cloud, warnings = build_cloud(labels, None, table, unit, "", parts)
    if said is not None:
        said += warnings
    return cloud


def staircase() -> PointCloud:
    """Voxels of unequal edges, in blocks of eight, without two of their corners."""
    data = np.ones((6, 5, 6))
    data[:2, :2, :3] = 0
    data[4:, 3:, 4:] = 0
    return voxels(data, (10.0, 8.0, 12.0), source_stride=[2] * 3)


def derivative(function: Callable[[float], Any], step: float) -> F64:
    """Derivative of a function at 0, by central differences of eighth order."""
    weights = {1: 4 / 5, 2: -1 / 5, 3: 4 / 105, 4: -1 / 280}
    total = sum(w * (function(k * step) - function(-k * step)) for k, w in weights.items())
    return np.asarray(total) / step


def check_weak_tangent(opened: Scene, symmetric: bool = True) -> None:
    """The tangent is the derivative of the forces, and symmetric as that of a gradient.

    Strains of 1e-3: truncation is below 1e-9 where the muscle's curves bend most, rounding 1e-12.
    """
    random = np.random.default_rng(11)
    x, direction, other = 0.01 * random.standard_normal((3, opened.dofs))
    _, product = opened.linearise(x, 0.6, direction)
    slope = derivative(lambda h: opened.linearise(x + h * direction, 0.6, direction)[0], 0.02)
    # entries beyond the coefficients of a pressure have a stiffness but no force
    used = (slope != 0.0) | (np.arange(len(x)) < opened.source_points * opened.dimension)
    assert_allclose(product[used], slope[used], atol=1e-8 * np.abs(slope).max())
    if symmetric:
        _, turned = opened.linearise(x, 0.6, other)
        assert abs(other @ product - direction @ turned) < 1e-11 * abs(direction @ turned)


def check_strong_rows(opened: Scene) -> None:
    """Linearised rows (5.66)-(5.70) are the derivative of the residuals (5.71)-(5.73).

    Strains of some ten per cent and their gradients, unequal everywhere. Steps of 1e-3 of the
    unknowns' size: truncation 1e-12, rounding 1e-16/1e-3 times the cancellation in the strong form.
    """
    random = np.random.default_rng(11)
    x = 0.02 * random.standard_normal(opened.dofs)
    direction = random.standard_normal(opened.dofs)
    _, product = opened.linearise(x, 0.6, direction)
    slope = derivative(
        lambda h: opened.linearise(x + h * direction, 0.6, direction, start=x)[0], 2e-5
    )
    assert abs(product).max() > 1.0
    for rows in (slice(0, None), slice(0, opened.collocation_points * opened.dimension)):
        error = np.linalg.norm(slope[rows] - product[rows])
        assert error < 1e-7 * np.linalg.norm(product[rows])
