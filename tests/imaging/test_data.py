"""Files that a deck names, looked for in a folder of data."""

import json
from pathlib import Path

import pytest
import tomllib

from myork.cli import main
from myork.errors import FileError, InputError
from myork.stations.data import PATHS, data_overrides

SCHEMA = Path(__file__).parents[2] / "fortran" / "deck" / "schema.toml"

DECK = """title = "own"
[units]
force = "N"
length = "cm"
[scene]
dimension = 3
[image]
anatomy = "t1.nii.gz"
truth = "truth.nii.gz"
"""


def test_every_path_of_images_is_known():
    schema = tomllib.loads(SCHEMA.read_text())
    keys = {
        f"{table}.{key}"
        for table in ("image", "dixon", "t2", "build", "tissue")
        for key, entry in schema[table].items()
        if isinstance(entry, dict) and entry.get("unit") == "path"
    }
    assert keys == set(PATHS)


@pytest.fixture
def deck(tmp_path):
    path = tmp_path / "decks" / "own.toml"
    path.parent.mkdir()
    path.write_text(DECK)
    (path.parent / "truth.nii.gz").touch()
    folder = tmp_path / "data" / "first visit"
    folder.mkdir(parents=True)
    (folder / "t1.nii.gz").touch()
    (folder / "truth.nii.gz").touch()
    return path


def test_files_beside_the_deck_come_first_others_are_looked_for(deck, tmp_path):
    place = tmp_path / "data" / "first visit" / "t1.nii.gz"
    assert data_overrides(deck, tmp_path / "data") == [f"image.anatomy={place}"]
    here = [f"image.anatomy={place}"]
    assert data_overrides(deck, tmp_path / "data", here) == []


def test_a_path_of_the_deck_is_first_joined_to_the_folder(deck, tmp_path):
    """As in a BIDS tree, in which each subject has files of the same names."""
    wanted = tmp_path / "data" / "sub-02" / "anat" / "t1.nii.gz"
    wanted.parent.mkdir(parents=True)
    wanted.touch()
    own = ["image.anatomy=sub-02/anat/t1.nii.gz"]
    assert data_overrides(deck, tmp_path / "data", own) == [f"image.anatomy={wanted}"]


def test_missing_and_double_files_are_told(deck, tmp_path):
    data = tmp_path / "data"
    with pytest.raises(FileError, match="there is no such folder"):
        data_overrides(deck, data / "nowhere")
    with pytest.raises(FileError, match=r"there is no other.nii.gz \(image.anatomy\) below"):
        data_overrides(deck, data, ["image.anatomy=other.nii.gz"])
    (data / "t1.nii.gz").touch()
    with pytest.raises(InputError, match="2 files .* t1.nii.gz .* --set image.anatomy=PATH"):
        data_overrides(deck, data)


def test_the_command_reads_the_file_that_was_found(deck, tmp_path, capsys):
    # The file is empty, and the message names it where it lies.
    assert main(["segment", str(deck), "--data", str(tmp_path / "data")]) == 2
    assert str(tmp_path / "data" / "first visit" / "t1.nii.gz") in capsys.readouterr().err


def test_of_several_files_those_at_the_deck_stay_there(tmp_path, monkeypatch):
    """The deck is named from elsewhere: its folder must not be put before its files twice."""
    monkeypatch.chdir(tmp_path)
    for name in ("deck/t1.nii.gz", "deck/t2.nii.gz", "data/t3.nii.gz"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    deck = tmp_path / "deck" / "a.toml"
    deck.write_text(
        'title = "t"\nunits = {force = "N", length = "mm"}\nscene.dimension = 3\n[image]\n'
        'anatomy = "t1.nii.gz"\nchannels = ["t2.nii.gz", "t3.nii.gz"]\n'
    )
    (found,) = data_overrides("deck/a.toml", "data")
    places = [str(tmp_path / name) for name in ("deck/t2.nii.gz", "data/t3.nii.gz")]
    assert found == f"image.channels={json.dumps(places)}"


def test_what_is_chosen_in_a_folder_stays_behind_its_name(deck, tmp_path):
    place = tmp_path / "data" / "visit" / "scan"
    place.mkdir(parents=True)
    asked = [
        'dixon.magnitude=["scan:series=5,echo=1", "scan:series=5,echo=2"]',
        f'dixon.phase=["{place}:echo=1", "{place}:echo=2"]',
        f"image.anatomy={place}:kind=water",
    ]
    (found,) = data_overrides(deck, tmp_path / "data", asked)
    key, value = found.split("=", 1)
    assert key == "dixon.magnitude"
    assert json.loads(value) == [f"{place}:series=5,echo={echo}" for echo in (1, 2)]
