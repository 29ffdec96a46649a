"""Files that are there whole or not at all."""

import json

import pytest

from myork.errors import FileError
from myork.files import whole_file, write_json


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


def test_a_file_that_cannot_be_written_is_named(tmp_path):
    path = tmp_path / "nowhere" / "a.json"
    with pytest.raises(FileError, match=r"nowhere/a\.json: cannot be written: No such file"):
        write_json(path, {})


def test_numbers_that_are_not_finite_become_null(tmp_path):
    write_json(tmp_path / "a.json", {"a": [float("nan"), 1.5], "b": {"c": float("inf")}, "d": "é"})
    text = (tmp_path / "a.json").read_text(encoding="utf-8")
    assert json.loads(text) == {"a": [None, 1.5], "b": {"c": None}, "d": "é"}
    assert "é" in text
