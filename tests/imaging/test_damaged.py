"""Damaged files by the commands themselves: refused by name, or read as they should be.

The files are made by `myork.reference.faults_images`.
"""

import re
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from myork.cli import main
from myork.core.deck import text_of_tables
from myork.errors import MyorkError
from myork.imaging.io import read_image
from myork.model.mesh import read_tracts, voxelise
from myork.reference.faults_images import image_faults, sound_image

KINDS = ("nifti", "gzip", "values", "place", "nrrd", "metaimage", "dicom", "labels", "names",
         "gradients", "tensor", "dwi")  # fmt: skip

# Each is read in a process of its own; on the last four VTK ends that process.
SURFACES = ("text.ply", "open.obj", "nan.obj", "far.obj", "many.vtk", "many.ply", "many.vtp",
            "no-corner.vtk")  # fmt: skip


@pytest.fixture(scope="module")
def faults(tmp_path_factory):
    return image_faults(tmp_path_factory.mktemp("damaged"))


def of_kind(faults, *kinds):
    found = [fault for fault in faults if not fault.huge and fault.name.split("-")[0] in kinds]
    assert found
    return found


def command(fault, folder):
    """Words of the command that reads a damaged file."""
    deck = folder / "deck.toml"
    deck.write_text(text_of_tables(fault.tables), encoding="utf-8")
    return [fault.command, str(deck), "--out", str(folder / "out"), "-q"]


def what_is_wrong(fault, status, said):
    """What is wrong with an outcome, nothing if it is right."""
    if status == 0:
        return "" if fault.message is None else f"{fault.name}: accepted"
    if status != 2 or "internal error" in said:
        return f"{fault.name}: exit {status}: {said}"
    # Names of labels are read with their map; what a reference leaves is told of the image.
    others = (fault.path.with_suffix(".nii.gz").name, "image.reference")
    if fault.path.name not in said and not any(name in said for name in others):
        return f"{fault.name}: does not name the file: {said}"
    if fault.message is not None and not re.search(fault.message, said):
        return f"{fault.name}: does not say '{fault.message}': {said}"
    return ""


def test_there_are_many_and_each_has_a_name(faults):
    assert len(faults) >= 300 and len({fault.name for fault in faults}) == len(faults)
    assert set(KINDS) | {"tracts", "surface"} == {fault.name.split("-")[0] for fault in faults}
    refused = [fault for fault in faults if fault.message is not None]
    assert len(refused) > 200


@pytest.mark.parametrize("kind", KINDS)
def test_images_end_in_a_named_error_or_a_result(faults, kind, tmp_path, capsys):
    wrong = []
    for fault in of_kind(faults, kind):
        status = main(command(fault, tmp_path))
        wrong.append(what_is_wrong(fault, status, capsys.readouterr().err))
    assert not any(wrong), "\n".join(filter(None, wrong))


def test_what_is_accepted_after_random_damage_is_an_image(faults):
    sound, accepted = sound_image(), 0
    for fault in of_kind(faults, "nifti", "gzip", "nrrd", "metaimage"):
        if "flip" not in fault.name:
            continue
        try:
            image = read_image(fault.path)
        except MyorkError:
            continue
        accepted += 1
        assert image.data.shape == sound.shape, fault.name
        if "packed" in fault.name or "gzip" in fault.name:
            assert np.array_equal(image.data, sound), fault.name
    assert accepted


def test_tracts_end_in_a_named_error_or_lines(faults):
    wrong = []
    for fault in of_kind(faults, "tracts"):
        try:
            lines, status, said = read_tracts(fault.path, 1.0), 0, ""
            assert all(np.isfinite(line).all() and len(line) > 1 for line in lines)
        except MyorkError as error:
            status, said = error.exit_code, str(error)
        if fault.name != "tracts-elsewhere":  # told where the surface is known
            wrong.append(what_is_wrong(fault, status, said))
    assert not any(wrong), "\n".join(filter(None, wrong))


