"""Ctrl-C, threads and the end of the interpreter around a solve in memory."""

import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from myork.core.calls import call_in_thread
from myork.core.scene import Scene
from myork.errors import StoppedError
from tests import scenes
from tests.scenes import refuses

#: Some tenths of a second in 40 steps: long enough to be interrupted at many places
LONG = scenes.gripped(
    "rkcm", scenes.box(25, 7, size=[4, 1]),
    {"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 1e3}, "y0 y1", u_x=1,
    load={"steps": 40},
)  # fmt: skip


def long_scene(**changes):
    return Scene.from_tables({**LONG, **changes}, threads=1)


@pytest.fixture(scope="module")
def whole():
    """States of a solve that nobody disturbs, and how long it took."""
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
        # those of the last solve, which was none
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


def ended(code):
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120)


@pytest.mark.slow
@pytest.mark.parametrize("ending", ["", "sys.exit(0)", "raise SystemExit"])
def test_the_interpreter_ends_while_another_thread_solves(ending):
    """Daemon threads run on while Python ends: the scene is closed under them."""
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
    """It waits until numpy is whole: half of it had been a broken installation, and a traceback."""
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
    assert done.stderr == "myork: stopped; finished results have been written\n"
