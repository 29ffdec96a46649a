"""A verdict belongs to the scene, not to its description.

Random valid scenes and their twins: mirrored, rotated by 90 degrees, shifted, in other units, with
points in another order, with the load split into two programmes. Twins have one verdict, the same
probes and the same error bars; values that vanish by symmetry are zero within their bars, and a
body without strain has a valid answer.

MYORK_SCENES and MYORK_SEED select more and other scenes than those of the suite.
"""

import os
import re
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from myork import Scene
from myork.errors import MyorkError
from myork.records import PointCloud, Voxels
from myork.tables import deck_text
from tests.scenes import PLANES, annulus, box, held, neo, probes, voxels

#: Numbers that differ by less than this share of the bar are equal; bars are at least a thousandth
#: of the value, and iterations end at 1e-6 of it
OF_BAR = 0.01
#: Rounding relative to the largest number of its kind, of bars and of probes
ROUNDING = 1e-6
#: Relative difference up to which bars are equal
OF_BARS = 0.1
AXES = "xyz"
METHODS = ("auto", "rkpm-gauss", "rkpm-scni", "rkcm", "rkcm-mixed")
#: Moduli of the models, relative to the shear modulus
LAWS = {
    "neo-hookean": {"mu": 1.0},
    "mooney-rivlin": {"C1": 0.4, "C2": 0.1},
    "yeoh": {"C1": 0.5, "C2": 0.02, "C3": 0.001},
    "polynomial": {"A10": 0.5, "A20": 0.05},
    "muscle": {"A10": 0.5, "sigma_max": 1.0},
}
MODULI = {"K"}.union(*LAWS.values())


