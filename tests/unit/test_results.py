"""Files: h5py, VTK and PyVista read what Fortran writes; models; whole files or none."""

import json
import shutil
import sys
from dataclasses import replace
from operator import attrgetter
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from myork import Scene, model_file
from myork.cli import main
from myork.core.material import Material, stress
from myork.errors import FileError, InstallationError
from myork.files import alone_in, check_writable, read_json, whole_file, write_json
from myork.imaging.io import write_image
from myork.model_file import write_model
from myork.records import Image, PointCloud, Voxels
from myork.results import Results
from myork.stations.solve import run_deck
from myork.sweeps.store import Store
from tests import scenes
from tests.scenes import MUSCLE, box, deck_file, execute, held, refuses, scene, start, stop_behind
from tests.unit.test_scene_from_tables import cloud

LOADS = [0.0, 1 / 3, 2 / 3, 1.0]
DIRECTION = [0.0, 0.6, 0.8]
#: A muscle in simple shear u_x = load y, u_z = 2 load y: homogeneous, and F differs from F^T
DECK = scene(
    "rkpm-gauss", box(3, 3, 3, size=[1, 2, 3]), title="sample", approximation=scenes.LINEAR,
    material=[{**MUSCLE, "fiber": DIRECTION}],
    boundary=[{"set": f"{a}{k}", "u_x": "y", "u_y": 0, "u_z": "2*y"} for a in "xyz" for k in "01"],
    load={"steps": 3, "activation": 0.3}, solver={"tolerance": 1e-10},
)  # fmt: skip


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("sample")
    run_deck(DECK, out, threads=1, error=False)
    return out / "results.vtkhdf"


def shear(load: float) -> np.ndarray:
    """Deformation gradient of the sample."""
    return np.array([[1.0, load, 0.0], [0.0, 1.0, 0.0], [0.0, 2 * load, 1.0]])


def cauchy(load: float) -> np.ndarray:
    """Cauchy stress of the sample, as a matrix."""
    law, f = Material.of_table(DECK["material"][0]), shear(load)
    return stress(law, f[None], fiber=DIRECTION, activation=0.3 * load)[0] @ f.T


def matrices(values: np.ndarray) -> np.ndarray:
    xx, yy, zz, xy, yz, xz = np.asarray(values).T
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]).transpose(2, 0, 1)


def test_reads_what_was_written(sample: Path) -> None:
    with Results(sample.parent) as results, Scene.from_tables(DECK, threads=1) as opened:
        n = results.npoint
        assert (results.nstep, n) == (4, 125)
        assert_array_equal(results.points, opened.points())
        assert_array_equal(results.label, np.ones(n))
        assert_array_equal(results.fiber, [DIRECTION] * n)
        assert_allclose(results.loads, LOADS, rtol=1e-15)
        assert_allclose(results.activations, [0.0, 0.1, 0.2, 0.3], rtol=1e-15)
        for step, load in enumerate(LOADS):
            right = cauchy(load)
            near = 1e-9 * max(1.0, np.abs(right).max())
            moved = results.points @ shear(load).T
            assert_allclose(results.field("F", step), [shear(load)] * n, atol=1e-11)
            assert_allclose(results.deformed(step), moved, atol=1e-11)
            assert_array_equal(results.deformed(step), results.points + results.field("u", step))
            assert_allclose(results.field("cauchy", step), [right] * n, atol=near)
            assert_allclose(results.field("pressure", step), -np.trace(right) / 3, atol=near)
            assert_allclose(results.field("J", step), 1.0, atol=1e-11)
            principal = [np.linalg.eigvalsh(right)[::-1]] * n
            assert_allclose(results.field("principal_stress", step), principal, atol=near)
        assert_array_equal(results.field("label"), results.label)
        state, middle = results.restart(), results.restart(1)
        assert_array_equal(state.coefficients, opened.solve(error=False).x[-1])
    assert (state.step, state.load) == (3, 1.0)
    assert not np.array_equal(middle.coefficients, state.coefficients)
    assert middle.activation == pytest.approx(0.1, rel=1e-15)


