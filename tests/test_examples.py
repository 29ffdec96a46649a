"""The scripts of the gallery run, are short, and stand on its page with their pictures."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))


def test_the_gallery_shows_every_script() -> None:
    page = (ROOT / "docs" / "gallery.md").read_text(encoding="utf-8")
    for script in SCRIPTS:
        assert f"`examples/{script.name}`" in page and f"(gallery/{script.stem}.png)" in page
        assert len(script.read_text(encoding="utf-8").splitlines()) <= 40, script.name
    assert len(list((ROOT / "docs" / "gallery").iterdir())) == len(SCRIPTS) > 0


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_makes_its_picture(script: Path, tmp_path: Path) -> None:
    picture = tmp_path / "picture.png"
    found = subprocess.run(
        [sys.executable, str(script), str(picture)], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "MPLBACKEND": "agg", "PYTHONPATH": ""}, check=False,
    )  # fmt: skip
    assert found.returncode == 0, found.stderr
    assert picture.read_bytes().startswith(b"\x89PNG") and picture.stat().st_size > 5000
    said = found.stdout
    if script.stem == "measured_fibers":
        page = (ROOT / "docs" / "validation.md").read_text(encoding="utf-8")
        assert f"```text\n{said}```" in page, said
    assert said and not {"doubtful", "refused", "nan"} & set(said.replace(":", " ").split()), said
