"""Decks of boxes and annuli of one polynomial material as input files of CalculiX.

Elements of 20 nodes with 8 integration points (C3D20R), one layer of them in plane problems.
"""

from __future__ import annotations

import re
import resource
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.truths.conditions import AXES, Ended, moved, side_of
from myork.types import F64

#: Positions of the nodes of an element, in halves of its edges
_NODES = np.array(
    [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2),
     (1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2),
     (0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)]
)  # fmt: skip
#: Numbers of load steps to try
_STEPS = (1, 4, 16)
_LIMIT = 100.0


def solve_calculix(deck: Mapping[str, Any], elements: Sequence[int]) -> dict[str, Any]:
    """Solve a deck on one mesh.

    - `deck`: all tables of the deck; a box or an annulus of one polynomial material
    - `elements`: elements along each edge
    - returns `elements`, `dofs`, `cpu_s` of the process [s] and `probes`, or the `outcome`
    """
    mesh = _Mesh(deck, elements)
    kept = {"elements": list(elements)}
    for steps in _STEPS:
        with tempfile.TemporaryDirectory() as folder:
            Path(folder, "job.inp").write_text(mesh.text(steps), encoding="ascii")
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            try:
                ended = subprocess.run(
                    ["ccx", "-i", "job"], cwd=folder, capture_output=True, timeout=_LIMIT,
                    text=True, check=False,
                )  # fmt: skip
            except subprocess.TimeoutExpired:
                return {**kept, "outcome": f"ended after {_LIMIT:g} s"}
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            found = Path(folder, "job.dat")
            if "*ERROR" in ended.stdout or not found.is_file():
                continue
            probes = mesh.probes(found.read_text(encoding="ascii"))
        if probes:
            spent = (after.ru_utime - before.ru_utime) + (after.ru_stime - before.ru_stime)
            return {
                **kept, "dofs": 3 * len(mesh.place), "cpu_s": spent, "steps": steps,
                "probes": probes,
            }  # fmt: skip
    return {**kept, "outcome": f"no convergence in {_STEPS[-1]} load steps"}


