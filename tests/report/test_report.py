"""The report: complete, self-contained, open about gaps, with figures and surfaces in place."""

import base64
import json
import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from html.parser import HTMLParser
from itertools import combinations
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from matplotlib.colors import to_hex
from numpy.testing import assert_allclose

from benchmarks.truths.scanners import reordered
from benchmarks.voxel_bodies import BODIES, body_cloud
from myork.core.scene import Scene
from myork.errors import FileError
from myork.records import Image, Labels
from myork.report import bodies, make_report
from myork.report.figures import LABELS, Series, label_colours, probe_figure, rom_series
from myork.report.image_figures import slice_figure
from myork.report.numbers import labelled, number, probe_units, with_error
from myork.report.sources import Deformation
from myork.report.sweep_page import Column, SweepFolder, sweep_page, trend_figure
from myork.report.tables import probe_table
from myork.rom.study import run_rom
from myork.stations.solve import run_deck
from myork.summary import printed
from myork.types import F64, I32
from tests.images import affine_of, save
from tests.scenes import MUSCLE, RUBBER, annulus, box, held, probes, refuses, scene

VOID = {"meta", "img", "br"}


class Page(HTMLParser):
    """Checks that tags are closed in order; collects the parts that the tests need."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.open: list[str] = []
        self.images: list[dict[str, str | None]] = []
        self.sections: list[str] = []
        self.targets: list[str] = []
        self.text = ""
        self.source = path.read_text(encoding="utf-8")
        self.feed(self.source)
        assert self.open == [], "tags left open"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "img":
            self.images.append(found)
        if tag == "section":
            self.sections.append(str(found["id"]))
        if tag == "a":
            self.targets.append(str(found["href"]))
        assert tag not in {"script", "link", "iframe"}, "nothing is loaded from elsewhere"

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open[-1:] != ["style"]:
            self.text += data


def change_summary(folder: Path, change: Callable[[dict[str, Any]], object]) -> None:
    path = folder / "summary.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def grid(*source: int, size: Any = None, ring: bool = False) -> tuple[F64, I32]:
    """Points in space and surface of a box, of unit cells by default, or of a quarter ring."""
    n = len(source)
    geometry = box(*source, size=size or [k - 1.0 for k in source], places=source)
    if ring:
        geometry = annulus(*source, radii=(1, 2), places=source)
    tables = scene(
        "rkcm", geometry, material=[RUBBER], boundary=[held("x0", n)],
        approximation={"order": 2, "support": 3.0},
    )  # fmt: skip
    with Scene.from_tables(tables) as opened:
        return np.pad(opened.points(), ((0, 0), (0, 3 - n))), opened.surface()


def lattice_of(points: F64) -> I32:
    """Place of each point of a block, shape `(n, 3)`."""
    places = [np.unique(np.round(axis, 9), return_inverse=True)[1] for axis in points.T]
    return np.stack(places, axis=1).astype(np.int32)


# ---- a folder with everything a report can show --------------------------------------------------

UNITS = {"force": "N", "length": "cm", "stress": "N/cm^2", "volume": "cm^3"}
#: Entries of a summary that no run of this folder makes
MORE = {
    "verdict": {"state": "accepted", "reasons": ["no error estimate: none was wanted"]},
    "exact": {"stress_zz": {"value": 3.06, "reference": 3.0617, "relative_error": 5.5e-4}},
    "warnings": ["2 islands with 14 voxels are connected to neither end: left out"],
    "segmentation": {
        "labels": {"muscle": {"pixels": 40211, "volume": 376.978}}, "iterations": 120,
        "scores": {"muscle": {"dice": 0.973, "pcc": 0.968}}, "energy": [1400.0, 700.0, 450.0],
    },
}  # fmt: skip


@pytest.fixture(scope="session")
def solved_block(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A block of muscle that is twisted and shortened, and its reduced models."""
    out = tmp_path_factory.mktemp("block")
    turn = {"u_z": -0.3, "rotation": 30, "axis": [0, 0, 1], "about": [0.5, 0.5, 2]}
    force = {"probe": "reaction", "load": [0.5, 1.0], "value": [-1.05, -3.02]}
    tables = scene(
        "rkpm-gauss", box(4, 4, 7, size=[1, 1, 2]), material=[{**MUSCLE, "fiber_angle": 30}],
        title="Muscle block, fibers inclined 30° <test>", load={"steps": 10, "activation": 0.3},
        boundary=[held("z0"), {"set": "z1", **turn}], rom={"modes": [1, 2]},
        probe=probes("reaction force_z z0", "stress_zz cauchy_zz 0.5 0.5 1", "tip u 1 0.5 1"),
        reference=[force | {"source": "mesh-converged finite elements"}],
    )  # fmt: skip
    for run in (run_deck, run_rom):
        run(tables, out, threads=1, overrides=["load.steps=4"])
    change_summary(out, lambda summary: summary.update(MORE))
    return out