def test_vtk_sees_a_time_series(sample: Path) -> None:
    """VTK's reader, also used by ParaView, shows vertices and the numbers of every step."""
    import pyvista
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(sample))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert reader.GetNumberOfSteps() == 4
    assert_allclose(times, LOADS, rtol=1e-15)
    with Results(sample) as results:
        for step, load in enumerate(LOADS):
            reader.SetStep(step)
            reader.Update()
            grid = pyvista.wrap(reader.GetOutputDataObject(0))
            assert grid.n_points == grid.n_cells == results.npoint
            assert set(grid.celltypes) == {pyvista.CellType.VERTEX}
            assert_array_equal(grid.points, results.points)
            assert_allclose(grid["F"], [shear(load).ravel()] * grid.n_points, atol=1e-11)
            assert_allclose(grid.warp_by_vector("u").points, results.deformed(step), rtol=1e-14)
            assert_array_equal(matrices(grid["cauchy"]), results.field("cauchy", step))
            assert_array_equal(grid["label"], results.label)
            assert_array_equal(grid["fiber"], results.fiber)


def test_points_of_a_step_for_pyvista(sample: Path) -> None:
    with Results(sample) as results:
        for step in range(results.nstep):
            cloud = results.to_pyvista(step)
            assert cloud.n_points == cloud.n_verts == results.npoint
            assert_array_equal(cloud.regular_faces, results.surface)
            assert_array_equal(cloud.points, results.points)
            assert set(cloud.point_data.keys()) == set(results.fields)
            assert_array_equal(cloud.point_data["u"], results.field("u", step))
            assert_array_equal(cloud.point_data["F"], results.field("F", step).reshape(-1, 9))
            assert cloud.field_data["load"][0] == results.loads[step]
        moved = results.to_pyvista(-1, deformed=True)
        assert_array_equal(moved.points, results.deformed(-1))


@pytest.mark.parametrize(("name", "call"), [
    ("pyvista", Results.to_pyvista), ("pandas", Results.history),
])  # fmt: skip
def test_what_is_missing_names_its_cure(sample, monkeypatch, name, call) -> None:
    # None in the table of modules makes an import fail
    monkeypatch.setitem(sys.modules, name, None)
    extra = {"pyvista": "viz"}.get(name, name)
    with Results(sample) as results:
        refuses(
            rf"needs {name}: pip install 'myork\[{extra}", call, results, kind=InstallationError
        )


def test_summary_beside_the_results(sample: Path, tmp_path: Path) -> None:
    """Probes by name, and a table of all with their bars."""
    shutil.copy(sample, tmp_path)
    path = tmp_path / "summary.json"
    with Results(tmp_path) as results:
        refuses(r"summary\.json: cannot", results.probe, "end", kind=FileError)
    steps = [
        {"load": 0.5, "iterations": 3, "probes": {"p": 1.0, "f": [1, 2, 3]}, "probe_errors": {}},
        {"load": 1.0, "iterations": 2, "probes": {"p": 2.0, "f": [4, 5, 6]},
         "probe_errors": {"p": 0.1, "f": [0.1, 0.2, 0.3]}},
    ]  # fmt: skip
    path.write_text(json.dumps({"steps": steps}))
    with Results(tmp_path) as results:
        loads, values = results.probe("f")
        assert_array_equal(loads, [0.5, 1.0])
        assert_array_equal(values, [[1, 2, 3], [4, 5, 6]])
        refuses("no probe 'start'; its probes:", results.probe, "start")
        table = results.history()
    assert list(table.index) == [1, 2] and list(table["load"]) == [0.5, 1.0]
    assert list(table["f_z"]) == [3, 6]
    assert table["p_error"][2] == 0.1 and np.isnan(table["f_y_error"][1])
    path.write_text('{"steps": [')
    with Results(tmp_path) as results:
        refuses("not a complete JSON", results.probe, "p", kind=FileError)


