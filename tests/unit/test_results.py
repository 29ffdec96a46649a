"""Result files: what Fortran writes is what h5py, VTK and PyVista read; models go the other way."""

import json
import os
import resource
import shutil
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from myork import model_file
from myork.errors import FileError, InputError, InstallationError
from myork.model_file import write_model
from myork.records import PointCloud, Voxels
from myork.results import Results

ROOT = Path(__file__).parents[2]
POINTS = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 3.0]])
LOADS = [0.0, 1 / 3, 2 / 3, 1.0]


@pytest.fixture(scope="session")
def test_h5() -> Path:
    """tests/fortran/test_h5.f90, built in build/tests of the checkout."""
    build = ROOT / "build" / "tests"
    meson = [sys.executable, "-m", "mesonbuild.mesonmain"]
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for command in (
        [] if (build / "build.ninja").exists() else ["setup", str(build), "-Dpython=disabled"],
        ["compile", "-C", str(build), "test_h5"],
    ):
        if command:
            done = subprocess.run(
                [*meson, *command],
                cwd=ROOT,
                env={**os.environ, "PATH": path},
                capture_output=True,
                text=True,
            )
            assert done.returncode == 0, done.stdout + done.stderr
    return build / "tests" / "fortran" / "test_h5"


@pytest.fixture(scope="session")
def sample(test_h5: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Three points in simple shear u_x = load y, u_z = 2 load y; see the program."""
    path = tmp_path_factory.mktemp("sample") / "results.vtkhdf"
    subprocess.run([test_h5, "write", path], check=True)
    return path


def shear(load: float) -> np.ndarray:
    """Deformation gradient of the sample."""
    return np.array([[1.0, load, 0.0], [0.0, 1.0, 0.0], [0.0, 2 * load, 1.0]])


def cauchy(load: float, point: int) -> np.ndarray:
    """Cauchy stress of the sample, as a matrix."""
    xx, yy, zz, xy, yz, xz = load * np.arange(1.0, 7.0) + point
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


@pytest.mark.slow
def test_reads_what_was_written(sample: Path) -> None:
    with Results(sample.parent) as results:
        assert (results.nstep, results.npoint) == (4, 3)
        assert_array_equal(results.points, POINTS)
        assert_array_equal(results.label, [1, 1, 2])
        assert_array_equal(results.fiber, [[1, 0, 0], [0, 0.6, 0.8], [0, 0, 0]])
        assert_allclose(results.loads, LOADS, rtol=1e-15)
        assert_allclose(results.activations, [0.0, 0.1, 0.2, 0.3], rtol=1e-15)
        for step, load in enumerate(LOADS):
            assert_allclose(results.field("F", step), [shear(load)] * 3, rtol=1e-15)
            assert_allclose(results.deformed(step), POINTS @ shear(load).T, rtol=1e-15)
            for point in range(3):
                assert_allclose(
                    results.field("cauchy", step)[point], cauchy(load, point), rtol=1e-15
                )
            assert_allclose(results.field("pressure", step), [-load, -load - 1, -load - 2])
            assert_allclose(results.field("J", step), [1.0, 1.01, 1.02], rtol=1e-15)
        assert_allclose(results.field("principal_stress")[1], [4.0, 3.0, 2.0], rtol=1e-15)
        assert_array_equal(results.field("label"), results.label)


def test_restart_state(sample: Path) -> None:
    with Results(sample) as results:
        state = results.restart()
        middle = results.restart(1)
    assert (state.step, state.load, state.version) == (3, 1.0, "0.1.0")
    assert state.deck == 'title = "sample"\n'
    assert_array_equal(state.coefficients, [1.0, 2.0, 3.0, 4.0])
    assert_array_equal(state.source, POINTS[:2])
    assert_allclose(middle.coefficients, np.arange(1, 5) / 3, rtol=1e-15)
    assert middle.activation == pytest.approx(0.1, rel=1e-15)


def test_vtk_sees_a_time_series(sample: Path) -> None:
    """VTK's reader, which is ParaView's as well, shows vertices and every step's own numbers."""
    import pyvista
    from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(sample))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    assert reader.GetNumberOfSteps() == 4
    assert_allclose(times, LOADS, rtol=1e-15)
    for step, load in enumerate(LOADS):
        reader.SetStep(step)
        reader.Update()
        grid = pyvista.wrap(reader.GetOutputDataObject(0))
        assert (grid.n_points, grid.n_cells) == (3, 3)
        assert set(grid.celltypes) == {pyvista.CellType.VERTEX}
        assert_array_equal(grid.points, POINTS)
        assert_allclose(grid["F"], [shear(load).ravel()] * 3, rtol=1e-15)
        assert_allclose(grid.warp_by_vector("u").points, POINTS @ shear(load).T, rtol=1e-15)
        xx, yy, zz, xy, yz, xz = grid["cauchy"][2]
        assert_allclose([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]], cauchy(load, 2), rtol=1e-15)
        assert_array_equal(grid["label"], [1, 1, 2])
        assert_array_equal(grid["fiber"][1], [0, 0.6, 0.8])


