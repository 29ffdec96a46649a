"""Bodies as meshes: corners, sets, laws and conditions are those of the deck."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from myork import Results, Scene, run_deck
from myork.errors import InstallationError
from myork.model_file import write_model
from myork.stations.export import cells_of, export
from tests.scenes import LINEAR, MUSCLE, box, deck_file, gripped, held, refuses, scene, staircase

#: A polynomial of the third order
THIRD = {"name": "rubber", "model": "polynomial", "A10": 37.3, "A20": -3.1, "A30": 0.5, "K": 1e3}
UNITS = {"title": "cube", "units": {"force": "N", "length": "cm"}}
CUBE = gripped(
    "rkpm-gauss", box(5, 5, 5), THIRD, "z0 z1", "force force_z z1", u_z=-0.2,
    **UNITS, approximation=LINEAR, load={"steps": 2},
)  # fmt: skip


def exported(tables: dict, folder: Path) -> tuple[list[str], str]:
    """What the export of tables says, and the file."""
    deck = deck_file(folder / "deck.toml", tables)
    return export(deck, folder / "out.inp"), (folder / "out.inp").read_text()


def blocks(text: str) -> dict[str, list[list[str]]]:
    """Rows below each keyword line; comments left out."""
    found: dict[str, list[list[str]]] = {}
    for line in text.splitlines():
        if line.startswith("*") and not line.startswith("**"):
            rows = found.setdefault(line, [])
        elif line and not line.startswith("**"):
            rows.append([word.strip() for word in line.split(",") if word.strip()])
    return found


def test_cells_have_all_their_corners() -> None:
    place = np.array([(x, y, z) for z in range(3) for y in range(3) for x in range(4)], np.int32)
    cells, lacking = cells_of(place + 7)
    assert (len(cells), lacking) == (3 * 2 * 2, 0)
    edges = (place[cells] - place[cells[:, :1]]) * [0.5, 1.0, 2.0]
    volume = np.linalg.det(edges[:, [1, 3, 4]])  # right-handed, first edge, last edge, up
    assert_allclose(volume, 1.0)
    # a missing point takes its cells along
    cells, lacking = cells_of(place[~(place == [1, 1, 1]).all(axis=1)])
    assert (len(cells), lacking) == (12 - 8, 8)
    flat, _ = cells_of(place[place[:, 2] == 0][:, :2])
    assert_array_equal(flat[0], [0, 1, 5, 4])


def test_input_deck_has_sets_law_and_conditions(tmp_path: Path) -> None:
    deck = deck_file(tmp_path / "cube.toml", CUBE)
    file = tmp_path / "out" / "cube.inp"
    assert export(deck, file) == [f"729 points, 512 cells: {file}"]
    found = blocks(file.read_text())
    nodes = np.array(found["*NODE, NSET=ALL"], float)
    with Scene(deck) as opened:
        assert_allclose(nodes[:, 1:], opened.points(), atol=1e-12)
        point, area = opened.set_points("z1")
        assert_allclose(opened.points()[point, 2], 1.0)
        assert_allclose(area.sum(), 1.0)
        refuses("'q0' is not a boundary set", opened.set_points, "q0")
    top = {int(word) for row in found["*NSET, NSET=z1"] for word in row}
    assert_allclose(nodes[[n - 1 for n in top], 3], 1.0)
    assert top == {*point + 1}
    assert ["z1", "3", "3", "-0.2"] in found["*BOUNDARY"] and len(found["*BOUNDARY"]) == 6
    law = [float(word) for row in found["*HYPERELASTIC, POLYNOMIAL, N=3"] for word in row]
    assert law == [37.3, 0, -3.1, 0, 0, 0.5, 0, 0, 0, 2e-3, 1e20, 1e20]
    assert found["*STATIC"] == [["0.5", "1"]]
    assert "*SOLID SECTION, ELSET=label1, MATERIAL=rubber" in found


def test_what_a_file_does_not_hold_is_said_and_written(tmp_path: Path) -> None:
    muscle = scene(
        "rkpm-gauss", box(3, 3, 3), **UNITS, approximation=LINEAR,
        material=[{**MUSCLE, "name": "calf", "fiber": [0, 0, 1]}],
        boundary=[held("z0", 3), {"set": "z1", "pressure": 2.0}, {"set": "x1", "u_x": "0.1*z"},
                  {"set": "y1", "traction": [0, 3, 0]}],
    )  # fmt: skip
    says, text = exported(muscle, tmp_path)
    for missing in ("material.calf: no keyword for 'muscle'", "boundary.z1.pressure",
                    "boundary.x1.u_x: an expression"):  # fmt: skip
        assert f"not in it: {missing}" in says and f"** not in it: {missing}\n" in text
    loads = np.array(blocks(text)["*CLOAD"], float)
    assert_allclose(loads[:, 2].sum(), 3.0)  # of a face of area 1
    assert set(loads[:, 1]) == {2.0}


def test_each_material_has_its_cells(tmp_path: Path) -> None:
    gel = {"name": "gel", "model": "neo-hookean", "mu": 2, "K": 50, "where": "z > 0.5"}
    found = blocks(exported({**CUBE, "material": [THIRD, gel]}, tmp_path)[1])
    assert "*SOLID SECTION, ELSET=label2, MATERIAL=gel" in found
    nodes = np.array(found["*NODE, NSET=ALL"], float)[:, 1:]
    for label, low in ((1, 0.0), (2, 0.5)):
        cells = np.array(found[f"*ELEMENT, TYPE=C3D8I, ELSET=label{label}"], int)[:, 1:] - 1
        assert len(cells) == 256
        assert nodes[cells].min(axis=(0, 1))[2] == pytest.approx(low)
    assert found["*HYPERELASTIC, POLYNOMIAL, N=1"] == [["1.0", "0.0", "0.04"]]


def test_results_keep_their_fields(tmp_path: Path) -> None:
    import meshio

    run_deck(CUBE, tmp_path, threads=1, error=False)
    export(tmp_path, tmp_path / "cube.vtu")
    mesh = meshio.read(tmp_path / "cube.vtu")
    with Results(tmp_path) as results:
        assert_allclose(mesh.points, results.points)
        assert_allclose(mesh.point_data["u"], results.field("u"))
        assert_allclose(mesh.point_data["cauchy"][:, 5], results.field("cauchy")[:, 1, 2])
    assert_array_equal(mesh.cell_data["label"][0], 1)
    refuses(r"an \.inp file needs the deck", export, tmp_path, tmp_path / "cube.inp")
    refuses(r"cube\.doc: meshio cannot write it", export, tmp_path, tmp_path / "cube.doc")


def test_cells_of_voxels_that_lack_a_corner_are_counted(tmp_path: Path) -> None:
    cloud = staircase()
    write_model(tmp_path / "model.h5", cloud)
    soft = {key: CUBE[key] for key in ("title", "units", "scene", "approximation", "material")}
    soft |= {"geometry": {"kind": "model"}, "boundary": [held(cloud.set_names[0])]}
    says, text = exported(soft, tmp_path)
    cells, lacking = cells_of(cloud.voxels.index)
    assert len(cells) and lacking
    line = f"not in it: {lacking} cells at the surface, which lack a corner"
    assert line in says and f"** {line}\n" in text
    found = blocks(text)
    assert_allclose(np.array(found["*NODE, NSET=ALL"], float)[:, 1:], cloud.points, atol=1e-12)


def test_without_meshio(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "meshio", None)
    deck, said = deck_file(tmp_path / "cube.toml", CUBE), r"meshio: pip install 'myork\[mesh\]'"
    refuses(said, export, deck, tmp_path / "cube.vtu", kind=InstallationError)


def test_bodies_and_laws_that_cannot_be_written(tmp_path: Path, inputs: Path) -> None:
    rigid = {**CUBE, "approximation": {"order": 2, "support": 3},
             "scene": {"dimension": 3, "method": "rkcm-mixed"},
             "material": [{**THIRD, "K": float("inf")}]}  # fmt: skip
    for deck, said in (
        (inputs / "poisson_1d.toml", "no lattice in the plane or in space"),
        (inputs / "poisson_2d.toml", r"needs \[\[material\]\], not \[linear\]"),
        (deck_file(tmp_path / "rigid.toml", rigid), r"--set material\.rubber\.K=1e4"),
    ):
        refuses(said, export, deck, tmp_path / "out.inp")


@pytest.mark.slow
def test_calculix_finds_our_force(tmp_path: Path) -> None:
    assert shutil.which("ccx"), "CalculiX is needed: apt install calculix-ccx"
    deck = deck_file(tmp_path / "cube.toml", CUBE)
    export(deck, tmp_path / "cube.inp")
    subprocess.run(["ccx", "cube"], cwd=tmp_path, check=True, capture_output=True)
    # the last line of three numbers: the total force on the last set, z1
    lines = (tmp_path / "cube.dat").read_text().splitlines()
    theirs = [float(line.split()[2]) for line in lines if len(line.split()) == 3][-1]
    with Scene(deck, ["geometry.source=[9,9,9]", "geometry.collocation=[9,9,9]"]) as opened:
        states = opened.solve(error=False)
        ours = opened.probes(states.x[-1:], states.load[-1:])[0, 0, 0]
    assert abs(theirs / ours - 1) < 0.03, (theirs, ours)