class _Mesh:
    """Nodes, elements and sets."""

    def __init__(self, deck: Mapping[str, Any], elements: Sequence[int]) -> None:
        self.deck, self.geometry = deck, deck["geometry"]
        self.plane = len(elements) == 2
        count = np.array([*elements, 1][:3])
        self.ring = self.geometry["kind"] == "annulus"
        if self.ring:
            inner, outer = self.geometry["inner_radius"], self.geometry["outer_radius"]
            low, high = np.array([inner, 0, 0]), np.array([outer, np.pi / 2, outer - inner])
        else:
            size = [*self.geometry["size"]]
            low, high = np.zeros(3), np.array([*size, min(size)][:3], float)
        if self.plane:
            high[2] = (high - low)[0] / count[0]
        first = np.stack(np.meshgrid(*map(np.arange, count), indexing="ij"), -1).reshape(-1, 1, 3)
        wide = 2 * count + 1
        number = np.ravel_multi_index(tuple((2 * first + _NODES).transpose(2, 0, 1)), tuple(wide))
        used, cells = np.unique(number, return_inverse=True)
        self.cells = cells.reshape(-1, 20)
        share = np.stack(np.unravel_index(used, tuple(wide)), -1) / (wide - 1)
        self.share, self.high = share, high
        self.place: F64 = low + share * (high - low)
        if self.ring:
            radius, angle, height = self.place.T
            self.place = np.stack([radius * np.cos(angle), radius * np.sin(angle), height], 1)

    def on(self, name: str) -> Any:
        """Numbers of the nodes of a set."""
        axis, side = side_of(name, self.ring)
        return np.flatnonzero(abs(self.share[:, axis] - side) < 1e-9)

    def text(self, steps: int) -> str:
        """Input of the whole load, initially in equal steps."""
        table = self.deck["material"][0]
        powers = [float(table.get(key) or 0.0) for key in ("A10", "A01", "A20", "A11", "A02")]
        powers += [float(table.get(key) or 0.0) for key in ("A30", "A21", "A12", "A03")]
        # its volumetric terms are (J - 1)^2/D1 and two others that are left out
        constants = [*powers, 2.0 / float(table["K"]), 1e30, 1e30]
        lines = ["*NODE, NSET=ALL"]
        lines += [f"{k}, {x:.15g}, {y:.15g}, {z:.15g}" for k, (x, y, z) in enumerate(self.place, 1)]
        lines.append("*ELEMENT, TYPE=C3D20R, ELSET=BODY")
        for k, cell in enumerate(self.cells + 1, 1):
            lines += [f"{k}, {', '.join(map(str, cell[:12]))},", ", ".join(map(str, cell[12:]))]
        for entry in {
            e["set"] for e in (*self.deck["boundary"], *self.deck["probe"]) if "set" in e
        }:
            lines += [f"*NSET, NSET=N{entry}", *(f"{k + 1}," for k in self.on(entry))]
        lines += ["*MATERIAL, NAME=M", "*HYPERELASTIC, POLYNOMIAL, N=3"]
        lines += [", ".join(f"{c:.12g}" for c in constants[:8])]
        lines += [", ".join(f"{c:.12g}" for c in constants[8:])]
        lines += ["*SOLID SECTION, ELSET=BODY, MATERIAL=M", "*STEP, NLGEOM, INC=200"]
        lines += ["*STATIC", f"{1.0 / steps:.12g}, 1.", "*BOUNDARY"]
        lines += [f"{k + 1}, {axis + 1}, {axis + 1}, {value:.15g}"
                  for (k, axis), value in self._moved().items()]  # fmt: skip
        loads = self._loads()
        if loads:
            lines += ["*CLOAD", *loads]
        sets = dict.fromkeys(e["set"] for e in self.deck["probe"] if e.get("set"))
        for name in sets:
            lines += [f"*NODE PRINT, NSET=N{name}, FREQUENCY=1000", "RF"]
        lines += ["*NODE PRINT, NSET=ALL, FREQUENCY=1000", "U", "*END STEP"]
        return "\n".join(lines) + "\n"

    def _moved(self) -> dict[tuple[int, int], float]:
        """Prescribed displacements by node and axis."""
        found: dict[tuple[int, int], float] = {}
        for entry in self.deck["boundary"]:
            on = self.on(entry["set"])
            for axis, values in moved(entry, self.place[on]).items():
                for k, value in zip(on, np.broadcast_to(values, len(on)), strict=True):
                    found.setdefault((int(k), axis), float(value))
        if self.plane:
            found |= {(k, 2): 0.0 for k in range(len(self.place))}
        return found

    def _loads(self) -> list[str]:
        """Forces at the nodes of faces with dead tractions on boxes."""
        lines = []
        for entry in self.deck["boundary"]:
            if entry.get("traction") is None:
                continue
            axis, side = AXES.index(entry["set"][0]), int(entry["set"][1])
            face = np.flatnonzero(_NODES[:, axis] == 2 * side)
            # corners -1/12, edge midpoints 1/3 of the element's face
            middle = (_NODES[face] == 1).any(axis=1)
            weight = np.where(middle, 1 / 3, -1 / 12)
            across = [k for k in range(3) if k != axis]
            force: dict[int, float] = {}
            on = set(self.on(entry["set"]).tolist())
            for cell in self.cells:
                if not on.issuperset(cell[face].tolist()):
                    continue
                place = self.place[cell]
                area = float(np.prod(np.ptp(place[:, across], axis=0)))
                for k, share in zip(cell[face], weight, strict=True):
                    force[int(k)] = force.get(int(k), 0.0) + share * area
            for k, area in force.items():
                lines += [f"{k + 1}, {i + 1}, {area * float(t):.15g}"
                          for i, t in enumerate(entry["traction"]) if t]  # fmt: skip
        return lines

    def probes(self, text: str) -> dict[str, float]:
        """Values of the probes at the end of the load; empty if it was not reached."""
        found: dict[str, dict[int, list[float]]] = {}
        block: dict[int, list[float]] = {}
        for line in text.splitlines():
            head = re.match(r" (\w+) \(.*for set N?(\w+) and time +(\S+)", line)
            if head and abs(float(head[3]) - 1.0) < 1e-6:
                block = found.setdefault(f"{head[1]} {head[2]}".lower(), {})
            elif head:
                block = {}
            elif line.strip():
                words = line.split()
                block[int(words[0]) - 1] = [float(word) for word in words[1:]]
        ends = found.get("displacements all")
        if not ends:
            return {}
        thick = float(np.ptp(self.place[:, 2])) if self.plane else 1.0
        moves = np.zeros_like(self.place)
        moves[list(ends)] = list(ends.values())

        def pull(name: str) -> tuple[Any, Any]:
            forces = found[f"forces {name}".lower()]
            return list(forces), np.array(list(forces.values())) / thick

        near = 1e-6 * float(self.high.max())
        return Ended(self.place, moves, pull, None, near).probes(self.deck)
