"""The body of a deck or of results as a mesh of hexahedra, for a second opinion elsewhere.

The corners are the collocation points: neighbours in their lattice make a cell, voxels likewise.
"""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from myork.core.scene import Scene
from myork.errors import InputError, optional
from myork.files import write_text
from myork.results import Results
from myork.types import F64, I32, I64

# Corners of a cell in the order of VTK, Abaqus and CalculiX, by dimension
_CORNERS: dict[int, list[tuple[int, ...]]] = {
    2: [(0, 0), (1, 0), (1, 1), (0, 1)],
    3: [(x, y, z) for z in (0, 1) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))],
}
# Names of cells by their corners
_MESHIO = {4: "quad", 8: "hexahedron"}
# Elements that neither program's full integration locks; they stand an hourglass less well
_ELEMENT = {4: "CPE4R", 8: "C3D8I"}
# Coefficients of the polynomial law in the order of *HYPERELASTIC, by its degree N
_ORDER = [[f"A{n - j}{j}" for j in range(n + 1)] for n in (1, 2, 3)]
# The terms of other laws as those of the polynomial
_AS_POLYNOMIAL = {
    "mooney-rivlin": {"A10": "C1", "A01": "C2"},
    "yeoh": {"A10": "C1", "A20": "C2", "A30": "C3"},
}
# Conditions that are written, and keys that are none
_WRITTEN = {"set", "u_x", "u_y", "u_z", "traction"}
_A_LINE = 8
# A compressibility of terms that are not there
_NONE = 1e20


class Body(NamedTuple):
    """A mesh with what stands at its points."""

    points: F64  #: Shape `(np, 3)` [length]
    #: Corners of each cell: eight of a hexahedron, four in a plane, shape `(nc, 8)` or `(nc, 4)`
    cells: I64
    label: I32  #: The label with the largest share in the corners of a cell, shape `(nc,)`
    fields: dict[str, NDArray[Any]]  #: Arrays by name, shape `(np, ...)`
    lacking: int  #: Cells at the surface of voxels that are left out, since they lack a corner


def export(
    source: Path, output: Path, *, overrides: Sequence[str] = (), out: Path | None = None
) -> list[str]:
    """Write the body of a deck, or that of results with the fields of their last state.

    - `source`: deck (`.toml`), result file or its folder
    - `output`: `.inp` is an input deck of Abaqus and CalculiX with sets, materials and conditions;
      other suffixes are those of meshio: `.vtu`, `.xdmf`, `.msh` and more
    - `overrides`: `"table.key=value"` each, of a deck
    - `out`: folder in which the model file of a deck is looked for first
    - returns what the file holds, and what of the deck it does not hold
    """
    plain = output.suffix == ".inp"
    if source.suffix != ".toml":
        if plain or overrides:
            raise InputError(
                f"{source}: {'an .inp file' if plain else '--set'} needs the deck, not its results"
            )
        with Results(source) as results:
            fields = {name: results.field(name) for name in results.fields}
            labels = np.unique(results.label)
            share = (results.label == labels[:, None]).astype(float)
            body = _body(source, results.points, results.lattice, labels, share, fields)
        missing = _lacking(body)
    else:
        with Scene(source, overrides, out) as scene:
            place, fiber, labels, share = scene.body()
            points = np.zeros((scene.collocation_points, 3))
            points[:, : scene.dimension] = scene.points()
            body = _body(source, points, place, labels, share, {"fiber": fiber})
            if plain and "linear" in scene.deck:
                raise InputError(f"{source}: an .inp file needs [[material]], not [linear]")
            if plain:
                text, missing = input_deck(body, scene)
        if not plain:
            missing = ["sets, materials and conditions: .inp files hold them", *_lacking(body)]
    output.parent.mkdir(parents=True, exist_ok=True)
    if plain:
        write_text(output, text)
    else:
        _write_mesh(output, body)
    return [f"{len(body.points)} points, {len(body.cells)} cells: {output}"] + [
        f"not in it: {line}" for line in missing
    ]