def test_refuses_what_is_not_there(sample: Path, tmp_path: Path) -> None:
    with Results(sample) as results:
        refuses("no field 'stress'; available: F, J, cauchy", results.field, "stress")
        refuses("no step 4; the last one is 3", results.field, "u", 4)
        refuses("no step 9", results.to_pyvista, 9)
    (tmp_path / "cut.h5").write_bytes(sample.read_bytes()[:-1000])
    h5py.File(tmp_path / "foreign.h5", "w").close()
    for path, said in (
        (tmp_path, r"results\.vtkhdf: no such file; run 'myork solve'"),
        (tmp_path / "cut.h5", r"cut\.h5: cannot be opened as an HDF5"),
        (tmp_path / "foreign.h5", r"foreign\.h5: not a result file of"),
    ):
        refuses(said, Results, path, kind=FileError)
    (tmp_path / "results.vtkhdf.part").write_bytes(b"")
    said = r"results\.vtkhdf\.part is what an interrupted run"
    refuses(said, Results, tmp_path, kind=FileError)


def test_closed_results_and_steps_between_two_are_no_damage(sample: Path) -> None:
    results = Results(sample)
    for step in (1.5, "1", None):
        refuses("no step", results.field, "u", step)
    points = results.points
    results.close()
    assert_array_equal(results.points, points)
    for call in (lambda: results.field("u"), lambda: results.loads, lambda: results.lattice):
        refuses("are closed", call)


@pytest.mark.parametrize("place", ["far", "flat"])
def test_a_lattice_that_does_not_fit(sample: Path, tmp_path: Path, place: str) -> None:
    path = Path(shutil.copy(sample, tmp_path))
    with h5py.File(path, "r+") as file:
        values = file["MyoRK/lattice"][()]
        del file["MyoRK/lattice"]
        values[0, :2] = -(2**31), 2**31 - 1
        file["MyoRK/lattice"] = values if place == "far" else values[:, :2] * 0
    with Results(path) as results:
        refuses("lattice does not fit", lambda: results.lattice, kind=FileError)


def test_a_killed_run_leaves_whole_steps(tmp_path: Path) -> None:
    """They can be recovered from the file it left."""
    deck = deck_file(tmp_path / "deck.toml", {**DECK, "load": {"steps": 400}})
    stop_behind(start(deck, tmp_path, "--no-error"))
    with Results(tmp_path / "results.vtkhdf.part") as results:
        assert results.nstep > 2
        for step in range(results.nstep):
            assert_allclose(results.field("F", step), [shear(step / 400)] * 125, atol=1e-11)


