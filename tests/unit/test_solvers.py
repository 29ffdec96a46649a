"""Scenes that the least squares ladder (tests/fortran/test_lstsq.f90) does not take."""

import pytest

from tests.refusals import refuses
from tests.scenes import box, held, scene, solved

#: Displacement form, nearly incompressible, fixed ends: rows from 1e2 to 1e10
STIFF = scene(
    "rkcm", box(4, 4, 7, size=[1, 1, 2]), boundary=[held("z0"), held("z1", u_x=0.2, u_z=0.3)],
    material=[{"name": "rubber", "model": "polynomial", "A10": 37.3, "K": 1e8}],
)  # fmt: skip


@pytest.mark.parametrize("name", ["dgelsx", "qr", "refined but longer"])
def test_unknown_methods_are_refused(open_scene, name):
    refuses("unknown least squares solver", open_scene(STIFF).solve, name)


@pytest.mark.parametrize(("changes", "message"), [
    # as many collocation points as source points, and hardly any on a boundary
    ({"geometry": box(9, 9, 9, size=[1, 1, 2], places=(3, 3, 3))}, "more collocation points"),
    # a support below their distance: source points between them are in no equation
    ({"geometry": box(3, 3, 30, size=[1, 1, 2], places=(33, 33, 4)),
      "approximation": {"order": 2, "support": 3.0}}, "island: 1089 collocation points around"),
])  # fmt: skip
def test_too_few_equations_are_refused(changes, message):
    refuses(message, solved, {**STIFF, **changes})