@pytest.fixture
def folder(tmp_path: Path, solved_block: Path) -> Path:
    """A converged demo: segmentation, full solution and reduced models."""
    write_segmentation(tmp_path)
    for name in ("results.vtkhdf", "summary.json"):
        shutil.copy(solved_block / name, tmp_path)
    return tmp_path


def write_segmentation(folder: Path) -> None:
    """A conical muscle in a bright calf, its voxel axes left, posterior, superior."""
    shape, spacing = (64, 60, 15), np.array([1.5, 1.5, 6.0])
    i, j, k = np.indices(shape)
    x, y = (i - 34) * spacing[0], (j - 28) * spacing[1]
    muscle = (x**2 / 1.6 + y**2 < (22 - 0.8 * k) ** 2) & (k > 1) & (k < 14)
    image = 200.0 * ((x**2 + y**2) < 40**2) - 130.0 * muscle
    image += np.random.default_rng(1).normal(0.0, 8.0, shape)
    fibers = np.where(muscle[..., None], [0.35, 0.2, 0.915], 0.0)
    affine = affine_of(spacing * [-1, -1, 1])
    labels = Labels(muscle.astype(np.int32), affine, {1: "muscle"})
    save(folder, affine, segmentation=labels, anatomy=image, fibers=fibers)


# ---- pages ---------------------------------------------------------------------------------------

SECTIONS = ("images", "deformation", "planes", "probes", "rom", "run")


def keep(folder: Path, *names: str) -> None:
    """Keep only these files, and in the summary only the entries of few figures."""
    for path in folder.iterdir():
        if path.name not in names:
            path.unlink()
    if "summary.json" in names:
        change_summary(folder, lambda summary: [summary.pop("rom"), summary.pop("timings_s")])


@pytest.mark.slow
def test_page_is_complete_and_self_contained(folder: Path) -> None:
    path = make_report(folder)
    assert path == folder / "report.html"
    page = Page(path)
    assert tuple(page.sections) == SECTIONS
    assert page.targets == [f"#{key}" for key in SECTIONS]
    assert len(page.images) == 6
    for image in page.images:
        assert len(image["alt"] or "") > 20
        kind, data = str(image["src"]).split(",", 1)
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data).startswith(b"\x89PNG")
    assert not re.search(r"(src|href)=\"(?!#|data:)|url\(|@import", page.source)
    assert not list(folder.glob("*.part"))
    text = page.text
    assert "Muscle block, fibers inclined 30° <test>" in text, "text is escaped"
    assert "accepted without an error estimate" in text
    assert "no error estimate: none was wanted" in text
    assert "2 islands with 14 voxels" in text and "Bands: estimated errors." in text
    summary = json.loads((folder / "summary.json").read_text())
    last, steps = summary["steps"][-1], summary["steps"]
    for wanted in (
        "reaction [N]", "stress_zz [N/cm²]", "tip [cm]", "mesh-converged finite elements",
        "3.0600", "3.0617", "cholesky (asked: auto)", "galerkin", "0.973", "load.steps=4",
        f"J {number(last['min_J'], 3)} to {number(last['max_J'], 3)}",
        f"Force imbalance {number(summary['force_imbalance'], 2)}",
        with_error(last["probes"]["reaction"], last["probe_errors"]["reaction"]),
        f"{number(summary['memory_peak_bytes'] / 2**20, 3)} MiB",
        f"4 steps, {sum(step['iterations'] for step in steps)} iterations",
    ):  # fmt: skip
        assert re.sub("<.*?>", "", wanted) in text, wanted


