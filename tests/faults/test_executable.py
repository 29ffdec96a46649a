"""Models, words, memories and environments on which the executable ended badly once."""

import os
import re
import resource
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from myork.core.deck import load_deck
from myork.core.scene import Scene
from myork.errors import FileError
from myork.model_file import write_model
from myork.stations.solve import find_executable
from tests.scenes import deck_file, myork, refuses
from tests.unit.test_scene_from_tables import BLOCK, PULLED, cloud

PATIENCE = 60


def run(*words: str | Path, **more) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [find_executable(), *words], capture_output=True, text=True, timeout=PATIENCE, **more
    )


def explain(folder: Path, *words: str, **more) -> subprocess.CompletedProcess[str]:
    return run(deck_file(folder / "deck.toml", BLOCK), "--explain", "-o", folder, *words, **more)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_model(tmp_path / "model.h5", cloud())
    return tmp_path


def limited(size: int) -> dict[str, Callable[[], None]]:
    """Words of a process that has so much address space [bytes]."""
    return {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size))}


@pytest.mark.slow
def test_many_names_take_little_memory(model: Path) -> None:
    """20,000 names, each of which took the room of all of them: 4 GB."""
    names = "z0\nz1\n" + "\n".join(f"set {i}" for i in range(20_000))
    with h5py.File(model / "model.h5", "r+") as file:
        del file["set_names"]
        file["set_names"] = np.frombuffer(names.encode(), np.uint8)
    done = explain(model, **limited(1_500_000_000))
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("name", ["model.h5", "deck.toml"])
def test_a_pipe_is_no_file(tmp_path: Path, name: str) -> None:
    os.mkfifo(tmp_path / "pipe")
    deck_file(tmp_path / "deck.toml", BLOCK)
    (tmp_path / name).unlink(missing_ok=True)
    (tmp_path / name).symlink_to("pipe")
    done = run(tmp_path / "deck.toml", "--explain")
    said = "not a regular file" if name == "model.h5" else f"{tmp_path / name}: the deck cannot be"
    assert done.returncode == 2 and said in done.stderr


def test_a_model_that_is_not_built(tmp_path: Path) -> None:
    said = "geometry.file: no model model.h5 in .* run `myork build` first"
    assert re.search(said, explain(tmp_path).stderr)
    refuses(said, Scene, tmp_path / "deck.toml", kind=FileError)


@pytest.mark.parametrize("kind", ["source", "points"])
def test_two_points_in_one_place(tmp_path: Path, kind: str) -> None:
    """Refused by number and place, from a file and from arrays."""
    points = getattr(cloud(), kind).copy()
    points[9] = points[3] + 1e-9
    body = replace(cloud(), **{kind: points})
    what = f"{'source' if kind == 'source' else 'collocation'} points 4 and 10 at (0, "
    write_model(tmp_path / "model.h5", body)
    done = explain(tmp_path)
    assert done.returncode == 2 and what in done.stderr and "are the same" in done.stderr
    refuses(re.escape(what), Scene.from_tables, PULLED, cloud=body)


def test_exponents_of_three_digits_keep_their_letter(model: Path) -> None:
    explain(model)
    words = ["-v", "-o", model, "--set", "material.A10=1e115", "--set", "material.K=1e117"]
    done = run(model / "deck.toml", *words)
    assert re.search(r"iteration 1  \|r\|  \d\.\dE\+10\d  \|A'r\|  \d\.\dE\+2\d\d  ", done.stdout)
    source = cloud().source.copy()
    source[[3, 9]] = 0.5, -1e-123, 0.375
    write_model(model / "model.h5", replace(cloud(), source=source))
    done = explain(model)
    assert done.returncode == 2 and "(0.5, -1E-123, 0.375)" in done.stderr


def test_threads_of_the_environment(model: Path) -> None:
    many = {**os.environ, "OMP_NUM_THREADS": "100000", "PYTHONPATH": os.pathsep.join(sys.path)}
    assert explain(model, "-t", "2", env=many).returncode == 0
    done = explain(model, env=many)
    assert done.returncode == 2 and "OMP_NUM_THREADS is 100000" in done.stderr
    assert "OMP_NUM_THREADS is 100000" in myork("explain", model / "deck.toml", env=many).stderr


@pytest.mark.parametrize("word", ["--help", "--version"])
def test_little_memory_answers_questions(word: str) -> None:
    ends = [run(word), run(word, **limited(300_000_000))]
    assert ends[0].returncode == ends[1].returncode == 0
    assert ends[0].stdout == ends[1].stdout and "myork-solve" in ends[0].stdout


@pytest.mark.parametrize(("words", "message"), [
    (["-t", "100000"], "-t 100000: the number of threads must be between 1 and 1024"),
    (["--threads", "0"], "--threads 0: the number of threads must be between 1 and 1024"),
    (["--threads"], "--threads needs a value"),
    (["--out"], "--out needs a value"),
    (["--set", "load.steps=2\nload.activation=1"], "an override must be a single line"),
])  # fmt: skip
def test_words_of_the_executable(model: Path, words: list[str], message: str) -> None:
    done = explain(model, *words)
    assert done.returncode == 2 and message in done.stderr


def test_texts_of_a_deck() -> None:
    """A null character cut a text; half a megabyte took 15 s."""
    for tables, said in (
        ({"title": "a\0b"}, r"title: must not contain the character .u0000"),
        ({"title": "x" * 500_000}, "title: must not be longer than 4096 bytes, not 500000"),
        ({"x" * 500_000: 1}, r"tables: x{100,200}\.\.\.: unknown"),
    ):
        refuses(said, load_deck, tables)


def test_little_memory_is_refused_at_once(model: Path) -> None:
    little = limited(300_000_000)
    for done in (explain(model, **little), myork("explain", model / "deck.toml", **little)):
        assert done.returncode == 2 and "ulimit -v" in done.stderr
