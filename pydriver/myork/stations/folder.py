"""Decks made from a folder of images, a BIDS tree or DICOM files."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from myork.core.deck import text_of_tables
from myork.errors import FileError, InputError
from myork.files import write_text
from myork.imaging.dicom import dicom_files, listed_images
from myork.imaging.headers import bids_name

#: BIDS suffixes of anatomical images, the best one first
_ANATOMY = ("T1w", "PDw", "T2w", "PDT2", "T2starw", "FLASH", "MEGRE")
_ENDS = ("bottom", "top")


class _Found(NamedTuple):
    """Images of a folder by kind, the best one first; echoes in the order of their times."""

    anatomy: list[str]
    dwi: list[str]
    magnitude: list[str]
    phase: list[str]
    water: Sequence[str] = ()
    fat: Sequence[str] = ()
    labels: Sequence[str] = ()


def deck_of_folder(folder: Path, out: Path) -> tuple[Path, list[str]]:
    """Write a deck for a folder of images.

    - `folder`: one subject (and visit) of a BIDS tree, or DICOM images
    - `out`: folder of the results
    - returns the deck, in the folder of the results, and lines that report the use of each image
    """
    folder = folder.resolve()
    files = sorted(path for path in folder.rglob("*") if path.name.endswith((".nii", ".nii.gz")))
    try:
        found = _of_bids(folder, files) if files else _of_dicom(folder)
    except FileError:
        decks = sorted(folder.glob("*.toml"))
        if not decks:
            raise
        raise InputError(
            f"{folder}: is a folder; name a deck inside it, such as {decks[0]}"
        ) from None
    tables, lines = _tables(found)
    if not tables["image"] and "dixon" not in tables and not found.labels:
        raise InputError(
            f"{folder}: contains no image that can be identified by its name or header; "
            f"BIDS names end in _{', _'.join(_ANATOMY)}, _dwi or _dseg; or write a deck "
            "(myork new images)"
        )
    lines.insert(0, f"{folder}: what its names and headers say")
    tables["title"] = f"Images of {folder.name}"
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"{folder.name}.toml"
    comments = [f"# {line}" for line in (*lines, "written anew by each run of the folder: copy it")]
    write_text(path, "\n".join([*comments, text_of_tables(tables)]))
    return path, [*lines, f"deck: {path}"]


def _of_bids(folder: Path, files: list[Path]) -> _Found:
    """Images of a BIDS tree by the suffixes of their names."""
    every = [bids_name(path)[0] for path in files]
    names = {"/".join(f"{k}-{one[k]}" for k in ("sub", "ses") if k in one) for one in every}
    visits = sorted(names - {""})
    if len(visits) > 1:
        raise InputError(
            f"{folder}: contains {len(visits)} subjects or visits; give the folder of one, such as "
            f"{folder / visits[0]}"
        )

    def named(suffix: str) -> list[str]:
        return [
            str(path)
            for path in files
            for entities, kind in [bids_name(path)]
            if kind == suffix
            and entities.get("part", "mag") == "mag"
            and (suffix == "dseg" or "derivatives" not in path.relative_to(folder).parts)
        ]

    magnitude, phase = _echoes(files)
    return _Found(
        anatomy=[path for suffix in _ANATOMY for path in named(suffix)],
        dwi=named("dwi"),
        magnitude=magnitude,
        phase=phase,
        labels=named("dseg"),
    )


def _echoes(files: list[Path]) -> tuple[list[str], list[str]]:
    """Magnitudes and phases of the first multi-echo run that has both, in order."""
    runs: dict[tuple[Path, str], dict[str, dict[int, str]]] = {}
    for path in files:
        entities, kind = bids_name(path)
        if kind == "MEGRE" and "derivatives" not in path.parts:
            part, echo = entities.pop("part", "mag"), int(entities.pop("echo", "1"))
            run = runs.setdefault((path.parent, str(sorted(entities.items()))), {})
            run.setdefault(part, {})[echo] = str(path)
    for run in runs.values():
        magnitude, phase = run.get("mag", {}), run.get("phase", {})
        if len(magnitude) > 1 and magnitude.keys() == phase.keys():
            order = sorted(magnitude)
            return [magnitude[number] for number in order], [phase[number] for number in order]
    return [], []


def _of_dicom(folder: Path) -> _Found:
    """Images of a DICOM folder by their headers, the anatomy with the most voxels first."""
    images = listed_images(dicom_files(folder))
    kinds: dict[str, list[Any]] = {}
    for one in images:
        kinds.setdefault("dwi" if one.weighted else one.kind, []).append(one)
    echoes: dict[Any, dict[str, list[Any]]] = {}
    for one in images:
        if one.kind in ("magnitude", "phase"):
            echoes.setdefault(one.series, {}).setdefault(one.kind, []).append(one)
    pairs = [
        (parts["magnitude"], parts["phase"])
        for parts in echoes.values()
        if len(parts.get("magnitude", ())) == len(parts.get("phase", ())) > 1
    ]
    magnitude, phase = pairs[0] if pairs else ([], [])

    def paths(found: Iterable[Any]) -> list[str]:
        return [f"{folder}:{one.text}" for one in found]

    plain = [one for one in images if one.kind not in ("phase", "fat") and not one.weighted]
    plain.sort(key=lambda one: -one.voxels)
    return _Found(
        anatomy=paths(plain),
        dwi=paths(kinds.get("dwi", ())),
        magnitude=paths(magnitude),
        phase=paths(phase),
        water=paths(kinds.get("water", ())),
        fat=paths(kinds.get("fat", ())),
    )


def _tables(found: _Found) -> tuple[dict[str, Any], list[str]]:
    """Tables of the deck, and lines that report the use of each image."""
    image: dict[str, Any] = {}
    tables: dict[str, Any] = {"scene": {"dimension": 3}, "image": image}
    lines = []
    if len(found.magnitude) == len(found.phase) > 1 and not found.labels:
        tables["dixon"] = {"magnitude": found.magnitude, "phase": found.phase}
        lines.append(f"water and fat of {len(found.phase)} echoes: {found.magnitude[0]} and so on")
    elif found.water and found.fat and not found.labels:
        image |= {"anatomy": found.water[0], "fat": found.fat[0]}
        lines.append(f"water and fat of the scanner: {found.water[0]}, {found.fat[0]}")
    elif found.anatomy:
        image["anatomy"] = found.anatomy[0]
        lines.append(f"anatomy: {_one_of(found.anatomy)}")
    if found.dwi and (image or found.labels):
        image["dwi"] = found.dwi[0]
        lines.append(f"diffusion: {_one_of(found.dwi)}")
    if found.labels:
        tables |= _model(found)
        lines.append(f"muscles: {_one_of(found.labels)}, fixed at both ends, activation 0.2")
    else:
        tables["tissue"] = {"find": True}
        tables["build"] = {
            "collocation_stride": [4, 4, 1], "source_stride": [4, 4, 1],
            "ids": [1, 2], "flow": not found.dwi,
        }  # fmt: skip
        lines.append("muscles: no label map (_dseg), so tissues and no force")
    return tables, lines


def _model(found: _Found) -> dict[str, Any]:
    """Tables of a muscle that contracts between both cut planes."""
    clamped = {"u_x": 0, "u_y": 0, "u_z": 0}
    return {
        "build": {
            "labels": found.labels[0],
            "collocation_stride": [2, 2, 1],
            "source_stride": [4, 4, 1],
            "flow": not found.dwi,
        },  # fmt: skip
        "geometry": {"kind": "model"},
        "material": [
            {"name": "muscle", "model": "muscle", "A10": 6.43, "A01": -3.8, "A20": 0.94, "K": 5000}
        ],
        "boundary": [{"set": name, **clamped} for name in _ENDS],
        "load": {"activation": 0.2},
        "probe": [{"name": "force", "quantity": "force_z", "set": _ENDS[1]}],
    }


def _one_of(paths: Sequence[str]) -> str:
    more = f" (first of {len(paths)})" if len(paths) > 1 else ""
    return f"{paths[0]}{more}"