@pytest.mark.slow
@pytest.mark.parametrize(("names", "sections"), [
    (("summary.json", "anatomy.nii.gz"), ["probes", "run"]),
    (("segmentation.nii.gz",), ["images"]),
    (("results.vtkhdf",), ["deformation", "planes"]),
])  # fmt: skip
def test_only_what_is_there_is_shown(folder, names, sections):
    keep(folder, *names)
    if "summary.json" in names:
        change_summary(folder, lambda summary: summary.pop("segmentation"))
    page = Page(make_report(folder))
    assert page.sections == sections and page.images


def test_a_single_state_is_a_row_of_numbers(folder: Path) -> None:
    """A dot on an axis shows less than the number and its bar."""
    keep(folder, "summary.json")
    many = Page(make_report(folder))
    change_summary(folder, lambda summary: summary.update(steps=summary["steps"][-1:]))
    single = Page(make_report(folder))
    assert "Probes of the deck in all" in many.text and "1 step," in single.text
    assert "Probes of the deck in all" not in single.text
    assert "Values in all converged steps" not in single.text


@pytest.mark.parametrize(("change", "badge"), [
    ({"verdict": {"state": "doubtful", "reasons": ["it is off"]}}, "? doubtful"),
    ({"verdict": {"state": "refused", "reasons": ["it is off"]}}, "✗ refused"),
    # not requested
    ({"verdict": None}, "converged"),
    ({"converged": False}, "✗ not converged, last state at load 1"),
    ({"converged": False, "steps": []}, "✗ no solution"),
])  # fmt: skip
def test_only_an_accepted_answer_is_green(folder: Path, change: dict[str, Any], badge: str) -> None:
    keep(folder, "summary.json")
    change_summary(folder, lambda summary: summary.update(change))
    page = Page(make_report(folder))
    assert badge in page.text and 'class="state good"' not in page.source
    assert ("it is off" in page.text) is bool(change.get("verdict"))


@pytest.mark.slow
def test_gaps_in_the_summary(folder: Path) -> None:
    """Values that the Fortran side could not compute are null; the page shows a dash."""

    def change(summary: dict[str, Any]) -> None:
        summary["steps"][1]["probes"].update(reaction=None, tip=None)
        summary["rom"]["models"][0].update(e1=None, e2=None, speedup_vs_full=None)
        summary["rom"]["pov"] = []
        summary["timings_s"]["shape"] = None
        summary["memory_peak_bytes"] = None
        summary["exact"]["stress_zz"]["reference"] = None
        summary["rom"]["full"] = summary["segmentation"]["scores"]["muscle"] = None
        summary["deck"] = None

    change_summary(folder, change)
    assert tuple(Page(make_report(folder)).sections) == SECTIONS


@pytest.mark.parametrize(("where", "value"), [
    (["steps", 1, "probes", "reaction"], "x"), (["steps"], 7), (["rom", "models", 0, "r"], []),
    (["reference", "reaction", "activation"], [0.5]),
])  # fmt: skip
def test_a_damaged_summary_is_named(folder: Path, where: list[Any], value: Any) -> None:
    def change(summary: Any) -> None:
        for key in where[:-1]:
            summary = summary[key]
        summary[where[-1]] = value

    for path in folder.iterdir():
        if path.name != "summary.json":
            path.unlink()
    change_summary(folder, change)
    refuses(r"summary\.json or another file is damaged", make_report, folder, kind=FileError)


