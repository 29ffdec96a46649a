"""`myork bench faults`: a part of the corpus, and the damage that had ended badly once."""

import os
import re
import resource
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from myork.bench.isolated import Verdict, isolated
from myork.bench.studies.faults import WRONG, run
from myork.cli import main
from myork.core.deck import load_deck, load_tables, text_of_tables
from myork.core.scene import Scene
from myork.errors import FileError, InputError
from myork.model_file import read_model, write_model
from myork.reference.faults_models import MODEL_DECK, block_cloud
from myork.stations.solve import find_executable

PATIENCE = 60


def test_a_part_of_the_corpus(tmp_path: Path) -> None:
    study = run(tmp_path, lambda line: None, True)
    bad = [case for case in study["cases"] if case["outcome"] in WRONG]
    assert not bad, bad
    ends = {case["outcome"] for case in study["cases"]}
    assert {"right", "refused"} <= ends and len(study["cases"]) > 350


def _end(how: str) -> Verdict:
    if how == "crash":
        os.abort()
    if how == "hang":
        while True:
            pass
    if how == "internal":
        raise ValueError(how)
    if how == "refused":
        raise InputError(how)
    return Verdict("right")


def test_an_isolated_call_may_do_anything() -> None:
    hows = ["right", "crash", "refused", "hang", "internal", "crash"]
    # longer than the imports of a process take
    verdicts = isolated(_end, hows, 2.0)
    assert [verdict.outcome for verdict in verdicts] == hows


def explain(folder: Path, *words: str, **more) -> subprocess.CompletedProcess[str]:
    deck = folder / "deck.toml"
    deck.write_text(text_of_tables(MODEL_DECK), encoding="utf-8")
    return subprocess.run(
        [find_executable(), deck, "--explain", "-o", folder, *words],
        capture_output=True, text=True, timeout=PATIENCE, **more,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("volume", -1.0, "'volume' has a negative number"),
        ("area", -1.0, "'area' has a negative number"),
        ("boundary_point", 2**31 - 1, "'boundary_point' must hold indices from 0 to 342"),
        ("boundary_set", 3, "'boundary_set' must hold indices from 0 to 2"),
    ],
)
def test_impossible_numbers_of_a_model(
    tmp_path: Path, name: str, value: float, message: str
) -> None:
    path = tmp_path / "model.h5"
    write_model(path, block_cloud())
    assert explain(tmp_path).returncode == 0
    with h5py.File(path, "r+") as file:
        file[name][5] = value
    done = explain(tmp_path)
    assert done.returncode == 2 and message in done.stderr
    with pytest.raises(InputError, match=message):
        read_model(path)


def test_many_names_take_little_memory(tmp_path: Path) -> None:
    """20,000 names, each of which took the room of all of them: 4 GB."""
    write_model(tmp_path / "model.h5", block_cloud())
    names = "left\nright\n" + "\n".join(f"set {i}" for i in range(20_000))
    with h5py.File(tmp_path / "model.h5", "r+") as file:
        del file["set_names"]
        file["set_names"] = np.frombuffer(names.encode(), np.uint8)
    most = 1_500_000_000
    done = explain(
        tmp_path, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (most, most))
    )
    assert done.returncode == 0, done.stderr


def test_a_pipe_is_no_model(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "model.h5")
    done = explain(tmp_path)
    assert done.returncode == 2 and "not a regular file" in done.stderr
    with pytest.raises(FileError):
        read_model(tmp_path / "model.h5")


def test_a_pipe_is_no_deck(tmp_path: Path) -> None:
    pipe = tmp_path / "deck.toml"
    os.mkfifo(pipe)
    done = subprocess.run(
        [find_executable(), pipe, "--explain"], capture_output=True, text=True, timeout=PATIENCE
    )
    assert done.returncode == 2 and f"{pipe}: the deck cannot be read" in done.stderr
    with pytest.raises(FileError, match="not a regular file"):
        load_deck(pipe)


