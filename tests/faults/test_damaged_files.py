"""Damaged files and little memory: refused by name or read, without a crash, hang or traceback."""

import io
import json
import os
import re
import resource
import shutil
import signal
import subprocess
import sys
import time
import zlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import nibabel
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from myork import ReducedModel, Scene, make_report, run_deck, run_rom
from myork.core.deck import load_deck, text_of_tables
from myork.errors import FileError, InputError, MyorkError
from myork.files import INPUTS
from myork.imaging.gradients import read_gradients
from myork.imaging.io import read_image, read_labels
from myork.model.mesh import read_tracts
from myork.model_file import read_model, write_model
from myork.results import Results
from myork.stations.segment import segment
from myork.stations.solve import find_executable
from myork.summary import WAITING
from tests.faults.damage import ARRAY, BYTES, SETTINGS, TEXT, Edit, damaged
from tests.imaging.test_formats import series
from tests.scenes import deck_file, myork, refuses, strip
from tests.unit.test_scene_from_tables import BLOCK, PULLED, cloud

AFFINE = np.diag([2.0, 2.0, 5.0, 1.0])
FAT = '[[material]]\nname = "fat"\nlabel = 2\nmodel = "neo-hookean"\nmu = 1.0\nK = 100.0\n'
BAR = strip(5, 4, load={"steps": 3}, rom={"modes": [1, 2]})


def disc() -> np.ndarray:
    """A bright disc with a dark one in it, in air, with a little noise."""
    i, j, _ = np.indices((32, 32, 2)) - 15.5
    image = np.select([np.hypot(i, j - 6.4) < 6.2, np.hypot(i, j) < 14], [120.0, 300.0], 2.0)
    noise = np.random.default_rng(3).normal(0.0, 4.0, image.shape)
    return np.abs(image + noise).astype(np.float32)


def segmented(**files: Path) -> dict[str, Any]:
    """Deck of two regions, which takes some tenths of a second."""
    image = {"tolerance": 0.1, **{key: str(path) for key, path in files.items()}}
    return {"scene": {"dimension": 3}, "image": image, "bias": {"method": "none"}}


