"""Hard cases beside finite elements: bending, coarse blocks, three tissues, lost ellipticity."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.hard.case import BESIDE, DOUBTED, FORMS, RIGHT, WARNED, Case
from benchmarks.problems import BY_NAME
from benchmarks.runner import sized_tables
from benchmarks.voxel_bodies import body_cloud
from myork.bench.runs import METHODS

__all__ = ["bent_cases"]

#: Expected verdict, why, and texts of its reasons
Ending = tuple[str, str, tuple[str, ...]]

_STRONG = "least squares of second derivatives hardly see bending (docs/theory/collocation.md)"
_COARSE = "points this coarse do not resolve the stress at a point"
_STIFF = "points this coarse are too stiff"
_LOCKS = "the published form locks (docs/mixed.md)"
_RIMS = "J strays where held faces end, which are singular"
_CAUTION = "the answer is right, and its bar too wide to be sure of it"


def bent_cases() -> list[Case]:
    """All of them."""
    return [*_beams(), *_columns(), *_blocks(), *_tissues(), *_unstable()]


def _beside(
    name: str,
    size: Sequence[int],
    form: str,
    expected: str,
    why: str,
    words: tuple[str, ...] = (),
    jitter: float = 0.0,
) -> Case:
    """A problem of `truths` with few points."""
    tables = sized_tables(BY_NAME[name].tables, size)
    if jitter:
        tables["geometry"]["jitter"] = jitter
    moved = f", lattice moved by {jitter:g} h" if jitter else ""
    points = "x".join(str(n) for n in size)
    return Case(
        f"{name}, {points}{moved}, {form}",
        tables,
        (f"scene.method={form}",),
        rival=name,
        tolerance=BESIDE,
        words=words,
        expected=expected,
        why=why,
        fast=len(size) == 2,
    )


def _beams() -> list[Case]:
    """Plane beams, on lattices and on moved points."""
    strong: Ending = (WARNED, _STRONG, ("the stress does",))
    off = dict.fromkeys(METHODS, strong)
    doubted: Ending = (DOUBTED, _CAUTION, ())
    coarse: Ending = (WARNED, _COARSE, ("probe inside",))
    right: Ending = (RIGHT, _RIMS, ())
    return [
        _beside(
            name,
            (17, 5),
            form,
            *{**off, "rkpm-gauss": gauss, "rkpm-scni": nodal}[form],
            jitter=jitter,
        )
        for name, jitter, gauss, nodal in (
            ("cantilever, dead traction", 0.0, right, right),
            ("cantilever, dead traction", 0.3, doubted, right),
            ("clamped beam, end shear", 0.0, doubted, coarse),
            ("clamped beam, end shear", 0.3, right, coarse),
        )
        for form in FORMS
    ]


def _columns() -> list[Case]:
    """Bodies that bend and turn in space, four points across."""
    found = []
    for name, size in (("column, leaning load", (4, 4, 10)), ("twist", (4, 4, 9))):
        for form in FORMS:
            case = _beside(name, size, form, WARNED, _COARSE)
            if form in METHODS:
                case = case._replace(why=_STRONG, words=("the stress does",))
            elif form == "rkpm-scni":
                case = case._replace(why=_STIFF)
            found.append(case)
    return found


def _blocks() -> list[Case]:
    """Coarse blocks of contracting muscle with inclined fibers: some stall, the others say so."""
    found = []
    for size in ((3, 3, 5), (4, 4, 7)):
        for form in FORMS:
            case = _beside("inclined block", size, form, WARNED, _COARSE)
            if form == "rkcm":
                case = case._replace(why=_LOCKS)
                if size[0] == 4:
                    case = case._replace(rival="", expected="", words=("stalls", "load"))
            if form in ("rkcm-mixed", "rkpm-scni") and size[0] == 3:
                case = case._replace(why=_STIFF)
            found.append(case)
    return found


def _tissues() -> list[Case]:
    """Muscle, fat and tendon in voxels; `rkcm` has no end within minutes there."""
    body = BY_NAME["three tissues of voxels"]
    cloud = body_cloud(body, 0.25)
    why = "the modulus jumps from tissue to tissue"
    found = [
        Case(
            f"{body.name}, {form}",
            body.tables,
            (f"scene.method={form}",),
            cloud,
            rival=body.name,
            tolerance=BESIDE,
            expected=WARNED,
            why=why,
            fast=False,
        )
        for form in FORMS[1:]
    ]
    for number, case in enumerate(found):
        if case.name.endswith("gauss"):
            found[number] = case._replace(expected=RIGHT, why=_RIMS)
        elif case.name.endswith("scni"):
            found[number] = case._replace(why="blocks of two voxels do not resolve the fat")
    return found


def _unstable() -> list[Case]:
    """Contraction beyond the loss of ellipticity: no answer is right, and none may be accepted."""
    # the published form locks and stays where the material is elliptic
    words = {"rkcm": ("the stress does",)}
    why = "beyond the loss of ellipticity no answer is right"
    return [
        _beside(
            "inclined block",
            (5, 5, 9),
            form,
            "",
            _LOCKS if form == "rkcm" else why,
            words.get(form, ("loses ellipticity",)),
        )._replace(
            name=f"inclined block, activation 0.6, {form}",
            overrides=(f"scene.method={form}", "load.activation=0.6"),
            rival="",
        )
        for form in FORMS
    ]
