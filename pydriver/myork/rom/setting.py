"""Data common to all models of one training."""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from typing import Any, NamedTuple

import numpy as np

from myork.core.galerkin import GalerkinParts, LoadParts, galerkin_parts, load_parts
from myork.core.scene import Scene
from myork.errors import InputError
from myork.rom import projection
from myork.rom.full import FullModel
from myork.rom.online import Conditions, conditions_of
from myork.rom.parameters import Parameter, ends_of, value_of
from myork.rom.probes import is_stress
from myork.rom.projection import Columns, Laws, Variant, laws_of
from myork.tables import override_text
from myork.types import F64, I64

#: Errors by rounding and iteration of forces that are zero by symmetry, relative to the largest
#: bulk modulus times the section of a cube of the body's volume
_ROUNDING = 1e-6


class Snapshots(NamedTuple):
    """Full states with the conditions they were solved for."""

    values: F64  #: Values of the parameters, those of loads scaled along the path, shape `(n, p)`
    share: F64  #: Fraction of the loads other than the parameters, shape `(n,)`
    x: F64  #: Unknowns, shape `(n, dofs)`
    probes: F64  #: Values of the probes, shape `(n, probes, 3)`


class Setting(NamedTuple):
    """Data common to all models of one training."""

    parameters: tuple[Parameter, ...]  #: Keys with their ranges
    laws: Laws  #: Materials
    parts: GalerkinParts  #: Integration points
    #: Prescribed loads other than the parameters, a unit of each load or two of a rotation, and a
    #: unit of each set whose force is wanted and that no load moves
    columns: Columns
    extra: int  #: Number of the last ones
    wanted: I64  #: Columns whose forces are wanted
    threads: int
    #: Keys of the values of those sets, with the values and the ends of their amplitudes
    still: tuple[tuple[str, float, float], ...]
    #: Traction parts of the wanted forces, by the columns, shape `(nf, columns)`
    pushes: F64
    places: tuple[tuple[int, int], ...]  #: Probe and component of each wanted force
    #: The full model at other values of the moduli that are parameters
    variants: tuple[Variant, ...]
    stresses: tuple[int, ...]  #: Probes of stresses, from 0
    rounding: float  #: Smaller forces are errors of rounding and iteration [force]

    def conditions(self, values: F64, share: F64 | None = None) -> Conditions:
        """Conditions of states from their parameters."""
        return conditions_of(values, self.parameters, self.laws, self.extra, share)


def make_setting(
    scene: Scene,
    kinds: tuple[Parameter, ...],
    deck: Mapping[str, Any],
    full: FullModel,
    threads: int,
    opened: ExitStack,
) -> tuple[Setting, dict[str, Any]]:
    """Data that do not depend on the snapshots, and the head of the file.

    Scenes at other values of moduli are opened in `opened`.

    - raises InputError: a modulus that does not enter the model linearly
    """
    base, units = full.loads(kinds)
    parts = galerkin_parts(scene)
    probes = deck["probe"]
    loads = [base, *units]
    wanted: list[int] = []
    still: list[tuple[str, float, float]] = []
    pushes: list[F64] = []
    extra: list[F64] = []
    places: list[tuple[int, int]] = []
    entries: list[dict[str, Any]] = []
    for index, (probe, of_set) in enumerate(zip(probes, parts.probe_sets, strict=True)):
        quantity = probe["quantity"]
        rows: list[int] = []
        if quantity == "force" or quantity in ("force_x", "force_y", "force_z"):
            all_axes = range(scene.dimension)
            axes = all_axes if quantity == "force" else ["xyz".index(quantity[-1])]
            for place, axis in enumerate(axes):
                rows.append(len(wanted))
                places.append((index, place))
                on = parts.set == of_set
                value = np.zeros((len(parts.set), scene.dimension))
                value[on, axis] = parts.essential[on, axis]
                pushes.append(np.array([load.push[on, axis].sum() for load in (base, *units)]))
                same = [k for k, load in enumerate(loads) if np.array_equal(load.value, value)]
                if not same:
                    extra.append(value)
                    loads.append(_unit_load(scene, len(parts.weight), value))
                    still += _prescribed(deck, probe["set"], axis)
                    same = [len(loads) - 1]
                wanted.append(same[0])
        elif is_stress(quantity) and not any(p.kind == "modulus" for p in kinds):
            pass
        elif quantity not in ("u", "u_x", "u_y", "u_z") or of_set > 0:
            continue
        name = probe["name"]
        entries.append(
            {"name": name, "quantity": quantity, "unit": deck["probe_units"][name],
             "rows": rows, "index": index}
        )  # fmt: skip
    push = np.zeros((len(wanted), len(loads)))
    push[:, : 1 + len(units)] = np.reshape(pushes, (len(wanted), 1 + len(units)))
    known = [entry["name"] for entry in entries]
    moduli = [p for p in kinds if p.kind == "modulus"]
    variants = []
    for p in moduli:
        own = value_of(p, deck)
        other = p.low if own - p.low > p.high - own else p.high
        middle = 0.5 * (other + own)
        ends = [opened.enter_context(full.open([override_text(p.key, v)])) for v in (middle, other)]
        more = full.loads(kinds, [override_text(p.key, other)])
        variants.append(_variant(p, deck, parts, ends, [more[0], *more[1]], extra))
    laws = laws_of(scene, [value_of(p, deck) for p in moduli])
    stiffest = max(parts.bulk.max(initial=0.0), parts.local_bulk.max(initial=0.0))
    rounding = _ROUNDING * float(stiffest * parts.weight.sum() ** (1.0 - 1.0 / scene.dimension))
    setting = Setting(
        kinds, laws, parts, projection.Columns.of(loads),
        len(loads) - 1 - len(units), np.array(wanted, np.int64), threads,
        tuple(still), push, tuple(places), tuple(variants),
        tuple(entry["index"] for entry in entries if is_stress(entry["quantity"])), rounding,
    )  # fmt: skip
    head = {
        "title": deck["title"],
        "units": deck["result_units"],
        "dimension": scene.dimension,
        "parameters": [list(p) for p in kinds],
        "force_amplitudes": setting.extra,
        "rounding": rounding,
        "probes": entries,
        "probes_left_out": [p["name"] for p in probes if p["name"] not in known],
    }
    return setting, head