def test_surfaces_end_in_a_named_error_or_labels(faults):
    def outcome(fault):
        try:
            labels = voxelise(fault.path, 1.0, (8.0, 8.0, 8.0), "muscle")
        except MyorkError as error:
            return what_is_wrong(fault, error.exit_code, str(error))
        assert labels.data.any()
        return what_is_wrong(fault, 0, "")

    some = [fault for fault in faults if fault.name.removeprefix("surface-") in SURFACES]
    assert len(some) == len(SURFACES)
    with ThreadPoolExecutor(2) as pool:
        wrong = list(pool.map(outcome, some))
    assert not any(wrong), "\n".join(filter(None, wrong))


def test_lines_elsewhere_and_damaged_meshes_by_the_command(faults, tmp_path, capsys):
    for name in ("tracts-elsewhere", "surface-many.vtp"):
        fault = next(fault for fault in faults if fault.name == name)
        status = main(command(fault, tmp_path))
        assert not what_is_wrong(fault, status, capsys.readouterr().err)


# Reads all files named on the command line, then tells the largest memory it held [MB]
LIMITED = """
import resource, sys
from pathlib import Path
import pydicom, SimpleITK
from myork.errors import MyorkError
from myork.imaging.gradients import read_gradients
from myork.imaging.io import read_image
from myork.model.mesh import read_tracts
resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))
before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
for name in sys.argv[1:]:
    path = Path(name)
    try:
        if path.suffix == ".npz":
            read_tracts(path, 1.0)
        elif path.suffix == ".bval":
            read_gradients(path, path, None, 8)
        else:
            read_image(path)
        print(f"{path.name} accepted")
    except MyorkError as error:
        print(f"{path.name}: {error.exit_code} {str(error).startswith(name)} {error}")
print((resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024)
"""


def test_files_that_promise_too_much_take_no_memory(faults):
    huge = [fault for fault in faults if fault.huge]
    assert len(huge) >= 8
    paths = [str(fault.path) for fault in huge]
    done = subprocess.run(
        [sys.executable, "-c", LIMITED, *paths], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    *lines, memory = done.stdout.splitlines()
    for fault, line in zip(huge, lines, strict=True):
        assert line.startswith(f"{fault.path.name}: 2 True"), line
        assert re.search(fault.message, line), line
    assert float(memory) < 100.0


def test_the_command_in_a_process_of_its_own(faults, tmp_path):
    # Its reader ended the process by a signal.
    fault = next(fault for fault in faults if fault.name == "metaimage-thousand-axes")
    done = subprocess.run(
        [sys.executable, "-m", "myork", *command(fault, tmp_path)],
        capture_output=True, text=True, timeout=120,
    )  # fmt: skip
    assert not what_is_wrong(fault, done.returncode, done.stderr)
    assert done.returncode == 2 and done.stderr.count("\n") == 1


def test_a_reader_of_surfaces_that_does_not_end_is_stopped(faults, monkeypatch):
    monkeypatch.setattr("myork.model.mesh_file._SECONDS", 1e-3)
    fault = next(fault for fault in faults if fault.name == "surface-flat.obj")
    with pytest.raises(MyorkError, match=r"flat.obj: cannot be read: the reader did not end"):
        voxelise(fault.path, 1.0, (8.0, 8.0, 8.0), "muscle")


def test_sound_files_of_all_kinds_are_accepted(faults, tmp_path):
    """What the damaged files are made of is no damage itself."""
    folder = faults[0].path.parent.parent
    for path in (folder / "nifti" / "sound.nii", folder / "volumes" / "dicom-sound"):
        image = read_image(path)
        np.testing.assert_allclose(image.spacing, [2.0, 2.0, 5.0])
    labels = voxelise(folder / "meshes" / "sound.obj", 1.0, (4.0, 4.0, 4.0), "muscle")
    assert labels.data.sum() * 64.0 == pytest.approx(4 / 3 * 20 * 20 * 30, rel=0.1)
