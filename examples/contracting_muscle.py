"""A block of muscle on a held end contracts: its fibers, inclined by 30 degrees, bend it aside."""

import sys
from tempfile import TemporaryDirectory

import pyvista

from myork import Results, run_deck

MUSCLE = {"name": "muscle", "model": "muscle", "A10": 6.43, "A01": -3.8, "A20": 0.94, "K": 5000}
BLOCK = {
    "title": "Contracting muscle",
    "units": {"force": "N", "length": "cm"},
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [1, 1, 3], "source": [5, 5, 13]},
    "material": [{**MUSCLE, "fiber_angle": 30}],
    "boundary": [{"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0}],
    "load": {"activation": 0.1},
    "probe": [{"name": "end", "quantity": "u", "set": "z1"}],
}

with TemporaryDirectory() as folder:
    run_deck(BLOCK, folder)
    with Results(folder) as results:
        body, verdict = results.to_pyvista(-1, deformed=True), results.summary["verdict"]
        rest = results.to_pyvista(-1).extract_feature_edges(30, boundary_edges=False)
print(verdict["state"], *verdict["reasons"])
body.verts = body.verts[:0]  # its surface alone, without a dot at each point
picture = pyvista.Plotter(off_screen=True, window_size=(500, 600))
picture.add_mesh(rest, color="gray", line_width=2)
picture.add_mesh(
    body, scalars="u", split_sharp_edges=True, cmap="viridis",
    scalar_bar_args={"title": "u [cm]", "fmt": "%.1f", "vertical": True},
)  # fmt: skip
picture.camera_position = "xz"
picture.camera.azimuth, picture.camera.elevation = 30, 20
picture.screenshot(sys.argv[1])
