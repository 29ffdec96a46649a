"""`myork bench faults`: a part of the corpus, and the damage that had ended badly once."""

import os
import resource
import subprocess
from pathlib import Path

import h5py
import numpy as np
import pytest

from myork.bench.isolated import Verdict, isolated
from myork.bench.studies.faults import WRONG, run
from myork.cli import main
from myork.core.deck import load_tables, text_of_tables
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
    assert done.returncode == 2 and "no regular file" in done.stderr
    with pytest.raises(FileError):
        read_model(tmp_path / "model.h5")


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