@pytest.mark.parametrize("kind", ["source", "points"])
def test_two_points_in_one_place(tmp_path: Path, kind: str) -> None:
    """Refused by number and place, from a file and from arrays."""
    cloud = block_cloud()
    points = getattr(cloud, kind).copy()
    points[9] = points[3] + 1e-9
    cloud = replace(cloud, **{kind: points})
    what = f"{'source' if kind == 'source' else 'collocation'} points 4 and 10 at (0, "
    write_model(tmp_path / "model.h5", cloud)
    done = explain(tmp_path)
    assert done.returncode == 2 and what in done.stderr and "are the same" in done.stderr
    tables = {key: value for key, value in MODEL_DECK.items() if key != "geometry"}
    with pytest.raises(InputError, match=re.escape(what)):
        Scene.from_tables(tables, cloud=cloud)


def test_exponents_of_three_digits_keep_their_letter(tmp_path: Path) -> None:
    spacing = block_cloud().spacing.copy()
    spacing[0, 1] = -1e-123
    write_model(tmp_path / "model.h5", replace(block_cloud(), spacing=spacing))
    done = explain(tmp_path)
    assert done.returncode == 2 and "(0.333333, -1.00000E-123, 0.333333)" in done.stderr
    write_model(tmp_path / "model.h5", block_cloud())
    words = ["-v", "-o", tmp_path, "--set", "material.A10=1e105", "--set", "material.K=1e107"]
    done = subprocess.run(
        [find_executable(), tmp_path / "deck.toml", *words],
        capture_output=True, text=True, timeout=PATIENCE,
    )  # fmt: skip
    assert re.search(r"iteration 1  \|r\|  \d\.\dE\+10\d  \|A'r\|  \d\.\dE\+2\d\d  ", done.stdout)


def test_threads_of_the_environment(tmp_path: Path) -> None:
    write_model(tmp_path / "model.h5", block_cloud())
    many = {**os.environ, "OMP_NUM_THREADS": "100000", "PYTHONPATH": os.pathsep.join(sys.path)}
    for words in ([], ["-t", "2"]):
        done = explain(tmp_path, *words, env=many)
        assert done.returncode == (0 if words else 2), done.stderr
        assert words or "OMP_NUM_THREADS is 100000" in done.stderr
    done = subprocess.run(
        [sys.executable, "-c", "import myork; myork.Scene"],
        env=many, capture_output=True, text=True, timeout=PATIENCE,
    )  # fmt: skip
    assert "InputError: OMP_NUM_THREADS is 100000" in done.stderr


@pytest.mark.parametrize("word", ["--help", "--version"])
def test_little_memory_answers_questions(word: str) -> None:
    little = 300_000_000
    ends = [
        subprocess.run(
            [find_executable(), word], capture_output=True, text=True, timeout=PATIENCE,
            preexec_fn=before,
        )
        for before in (None, lambda: resource.setrlimit(resource.RLIMIT_AS, (little, little)))
    ]  # fmt: skip
    assert ends[0].returncode == ends[1].returncode == 0
    assert ends[0].stdout == ends[1].stdout and "myork-solve" in ends[0].stdout


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["-t", "100000"], "from 1 to 1024"),
        (["--set", "load.steps=2\nload.activation=1"], "an override is a single line"),
    ],
)
def test_words_of_the_executable(tmp_path: Path, words: list[str], message: str) -> None:
    write_model(tmp_path / "model.h5", block_cloud())
    done = explain(tmp_path, *words)
    assert done.returncode == 2 and message in done.stderr


@pytest.mark.parametrize(
    ("words", "message"),
    [(["--out", ""], "the name of a folder"), (["--threads", "100000"], "at most 1024")],
)
def test_words_of_the_command(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as end:
        main(["explain", "deck.toml", *words])
    assert end.value.code == 2 and message in capsys.readouterr().err


def test_texts_of_a_deck() -> None:
    """A null character cut a text; half a megabyte took 15 s."""
    with pytest.raises(InputError, match=r"title: must not contain the character .u0000"):
        load_tables({"title": "a\0b"})
    with pytest.raises(InputError, match="title: must not be longer than 4096 bytes, not 500000"):
        load_tables({"title": "x" * 500_000})
    with pytest.raises(InputError, match=r"tables: x{100,200}\.\.\.: unknown"):
        load_tables({"x" * 500_000: 1})


def test_little_memory_is_refused_at_once(tmp_path: Path) -> None:
    write_model(tmp_path / "model.h5", block_cloud())
    little = 300_000_000
    done = explain(
        tmp_path, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (little, little))
    )
    assert done.returncode == 2 and "ulimit -v" in done.stderr
