"""Signals and full disks: an earlier result stays whole, whoever wrote it."""

import json
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

import h5py
import nibabel
import numpy as np
import pytest

from myork.summary import WAITING
from tests.faults.test_damaged_files import AFFINE, BAR, disc, segmented
from tests.scenes import deck_file

pytestmark = pytest.mark.nightly

PATIENCE = 60
COMMANDS = ("solve", "rom", "segment", "build", "report")


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A deck of each command, and a folder with its result."""
    place = tmp_path_factory.mktemp("place")
    for name, values in (("anatomy", disc()), ("labels", np.pad(np.ones((6,) * 3, "i2"), 1))):
        nibabel.save(nibabel.Nifti1Image(values, AFFINE), place / f"{name}.nii")
    box = {"scene": {"dimension": 3}, "build": {"labels": str(place / "labels.nii"), "ids": [1]}}
    decks = (BAR, BAR, segmented(anatomy=place / "anatomy.nii"), box)
    for name, deck in zip(COMMANDS, decks, strict=False):
        deck_file(place / f"{name}.toml", deck)
    for name in COMMANDS:
        if name == "report":
            shutil.copytree(place / "solve", place / "report")
        ended(start(place, name, place / name), 0)
    return place


def words(place: Path, name: str, out: Path) -> list[str]:
    start = [sys.executable, "-m", "myork", name, "-q"]
    if name == "report":
        return [*start, str(out)]
    return [*start, str(place / f"{name}.toml"), "--threads", "1", "--out", str(out)]


def start(
    place: Path, name: str, out: Path, before: Callable[[], None] | None = None
) -> subprocess.Popen[str]:
    return subprocess.Popen(
        words(place, name, out),
        stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        encoding="utf-8", errors="replace", preexec_fn=before,
    )  # fmt: skip


def ended(run: subprocess.Popen[str], *codes: int) -> str:
    said = run.communicate(timeout=PATIENCE)[1]
    assert run.returncode in codes, said
    return said


def assert_whole(earlier: Path, out: Path) -> None:
    """Every file of the earlier result is there, as it was, set aside, or new and whole."""
    for path in sorted(path for path in earlier.iterdir() if path.is_file()):
        now = out / path.name
        places = (now, out / WAITING)
        kept = [place.read_bytes() for place in places if place.is_file()]
        assert kept, now
        if path.name == ".lock" or ".part" in path.name or path.read_bytes() in kept:
            continue
        if now.suffix == ".json":
            json.loads(now.read_text())
        elif now.suffix == ".html":
            assert now.read_text().rstrip().endswith("</html>")
        elif now.suffix in (".h5", ".vtkhdf"):
            with h5py.File(now) as file:
                file.visititems(lambda _, entry: entry[()] if hasattr(entry, "shape") else None)
        elif ".nii" in now.name:
            np.asarray(nibabel.Nifti1Image.from_filename(now).dataobj)
        else:
            assert now.stat().st_size > 0, now


@pytest.mark.parametrize("name", COMMANDS)
def test_a_signal_at_any_moment(place: Path, tmp_path: Path, name: str) -> None:
    began = time.perf_counter()
    ended(start(place, name, place / name), 0)
    seconds = time.perf_counter() - began
    moments = np.random.default_rng(11).uniform(0.02, 1.0, 9) * seconds
    kinds = (signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
    for number, (wait, kind) in enumerate(zip(moments, 3 * kinds, strict=True)):
        out = tmp_path / str(number)
        shutil.copytree(place / name, out)
        run = start(place, name, out)
        time.sleep(wait)
        run.send_signal(kind)
        # 3 where a library was loading; a signal where there was no handler yet, or Python passes
        # on the interrupt that it makes of each
        try:
            ended(run, 0, 1, 2, 3, -kind, 128 + kind, -signal.SIGINT)
        except AssertionError as ends:
            # other libraries may abort if interrupted while they load
            assert run.returncode == -signal.SIGABRT and "cannot be loaded" in str(ends)
        assert_whole(place / name, out)


@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk(place: Path, tmp_path: Path, name: str) -> None:
    """Limits on the size of files stand for full disks."""
    for size in np.geomspace(1, 3e5, 6).astype(int).tolist():
        out = tmp_path / str(size)
        shutil.copytree(place / name, out)
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
        assert "Traceback" not in ended(start(place, name, out, limit), 0, 1, 2)
        assert_whole(place / name, out)
