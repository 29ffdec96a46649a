"""What a segmentation's uncertainty does to a force: perturbed label maps, rebuilt and solved."""

import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import ndimage
from scipy.special import ndtr

from myork.console import ProgressCallback, silent
from myork.core.deck import load_deck
from myork.core.scene import Scene
from myork.errors import ConvergenceError, FileError, InputError
from myork.files import write_csv, write_json
from myork.imaging.io import read_labels, write_labels
from myork.model_file import read_model
from myork.records import Labels
from myork.rom.probes import places_of, units_of
from myork.stations.build import build
from myork.tables import override_text
from myork.types import F64, Mask


class Doubt(NamedTuple):
    """How a boundary may be wrong, all in mm."""

    bias: float = 0.0  #: By how much all boundaries lie too far inside; negative: outside
    shift: float = 0.5  #: Standard deviation of a displacement of a whole boundary, one a map
    noise: float = 0.5  #: Standard deviation of a displacement that varies along it
    length: float = 10.0  #: Distance over which that varies


def uncertainty(
    deck: str | Path,
    out: str | Path,
    *,
    doubt: Doubt | None = None,
    samples: int = 12,
    seed: int = 0,
    probe: str | None = None,
    fixed: Sequence[str] = (),
    threads: int | None = None,
    progress: ProgressCallback = silent,
) -> dict[str, Any]:
    """Distribution of a force over label maps that could as well be true.

    The boundary of each label is moved outwards by a bias, by a random shift of the whole map and
    by a random field along it; the model is rebuilt and solved for each map.

    - `deck`: deck of a model from labels: `build.labels`, or what `myork segment` left in `out`
    - `out`: folder of `uncertainty.json` and `.csv`
    - `doubt`: how the boundaries may be wrong
    - `samples`: perturbed maps; the map as it is comes first
    - `probe`: its name; the first one of a force by default
    - `fixed`: overrides of the deck, `KEY=VALUE`
    - returns what `uncertainty.json` holds
    - raises InputError: the deck has no label map, or the amounts are wrong
    """
    doubt = doubt or Doubt()
    if not np.isfinite(doubt).all() or min(doubt[1:]) < 0.0 or doubt.length == 0.0:
        raise InputError("shift and noise must not be negative, and the length above 0")
    if samples < 2:
        raise InputError(f"--samples {samples}: at least 2 are needed")
    deck, out = Path(deck).resolve(), Path(out)
    values = load_deck(deck, fixed, "build")
    table = values["build"]
    if "surface" in table:
        raise InputError(
            "build.surface: the study moves the surface of a label map; give build.labels instead"
        )
    source = deck.parent / table["labels"] if "labels" in table else out / "segmentation.nii.gz"
    if not source.is_file():
        raise FileError(f"{source}: there is no label map; run `myork segment` into {out} first")
    labels = read_labels(source)
    if not (labels.data > 0).any():
        raise InputError(f"{source}: no label is above 0")
    own = out / "fibers.nii.gz"
    fibers = deck.parent / table["fibers"] if "fibers" in table else own
    rng = np.random.default_rng(seed)
    rows: list[dict[str, Any]] = []
    name, unit = probe or "", ""
    for number in range(samples + 1):
        start = time.process_time()
        shift = doubt.bias + doubt.shift * rng.standard_normal()
        moved = labels
        if number == 0:
            shift = 0.0
        else:
            moved = perturbed(labels, shift, doubt.noise, doubt.length, rng)
        folder = out / f"map_{number:03d}"
        folder.mkdir(parents=True, exist_ok=True)
        write_labels(folder / "labels.nii.gz", moved)
        settings = [
            *fixed,
            override_text("build.labels", str((folder / "labels.nii.gz").resolve())),
        ]
        if fibers.is_file() and ("fibers" in table or "labels" not in table):
            settings.append(override_text("build.fibers", str(fibers.resolve())))
        row: dict[str, Any] = {"map": number, "shift": shift, "value": np.nan, "message": ""}
        try:
            build(deck, folder, overrides=settings)
            row["volume"] = float(read_model(folder / "model.h5").volume.sum())
            with Scene(deck, settings, folder, threads) as scene:
                name, unit, place = _probe_of(scene, probe)
                state = scene.solve(error=False).x[-1:]
                row["value"] = float(scene.probes(state, np.ones(1))[0][place])
        except ConvergenceError as reason:
            row["message"] = str(reason)
        row["cpu_s"] = time.process_time() - start
        rows.append(row)
        shutil.rmtree(folder)
        found = row["message"] or f"{name} {row['value']:.4g}"
        progress(f"map {number}/{samples}: {found}")
    summary = _summary(rows, doubt, name, seed)
    summary |= {"unit": unit, "units": dict(values["result_units"])}
    names = ["map", "shift", "volume", "value", "message", "cpu_s"]
    write_csv(out / "uncertainty.csv", names, ([row.get(n, "") for n in names] for row in rows))
    write_json(out / "uncertainty.json", summary)
    return summary


