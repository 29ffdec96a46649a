"""A muscle that pulls at a tendon shortens the more, the softer the tendon is."""

import sys
from pathlib import Path

import matplotlib.pyplot as plt

from myork import Scene

DECK = Path(__file__).parents[1] / "inputs" / "tendon.toml"
STIFFNESS = [5, 10, 20, 40, 80]

rows = []
with Scene(DECK) as scene:
    names = [probe["name"] for probe in scene.deck["probe"]]
    for stiffness in STIFFNESS:
        scene.update({"boundary.z1.tendon": stiffness})
        states = scene.solve()
        values = scene.probes(states.x[-1:], states.load[-1:])[0, :, 0]
        rows.append(dict(zip(names, values, strict=True)))
        print(f"{stiffness} N/cm: {rows[-1]['force']:.3f} N, {states.verdict}")
figure, left = plt.subplots()
left.semilogx(STIFFNESS, [row["force"] for row in rows], "o-")
left.set_xticks(STIFFNESS, map(str, STIFFNESS), minor=False)
left.set_xticks([], minor=True)
left.set_xlabel("stiffness of the tendon [N/cm]")
left.set_ylabel("force [N]", color="C0")
right = left.twinx()
right.plot(STIFFNESS, [-row["shortening"] for row in rows], "s--", color="C1")
right.set_ylabel("shortening of the muscle [cm]", color="C1")
figure.tight_layout()
figure.savefig(sys.argv[1], dpi=100)
