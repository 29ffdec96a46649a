"""The site: it builds without warnings, its index of equations is true, its tutorials run."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
NUMBER = r"(?:[3-6]|[A-C])\.\d+"
# numbered equations of the dissertation: chapter or appendix and the last number
LAST = {"3": 45, "4": 39, "5": 126, "6": 72, "A": 2, "B": 2, "C": 17}


def spread(first: str, last: str) -> set[str]:
    """All numbers from one equation to another of the same chapter."""
    chapter, low = first.split(".")
    return {f"{chapter}.{i}" for i in range(int(low), int(last.split(".")[1]) + 1)}


def rows() -> Iterator[tuple[set[str], str]]:
    for line in (ROOT / "docs/equations.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and re.match(NUMBER, cells[0]):
            numbers: set[str] = set()
            for part in cells[0].split(","):
                ends = part.strip().split("-")
                numbers |= spread(ends[0], ends[-1])
            yield numbers, cells[2]


def cited(path: Path) -> set[str]:
    """Equations that a file cites: (5.76), (5.78a), (5.1)-(5.5) and (5.1) to (5.5)."""
    numbers: set[str] = set()
    text = re.sub(r"\n\s*(!>|!|#)?\s*", " ", path.read_text())
    for first, last in re.findall(
        rf"\(({NUMBER})[a-e]?\)(?:(?:-| to | and )\(({NUMBER})[a-e]?\))?", text
    ):
        numbers |= spread(first, last or first) if first[0] == (last or first)[0] else {first}
        numbers.add(last or first)
    return numbers


def test_every_equation_has_one_row() -> None:
    found = [number for numbers, _ in rows() for number in numbers]
    wanted = {f"{chapter}.{i}" for chapter, n in LAST.items() for i in range(1, n + 1)}
    assert sorted(found) == sorted(wanted)


@pytest.mark.parametrize(("numbers", "where"), list(rows()), ids=lambda value: str(value)[:40])
def test_named_files_cite_their_equations(numbers: set[str], where: str) -> None:
    files = re.findall(r"`([\w/.]+\.(?:f90|py|toml|c))`", where)
    if not files:
        assert re.match(r"(not needed|open): \w+", where)
    for name in files:
        assert cited(ROOT / name) & numbers, f"{name} cites none of {sorted(numbers)}"


def test_site_builds_without_warnings(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "index.html").is_file()


@pytest.mark.parametrize(
    "page",
    [ROOT / "docs/start.md", *sorted((ROOT / "docs/tutorials").glob("*.md"))],
    ids=lambda p: p.stem,
)
def test_tutorials_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every block as it stands: decks are written, commands run, Python keeps its names."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = re.findall(r"^```(python|sh|toml)\n(.*?)^```$", page.read_text(), re.S | re.M)
    assert blocks
    for kind, text in blocks:
        if kind == "toml":
            Path(text.splitlines()[0].removeprefix("# ")).write_text(text)
        elif kind == "python":
            exec(compile(text, str(page), "exec"), names)
        else:
            for line in text.splitlines():
                words = shlex.split(line, comments=True)
                assert words.pop(0) == "myork"
                command = [sys.executable, "-m", "myork", *words]
                done = subprocess.run(command, capture_output=True, text=True, check=False)
                assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