def _variant(
    parameter: Parameter,
    deck: Mapping[str, Any],
    parts: GalerkinParts,
    scenes: Sequence[Scene],
    loads: Sequence[LoadParts],
    extra: Sequence[F64],
) -> Variant:
    """The full model at another value of a modulus, from scenes half-way there and there."""
    half, there = (galerkin_parts(scene) for scene in scenes)
    for name in ("bulk", "local_bulk", "basis", "weight"):
        old, middle, new = (getattr(p, name) for p in (parts, half, there))
        size = np.abs(new).max(initial=np.finfo(float).tiny)
        moved = np.abs(new - old).max(initial=0.0) if name in ("basis", "weight") else 0.0
        if max(np.abs(0.5 * (old + new) - middle).max(initial=0.0), moved) > 1e-9 * size:
            raise InputError(
                f"{parameter.key}: the model does not depend linearly on it, as where groups of "
                "cells hold tissues of several moduli: a reduced model cannot vary it"
            )
    scene = scenes[1]
    found = [*loads, *(_unit_load(scene, len(parts.weight), value) for value in extra)]
    return Variant(
        value_of(parameter, scene.deck) - value_of(parameter, deck), scene, there,
        laws_of(scene), projection.Columns.of(found),
    )  # fmt: skip


def force_values(setting: Setting, probes: F64) -> F64:
    """Wanted forces of states from the values of their probes, shape `(n, probes, 3)`."""
    columns = [probes[:, index, place] for index, place in setting.places]
    return np.stack(columns, axis=1) if columns else np.zeros((len(probes), 0))


def _prescribed(deck: Mapping[str, Any], of_set: str, axis: int) -> list[tuple[str, float, float]]:
    """Key, value and end of the amplitude of a displacement of a set.

    None where it is not a number, or where its amplitude ends at zero.
    """
    name = f"u_{'xyz'[axis]}"
    entries = [b for b in deck["boundary"] if b["set"] == of_set and name in b]
    if len(entries) != 1 or isinstance(entries[0][name], str):
        return []
    key = f"boundary.{of_set}.{name}"
    return [(key, float(entries[0][name]), end) for end in ends_of(deck)[key] if end != 0.0]


def _unit_load(scene: Scene, points: int, value: F64) -> LoadParts:
    """Loads due to displacements of surface points; the scene's own loads are overwritten."""
    fields = np.zeros((len(scene.field_points()), 3))
    fields[points:, : value.shape[1]] = value
    scene.set_fields(np.zeros_like(fields), fields, np.zeros((len(fields), 3, 3)))
    return load_parts(scene)
