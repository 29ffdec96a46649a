"""What shows in a minute that an installation works: known answers, threads, files, programs."""

import importlib.metadata
import os
import platform
import re
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

import myork
from myork.console import ProgressCallback, silent
from myork.core.scene import Scene
from myork.errors import InputError, MyorkError
from myork.files import INPUTS, write_json
from myork.report import make_report
from myork.results import Results
from myork.stations.check import Check, Checks, check_deck
from myork.stations.new import new_deck
from myork.stations.solve import find_executable, run_deck

#: Its solution is known: an eighth of a bar stretched to six times its length
_BAR = INPUTS / "uniaxial_tension.toml"
#: Displacement of the patch tests at a point X is this times X
_SLOPE = np.array([[0.10, 0.05, -0.02], [0.04, -0.06, 0.03], [-0.03, 0.02, 0.05]])
#: Rounding times the bulk modulus over the shear modulus stays far below
_PATCH = 1e-10
#: The stress of the bar is its series in 1/K, cut off behind this
_EXACT = 1e-8
#: Two programs that follow the same path differ by rounding
_SAME = 1e-10
_LIBRARIES = re.compile(
    r"(/\S*/lib(?:openblas|blas|lapack|gomp|gfortran|spqr|cholmod|umfpack|hdf5)[^/\s]*)"
)
_PACKAGES = ("numpy", "scipy", "h5py", "nibabel", "matplotlib")


def run_selftest(
    out: str | Path | None = None, *, progress: ProgressCallback = silent
) -> list[Check]:
    """Check an installation: nothing but the package is needed.

    - `out`: folder that keeps what the checks wrote and `selftest.json`; default none
    - `progress`: called with a line a version, a library and a check
    - returns what was found; none has failed where the installation works
    """
    begin = time.perf_counter()
    with _folder(out) as folder:
        facts = _facts()
        for name, value in facts.items():
            for place, line in enumerate(value.split("\n")):
                progress(f"{'' if place else name:<22} {line}")
        found = Checks(
            progress, MyorkError, OSError, ImportError, ArithmeticError,
            detail=lambda reason: f"{type(reason).__name__}: {reason}",
        )  # fmt: skip
        for method in ("rkpm-gauss", "rkpm-scni", "rkcm-mixed"):
            found.note(f"patch, {method}", _patch, method)
        found.note("sparse solvers", _sparse)
        answers: dict[str, Any] = {}
        found.note("known answer", _known, folder / "bar", answers)
        found.note("both programs", _both, answers)
        found.note("results and report", _files, folder / "bar")
        deck = folder / "muscle.toml"
        deck.unlink(missing_ok=True)
        found += check_deck(new_deck("muscle", deck), progress=progress)
        seconds = time.perf_counter() - begin
        failed = [check.name for check in found if check.passed is False]
        progress(
            f"{len(found)} checks in {seconds:.0f} s: "
            + (f"{len(failed)} failed: {', '.join(failed)}" if failed else "the installation works")
        )
        if out is not None:
            content = {"facts": facts, "checks": [check._asdict() for check in found]}
            write_json(folder / "selftest.json", content)
    return found


@contextmanager
def _folder(out: str | Path | None) -> Iterator[Path]:
    if out is None:
        with tempfile.TemporaryDirectory(prefix="myork-selftest-") as folder:
            yield Path(folder)
    else:
        Path(out).mkdir(parents=True, exist_ok=True)
        yield Path(out)


def _facts() -> dict[str, str]:
    """Versions, threads and libraries: what a report of a fault needs."""
    executable = find_executable()
    facts = {
        "myork": f"{myork.__version__} in {Path(__file__).parent}",
        "myork-solve": f"{_said(executable, '--version').split()[-1]} in {executable}",
        "Python": f"{platform.python_version()} in {sys.executable}",
        "system": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "packages": ", ".join(f"{n} {importlib.metadata.version(n)}" for n in _PACKAGES),
        "threads": ", ".join(
            f"{name}={os.environ.get(name, 'not set')}"
            for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "OMP_WAIT_POLICY")
        ),
    }
    loaded = Path("/proc/self/maps")
    own = loaded.read_text(encoding="utf-8") if loaded.exists() else ""
    # a repaired wheel has the program beside the package and a launcher in its place
    repaired = Path(__file__).parents[1] / "myork.scripts" / executable.name
    program = repaired if repaired.is_file() else executable
    # the loader lists instead of running it
    listed = _said(program, LD_TRACE_LOADED_OBJECTS="1")
    for name, text in (("libraries of Python", own), ("of myork-solve", listed)):
        facts[name] = "\n".join(sorted(set(_LIBRARIES.findall(text)))) or "not known"
    return facts


