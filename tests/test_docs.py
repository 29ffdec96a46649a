"""The site: it builds without warnings, its index of equations is correct, its tutorials run.

The command output shown on a page is what the command prints. Scripts of the gallery run, are
short and are shown on its page with their pictures.
"""

import inspect
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from importlib import import_module
from itertools import zip_longest
from pathlib import Path

import pytest
import yaml

from benchmarks.runner import TABLES, write_table
from myork.bench import BENCHES
from tests.scenes import myork

ROOT = Path(__file__).parents[1]
NUMBER = r"(?:[3-6]|[A-C])\.\d+"
# numbered equations of the dissertation: chapter or appendix and the last number
LAST = {"3": 45, "4": 39, "5": 126, "6": 72, "A": 2, "B": 2, "C": 17}


def spread(first: str, last: str) -> set[str]:
    """All numbers from one equation to another of the same chapter."""
    chapter, low = first.split(".")
    return {f"{chapter}.{i}" for i in range(int(low), int(last.split(".")[1]) + 1)}


def rows() -> Iterator[set[str]]:
    for line in (ROOT / "docs/equations.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 3 and re.match(NUMBER, cells[0]):
            numbers: set[str] = set()
            for part in cells[0].split(","):
                ends = part.strip().split("-")
                numbers |= spread(ends[0], ends[-1])
            yield numbers


def test_every_equation_has_one_row() -> None:
    found = [number for numbers in rows() for number in numbers]
    wanted = {f"{chapter}.{i}" for chapter, n in LAST.items() for i in range(1, n + 1)}
    assert sorted(found) == sorted(wanted)


@pytest.mark.slow
def test_site_builds_without_warnings(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-q", "docs", str(tmp_path)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "index.html").is_file()


#: Pages whose blocks run unchanged, one after the other
TUTORIALS = [ROOT / "docs/start.md", *sorted((ROOT / "docs/tutorials").glob("*.md"))]
#: Pages that show what commands print
SHOWING = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
NUMBER_SHOWN = re.compile(r"[-+]?\d+(?:\.\d+)?(?:[Ee][-+]?\d+)?")


def run(line: str) -> str:
    """Output of a command on a page."""
    words = shlex.split(line, comments=True)
    assert words.pop(0) == "myork", line
    done = myork(*words, timeout=None)
    assert done.returncode == 0, f"{line}\n{done.stdout}{done.stderr}"
    return done.stdout


def is_alike(shown: str, printed: str) -> bool:
    """Whether a line of a page agrees with that of a run.

    Words must be equal, and numbers to 1.5 in the last digit shown or 1e-4, as the last digits
    depend on libraries. Residuals, steps of the iteration, times and memory are not compared.
    """
    lines = [
        re.sub(r"(\|(?:r|A'r|da)\| +)\S+|\S+ (?:(?:CPU )?s|MB)(?=,|$)", r"\1...", line.rstrip())
        for line in (shown, printed)
    ]
    if len({NUMBER_SHOWN.sub("0", line) for line in lines}) > 1:
        return False
    for one, other in zip(*map(NUMBER_SHOWN.findall, lines), strict=True):
        digits, _, power = one.lower().partition("e")
        last = 10.0 ** (int(power or 0) - len(digits.partition(".")[2]))
        if abs(float(one) - float(other)) > max(1.5 * last, 1e-4 * abs(float(one))):
            return False
    return True


def run_console(block: str) -> None:
    """Run the commands of a block, and compare the text below each with its output."""
    for part in re.split(r"^\$ ", block, flags=re.M)[1:]:
        line, _, shown = part.partition("\n")
        printed = run(line)
        pairs = list(zip_longest(shown.splitlines(), printed.splitlines(), fillvalue=""))
        assert all(is_alike(*pair) for pair in pairs), f"$ {line}\n{printed}"


def blocks_of(page: Path, kinds: str) -> list[tuple[str, str]]:
    """Kinds and texts of the fenced blocks of a page."""
    return re.findall(rf"^```({kinds})\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE)


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [page for page in SHOWING if page not in TUTORIALS and blocks_of(page, "console")],
    ids=lambda p: p.stem,
)
def test_samples_are_what_commands_print(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "inputs").symlink_to(ROOT / "inputs")
    for _, block in blocks_of(page, "console"):
        run_console(block)


def test_what_commands_print_stands_below_them() -> None:
    """Answers of solves are shown in blocks of the kind `console`, which are run."""
    answer = re.compile(r"^ *(?:(?:accepted|doubtful|refused): |step +\d+/\d+ |\w+ \S+ \+- )", re.M)
    bare = {
        page.name: answer.findall(
            re.sub(r"^```console\n.*?^```$", "", page.read_text(), flags=re.S | re.M)
        )
        for page in SHOWING
    }
    assert not {name: found for name, found in bare.items() if found}


@pytest.mark.slow
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda p: p.stem)
def test_tutorials_run(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every block unchanged: decks are written, commands run, Python keeps its names."""
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    blocks = blocks_of(page, "python|sh|toml|console")
    assert blocks
    for kind, text in blocks:
        if kind == "toml":
            Path(text.splitlines()[0].removeprefix("# ")).write_text(text)
        elif kind == "python":
            exec(compile(text, str(page), "exec"), names)
        elif kind == "console":
            run_console(text)
        else:
            for line in text.splitlines():
                run(line)


@pytest.mark.slow
def test_tables_stand_below_what_their_functions_say() -> None:
    results = ROOT / "docs" / "results"
    pages = {page.stem: page.read_text("utf-8") for page in results.glob("*.md")}
    for module, names in TABLES.items():
        page = pages.get(module, pages["images"])
        for name in (name for name in names if f"\n## {name}\n" in page):
            about = inspect.getdoc(getattr(import_module(f"benchmarks.tables.{module}"), name))
            assert f"\n\n## {name}\n\n{about}\n\n| " in page, name


def test_a_table_replaces_its_earlier_rows(tmp_path: Path) -> None:
    page = tmp_path / "images.md"
    for rows in ([["a", "b"], ["1", ""]], [["a"], ["2"]]):
        write_table(page, "two", "About two.", rows, "today")
        write_table(page, "one", "About one.", [["c"]], "now")
    assert page.read_text("utf-8") == (
        "# Two\n\n## one\n\nAbout one.\n\n| c |\n|---|\n\nnow\n\n"
        "## two\n\nAbout two.\n\n| a |\n|---|\n| 2 |\n\ntoday\n"
    )


# ---- the gallery ---------------------------------------------------------------------------------

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


# ---- links, numbers of the README, citation ------------------------------------------------------


TEXTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])
#: Texts in backquotes that are paths of the tree
FOLDERS = ["benchmarks", "docs", "examples", "fortran", "inputs", "pydriver", "tests"]
FOLDERS += [".ci", ".github"]


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def prose(page: Path) -> str:
    """Text without blocks of code and formulas."""
    text = page.read_text(encoding="utf-8")
    return re.sub(r"^(```|~~~).*?^\1$|\$\$.*?\$\$", "", text, flags=re.M | re.S)


@cache
def anchors(page: Path) -> set[str]:
    """Names of the headings, as GitHub and myst make them."""
    heads = re.findall(r"^#+ +(.+?) *$", prose(page), flags=re.M)
    plain = [re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", head).lower() for head in heads]
    return {re.sub(r"[^\w\- ]", "", head).replace(" ", "-") for head in plain}


def test_links_resolve() -> None:
    wrong = []
    for page in TEXTS:
        for target in re.findall(r"\]\(<?([^)\s>]+)>?\)", prose(page)):
            if re.match(r"[a-z]+:", target):
                if not target.startswith(("https://", "mailto:")):
                    wrong.append(f"{name_of(page)}: {target}")
                continue
            name, _, anchor = target.partition("#")
            path = (page.parent / name).resolve() if name else page
            if not path.exists() or (anchor and anchor not in anchors(path)):
                wrong.append(f"{name_of(page)}: {target}")
    assert not wrong, "\n".join(wrong)


def test_paths_and_benchmarks_are_there() -> None:
    """Paths in backquotes exist, and so do the benchmarks by which numbers are traced."""
    wrong = []
    for page in TEXTS:
        text = prose(page)
        named = re.findall(rf"`((?:{'|'.join(map(re.escape, FOLDERS))})/[\w./*-]+)`", text)
        absent = [path for path in named if not any(ROOT.glob(path.rstrip("/")))]
        wrong += [f"{name_of(page)}: {path}" for path in absent]
        whole = page.read_text(encoding="utf-8")
        for names in re.findall(r"myork bench ((?:[a-z_]+ ?)+)[`\n]", whole):
            unknown = {*names.split()} - {*BENCHES, "all"}
            wrong += [f"{name_of(page)}: myork bench {name}" for name in unknown]
    assert not wrong, "\n".join(wrong)


def test_numbers_of_the_readme_are_those_of_the_pages() -> None:
    """Measured values are on the page that their row names, as printed."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = text.split("## What has been measured")[1].split("\n## ")[0].splitlines()
    counted = 0
    for row in (row for row in rows if row.startswith("| ") and "](" in row):
        *_, found, printed, pages = row.strip("| ").split(" | ")
        assert re.search("myork (?:bench|reproduce)|benchmarks/", printed), row
        linked = re.findall(r"\]\(([^)]+)\)", pages)
        there = "".join((ROOT / page).read_text(encoding="utf-8") for page in linked)
        for number in re.findall(r"\d+\.\d+(?:e-?\d+)?", found):
            assert re.search(rf"(?<![\d.]){re.escape(number)}(?!\d)", there), f"{number}: {row}"
            counted += 1
    assert counted > 8


def test_the_citation_is_that_of_this_version() -> None:
    """CITATION.cff, pyproject's licence and meson's version agree; the citation is complete."""
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    meson = (ROOT / "meson.build").read_text(encoding="utf-8")
    assert f"version: '{cited['version']}'" in meson
    assert f"license: '{cited['license']}'" in meson
    needed = {"cff-version", "message", "title", "type", "abstract", "keywords", "authors"}
    assert needed <= set(cited) and cited["references"][0]["url"].startswith("https://")
