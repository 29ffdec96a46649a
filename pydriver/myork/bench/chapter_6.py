"""Problems of Basava (2015), chapter 6, with what was published of them."""

from typing import NamedTuple

from myork.bench.runs import lattice

_WEIGHTS = ('solver.weight_essential="ns-c4"', "solver.weight_traction=1")
#: The published form: order, support, kernel and weights
RKCM = (
    "scene.method=rkcm",
    "approximation.order=2",
    "approximation.support=3",
    "approximation.kernel=quintic",
    *_WEIGHTS,
)


class Motion(NamedTuple):
    """A motion: what is varied, and the published errors."""

    name: str
    deck: str
    overrides: tuple[str, ...]
    published: tuple[float, ...] = ()


#: Published numbers of modes of the motions
MODES = (1, 5, 25)
#: Tables 6.1 and 6.2
_WAVE, _BAR = (3.202e-3, 4.791e-4, 5.597e-9), (5.776, 3.547e-2, 3.018e-7)
_STRONG, _WEAK = "scene.method=rkcm", "scene.method=rkpm-gauss"
_THIRD = (_WEIGHTS[0], "approximation.order=3", "approximation.support=3.5")
#: The motions of tables 6.1 and 6.2
WAVES = (
    Motion("order 2, 3h", "wave_1d", (_STRONG,), _WAVE),
    Motion("order 3, 3.5h, weights (6.41)", "wave_1d", (_STRONG, *_THIRD), _WAVE),
    Motion("Galerkin form", "wave_1d", (_WEAK,)),
)
BARS = (
    Motion("E = 1 and 1/4", "bar_1d", (_STRONG,), _BAR),
    Motion("Galerkin form", "bar_1d", (_WEAK,)),
)


class LoadPath(NamedTuple):
    """A path of loads with what was published of it."""

    #: Problem and deck
    name: str
    deck: str
    overrides: tuple[str, ...]  #: The published discretisation
    modes: tuple[int, ...]  #: Numbers of modes
    #: Published errors with each number of modes
    e1: tuple[float, ...] = ()
    e2: tuple[float, ...] = ()
    #: Published processor time of the full model, and with each number of modes [min]
    full_min: float | None = None
    reduced_min: tuple[float, ...] = ()
    saved: tuple[float, ...] = ()  #: Published share of time saved with each number of modes [%]


_SHEAR = LoadPath(
    "sheared block",
    "shear_3d",
    (*lattice((17, 5, 5)), "load.steps=50"),
    (1, 5, 20),
    (9.271e-3, 1.188e-3, 2.393e-6),
    (4.076e-2, 5.267e-3, 1.060e-5),
    98.504,
    (10.681, 15.109, 18.445),
    (89.156, 84.661, 81.274),
)
_TUBE = LoadPath(
    "inflated tube",
    "tube",
    lattice((17, 101)),
    (2, 5, 10),
    (6.356e-2, 5.021e-5, 5.305e-6),
    (2.917e-1, 2.777e-4, 2.933e-5),
    196.983,
    (2.491, 2.684, 2.968),
    (98.735, 98.637, 98.493),
)
_BLOCK = LoadPath(
    "muscle block",
    "muscle_block",
    (*RKCM, 'material.curve="published"', "load.steps=10"),
    (1, 2, 10),
    (4.975e-2, 5.685e-3, 2.277e-6),
    (5.622e-2, 6.973e-3, 2.402e-6),
    372.567,
    (23.843, 23.961, 24.420),
    (93.600, 93.568, 93.445),
)
#: The phantom with 1861 source, 3723 collocation and 1277 boundary points; published are 1837, 3727
#: and 1320
MG_SIZE = (
    "phantom.size=[96,96,34]",
    "phantom.spacing=[1.25,1.25,2.65]",
    "build.source_stride=[2,4,1]",
)
_GASTROCNEMIUS = LoadPath(
    "medial gastrocnemius",
    "mg_muscle",
    (*RKCM, 'solver.newton="full"', *MG_SIZE),
    (5, 10),
    (1.365e-2, 3.999e-5),
    (1.376e-2, 3.983e-5),
    1868.9,
    (19.9, 21.932),
    (98.935, 98.826),
)
#: Tables 6.3 to 6.10
PATHS = (_SHEAR, _TUBE, _BLOCK, _GASTROCNEMIUS)
#: The same in the Galerkin form, with points that it can afford
GALERKIN = (
    LoadPath("tube", "tube", ("scene.method=rkpm-gauss", *lattice((9, 51))), (2, 5, 10)),
    LoadPath("muscle block", "muscle_block", (*lattice((5, 5, 9)), "load.steps=10"), (1, 2, 5, 10)),
    LoadPath("medial gastrocnemius", "mg_muscle", (), (2, 5, 10)),
)
