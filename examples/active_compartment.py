"""A muscle of which one half is active: activation as an expression, fibers as lines."""

import sys
from tempfile import TemporaryDirectory

import pyvista

from myork import Results, run_deck

SHEET = {
    "units": {"force": "N", "length": "cm"},
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [1, 0.5, 2], "source": [7, 4, 11]},
    "material": [{
        "name": "muscle", "model": "muscle", "A10": 6.43, "A01": -3.8, "A20": 0.94, "K": 5000,
        "fiber": [0, 0, 1], "activation": "0.2*(x < 0.5)",
    }],
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "spring": [2, 2, 20]},
    ],
    "probe": [{"name": "force", "quantity": "force_z", "set": "z0"}],
}  # fmt: skip

with TemporaryDirectory() as folder:
    run_deck(SHEET, folder)
    with Results(folder) as results:
        body, last = results.to_pyvista(-1, deformed=True), results.summary["steps"][-1]
        print(results.summary["verdict"]["state"], *results.summary["verdict"]["reasons"])
print(f"force {last['probes']['force']:.3f} +- {last['probe_errors']['force']:.1g} N")
lines = body.glyph(orient="fiber", scale=False, geom=pyvista.Line(), factor=0.14)
picture = pyvista.Plotter(off_screen=True, window_size=(500, 600))
bar = {"title": "u [cm]", "fmt": "%.2f", "vertical": True, "position_x": 0.8}
picture.add_mesh(lines, scalars="u", line_width=3, scalar_bar_args=bar)
picture.camera_position = "xz"
picture.screenshot(sys.argv[1])