def _said(program: Path, *arguments: str, **environment: str) -> str:
    """What a program prints."""
    done = subprocess.run(
        [program, *arguments],
        env={**os.environ, **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )
    return done.stdout


def _patch(method: str) -> tuple[bool, str]:
    """A linear displacement on the whole surface must fill the body."""
    body = 5 if method == "rkcm-mixed" else 4
    tables: dict[str, Any] = {
        "scene": {"dimension": 3, "method": method},
        "geometry": {
            "kind": "box",
            "size": [1, 1, 1],
            "source": [body] * 3,
            "collocation": [body + 1] * 3,
        },
        "material": [{"name": "rubber", "model": "neo-hookean", "mu": 10, "K": 1e3}],
        "boundary": [
            {"set": f"{axis}{end}", "u_x": 0, "u_y": 0, "u_z": 0} for axis in "xyz" for end in "01"
        ],
        "load": {"steps": 1},
        "solver": {"tolerance": 1e-10},
    }
    with Scene.from_tables(tables) as scene:
        x = scene.field_points()
        scene.set_fields(np.zeros_like(x), x @ _SLOPE.T, np.zeros((len(x), 3, 3)))
        states = scene.solve(error=False)
        exact = scene.points() @ _SLOPE.T
        u = scene.fields(states.x[-1], 1.0).u
    error = float(np.abs(u - exact).max() / np.abs(exact).max())
    return error < _PATCH, f"a linear displacement is off by {error:.1e} (at most {_PATCH:.0e})"


def _sparse() -> tuple[bool | None, str]:
    """SuiteSparse is there, and agrees with LAPACK; a build may leave it out."""
    answer = {}
    for solver in ("normal", "sparse-normal", "spqr"):
        changes = [f"solver.linear={solver}", "geometry.source=[5,3,3]", "load.steps=2"]
        with Scene(_BAR, [*changes, "geometry.collocation=[9,5,5]", "material.K=1e4"]) as scene:
            try:
                answer[solver] = scene.solve(error=False).x[-1]
            except InputError as reason:
                return None, str(reason)
    size = np.linalg.norm(answer["normal"])
    error = max(float(np.linalg.norm(x - answer["normal"]) / size) for x in answer.values())
    return error < 1e-6, f"SuiteSparse and LAPACK agree to {error:.1e}"


def _known(folder: Path, answers: dict[str, Any]) -> tuple[bool, str]:
    """The executable finds the stress of a bar whose solution is known."""
    answers |= run_deck(_BAR, folder, verbosity=-1)
    found = answers["exact"]["stress"]
    error = float(found["relative_error"])
    return error < _EXACT, (
        f"stress at six times the length {found['value']:.9g}, exact {found['reference']:.9g}, "
        f"off by {error:.1e} (at most {_EXACT:.0e})"
    )


def _both(answers: dict[str, Any]) -> tuple[bool, str]:
    """The extension gives the executable's numbers."""
    with Scene(_BAR) as scene:
        states = scene.solve(error=False)
        value = float(scene.probes(states.x[-1:], states.load[-1:])[0, 0, 0])
    theirs = float(answers["steps"][-1]["probes"]["stress"])
    error = abs(value - theirs) / abs(theirs)
    return error < _SAME, f"extension and executable agree to {error:.1e} (at most {_SAME:.0e})"


def _files(folder: Path) -> tuple[bool, str]:
    """h5py reads what the executable wrote, and the report has its figures."""
    with Results(folder) as results:
        steps, points = results.nstep, results.npoint
        whole = bool(np.isfinite(results.field("u", step=-1)).all())
    size = make_report(folder).stat().st_size
    good = whole and steps > 1 and size > 10_000
    return good, f"{steps} steps of {points} points, a page of {size / 1e3:.0f} kB"
