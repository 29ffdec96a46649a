"""Ctrl-C, threads and the end of the interpreter during a solve in memory; bits on two threads."""

import hashlib
import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from benchmarks.truths.compiled import shape_functions
from myork import ReducedModel
from myork.core.calls import call_in_thread
from myork.core.level_sets import evolve_level_sets
from myork.core.scene import Scene
from myork.core.threads import core_threads
from myork.errors import StoppedError
from tests import scenes
from tests.scenes import CASES, refuses

#: Some tenths of a second in 40 steps: long enough to be interrupted at many places
LONG = scenes.strip(25, 7, method="rkcm", load={"steps": 40})


def long_scene(**changes):
    return Scene.from_tables({**LONG, **changes}, threads=1)


@pytest.fixture(scope="module")
def whole():
    """States of an undisturbed solve, and its duration."""
    with long_scene() as scene:
        started = time.perf_counter()
        states = scene.solve()
        return states, time.perf_counter() - started


@pytest.mark.slow
def test_ctrl_c_at_any_time_leaves_what_had_converged(whole):
    """At 50 places: the states before the signal are the first of the whole solve, bit by bit."""
    states, seconds = whole
    stopped = 0
    for delay in np.linspace(0.0, 0.9 * seconds, 50):
        key = threading.Timer(delay, os.kill, (os.getpid(), signal.SIGINT))
        with long_scene() as scene:
            try:
                key.start()
                scene.solve()
                key.join()
            except KeyboardInterrupt:
                stopped += 1
            found = scene.states
            if found is not None:
                assert np.array_equal(found.x, states.x[: len(found.x)])
                assert np.array_equal(found.load, states.load[: len(found.x)])
            assert scene.fields(np.zeros(scene.dofs), 0.0).u.shape == (scene.collocation_points, 3)
            if stopped == 25:
                assert np.array_equal(scene.solve().x, states.x), "it solves again"
    assert stopped == 50


def test_keys_pressed_again_and_again_do_not_leave_a_call_behind():
    ended, asked = [], []

    def work():
        for _ in range(5):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.06)
        ended.append(1)

    assert call_in_thread(work, lambda: None, lambda: asked.append(1))
    assert ended and asked


def test_progress_that_raises_ends_the_solve():
    def refuse(line):
        raise RuntimeError("no room to print")

    with long_scene() as scene:
        refuses("no room", scene.solve, progress=refuse, kind=RuntimeError)
        assert scene.states is not None and 1 <= len(scene.states.load) <= 40


@pytest.mark.slow
def test_a_busy_scene_refuses_questions_and_answers_after(whole):
    asked = []

    def ask(line):
        refuses("is being solved", scene.fields, np.zeros(scene.dofs), 0.0)
        refuses("is being solved", scene.solve)
        refuses("progress of its own solve", scene.close)
        asked.append(line)

    with long_scene() as scene:
        assert scene.states is None
        states = scene.solve(progress=ask)
        assert asked and np.array_equal(states.x, whole[0].x)
        assert np.array_equal(scene.states.x, states.x)
        assert scene.fields(states.x[-1], 1.0).u.shape == (scene.collocation_points, 3)
        # those of the last solve, which had none
        refuses("no reduced model", scene.solve_reduced, "")
        assert scene.states is None


def test_closing_a_scene_ends_its_solve():
    scene = long_scene(load={"steps": 400})
    with ThreadPoolExecutor(1) as pool:
        solve = pool.submit(scene.solve)
        time.sleep(0.2)
        scene.close()
        assert isinstance(solve.exception(), StoppedError)
    refuses("closed", scene.solve)


def ended(code, *words, **more):
    program = [sys.executable, "-c", code, *words]
    return subprocess.run(program, capture_output=True, text=True, timeout=600, **more)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["", "sys.exit(0)", "raise SystemExit"])
def test_the_interpreter_ends_while_another_thread_solves(ending):
    """Daemon threads keep running while Python exits: the scene is closed under them."""
    code = f"""
import sys, threading, time
sys.path.insert(0, {str(os.path.dirname(__file__))!r})
from test_interrupts import long_scene
scene = long_scene(load={{"steps": 4000}})
threading.Thread(target=lambda: scene.solve(), daemon=True).start()
time.sleep(0.2)
{ending}
"""
    done = ended(code)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_a_signal_amid_the_import_of_numpy(name):
    """It waits until numpy is loaded: half of it gave a broken installation and a traceback."""
    code = f"""
import os, signal, sys
from myork.cli import main

class Key:
    def find_spec(self, name, path=None, target=None):
        if name == "numpy._core.multiarray":
            os.kill(os.getpid(), signal.{name})

sys.meta_path.insert(0, Key())
assert "numpy" not in sys.modules
sys.exit(main(["explain", "deck.toml"]))
"""
    done = ended(code)
    assert done.returncode == 1
    assert done.stderr == "myork: stopped; results that were finished are kept\n"


