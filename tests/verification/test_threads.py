"""One and two threads give the same bits: every method, every solver, the executable and Python.

Sums of the core run in an order that does not depend on the threads, and the libraries whose order
does (BLAS, LAPACK, SuiteSparse) are held to one thread where the core does not call them from
threads of its own. The bodies are large enough for OpenBLAS to divide their matrices when it may:
without the hold every case with a dense or sparse factor differs, between 1e-16 and 1e-10.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.scenes import CASES

#: What Python hands out of all cases, once on each number of threads
PROGRAM = """
import hashlib, json, sys
import numpy as np
from myork.core.level_sets import evolve_level_sets
from myork.core.scene import Scene
from benchmarks.truths.compiled import shape_functions
from myork.core.threads import core_threads

def digest(*arrays):
    data = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    return hashlib.sha256(data).hexdigest()

def solved(scene):
    states = scene.solve()
    fields = scene.fields(states.x[-1], 1.0)
    return states, digest(states.x, states.probe_errors, fields.u, fields.f, fields.cauchy)

def level_sets():
    rng = np.random.default_rng(1)
    disc = np.hypot(*np.mgrid[-1:1:40j, -1:1:30j]) < 0.5
    image = disc[..., None, None] + 0.1 * rng.standard_normal((40, 30, 6, 1))
    start = rng.standard_normal((*image.shape[:3], 2))
    found = (
        evolve_level_sets(
            image, np.ones(image.shape[:3]), start, spacing=(1.0, 1.0, 1.0), mu=0.01, nu=0.0,
            epsilon=0.5, dt=500.0, tolerance=1e-4, iterations=20,
            lambdas=np.ones((1, 4)), volume=volume,
        )
        for volume in (False, True)
    )
    return digest(*(array for each in found for array in each.values()))

def all_cases(threads):
    for name, (deck, overrides) in json.load(open(sys.argv[1])).items():
        with Scene(deck, overrides, threads=threads) as scene:
            states, table = solved(scene)
            yield name, table
            if name == "displacement, refined":
                scene.reduce(np.linalg.qr(states.x.T)[0])
                yield "reduced", digest(scene.solve_reduced("").x)
    rng = np.random.default_rng(2)
    yield "level sets", level_sets()
    points = rng.uniform(0, 1, (600, 3))
    shape = shape_functions(points, 0.35, points[::2], order=2)
    yield "shape functions", digest(shape.value, shape.neighbour)

for threads in (1, 2):
    with core_threads(threads):
        print(json.dumps(dict(all_cases(threads))))
"""


def run(program: str, *words: object, **environment: str) -> list[str]:
    """Lines that a program says in a process without the limits that the tests run under."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "OPENBLAS_"))}
    kept |= {"OMP_WAIT_POLICY": "passive", "PYTHONPATH": os.pathsep.join(sys.path)}
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, words)], env=kept | environment,
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_python(inputs: Path, tmp_path: Path) -> None:
    """Scenes, a reduced model, level sets and shape functions in one process."""
    cases = {name: (str(inputs / f"{deck}.toml"), more) for name, (deck, more) in CASES.items()}
    (tmp_path / "cases.json").write_text(json.dumps(cases), encoding="utf-8")
    one, two = map(json.loads, run(PROGRAM, tmp_path / "cases.json"))
    assert len(one) == len(CASES) + 3
    assert [name for name in one if one[name] != two[name]] == []


#: Scenes and a reduced model in children of a process that has used its threads
FORKS = """
import multiprocessing, os, signal, sys
import numpy as np
from myork import ReducedModel, Scene
from tests.scenes import box, gripped, neo

tables = gripped("rkpm-scni", box(5, 5, 5, places=(5, 5, 5)), neo(20, 500), "x0 x1", u_x=0.2)
scene = Scene.from_tables(tables)
rom = ReducedModel.load(sys.argv[1], threads=2)
rows = np.linspace([0.0, -0.1], [0.5, 0.1], 40)

def answers():
    with Scene.from_tables(tables) as own:
        x = [each.solve(error=False).x[-1] for each in (scene, own)]
        u = scene.fields(x[0], 1.0).u
    force = [rom.batch(rows).force, rom.solve(activation=0.3, u_z=0.05).force]
    return b"".join(np.ascontiguousarray(a).tobytes() for a in (*x, u, *force))

here = answers()

def child():
    signal.alarm(60)  # a child that waits for threads that are not there ends by this
    os._exit(0 if answers() == here else 1)

first = multiprocessing.get_context("fork").Process(target=child)
first.start()
first.join()
pid = os.fork()
if pid == 0:
    child()
second = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
assert answers() == here
print(first.exitcode, second)
"""


@pytest.mark.slow
def test_children_of_a_fork(voxel_rom: Path) -> None:
    """None of their parent's threads come along: the first parallel region waited for them."""
    assert run(FORKS, voxel_rom, OMP_NUM_THREADS="2") == ["0 0"]
