"""Damaged reduced models and models: refused by name, or solved without a crash.

Reduced models keep a right checksum. Cases are numbers: the same number is the same damage.
MYORK_CASES says how many of each there are.
"""

import io
import json
import os
import subprocess
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from myork import ReducedModel, Scene
from myork.errors import FileError, InputError, MyorkError
from myork.model_file import read_model, write_model
from myork.rom import store
from myork.stations.solve import find_executable
from tests.faults.isolated import Verdict, isolated

CASES = int(os.environ.get("MYORK_CASES", "100"))
#: Longest time of a case [s]
PATIENCE = 60.0

REALS = (np.nan, np.inf, -np.inf, -1.0, 0.0, 1.0, 1e-3, 1e6, 1e19, 1e300, -1e300, 1e-300)
WHOLES = (-1, 0, 1, 2, 7, 64, 1000, 10**6, -(2**31), 2**31 - 1)
ODD: tuple[Any, ...] = (
    None, True, -1, 0, 1, 7, 10**6, 2**31, 1e308, 10**300, "", "x", "force", [], [None], {}, [[1]],
    float("nan"), "é" * 100,
)  # fmt: skip

CLAIMED = (2**40, 8)

Random = np.random.Generator


def choice(random: Random, of: Any) -> Any:
    return list(of)[int(random.integers(len(of)))]


def damage_entries(random: Random, values: np.ndarray) -> np.ndarray:
    """Other numbers at one place, at several or at all of them."""
    values = values.copy()
    if values.dtype.kind == "S" or values.size == 0:
        return values
    several = random.integers(values.size, size=int(random.integers(1, 20)))
    where: Any = (several[:1], several, slice(None))[int(random.integers(3))]
    how = random.integers(4)
    if values.dtype == np.uint8 or how == 0:
        values.flat[where] = random.permutation(values.ravel())[: np.size(values.flat[where])]
    elif how == 1 and values.dtype.kind in "if":
        values.flat[where] = -values.flat[where]
    elif values.dtype.kind == "f":
        values.flat[where] = choice(random, REALS)
    else:
        values.flat[where] = choice(random, WHOLES)
    return values


def damage_array(random: Random, file: h5py.File, name: str) -> str:
    """Another dataset in place of one, or none."""
    values = file[name][()]
    flat = np.atleast_1d(values)
    others: dict[str, Any] = {
        "other numbers": damage_entries(random, np.asarray(values)),
        "missing": None,
        "empty": flat[:0],
        "scalar": flat.flat[0] if flat.size else 0.0,
        "one less": flat[:-1],
        "one more": np.concatenate([flat, flat[:1]]),
        "flat": flat.reshape(-1),
        "deep": flat.reshape((1,) * 6 + flat.shape),
        "transposed": flat.T,
        "last axis less": flat[..., :-1],
        "texts": np.array([b"a"] * max(1, len(flat))),
        "texts of any length": np.array(["x"], dtype=h5py.string_dtype()),
        "complex": np.zeros(flat.shape, complex),
        "compound": np.zeros(flat.shape, [("a", "f8"), ("b", "i4")]),
        "opaque": np.zeros(flat.shape, "V3"),
        "nothing": h5py.Empty("f8"),
        "logical": np.zeros(flat.shape, bool),
        "group": {},
        "link": h5py.SoftLink("/nowhere"),
        "another file": h5py.ExternalLink("/dev/zero", "/x"),
    }
    if flat.dtype.kind in "iufb":
        others |= {
            kind: flat.astype(kind) for kind in ("f2", "f4", ">f8", "f16", "i1", "i4", "i8", "u8")
        }
    if random.random() < 0.4:
        what = "other numbers"
    else:
        what = choice(random, others)
    del file[name]
    if what == "group":
        file.create_group(name)
    elif what == "missing":
        pass
    elif random.random() < 0.1:
        what = "claimed"
        file.create_dataset(name, CLAIMED, chunks=(1000, 8), dtype=float)
    elif random.random() < 0.1 and np.ndim(others[what]) > 0 and np.size(others[what]) > 0:
        file.create_dataset(name, data=others[what], compression="gzip")
        what += ", compressed"
    else:
        file[name] = others[what]
    return f"{name} {what}"


