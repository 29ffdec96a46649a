"""Runs that continue an interrupted run, and runs that start from states of another."""

import random
import shutil
import signal
import subprocess
import time
from pathlib import Path

import h5py
import numpy as np
import pytest

from myork import Results, Scene
from myork.cli import main
from myork.errors import FileError
from myork.stations.solve import run_deck
from myork.summary import read_summary
from tests.scenes import box, held, neo, probes, refuses, scene, start, stop_behind

MUSCLE = scene(
    "rkpm-gauss", box(5, 5, 7, size=[1, 1, 2], places=(7, 7, 9)),
    material=[{"name": "muscle", "model": "muscle", "A10": 10, "K": 1000, "fiber_angle": 30}],
    boundary=[held("z0"), held("z1", u_z=0.2)], load={"steps": 8, "activation": 0.3},
    probe=probes("force force z1"),
)  # fmt: skip
RUBBER = MUSCLE | {
    "geometry": box(4, 4, 4, places=(6, 6, 6)),
    "material": [neo(10, 500)],
    "boundary": [held("z0"), held("z1", u_x=0.3, u_z=0.3)],
    "load": {"steps": 6},
}


def run(deck: Path, out: Path, *options: str) -> str:
    child = start(deck, out, *options)
    said = child.communicate()[0]
    assert child.returncode == 0, said
    return said


