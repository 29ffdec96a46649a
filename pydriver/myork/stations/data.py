"""Files named by a deck: read onto one grid, or looked for in a folder of the user's data."""

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from myork.console import ProgressCallback
from myork.core.deck import load_deck
from myork.errors import FileError, InputError
from myork.imaging.damage import Damage, damaged_slices, missing_slices
from myork.imaging.dicom import split_choice
from myork.imaging.diffusion import Diffusion, gradient_files, read_tensors
from myork.imaging.geometry import Grid, slice_axis, with_axis_at
from myork.imaging.io import read_image, read_labels, read_reference, renew_images
from myork.imaging.resampling import on_grid
from myork.records import Image, Labels

#: Keys of decks that name an image, a label map, a surface or tracts
PATHS = (
    "image.anatomy",
    "image.tensor",
    "image.dwi",
    "image.channels",
    "image.fat",
    "image.truth",
    "image.region",
    "image.body",
    "image.reference",
    "image.reference_anatomy",
    "image.seeds",
    "dixon.magnitude",
    "dixon.phase",
    "build.labels",
    "build.fibers",
    "build.fractions",
    "build.activation",
    "build.surface",
    "build.tracts",
    "tissue.fat",
    "tissue.connective",
)

#: Keys whose images come from a scanner: their slices are checked for damage
_MEASURED = ("anatomy", "channels", "magnitude")


class OneGrid:
    """Brings images and label maps onto the grid of a run; the log reports what was moved.

    - `progress`: called with a line of text at a time
    - `slices_last`: the slice axis of all images is moved to the last place, as the segmentation
      needs it; `stored` restores the order of the first image's file
    """

    def __init__(self, progress: ProgressCallback, slices_last: bool = False) -> None:
        self._progress = progress
        self._slices_last = slices_last
        self._axis: int | None = None  # slice axis in the first file
        #: Entries `file`, `how` and `shift` [mm] of `summary.json`, see `myork.imaging.resampling`
        self.moved: list[dict[str, Any]] = []
        #: Entries `file`, `slices` and `why` of `summary.json`, see `myork.imaging.damage`
        self.damaged: list[dict[str, Any]] = []
        self.doubts: list[str] = []  #: Warnings that have been printed

    def tell_strangers(self, image: Path, files: Iterable[Path]) -> None:
        """Report files that describe an image but have another name."""
        stem = image.name.removesuffix(".gz").removesuffix(".nii")
        if names := [file.name for file in files if file.stem != stem]:
            self._progress(f"{image.name}: described by {' and '.join(names)}")

    def doubt(self, text: str) -> None:
        """Warn at once: a fault of a file may be the reason for a later refusal."""
        self.doubts.append(text)
        self._progress(f"warning: {text}")

    def note(self, name: str, faults: Sequence[Damage]) -> None:
        """Warn about damaged slices of a file."""
        for fault in faults:
            self.damaged.append({"file": name, "slices": fault.slices, "why": fault.why})
            self.doubt(fault.said(name))

    def of(self, one: Grid, like: Image | Labels | None, way: str = "") -> Grid:
        """An image on the grid of another one; unchanged where there is none."""
        if self._slices_last:
            axis = slice_axis(one.spacing, one.data.shape[:3])
            self._axis = axis if self._axis is None else self._axis
            one = with_axis_at(one, axis, 2)
        if like is None:
            return one
        one, move = on_grid(one, like, way)
        if move is not None:
            self.moved.append({"file": move.file, "how": move.how, "shift": move.shift})
            self._progress(move.said)
            for text in move.doubts:
                self.doubt(text)
        return one

    def stored(self, one: Grid) -> Grid:
        """A result in the voxel order of the first file."""
        return one if self._axis is None else with_axis_at(one, 2, self._axis)

    def renew(self, folder: Path, **images: Image | None) -> None:
        """Write results by `renew_images`, in the voxel order of the first file."""
        renew_images(folder, **{name: one and self.stored(one) for name, one in images.items()})


