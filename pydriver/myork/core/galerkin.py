"""Parts of a Galerkin problem in the compiled core, from which reduced models are built."""

from typing import NamedTuple

import numpy as np

from myork.core.checks import modes_of
from myork.core.scene import Scene
from myork.types import F64, I32, Mask


class GalerkinParts(NamedTuple):
    """Quantities that the Galerkin form integrates."""

    #: Volume of the integration points and their local part of the bulk modulus, shape `(np,)`
    weight: F64
    local_bulk: F64
    group: I32  #: Number of points before each group, shape `(groups + 1,)`
    bulk: F64  #: Bulk modulus on the projected volume of each group, shape `(groups,)` [stress]
    polynomials: I32  #: Number of polynomials of each group
    #: Their values at the points and their integrals, shapes `(np, 1 + nd)`, `(groups, 1 + nd)`
    basis: F64
    total: F64
    set: I32  #: Boundary set of the surface points, from 1
    probe_sets: I32  #: Boundary set of each probe, from 1; 0 for probes at points
    essential: Mask  #: Whether a component is prescribed there, shape `(ms, nd)`
    penalty: F64  #: Penalty times area of the surface points, shape `(ms,)` [force/length]
    #: Entries before each point, shape `(np + 1,)`, and the tissue of each entry, from 0
    first: I32
    tissue: I32
    #: Fraction and fiber of the entries, shapes `(ne,)`, `(ne, 3)`
    fraction: F64
    fiber: F64


class LoadParts(NamedTuple):
    """Values that a scene prescribes at full load."""

    #: Prescribed displacements of the surface points and forces of their tractions, shape
    #: `(ms, nd)`
    value: F64
    push: F64
    given: F64  #: Displacement gradients due to these values, index 3 i + A, shape `(np, 9)`
    force: F64  #: Forces on the unknowns, shape `(n,)`


class PlaceParts(NamedTuple):
    """Location of a probe."""

    #: Displacement gradients of the modes there, shape `(9, r)`; zero where gradients are smoothed
    gradient: F64
    #: Weights of the gradients of the integration points; zero where they are not smoothed
    weight: F64
    pressure: F64  #: Weights of the coefficients of the groups' pressures, shape `(groups, 1 + nd)`
    local_bulk: float  #: Part of the bulk modulus that acts locally there
    tissue: I32  #: Its tissues, from 0
    #: Their fractions and fibers, shapes `(k,)`, `(k, 3)`
    fraction: F64
    fiber: F64
    #: On a traction-free face: gradients along it and its normal, shapes `(9, r)`, `(3,)`;
    #: otherwise zero
    face: F64
    normal: F64
    bulk: float  #: Bulk modulus there, 0 elsewhere


def galerkin_parts(scene: Scene) -> GalerkinParts:
    """Points, groups, surface and tissues of an open scene.

    - raises InputError: the scene has another form, or an infinite bulk modulus
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
    - raises InputError: a law that is not a polynomial with fibers
    """
    coefficients, fibers, state = scene._ask("laws").values()
    return coefficients.T, fibers.T, state.T


def load_parts(scene: Scene) -> LoadParts:
    """Values that an open scene prescribes at full load."""
    return LoadParts(**{name: array.T for name, array in scene._ask("loads").items()})


def place_parts(scene: Scene, probe: int, modes: F64) -> PlaceParts:
    """Location of a probe (numbered from 0), with the gradients of modes, shape `(n, r)`, there."""
    found = scene._ask("place", probe + 1, modes_of(modes, scene.dofs))
    numbers = {name: float(found[name]) for name in ("local_bulk", "bulk")}
    turned = {name: found[name].T for name in ("pressure", "fiber")}
    return PlaceParts(**{**found, **numbers, **turned})


def modal_gradients(scene: Scene, modes: F64) -> F64:
    """Displacement gradients of modes, shape `(n, r)`, at the points: `(np, 9, r)`."""
    gradient = scene._ask("gradients", modes_of(modes, scene.dofs))["gradient"]
    return np.moveaxis(gradient, (0, 1, 2), (1, 0, 2))


def modal_products(scene: Scene, modes: F64) -> tuple[F64, F64]:
    """Modes, shape `(n, r)`, projected on penalty plus stabilisation, and on the mass."""
    stiff, mass = scene._ask("products", modes_of(modes, scene.dofs)).values()
    return stiff, mass
