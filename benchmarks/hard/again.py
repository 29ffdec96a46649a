"""Hard cases of answers that are taken up again: restarts, and reduced models."""

from __future__ import annotations

from benchmarks.hard.case import EXPLAINED, WARNED, Case
from benchmarks.truths.deck_parts import deck, force, held, probe
from myork.bench.materials import MUSCLE, RUBBER

__all__ = ["again_cases"]

_CUBE = {
    **deck(
        "Rubber pulled and sheared",
        {"kind": "box", "size": [1, 1, 1], "source": [4, 4, 4], "collocation": [6, 6, 6]},
        ({**RUBBER, "K": 500.0},),
        (held("z0"), held("z1", u_x=0.3, u_z=0.3)),
        (force("pull", "z", "z1"), force("push", "x", "z1")),
    ),
    "load": {"steps": 6},
}
_BLOCK = {
    **deck(
        "Contracting block with inclined fibers, pulled",
        {"kind": "box", "size": [1, 1, 2], "source": [4, 4, 6], "collocation": [4, 4, 6]},
        ({**MUSCLE, "fiber_angle": 20},),
        (held("z0"), held("z1", u_z=0.1)),
        (force("reaction", "z", "z1"), probe("side", "u_x", (1, 0.5, 1))),
        activation=0.3,
    ),
    "load": {"steps": 3, "activation": 0.3},
}
_BLOCK["scene"] = {"dimension": 3, "method": "rkpm-scni"}


def again_cases() -> list[Case]:
    """All of them."""
    return [*_restarts(), *_models()]


def _restarts() -> list[Case]:
    """Runs that go on; a killed one must end with the bits of the one that was not."""
    found = []
    for form in ("rkpm-gauss", "rkcm-mixed"):
        case = Case("", _CUBE, (f"scene.method={form}",), station="restart", tolerance=0.0)
        found += [
            case._replace(name=f"{name}, {form}", subject=subject, **changes)
            for name, subject, changes in (
                ("killed and resumed", "killed", {"right": {"pull": 0.0}}),
                (
                    "started from a state",
                    "from a state",
                    {"right": {"pull": 0.0}, "tolerance": 1e-9},
                ),
                ("resumed with another deck", "another deck", {"words": ("another deck",)}),
                ("resumed from half a journal", "cut journal", {"right": {"pull": 0.0}}),
            )
        ]
    return found


def _models() -> list[Case]:
    """A reduced model inside and outside of its range, damaged, and of a form without energy."""
    case = Case("", _BLOCK, station="reduced", right={"reaction": 0.0}, tolerance=0.01)
    return [
        case._replace(
            name="reduced model inside its range",
            overrides=("load.activation=0.23", "boundary.z1.u_z=0.07"),
        ),
        case._replace(
            name="reduced model at a corner of its range",
            overrides=("load.activation=0.5", "boundary.z1.u_z=0.2"),
        ),
        case._replace(
            name="reduced model at twice its range",
            overrides=("load.activation=1", "boundary.z1.u_z=0.4"),
            words=("outside the range",),
            expected=WARNED,
            why="what the training did not see",
        ),
        case._replace(
            name="reduced model far outside, turned inside out",
            overrides=("load.activation=0.5", "boundary.z1.u_z=-1.9"),
            words=("outside the range",),
            right={},
            expected=EXPLAINED,
            why="the body would be turned inside out",
        ),
        case._replace(
            name="half the file of a reduced model",
            overrides=("load.activation=0.2", "boundary.z1.u_z=0.1"),
            subject="cut",
            words=("cut.rom.h5",),
            right={},
        ),
        case._replace(
            name="unknown parameter of a reduced model",
            overrides=("load.activation=0.2", "boundary.z1.u_y=0.1"),
            words=("u_y",),
            right={},
        ),
        case._replace(
            name="reduced model of a collocation",
            overrides=("scene.method=rkcm-mixed",),
            subject="train",
            words=("one of the Galerkin forms",),
            right={},
        ),
    ]
