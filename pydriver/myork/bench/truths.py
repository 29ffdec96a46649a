"""Errors of answers against finite elements of the same problem, which are solved beside them.

felupe solves a problem on several meshes, bodies of voxels in their true shape; the limit of these
meshes is the truth, with what is not known of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from myork.bench.runs import read_deck
from myork.console import ProgressCallback
from myork.errors import ConvergenceError
from myork.reference.finite_elements import solve_deck
from myork.reference.problems import Problem, probe_kind
from myork.reference.voxel_bodies import Body, box_tables

__all__ = ["KINDS", "WRONG", "Truths", "lattice_text", "sized_tables", "solve_rivals"]

#: Kinds of probes
KINDS = ("displacement", "force", "stress", "surface stress")
#: An error that must not be accepted [-]
WRONG = 0.05


class Truth(NamedTuple):
    """Value of a probe, and by how much it may be off."""

    value: float
    doubt: float


class Truths(NamedTuple):
    """What is known of a problem's probes.

    Attributes
    ----------
    kinds : mapping
        Kind of each probe, by name.
    values : mapping
        Their truths.
    """

    kinds: Mapping[str, str]
    values: Mapping[str, Truth]

    def errors(self, probes: Mapping[str, float], bars: Mapping[str, float]) -> dict[str, Any]:
        """Compare an answer.

        Parameters
        ----------
        probes, bars : mapping
            Values and error bars, by name.

        Returns
        -------
        dict
            `error`, `bar` and `doubt` of the truth by probe, relative; `off`, the largest error
            beyond the doubt; `held`, how many bars hold; `error` and `bar` followed by a kind, the
            largest of it.
        """
        kinds, truths = self.kinds, self.values
        error = {
            name: abs(probes[name] - truth.value) / abs(truth.value)
            for name, truth in truths.items()
            if name in probes
        }
        bar = {
            name: bars[name] / abs(truths[name].value)
            for name in error
            if bars.get(name) is not None
        }
        doubt = {name: truths[name].doubt / abs(truths[name].value) for name in error}
        held = [error[name] <= bar[name] + doubt[name] for name in bar]
        largest = {
            f"{key} {kind}": max((of[name] for name in of if kinds[name] == kind), default=None)
            for kind in KINDS
            for key, of in (("error", error), ("bar", bar))
        }
        off = max((max(error[name] - doubt[name], 0.0) for name in error), default=None)
        return {
            "error": error,
            "bar": bar,
            "doubt": doubt,
            "off": off,
            "held": f"{sum(held)} of {len(held)}" if held else None,
            **largest,
        }


def solve_rivals(
    problem: Problem | Body, progress: ProgressCallback
) -> tuple[Truths, list[dict[str, Any]]]:
    """Solve a problem on all its meshes.

    Parameters
    ----------
    problem : Problem or Body
        Problem.
    progress : callable
        Called with every line of progress.

    Returns
    -------
    truths : Truths
        Limit of the meshes.
    rivals : list of dict
        Of each mesh `size`, `probes` (none where the iteration failed), `dofs`, `cpu_s` and
        `outcome`.
    """
    if isinstance(problem, Body):
        deck = read_deck(box_tables(problem))
    else:
        deck = read_deck(sized_tables(problem.tables, problem.sizes[0]))
    size = deck["geometry"].get("size")
    kinds = {entry["name"]: probe_kind(entry, size) for entry in deck["probe"]}
    rivals = []
    for count in problem.elements:
        progress(f"{problem.name}: finite elements, {lattice_text(count)}")
        found = _finite_elements(problem, deck, count)
        rivals.append({**found, "size": lattice_text(count)})
    limits = _truths([rival["probes"] for rival in rivals if rival["probes"]])
    return Truths(kinds, limits), rivals


def sized_tables(tables: Mapping[str, Any], size: Sequence[int]) -> dict[str, Any]:
    """Deck with its source points, and collocation points at half their spacing.

    Parameters
    ----------
    tables : mapping
        Deck without them.
    size : sequence of int
        Source points along each edge.
    """
    places = {"source": list(size), "collocation": [2 * n - 1 for n in size]}
    return {**tables, "geometry": {**tables["geometry"], **places}}


def lattice_text(count: Sequence[int]) -> str:
    """Numbers along the edges as tables show them."""
    return " x ".join(str(n) for n in count)


def _finite_elements(
    problem: Problem | Body, deck: Mapping[str, Any], count: Sequence[int]
) -> dict[str, Any]:
    """Last values of the probes, none where the iteration failed."""
    body = problem if isinstance(problem, Body) else None
    try:
        rival = solve_deck(
            deck, count, labels=body.part if body else None, warp=body.warp if body else None
        )
    except ConvergenceError as error:
        return {"probes": {}, "dofs": None, "cpu_s": None, "outcome": str(error)}
    probes = {name: values[-1] for name, values in rival["probes"].items()}
    return {**rival, "probes": probes, "outcome": "converged"}


def _truths(found: Sequence[Mapping[str, float]]) -> dict[str, Truth]:
    """Limit of the meshes: Aitken's where the changes shrink, otherwise the finest value."""
    truths = {}
    for name in found[-1] if found else ():
        values = [probes[name] for probes in found]
        last = values[-1]
        change = last - values[-2] if len(values) > 1 else abs(last)
        doubt = abs(change)
        if len(values) > 2:
            before = values[-2] - values[-3]
            if change * before > 0.0 and abs(change) < 0.7 * abs(before):
                rest = change * change / (before - change)
                last, doubt = last + rest, abs(rest)
        truths[name] = Truth(last, doubt)
    return truths
