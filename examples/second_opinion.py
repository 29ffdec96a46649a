"""The body of a deck as hexahedra for other programs: CalculiX's input deck and a mesh of VTK."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import pyvista

from myork.stations.export import export

DECK = Path(__file__).parents[1] / "inputs" / "cube_plates.toml"
FEW = ["geometry.collocation=[9,9,9]"]

with TemporaryDirectory() as folder:
    plain, mesh = Path(folder, "cube.inp"), Path(folder, "cube.vtu")
    for file in (plain, mesh):
        print(*export(DECK, file, overrides=FEW), sep="\n")
    lines, body = plain.read_text().splitlines(), pyvista.read(mesh)
print(*(line for line in lines if line.startswith("*") and not line.startswith("**")), sep="\n")
picture = pyvista.Plotter(off_screen=True, window_size=(500, 500))
picture.add_mesh(body, color="lightblue", show_edges=True)
picture.screenshot(sys.argv[1])
