"""Requests of the page to a reduced model: its body, a state, curves of a force."""

import math
import time
from collections.abc import Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.core.states import Fields
from myork.errors import InputError, MyorkError
from myork.rom.check import LEAST_FORCE
from myork.rom.model import OUTSIDE, Batch, ReducedModel
from myork.rom.parameters import value_of
from myork.rom.probes import probe_columns
from myork.summary import read_summary
from myork.types import F64

#: Fields by name, with title and kind of unit
FIELDS = {
    "von_mises": ("von Mises stress", "stress"),
    "principal": ("largest principal stress", "stress"),
    "strain": ("largest principal strain", ""),
    "J": ("volume ratio J", ""),
    "displacement": ("displacement", "length"),
}
#: An error is relative to the displacement, but at least to this share of the largest of the
#: training, as a probe is judged by its kind
_LEAST = 0.1
#: Share of a range below which its ends are rounding errors
_ROUNDING = 1e-9
#: Extension of sliders beyond a range, relative to it
_BEYOND = 0.15
#: Number of points of a curve
_POINTS = 31
#: Percentage of the sampled values at either end that get the end colour: stresses
#: at a few places are many times those elsewhere
_TAIL = 2.0
#: A solve on the same points whose force differs from the model's by more than this belongs to
#: another deck; models are trained to a tenth of it
_SAME = 0.01


class Shown(NamedTuple):
    """Display data of a state."""

    #: Numbers beside the body: probes, indicator, verdict with reasons, range of the field
    facts: dict[str, Any]
    positions: F64  #: Corners of the surface, shape `(n, 3)` [length]
    values: F64  #: The field there, not a number where J <= 0, shape `(n,)`


