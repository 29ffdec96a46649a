"""The architecture as a test: which modules may use which.

Fortran: a file uses rooms of lower layers and its own, by `use ..., only`. Python: a module
imports modules of lower layers and those of its own room. Rooms of one layer do not see each
other.
"""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FORTRAN = ROOT / "fortran"
PACKAGE = ROOT / "pydriver" / "myork"

#: Rooms of fortran/ (folders with sources), lowest first
FORTRAN_LAYERS = [
    {"base"},
    {"algebra", "deck", "image"},
    {"material"},
    {"functions"},
    {"scene"},
    {"cells", "newton", "h5"},
    {"strong", "weak", "results"},
    {"reduced"},
    {"solve"},
    {"app", "api"},
]
#: Modules and folders of the package, lowest first
PYTHON_LAYERS = [
    {"types"},
    {"errors", "console"},
    {"records"},
    {"arrays", "files"},
    {"model_file", "summary", "tables"},
    {"results"},
    {"core", "imaging"},
    {"segmentation"},
    {"model"},
    {"stations"},
    {"rom", "report"},
    {"bench", "chain", "sweeps", "view"},
    {"demo"},
    {"cli"},
    {"__main__"},
]
#: Rooms that work without the compiled core
WITHOUT_CORE = {"imaging", "report"}

F90 = sorted(FORTRAN.rglob("*.f90"))
PYTHON = sorted(
    path for path in PACKAGE.rglob("*.py") if path.name != "__init__.py" or path.parent != PACKAGE
)


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def fortran_code(path: Path) -> list[str]:
    """Lines in lower case, without comments and literals, continuations joined."""
    text = re.sub(r"\"[^\"\n]*\"|'[^'\n]*'", "''", path.read_text(encoding="utf-8").lower())
    text = re.sub(r"!.*", "", text)
    return re.sub(r"&\s*\n\s*&?", " ", text).splitlines()


def functions(code: str) -> list[tuple[str, str, str]]:
    """Name, result and declarations of each function."""
    heads = r"\bfunction\s+(\w+)\s*\([^)]*\)(?:.*\bresult\s*\(\s*(\w+)\s*\))?"
    found = []
    for head in re.finditer(heads, code):
        name, result = head.groups()
        body = re.split(
            rf"\bend\s+function\s+{name}\b|\n\s*contains\b", code[head.end() :], maxsplit=1
        )
        found.append((name, result or name, body[0]))
    return found


def layer_of(room: str, layers: list[set[str]]) -> int:
    for digit, rooms in enumerate(layers):
        if room in rooms:
            return digit
    raise AssertionError(f"{room} has no place in the layers of {Path(__file__).name}")


def may_use(user: str, used: str, layers: list[set[str]]) -> bool:
    return user == used or layer_of(user, layers) > layer_of(used, layers)


def imported_modules(path: Path) -> list[str]:
    """Dotted names below myork that a file imports, at its top or inside a function."""
    found = []
    here = ["myork", *path.relative_to(PACKAGE).with_suffix("").parts][:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = here[: len(here) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            # from myork import x: x is the module; from myork.x import y: x is
            found += (
                [f"myork.{alias.name}" for alias in node.names] if module == "myork" else [module]
            )
    return [name.removeprefix("myork.") for name in found if name.startswith("myork.")]


def test_every_folder_has_a_place() -> None:
    assert F90 and PYTHON
    assert {path.parent.name for path in F90} == set().union(*FORTRAN_LAYERS)
    assert sum(path.is_dir() for path in FORTRAN.iterdir()) <= 16


USE = re.compile(r"\s*use\b(\s*,\s*(?P<nature>\w+)\s*::|\s*::)?\s*(?P<name>\w+)(?P<rest>.*)")


def test_fortran_uses_lower_layers() -> None:
    home = {module.stem: module.parent.name for module in F90}
    wrong = []
    for path in F90:
        room = path.parent.name
        for line in fortran_code(path):
            use = USE.match(line)
            if use is None:
                continue
            if not re.match(r"\s*,\s*only\s*:", use["rest"]):
                wrong.append(f"{name_of(path)}: without only: {line.strip()}")
            if use["nature"] == "intrinsic" or use["name"].startswith(("iso_", "ieee_", "omp_")):
                continue
            if use["name"] not in home:
                wrong.append(f"{name_of(path)}: no file of this name: {line.strip()}")
                continue
            used = home[use["name"]]
            if not may_use(room, used, FORTRAN_LAYERS):
                wrong.append(f"{name_of(path)}: {room} uses {used}: {line.strip()}")
            if (room, used) == ("api", "h5"):
                wrong.append(f"{name_of(path)}: the extension links no HDF5")
    assert not wrong, "\n".join(wrong)


def test_fortran_house_rules() -> None:
    wrong = []
    for path in F90:
        code = "\n".join(fortran_code(path))
        room = path.parent.name
        modules = re.findall(r"^module\s+(?!procedure\b)(\w+)", code, re.MULTILINE)
        if modules not in ([], [path.stem]):
            wrong.append(f"{name_of(path)}: one module, named as its file")
        if modules and not re.search(r"^\s*private\s*$", code, re.MULTILINE):
            wrong.append(f"{name_of(path)}: private is missing")
        if (modules or room == "app") and "implicit none" not in code:
            wrong.append(f"{name_of(path)}: implicit none is missing")
        prints = r"^\s*(print\b|(error\s+)?stop\b|write\s*\(\s*\*)"
        if room != "app" and re.search(prints, code, re.MULTILINE):
            wrong.append(f"{name_of(path)}: prints or stops")
        # gfortran keeps the length of such a result in a static variable of the caller, which
        # threads share: give it a length, or take a subroutine
        wrong += [
            f"{name_of(path)}: {name} returns a text of deferred length"
            for name, result, body in functions(code)
            if re.search(rf"character\s*\(\s*(len\s*=\s*)?:.*::.*\b{result}\b", body)
        ]
        wrong += [
            f"{name_of(path)}: {line.strip()}: a text of deferred length"
            for line in re.findall(r"(?m)^[^!\n]*character\s*\([^)]*:\s*\)\s*function.*$", code)
        ]
        text = path.read_text(encoding="utf-8").splitlines()
        wrong += [
            f"{name_of(path)}:{number}: longer than 100 columns"
            for number, line in enumerate(text, 1)
            if len(line) > 100
        ]
    assert not wrong, "\n".join(wrong)


@pytest.mark.slow
def test_python_imports_lower_layers() -> None:
    wrong = []
    for path in PYTHON:
        room = path.relative_to(PACKAGE).with_suffix("").parts[0]
        for module in imported_modules(path):
            used = module.split(".")[0]
            if used == "_core":
                if room != "core":
                    wrong.append(f"{name_of(path)}: {room} imports the extension; only core does")
            elif used not in {"_version", "__version__"}:
                if not may_use(room, used, PYTHON_LAYERS):
                    wrong.append(f"{name_of(path)}: {room} imports {module}")
                if room in WITHOUT_CORE and used == "core":
                    wrong.append(f"{name_of(path)}: {room} works without the core")
    assert not wrong, "\n".join(wrong)
