"""A label map, here made by formula, to the force of the muscle in it."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import nibabel
import numpy as np
import pyvista

from myork import Results, build, run_deck

DECK = Path(__file__).parent / "data" / "muscle.toml"

x, y, z = np.meshgrid(*(np.arange(n) + 0.5 for n in (18, 18, 30)), indexing="ij")
labels = np.hypot(x - 9, y - 9) < 5 + 3 * np.sin(np.pi * z / 30)
with TemporaryDirectory() as folder:
    file = Path(folder, "labels.nii.gz")  # voxels of 1 mm
    nibabel.save(nibabel.Nifti1Image(labels.astype(np.int16), np.eye(4)), file)
    build(DECK, Path(folder), overrides=[f"build.labels={file}"])
    run_deck(DECK, Path(folder))
    with Results(folder) as results:
        body, last = results.to_pyvista(-1, deformed=True), results.summary["steps"][-1]
        print(results.summary["verdict"]["state"])
print(f"force {last['probes']['force']:.2f} +- {last['probe_errors']['force']:.1g} N")
body.verts = body.verts[:0]  # its surface alone, without a dot at each point
picture = pyvista.Plotter(off_screen=True, window_size=(500, 600))
bar = {"title": "u [cm]", "fmt": "%.2f", "vertical": True}
picture.add_mesh(body, scalars="u", scalar_bar_args=bar)
picture.camera_position = "xz"
picture.screenshot(sys.argv[1])