class Answers(AbstractContextManager["Answers"]):
    """A reduced model with its full scene, which gives fields; used by one thread at a time.

    - `path`: reduced model
    - `threads`: threads of a call
    """

    def __init__(self, path: Path, threads: int = 1) -> None:
        self.rom = rom = ReducedModel.load(path, threads=threads)
        full = rom.full_model()
        self._full = full.open(["load.steps=1"])
        points = self._full.points()
        self._corners, renumbered = np.unique(self._full.surface(), return_inverse=True)
        self.triangles = renumbered.reshape(-1, 3).astype(np.uint32)
        #: Undeformed corners of the surface, shape `(n, 3)` [length]
        self.rest = np.zeros((len(self._corners), 3))
        self.rest[:, : points.shape[1]] = points[self._corners]
        self.probes = self._probes()
        self.ranges, self._largest = self._ranges()
        self._bar = self._bar_of_force(path.parent)

    def __exit__(self, *_: object) -> None:
        self._full.close()

    def about(self) -> dict[str, Any]:
        """Data from which the page is built."""
        rom, units = self.rom, self.rom.units
        named = {**units, "": "-"}
        parameters = []
        for p in rom.parameters:
            more = _BEYOND * (p.high - p.low)
            low, high = p.low - more, p.high + more
            if p.kind == "activation":
                low, high = max(low, 0.0), min(high, 1.0)
            elif p.low > 0.0:
                # a modulus keeps its value
                low = max(low, 0.5 * p.low)
            unit = {
                "load": units["length"],
                "activation": "",
                "fiber_angle": "°",
                "rotation": "°",
            }.get(p.kind, units["stress"])
            parameters.append(
                {"key": p.key, "low": p.low, "high": p.high, "least": low, "most": high,
                 "unit": unit}
            )  # fmt: skip
        return {
            "title": rom.head["title"],
            "parameters": parameters,
            "start": self.start(),
            "probes": self.probes,
            "fields": [
                {"name": name, "title": title, "unit": named[unit], "range": self.ranges[name]}
                for name, (title, unit) in FIELDS.items()
            ],
            "length": units["length"],
            "tolerance": rom.head["tolerance"],
            "describe": rom.describe(),
            "bar": self._bar,
        }

    def start(self) -> list[float]:
        """Values of the first state: no load if that is in the range, otherwise the middle."""
        return [
            0.0 if p.columns and p.low <= 0.0 <= p.high else 0.5 * (p.low + p.high)
            for p in self.rom.parameters
        ]

    def state(self, values: Sequence[float], field: str) -> Shown:
        """A state with one field on the surface.

        - raises InputError: a wrong number of values, or no such field
        """
        if field not in FIELDS:
            raise InputError(f"{field}: no field; there are {', '.join(FIELDS)}")
        facts, positions, found = self.fields(values, [field])
        return Shown({**facts, "range": self.range_of(found[0], field)}, positions, found[0])

    def range_of(self, values: F64, field: str) -> Sequence[float | None]:
        """Smallest and largest finite value of a field."""
        real = values[np.isfinite(values)]
        if not len(real):
            return [None, None]
        return _rounded(np.array([real.min(), real.max()]), np.abs(self.ranges[field]).max())

    def fields(
        self, values: Sequence[float], names: Sequence[str] = tuple(FIELDS)
    ) -> tuple[dict[str, Any], F64, F64]:
        """A state with several fields on the surface.

        Returns facts without a range, positions `(n, 3)` [length], fields `(names, n)`.
        """
        row = np.array([values], float)
        start = time.perf_counter()
        batch = self.rom.batch(row, indicator=True)
        took = time.perf_counter() - start
        fields = self._fields(row[0], batch.amplitudes[0])
        found = np.stack([_field(fields, name)[self._corners] for name in names])
        j = fields.named["J"][:, 0]
        size = float(np.linalg.norm(batch.amplitudes[0])) / (_LEAST * self.rom.largest)
        error = float(batch.indicator[0]) * min(1.0, size)
        verdict, reasons = self._verdict(row[0], batch, float(j.min()))
        facts = {
            "probes": [_number(v) for v in self._values(batch)[0]],
            "indicator": _number(error),
            "inside": bool(batch.inside[0]),
            "converged": bool(batch.converged[0]),
            "verdict": verdict,
            "reasons": reasons,
            "J": [_number(j.min()), _number(j.max())],
            "ms": 1e3 * took,
        }
        return facts, self.rest + fields.u[self._corners], found

    def curve(self, values: Sequence[float], probe: int, k: int) -> dict[str, Any]:
        """A probe along a parameter through a state.

        - `values`: the state
        - `probe`, `k`: indices in `probes` and among the parameters
        - returns the index of the parameter, `x`, and `y`, None without a state
        """
        if not 0 <= probe < len(self.probes):
            raise InputError(f"probe {probe}: there are {len(self.probes)}")
        own = self.rom.parameters[k]
        rows = np.tile(np.asarray(values, float), (_POINTS, 1))
        rows[:, k] = np.linspace(own.low, own.high, _POINTS)
        batch = self.rom.batch(rows)
        found = np.where(batch.converged, self._values(batch)[:, probe], np.nan)
        return {"parameter": k, "x": rows[:, k].tolist(), "y": [_number(v) for v in found]}

    def _fields(self, row: F64, amplitudes: F64) -> Fields:
        """Fields of a state from the full scene; materials and prescribed values enter them."""
        wanted = {p.key: float(v) for p, v in zip(self.rom.parameters, row, strict=True)}
        self._full.update(wanted)
        return self._full.fields(self.rom.basis @ amplitudes, 1.0)

    def _probes(self) -> list[dict[str, str]]:
        """Names and units of the scalars of the probes, forces first."""
        found = []
        for probe in self.rom.head["probes"]:
            names = probe_columns(probe, self._full.dimension)
            found += [{"name": n, "unit": probe["unit"], "of": probe["name"]} for n in names]
        if not found:
            raise InputError("the reduced model has no probe to show")
        first = {p["name"] for p in self.rom.head["probes"] if p["quantity"].startswith("force")}
        return sorted(found, key=lambda p: p["of"] not in first)

    def _values(self, batch: Batch) -> F64:
        """Scalars of `probes`, shape `(n, probes)`."""
        scalars = batch.scalars()
        return np.stack([scalars[probe["name"]] for probe in self.probes], axis=1)

    def _verdict(self, row: F64, batch: Batch, smallest_j: float) -> tuple[str, list[str]]:
        """Verdict as in sweeps and `rom solve`, with the ranges that are exceeded."""
        verdict, reasons = batch.verdict(0)
        reasons = [reason for reason in reasons if reason != OUTSIDE] + [
            f"{p.key} = {v:.4g} is outside the trained range {p.low:g} to {p.high:g}"
            for p, v in zip(self.rom.parameters, row, strict=True)
            if not p.low <= v <= p.high and not batch.inside[0]
        ]
        if verdict != "refused" and smallest_j <= 0.0:
            verdict = "doubtful"
            reasons.insert(0, f"the material is inverted at a point: J = {smallest_j:.3g}")
        return verdict, reasons

    def _bar_of_force(self, folder: Path) -> dict[str, Any] | None:
        """Error of the first force from the check on unseen full solves; None without a check.

        It is relative to the force, or to a share of the largest if the force is smaller; with
        `full`, the error bar of the full model at full load, if its solve is in the same folder.
        """
        found, name = self.rom.certificate, self.probes[0]["of"]
        if not found or not any(p["rows"] for p in self.rom.head["probes"]):
            return None
        return {
            "of": name,
            "points": found["points"],
            "reduced": found["force"]["max"],
            "full": self._full_error(folder, name),
            "least": LEAST_FORCE * self._largest,
            "between": 0.0,
        }

    def _full_error(self, folder: Path, name: str) -> float | None:
        """Relative error bar of a force in the folder of the model; None if none belongs to it."""
        scene = self._full
        try:
            summary = read_summary(folder)
            last = summary["steps"][-1]
            force, error = (np.asarray(last[k][name]) for k in ("probes", "probe_errors"))
            row = [value_of(p, summary["deck"]) for p in self.rom.parameters]
            off = np.linalg.norm(force - self.rom.batch(np.array([row])).probes[name][0])
            of_it = (
                (summary["dofs"], summary["collocation_points"])
                == (scene.dofs, scene.collocation_points)
                and off < _SAME * np.linalg.norm(force)
                and summary["converged"]
                and summary["verdict"]["state"] != "refused"
            )
            return float(np.linalg.norm(error) / np.linalg.norm(force)) if of_it else None
        except (MyorkError, LookupError, TypeError, AttributeError, ValueError):
            # another program may be writing into the folder: then there is no bar
            return None

    def _ranges(self) -> tuple[dict[str, list[float]], float]:
        """Ranges of the colours: values at the ends of each parameter and in the middle.

        Also the largest value of the first probe there.
        """
        middle = np.array([0.5 * (p.low + p.high) for p in self.rom.parameters])
        rows = [middle]
        for k, p in enumerate(self.rom.parameters):
            for end in (p.low, p.high):
                rows.append(np.where(np.arange(len(middle)) == k, end, middle))
        batch = self.rom.batch(np.array(rows))
        found: dict[str, list[F64]] = {name: [] for name in FIELDS}
        for row, a in zip(np.array(rows)[batch.converged], batch.amplitudes[batch.converged],
                          strict=True):  # fmt: skip
            fields = self._fields(row, a)
            for name in FIELDS:
                found[name].append(_field(fields, name)[self._corners])
        if not found["J"]:
            raise InputError("the reduced model did not converge in its range: train it again")
        ranges = {}
        for name, values in found.items():
            every = np.concatenate(values)
            # stresses where J <= 0 are not numbers
            every = every[np.isfinite(every)]
            ends = np.percentile(every, [_TAIL, 100.0 - _TAIL])
            ranges[name] = _rounded(ends, float(np.abs(ends).max()))
        return ranges, float(np.abs(self._values(batch)[batch.converged, 0]).max())


def _field(fields: Fields, name: str) -> F64:
    """One number per point."""
    if name == "displacement":
        return np.linalg.norm(fields.u, axis=1)
    if name == "J":
        return np.asarray(fields.named["J"][:, 0])
    if name == "principal":
        return np.asarray(fields.named["principal_stress"].max(axis=1))
    if name == "strain":
        found = np.full(len(fields.f), np.nan)
        real = np.isfinite(fields.f).all(axis=(1, 2))
        f = fields.f[real]
        stretch = np.linalg.eigvalsh(np.einsum("pia,pib->pab", f, f))
        found[real] = np.sqrt(np.maximum(stretch[:, -1], 0.0)) - 1.0
        return found
    first, second, third = fields.named["principal_stress"].T
    squares = (first - second) ** 2 + (second - third) ** 2 + (third - first) ** 2
    return np.asarray(np.sqrt(0.5 * squares))


def _rounded(ends: F64, size: float) -> list[float]:
    """Ends of a range, zero where they are rounding errors relative to the size of the values."""
    return [0.0 if abs(end) < _ROUNDING * size else float(end) for end in ends]


def _number(value: Any) -> float | None:
    """A number that JSON can express."""
    return float(value) if math.isfinite(value) else None
