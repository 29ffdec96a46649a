"""A hard case and its verdict.

What counts as wrong is an answer that is off and does not say so, a crash, and a run without an
end. The volume ratio is judged beside the probes: a stress may be right where volumes are not. It
is judged in the mean over the body, as the largest deviation says nothing: J has no limit at the
end of a held face, whatever the number of points.

Three bounds, none of them chosen to fit an answer: `ITERATED` where the body is homogeneous and
every form can give it, `ASKED` where the answer is known, `BESIDE` where finite elements gave it
and for J.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.problems import BY_NAME
from benchmarks.runner import Truths, solve_rivals
from benchmarks.truths.manufactured import Problem as Manufactured
from myork.bench.runs import METHODS, Deck
from myork.console import silent
from myork.records import PointCloud
from myork.types import F64

__all__ = [
    "ASKED",
    "BESIDE",
    "DOUBTED",
    "EXPLAINED",
    "FORMS",
    "ITERATED",
    "RIGHT",
    "WARNED",
    "Case",
    "bound",
    "judge",
    "volume_error",
]

#: Verdicts: the answer is right and accepted; it is refused or not reached, and the message says
#: why; it is right and the run doubts it; it is off and the run says so
RIGHT, EXPLAINED, DOUBTED, WARNED = "right", "explained", "right, doubted", "off, told"

#: All forms, the collocations first
FORMS = (*METHODS, "rkpm-gauss", "rkpm-scni")

#: What iterations leave of a homogeneous state: `solver.tolerance` [-]
ITERATED = 1e-6
#: Error that a user who says nothing asks for: the default of `accuracy` [-]
ASKED = 0.02
#: Error up to which an answer counts as right beside the limit of finite elements, which are
#: themselves some per mille off: that of docs/verdict.md [-]
BESIDE = 0.05

#: What is written down of earlier runs: errors of probes and of J by case
_MEASURED = Path(__file__).parent / "measured.json"


class Case(NamedTuple):
    """A hard case.

    Attributes
    ----------
    name : str
        What is hard.
    deck : Deck
        Name of an installed deck, or tables.
    overrides : tuple of str
        Overrides of the deck.
    cloud : PointCloud or None
        Points of the body, where it has no deck of its own.
    right : mapping
        Right values of probes; empty where there is none.
    rival : str
        Problem of `truths` whose right values finite elements give.
    tolerance : float
        Largest relative error of a right answer [-].
    volume : tuple of float
        Smallest and largest volume ratio of the right answer at full load [-].
    stray : float
        By how much J of a right answer may leave that range at full load, root mean square over
        the places of output [-].
    words : tuple of str
        Texts that the message of a refusal or the reasons of a doubt contain.
    expected : str
        Verdict; by itself `RIGHT` where there are right values and `EXPLAINED` elsewhere.
    why : str
        Why the verdict is neither of these two.
    fast : bool
        Takes a second or two.
    manufactured : tuple of Problem and str, or None
        Problem with a chosen solution in place of a deck, and its form.
    """

    name: str
    deck: Deck = ""
    overrides: tuple[str, ...] = ()
    cloud: PointCloud | None = None
    right: Mapping[str, float] = {}
    rival: str = ""
    tolerance: float = ASKED
    volume: tuple[float, float] = (1.0, 1.0)
    stray: float = BESIDE
    words: tuple[str, ...] = ()
    expected: str = ""
    why: str = ""
    fast: bool = True
    manufactured: tuple[Manufactured, str] | None = None

    @property
    def wanted(self) -> str:
        """Verdict that is expected."""
        return self.expected or (RIGHT if self.right or self.rival else EXPLAINED)


def bound(case: Case, what: str) -> float:
    """Twice the `error`, `stray` or `way` that `measured.json` has of a case; not below rounding.

    A case that it does not hold is new, and judged by its own bounds only.
    """
    known = _measured().get(case.name, {})
    return max(2.0 * float(known.get(what, 0.0)), ITERATED) if known else float("inf")


def volume_error(case: Case, j: F64) -> float:
    """Root mean square of what volume ratios leave the right range of a case by [-].

    Parameters
    ----------
    case : Case
        The case.
    j : NDArray
        Volume ratios at the places of output, shape `(n,)` [-].
    """
    low, high = case.volume
    return float(np.sqrt(np.mean((np.minimum(j - low, 0.0) + np.maximum(j - high, 0.0)) ** 2)))


def judge(case: Case, record: dict[str, Any]) -> str:
    """Verdict on a run.

    Parameters
    ----------
    case : Case
        The case.
    record : dict
        Its run, with `stray` where J is known (`volume_error`). Where it converged it gets
        `error`, the largest of its probes, with that probe's name as `worst`, and `way`: the
        largest J by which it leaves the range and rest, in any state.

    Returns
    -------
    str
        One of the four good verdicts; `wrong`, an answer that is off and accepted; `worse`, one
        whose error is more than twice what it was; `unexplained`, an end without what it must
        name; or the outcome of a run that crashed, failed or has no end.
    """
    outcome = record["outcome"]
    reasons = (record.get("verdict") or {}).get("reasons", [])
    warned = [text for text in record.get("warnings", []) if text.startswith("J at points")]
    told = " ".join([record["message"], *reasons, *warned])
    named = bool(told) and all(word in told for word in case.words)
    if outcome in ("refused", "not converged"):
        return EXPLAINED if named else "unexplained"
    if outcome not in ("converged", "done"):
        return str(outcome)
    accepted = (record.get("verdict") or {}).get("state", "accepted") == "accepted"
    if "error" not in record:
        errors = _errors(case, record)
        if not errors:
            # an answer to what has none
            return "wrong" if accepted else EXPLAINED if named else "unexplained"
        # what is not a number is no right answer
        errors = {name: e if math.isfinite(e) else math.inf for name, e in errors.items()}
        record["worst"] = max(errors, key=lambda name: errors[name])
        record["error"] = errors[record["worst"]]
    _note_volume(case, record)
    if record["error"] > case.tolerance or record.get("stray", 0.0) > case.stray:
        said = not accepted or (bool(warned) and record["error"] <= case.tolerance)
        return "wrong" if not said else WARNED if named else "unexplained"
    if any(record.get(what, 0.0) > bound(case, what) for what in ("error", "stray", "way")):
        return "worse"
    return RIGHT if accepted else DOUBTED if named else "unexplained"


@cache
def _truths_of(name: str) -> Truths:
    """Right values of a problem of `benchmarks`, by two meshes of finite elements."""
    problem = BY_NAME[name]
    return solve_rivals(problem._replace(elements=problem.elements[:2]), silent)[0]


def _errors(case: Case, record: Mapping[str, Any]) -> dict[str, float]:
    """Relative errors of the probes whose values are known, by name."""
    probes = record.get("probes", {})
    if case.rival:
        return dict(_truths_of(case.rival).errors(probes, {})["error"])
    return {name: abs(probes[name] / value - 1.0) for name, value in case.right.items()}


def _note_volume(case: Case, record: dict[str, Any]) -> None:
    """How far J is off anywhere, in any state."""
    if "max_J" not in record:
        return
    low, high = case.volume
    record["way"] = max(min(low, 1.0) - record["min_J"], record["max_J"] - max(high, 1.0), 0.0)


@cache
def _measured() -> dict[str, dict[str, float]]:
    known: dict[str, dict[str, float]] = json.loads(_MEASURED.read_text(encoding="utf-8"))
    return known