class Case(NamedTuple):
    """A scene as data: tables of a deck, and the points of a body that is neither box nor ring."""

    tables: dict[str, Any]
    cloud: PointCloud | None = None

    @property
    def kind(self) -> str:
        """Box, annulus or voxels."""
        return "voxels" if self.cloud is not None else str(self.tables["geometry"]["kind"])

    @property
    def nd(self) -> int:
        """Space dimension."""
        return int(self.tables["scene"]["dimension"])

    @property
    def frame(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest corner and size of the body."""
        if self.cloud is not None:
            return self.cloud.points.min(axis=0), np.ptp(self.cloud.points, axis=0)
        geometry = self.tables["geometry"]
        size = geometry.get("size", [geometry.get("outer_radius")] * 2)
        return np.zeros(self.nd), np.array(size, float)

    def change(self, **tables: Any) -> "Case":
        """The same with other tables; those that are None are removed."""
        every = (self.tables | tables).items()
        return Case({key: table for key, table in every if table is not None}, self.cloud)


class Answer(NamedTuple):
    """Verdict with reasons, values and bars of the probes at full load."""

    verdict: str
    reasons: list[str]
    value: np.ndarray
    bar: np.ndarray


class Twin(NamedTuple):
    """A map of space, `x' = length (turn x + shift)`, and of stresses."""

    turn: np.ndarray = np.eye(3)
    shift: np.ndarray = np.zeros(3)
    length: float = 1.0
    stress: float = 1.0


#: The scene itself
SAME = Twin()


# ---- scenes --------------------------------------------------------------------------------------


def scene_of(seed: int, number: int) -> Case:
    """Random valid scene, small enough for a fraction of a second."""
    rng = np.random.default_rng([seed, number])
    kind = str(rng.choice(["box", "box", "annulus", "voxels"]))
    nd = {"annulus": 2, "voxels": 3}.get(kind) or int(rng.choice([2, 3]))
    method = str(rng.choice(METHODS, p=[0.3, 0.2, 0.2, 0.1, 0.2]))
    if kind == "voxels":
        method = method.replace("-mixed", "")
    strong = method.startswith("rkcm")
    size = np.round(rng.uniform(0.8, 2.5, nd), 3)
    source = rng.integers(4, 8 if strong else 12, 2)
    if nd == 3:
        source = rng.integers(4, 6 if strong else 8, 3)
    many = 2 * source - 1 if strong or rng.random() < 0.5 else source
    points = {"places": many.tolist()}
    if kind == "annulus":
        geometry = annulus(*source.tolist(), radii=(size[0], np.round(size.sum(), 3)), **points)
    else:
        geometry = box(*source.tolist(), size=size, **points)
    case = Case({"scene": {"dimension": nd, "method": method}, "geometry": geometry})
    if kind == "voxels":
        case = Case({"scene": case.tables["scene"]}, _voxels(rng, strong))
    case = case.change(material=_materials(rng, case, strong))
    case = case.change(**_load(rng, case, strong))
    return case.change(probe=_probes(rng, case))


def _voxels(rng: np.random.Generator, strong: bool) -> PointCloud:
    """Block, cylinder or bracket of voxels, of one label or two."""
    n = rng.integers(4, 6, 3) if strong else rng.integers(5, 9, 3)
    at = np.moveaxis(np.indices(n), 0, -1)
    label = np.ones(n, np.int32)
    shape = rng.choice(["block", "cylinder", "bracket"])
    if shape == "cylinder":
        label[(((at[..., :2] + 0.5) / n[:2] - 0.5) ** 2).sum(-1) > 0.26] = 0
    if shape == "bracket":
        label[n[0] // 2 + 1 :, :, n[2] // 2 + 1 :] = 0
    if rng.random() < 0.5:
        label[(label > 0) & (at[..., 1] >= rng.integers(2, n[1] - 1))] = 2
    spacing = [*np.round(rng.uniform(1.5, 3, 2), 2), np.round(rng.uniform(1.5, 4), 2)]
    stride = [int(rng.choice([1, 1 + (not strong)]))] * 3
    return voxels(np.pad(label, 1), spacing, source_stride=stride)


def _materials(rng: np.random.Generator, case: Case, strong: bool) -> list[dict[str, Any]]:
    """One material or two; muscles have fibers."""
    middle = float(case.frame[0][0] + case.frame[1][0] / 2)
    two = case.cloud is None and rng.random() < 0.2
    labels = [1, 2][: 1 + two] if case.cloud is None else sorted(case.cloud.label_names)
    materials = []
    for label in labels:
        mu = float(rng.uniform(2, 20))
        model = str(rng.choice(list(LAWS)))
        stiff = float(rng.choice([20, 50 if strong else 500]))
        one: dict[str, Any] = {"name": f"m{label}", "model": model, "K": mu * stiff}
        one |= {key: part * mu for key, part in LAWS[model].items()}
        if model == "muscle":
            fiber = np.eye(3)[rng.integers(case.nd)]
            if rng.random() < 0.5:
                fiber = np.append(rng.normal(size=case.nd), 0.0)[:3]
            one["fiber"] = fiber.tolist()
            if not strong and rng.random() < 0.3:
                one["activation"] = f"0.5 + 0.3*sin(2*(x - {middle!r}))"
        if case.kind == "voxels":
            one["label"] = label
        elif two:
            # between the points of any lattice
            one["where"] = "1 > 0" if label == 1 else f"x > {middle + 0.01234!r}"
        materials.append(one)
    return materials


def _load(rng: np.random.Generator, case: Case, strong: bool) -> dict[str, Any]:
    """Fix one end, load the other in one of many ways, and perhaps activate."""
    nd, (low, size), mu = case.nd, case.frame, 10.0
    sides = [(f"{a}{end}", f"{a}{1 - end}", i) for i, a in enumerate(AXES[:nd]) for end in (0, 1)]
    if case.kind == "voxels":
        sides = [("bottom", "top", 2), ("top", "bottom", 2)]
    fixed, moved, axis = sides[rng.integers(len(sides))]
    sets = None
    ways = ["stretch", "traction"] + ["pressure"] * (not strong)
    clamp = {f"u_{a}": 0.0 for a in AXES[:nd]}
    boundary: list[dict[str, Any]] = []
    if case.kind == "annulus":
        boundary += PLANES[1::-1]
        fixed, moved = ("outer", "inner") if rng.random() < 0.5 else ("inner", "outer")
        if rng.random() < 0.4:
            boundary.append({"set": fixed, "radial": 0.0})
        ways = ["radial"] if strong else ["radial", "pressure"]
    elif rng.random() < 0.4 and len(sides) > 2:
        # rollers on one side of each direction
        boundary += PLANES[:nd]
        moved = f"{AXES[axis]}1"
    else:
        boundary.append({"set": fixed, **clamp})
        ways += ["grip", "shear", "patch", "turn"]
    amount = float(rng.choice([-1, 1]) * rng.uniform(0.02, 0.1))
    along, across = AXES[axis], AXES[(axis + 1) % nd]
    edge = float(low[(axis + 1) % nd] + 0.4321 * size[(axis + 1) % nd])
    length = amount * float(size[axis])
    way = str(rng.choice(ways))
    entry: dict[str, Any] = {
        "radial": {"radial": length / 3},
        "pressure": {"pressure": amount * mu},
        "stretch": {f"u_{along}": length},
        "traction": {"traction": (amount * mu * np.eye(nd)[axis]).tolist()},
        "grip": {**clamp, f"u_{along}": length},
        "shear": {**clamp, f"u_{across}": length},
        "patch": {"traction": (0.5 * amount * mu * rng.normal(size=nd)).tolist()},
        "turn": {"rotation": 60 * amount, "about": (low + 0.5 * size).tolist()},
    }[way]
    if way == "turn" and nd == 3:
        entry["axis"] = np.eye(3)[axis].tolist()
    if way == "patch":
        sets = [{"name": "patch", "side": moved, "where": f"{across} > {edge!r}"}]
        moved = "patch"
    entry = {"set": moved, **entry}
    boundary.append(entry)
    if case.kind == "box" and not strong and len(boundary) == 2 and rng.random() < 0.2:
        beside = next(name for name, _, a in sides if a != axis)
        # the load remains the last
        boundary.insert(0, {"set": beside, "spring": [float(rng.uniform(0.5, 5))] * nd})
    load: dict[str, Any] = {"steps": int(rng.integers(1, 4)), "max_halvings": 3}
    if any(m["model"] == "muscle" for m in case.tables["material"]) and rng.random() < 0.7:
        load["activation"] = float(rng.uniform(0.05, 0.3))
    return {"boundary": boundary, "load": load, "set": sets}


def _probes(rng: np.random.Generator, case: Case) -> list[dict[str, Any]]:
    """Vectors and scalars at inner points and of the sets with conditions."""
    nd, (low, size), tables = case.nd, case.frame, case.tables
    names = ["u", "J", "pressure", "principal_max", "cauchy_xx", "cauchy_xy", "u_y", "cauchy_yy"]
    names += ["cauchy_zz", "cauchy_xz"] * (nd == 3)
    found: list[Any] = []
    for i in range(int(rng.integers(2, 5))):
        if case.kind == "annulus":
            t, g = rng.uniform(0.2, 1.3), tables["geometry"]
            r = rng.uniform(g["inner_radius"], g["outer_radius"])
            at = r * np.array([np.cos(t), np.sin(t)])
        else:
            at = low + size * rng.uniform(0.3, 0.7, nd)
        quantity = str(rng.choice(names)) if i else "u"
        found.append({"name": f"p{i}", "quantity": quantity, "point": at.tolist()})
    sets = [entry["set"] for entry in tables["boundary"] if "spring" not in entry]
    found += [f"f{i} force {side}" for i, side in enumerate(dict.fromkeys(sets))]
    found += [f"turned torque_z {sets[-1]}", f"moved u {sets[-1]}"]
    muscles = [m["name"] for m in tables["material"] if m["model"] == "muscle"]
    found += [{"name": "s", "quantity": "fiber_stretch", "material": m} for m in muscles[:1]]
    return probes(*found)


# ---- twins ---------------------------------------------------------------------------------------


def mapped(case: Case, twin: Twin) -> Case:
    """The same scene, described in other axes, from another origin or in other units."""
    nd = case.nd
    turn, unit, stress = twin.turn[:nd, :nd], twin.length, twin.stress
    handed = round(np.linalg.det(twin.turn))

    def axis(letter: str) -> tuple[str, float]:
        """Image of an axis, and its sign there."""
        b = int(np.argmax(abs(turn[:, AXES.index(letter)])))
        return AXES[b], float(turn[b, AXES.index(letter)])

    def one(found: re.Match[str]) -> str:
        letter, sign = axis(found[0])
        away = float(twin.shift[AXES.index(letter)])
        return f"({sign:g}*({letter}/{unit!r} - ({away!r})))"

    def side(name: str) -> str:
        if case.cloud is not None or not re.fullmatch("[xyz][01]", name):
            return name
        letter, sign = axis(name[0])
        return f"{letter}{name[1] if sign > 0 else 1 - int(name[1])}"

    def place(x: Any) -> Any:
        return (unit * (turn @ np.array(x) + twin.shift[:nd])).tolist()

    def text(expression: str) -> str:
        return re.sub(r"\b[xyz]\b", one, expression)

    new: dict[str, Callable[[Any], Any]] = {
        **dict.fromkeys(("set", "side"), side),
        "where": text,
        "activation": lambda v: text(v) if isinstance(v, str) else v,
        **dict.fromkeys(("point", "about"), place),
        **dict.fromkeys((*MODULI, "pressure"), lambda v: v * stress),
        "quantity": lambda v: _quantity(v, twin, nd)[0],
        "radial": lambda v: v * unit,
        "traction": lambda v: (stress * turn @ v).tolist(),
        "spring": lambda v: (stress / unit * abs(turn) @ v).tolist(),
        "fiber": lambda v: (twin.turn @ v).tolist(),
        "axis": lambda v: (handed * twin.turn @ v).tolist(),
        "rotation": lambda v: v * (handed if nd == 2 else 1),
    }

    def entry(old: dict[str, Any]) -> dict[str, Any]:
        moved = [key for key in old if re.fullmatch("u_[xyz]", key)]
        ends = {f"u_{axis(key[2])[0]}": old[key] * unit * axis(key[2])[1] for key in moved}
        return {k: new[k](v) if k in new else v for k, v in old.items() if k not in moved} | ends

    tables = dict(case.tables)
    for table in ("material", "set", "boundary", "probe"):
        if table in tables:
            tables[table] = [entry(old) for old in tables[table]]
    if "geometry" in tables:
        geometry = dict(tables["geometry"])
        if geometry["kind"] == "box":
            for key in ("size", "source", "collocation"):
                geometry[key] = (abs(turn).astype(int) @ geometry[key]).tolist()
            geometry["size"] = (unit * np.array(geometry["size"])).tolist()
        else:
            geometry |= {k: geometry[k] * unit for k in ("inner_radius", "outer_radius")}
        tables["geometry"] = geometry
    if unit != 1:
        tables["units"] = {"force": "kN", "length": "mm"}
    return Case(tables, None if case.cloud is None else _mapped_cloud(case.cloud, twin))


def _quantity(name: str, twin: Twin, nd: int) -> tuple[str, float]:
    """Name of a component in other axes, and the factor of its value there."""
    head, _, axes = name.partition("_")
    # by length and stress; forces and torques in the plane are per thickness
    powers = {"u": (1, 0), "force": (nd - 1, 1), "torque": (nd, 1), "J": (0, 0), "fiber": (0, 0)}
    length, stress = powers.get(head, (0, 1))
    factor = twin.length**length * twin.stress**stress
    if axes and set(axes) <= set(AXES):
        rows = [int(np.argmax(abs(twin.turn[:, AXES.index(a)]))) for a in axes]
        for a, b in zip(axes, rows, strict=True):
            factor *= twin.turn[b, AXES.index(a)]
        if head == "torque":
            factor *= round(np.linalg.det(twin.turn))
        name = f"{head}_{''.join(AXES[b] for b in sorted(rows))}"
    return name, factor


def _mapped_cloud(cloud: PointCloud, twin: Twin) -> PointCloud:
    """Points in other axes."""
    turn, unit = twin.turn, twin.length

    def places(x: np.ndarray) -> np.ndarray:
        return unit * (x @ turn.T + twin.shift)

    blocks = cloud.voxels
    if blocks is not None:
        index = blocks.index @ turn.T.astype(int)
        low, size = index.min(axis=0), unit * abs(turn) @ blocks.size
        origin = places(blocks.origin) + low * size
        blocks = Voxels((index - low).astype(np.int32), size, origin)
    return replace(
        cloud, source=places(cloud.source), spacing=unit * abs(turn) @ cloud.spacing,
        points=places(cloud.points), fiber=cloud.fiber @ turn.T, volume=cloud.volume * unit**3,
        normal=cloud.normal @ turn.T, area=cloud.area * unit**2, voxels=blocks,
        length_unit="cm" if unit == 1 else "mm",
    )  # fmt: skip


def _reordered(cloud: PointCloud, rng: np.random.Generator) -> PointCloud:
    """The same points, source points and boundary entries, in another order."""
    old = rng.permutation(len(cloud.points))
    new = np.argsort(old).astype(np.int32)
    entry = rng.permutation(len(cloud.boundary_point))
    of_points = {k: getattr(cloud, k)[old] for k in ("points", "label", "fiber", "volume")}
    of_entries = {k: getattr(cloud, k)[entry] for k in ("boundary_set", "normal", "area")}
    blocks = cloud.voxels
    return replace(
        cloud, source=rng.permutation(cloud.source), **of_points, **of_entries,
        boundary_point=new[cloud.boundary_point][entry],
        voxels=None if blocks is None else replace(blocks, index=blocks.index[old]),
    )  # fmt: skip


# ---- answers -------------------------------------------------------------------------------------


def solved(case: Case) -> Answer:
    """Answer to a scene; a run that stops early has no numbers."""
    with Scene.from_tables(case.tables, case.cloud, threads=1) as scene:
        try:
            states = scene.solve()
        except MyorkError as error:
            none = np.full((len(case.tables["probe"]), 3), np.nan)
            return Answer("refused", [str(error)], none, none)
        value = scene.probes(states.x[-1:], states.load[-1:])[0]
    return Answer(states.verdict, states.reasons, value, states.probe_errors[-1])


def differences(
    case: Case, one: Answer, two: Answer, twin: Twin = SAME, within: bool = False
) -> list[str]:
    """Differences of two answers to one scene; `within` the bars where lattices differ."""
    found = []
    verdicts = {one.verdict, two.verdict}
    # along another path the second solution may find another branch, which is never accepted
    strayed = "accepted" not in verdicts and any(
        "another branch" in reason for reason in (*one.reasons, *two.reasons)
    )
    if len(verdicts) > 1 and not strayed:
        found.append(f"{one.verdict} {one.reasons} becomes {two.verdict} {two.reasons}")
    kinds: dict[str, float] = {}
    rows = []
    for i, probe in enumerate(case.tables["probe"]):
        name = probe["quantity"]
        factor, size = _quantity(name, twin, case.nd)[1], 1
        value, bar = factor * one.value[i], abs(factor) * one.bar[i]
        if name in ("u", "force"):
            value, bar, size = twin.turn @ value, abs(twin.turn) @ bar, 3
        kind = re.split("_", name)[0]
        kind = "stress" if kind in ("cauchy", "pressure", "principal") else kind
        pairs = (value, bar, two.value[i], two.bar[i])
        rows.append((probe["name"], kind, *(entry[:size] for entry in pairs)))
        kinds[kind] = max([kinds.get(kind, 0.0), *abs(value[:size])])
    kinds["torque"] = max(kinds["torque"], kinds["force"] * twin.length * max(case.frame[1]))
    refused = strayed or verdicts == {"refused"}
    for name, kind, value, bar, other, its in rows:
        wide, rounding = np.fmax(bar, its), ROUNDING * kinds[kind]
        room = (1 if within else OF_BAR) * wide + rounding
        missing = np.any(np.isnan(bar) != np.isnan(its))
        if refused and np.isnan([bar, its]).all():
            # a refused answer without bars has no reliable values
            continue
        if np.any(abs(value - other) > room) or np.any(np.isnan(value) != np.isnan(other)):
            found.append(f"{name}: {value} +- {bar} becomes {other} +- {its}")
        elif refused and missing:
            continue
        elif not within and (missing or np.any(abs(bar - its) > OF_BARS * wide + rounding)):
            found.append(f"{name}: bar of {value}, {bar}, becomes {its}")
    return found


# ---- relations -----------------------------------------------------------------------------------


def _moved(case: Case, base: Answer, turn: np.ndarray, far: float = 0.0) -> list[str]:
    shift = np.zeros(3)
    if case.kind == "box":
        size = np.append(case.frame[1], [0.0] * (3 - case.nd))
        shift = (abs(turn) @ size - turn @ size) / 2
    twin = Twin(turn, shift + far)
    # the second solution merges voxels from one end
    within = case.kind == "voxels" and not np.all(turn == np.eye(3))
    return differences(case, base, solved(mapped(case, twin)), twin, within)


def mirror(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Mirrored in one direction; a quarter ring at its middle, voxels if they come in pairs."""
    if case.kind == "annulus":
        return _moved(case, base, np.eye(3)[[1, 0, 2]])
    axes = list(range(case.nd))
    if case.cloud is not None:
        # the second solution merges two, from one end
        axes = [d for d in axes if np.ptp(case.cloud.voxels.index[:, d]) % 2]
    if not axes:
        return []
    signs = np.ones(3)
    signs[rng.choice(axes)] = -1
    return _moved(case, base, np.diag(signs))


def rotation(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Rotated by 90 degrees, image bodies about z only: their slices are normal to it."""
    if case.kind == "annulus":
        return []
    axis = rng.integers(3) if case.kind == "box" and case.nd == 3 else 2
    turn, (a, b) = np.eye(3), ((axis + 1) % 3, (axis + 2) % 3)
    turn[[a, b]] = turn[[b, a]]
    turn[a] *= -1
    return _moved(case, base, turn)


def shift(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Shifted by a thousand lengths, for bodies whose position can be chosen."""
    if case.cloud is None:
        return []
    return _moved(case, base, np.eye(3), 1000 * float(max(case.frame[1])))


def units(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """In mm and kN in place of cm and N."""
    twin = Twin(length=10.0, stress=1e-5)
    return differences(case, base, solved(mapped(case, twin)), twin)


def order(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Points in another order."""
    if case.cloud is None:
        return []
    return differences(case, base, solved(Case(case.tables, _reordered(case.cloud, rng))))


def split(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Loads one after the other, in both orders, end in the same state as both together."""
    paths = []

    def second(table: dict[str, Any]) -> dict[str, Any]:
        return table | ({"amplitude": "second"} if "activation" in table else {})

    *fixed, last = case.tables["boundary"]
    later = case.change(
        boundary=[*fixed, {**last, "amplitude": "first"}],
        material=[second(one) for one in case.tables["material"]],
        load=second({**case.tables["load"], "steps": 2}),
    )
    for late in ("first", "second"):
        amplitude = [
            {"name": name, "time": [0, 0.5, 1], "value": [0, float(name != late), 1]}
            for name in ("first", "second")
        ]
        paths.append(solved(later.change(amplitude=amplitude)))
    return differences(case, base, paths[0]) + differences(case, *paths)


def zero(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Values that vanish by symmetry in y are zero within their bars."""
    if case.kind == "annulus":
        return []
    nd, (low, size) = case.nd, case.frame
    fixed, pulled, along = ("bottom", "top", 2) if case.kind == "voxels" else ("x0", "x1", 0)
    labels = [{"label": m["label"]} for m in case.tables["material"] if "label" in m]
    pull = {f"u_{AXES[along]}": 0.1 * float(size[along])}
    at = low + size * np.where(np.arange(nd) == 1, 0.5, rng.uniform(0.3, 0.7, nd))
    place = " ".join(map(repr, at.tolist()))
    scene = case.change(
        material=[neo(10.0, 500.0, f"m{i}", **label) for i, label in enumerate(labels or [{}])],
        boundary=[held(fixed, nd), held(pulled, nd if rng.random() < 0.5 else 0, **pull)],
        load={"steps": 1}, set=None,
        probe=probes(f"u u_y {place}", f"s cauchy_xy {place}", f"f force_y {pulled}",
                     f"g force_y {fixed}"),
    )  # fmt: skip
    answer = solved(scene)
    rows = zip(scene.tables["probe"], answer.value[:, 0], answer.bar[:, 0], strict=True)
    return [
        f"{probe['name']}: {value} +- {bar}, {answer.verdict}"
        for probe, value, bar in rows
        if abs(value) > bar and answer.verdict == "accepted"
    ]


def _unloaded(case: Case) -> Case:
    """The same scene without any load."""

    def entry(old: dict[str, Any]) -> dict[str, Any]:
        loads = [k for k in old if k[:2] == "u_" or k in ("pressure", "radial", "rotation")]
        new = {**old, **dict.fromkeys(loads, 0.0)}
        return new | ({"traction": [0.0] * case.nd} if "traction" in old else {})

    load = {**case.tables["load"], "activation": 0.0}
    material = [{k: v for k, v in m.items() if k != "activation"} for m in case.tables["material"]]
    boundary = [entry(one) for one in case.tables["boundary"]]
    return case.change(boundary=boundary, material=material, load=load)


def _unstrained(case: Case, moved: Callable[[np.ndarray], np.ndarray] = np.zeros_like) -> list[str]:
    """Faults of a body without strain: it must be accepted, without forces, and moved
    as a function of position says."""
    answer = solved(case)
    found = [] if answer.verdict == "accepted" else [f"{answer.verdict}: {answer.reasons}"]
    stiff = max(m["K"] for m in case.tables["material"])
    for probe, value in zip(case.tables["probe"], answer.value, strict=True):
        name = probe["quantity"]
        wanted = float(name in ("J", "fiber_stretch"))
        room = 1e-8 * (1.0 if name[0] in "uJ" or wanted else stiff * max(case.frame[1]) ** 3)
        if name == "u" and "point" in probe:
            off = value[: case.nd] - moved(np.array(probe["point"]))
            found += [f"u is off by {off}"] * bool(np.any(abs(off) > 1e-6 * max(case.frame[1])))
        if name[0] != "u" and np.any(abs(value[: 3 if name == "force" else 1] - wanted) > room):
            found.append(f"{name} is {value}")
    return found


def rest(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Without any load."""
    return _unstrained(_unloaded(case))


def rigid(case: Case, base: Answer, rng: np.random.Generator) -> list[str]:
    """Translated and perhaps rotated by one set."""
    side = "bottom" if case.kind == "voxels" else "x0"
    motion: dict[str, Any] = {f"u_{a}": float(rng.normal()) for a in AXES[: case.nd]}
    if rng.random() < 0.5:
        motion |= {"rotation": float(rng.uniform(5, 40)), "about": [0.3] * case.nd}
        motion |= {"axis": rng.normal(size=3).tolist()} if case.nd == 3 else {}
    probe = [p for p in case.tables["probe"] if "point" in p]
    probe.append({"name": "f", "quantity": "force", "set": side})
    boundary = [{"set": side, **motion}]
    axis = np.array(motion.get("axis", [0, 0, 1]))
    turned = np.deg2rad(motion.get("rotation", 0.0)) * axis / np.linalg.norm(axis)
    turn = Rotation.from_rotvec(turned).as_matrix()[: case.nd, : case.nd]
    shift = np.array([motion[f"u_{a}"] for a in AXES[: case.nd]])
    carried = _unloaded(case).change(boundary=boundary, set=None, probe=probe)
    return _unstrained(carried, lambda x: turn @ (x - 0.3) + 0.3 - x + shift)


RELATIONS = (mirror, rotation, shift, units, order, split, rest, zero, rigid)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(int(os.environ.get("MYORK_SCENES", "30"))))
def test_a_verdict_belongs_to_the_scene(number: int) -> None:
    seed = int(os.environ.get("MYORK_SEED", "1"))
    case = scene_of(seed, number)
    base = solved(case)
    for k, relation in enumerate(RELATIONS):
        found = relation(case, base, np.random.default_rng([seed, number, k]))
        assert not found, (relation.__name__, *found, deck_text(case.tables))