def damage_tree(random: Random, tree: Any) -> str:
    """Another entry at some place of the head."""
    at, way = tree, []
    while True:
        keys = list(at) if isinstance(at, dict) else list(range(len(at)))
        if not keys:
            return "nothing"
        way.append(choice(random, keys))
        inside = at[way[-1]]
        if not isinstance(inside, dict | list) or not inside or random.random() < 0.3:
            break
        at = inside
    if random.random() < 0.3:
        del at[way[-1]]
        return f"head {way} missing"
    old, new = at[way[-1]], choice(random, ODD)
    if type(old) in (int, float) and random.random() < 0.5:
        new = choice(random, (old + 1, old - 1, -old, 2 * old))
    at[way[-1]] = new
    return f"head {way} is {str(new)[:20]}"


def damage_head(random: Random, file: h5py.File) -> str:
    tree = json.loads(bytes(file["head"][()]))
    what = damage_tree(random, tree)
    text = json.dumps(tree).encode()
    if random.random() < 0.1:
        what, text = choice(
            random,
            {
                "no text": b"\xff\xfe",
                "null": b"null",
                "deep": b"[" * 10**5,
                "cut": text[:300],
            }.items(),
        )
    del file["head"]
    file["head"] = np.bytes_(text)
    return what


def damage_attribute(random: Random, file: h5py.File, name: str) -> str:
    others: dict[str, Any] = {
        "missing": None,
        "number": 3.0,
        "texts": np.array([b"myork"] * 1000),
        "texts of any length": np.array(["x" * 5000] * 3, dtype=h5py.string_dtype()),
        "long": np.bytes_(b"m" * 60_000),
        "other": "Länge",
        "nothing": h5py.Empty("S5"),
    }
    what = choice(random, others)
    del file.attrs[name]
    if what != "missing":
        file.attrs[name] = others[what]
    return f"attribute {name} {what}"


def names_of(file: h5py.File) -> list[str]:
    found: list[str] = []
    file.visititems(
        lambda name, item: found.append(name) if isinstance(item, h5py.Dataset) else None
    )
    return found


def values_of(file: h5py.File) -> dict[str, np.ndarray]:
    """All arrays but those that claim more than any memory holds."""
    return {n: np.asarray(file[n][()]) for n in names_of(file) if file[n].shape != CLAIMED}


def damage_rom(number: int, content: bytes, path: Path) -> str:
    """Write a damaged reduced model with a right checksum; what was done to it."""
    random = np.random.default_rng((29, number))
    held = io.BytesIO(content)
    with h5py.File(held, "r+") as file:
        names = names_of(file)
        how = random.random()
        if how < 0.02:
            what = damage_attribute(random, file, "format")
        elif how < 0.2:
            what = damage_head(random, file)
        elif how < 0.3:
            inside = path.with_suffix(".inside")
            inside.write_bytes(file["cloud"][()].tobytes())
            what = f"cloud: {damage_model(number, inside)}"
            del file["cloud"]
            file["cloud"] = np.frombuffer(inside.read_bytes(), np.uint8)
        elif how < 0.34:
            one, two = choice(random, names), choice(random, names)
            file.move(one, "kept")
            if two != one:
                file.move(two, one)
            file.move("kept", two)
            what = f"{one} and {two} exchanged"
        elif how < 0.37:
            file[choice(random, ("more", "online/more", "places/more"))] = np.ones(3)
            what = "one more array"
        else:
            groups = sorted({name.split("/")[0] for name in names} - {"head", "cloud"})
            group = choice(random, groups)
            own = [name for name in names if name.split("/")[0] == group]
            what = damage_array(random, file, choice(random, own))
        if how >= 0.02:
            try:
                values = {}
                file.visititems(
                    lambda name, item: (
                        values.update({name: np.asarray(item[()])})
                        if isinstance(item, h5py.Dataset) and item.shape != (2**40, 8)
                        else None
                    )
                )
                file.attrs["sha256"] = np.bytes_(store._checksum(values))
            except (TypeError, ValueError, OSError):
                # of what has no numbers there is no checksum
                what += ", without a checksum"
    path.write_bytes(held.getvalue())
    return what


