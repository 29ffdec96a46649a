"""Files that are there whole or not at all."""

import json
from pathlib import Path

import numpy as np
import pytest

from myork.errors import FileError
from myork.files import alone_in, read_json, whole_file, write_json
from myork.imaging.io import write_image
from myork.model_file import write_model
from myork.records import Image
from myork.sweeps.store import Store
from tests.scenes import refuses
from tests.unit.test_scene_from_tables import cloud


@pytest.mark.parametrize("by_suffix", [False, True])
def test_a_file_stays_as_it_was_until_the_new_one_is_whole(tmp_path, by_suffix):
    path = tmp_path / "a.txt"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), whole_file(path, by_suffix=by_suffix) as unfinished:
        unfinished.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old"
    with whole_file(path, by_suffix=by_suffix) as unfinished:
        unfinished.write_text("new")
        assert path.read_text() == "old"
        assert (unfinished.suffix == ".txt") == by_suffix
    assert path.read_text() == "new" and list(tmp_path.iterdir()) == [path]


def test_numbers_that_are_not_finite_become_null_and_files_are_named(tmp_path):
    write_json(tmp_path / "a.json", {"a": [float("nan"), 1.5], "b": {"c": float("inf")}, "d": "é"})
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    assert json.loads(text) == {"a": [None, 1.5], "b": {"c": None}, "d": "é"}
    assert "é" in text
    (tmp_path / "a.json").write_text("[1]")
    with pytest.raises(FileError, match=r"a\.json: an object is needed, not list"):
        read_json(tmp_path / "a.json")
    path = tmp_path / "nowhere" / "a.json"
    with pytest.raises(FileError, match=r"nowhere/a\.json: cannot be written: No such file"):
        write_json(path, {})


def lay(path: Path, how: str) -> Path:
    """Put a name of another file in place of an output; the file behind it."""
    theirs = path.parent / "theirs"
    theirs.write_text("theirs")
    (path.symlink_to if how == "link" else path.hardlink_to)(theirs)
    return theirs


def _store(folder: Path) -> Store:
    """Store of a sweep of two points that nothing reads back."""
    return Store(folder, {"points": [[0], [1]], "calls": []}, {"units": {}})


ZEROS = Image(np.zeros((2, 2, 2)), np.eye(4))
WRITERS = {
    "summary.json.part": lambda out: write_json(out / "summary.json", {}),
    "part.a.nii.gz": lambda out: write_image(out / "a.nii.gz", ZEROS),
    "model.h5.part": lambda out: write_model(out / "model.h5", cloud()),
    "sweep.csv.part": lambda out: _store(out).write_table([], []),
    "sweep.parquet.part": lambda out: _store(out).write_table([], []),
}


@pytest.mark.parametrize("how", ["link", "second name"])
@pytest.mark.parametrize("name", WRITERS)
def test_output_does_not_follow_names(tmp_path: Path, name: str, how: str) -> None:
    """The name goes, and the file behind it stays."""
    theirs = lay(tmp_path / name, how)
    WRITERS[name](tmp_path)
    assert theirs.read_text() == "theirs"


def test_files_that_stay_are_not_followed(tmp_path: Path) -> None:
    theirs = lay(tmp_path / ".lock", "link")
    with pytest.raises(FileError, match="cannot be used for output"), alone_in(tmp_path):
        pass
    sweep = _store(tmp_path)
    sweep.add({"point": 0})
    (tmp_path / "points.jsonl").unlink()
    lay(tmp_path / "points.jsonl", "link")
    refuses(r"points\.jsonl", sweep.add, {"point": 1}, kind=OSError)
    assert theirs.read_text() == "theirs"
