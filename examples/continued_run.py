"""A muscle is stretched once; three activations continue from that state."""

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from myork import Results, run_deck

MUSCLE = {"name": "muscle", "model": "muscle", "A10": 6.43, "A01": -3.8, "A20": 0.94, "K": 5000}
BLOCK = {
    "units": {"force": "N", "length": "cm"},
    "scene": {"dimension": 3, "method": "rkpm-gauss"},
    "geometry": {"kind": "box", "size": [1, 1, 2], "source": [5, 5, 9]},
    "material": [{**MUSCLE, "fiber": [0, 0, 1]}],
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "u_x": 0, "u_y": 0, "u_z": 0.3, "amplitude": "stretch"},
    ],
    "probe": [{"name": "force", "quantity": "force_z", "set": "z1"}],
}
RAMP = {"name": "stretch", "time": [0, 1], "value": [0, 1]}
HELD = {"name": "stretch", "time": [0], "value": [1]}

with TemporaryDirectory() as folder:
    run_deck({**BLOCK, "amplitude": [RAMP], "load": {"steps": 3}}, first := Path(folder, "first"))
    with Results(first) as results:
        begin = results.probe("force")[1][-1]
    for level in (0, 0.1, 0.2, 0.3):
        load, out = {"activation": level, "steps": 3}, Path(folder, f"{level}")
        run_deck({**BLOCK, "amplitude": [HELD], "load": load}, out, start=first)
        with Results(out) as results:
            time, force = results.probe("force")
            print(f"activation {level}: {force[-1]:.2f} N {results.summary['verdict']['state']}")
        plt.plot([0, *time], [begin, *force], "o-", label=f"activation {level}")
plt.xlabel("load time after the stretch")
plt.ylabel("force [N]")
plt.legend()
plt.savefig(sys.argv[1], dpi=100)