def damage_model(number: int, path: Path) -> str:
    """Damage a model; what was done to it."""
    random = np.random.default_rng((31, number))
    with h5py.File(path, "r+") as file:
        names = names_of(file)
        if random.random() < 0.05:
            what = damage_attribute(
                random, file, choice(random, ("format", "length_unit", "source_images"))
            )
        else:
            # grids are what is checked last
            own = [n for n in names if n.startswith("voxels") or random.random() < 0.5]
            what = damage_array(random, file, choice(random, own))
    return what


def use(rom: ReducedModel) -> None:
    """All that a reduced model answers."""
    values = np.array([[0.5 * (p.low + p.high) for p in rom.parameters]] * 3)
    rom.batch(values + 0.1 * rom._scale * np.arange(3)[:, None], indicator=True)
    rom.batch(values, corrections=0)
    state = rom.state(dict(zip([p.key for p in rom.parameters], values[0], strict=True)))
    state.u()
    assert state.describe() and rom.describe() and rom._repr_html_() and state._repr_html_()
    try:
        with rom.full_model().open(["load.steps=1"]) as scene:
            scene.fields(rom.basis @ state._amplitudes, 1.0)
    except MyorkError:
        # a deck that is no deck any more
        pass


def open_rom(item: tuple[int, str, str]) -> Verdict:
    number, sound, place = item
    path = Path(place)
    what = damage_rom(number, Path(sound).read_bytes(), path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            rom = ReducedModel.load(path, threads=1)
        except (InputError, FileError) as error:
            if not str(error).startswith(f"{path}: "):
                return Verdict("internal", f"{what}: names no file: {error}")
            return Verdict("refused", f"{what}: {error}")
        use(rom)
    return Verdict("right", what)


#: What the executable does not read or limits, and labels beyond 32 bits, which no material has
ALONE = ("source_images", "label_names", "label ", "length_unit long")


def open_model(item: tuple[int, str, str, str]) -> Verdict:
    """Python and the executable take a damaged model, or both refuse it."""
    number, sound, method, place = item
    path = Path(place, "model.h5")
    path.write_bytes(Path(sound).read_bytes())
    what = damage_model(number, path)
    deck = Path(sound).with_suffix(".toml")
    words = [f"scene.method={method}", f"geometry.file={path}"]
    command = [find_executable(), deck, "--explain", "-o", place]
    done = subprocess.run(
        [*command, *(word for text in words for word in ("--set", text))],
        capture_output=True, text=True, errors="replace", timeout=PATIENCE,
    )  # fmt: skip
    if done.returncode not in (0, 2):
        return Verdict("crash", f"{what}: {done.returncode} {done.stderr[-500:]}")
    said = ""
    try:
        read_model(path)
    except (InputError, FileError) as error:
        said = str(error)
        if not said.startswith(f"{path}: "):
            return Verdict("internal", f"{what}: names no file: {said}")
    refused = done.stderr.startswith(f"{path}: ")
    if bool(said) != refused and not any(name in what for name in ALONE):
        return Verdict("lost", f"{what}: {said or 'taken'}, but {done.stderr[-500:]}")
    try:
        with Scene(deck, words) as scene:
            scene.solve(error=bool(number % 2))
    except MyorkError as error:
        said = str(error)
    return Verdict("refused" if said else "right", f"{what}: {said}")


def judge(check: Any, items: list[Any]) -> None:
    verdicts = isolated(check, items, PATIENCE)
    told = [f"{n} {end.outcome}: {end.said}" for n, end in enumerate(verdicts)]
    if "MYORK_CASES" in os.environ:
        print("", *told, sep="\n")
    ends = [end.outcome for end in verdicts]
    assert not (set(ends) - {"right", "refused"}), [
        line for line, end in zip(told, ends, strict=True) if end not in ("right", "refused")
    ]
    assert set(ends) == {"right", "refused"}


@pytest.mark.nightly
def test_damaged_reduced_models(voxel_rom: Path, tmp_path: Path) -> None:
    use(ReducedModel.load(voxel_rom, threads=1))
    place = str(tmp_path / "damaged.rom.h5")
    judge(open_rom, [(number, str(voxel_rom), place) for number in range(CASES)])


METHODS = ("rkpm-scni", "rkpm-gauss", "rkcm", "rkcm-mixed")
FAT = '[[material]]\nname = "fat"\nlabel = 2\nmodel = "neo-hookean"\nmu = 1.0\nK = 100.0\n'


@pytest.mark.nightly
def test_damaged_models(voxel_rom: Path, tmp_path: Path) -> None:
    """Of muscle alone, with activations, and with fat beside muscle in each voxel."""
    cloud = read_model(voxel_rom.with_name("model.h5"))
    n = len(cloud.points)
    both = {"fraction": np.tile([0.7, 0.3], (n, 1)), "label_names": {1: "muscle", 2: "fat"}}
    deck = voxel_rom.with_name("muscle.toml").read_text()
    for name, more in {
        "plain": {},
        "active": {"activation": np.full(n, 0.5)},
        "both": both,
    }.items():
        write_model(tmp_path / f"{name}.h5", replace(cloud, **more))
        (tmp_path / f"{name}.toml").write_text(deck + FAT * (name == "both"))
    (tmp_path / "out").mkdir()
    items = [
        (k, str(tmp_path / f"{name}.h5"), METHODS[k // 3 % len(METHODS)], str(tmp_path / "out"))
        for k, name in enumerate((["plain", "active", "both"] * CASES)[:CASES])
    ]
    for _, sound, method, _ in items[:12]:
        # collocation does not know the slopes of activations
        if not (sound.endswith("active.h5") and method.startswith("rkcm")):
            words = [f"scene.method={method}", f"geometry.file={sound}"]
            with Scene(Path(sound).with_suffix(".toml"), words) as scene:
                scene.solve(error=False)
    judge(open_model, items)


def rewritten(path: Path, **changes: Any) -> None:
    """Change entries of a reduced model, by place, and write its checksum anew."""
    with h5py.File(path, "r+") as file:
        for name, (place, value) in changes.items():
            file[name][place] = value
        file.attrs["sha256"] = np.bytes_(store._checksum(values_of(file)))


@pytest.mark.parametrize("name", ["force/first", "force/tissue", "indicator/tissue"])
@pytest.mark.parametrize("value", [10**6, 2**31 - 1, -(2**31)])
def test_indices_that_ended_the_process(
    voxel_rom: Path, tmp_path: Path, name: str, value: int
) -> None:
    path = tmp_path / "wrong.rom.h5"
    path.write_bytes(voxel_rom.read_bytes())
    rewritten(path, **{name: (3, value)})
    with pytest.raises(InputError, match=rf"^{path}: '{name}' must hold .*entry 3 is {value}"):
        ReducedModel.load(path)


def test_shapes_and_types_are_under_the_checksum(voxel_rom: Path, tmp_path: Path) -> None:
    path = tmp_path / "wrong.rom.h5"
    for change in (lambda a: a.reshape(a.shape[::-1]), lambda a: a.view(np.int64)):
        path.write_bytes(voxel_rom.read_bytes())
        with h5py.File(path, "r+") as file:
            values = file["online/h"][()]
            del file["online/h"]
            file["online/h"] = change(values)
        with pytest.raises(FileError, match="its content is damaged"):
            ReducedModel.load(path)


def test_states_that_determine_no_function(voxel_rom: Path, tmp_path: Path) -> None:
    path = tmp_path / "wrong.rom.h5"
    path.write_bytes(voxel_rom.read_bytes())
    rewritten(path, **{"training/parameters": (slice(None), 0.1)})
    with pytest.raises(InputError, match=rf"^{path}: states of the training are the same"):
        ReducedModel.load(path)