def test_points_of_a_step_for_pyvista(sample: Path) -> None:
    with Results(sample) as results:
        for step in range(results.nstep):
            cloud = results.to_pyvista(step)
            assert cloud.n_points == cloud.n_verts == results.npoint
            assert_array_equal(cloud.points, results.points)
            assert set(cloud.point_data.keys()) == set(results.fields)
            assert_array_equal(cloud.point_data["u"], results.field("u", step))
            assert_array_equal(
                cloud.point_data["F"], results.field("F", step).reshape(results.npoint, 9)
            )
            assert cloud.field_data["load"][0] == results.loads[step]
        moved = results.to_pyvista(-1, deformed=True)
        assert_array_equal(moved.points, results.deformed(-1))
        with pytest.raises(InputError, match="no step 9"):
            results.to_pyvista(9)


def test_a_reader_of_pyvista_reaches_all_steps(sample: Path) -> None:
    import pyvista

    reader = pyvista.get_reader(sample)
    with Results(sample) as results:
        for step in range(results.nstep):
            reader.reader.SetStep(step)
            assert_allclose(reader.read().point_data["u"], results.field("u", step))


def test_what_is_missing_names_its_cure(sample: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # None in the table of modules is an import that fails
    for name, extra in (("pyvista", "viz"), ("pandas", "pandas")):
        monkeypatch.setitem(sys.modules, name, None)
        call = {"pyvista": Results.to_pyvista, "pandas": Results.history}[name]
        with (
            Results(sample) as results,
            pytest.raises(InstallationError, match=rf"needs {name}: pip install 'myork\[{extra}"),
        ):
            call(results)


def test_history_is_a_table(sample: Path, tmp_path: Path) -> None:
    shutil.copy(sample, tmp_path)
    steps = [
        {"load": 0.5, "iterations": 3, "probes": {"p": 1.0, "f": [1, 2, 3]}, "probe_errors": {}},
        {
            "load": 1.0,
            "iterations": 2,
            "probes": {"p": 2.0, "f": [4, 5, 6]},
            "probe_errors": {"p": 0.1, "f": [0.1, 0.2, 0.3]},
        },
    ]
    (tmp_path / "summary.json").write_text(json.dumps({"steps": steps}))
    with Results(tmp_path) as results:
        table = results.history()
    assert list(table.index) == [1, 2]
    assert list(table["load"]) == [0.5, 1.0]
    assert list(table["f_z"]) == [3, 6]
    assert table["p_error"][2] == 0.1
    assert np.isnan(table["f_y_error"][1])


def test_pyvista_reads_the_file(sample: Path) -> None:
    import pyvista

    grid = pyvista.read(sample)
    assert grid.n_points == 3
    assert {"u", "F", "J", "cauchy", "principal_stress", "pressure"} <= set(grid.point_data)


def test_geometry_is_stored_once(sample: Path) -> None:
    with h5py.File(sample) as file:
        vtk = file["VTKHDF"]
        assert vtk["Points"].shape == (3, 3)
        assert vtk["PointData/fiber"].shape == (3, 3)
        assert vtk["PointData/u"].shape == (12, 3)
        assert vtk.attrs["Type"] == b"UnstructuredGrid"
        assert vtk["PointData/u"].compression == "gzip"


def test_summary_beside_the_results(sample: Path, tmp_path: Path) -> None:
    (tmp_path / "results.vtkhdf").write_bytes(sample.read_bytes())
    with Results(tmp_path) as results, pytest.raises(FileError, match=r"summary\.json: cannot"):
        results.probe("end")
    steps = [{"load": 0.5, "probes": {"end": [1.0, 2.0, 3.0]}}, {"load": 1.0, "probes": {}}]
    (tmp_path / "summary.json").write_text(json.dumps({"steps": steps}))
    with Results(tmp_path) as results:
        loads, values = results.probe("end")
        assert_array_equal(loads, [0.5])
        assert_array_equal(values, [[1.0, 2.0, 3.0]])
        with pytest.raises(InputError, match="no probe 'start'; there are end"):
            results.probe("start")
    (tmp_path / "summary.json").write_text('{"steps": [')
    with Results(tmp_path) as results, pytest.raises(FileError, match="not a complete JSON"):
        results.probe("end")


def test_refuses_what_is_not_there(sample: Path, tmp_path: Path) -> None:
    with Results(sample) as results:
        with pytest.raises(InputError, match="no field 'stress'; there are F, J, cauchy"):
            results.field("stress")
        with pytest.raises(InputError, match="no step 4; the last one is 3"):
            results.field("u", 4)
    with pytest.raises(FileError, match=r"results\.vtkhdf: no such file; run 'myork solve'"):
        Results(tmp_path)
    (tmp_path / "results.vtkhdf.part").write_bytes(b"")
    with pytest.raises(FileError, match=r"results\.vtkhdf\.part is what an interrupted run"):
        Results(tmp_path)


def test_refuses_cut_and_foreign_files(sample: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.vtkhdf"
    cut.write_bytes(sample.read_bytes()[:-1000])
    with pytest.raises(FileError, match=r"cut\.vtkhdf: cannot be opened as an HDF5 file"):
        Results(cut)
    text = tmp_path / "text.vtkhdf"
    text.write_text("not HDF5")
    with pytest.raises(FileError, match=r"text\.vtkhdf: cannot be opened as an HDF5 file"):
        Results(text)
    foreign = tmp_path / "foreign.h5"
    with h5py.File(foreign, "w") as file:
        file["x"] = 1.0
    with pytest.raises(FileError, match=r"foreign\.h5: not a result file of myork"):
        Results(foreign)


def test_full_disk_is_an_error_and_keeps_the_old_file(test_h5: Path, tmp_path: Path) -> None:
    """A limit on the size of files stands for a full disk: the same path through HDF5."""

    def limit() -> None:
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))

    path = tmp_path / "results.vtkhdf"
    path.write_text("results of an earlier run")
    done = subprocess.run(
        [test_h5, "write", path], preexec_fn=limit, capture_output=True, text=True
    )
    assert done.returncode == 1, done.stderr
    assert "results.vtkhdf.part: writing" in done.stderr
    assert "File too large" in done.stderr
    assert path.read_text() == "results of an earlier run"


