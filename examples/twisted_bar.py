"""A square bar of rubber whose end is turned by half a turn, and the torque that this takes."""

import sys
from tempfile import TemporaryDirectory

import pyvista

from myork import Results, run_deck

BAR = {
    "title": "Twisted bar",
    "units": {"force": "N", "length": "cm"},
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [1, 1, 3], "source": [5, 5, 13]},
    "material": [{"name": "rubber", "model": "neo-hookean", "mu": 10, "K": 1000}],
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "rotation": 180, "axis": [0, 0, 1], "about": [0.5, 0.5, 0]},
    ],
    "probe": [{"name": "torque", "quantity": "torque_z", "set": "z1", "about": [0.5, 0.5, 3]}],
}

with TemporaryDirectory() as folder:
    run_deck(BAR, folder)
    with Results(folder) as results:
        body, last = results.to_pyvista(-1, deformed=True), results.summary["steps"][-1]
        print(results.summary["verdict"]["state"], *results.summary["verdict"]["reasons"])
print(f"torque {last['probes']['torque']:.3f} +- {last['probe_errors']['torque']:.1g} N cm")
body.verts = body.verts[:0]  # its surface alone, without a dot at each point
picture = pyvista.Plotter(off_screen=True, window_size=(500, 600))
picture.add_mesh(
    body, scalars="u", show_edges=True, split_sharp_edges=True,
    scalar_bar_args={"title": "u [cm]", "fmt": "%.1f", "vertical": True},
)  # fmt: skip
picture.camera_position = "xz"
picture.camera.azimuth, picture.camera.elevation = 30, 20
picture.screenshot(sys.argv[1])
