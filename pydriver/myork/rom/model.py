"""A trained reduced model: answers within a millisecond, each with its error."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from myork.core.deck import deck_key
from myork.core.online import Cells, Model
from myork.core.threads import checked_threads
from myork.errors import FileError, InputError
from myork.model_file import model_of_bytes
from myork.rom.full import FullModel
from myork.rom.marks import DOUBTFUL, LOST, NAMES, NEAR_LOST, Marks
from myork.rom.online import MOST_STEPS, Answer, Conditions, Regression, Solver, conditions_of
from myork.rom.parameters import Parameter, check_possible, short_names, widths_of
from myork.rom.places import Places
from myork.rom.probes import is_stress
from myork.rom.projection import Laws
from myork.rom.store import read_arrays, write_arrays
from myork.types import F64, I64, Mask

#: Reason for doubt in answers of a model that was trained without a test
OUTSIDE = "outside the training range"
NOT_TESTED = "not tested: the model was trained with --tests 0"


class Batch(NamedTuple):
    """Answers for many parameters."""

    force: F64  #: The first force probe, shape `(n,)`, or `(n, 3)` where it is a vector
    probes: dict[str, F64]  #: Values of all probes of the model by name
    #: Estimated relative error of the displacement; not a number where it was not asked for
    indicator: F64
    inside: Mask  #: Whether the parameters lie in the range of the training
    #: The worst mark of the full solves nearby: 1 accepted, 2 doubtful, 3 unstable or not found, 0
    #: without a mark
    full: I64
    #: Whether the tolerance of the training is met, according to its test: inside, not near lost
    #: states, and with a small estimate; it needs the indicator
    certified: Mask
    #: Whether the state solves the equations; a fixed number of corrections may be too small
    converged: Mask
    iterations: I64  #: Newton iterations
    amplitudes: F64  #: Amplitudes of the modes, shape `(n, r)`
    tested: Mask  #: Whether the model was tested on unseen states, equal for all

    def scalars(self) -> dict[str, F64]:
        """Probes as scalars by name, vector components with their axis appended, `(n,)` each."""
        found = {}
        for name, value in self.probes.items():
            if value.ndim == 1:
                found[name] = value
            else:
                found |= {f"{name}_{axis}": v for axis, v in zip("xyz", value.T, strict=False)}
        return found

    def doubts(self, k: int) -> list[str]:
        """Reasons for doubt in an answer with an indicator, one sentence each."""
        lost = self.full[k] == LOST
        found = {
            "the reduced model did not converge": not self.converged[k],
            OUTSIDE: not self.inside[k],
            NEAR_LOST: lost,
            "full solves nearby are doubtful": self.full[k] == DOUBTFUL,
        }
        if self.converged[k] and self.inside[k] and not lost:
            error = f"the estimated error of {self.indicator[k]:.1e} is too large to be certified"
            found[error if self.tested[k] else NOT_TESTED] = not self.certified[k]
        return [reason for reason, holds in found.items() if holds]

    def verdict(self, k: int) -> tuple[str, list[str]]:
        """Verdict on the reduction of an answer with an indicator, with the reasons."""
        reasons = self.doubts(k)
        if not self.converged[k]:
            return "refused", reasons
        return ("doubtful" if reasons else "accepted"), reasons


class ReducedState:
    """Answer for one set of parameters."""

    def __init__(
        self, parameters: dict[str, float], batch: Batch, shapes: F64, probe_units: dict[str, str],
        tested: list[str], bars: dict[str, float],
    ) -> None:  # fmt: skip
        self.parameters = parameters  #: Values by key
        self.force: Any = batch.force[0].tolist()  #: The first force probe of the deck
        #: Values of all probes of the model by name, and their units, empty for ratios
        self.probes = {name: value[0].tolist() for name, value in batch.probes.items()}
        self.probe_units = probe_units
        #: Estimated relative error of the displacement
        self.indicator = float(batch.indicator[0])
        #: Whether the parameters lie in the range of the training; whether this is a solution
        self.inside = bool(batch.inside[0])
        self.converged = bool(batch.converged[0])
        #: Result of nearby full solves: unknown, accepted, doubtful, lost (unstable or not found)
        self.full = NAMES[batch.full[0]]
        #: Whether the tolerance of the training is met, according to its test, and reasons against
        #: the answer
        self.certified = bool(batch.certified[0])
        #: Names of the probes that the tolerance refers to
        self.certified_probes = tested if self.certified else []
        #: Largest errors of all probes at the test states, by the names of `Batch.scalars`
        self.probe_errors = bars if self.certified else {}
        self.doubts = batch.doubts(0)
        self.iterations = int(batch.iterations[0])  #: Newton iterations
        self._amplitudes = batch.amplitudes[0]
        self._shapes = shapes

    def u(self) -> F64:
        """Displacement at the collocation points, shape `(npoint, 3)` [length]."""
        return np.asarray(self._shapes @ self._amplitudes)

    def as_dict(self) -> dict[str, Any]:
        """Content that `myork rom solve --json` prints."""
        names = (
            "parameters", "force", "probes", "probe_errors", "probe_units", "indicator", "inside",
            "converged", "full", "certified", "certified_probes", "doubts", "iterations",
        )  # fmt: skip
        return {name: getattr(self, name) for name in names}

    def describe(self) -> str:
        """Parameters, probes and their reliability, in lines."""
        given = ", ".join(f"{key} = {_six_digits(x)}" for key, x in self.parameters.items())
        found = []
        for name, value in self.probes.items():
            names = [f"{name}_{axis}" for axis in "xyz"] if isinstance(value, list) else [name]
            bars = ", ".join(f"{self.probe_errors[k]:.2g}" for k in names if k in self.probe_errors)
            bar = f" +- {bars}" if bars else ""
            found.append(f"  {name} {_six_digits(value)}{bar} {self.probe_units[name]}".rstrip())
        error = f"estimated relative error of the displacement {self.indicator:.1e}"
        sure = f"within the tolerance of the training: {', '.join(self.certified_probes)}"
        held = sure if self.certified else "not certified"
        quality = "; ".join([f"{error}, {held}", *self.doubts])
        return "\n".join([f"at {given}", *found, quality])

    def __repr__(self) -> str:
        return "ReducedState(" + ", ".join(f"{k}={v}" for k, v in self.as_dict().items()) + ")"


class ReducedModel:
    """A reduced model that can be saved after its training.

    `ReducedModel.train` makes one from a deck, `ReducedModel.load` reads one from a file; it needs
    neither the deck nor an image afterwards. Attributes:

    - `parameters`: free keys, with the ranges of the training
    - `certificate`: errors measured on states outside the training
    - `units`, `probe_units`: units of force, length, stress and volume; of each probe by name,
      empty for ratios
    - `largest`: largest displacement of the training, in L2 over the body [length^(5/2)]

    >>> from myork import ReducedModel
    >>> rom = ReducedModel.load("muscle.rom.h5")  # doctest: +SKIP
    >>> rom.solve(activation=0.4, u_z=0.2).force  # doctest: +SKIP
    """

    def __init__(self, arrays: Mapping[str, Any], threads: int = 0) -> None:
        from scipy.spatial import cKDTree

        threads = checked_threads(threads)
        self._arrays = dict(arrays)
        head = json.loads(arrays["head"])
        self.head: dict[str, Any] = head
        self.parameters = tuple(
            Parameter._make((*entry, tuple(tissues), end))
            for *entry, tissues, end in head["parameters"]
        )
        self.units: dict[str, str] = head["units"]
        self.probe_units: dict[str, str] = {p["name"]: p["unit"] for p in head["probes"]}
        self.certificate: dict[str, Any] = head.get("certificate", {})
        self._laws = Laws(*(np.asarray(arrays[f"laws/{name}"]) for name in Laws._fields))
        self._extra = int(head["force_amplitudes"])
        whole = _cells(arrays, "force")
        r, m = int(head["modes"]), int(head["indicator_modes"])
        self.modes = r
        model = _model(arrays, "online", r)
        finer = _model(arrays, "indicator", m)
        wanted = np.asarray(arrays["wanted"], np.int64)
        # a ten-thousandth of the largest state: near rest no step is small relative to the state
        sizes = np.linalg.norm(np.asarray(arrays["training/amplitudes"]), axis=1)
        self.largest = float(sizes.max())
        self._least = least = 1e-4 * self.largest
        few = np.concatenate([np.arange(r), np.arange(m, whole.h.shape[2])])
        self._solver = Solver(model, whole.modes(few), wanted + r, threads, least)
        self._places = None
        if "places/pressure" in arrays:
            self._places = Places(arrays, _cells(arrays, "places"), model.fibers)
        self._finer = Solver(finer, finer.cells, np.zeros(0, np.int64), threads, least)
        self._points = np.asarray(arrays["training/parameters"])
        self._amplitudes = np.asarray(arrays["training/amplitudes"])
        self.marks = Marks(np.asarray(arrays["marks/values"]), np.asarray(arrays["marks/mark"]))
        scale = widths_of(self.parameters)
        forces = np.asarray(arrays["training/forces"])
        self._scale = scale
        self._lifts = Regression(
            np.asarray(arrays["lifts/parameters"]), np.asarray(arrays["lifts/values"]), scale
        )
        self._regression = Regression(self._points, np.hstack([self._amplitudes, forces]), scale)
        # equal for all states
        self._known = self.conditions(self._points)
        self._tree = cKDTree(self._points / scale)
        self._names = short_names(self.parameters)
        self._ends = np.array([[p.low, p.high] for p in self.parameters]).T

    @classmethod
    def train(
        cls, deck: str | Path, parameters: Mapping[str, Any], **settings: Any
    ) -> "ReducedModel":
        """Train a reduced model of a deck; see `myork.rom.train.train` for the settings.

        - `deck`: deck file; its method is one of the Galerkin forms
        - `parameters`: ranges `(low, high)` by key: `load.activation`, `material.NAME.sigma_max`,
          `boundary.SET.u_z`; the last word of a key is enough
        - `**settings`: `tolerance`, `full_solves`, `seed`, `out`, `overrides`, `threads`,
          `progress`
        """
        from myork.rom.train import train

        return train(deck, parameters, **settings)

    @classmethod
    def load(cls, path: str | Path, threads: int = 0) -> "ReducedModel":
        """Read a model from its file.

        - raises FileError: there is no such file, or it is damaged
        - raises InputError: it has another version
        """
        arrays = read_arrays(Path(path))
        try:
            return cls(arrays, threads)
        except (LookupError, ValueError, TypeError) as reason:
            raise FileError(
                f"{path}: is not a file written by `myork rom train`: "
                f"{type(reason).__name__}: {reason}"
            ) from None

    def save(self, path: str | Path) -> Path:
        """Write the model to a file."""
        path = Path(path)
        self._arrays["head"] = json.dumps(self.head)
        write_arrays(path, self._arrays)
        return path

    def set_certificate(self, certificate: dict[str, Any]) -> None:
        """Store the errors measured on unseen states."""
        self.certificate = self.head["certificate"] = certificate

    def describe(self) -> str:
        """Description of the model and of its measured errors, in a few lines."""
        c = self.certificate
        cells = self.head["cells"]
        lines = [
            f"{self.head['title']}: {self.modes} modes, {cells['kept']} of {cells['all']} cells",
            *(f"  {p.key} from {p.low:g} to {p.high:g}" for p in self.parameters),
        ]
        if c:
            u, force, sure, rough = c["u"], c["force"], c["certified"], c["regression"]["force"]
            head = self.head
            lines += [
                f"{c['points']} unseen states, {c['failed']} failed:",
                f"  displacement: error {u['median']:.1e} in the median, {u['max']:.1e} at most",
                f"  force: error {force['median']:.1e} in the median, {force['max']:.1e} at most",
                f"  at the {sure['points']} that it certifies: displacement {sure['u']:.1e} of the "
                f"largest, force {sure['force']:.1e} at most"
                if sure["points"]
                else f"  certified: none, as no error is estimated below {head['tolerance']:g}",
                f"  estimated over true error: {c['indicator_ratio']['min']:.2f} to "
                f"{c['indicator_ratio']['max']:.2f}",
                f"  {c['cpu_us_per_state']:.0f} us per state, {c['full_cpu_s_per_state']:.2f} s a "
                "full one (processor time)",
                f"regression of the same {head['full_solves']} full solves:",
                f"  force: error {rough['median']:.1e} in the median, {rough['max']:.1e} at most",
                f"  {c['regression']['cpu_us_per_state']:.0f} us per state, made in "
                f"{head['solves_cpu_s']:.0f} s, the reduced model in {head['offline_cpu_s']:.0f} s",
            ]
            if c["lost"]:
                lines.append(
                    f"  left out: {c['lost']} states without a stable full solution, "
                    f"{c['lost_unmarked']} of them not marked"
                )
        else:
            lines.append(f"  {NOT_TESTED}; all its answers are doubtful")
        if self.head["probes_left_out"]:
            lines.append(f"probes left out: {', '.join(self.head['probes_left_out'])}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return f"ReducedModel({self.describe()})"

    def solve(self, /, **values: float) -> ReducedState:
        """The state for one set of parameters, with its estimated error.

        - `**values`: values by key or by the last word of a key; all parameters are needed
        - raises InputError: an unknown parameter, or one without a value
        """
        row = self.rows(values)
        batch = self.batch(row, indicator=True)
        named = {p.key: float(v) for p, v in zip(self.parameters, row[0], strict=True)}
        of = [(q["quantity"].partition("_")[0], q["name"]) for q in self.head["probes"]]
        tested = [name for kind, name in of if kind == "u"]
        tested += [name for kind, name in of if kind == "force"][:1]
        shapes = np.asarray(self._arrays["shapes"])
        bars = self.certificate.get("probes", {})
        return ReducedState(named, batch, shapes, self.probe_units, tested, bars)

    def batch(
        self, values: F64, corrections: int | str = "converged", *, indicator: bool = False
    ) -> Batch:
        """States of many sets of parameters.

        - `values`: values in the order of `parameters`, shape `(n, p)`
        - `corrections`: Newton iterations after the regression; 0 for the regression alone
        - `indicator`: estimate the errors; it doubles the cost
        - raises InputError: values that no deck may have, such as activations above 1
        """
        try:
            values = np.atleast_2d(np.asarray(values, float))
        except (TypeError, ValueError):
            raise InputError("values must be an array of numbers, a row for each state") from None
        if not len(values) or values.shape[1:] != (len(self.parameters),):
            raise InputError(
                f"values must have shape (n, {len(self.parameters)}) with at least one row, not "
                f"{values.shape}"
            )
        with np.errstate(over="ignore"):
            if not np.isfinite(values / self._scale).all():
                raise InputError("values must be finite numbers, also in ranges of the training")
        for p, column in zip(self.parameters, values.T, strict=True):
            check_possible(p.key, column)
        most = MOST_STEPS if corrections == "converged" else corrections
        if not isinstance(most, int) or not 0 <= most <= MOST_STEPS:
            raise InputError(f'corrections must be 0, 1, 2 or "converged", not {corrections!r}')
        guess = self._regression(values)
        start, forces = guess[:, : self.modes], guess[:, self._amplitudes.shape[1] :]
        conditions = self.conditions(values)
        if most == 0:
            none = np.zeros(len(values), np.int64)
            # no equation was evaluated
            answer = Answer(start, forces, none, none > 0, np.full(len(values), np.nan))
        else:
            answer = self._solver.solve(
                conditions, start, self._known, self._amplitudes[:, : self.modes],
                np.asarray(self._tree.query(values / self._scale)[1]), most,
                self._lifts(values).reshape(len(values), self.modes, -1),
            )  # fmt: skip
        error = np.full(len(values), np.nan)
        if indicator:
            error = self._indicate(conditions, answer)
        probes = self._probes(conditions, answer)
        # without a state there is nothing to measure
        for found in (error, *probes.values()):
            found[~answer.converged & (most == MOST_STEPS)] = np.nan
        names = [q["name"] for q in self.head["probes"] if q["quantity"].startswith("force")]
        force = probes[names[0]] if names else np.full(len(values), np.nan)
        margin = 1e-9 * self._scale
        within = (values >= self._ends[0] - margin) & (values <= self._ends[1] + margin)
        inside = np.asarray(within.all(axis=1))
        full = self.marks.worst(values, self._scale)
        # relative to the largest state, like the tolerance; comparisons with not-a-number are false
        size = np.linalg.norm(answer.amplitudes, axis=1) / self.largest
        worst = error * size * self.certificate.get("over_estimate", np.nan)
        certified = inside & answer.converged & (full < LOST) & (worst <= self.head["tolerance"])
        return Batch(
            force, probes, error, inside, full, certified, answer.converged, answer.iterations,
            answer.amplitudes, np.full(len(values), bool(self.certificate)),
        )  # fmt: skip

    def key_of(self, name: str) -> str:
        """Key of a parameter by a key of the deck, as in `--set`, or its short name."""
        names = self._names
        if name not in names and "." in name:
            name = deck_key("deck", name, self.head["overrides"], self.head["deck"])
        if name not in names:
            keys = ", ".join(p.key for p in self.parameters)
            raise InputError(f"{name}: not a parameter of this reduced model; it has {keys}")
        return names[name]

    def rows(self, given: Mapping[str, Any], count: int = 1) -> F64:
        """Values in the order of `parameters`, shape `(count, p)`.

        - `given`: by key or short name a number, its text, or one for each row
        - `count`: number of rows
        - raises InputError: an unknown parameter, a missing one, or a value that is not a number
        """
        named = {self.key_of(name): value for name, value in given.items()}
        missing = [p.key for p in self.parameters if p.key not in named]
        if missing:
            raise InputError(
                f"no value for {', '.join(missing)}: give each a number, in a command by "
                "--set KEY=VALUE"
            )
        rows = np.empty((count, len(self.parameters)))
        for k, p in enumerate(self.parameters):
            try:
                rows[:, k] = np.asarray(named[p.key]).astype(float)
            except ValueError:
                raise InputError(f"{p.key}: the reduced model takes numbers only") from None
        return rows

    def conditions(self, values: F64) -> Conditions:
        """Conditions of states from their parameters."""
        return conditions_of(values, self.parameters, self._laws, self._extra)

    @property
    def basis(self) -> F64:
        """Modes, columns of unknowns of the full model, orthonormal with respect to the mass."""
        return np.asarray(self._arrays["basis"])

    def full_model(self) -> FullModel:
        """The full model from which this one was made."""
        cloud, head = None, self.head
        if "cloud" in self._arrays:
            content = np.asarray(self._arrays["cloud"]).tobytes()
            cloud = model_of_bytes(content, "the reduced model's 'cloud'")
        return FullModel(head["deck"], head["overrides"], cloud, self._solver.threads or None)

    def _indicate(self, conditions: Conditions, answer: Answer) -> F64:
        """Relative size of a Newton step in a larger basis."""
        n, m = len(answer.amplitudes), self._finer.model.r
        start = np.zeros((n, m))
        start[:, : self.modes] = answer.amplitudes
        finer = self._finer.newton(conditions, start, tolerance=np.inf, most=1)[0].amplitudes
        size = np.linalg.norm(finer, axis=1)
        return np.linalg.norm(finer - start, axis=1) / np.maximum(size, self._least)

    def _probes(self, conditions: Conditions, answer: Answer) -> dict[str, F64]:
        """Values of the probes: forces, with tractions added, and displacements."""
        push = answer.force + conditions.given @ np.asarray(self._arrays["tractions"]).T
        found = {}
        named = [probe for probe in self.head["probes"] if is_stress(probe["quantity"])]
        if self._places is not None:
            kinds = {k: probe["quantity"] for k, probe in enumerate(named)}
            stress = self._places.values(conditions, answer.amplitudes, kinds)
        for probe in self.head["probes"]:
            if is_stress(probe["quantity"]):
                value = stress[named.index(probe)][:, None]
            elif probe["quantity"].startswith("force"):
                rows = probe["rows"]
                value = push[:, rows]
            else:
                shapes = np.asarray(self._arrays[f"probes/{probe['name']}"])[:, : self.modes]
                value = answer.amplitudes @ shapes.T
            found[probe["name"]] = value[:, 0] if value.shape[1] == 1 else value
        return found


def _six_digits(value: Any) -> str:
    return ", ".join(f"{number:.6g}" for number in np.atleast_1d(value))


def _cells(arrays: Mapping[str, Any], name: str) -> Cells:
    kinds = dict.fromkeys(("first", "tissue"), np.int32)
    return Cells(
        *(
            np.asfortranarray(np.asarray(arrays[f"{name}/{key}"], kinds.get(key, float)))
            for key in Cells._fields
        )
    )


def _model(arrays: Mapping[str, Any], name: str, r: int) -> Model:
    keys = ("constant", "constant_slope", "volume", "volume_slope")
    numbers = (np.asfortranarray(np.asarray(arrays[f"{name}/{key}"], float)) for key in keys)
    fibers = np.asfortranarray(np.asarray(arrays["laws/fibers"]).T)
    return Model._make((r, _cells(arrays, name), *numbers, fibers))
