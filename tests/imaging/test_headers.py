"""Echo times and field of DICOM headers and of the JSON files of BIDS."""

import json
from pathlib import Path

import numpy as np
import pytest

from myork.errors import InputError
from myork.imaging.headers import Header, bids_name, read_header
from myork.stations.data import DeckFiles, OneGrid
from myork.stations.segment import _times


def table(path: Path, **entries):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(entries))


def test_the_nearest_and_most_special_file_wins(tmp_path):
    image = tmp_path / "sub-01" / "anat" / "sub-01_echo-2_part-mag_MEGRE.nii.gz"
    assert read_header(image) == Header(None, None)
    table(tmp_path / "MEGRE.json", MagneticFieldStrength=1.5, EchoTime=0.009)
    table(tmp_path / "echo-2_MEGRE.json", EchoTime=0.0046)
    table(tmp_path / "echo-1_MEGRE.json", EchoTime=0.0023)
    table(tmp_path / "sub-02_MEGRE.json", MagneticFieldStrength=7)
    assert read_header(image) == Header(pytest.approx(4.6), 1.5)
    table(image.parent / "sub-01_echo-2_part-mag_MEGRE.json", MagneticFieldStrength=3)
    assert read_header(image) == Header(pytest.approx(4.6), 3.0)
    table(image.parent / "sub-01_echo-2_part-mag_MEGRE.json", EchoTime="long")
    with pytest.raises(InputError, match="EchoTime of its header is 'long', a number above zero"):
        read_header(image)
    (tmp_path / "MEGRE.json").write_text("{")
    with pytest.raises(InputError, match=r"MEGRE.json: is not readable JSON"):
        read_header(image)


def test_names():
    assert bids_name(Path("a/sub-01_echo-2_dwi.nii.gz")) == ({"sub": "01", "echo": "2"}, "dwi")
    assert bids_name(Path("t1.nii")) == ({}, "t1")


def files(folder, **dixon):
    magnitude = ["s_echo-1_MEGRE.nii.gz", "s_echo-2_MEGRE.nii.gz"]
    deck = {"folder": str(folder), "dixon": {"magnitude": magnitude, **dixon}}
    return DeckFiles(deck, "dixon", OneGrid(print))


def test_times_of_the_deck_stand_before_those_of_headers(tmp_path):
    assert _times(files(tmp_path), print) == ((), 0.0)
    for number, time in ((1, 0.0012), (2, 0.0024)):
        table(tmp_path / f"s_echo-{number}_MEGRE.json", EchoTime=time)
    one = files(tmp_path)
    assert _times(one, print) == ((), 0.0)
    assert "hold 2 echo times and no field" in one.grid.doubts[0]
    times, strength = _times(files(tmp_path, field_strength=3.0), print)
    np.testing.assert_allclose(times, [1.2, 2.4])
    assert strength == 3.0
    own = files(tmp_path, echo_times=[2.3, 4.6], field_strength=1.5)
    assert _times(own, print) == ([2.3, 4.6], 1.5)