def test_refused_folders(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    empty = tmp_path_factory.mktemp("empty")
    refuses("nowhere: no such folder", make_report, folder / "nowhere", kind=FileError)
    refuses("nothing to report: neither summary.json", make_report, empty, kind=FileError)
    keep(folder, "summary.json")
    (folder / "report.html").mkdir()
    refuses(r"report\.html: cannot be written: Is a directory", make_report, folder, kind=FileError)


def test_values_are_those_that_the_solver_prints() -> None:
    assert with_error([0.0, 0.1885], [9e-4, 3.1e-3]) == "(0, 0.1885) ± (0.00090, 0.0031)"
    step = {"probes": {"u": [1e-17, 0.2], "j": 1.0}, "printed": {"u": [0.0, 0.2]}}
    assert printed(step) == {"u": [0.0, 0.2], "j": 1.0}
    shown = probe_table([step], {"u": "cm", "j": ""})
    assert "<td>(0, 0.2000)</td>" in shown and "u [cm]" in shown and ">j</th>" in shown
    # units are read and typeset
    assert probe_units({"probe_units": {"f": "N/cm^2", "j": ""}}) == {"f": "N/cm²", "j": ""}
    assert [labelled("f", "N/cm²"), labelled("j", "")] == ["f [N/cm²]", "j"]


@pytest.mark.parametrize(("value", "digits", "text"), [
    (3.06, 4, "3.060"), (-0.0123456, 3, "−0.0123"), (8198.36, 4, "8\u202f198"),
    (25432.0, 3, "25\u202f400"), (-7309.0, 4, "−7\u202f309"), (2e-6, 2, "2.0·10<sup>−6</sup>"),
    (1e8, 2, "1.0·10<sup>8</sup>"), (0.0, 3, "0"), (36411, 4, "36\u202f411"),
    ([1.0, -2.5], 2, "(1.0, −2.5)"), (None, 4, "–"), (float("nan"), 4, "–"),
    (float("inf"), 4, "–"),
])  # fmt: skip
def test_numbers(value: Any, digits: int, text: str) -> None:
    assert number(value, digits) == text


MM = {"length": "mm", "stress": "N/mm^2"}


def block(plane: bool = False) -> Deformation:
    """A box of 1 x 2 x 3 that moves by (0.5, 0, 0)."""
    points, surface = grid(*[4] * (3 - plane), size=[1, 2, 3][: 3 - plane])
    n = len(points)
    return Deformation(
        points=points, displacement=np.tile([0.5, 0.0, 0.0], (n, 1)), stress=np.arange(1.0 * n),
        volume_ratio=np.ones(n), fiber=np.zeros((n, 3)),
        label=np.ones(n, np.int32), loads=np.array([0.0, 1.0]), activations=np.array([0.0, 0.3]),
        surface=surface, lattice=lattice_of(points),
    )  # fmt: skip


@pytest.mark.slow
def test_bodies_are_to_scale_and_in_one_frame() -> None:
    figure = bodies.surface_figure(block(), MM)
    boards = [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]
    assert len(boards) == 6 and any("N/mm²" in axes.get_title() for axes in boards)
    for axes in boards:
        # 1 x 2 x 3, moved by 0.5 along x
        ends = np.array([axes.get_xlim(), axes.get_ylim(), axes.get_zlim()])
        assert np.all(ends[:, 0] <= [0.5, 0.0, 0.0]) and np.all(ends[:, 1] >= [1.5, 2.0, 3.0])
        scale = np.diff(ends)[:, 0] / axes._box_aspect
        assert_allclose(scale, scale[0], rtol=1e-6)


@pytest.mark.slow
def test_bodies_without_a_surface_are_drawn_as_points(folder: Path) -> None:
    keep(folder, "results.vtkhdf")
    with h5py.File(folder / "results.vtkhdf", "r+") as file:
        del file["MyoRK/surface"], file["MyoRK/lattice"]
    page = Page(make_report(folder))
    assert "Points in place of the surface" in page.text and "No planes" in page.text
    assert len(page.images) == 1


def test_plane_body_is_drawn_where_it_is() -> None:
    displacement, stress = bodies.plane_figure(block(plane=True), MM).axes[:2]
    assert displacement.get_aspect() == 1.0 and "N/mm²" in stress.get_title()
    # edges of the undeformed body and points of the map
    (shape,) = [c._triangulation for c in displacement.collections if hasattr(c, "_triangulation")]
    lines = [line.get_xydata() for line in displacement.lines]
    corners = np.concatenate([np.column_stack([shape.x, shape.y]), *lines])
    assert_allclose([corners.min(axis=0), corners.max(axis=0)], [[0, 0], [1.5, 2]], atol=1e-9)


def test_planes_show_what_lies_in_them() -> None:
    """Fibers upwards, in the coronal plane; tissues by their names."""
    body = block()
    body = replace(body, fiber=np.tile([0.0, 0.0, 1.0], (len(body.points), 1)))
    figure = bodies.slices_figure(body, MM)
    assert figure.axes[0].texts[0].get_text() == "plane z = 1 mm"
    strokes = figure.axes[4].collections[-1]
    # strokes end where the body does
    seen = strokes.get_clip_path().get_fully_transformed_path().vertices
    shape = figure.axes[4].transData.inverted().transform(seen)
    assert_allclose([shape.min(axis=0), shape.max(axis=0)], [[0, 0], [1, 3]], atol=1e-9)
    assert np.all(np.asarray(strokes.U) == 0.0) and np.all(np.asarray(strokes.V) == 1.0)
    assert not figure.legends
    two = replace(body, label=(body.points[:, 2] > 1).astype(np.int32))
    (legend,) = bodies.slices_figure(two, MM, ["muscle"]).legends
    assert [text.get_text() for text in legend.get_texts()] == ["muscle", "label 1"]


def test_numbers_of_flat_pictures_do_not_overlap() -> None:
    """A body a tenth as high as wide: numbers along its axes and colour bars have their room."""
    body = block()
    body = replace(body, points=body.points * [10.0, 5.0, 0.3])
    figure = bodies.slices_figure(body, MM)
    figure.canvas.draw()
    for axes in [own for panel in figure.axes for own in (panel, *panel.child_axes)]:
        drawn = [tick for axis in (axes.xaxis, axes.yaxis) for tick in axis._update_ticks()]
        texts = [text for tick in drawn for text in (tick.label1, tick.label2)]
        boxes = [text.get_window_extent() for text in texts if text.get_visible()]
        for one, other in combinations(boxes, 2):
            assert not one.overlaps(other)


def test_a_label_has_one_colour_in_all_pictures() -> None:
    assert len(set(LABELS)) == 20
    assert len({*label_colours(range(1, 21)).values()}) == 20
    assert len({*label_colours([3, 23, 43]).values()}) == 3
    body = block()
    body = replace(body, label=np.where(body.points[:, 2] > 1, 12, 4).astype(np.int32))
    (model,) = bodies.slices_figure(body, MM).legends
    labels = np.repeat(np.int32([4, 7, 12]), 8)[:, None, None] * np.ones((1, 9, 9), np.int32)
    (image,) = slice_figure(Labels(labels, np.eye(4)), None, None).legends
    three = [line.get_color() for line in image.get_lines()]
    two = [to_hex(patch.get_facecolor()).upper() for patch in model.get_patches()]
    assert two == [three[0], three[2]]


def test_the_plane_drawn_lies_in_a_body_and_not_between_two() -> None:
    """Two limbs of unequal size with a gap in the middle; of equal planes the middle one."""
    lattice = np.stack(np.meshgrid(np.arange(9), np.arange(4), np.arange(5), indexing="ij"), -1)
    limbs = np.concatenate([lattice[:2].reshape(-1, 3), lattice[6:, :, :3].reshape(-1, 3)])
    kept, triangles = bodies._plane(limbs.astype(np.int32), 0)
    assert set(limbs[kept, 0]) == {1} and len(triangles) == 2 * 3 * 4
    whole = lattice.reshape(-1, 3).astype(np.int32)
    for axis in (1, 2):
        assert set(whole[bodies._plane(whole, axis)[0], axis]) == {axis}


@pytest.mark.parametrize(
    ("draw", "plane"), [(bodies.plane_figure, True), (bodies.slices_figure, False)]
)
def test_places_without_stress_are_marked(draw: Any, plane: bool) -> None:
    """Where J <= 0: a cross in place of a colour; all other points keep their colour."""
    body = block(plane=plane)
    stress = np.where(np.arange(len(body.points)) % 3 == 0, np.nan, body.stress)
    figure = draw(replace(body, stress=stress), MM)
    lines = [line for axes in figure.axes for line in axes.lines]
    crosses = [line for line in lines if line.get_marker() == "x" and len(line.get_xdata())]
    assert crosses and all(line.get_color() == bodies.NO_VALUE for line in crosses)
    bars = [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]
    assert np.isfinite([axes.get_ylim() for axes in bars]).all()


def test_reduced_models_alone_say_what_was_asked_and_what_they_are_off(tmp_path: Path) -> None:
    models = [{"kind": "reduced", "r": r, "e1": e, "e2": 2 * e} for r, e in ((1, 1e-3), (3, 1e-9))]
    rom = {"snapshots": 4, "full": {"load": [1.0], "probes": {}}, "pov": [1.0], "models": models}
    deck = {"geometry": {"kind": "box", "size": [2, 1]}, "material": [{"name": "rubber"}]}
    content = {"title": "sheet", "units": UNITS, "dimension": 2, "deck": deck, "rom": rom}
    (tmp_path / "summary.json").write_text(json.dumps(content))
    text = Page(make_report(tmp_path)).text
    assert "A sheet of 2 × 1 cm of rubber" in text
    assert "The error of the full model adds to it" in text


def test_colours_reach_the_largest_value_but_for_one_far_out() -> None:
    values = np.linspace(0.0, 1.0, 1001)
    assert bodies.limits_of(values)[1] == pytest.approx(1.0, abs=1e-5)
    values[0] = 50.0
    low, high, ends = bodies.limits_of(values)
    assert high < 1.1 and ends == "max" and low < 1e-2


@pytest.mark.slow
def test_page_in_a_browser(folder: Path, open_page: Callable[[str], Any]) -> None:
    """Nothing on the console, every picture loaded, no horizontal scrolling on a narrow screen."""
    page = open_page(make_report(folder).as_uri())
    loaded = "[...document.images].every(image => image.complete && image.naturalWidth > 100)"
    assert page.evaluate(loaded)
    page.set_viewport_size({"width": 400, "height": 800})
    assert page.evaluate("document.documentElement.scrollWidth") <= 400
    # letters in wide figures stay legible: the figure scrolls, drawn at least at half its size
    drawn = page.evaluate(
        "[...document.querySelectorAll('figure img')].map(i => i.clientWidth / i.naturalWidth)"
    )
    assert drawn and min(drawn) > 0.4


def test_probes_against_activation() -> None:
    steps = [{"load": load, "activation": 0.3 * load, "probes": {"f": -load}} for load in (0.5, 1)]
    reference = {"f": {"load": [0.25], "activation": [0.075], "reference": [-0.2]}}
    exact = {"f": {"reference": -1.1}}
    axes = probe_figure([Series("", steps)], {"f": "N"}, reference, exact).axes[0]
    assert axes.get_xlabel() == "activation [-]"
    for line, places in zip(
        axes.lines, ([[0.15, -0.5], [0.3, -1.0]], [[0.075, -0.2]], [[0.3, -1.1]]), strict=True
    ):
        assert_allclose(line.get_xydata(), places)
    passive = [{**step, "activation": 0.0} for step in steps]
    axes = probe_figure([Series("", passive)], {"f": "N"}, reference, {}).axes[0]
    assert axes.get_xlabel() == "load [-]"
    assert_allclose(axes.lines[1].get_xydata(), [[0.25, -0.2]])


def test_full_against_reduced() -> None:
    full = {"load": [0.5, 1.0], "probes": {"f": [1.0, 2.0], "tip": [[0.0, 1.0], [0.0, 2.0]]}}
    models = [{"kind": "reduced", "r": 3, "probes": {"f": [1.1, None]}}]
    figure = probe_figure(rom_series({"full": full, "models": models}), {"f": "N", "tip": "mm"})
    lines = figure.axes[0].lines
    assert_allclose(lines[0].get_xydata(), [[0.5, 1.0], [1.0, 2.0]])
    assert_allclose(lines[1].get_xydata(), [[0.5, 1.1], [1.0, np.nan]])
    assert lines[1].get_label() == "r = 3"
    assert_allclose(figure.axes[1].lines[1].get_ydata(), [1.0, 2.0])


@pytest.mark.parametrize(("axes", "flipped"), [
    ((0, 1, 2), ()), ((0, 1, 2), (0,)), ((0, 1, 2), (0, 1)), ((2, 0, 1), ()),
])  # fmt: skip
def test_slices_are_canonical(axes: tuple[int, ...], flipped: tuple[int, ...]) -> None:
    """Label at the right and front, fibers to the right and up, for any voxel axes."""
    data = np.zeros((10, 12, 5), dtype=np.int32)
    data[6:9, 7:11, 1:4] = 1  # x from 12 to 18 mm, y from 14 to 22 mm
    vectors = np.where(data[..., None] > 0, [0.6, 0.0, 0.8], 0.0)
    affine = affine_of((2.0, 2.0, 5.0), (1.0, 1.0, 2.5))
    images = Labels(data, affine, {1: "muscle"}), Image(vectors, affine)
    labels, fiber = (reordered(image, axes, flipped) for image in images)
    figure = slice_figure(labels, None, fiber)
    axial, strokes = figure.axes[1], figure.axes[3].collections[-1]
    corners = np.concatenate([path.vertices for path in axial.collections[1].get_paths()])
    assert_allclose(corners.mean(axis=0), [15.0, 18.0], atol=0.5)
    assert axial.get_xlim() == (2.0, 20.0) and axial.get_ylim() == (4.0, 24.0)
    assert np.all(np.asarray(strokes.U) > 0.59)
    assert_allclose(strokes.V, 0.8)


def test_a_single_slice_is_one_picture() -> None:
    label = np.zeros((12, 10, 1), np.int32)
    label[3:8, 2:7] = 1
    for count, pictures in ((1, 1), (4, 4)):
        stack = Labels(np.repeat(label, count, axis=2), np.eye(4))
        assert len(slice_figure(stack, None, None).axes) == pictures
    coronal = np.moveaxis(label, 2, 1)  # a single row from front to back
    fibers = Image(coronal[..., None] * [0, 0, 1.0], np.eye(4))
    drawn = slice_figure(Labels(coronal, np.eye(4)), None, fibers)
    assert len(drawn.axes[3].collections[-1].V) > 0


# ---- surfaces that the core makes of lattices ----------------------------------------------------


def volume(points: F64, triangles: I32) -> float:
    """By the divergence theorem: positive if triangles are oriented outwards."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)


def areas(points: F64, triangles: I32) -> F64:
    """Areas of plane triangles: positive if they are counter-clockwise."""
    a, b, c = (points[triangles[:, k]] for k in range(3))
    u, v = b - a, c - a
    return 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])


def is_closed(triangles: I32) -> bool:
    """Each edge belongs to two triangles, or to four where the surface touches itself."""
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    return bool((np.unique(edges, axis=0, return_counts=True)[1] % 2 == 0).all())


def test_the_surface_of_a_block() -> None:
    points, triangles = grid(5, 4, 6)
    assert is_closed(triangles)
    assert volume(points, triangles) == pytest.approx(60.0, rel=1e-12)
    # no triangle lies inside, and no point of the surface is hidden
    on = (points == points.min(axis=0)) | (points == points.max(axis=0))
    assert on[triangles].all(axis=1).any(axis=1).all()
    assert len(np.unique(triangles)) == on.any(axis=1).sum()


def test_the_surface_of_plane_bodies() -> None:
    assert areas(*grid(5, 3)) == pytest.approx(np.full(16, 0.5), rel=1e-12)
    ring = areas(*grid(9, 33, ring=True))
    assert ring.min() > 0.0 and ring.sum() == pytest.approx(0.75 * np.pi, rel=1e-3)


@pytest.mark.parametrize("body", BODIES, ids=lambda body: body.name)
def test_the_surface_of_voxels(body) -> None:
    """Slopes in place of stairs: closed, with every point of the surface, little volume lost."""
    cloud = body_cloud(body, body.sizes[0])
    with Scene.from_tables(dict(body.tables), cloud) as scene:
        points, triangles = scene.points(), scene.surface()
    assert is_closed(triangles)
    assert set(cloud.boundary_point) == set(triangles.ravel())
    assert volume(points, triangles) == pytest.approx(cloud.volume.sum(), rel=0.05)


@pytest.mark.slow
def test_without_a_lattice_there_is_no_surface() -> None:
    body = BODIES[0]
    cloud = replace(body_cloud(body, body.sizes[0]), voxels=None)
    tables = {**body.tables, "scene": {"dimension": 3, "method": "rkcm"}}
    with Scene.from_tables(tables, cloud) as scene:
        assert scene.surface().shape == (0, 3)


# ---- pages of sweeps -----------------------------------------------------------------------------


@pytest.fixture
def swept(tmp_path: Path) -> Path:
    """Thirty points of three keys, one of which has no effect; one failed, one is not solved."""
    folder = tmp_path / "swept"
    folder.mkdir()
    rng = np.random.default_rng(4)
    points = [[float(x) for x in row] for row in rng.uniform([20, 0, 1], [40, 30, 2], (31, 3))]
    head = {"deck": "9f", "keys": ["m.sigma_max", "m.fiber_angle", "m.K"], "points": points}
    lines = [json.dumps({"sweep": {**head, "model": None}})]
    for k, (sigma, angle, _) in enumerate(points[:30]):
        row: dict[str, Any] = {"point": k, "verdict": "accepted", "message": "", "cpu_s": 2.0}
        force = -2.0 * sigma + 0.1 * angle + 0.005 * sigma * angle
        row |= {"probes": {"force": force}, "errors": {"force": 0.5}}
        if k == 7:
            row |= {"probes": {}, "errors": {}, "verdict": "failed", "message": "J below <0>"}
        lines.append(json.dumps(row))
    (folder / "points.jsonl").write_text("\n".join(lines) + '\n{"point": 30, "pro')
    (folder / "sweep.json").write_text('{"title": "Block", "units": {"force": "N"}}')
    return folder


@pytest.mark.slow
def test_sweep_page(swept: Path, open_page: Callable[[str], Any]) -> None:
    path = make_report(swept)
    page = Page(path)
    assert page.sections == ["trends", "failures"]
    for wanted in (
        "Sweep: Block", "29 accepted", "1 failed", "1 to do", "31 points by full solutions",
        "m.sigma_max from", "60.0 CPU s in all, 2.00 s per point", "J below <0>", "force from",
    ):  # fmt: skip
        assert wanted in page.text, wanted
    assert len(page.images) == 1
    shown = open_page(path.as_uri())
    assert shown.evaluate("[...document.images].every(i => i.complete && i.naturalWidth > 100)")


def test_words_stand_side_by_side() -> None:
    key = Column("method", "", ["rkcm", "rkpm-gauss", "rkcm"], [])
    probe = Column("force", "N", [1.0, 2.0, 1.1], [0.1, np.nan, 0.1])
    axes = trend_figure([key], probe, ["accepted", "doubtful", "accepted"]).axes[0]
    assert [label.get_text() for label in axes.get_xticklabels()] == ["rkcm", "rkpm-gauss"]


def test_damaged_sweeps_are_refused_by_name(swept: Path) -> None:
    file = swept / "points.jsonl"
    first = file.read_text().splitlines()[0]
    for text in ("", "{}", '{"sweep": {"keys": 3}}', "[]"):
        file.write_text(text)
        with pytest.raises(FileError, match=r"points\.jsonl: is not a table written by"):
            make_report(swept)
    file.write_text(first + "\n")
    refuses("no point is finished", make_report, swept, kind=FileError)


def test_bars_of_what_is_zero_by_symmetry(folder: Path) -> None:
    """They are compared with the other probes of their unit."""
    units = {"x": "N", "y": "N", "end": "cm"}
    values, bars = {"x": 2.0, "y": 1e-16, "end": 0.5}, {"x": 0.02, "y": 0.01, "end": 0.01}
    columns = [Column(name, unit, [values[name]], [bars[name]]) for name, unit in units.items()]
    key = Column("load.activation", "", [0.1])
    sweep = SweepFolder(folder, 1, [key], columns, ["accepted"], [""], [1.0], {})
    told = " ".join(str(line) for answer in sweep_page(sweep).story for line in answer.lines)
    assert "Error bars: at most 2.0 % of the largest value of their unit" in told
    summary = json.loads((folder / "summary.json").read_text())
    summary["steps"][-1] |= {"probes": values, "probe_errors": bars}
    summary["probe_units"] = units
    (folder / "summary.json").write_text(json.dumps(summary))
    assert "Error bars: at most 5.0 % of the value (y)" in make_report(folder).read_text()
