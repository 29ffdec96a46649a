"""Files as people, scanners and converters leave them: read right, or refused."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nibabel
import numpy as np
import pydicom
from scipy.spatial.transform import Rotation

from benchmarks.tables.grids import HALVES, grid, shuffled
from benchmarks.tables.real_images import measured_run
from benchmarks.truths.scanners import MAKERS, gradient_table, stack, weighted, write_gradients
from myork.core.deck import load_deck
from myork.errors import MyorkError
from myork.imaging.diffusion import dyads_of, fit_tensors, read_diffusion
from myork.imaging.gradients import GradientTable
from myork.imaging.headers import read_header
from myork.imaging.io import read_labels, write_image, write_labels
from myork.imaging.phantom import make_phantom
from myork.records import Image
from myork.stations.data import data_overrides
from myork.stations.folder import deck_of_folder
from myork.stations.resample import resample
from myork.types import F64

#: What a tensor may be off after its signals were rounded [mm^2/s]
_ROUNDED = 3e-5


def paths(half: str) -> Iterator[tuple[str, ...]]:
    """Files as they leave scanners, converters and other programs: read right, or refused.

    BIDS trees with visits, runs, acquisitions, derivatives, echoes and tables of gradients beside
    the images or in a folder above; trees of several subjects, which must be refused; masks of
    Dafne, half of them for images whose axes are stored in another order; diffusion series of DICOM
    as Siemens, Philips and GE write b values and directions, and as the standard has them, in any
    oblique planes; files that a deck names, below `--data`, where another subject may have files of
    the same names, which must be refused. A case is right if the intended files are read, with
    tensors to the rounding of their signals, and echo times and labels exactly. For comparison, a
    script of a few lines: it takes the first file with the right ending and the tables beside it,
    arrays as stored with rows and columns exchanged, DICOM's standard elements, the first file of a
    name.
    """
    yield "files", "cases", "right", "refused", "wrong", "script right"
    for place, (kind, case) in enumerate(CASES.items()):
        counts = dict.fromkeys(("right", "refused", "wrong", "script"), 0)
        for number in HALVES[half]:
            random = np.random.default_rng([100 + place, number])
            with TemporaryDirectory() as folder:
                read, script = case(Path(folder), random)
                try:
                    word = "right" if read() else "wrong"
                except MyorkError:
                    word = "refused"
                counts[word] += 1
                # a script of a few lines fails where something is not as it expects
                with suppress(IndexError, KeyError, OSError, ValueError, np.linalg.LinAlgError):
                    counts["script"] += bool(script())
        yield kind, str(len(HALVES[half])), *map(str, counts.values())


#: Whether a case is read right, by ours and by a script
Answers = tuple[Callable[[], bool], Callable[[], bool]]


def _tensor(random: np.random.Generator) -> F64:
    """A tensor of muscle, its fibers anywhere, shape `(6,)` [mm^2/s]."""
    fiber = random.normal(size=3)
    fiber /= np.linalg.norm(fiber)
    return 1e-3 * (1.2 * np.array([1.0, 1, 1, 0, 0, 0]) + 0.8 * dyads_of(fiber))


def _is(found: Image, tensor: F64) -> bool:
    return bool(np.abs(found.data - tensor).max() < _ROUNDED)


def _tree(folder: Path, subject: str, random: np.random.Generator, tensor: F64) -> dict[str, Any]:
    """A subject of a BIDS tree; what is to be found in it."""
    visit = ["ses-1"] if random.random() < 0.5 else []
    name = "_".join([f"sub-{subject}", *visit])
    home = folder.joinpath(f"sub-{subject}", *visit)
    runs = ["_run-1", "_run-2"] if random.random() < 0.5 else [""]
    like = grid(random, turned=bool(random.integers(2)))
    like = Image(like.data[:8, :8, :8], like.affine)
    for part in ("anat", "dwi"):
        (home / part).mkdir(parents=True)
    wanted = {"anatomy": home / "anat" / f"{name}{runs[0]}_T1w.nii.gz"}
    for run in runs:
        grey = random.uniform(1.0, 900.0, like.data.shape)
        write_image(home / "anat" / f"{name}{run}_T1w.nii.gz", Image(grey, like.affine))
    # what a program made of the same image
    made = folder.joinpath("derivatives", "prep", f"sub-{subject}", *visit, "anat")
    made.mkdir(parents=True)
    write_image(made / f"{name}_desc-preproc_T1w.nii.gz", like)
    labels = random.integers(0, 3, like.data.shape).astype(float)
    write_image(made / f"{name}_dseg.nii.gz", Image(labels, like.affine))
    (made / f"{name}_dseg.tsv").write_text("index\tname\n1\tsoleus\n2\ttibialis\n")
    wanted["labels"] = made / f"{name}_dseg.nii.gz"
    table = gradient_table(int(random.integers(6, 20)), float(random.integers(400, 800)))
    signal = weighted(np.full(like.data.shape, 2000.0), tensor, table)
    acquisition = "_acq-ep2d" if random.random() < 0.5 else ""
    dwi = home / "dwi" / f"{name}{acquisition}_dwi.nii.gz"
    write_image(dwi, Image(signal, like.affine))
    above = [
        (home / "dwi", dwi.name.split(".")[0]),
        (folder, "dwi"),
        (folder / f"sub-{subject}", f"sub-{subject}_dwi"),
    ]
    write_gradients(*above[random.integers(3)], table, like.affine)
    wanted["dwi"] = dwi
    return wanted


def _bids(folder: Path, random: np.random.Generator) -> Answers:
    """One subject with labels and diffusion."""
    tensor = _tensor(random)
    wanted = _tree(folder / "study", "01", random, tensor)

    def read() -> bool:
        deck = load_deck(deck_of_folder(folder / "study", folder / "out")[0])
        dwi, table = read_diffusion(Path(deck["image"]["dwi"]))
        labels = Path(deck["build"]["labels"])
        return (
            Path(deck["image"]["anatomy"]) == wanted["anatomy"].resolve()
            and labels == wanted["labels"].resolve()
            and read_labels(labels).names == {1: "soleus", 2: "tibialis"}
            and _is(fit_tensors(dwi, table), tensor)
        )

    def script() -> bool:
        first = {
            end: sorted((folder / "study").rglob(f"*_{end}.nii.gz"))[0] for end in ("T1w", "dwi")
        }
        image: Any = nibabel.load(first["dwi"])
        b, g = (np.loadtxt(str(first["dwi"]).replace("nii.gz", end)) for end in ("bval", "bvec"))
        table = GradientTable(b, g.T @ (image.affine[:3, :3] / image.header.get_zooms()[:3]).T)
        found = fit_tensors(Image(image.get_fdata(), image.affine), table)
        return first["T1w"] == wanted["anatomy"] and _is(found, tensor)

    return read, script


def _echoes(folder: Path, random: np.random.Generator) -> Answers:
    """Magnitude and phase of several echoes, times in files of their own or of all parts."""
    count, home = int(random.integers(2, 11)), folder / "study" / "sub-01" / "anat"
    home.mkdir(parents=True)
    times = np.cumsum(random.uniform(0.9, 1.6, count))
    both = random.random() < 0.5
    field = float(random.choice([1.5, 3.0]))
    (folder / "study" / "MEGRE.json").write_text(json.dumps({"MagneticFieldStrength": field}))
    for echo in random.permutation(count):
        stem = f"sub-01_echo-{echo + 1}"
        for part in ("mag", "phase"):
            write_image(
                home / f"{stem}_part-{part}_MEGRE.nii.gz", Image(np.ones((4, 4, 2)), np.eye(4))
            )
            own = stem if both else f"{stem}_part-{part}"
            (home / f"{own}_MEGRE.json").write_text(json.dumps({"EchoTime": times[echo] / 1000}))

    def order(files: list[Path]) -> bool:
        return [int(path.name.split("echo-")[1].split("_")[0]) for path in files] == [
            n + 1 for n in range(count)
        ]

    def read() -> bool:
        table = load_deck(deck_of_folder(folder / "study", folder / "out")[0])["dixon"]
        found = [read_header(Path(one)) for one in table["magnitude"]]
        return (
            all(order([Path(one) for one in table[key]]) for key in ("magnitude", "phase"))
            and np.allclose([one.echo_time or 0.0 for one in found], times)
            and all(one.field == field for one in found)
        )

    def script() -> bool:
        files = sorted(home.glob("*part-mag_MEGRE.nii.gz"))
        beside = [json.loads(Path(str(one).replace("nii.gz", "json")).read_text()) for one in files]
        return order(files) and np.allclose([1000 * one["EchoTime"] for one in beside], times)

    return read, script


def _subjects(folder: Path, random: np.random.Generator) -> Answers:
    """Several subjects or visits: which one is not said."""
    for number in range(int(random.integers(2, 5))):
        _tree(folder / "study", f"{number + 1:02d}", random, _tensor(random))

    def read() -> bool:
        deck_of_folder(folder / "study", folder / "out")
        return False

    return read, lambda: False


def _dafne(folder: Path, random: np.random.Generator) -> Answers:
    """Masks drawn on the screen, of an image whose axes are stored in any order."""
    screen = np.diag([-random.uniform(0.8, 2), -random.uniform(0.8, 2), random.uniform(3, 9), 1.0])
    shown = random.integers(0, 4, (7, 6, 5))  # columns, rows, slices
    names = ("Gastrocnemius", "Soleus", "Tibialis")
    image = Image(shown.astype(float), screen)
    image = shuffled(image, random) if random.random() < 0.5 else image
    write_image(folder / "t1.nii.gz", image)
    masks = {name: np.swapaxes(shown == n + 1, 0, 1) for n, name in enumerate(names)}
    np.savez(folder / "rois.npz", **masks)

    def read() -> bool:
        out = resample(folder / "rois.npz", folder / "t1.nii.gz", folder / "out.nii.gz")
        found = read_labels(out)
        return found.names == dict(enumerate(names, 1)) and np.array_equal(found.data, image.data)

    def script() -> bool:
        found = np.zeros(image.data.shape)
        for n, mask in enumerate(masks.values()):
            found[np.swapaxes(mask, 0, 1)] = n + 1
        return np.array_equal(found, image.data)

    return read, script


def _dicom(maker: str) -> Callable[[Path, np.random.Generator], Answers]:
    """A diffusion series of a maker."""

    def case(folder: Path, random: np.random.Generator) -> Answers:
        tensor = _tensor(random)
        axes = Rotation.from_euler("xyz", random.uniform(-35, 35, 3), degrees=True).as_matrix()
        axes = axes[:, [0, 1, 2]] if random.random() < 0.7 else axes[:, [1, 2, 0]]
        table = gradient_table(int(random.integers(6, 13)), float(random.integers(400, 800)))
        shape = (*random.integers(3, 17, 2), 3)
        values = weighted(np.full(shape, 2000.0), tensor, table)
        stack(folder / "scan", values, axes, maker=maker, weighting=table)

        def read() -> bool:
            dwi, found = read_diffusion(folder / "scan")
            return _is(fit_tensors(dwi, found), tensor)

        def script() -> bool:
            slices = [pydicom.dcmread(path) for path in sorted((folder / "scan").iterdir())]
            b = np.array([float(one["DiffusionBValue"].value) for one in slices])
            g = np.array([one["DiffusionGradientOrientation"].value for one in slices])
            signal = np.array([float(one.pixel_array.mean()) for one in slices])
            found = fit_tensors(
                Image(signal[np.newaxis, np.newaxis, np.newaxis], np.eye(4)),
                GradientTable(b, g * [-1.0, -1.0, 1.0]),
            )
            return _is(found, tensor)

        return read, script

    return case


def _data(folder: Path, random: np.random.Generator) -> Answers:
    """Files below a folder: joined paths, names in any folder, names that two files have."""
    kind = int(random.integers(3))
    home = folder / "data" / "b" / "visit 1"
    names = ["b/visit 1/t1.nii.gz", "t1.nii.gz", "t1.nii.gz"]
    home.mkdir(parents=True)
    write_image(home / "t1.nii.gz", Image(np.ones((2, 2, 2)), np.eye(4)))
    if kind != 1:
        shutil.copytree(folder / "data" / "b", folder / "data" / "a")
    deck = folder / "deck.toml"
    deck.write_text(
        f'title = "t"\nunits = {{force = "N", length = "mm"}}\nscene.dimension = 3\n'
        f'image.anatomy = "{names[kind]}"\n'
    )

    def read() -> bool:
        (found,) = data_overrides(deck, folder / "data")
        return kind < 2 and found == f"image.anatomy={(home / 't1.nii.gz').resolve()}"

    def script() -> bool:
        return kind < 2 and sorted((folder / "data").rglob("t1.nii.gz"))[0] == home / "t1.nii.gz"

    return read, script


#: Kinds of files, and what writes a case
CASES: dict[str, Callable[[Path, np.random.Generator], Answers]] = {
    "BIDS: labels and diffusion": _bids,
    "BIDS: echoes": _echoes,
    "BIDS: several subjects": _subjects,
    "Dafne": _dafne,
    **{f"DICOM: {maker}": _dicom(maker) for maker in MAKERS},
    "`--data`": _data,
}


def folders() -> Iterator[tuple[str, ...]]:
    """A folder of images instead of a deck, run from an empty folder: its output and cost.

    A calf (the phantom, 96 x 96 x 15 voxels, T1 image and twelve diffusion directions, SNR 25): as
    a BIDS tree with a label map of its six muscles in `derivatives`, and as DICOM files of two
    Siemens series in one folder. The output lists how each file was used, forces and the verdict.
    """
    yield "typed", "exit", "said", "wall [s]", "CPU [s]", "memory [MB]"
    leg, table = make_phantom(), gradient_table(12)
    signal = weighted(leg.still.data, leg.clean_tensor.data, table)
    noise = np.random.default_rng(1).normal(0.0, 16.0, (2, *signal.shape))
    images = {
        "anat": ("T1w", leg.anatomy.data),
        "dwi": ("dwi", np.hypot(signal + noise[0], noise[1])),
    }
    with TemporaryDirectory() as place:
        home, empty = Path(place).resolve(), Path(place, "empty").resolve()
        empty.mkdir()
        # columns to the right and rows to the front, as the axes of the phantom
        axes = np.diag([-1.0, -1.0, 1.0])
        for number, (folder, (suffix, data)) in enumerate(images.items(), start=3):
            path = home / "study" / "sub-01" / folder / f"sub-01_{suffix}.nii.gz"
            path.parent.mkdir(parents=True)
            write_image(path, Image(data, leg.anatomy.affine))
            weights = table if suffix == "dwi" else None
            stack(home / "scan", np.swapaxes(data, 0, 1), axes, number=number, weighting=weights,
                  spacing=leg.anatomy.spacing.tolist(), SeriesDescription=suffix)  # fmt: skip
        write_gradients(home / "study" / "sub-01" / "dwi", "sub-01_dwi", table, leg.anatomy.affine)
        drawn = home / "study" / "derivatives" / "sub-01_dseg.nii.gz"
        drawn.parent.mkdir()
        write_labels(drawn, leg.truth)
        names = "".join(f"{label}\t{name}\n" for label, name in leg.truth.names.items())
        drawn.with_name("sub-01_dseg.tsv").write_text(f"index\tname\n{names}")
        for name in ("study", "scan"):
            words = ["run", f"../{name}"]
            run = measured_run(words, empty)
            last = next(n for n, line in enumerate(run.said) if line.startswith("deck:"))
            doubts = sum(line.startswith("warning") for line in run.said)
            verdicts = ("accepted", "doubtful", "refused")
            end = [line for line in run.said[last:] if "+-" in line]
            end += [line.split(":")[0] for line in run.said if line.startswith(verdicts)]
            said = [line.replace(f"{home}/", "").strip() for line in [*run.said[1:last], *end]]
            said.insert(last - 1, f"{doubts} warnings")
            numbers = (f"{one:.0f}" for one in (run.wall, run.cpu, run.memory))
            yield f"`myork {' '.join(words)}`", str(run.status), "; ".join(said), *numbers