def datasets(out: Path) -> dict[str, np.ndarray]:
    found: dict[str, np.ndarray] = {}

    def keep(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = item[()]

    with h5py.File(out / "results.vtkhdf") as file:
        file.visititems(keep)
    return found


def history(out: Path) -> list[str]:
    return (out / "history.csv").read_text().splitlines()


def assert_equal(out: Path, whole: Path) -> None:
    """The same states, to the tolerance of the solver; the iterations begin without a secant."""
    ours, theirs = (datasets(folder) for folder in (out, whole))
    assert ours.keys() == theirs.keys()
    for name, values in theirs.items():
        near = 1e-5 * np.abs(values).max() if values.dtype == float else 0
        np.testing.assert_allclose(ours[name], values, rtol=0, atol=near, err_msg=name)
    steps = [[line.split(",")[0] for line in history(folder)] for folder in (out, whole)]
    assert list(dict.fromkeys(steps[0])) == list(dict.fromkeys(steps[1]))
    found, expected = (read_summary(folder) for folder in (out, whole))
    assert found["verdict"]["state"] == expected["verdict"]["state"]
    for ours, theirs in zip(found["steps"], expected["steps"], strict=True):
        for name, value in theirs["probes"].items():
            near = 1e-5 * np.abs(value).max()
            np.testing.assert_allclose(ours["probes"][name], value, rtol=0, atol=near)


def interrupt(deck: Path, out: Path, wait: float, *options: str) -> None:
    child = start(deck, out, *options)
    try:
        child.wait(wait)
    except subprocess.TimeoutExpired:
        child.kill()
    child.communicate()


@pytest.mark.slow
def test_killed_at_random_moments_and_resumed_it_is_the_same_run(tmp_path, write_deck):
    deck, whole = write_deck(MUSCLE), tmp_path / "whole"
    begun = time.monotonic()
    run(deck, whole)
    seconds = time.monotonic() - begun
    seed = random.randrange(1 << 30)
    draw, resumed = random.Random(seed), 0
    for k in range(5):
        out = tmp_path / f"killed{k}"
        interrupt(deck, out, draw.uniform(0.1, 0.9) * seconds)
        # and once more on the way
        interrupt(deck, out, draw.uniform(0.1, 0.9) * seconds, "--resume")
        resumed += "resumed after load step" in run(deck, out, "--resume")
        assert_equal(out, whole)
    assert resumed > 0, f"seed {seed}"


FORMS = {
    "mixed": {"scene": {"dimension": 3, "method": "rkcm-mixed"}},
    "incompressible": {"material": [{**RUBBER["material"][0], "K": float("inf")}]},
    "halved": {"solver": {"max_iterations": 3}},
    "minres": {"scene": {"dimension": 3, "method": "rkpm-scni"}, "galerkin": {"direct_limit": 0}},
    # rates with jumps
    "programme": {
        "amplitude": [{"name": "there", "time": [0, 0.4, 1], "value": [0, 1, 1]}],
        "boundary": [held("z0"), held("z1", u_x=0.3, u_z=0.3, amplitude="there")],
    },
}


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
def test_every_form_is_resumed(tmp_path, write_deck, name):
    """A run is stopped after its third load step, as soon as this is in its journal."""
    deck = write_deck({**RUBBER, **FORMS[name]})
    run(deck, tmp_path / "whole")
    for number in (signal.SIGKILL, signal.SIGTERM):
        out = tmp_path / number.name
        stop_behind(start(deck, out), number)
        assert "resumed after load step" in run(deck, out, "--resume")
        assert_equal(out, tmp_path / "whole")


@pytest.mark.slow
def test_a_finished_run_is_read_again(tmp_path, write_deck):
    deck = write_deck(RUBBER)
    run(deck, tmp_path)
    shutil.copytree(tmp_path, whole := tmp_path / "whole")
    assert "resumed after load step 6" in run(deck, tmp_path, "--resume")
    assert_equal(tmp_path, whole)
    # of a torn journal, and of one whose end was lost in a power cut, the complete steps are used
    journal = tmp_path / "results.journal"
    states = journal.read_bytes()
    for torn in (states[: -len(states) // 4], states[:-100] + bytes(100)):
        journal.write_bytes(torn)
        assert "resumed after load step" in run(deck, tmp_path, "--resume", "--no-error")
        assert_equal(tmp_path, whole)
    # a damaged head, or another version, is refused
    for place in (14, 19):
        damaged = bytearray(states)
        damaged[place] ^= 0x80
        journal.write_bytes(damaged)
        child = start(deck, tmp_path, "--resume", "--no-error")
        assert child.communicate() and child.returncode == 2
    # a run that was killed before it had solved anything begins anew, and says so
    journal.write_bytes(states[:16])
    assert "no load step to resume" in run(deck, tmp_path, "--resume", "--no-error")


def test_another_deck_is_refused(tmp_path):
    """Without anything to resume, a run begins at rest."""
    assert run_deck(RUBBER, tmp_path, threads=1, resume=True, error=False)["converged"]
    said, seven = r"another deck: it was solved without --set", ["load.steps=7"]
    refuses(said, run_deck, RUBBER, tmp_path, overrides=seven, resume=True)
    said, other = r'another deck: line \d+ was "steps = 6"', {**RUBBER, "load": {"steps": 7}}
    refuses(said, run_deck, other, tmp_path, resume=True)


@pytest.mark.slow
def test_a_state_is_where_another_run_starts(tmp_path):
    """A body has no memory: from that state and from rest the same state is found."""
    run_deck(RUBBER, tmp_path / "first", threads=1, error=False)
    file, same = tmp_path / "first" / "results.vtkhdf", {**RUBBER, "load": {"steps": 1}}
    further = same | {"boundary": [held("z0"), held("z1", u_x=0.3, u_z=0.35)]}
    rest, near, earlier = (
        run_deck(further, tmp_path / f"run {number}", threads=1, error=False, start=begin)
        for number, begin in enumerate((None, file, f"{file}:5"))
    )
    expected = rest["steps"][-1]["probes"]["force"]
    for summary in (near, earlier):
        assert summary["steps"][-1]["probes"]["force"] == pytest.approx(expected, rel=1e-5)
    # with the loads of the state it is confirmed, without further iterations
    with Results(file) as results, Scene.from_tables(same, threads=1) as scene:
        last = results.restart()
        for begin in (file, f"{file}:6", last, last.coefficients):
            states = scene.solve(error=False, start=begin)
            assert states.iterations[-1] == 1
            assert np.allclose(states.x[-1], last.coefficients, rtol=0, atol=1e-7)
        assert scene.solve(error=False, start=states).iterations[-1] == 1
        assert scene.solve(error=False).iterations[-1] > 3


def test_a_start_that_leads_nowhere_is_left(tmp_path):
    """The state of full load is inverted at the first of several loads: the run begins at rest."""
    first = run_deck(RUBBER, tmp_path / "first", threads=1, error=False)
    file, said = tmp_path / "first" / "results.vtkhdf", []
    again = run_deck(
        RUBBER, tmp_path / "again", threads=1, error=False, start=file, progress=said.append
    )
    assert any("from the given start" in line and "from rest" in line for line in said)
    with Scene.from_tables(RUBBER, threads=1) as scene:
        force = scene.probes(scene.solve(error=False, start=file).x, [1.0] * 6)[-1, 0]
    for found in (again["steps"][-1]["probes"]["force"], force):
        np.testing.assert_allclose(found, first["steps"][-1]["probes"]["force"], rtol=1e-6)


def programme(pull: list[float], excite: list[float], steps: int, method: str) -> dict:
    """A block of muscle, stretched and excited by amplitudes over equal parts of load time."""
    time = np.linspace(0, 1, len(pull)).tolist()
    return MUSCLE | {
        "scene": {"dimension": 3, "method": method}, "geometry": box(3, 3, 3, places=[4] * 3),
        "material": [MUSCLE["material"][0] | {"A10": 1, "K": 500, "fiber_angle": 17}],
        "amplitude": [{"name": name, "time": time, "value": value}
                      for name, value in (("pull", pull), ("excite", excite))],
        "boundary": [held("z0"), held("z1", u_z=0.2, amplitude="pull")],
        "load": {"activation": 0.2, "amplitude": "excite", "steps": steps},
    }  # fmt: skip


@pytest.mark.parametrize("method", ["rkpm-gauss", "rkpm-scni"])
def test_two_programmes_are_the_long_one(tmp_path, method):
    """Stretched, then excited: in one run, in two, or in the second alone from rest."""

    def solve(name: str, deck: dict, begin: Path | None = None) -> list[np.ndarray]:
        run_deck(deck, tmp_path / name, threads=1, error=False, start=begin)
        with Results(tmp_path / name) as results:
            return [results.restart(step).coefficients for step in range(results.nstep)]

    whole = solve("whole", programme([0, 1, 1], [0, 0, 1], 4, method))
    last = solve("first", programme([0, 1], [0, 0], 2, method))[-1]
    tables = programme([1, 1], [0, 1], 2, method)
    near = 1e-6 * np.abs(last).max()
    for name, begin in (("second", tmp_path / "first"), ("alone", None)):
        found = solve(name, tables, begin)
        np.testing.assert_allclose(found, whole[2:], atol=near)
        np.testing.assert_allclose(found[0], last, atol=near)
        # one iteration confirms the state
        few = sum(line.startswith("0,") for line in history(tmp_path / name)) <= 2
        assert few == (name == "second")


def test_a_programme_begins_at_equilibrium_with_what_it_prescribes():
    """A start with other loads is brought to those of load time 0, or left out if there is none."""
    tables = programme([1, 0.5], [1, 0], 1, "rkpm-gauss")
    with Scene.from_tables(tables, threads=1) as scene:
        rest = scene.solve(error=False).x
        for begin in (0.7 * rest[-1], np.random.default_rng(0).standard_normal(scene.dofs)):
            np.testing.assert_allclose(scene.solve(error=False, start=begin).x, rest, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_run_that_began_loaded_is_resumed(tmp_path, write_deck, number):
    """Its first state is neither that at rest nor found twice; the start need not be named."""
    body = {key: MUSCLE[key] for key in ("geometry", "material")}
    first = programme([0, 1], [0, 0], 1, "rkpm-gauss") | body
    run_deck(first, tmp_path / "first", threads=1, error=False)
    deck = write_deck(programme([1, 1], [0, 1], 6, "rkpm-gauss") | body)
    begin = ("--start-from", str(tmp_path / "first"))
    run(deck, tmp_path / "whole", *begin)
    out = tmp_path / "out"
    stop_behind(start(deck, out, *begin), number)
    assert "resumed after load step" in run(deck, out, "--resume")
    assert_equal(out, tmp_path / "whole")


def test_a_state_of_other_points_is_refused(tmp_path):
    run_deck(RUBBER, tmp_path / "first", threads=1, error=False)
    file, out = tmp_path / "first" / "results.vtkhdf", tmp_path / "b"
    for override, said in (
        ("geometry.source=[5,4,4]", "80 source points|64 source points"),
        ("geometry.size=[1,1,1.1]", "points at other places"),
        ("approximation.support=2.2", "an approximation of order 1"),
    ):
        refuses(said, run_deck, RUBBER, out, overrides=[override], start=file)
        with Scene.from_tables(RUBBER, overrides=[override]) as scene:
            refuses("start", scene.solve, start=file)
    refuses("has no step 9", run_deck, RUBBER, out, start=f"{file}:9")
    missing = tmp_path / "nowhere.vtkhdf"
    with Scene.from_tables(RUBBER) as scene:
        refuses(r"nowhere\.vtkhdf", scene.solve, start=missing, kind=FileError)


def test_both_commands_know_the_options(tmp_path, write_deck):
    deck, out = write_deck({**RUBBER, "load": {"steps": 2}}), tmp_path / "out"
    options = ["solve", str(deck), "--out", str(out), "--threads", "1", "-q"]
    begin = "--start-from", f"{out / 'results.vtkhdf'}:1"
    for more in ((), ("--resume",), begin):
        assert main([*options, "--no-error", *more]) == 0
    assert main([*options, "--start-from", str(tmp_path / "none.vtkhdf")]) == 2


@pytest.mark.slow
def test_points_that_were_refined_are_not_searched_again(tmp_path, write_deck):
    """A killed run continues with the points it had found, whatever a new search would find."""
    wanted = {"accuracy": 0.01, "cost": 60.0}
    deck = write_deck({**RUBBER, "load": {"steps": 12}, "refine": wanted})
    said = run(deck, tmp_path / "whole")
    assert "refine 2:" in said and "the target error of 1 % is" in said
    out = tmp_path / "killed"
    stop_behind(start(deck, out))
    said = run(deck, out, "--resume")
    assert "refine 1:" not in said and "resumed after load step" in said
    assert "the points of the run that is resumed" in said
    assert_equal(out, tmp_path / "whole")
    found, before = (read_summary(folder)["refine"] for folder in (out, tmp_path / "whole"))
    assert found["met"] and before["met"] and not found["levels"]
    # a finished run is read again; another request is another deck
    assert "refine 1:" not in run(deck, out, "--resume")
    child = start(deck, out, "--resume", "--set", "geometry.source=[5,5,5]")
    assert "another deck: it was solved with --set geometry" in child.communicate()[0]
    assert child.returncode == 2