def test_killed_run_keeps_the_old_file(test_h5: Path, tmp_path: Path) -> None:
    path = tmp_path / "results.vtkhdf"
    path.write_text("results of an earlier run")
    done = subprocess.run([test_h5, "crash", path], capture_output=True)
    assert done.returncode != 0
    assert path.read_text() == "results of an earlier run"
    # The steps before the crash are whole: they can be rescued from the file it left.
    with Results(path.with_name("results.vtkhdf.part")) as results:
        assert results.nstep == 2
        assert_allclose(results.field("F", 1), [shear(1 / 3)] * 3, rtol=1e-15)


CLOUD = PointCloud(
    source=np.arange(6.0).reshape(2, 3),
    spacing=np.array([[1.0, 2.0, 3.0], [1.0, 2.0, 4.0]]),
    points=np.arange(9.0).reshape(3, 3) / 7,
    label=np.array([1, 2, 2], np.int32),
    fiber=np.array([[0.0, 0.6, 0.8], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]),
    volume=np.full(3, 0.25 * 0.5 * 2.0),
    boundary_point=np.array([0, 2, 2], np.int32),
    boundary_set=np.array([0, 0, 1], np.int32),
    normal=np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]),
    area=np.array([4.0, 5.0, 6.0]),
    set_names=("bottom", "top"),
    label_names={1: "muscle", 2: "fat"},
    length_unit="mm",
    source_images="phantom",
    voxels=Voxels(
        np.array([[5, -1, 2], [6, 0, 2], [8, 0, 3]], np.int32),
        np.array([0.25, 0.5, 2.0]),
        np.array([0.1, -3.0, 7.0]),
    ),
)


@pytest.fixture
def model(tmp_path: Path) -> Path:
    """A small model as `myork build` writes it."""
    path = tmp_path / "model.h5"
    write_model(path, CLOUD)
    return path


def read_model(test_h5: Path, path: Path) -> tuple[dict[str, list[str]], str]:
    """What the Fortran reader prints: its values, and its error."""
    done = subprocess.run([test_h5, "model", path], capture_output=True, text=True)
    assert done.returncode == (1 if done.stderr else 0)
    lines = [line.split() for line in done.stdout.splitlines()]
    return {line[0]: line[1:] for line in lines}, done.stderr


REALS = ("source", "spacing", "points", "fiber", "volume", "normal", "area")


def test_model_round_trip(test_h5: Path, model: Path) -> None:
    """Names are those of the record, in the file, in the core and in Python."""
    values, error = read_model(test_h5, model)
    assert not error
    again = model_file.read_model(model)
    for name in REALS:
        assert_array_equal(np.array(values[name], dtype=float), getattr(CLOUD, name).ravel())
    for name in (*REALS, "label", "boundary_point", "boundary_set"):
        assert_array_equal(getattr(again, name), getattr(CLOUD, name))
    for name in ("set_names", "label_names", "length_unit", "source_images"):
        assert getattr(again, name) == getattr(CLOUD, name)
    assert values["label"] == ["1", "2", "2"]
    assert values["boundary_point"] == ["1", "3", "3"], "indices count from 1 in Fortran"
    assert values["boundary_set"] == ["1", "1", "2"]
    assert values["set_names"] == ["bottom", "top"]
    assert values["length_unit"] == ["mm"]
    assert again.voxels is not None
    for name in ("index", "size", "origin"):
        wanted = getattr(CLOUD.voxels, name)
        assert_array_equal(np.array(values[f"voxels/{name}"], dtype=float), wanted.ravel())
        assert_array_equal(getattr(again.voxels, name), wanted)