def explained(deck: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """The executable also stops cleanly."""
    done = subprocess.run(
        [find_executable(), deck, "--explain", "-o", deck.parent,
         *(word for text in words for word in ("--set", text))],
        capture_output=True, text=True, errors="replace", timeout=50,
    )  # fmt: skip
    wrong = re.search("internal error|runtime error|ERROR STOP", done.stderr)
    assert done.returncode in (0, 2) and not wrong, (done.returncode, done.stderr)
    return done


def explain(deck: Path) -> None:
    done = explained(deck)
    assert done.returncode == 0 or str(deck.parent) in done.stderr, done.stderr


def read_deck(path: Path) -> None:
    explain(path)
    load_deck(path)


def read_cloud(path: Path) -> None:
    explain(path.with_name("deck.toml"))
    read_model(path)


def read_grey(path: Path) -> None:
    image = read_image(path)
    assert np.isfinite(image.data).all()
    if path.suffix == ".gz":  # the checksum detects any other change
        assert np.array_equal(image.data, disc())


def read_names(path: Path) -> None:
    labels = read_labels(path.with_suffix(".nii"))
    assert all(isinstance(name, str) for name in labels.names.values())


def read_table(path: Path) -> None:
    files = [path.with_name(f"sound.{kind}") for kind in ("bval", "bvec")]
    table = read_gradients(*files, AFFINE, 8)
    assert np.isfinite(table.b).all() and np.isfinite(table.direction).all()


def read_states(path: Path) -> None:
    with Results(path) as results:
        for number in range(results.nstep):
            results.restart(number)
            for name in results.fields:
                results.field(name, number)


def use_rom(path: Path) -> None:
    """A model that is read gives answers: the checksum detects any other change."""
    rom = ReducedModel.load(path, threads=1)
    assert rom.solve(**{p.key: 0.5 * (p.low + p.high) for p in rom.parameters}).converged


#: Faults that the executable does not read or check, labels beyond 32 bits, which no material has,
#: names that match no condition, which it accepts, and columns without names
ALONE = ("source_images", "label_names", "label'", "length_unit", "'utf-8' codec", "null character",
         "'fraction' has shape")  # fmt: skip
FORMS = ("rkpm-scni", "rkpm-gauss", "rkcm")


def solve_model(path: Path) -> None:
    """Python and the executable both accept a model or both refuse it; accepted ones are solved."""
    content, deck = path.read_bytes(), path.with_suffix(".toml")
    # collocation needs slopes of activations, which it does not have
    forms = FORMS[: 2 if path.stem == "active" else 3]
    form = forms[zlib.crc32(content) % len(forms)]
    words = [f"scene.method={form}", f"geometry.file={path}"]
    if form == "rkcm":
        words += ["approximation.order=2", "approximation.support=3"]
    refused, said = explained(deck, *words).returncode == 2, ""
    try:
        read_model(path)
    except (InputError, FileError) as error:
        said = str(error)
        assert said.startswith(f"{path}: "), said
        assert refused or any(name in said for name in ALONE), said
    try:
        with Scene(deck, words) as scene:
            scene.solve(error=bool(zlib.crc32(content) % 2))
    except MyorkError as error:
        raise InputError(f"{path}: {error}") from error
    assert said or not refused, "only the executable refuses it"


read_lines = partial(read_tracts, to_mm=1.0)

#: For each kind: the function that reads its files, and damage to them
KINDS: dict[str, tuple[Callable[[Path], Any], st.SearchStrategy[Edit]]] = {
    "deck": (read_deck, BYTES | TEXT), "model": (read_cloud, BYTES), "rom": (use_rom, BYTES),
    "voxels": (solve_model, ARRAY), "nifti": (read_grey, BYTES), "gzip": (read_grey, BYTES),
    "dicom": (read_image, BYTES), "names": (read_names, BYTES | TEXT),
    "gradients": (read_table, BYTES | TEXT), "tracts": (read_lines, BYTES | ARRAY),
    "states": (read_states, BYTES | ARRAY), "summary": (make_report, BYTES | TEXT),
    "results": (make_report, BYTES | ARRAY),
}  # fmt: skip
#: Kinds read as a folder, slower kinds, and files that accompany the damaged one
FOLDERS = ("dicom", "summary", "results")
SHARE = {"rom": 4, "voxels": 4, **dict.fromkeys(FOLDERS, 10)}
PAGE = "report.html"  # written into the folder that is read
BESIDE = ("model/deck.toml", "names/sound.nii",
          "voxels/plain.toml", "voxels/active.toml", "voxels/both.toml")  # fmt: skip
#: Nightly cases of a kind; 4000 are a thousand of a model
CASES = int(os.environ.get("MYORK_CASES", "400"))
#: Kinds in which a missing part must always be noticed
WHOLE = ("model", "nifti", "dicom", "tracts", "states", "results")


@pytest.fixture(scope="module")
def sound(tmp_path_factory: pytest.TempPathFactory, voxel_rom: Path) -> Path:
    """A folder of each kind with sound files."""
    top = tmp_path_factory.mktemp("files")
    for kind in KINDS:
        (top / kind).mkdir()
    for deck in INPUTS.glob("*.toml"):
        if not re.search('"model"|.nii', deck.read_text()):
            shutil.copy(deck, top / "deck")
    write_model(top / "model" / "model.h5", cloud())
    (top / "model" / "deck.toml").write_text(text_of_tables(BLOCK))
    shutil.copy(voxel_rom, top / "rom")
    muscle = read_model(voxel_rom.with_name("model.h5"))
    n, deck = len(muscle.points), voxel_rom.with_name("muscle.toml").read_text()
    shares = {"fraction": np.tile([0.7, 0.3], (n, 1)), "label_names": {1: "muscle", 2: "fat"}}
    active = {"activation": np.full(n, 0.5)}
    for name, more in {"plain": {}, "active": active, "both": shares}.items():
        write_model(top / f"voxels/{name}.h5", replace(muscle, **more))
        (top / f"voxels/{name}.toml").write_text(deck + FAT * (name == "both"))
    for name in ("nifti/sound.nii", "gzip/sound.nii.gz"):
        nibabel.save(nibabel.Nifti1Image(disc(), AFFINE), top / name)
    series(top / "dicom")
    nibabel.save(nibabel.Nifti1Image(np.ones((2, 2, 2), "u1"), AFFINE), top / "names/sound.nii")
    (top / "names/sound.json").write_text('{"soleus": 1, "tibialis": 2}')
    np.savetxt(top / "gradients/sound.bval", [[0] + [500] * 7], fmt="%g")
    np.savetxt(top / "gradients/sound.bvec", np.eye(3)[:, np.arange(8) % 3], fmt="%.3f")
    np.savez_compressed(top / "tracts/sound.npz", points=np.tile(LINES, (3, 1)), offsets=[0, 7, 14])
    for run in (run_deck, run_rom):
        run(BAR, top, threads=1)
    for kind, name in (("states", "results.vtkhdf"), ("summary", "summary.json"),
                       ("results", "results.vtkhdf")):  # fmt: skip
        shutil.copy(top / name, top / kind)
    return top


@pytest.fixture(scope="module", autouse=True)
def little_memory() -> Iterator[None]:
    """Larger allocations fail here, without affecting the machine."""
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (16 << 30, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_AS, before)


def refusal(path: Path, edits: Sequence[Edit]) -> str:
    """Error message for a damaged file, empty if it is read; restores the sound file."""
    content, kind = path.read_bytes(), path.parent.name
    path.write_bytes(damaged(content, edits))
    try:
        KINDS[kind][0](path.parent if kind in FOLDERS else path)
    except MyorkError as error:
        assert error.exit_code == 2 and str(path.parent) in str(error)
        return str(error)
    finally:
        path.write_bytes(content)
    return ""


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("count", [
    pytest.param(20, marks=pytest.mark.slow), pytest.param(CASES, marks=pytest.mark.nightly),
])  # fmt: skip
def test_any_damage(sound: Path, kind: str, count: int) -> None:
    files = sorted((sound / kind).iterdir())
    paths = [p for p in files if p.name != PAGE and f"{kind}/{p.name}" not in BESIDE]
    refused = []

    @settings(SETTINGS, max_examples=count // SHARE.get(kind, 1))
    @given(st.sampled_from(paths), st.lists(KINDS[kind][1], min_size=1, max_size=3))
    def ends_well(path: Path, edits: list[Edit]) -> None:
        refused.append(bool(refusal(path, edits)))
        assert refused[-1] or kind not in WHOLE or [how for how, *_ in edits] != ["cut"]

    for path in paths:
        assert not refusal(path, []), path
    ends_well()
    # not every number has an effect
    assert any(refused) and (count < 400 or kind != "voxels" or not all(refused))


def text(new: str) -> list[Edit]:
    return [("all", 0, new.encode())]


def lines(points: np.ndarray, offsets: list[float]) -> list[Edit]:
    np.savez(stream := io.BytesIO(), points=points, offsets=offsets)
    return [("all", 0, stream.getvalue())]


LINES = np.column_stack([np.zeros((7, 2)), np.linspace(-30.0, 30.0, 7)])
#: Damage to the file of a kind, and the message
ONCE: list[tuple[str, list[Edit], str]] = [
    ("dicom/1.dcm", [("cut", 140, None)], "has no data behind its header"),
    *(("names/sound.json", text(names), "must contain|twice") for names in (
        '{"a": 1.5}', '{"a": -1}', '{"a": 1e999}', '{"a": NaN}', '{"a": true}', '{"a": 1, "b": 1}',
        '{"a": {"b": 1}}', '{"a": 1, "a": 2}', '{"a": ' + "9" * 5000 + "}")),
    ("gradients/sound.bval", text("0" + " 5e8" * 7), "is implausible"),
    ("gradients/sound.bval", text("0" + " 0.5" * 7), "no b value is above 50 s/mm"),
    ("gradients/sound.bvec", text("1e300 1 1 1 1 1 1 1\n" * 3), "must be unit vectors"),
    ("tracts/sound.npz", lines(LINES * 1j, [0, 7]), "of numbers"),
    ("tracts/sound.npz", lines(LINES, [0, 3.5, 7]), "offsets integers that rise"),
    ("tracts/sound.npz", lines(LINES, [0, 70]), "offsets integers that rise"),
    ("tracts/sound.npz", lines(np.array(5.0), [0, 7]), "points must be"),
    ("tracts/sound.npz", lines(LINES[:0], [0]), "contains no lines"),
    ("tracts/sound.npz", lines(LINES * 0, [0, 7]), "all points of each line coincide"),
]  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize(("name", "edits", "said"), ONCE)
def test_damage_that_ended_badly_once(sound: Path, name: str, edits: list[Edit], said: str) -> None:
    assert re.search(said, refusal(sound / name, edits) or "it is read")


@pytest.mark.parametrize("name", ["missing", "folder", "pipe", "loop"])
def test_places_without_a_file(tmp_path: Path, name: str) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for read in (read_image, load_deck, read_model, read_lines):
        refuses(str(tmp_path / name), read, tmp_path / name, kind=MyorkError)


def with_one(value: float) -> np.ndarray:
    image = disc().astype(float)
    image[4, 5, 1] = value
    return image


DARK = ((disc() > 60) & (disc() < 200)).astype(np.int16)
CORNER = np.pad([[[1, 1]]], ((0, 31), (0, 31), (0, 0)))


@pytest.mark.parametrize(("key", "values", "message"), [
    ("anatomy", with_one(1e300), "1 values are beyond"),
    ("anatomy", with_one(1e20), "the file is damaged there"),
    ("anatomy", -disc(), "no value is above zero"),
    ("anatomy", np.ones_like(disc()), "contrast"),
    ("anatomy", disc() * 1j, "values are complex"),
    ("anatomy", np.zeros(DARK.shape, [(name, "u1") for name in "RGB"]), "values are colours"),
    ("anatomy", disc()[:1, :1, :1], "no body found"),
    ("reference", 0 * DARK, "the reference is empty"),
    ("reference", CORNER, "the segmentation is empty"),
    ("reference", DARK.astype(np.int64) * 2**40, "must not exceed"),
    ("truth", 0 * DARK, "the truth is empty"),
    ("truth", DARK * 1j, "values are complex"),
    ("region", 0 * DARK, "the region is empty"),
    *(("tensor", np.full((32, 32, 2, 6), value), "no usable diffusion tensor")
      for value in (np.nan, np.inf, 0.0, -1.0)),
])  # fmt: skip
def test_impossible_values(tmp_path: Path, key: str, values: np.ndarray, message: str) -> None:
    images = {"anatomy": disc(), key: values}
    paths = {name: tmp_path / f"{name}.nii" for name in images}
    for name, data in images.items():
        nibabel.save(nibabel.Nifti1Image(data, AFFINE, dtype=data.dtype), paths[name])
    kind = (InputError, FileError)  # exit status 2
    said = refuses(message, segment, segmented(**paths), tmp_path / "out", kind=kind)
    assert str(tmp_path) in said


# ---- models, words, memories and environments on which the executable once crashed ---------------


PATIENCE = 60


def run(*words: str | Path, **more) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [find_executable(), *words], capture_output=True, text=True, timeout=PATIENCE, **more
    )


def asked(folder: Path, *words: str, **more) -> subprocess.CompletedProcess[str]:
    return run(deck_file(folder / "deck.toml", BLOCK), "--explain", "-o", folder, *words, **more)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    write_model(tmp_path / "model.h5", cloud())
    return tmp_path


def limited(size: int) -> dict[str, Callable[[], None]]:
    """Options of a process with a limited address space [bytes]."""
    return {"preexec_fn": lambda: resource.setrlimit(resource.RLIMIT_AS, (size, size))}


@pytest.mark.slow
def test_many_names_take_little_memory(model: Path) -> None:
    """20,000 names, each of which once took the space of all of them: 4 GB."""
    names = "z0\nz1\n" + "\n".join(f"set {i}" for i in range(20_000))
    with h5py.File(model / "model.h5", "r+") as file:
        del file["set_names"]
        file["set_names"] = np.frombuffer(names.encode(), np.uint8)
    done = asked(model, **limited(1_500_000_000))
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
    assert re.search(said, asked(tmp_path).stderr)
    refuses(said, Scene, tmp_path / "deck.toml", kind=FileError)


@pytest.mark.parametrize("kind", ["source", "points"])
def test_two_points_in_one_place(tmp_path: Path, kind: str) -> None:
    """Refused by number and place, from a file and from arrays."""
    points = getattr(cloud(), kind).copy()
    points[9] = points[3] + 1e-9
    body = replace(cloud(), **{kind: points})
    what = f"{'source' if kind == 'source' else 'collocation'} points 4 and 10 at (0, "
    write_model(tmp_path / "model.h5", body)
    done = asked(tmp_path)
    assert done.returncode == 2 and what in done.stderr and "are the same" in done.stderr
    refuses(re.escape(what), Scene.from_tables, PULLED, cloud=body)


@pytest.mark.parametrize("name", ["points", "fiber", "set_names"])
def test_one_wrong_bit_of_a_model_is_noticed(model: Path, name: str) -> None:
    """By the executable and by Python; most such bits still give a possible body."""
    file = model / "model.h5"
    with h5py.File(file) as content:
        place = content[name].id.get_chunk_info(0).byte_offset
    changed = bytearray(file.read_bytes())
    changed[place + 1] ^= 1
    file.write_bytes(changed)
    assert re.search(f"{file}.*{name}.*Fletcher32", asked(model).stderr)
    refuses(f"{file}: .*filter returned failure", read_model, file, kind=FileError)


def test_exponents_of_three_digits_keep_their_letter(model: Path) -> None:
    asked(model)
    words = ["-v", "-o", model, "--set", "material.A10=1e115", "--set", "material.K=1e117"]
    done = run(model / "deck.toml", *words)
    assert re.search(r"iteration 1  \|r\|  \d\.\dE\+10\d  \|A'r\|  \d\.\dE\+2\d\d  ", done.stdout)
    source = cloud().source.copy()
    source[[3, 9]] = 0.5, -1e-123, 0.375
    write_model(model / "model.h5", replace(cloud(), source=source))
    done = asked(model)
    assert done.returncode == 2 and "(0.5, -1E-123, 0.375)" in done.stderr


def test_threads_of_the_environment(model: Path) -> None:
    many = {**os.environ, "OMP_NUM_THREADS": "100000", "PYTHONPATH": os.pathsep.join(sys.path)}
    assert asked(model, "-t", "2", env=many).returncode == 0
    done = asked(model, env=many)
    assert done.returncode == 2 and "OMP_NUM_THREADS is 100000" in done.stderr
    assert "OMP_NUM_THREADS is 100000" in myork("explain", model / "deck.toml", env=many).stderr


@pytest.mark.parametrize("word", ["--help", "--version"])
def test_the_executable_answers_questions(word: str) -> None:
    done = run(word)
    assert done.returncode == 0 and "myork-solve" in done.stdout


@pytest.mark.parametrize(("words", "message"), [
    (["-t", "100000"], "-t 100000: the number of threads must be between 1 and 1024"),
    (["--threads", "0"], "--threads 0: the number of threads must be between 1 and 1024"),
    (["--threads"], "--threads needs a value"),
    (["--out"], "--out needs a value"),
    (["--set", "load.steps=2\nload.activation=1"], "an override must be a single line"),
])  # fmt: skip
def test_words_of_the_executable(model: Path, words: list[str], message: str) -> None:
    done = asked(model, *words)
    assert done.returncode == 2 and message in done.stderr


def test_texts_of_a_deck() -> None:
    """A null character truncated a text; half a megabyte took 15 s."""
    for tables, said in (
        ({"title": "a\0b"}, r"title: must not contain the character .u0000"),
        ({"title": "x" * 500_000}, "title: must not be longer than 4096 bytes, not 500000"),
        ({"x" * 500_000: 1}, r"tables: x{100,200}\.\.\.: unknown"),
    ):
        refuses(said, load_deck, tables)


def test_little_memory_is_refused_at_once(model: Path) -> None:
    little = limited(300_000_000)
    for done in (asked(model, **little), myork("explain", model / "deck.toml", **little)):
        assert done.returncode == 2 and "ulimit -v" in done.stderr


# ---- signals and full disks: an earlier result is kept whole, whoever wrote it -------------------


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
    """Every file of the earlier result is there: unchanged, set aside, or new and whole."""
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


@pytest.mark.nightly
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
        # 3 while a library was loading; a signal if there was no handler yet, or Python passes
        # on the interrupt that it makes of each
        try:
            ended(run, 0, 1, 2, 3, -kind, 128 + kind, -signal.SIGINT)
        except AssertionError as ends:
            # other libraries may abort if interrupted while they load
            assert run.returncode == -signal.SIGABRT and "cannot be loaded" in str(ends)
        assert_whole(place / name, out)


@pytest.mark.nightly
@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk(place: Path, tmp_path: Path, name: str) -> None:
    """Limits on the file size simulate full disks."""
    for size in np.geomspace(1, 3e5, 6).astype(int).tolist():
        out = tmp_path / str(size)
        shutil.copytree(place / name, out)
        limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (size, size))
        assert "Traceback" not in ended(start(place, name, out, limit), 0, 1, 2)
        assert_whole(place / name, out)


@pytest.mark.slow
def test_no_array_of_a_model_lies_in_another_file(sound: Path) -> None:
    """Python and the executable refuse the link, also for optional arrays of a model."""
    for number in range(12):
        assert refusal(sound / "voxels" / "active.h5", [("array", number, "another file")]), number