class DeckFiles:
    """Images and label maps named by a table of a deck, on the grid of a run.

    - `deck`: effective deck; relative paths start in its folder
    - `name`: name of the table
    - `grid`: brings them onto one grid
    - `made`: files of an earlier station, for keys that the deck does not give
    """

    def __init__(
        self,
        deck: Mapping[str, Any],
        name: str,
        grid: OneGrid,
        made: Mapping[str, Path] | None = None,
    ) -> None:
        self.name, self.table, self.folder = name, deck[name], Path(deck["folder"])
        self.grid = grid
        self.read: list[Path] = []  #: Files behind what was returned
        self._made = made or {}

    @contextmanager
    def _naming(self, key: str) -> Iterator[None]:
        """Prefix errors of a file with its key."""
        try:
            yield
        except (FileError, InputError) as reason:
            known = f"{self.name}.{key}" in str(reason) or key not in self.table
            message = str(reason) if known else f"{self.name}.{key}: {reason}"
            raise type(reason)(message) from reason

    def path(self, key: str) -> Path | None:
        """Path of a key, recorded as read; None where there is none."""
        path = self.folder / self.table[key] if key in self.table else self._made.get(key)
        self.read += [] if path is None else [path]
        return path

    def image(
        self, key: str, like: Image | Labels | None = None, values: int | None = 1
    ) -> Image | None:
        """Image of a key, on the grid of another one; None without the key.

        - `values`: values per voxel, as in `read_image`
        """
        path = self.path(key)
        if path is None:
            return None
        way = "tensor-wise" if values in (3, 6) else "linear"
        return self.grid.of(self._image(key, path, values), like, way)

    def _image(self, key: str, path: Path, values: int | None = 1) -> Image:
        """Image of a file, with a warning about damaged slices."""
        with self._naming(key):
            found = read_image(path, values, self.grid.doubt)
        if key in _MEASURED:
            self.grid.note(found.name, damaged_slices(found))
        return found

    def images(self, key: str, like: Image | None = None, way: str = "linear") -> list[Image]:
        """Images of a key with several files, on one grid: by default that of the first."""
        found: list[Image] = []
        for name in self.table[key]:
            image = self._image(key, self.folder / name)
            found.append(self.grid.of(image, like or next(iter(found), None), way))
        return found

    def tensors(self) -> Diffusion | None:
        """Diffusion tensors of the table `image`, on their own grid; None without any."""
        with self._naming("dwi" if "dwi" in self.table else "tensor"):
            found = read_tensors(self.table, self.folder)
        dwi = self.folder / self.table.get("dwi", "")
        if dwi.is_file():
            self.grid.tell_strangers(dwi, gradient_files(dwi))
        for text in found.doubts if found else ():
            self.grid.doubt(text)
        if found is not None and found.mean is not None:
            self.grid.note(found.mean.name, damaged_slices(found.mean))
        return found

    def labels(
        self, key: str, like: Image | None = None, progress: ProgressCallback | None = None
    ) -> Labels | None:
        """Label map of a key, on the grid of an image; None without the key.

        - `progress`: if given, a map without names takes those of its folder, see `read_reference`
        """
        path = self.path(key)
        if path is None:
            return None
        with self._naming(key):
            note = self.grid.doubt
            if progress:
                found = read_reference(path, progress, note)
            else:
                found = read_labels(path, note)
        if key == "labels":
            self.grid.note(found.name, missing_slices(found))
        found = self.grid.of(found, like)
        with self._naming(key):
            if key != "labels" and not found.data.any():  # labels of a model are on their own grid
                raise InputError(f"{found.name}: the {key} is empty, no label is above zero")
        return found


def data_overrides(deck: str | Path, data: str | Path, overrides: Sequence[str] = ()) -> list[str]:
    """Overrides that give the location of the files of a deck.

    Relative paths are looked for in the folder before that of the deck, where files of another
    subject may lie: a path with folders below `data`, all others by their names in all folders
    below it.

    - `data`: folder
    - returns `"table.key=value"` each
    """
    folder = Path(data)
    if not folder.is_dir():
        raise FileError(f"{folder}: there is no such folder; give --data the folder of your images")
    values = load_deck(deck, overrides)
    found = []
    for key in PATHS:
        table, name = key.split(".")
        wanted = values.get(table, {}).get(name)
        names = wanted if isinstance(wanted, list) else [wanted] if wanted else []
        own = [split_choice(Path(one)) for one in names]
        at_deck = [Path(values["folder"], path) for path, _ in own]
        places = [
            _place(deck, key, path, folder, beside)
            for (path, _), beside in zip(own, at_deck, strict=True)
        ]
        if all(
            one.exists() and one.samefile(two) for one, two in zip(at_deck, places, strict=True)
        ):
            continue
        chosen = [
            f"{place.resolve()}:{choice}" if choice else f"{place.resolve()}"
            for place, (_, choice) in zip(places, own, strict=True)
        ]
        text = json.dumps(chosen)
        found.append(f"{key}={text if isinstance(wanted, list) else chosen[0]}")
    return found


def _place(deck: str | Path, key: str, wanted: Path, folder: Path, beside: Path) -> Path:
    """The single file (or folder) with a given name below a folder, or that of the deck.

    - `beside`: where the deck says that it is
    """
    if wanted.is_absolute() and wanted.exists():
        return wanted
    if len(wanted.parts) > 1 and (folder / wanted).exists():
        return folder / wanted
    places = sorted({place.resolve() for place in folder.rglob(wanted.name)})
    if beside.exists() and (not places or beside.resolve() in places):
        return beside
    if not places:
        raise FileError(f"{deck}: there is no {wanted.name} ({key}) below {folder}")
    if len(places) > 1:
        raise InputError(
            f"{deck}: {len(places)} files below {folder} are called {wanted.name} "
            f"({key}): {places[0]}, {places[1]}; choose one by --set {key}=PATH"
        )
    return places[0]
