"""Parts of a Galerkin problem in the compiled core, of which reduced models are made."""

from typing import NamedTuple

import numpy as np

from myork.core.checks import modes_of
from myork.core.scene import Scene
from myork.types import F64, I32, Mask


class GalerkinParts(NamedTuple):
    """What the Galerkin form integrates."""

    #: Volume of the integration points and their own part of the bulk modulus, shape `(np,)`
    weight: F64
    local_bulk: F64
    group: I32  #: Points before each group, shape `(groups + 1,)`
    bulk: F64  #: Bulk modulus on the projected volume of each group, shape `(groups,)` [stress]
    polynomials: I32  #: Polynomials of each group
    #: Their values at the points and their integrals, shapes `(np, 1 + nd)`, `(groups, 1 + nd)`
    basis: F64
    total: F64
    set: I32  #: Boundary set of the surface points, from 1
    probe_sets: I32  #: Boundary set of each probe, from 1; 0 of those at points
    essential: Mask  #: Whether a component is prescribed there, shape `(ms, nd)`
    penalty: F64  #: Penalty times area of the surface points, shape `(ms,)` [force/length]
    #: Entries before each point, shape `(np + 1,)`, and the tissue of each, from 0
    first: I32
    tissue: I32
    #: Fraction and fiber of the entries, shapes `(ne,)`, `(ne, 3)`
    fraction: F64
    fiber: F64


class LoadParts(NamedTuple):
    """What a scene prescribes at full load."""

    #: Prescribed displacements of the surface points and forces of their tractions, shape
    #: `(ms, nd)`
    value: F64
    push: F64
    given: F64  #: Displacement gradients that the values make, index 3 i + A, shape `(np, 9)`
    force: F64  #: Forces on the unknowns, shape `(n,)`


class PlaceParts(NamedTuple):
    """The place of a probe."""

    #: Displacement gradients of modes there, shape `(9, r)`; zero where gradients are smoothed
    gradient: F64
    #: Weights of the gradients of the integration points; zero where they are not smoothed
    weight: F64
    pressure: F64  #: Weights of the coefficients of the groups' pressures, shape `(groups, 1 + nd)`
    local_bulk: float  #: Part of the bulk modulus that acts there
    tissue: I32  #: Its tissues, from 0
    #: Their fractions and fibers, shapes `(k,)`, `(k, 3)`
    fraction: F64
    fiber: F64
    #: On a free face, where the stress has no traction, gradients along it and its normal, shapes
    #: `(9, r)`, `(3,)`; otherwise zero
    face: F64
    normal: F64
    bulk: float  #: Bulk modulus there, 0 elsewhere


def galerkin_parts(scene: Scene) -> GalerkinParts:
    """Points, groups, surface and tissues of an open scene.

    - raises InputError: the scene is of another form, or has an infinite bulk modulus
    """
    found = scene._ask("cells")
    turned = {name: found[name].T for name in ("basis", "total", "fiber")}
    return GalerkinParts(**{**found, **turned, "essential": found["essential"].T != 0})


def tissue_laws(scene: Scene) -> tuple[F64, F64, F64]:
    """Laws of the tissues of an open scene.

    - returns `coefficients`: A10, A01, A20, A11, A02, A30, A21, A12, A03 of each, shape `(nt, 9)`
      [stress]
    - returns `fibers`: lambda_o, gamma1, gamma2, whether the curves are smooth, and the axis about
      which `fiber_angle` turns fibers, shape `(nt, 7)`
    - returns `state`: whether there are fibers, largest isometric stress and activation, shape
      `(nt, 3)`
    - raises InputError: a law that is no polynomial with fibers
    """
    coefficients, fibers, state = scene._ask("laws").values()
    return coefficients.T, fibers.T, state.T


def load_parts(scene: Scene) -> LoadParts:
    """What an open scene prescribes at full load."""
    return LoadParts(**{name: array.T for name, array in scene._ask("loads").items()})


def place_parts(scene: Scene, probe: int, modes: F64) -> PlaceParts:
    """The place of a probe, from 0, and gradients of modes, shape `(n, r)`, there."""
    found = scene._ask("place", probe + 1, modes_of(modes, scene.dofs))
    numbers = {name: float(found[name]) for name in ("local_bulk", "bulk")}
    turned = {name: found[name].T for name in ("pressure", "fiber")}
    return PlaceParts(**{**found, **numbers, **turned})


def modal_gradients(scene: Scene, modes: F64) -> F64:
    """Displacement gradients of modes, shape `(n, r)`, at the points: `(np, 9, r)`."""
    gradient = scene._ask("gradients", modes_of(modes, scene.dofs))["gradient"]
    return np.moveaxis(gradient, (0, 1, 2), (1, 0, 2))


def modal_products(scene: Scene, modes: F64) -> tuple[F64, F64]:
    """Products of modes, shape `(n, r)`, with penalty and stabilisation, and with the mass."""
    stiff, mass = scene._ask("products", modes_of(modes, scene.dofs)).values()
    return stiff, mass