# ---- one and two threads give the same bits: every method, every solver --------------------------


def digest(*arrays):
    data = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
    return hashlib.sha256(data).hexdigest()


def level_sets():
    rng = np.random.default_rng(1)
    disc = np.hypot(*np.mgrid[-1:1:40j, -1:1:30j]) < 0.5
    image = disc[..., None, None] + 0.1 * rng.standard_normal((40, 30, 6, 1))
    start = rng.standard_normal((*image.shape[:3], 2))
    found = evolve_level_sets(
        image, np.ones(image.shape[:3]), start, spacing=(1.0, 1.0), mu=0.01, nu=0.0,
        epsilon=0.5, dt=500.0, tolerance=1e-4, iterations=20, lambdas=np.ones((1, 4)),
    )  # fmt: skip
    return digest(*found.values())


def all_cases(cases, threads):
    """All results of all cases that Python returns."""
    for name, (deck, overrides) in cases.items():
        with Scene(deck, overrides, threads=threads) as scene:
            states = scene.solve()
            fields = scene.fields(states.x[-1], 1.0)
            yield name, digest(states.x, states.probe_errors, fields.u, fields.f, fields.cauchy)
            if name == "displacement, refined":
                scene.reduce(np.linalg.qr(states.x.T)[0])
                yield "reduced", digest(scene.solve_reduced("").x)
    yield "level sets", level_sets()
    points = np.random.default_rng(2).uniform(0, 1, (600, 3))
    shape = shape_functions(points, 0.35, points[::2], order=2)
    yield "shape functions", digest(shape.value, shape.neighbour)


def on_one_and_two_threads(path):
    """One line for all cases for each number of threads."""
    cases = json.loads(Path(path).read_text(encoding="utf-8"))
    for threads in (1, 2):
        with core_threads(threads):
            print(json.dumps(dict(all_cases(cases, threads))))


def run(function: str, word: object, **environment: str) -> list[str]:
    """Lines that a function of this module prints for a word, in a process without the limits that
    the tests run under.
    """
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("OMP_", "OPENBLAS_"))}
    kept |= {"OMP_WAIT_POLICY": "passive", "PYTHONPATH": os.pathsep.join(sys.path)}
    code = f"import sys; from tests.unit import test_interrupts as m; m.{function}(sys.argv[1])"
    done = ended(code, str(word), env=kept | environment)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_python(inputs: Path, tmp_path: Path) -> None:
    """Scenes, a reduced model, level sets and shape functions in one process.

    The bodies are large enough for OpenBLAS to divide their matrices if it may: unless libraries
    are limited to one thread, every dense or sparse factor would differ, by 1e-16 to 1e-10.
    """
    cases = {name: (str(inputs / f"{deck}.toml"), more) for name, (deck, more) in CASES.items()}
    (tmp_path / "cases.json").write_text(json.dumps(cases), encoding="utf-8")
    one, two = map(json.loads, run("on_one_and_two_threads", tmp_path / "cases.json"))
    assert len(one) == len(CASES) + 3
    assert [name for name in one if one[name] != two[name]] == []


def forked(path):
    """Whether children of a process that has used its threads give the same answers."""
    block = scenes.box(5, 5, 5, places=(5, 5, 5))
    tables = scenes.gripped("rkpm-scni", block, scenes.neo(20, 500), "x0 x1", u_x=0.2)
    scene, rom = Scene.from_tables(tables), ReducedModel.load(path, threads=2)
    rows = np.linspace([0.0, -0.1], [0.5, 0.1], 40)

    def answers():
        with Scene.from_tables(tables) as own:
            x = [each.solve(error=False).x[-1] for each in (scene, own)]
            u = scene.fields(x[0], 1.0).u
        force = [rom.batch(rows).force, rom.solve(activation=0.3, u_z=0.05).force]
        return digest(*x, u, *force)

    here = answers()

    def child():
        signal.alarm(60)  # stops a child that waits for threads that do not exist
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


@pytest.mark.slow
def test_children_of_a_fork(voxel_rom: Path) -> None:
    """They inherit none of their parent's threads; the first parallel region waited for them."""
    assert run("forked", voxel_rom, OMP_NUM_THREADS="2") == ["0 0"]