def cells_of(place: I32) -> tuple[I64, int]:
    """Cells between neighbouring places of a lattice that have all their corners.

    - `place`: place of each point, shape `(np, 2)` or `(np, 3)`
    - returns `cells`: points at the corners, shape `(nc, 4)` or `(nc, 8)`, in the order of VTK
    - returns `lacking`: cells that are left out, since they have at least half of their corners but
      not all
    """
    low = place.min(axis=0)
    at = np.full(place.max(axis=0) - low + 1, -1)
    at[tuple((place - low).T)] = np.arange(len(place))
    corners = [
        at[tuple(slice(c, n - 1 + c) for c, n in zip(corner, at.shape, strict=True))].ravel()
        for corner in _CORNERS[place.shape[1]]
    ]
    cells = np.stack(corners, axis=1)
    there = (cells >= 0).sum(axis=1)
    whole = there == cells.shape[1]
    return cells[whole], int((~whole & (2 * there >= cells.shape[1])).sum())


def _body(
    source: Path,
    points: F64,
    place: I32,
    labels: I32,
    share: F64,
    fields: dict[str, NDArray[Any]],
) -> Body:
    if len(place) == 0 or place.shape[1] not in _CORNERS:
        raise InputError(
            f"{source}: its points have no lattice in the plane or in space: boxes, annuli and "
            "models of voxels have one"
        )
    cells, lacking = cells_of(place)
    if len(cells) == 0:
        raise InputError(f"{source}: no cell has all its corners: take more points")
    most = labels[share[:, cells].sum(axis=2).argmax(axis=0)]
    return Body(points, cells, most, fields, lacking)


def _lacking(body: Body) -> list[str]:
    """Line about the cells that are left out, if there are any."""
    return [f"{body.lacking} cells at the surface, which lack a corner"] if body.lacking else []


def _write_mesh(output: Path, body: Body) -> None:
    meshio = optional("meshio", "mesh", f"{output}: all but .inp")
    kind = _MESHIO[body.cells.shape[1]]
    fields = {name: np.reshape(v, (len(v), -1)).squeeze() for name, v in body.fields.items()}
    mesh = meshio.Mesh(
        body.points, [(kind, body.cells)], point_data=fields, cell_data={"label": [body.label]}
    )
    try:
        mesh.write(output)
    except (meshio.WriteError, meshio.ReadError, KeyError) as reason:
        known = ", ".join(sorted(meshio.extension_to_filetypes))
        raise InputError(f"{output}: meshio cannot write it: {reason}; it knows {known}") from None


# ---- Abaqus and CalculiX ---------------------------------------------------------------------


def input_deck(body: Body, scene: Scene) -> tuple[str, list[str]]:
    """Input deck of Abaqus and CalculiX, and what of the scene it does not hold.

    - `body`: mesh of the scene
    - `scene`: open scene: its sets, materials and conditions
    """
    deck: Mapping[str, Any] = scene.deck
    missing = _lacking(body)
    used = [entry["set"] for entry in (*deck.get("boundary", ()), *deck.get("probe", ()))
            if "set" in entry]  # fmt: skip
    sets = {name: scene.set_points(name) for name in dict.fromkeys(used)}
    lines = [f"*HEADING\n{deck['title']}", "*NODE, NSET=ALL"]
    lines += [f"{n}, " + ", ".join(f"{x:.12g}" for x in at) for n, at in enumerate(body.points, 1)]
    lines += _elements(body)
    for name, (point, _) in sets.items():
        lines += [f"*NSET, NSET={name}", *_rows(np.unique(point) + 1)]
    for material, labels in _placed(deck["material"], body.label):
        law = list(_law(material))
        if not law:
            missing.append(f"material.{material['name']}: no keyword for {material['model']!r}")
        lines += [f"*MATERIAL, NAME={material['name']}", *law]
        for label in labels:
            lines.append(f"*SOLID SECTION, ELSET=label{label}, MATERIAL={material['name']}")
            lines += ["1."] if scene.dimension == 2 else []
    steps = deck["load"]["steps"]
    lines += ["*STEP, NLGEOM, INC=1000", f"*STATIC\n{1 / steps:.6g}, 1"]
    for entry in deck.get("boundary", ()):
        lines += _condition(entry, sets)
        missing += list(_left_out(entry))
    for name in sets:
        lines += [f"*NODE PRINT, NSET={name}, TOTALS=ONLY", "RF"]
    lines += ["*NODE FILE", "U, RF", "*EL FILE", "S", "*END STEP", ""]
    lines[1:1] = [f"** not in it: {line}" for line in missing]
    return "\n".join(lines), missing