def perturbed(
    labels: Labels, shift: float, noise: float, length: float, rng: np.random.Generator
) -> Labels:
    """A label map whose boundaries are moved outwards.

    The body is what lies inside a moved signed distance to its surface. Within it each voxel has
    the label that it is deepest in; borders between labels move by the random field alone, since
    what one of them loses the other has. A move by less than a voxel takes as many voxels of the
    boundary, in random patches, so that volumes change by it on average.

    - `labels`: label map
    - `shift`: move of the surface [mm]
    - `noise`, `length`: standard deviation of a smooth random move, and over which distance it
      varies [mm]
    - `rng`: random numbers
    """
    data, spacing = labels.data, labels.spacing

    def moved(inside: Mask) -> F64:
        """Distance to the moved boundary, positive inside [mm]."""
        # a map goes on beyond its first and last slice
        whole = np.pad(inside, 1)
        whole[:, :, 0], whole[:, :, -1] = whole[:, :, 1], whole[:, :, -2]
        depth = ndimage.distance_transform_edt(whole, spacing)
        depth -= ndimage.distance_transform_edt(~whole, spacing)
        depth = depth[1:-1, 1:-1, 1:-1]
        # distances are those to centres of voxels: the boundary lies half a voxel before
        half = 0.5 * float(np.min(spacing))
        depth = depth - half * np.sign(depth) + noise * _field(data.shape, length / spacing, rng)
        # evenly between half a voxel inwards and outwards
        part = ndtr(_field(data.shape, np.full(3, 2.0), rng)) - 0.5
        return np.asarray(depth + 2.0 * half * part)

    body = moved(data > 0) + shift > 0.0
    found = [int(label) for label in np.unique(data[data > 0])]
    chosen = np.full(data.shape, found[0], data.dtype)
    if len(found) > 1:
        depths = np.stack([moved(data == label) for label in found])
        chosen = np.asarray(found, data.dtype)[np.argmax(depths, axis=0)]
    return Labels(np.where(body, chosen, 0), labels.affine, labels.names, labels.name)


def _field(shape: tuple[int, ...], length: F64, rng: np.random.Generator) -> F64:
    """A smooth random field of standard deviation one."""
    field = ndimage.gaussian_filter(rng.standard_normal(shape), 0.5 * length, mode="wrap")
    return np.asarray(field / max(float(field.std()), 1e-300))


def _probe_of(scene: Scene, asked: str | None) -> tuple[str, str, tuple[int, int]]:
    """Name, unit and place of the number asked for, the first of a force by default."""
    probes = scene.deck["probe"]
    places = places_of(probes, scene.dimension)
    forces = (name for name, (i, _) in places.items() if "force" in probes[i]["quantity"])
    name = asked or next(forces, "NAME")
    if name not in places:
        raise InputError(f"--probe {name}: there are {', '.join(places) or 'none'}")
    return name, units_of(probes, scene.dimension, scene.probe_units)[name], places[name]


def _summary(rows: Sequence[dict[str, Any]], doubt: Doubt, name: str, seed: int) -> dict[str, Any]:
    value = np.array([row["value"] for row in rows])
    good = np.isfinite(value)
    good[0] = False
    if good.sum() < 2:
        raise InputError(f"fewer than two maps could be solved: {rows[-1]['message']}")
    spread = value[good]
    volume = np.array([row.get("volume", np.nan) for row in rows])[good]
    slope = np.polyfit(volume / volume.mean() - 1.0, spread / spread.mean() - 1.0, 1)[0]
    left = spread / spread.mean() - 1.0 - slope * (volume / volume.mean() - 1.0)
    total = float(np.var(spread / spread.mean()))
    return {
        "probe": name,
        "doubt_mm": doubt._asdict(),
        "seed": seed,
        "maps": len(rows) - 1,
        "failed": int(len(rows) - 1 - good.sum()),
        "as_it_is": float(value[0]) if np.isfinite(value[0]) else None,
        "mean": float(spread.mean()),
        "standard_deviation": float(spread.std(ddof=1)),
        "percentiles": dict(
            zip(("2.5", "50", "97.5"), np.percentile(spread, [2.5, 50, 97.5]).tolist(), strict=True)
        ),
        "relative_standard_deviation": float(spread.std(ddof=1) / abs(spread.mean())),
        "volume_relative_standard_deviation": float(volume.std(ddof=1) / volume.mean()),
        "force_per_volume": float(slope),
        "explained_by_volume": 1.0 - float(np.var(left)) / total if total > 0 else None,
        "cpu_s": float(sum(row["cpu_s"] for row in rows)),
    }