def test_model_without_voxels(test_h5: Path, tmp_path: Path) -> None:
    write_model(tmp_path / "model.h5", replace(CLOUD, voxels=None))
    values, error = read_model(test_h5, tmp_path / "model.h5")
    assert not error and len(values["points"]) == 9
    assert not any(name.startswith("voxels") for name in values)
    assert model_file.read_model(tmp_path / "model.h5").voxels is None


@pytest.mark.parametrize(
    ("dataset", "value", "message"),
    [
        ("volume", None, "dataset 'volume' is missing"),
        ("fiber", np.ones((2, 3)), "'fiber' has shape (2, 3), but (3, 3)"),
        ("points", np.full((3, 3), np.nan), "'points' must hold finite numbers, but entry 0"),
        ("boundary_point", np.array([0, 3, 1]), "indices from 0 to 2, but entry 1 is 3"),
        ("boundary_set", np.array([0, 0, -1]), "indices from 0 to 1, but entry 2 is -1"),
        ("area", np.ones(2), "'area' has shape (2), but (3) is needed"),
        ("source", np.ones(6), "'source' has 1 dimension(s), but 2 are needed"),
        ("voxels/index", np.ones((2, 3), int), "'voxels/index' has shape (2, 3), but (3, 3)"),
        ("voxels/index", np.full((3, 3), -(2**30)), "an index beyond any image in entry 0"),
        ("voxels/size", np.array([1.0, 0.0, 1.0]), "'voxels/size' must be positive and finite"),
        ("voxels/size", np.ones(2), "must have 3 numbers each"),
        ("voxels/origin", np.array([1.0, np.nan, 1.0]), "'voxels/origin' finite"),
        ("source", np.ones((0, 3)), "it has no source points"),
    ],
)
def test_bad_models_are_refused(
    test_h5: Path, model: Path, dataset: str, value: np.ndarray | None, message: str
) -> None:
    with h5py.File(model, "a") as file:
        del file[dataset]
        if value is not None:
            file[dataset] = value
    _, error = read_model(test_h5, model)
    assert error.startswith(f"{model}: ")
    assert message in error


def test_foreign_model_is_refused(test_h5: Path, model: Path) -> None:
    with h5py.File(model, "a") as file:
        file.attrs["format"] = "myork-model 7"
    _, error = read_model(test_h5, model)
    assert f"{model}: not a model written by 'myork build' of this version" in error


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("length_unit", np.array(["mm", "cm"], dtype=object)),
        ("length_unit", np.array([b"mm"] * 2000)),
        ("length_unit", np.bytes_(b"m" * 5000)),
        ("length_unit", 7),
        ("length_unit", h5py.Empty("S10")),
    ],
)
def test_attributes_that_are_no_single_text_are_refused(
    test_h5: Path, model: Path, name: str, value: object
) -> None:
    with h5py.File(model, "a") as file:
        del file.attrs[name]
        file.attrs[name] = value
    _, error = read_model(test_h5, model)
    assert f"{model}: text attribute '{name}' of '/': it is" in error


@pytest.mark.parametrize(
    ("dataset", "value", "message"),
    [
        ("label", np.array([1.5, 2.0, 2.0]), "it does not hold integers"),
        ("volume", np.array([b"1", b"2", b"3"]), "it does not hold numbers"),
        ("set_names", np.array([b"bottom", b"top"]), "it does not hold integers"),
    ],
)
def test_datasets_of_another_kind_are_refused(
    test_h5: Path, model: Path, dataset: str, value: np.ndarray, message: str
) -> None:
    with h5py.File(model, "a") as file:
        del file[dataset]
        file[dataset] = value
    _, error = read_model(test_h5, model)
    assert f"{model}: '{dataset}': {message}" in error


@pytest.mark.parametrize("claimed", [(10**6, 3), (2**57, 3)])
def test_shapes_that_the_file_cannot_fill_are_refused(
    test_h5: Path, model: Path, claimed: tuple[int, int]
) -> None:
    """As a damaged header would have it: far more numbers than bytes; none is stored here."""
    with h5py.File(model, "a") as file:
        del file["points"]
        file.create_dataset("points", claimed, chunks=(1000, 3), dtype=float)
    _, error = read_model(test_h5, model)
    assert "its shape claims far more numbers than the file holds" in error