def _rows(numbers: NDArray[Any]) -> Iterator[str]:
    """Numbers in lines of eight, with a comma where more follow."""
    for first in range(0, len(numbers), _A_LINE):
        more = "," if first + _A_LINE < len(numbers) else ""
        yield ", ".join(map(str, numbers[first : first + _A_LINE])) + more


def _elements(body: Body) -> Iterator[str]:
    """The cells, a set for each label."""
    kind = _ELEMENT[body.cells.shape[1]]
    for label in np.unique(body.label):
        yield f"*ELEMENT, TYPE={kind}, ELSET=label{label}"
        for number in np.flatnonzero(body.label == label):
            yield ", ".join(map(str, (number + 1, *(body.cells[number] + 1))))


def _placed(
    materials: Sequence[Mapping[str, Any]], label: I32
) -> Iterator[tuple[Mapping[str, Any], list[int]]]:
    """Each material with the labels of its cells."""
    there = np.unique(label).tolist()
    labelled = all("label" in material for material in materials)
    for number, material in enumerate(materials, 1):
        mine = [material["label"] if labelled else number]
        yield material, there if len(materials) == 1 else [one for one in mine if one in there]


def _law(material: Mapping[str, Any]) -> Iterator[str]:
    """The law of a material as *HYPERELASTIC; nothing where there is no such keyword."""
    model = material["model"]
    if model == "polynomial":
        terms = {key: material.get(key, 0.0) for order in _ORDER for key in order}
    elif model == "neo-hookean":
        terms = {"A10": material["mu"] / 2}
    elif model in _AS_POLYNOMIAL:
        terms = {term: material.get(key, 0.0) for term, key in _AS_POLYNOMIAL[model].items()}
    else:
        return
    if not np.isfinite(material["K"]):
        raise InputError(
            f"material.{material['name']}.K: {material['K']}: give a number, as in "
            f"--set material.{material['name']}.K=1e4"
        )
    degree = max((n for n, order in enumerate(_ORDER, 1) if any(map(terms.get, order))), default=1)
    numbers = [terms.get(key, 0.0) for order in _ORDER[:degree] for key in order]
    yield f"*HYPERELASTIC, POLYNOMIAL, N={degree}"
    # CalculiX takes a zero for one that it has to choose
    yield from _rows(np.array([*numbers, 2 / material["K"], *[_NONE] * (degree - 1)]))


def _left_out(entry: Mapping[str, Any]) -> Iterator[str]:
    """Keys of a condition that are not written."""
    for key, value in entry.items():
        if key not in _WRITTEN:
            yield f"boundary.{entry['set']}.{key}"
        elif key != "set" and (
            isinstance(value, str) or any(isinstance(part, str) for part in np.atleast_1d(value))
        ):
            yield f"boundary.{entry['set']}.{key}: an expression"


def _condition(entry: Mapping[str, Any], sets: Mapping[str, tuple[I32, F64]]) -> Iterator[str]:
    """Displacements and tractions at full load."""
    name = entry["set"]
    for direction, key in enumerate(("u_x", "u_y", "u_z"), 1):
        if isinstance(entry.get(key), int | float):
            yield f"*BOUNDARY\n{name}, {direction}, {direction}, {entry[key]:.12g}"
    for direction, traction in enumerate(entry.get("traction", ()), 1):
        if isinstance(traction, int | float) and traction:
            yield "*CLOAD"
            for point, area in zip(*sets[name], strict=True):
                yield f"{point + 1}, {direction}, {traction * area:.12g}"
