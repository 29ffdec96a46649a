"""Settings shared by all tests."""

import os
import shutil
import signal
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

# Before numpy and the core are imported: OpenMP and OpenBLAS read these once. Only with one thread
# is the speed reliable on a shared machine; tests of threads ask for two.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MPLBACKEND", "Agg")

# A shell starts background processes with SIGINT ignored, and programs inherit that
signal.signal(signal.SIGINT, signal.default_int_handler)

import pytest  # noqa: E402


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Tests neither slow nor nightly are core; those that train a reduced model are slow."""
    for item in items:
        if {"trained", "voxel_rom"} & set(getattr(item, "fixturenames", ())):
            item.add_marker(pytest.mark.slow)
        if not any(item.get_closest_marker(name) for name in ("slow", "nightly")):
            item.add_marker(pytest.mark.core)


@pytest.fixture(scope="session")
def inputs() -> Path:
    """Folder with the decks of the checkout."""
    return Path(__file__).parent.parent / "inputs"


@pytest.fixture
def write_deck(tmp_path: Path) -> Callable[[dict[str, Any]], Path]:
    """Write tables as a deck; units and title need not be given."""
    from tests.scenes import deck_file

    return partial(deck_file, tmp_path / "deck.toml")


@pytest.fixture
def open_scene() -> Iterator[Callable[..., Any]]:
    """Open scenes from tables, or from the path of a deck; all are closed at the end."""
    from myork import Scene

    scenes = []

    def open_(deck: dict[str, Any] | Path, *overrides: str, cloud: Any = None) -> Scene:
        if isinstance(deck, dict):
            scenes.append(Scene.from_tables(deck, cloud, overrides=overrides))
        else:
            scenes.append(Scene(deck, overrides))
        return scenes[-1]

    yield open_
    for scene in scenes:
        scene.close()


@pytest.fixture(scope="session")
def voxel_rom(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """File of a reduced model of a muscle of 4 x 4 x 4 voxels, with arrays of every kind."""
    from dataclasses import replace

    import numpy as np

    from myork import ReducedModel
    from myork.core.deck import text_of_tables
    from myork.model_file import write_model
    from tests.scenes import gripped, voxels

    muscle = {"name": "muscle", "label": 1, "model": "muscle", "A10": 6.43, "K": 500}
    tables = gripped(
        "rkpm-scni", {"kind": "model", "file": "model.h5"}, {**muscle, "sigma_max": 30},
        "bottom top", "pull force bottom", "middle u 1.5 1.5 1.5", "stress cauchy_zz 1.5 1.5 1.5",
        title="Muscle of voxels", approximation={"order": 1, "support": 1.6}, u_z=0.1,
        load={"steps": 1, "activation": 0.5},
    )  # fmt: skip
    folder = tmp_path_factory.mktemp("rom")
    cloud = voxels(np.pad(np.ones((4, 4, 4)), 1), 5.0, source_stride=[2] * 3)
    along = np.tile([0.0, 0.0, 1.0], (len(cloud.points), 1))
    write_model(folder / "model.h5", replace(cloud, fiber=along))
    (folder / "muscle.toml").write_text(text_of_tables(tables), encoding="utf-8")
    ranges = {"load.activation": (0.0, 0.5), "boundary.top.u_z": (-0.1, 0.1)}
    rom = ReducedModel.train(folder / "muscle.toml", ranges, full_solves=6, tests=2, threads=1)
    return rom.save(folder / "muscle.rom.h5")


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A headless Chromium; without one, a test fails instead of passing.

    It is closed with its module: its event loop would disturb other tests.
    """
    from playwright.sync_api import sync_playwright

    names = ("chromium", "chromium-browser", "google-chrome")
    path = next((found for name in names if (found := shutil.which(name))), None)
    assert path is not None, f"a browser is needed, one of {', '.join(names)}: apt install chromium"
    with sync_playwright() as driver:
        # WebGL without a graphics card
        options = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
        chromium = driver.chromium.launch(executable_path=path, args=options)
        yield chromium
        chromium.close()


@pytest.fixture
def open_page(browser: Any) -> Iterator[Callable[[str], Any]]:
    """Open a page; at the end its console must be empty."""
    said: list[str] = []
    pages = []

    def open_(address: str) -> Any:
        page = browser.new_page(viewport={"width": 1400, "height": 860})
        page.set_default_timeout(60_000)
        page.on("console", lambda message: said.append(f"{message.type}: {message.text}"))
        page.on("pageerror", lambda error: said.append(f"error: {error}"))
        page.goto(address)
        pages.append(page)
        return page

    yield open_
    for page in pages:
        page.close()
    assert said == []