CLOUD = PointCloud(
    source=np.arange(6.0).reshape(2, 3), spacing=np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0]]),
    points=np.arange(9.0).reshape(3, 3) / 7, label=np.array([1, 2, 2], np.int32),
    fiber=np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    volume=np.full(3, 0.25 * 0.5 * 2.0), boundary_point=np.array([0, 2, 2], np.int32),
    boundary_set=np.array([0, 0, 1], np.int32), area=np.array([4.0, 5.0, 6.0]),
    normal=np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
    set_names=("bottom", "top"), label_names={1: "muscle", 2: "fat"}, length_unit="mm",
    source_images="phantom",
    voxels=Voxels(np.array([[5, -1, 2], [6, 0, 2], [8, 0, 3]], np.int32),
                  np.array([0.25, 0.5, 2.0]), np.array([0.1, -3.0, 7.0])),
)  # fmt: skip


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A small model as `myork build` writes it."""
    path = tmp_path / "model.h5"
    write_model(path, CLOUD)
    return path


def refused(path: Path) -> str:
    """Error message of the core about a model."""
    tables = scene(
        "rkpm-scni", {"kind": "model", "file": str(path)}, material=[MUSCLE],
        boundary=[held("bottom")], units={"force": "N", "length": "mm"},
    )  # fmt: skip
    deck = deck_file(path.with_name("deck.toml"), {"title": "model", **tables})
    _, done = execute(deck, path.parent, "--explain")
    assert done.returncode == 2
    return done.stderr


def test_model_round_trip(model: Path) -> None:
    """Names are those of the record; the core reads the same (test_scene_from_tables.py)."""
    again = model_file.read_model(model)
    for name in (
        "source", "spacing", "points", "fiber", "volume", "normal", "area", "label",
        "boundary_point", "boundary_set", "voxels.index", "voxels.size", "voxels.origin",
    ):  # fmt: skip
        assert_array_equal(*(attrgetter(name)(cloud) for cloud in (again, CLOUD)))
    for name in ("set_names", "label_names", "length_unit", "source_images"):
        assert getattr(again, name) == getattr(CLOUD, name)
    write_model(model, replace(CLOUD, voxels=None, length_unit="µm"))
    again = model_file.read_model(model)
    assert again.voxels is None and again.length_unit == "µm"


@pytest.mark.parametrize(("dataset", "value", "message"), [
    ("volume", None, "dataset 'volume': it is missing"),
    ("fiber", np.ones((2, 3)), "'fiber' does not have the numbers"),
    ("points", np.full((3, 3), np.nan), "'points' does not have the numbers"),
    ("boundary_point", np.array([0, 3, 1]), "'boundary_point' does not have"),
    ("volume", -np.ones(3), "'volume' does not have the numbers"),
    ("source", np.ones(6), "'source': it has 1 dimension(s), but 2 are needed"),
    ("voxels/index", np.full((3, 3), -(2**30)), "'voxels/index' does not have"),
    ("voxels/size", np.array([1.0, 0.0, 1.0]), "'voxels/size' does not have"),
    ("source", np.ones((0, 3)), "'source' does not have the numbers"),
    ("label", np.array([1.5, 2.0, 2.0]), "'label': it does not hold integers"),
    # as in a damaged header: far more numbers than bytes; none is stored here
    *(("points", shape, "shape declares far more numbers than the file contains")
      for shape in ((10**6, 3), (2**57, 3))),
    ("format", np.frombuffer(b"myork-model 7", np.uint8), "not a model written by 'myork build'"),
    *(("length_unit", value, "'length_unit': it ") for value in (
        np.array([b"mm"] * 2000), 7, h5py.Empty("S10"))),
])  # fmt: skip
def test_bad_models_are_refused(model: Path, dataset: str, value: Any, message: str) -> None:
    """Datasets that are missing or wrong."""
    with h5py.File(model, "a") as file:
        del file[dataset]
        if isinstance(value, tuple):
            file.create_dataset(dataset, value, chunks=(1000, 3), dtype=float)
        elif value is not None:
            file[dataset] = value
    error = refused(model)
    assert f"{model}: " in error and message in error


# ---- files that are complete or absent -----------------------------------------------------------


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


def test_a_file_that_cannot_be_written_is_refused_before_the_training(tmp_path, capsys):
    check_writable(tmp_path / "a.rom.h5")
    assert not any(tmp_path.iterdir())
    deck = deck_file(tmp_path / "deck.toml", DECK)
    for path, said in ((tmp_path, "it is a folder"), (tmp_path / ("x" * 300), "File name too")):
        assert (
            main(["rom", "train", str(deck), "--vary", "load.activation=0:1", "-o", str(path)]) == 2
        )
        assert f"{path}: cannot be written: {said}" in capsys.readouterr().err


def lay(path: Path, how: str) -> Path:
    """Replace an output by a link to another file; returns that file."""
    theirs = path.parent / "theirs"
    theirs.write_text("theirs")
    (path.symlink_to if how == "link" else path.hardlink_to)(theirs)
    return theirs


def _store(folder: Path) -> Store:
    """Store of a sweep of two points, which is never read."""
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
    """The link is replaced, and the file behind it is unchanged."""
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
