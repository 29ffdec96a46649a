"""Decks: their values, error messages about wrong ones, and tests generated from the schema.

All checks are those of the compiled reader; tomllib and hashlib are independent references.
"""

import hashlib
import itertools
import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from runpy import run_path
from types import SimpleNamespace
from typing import Any

import pytest

from myork.core import deck as core_deck
from myork.core.deck import deck_key, load_deck
from myork.errors import FileError, InputError
from myork.tables import deck_text
from tests.scenes import box, probes, refuses, tomllib

ROOT = Path(__file__).parents[2]
DECKS = sorted((ROOT / "inputs").rglob("*.toml"))

#: A deck that uses most tables. The tests below change one line of it; lines count from 1.
BLOCK = deck_text({
    "title": "block", "units": {"force": "N", "length": "cm"}, "scene": {"dimension": 3},
    "geometry": box(5, 5, 9, size=[1, 1, 2]),
    "material": [
        {"name": "muscle", "label": 1, "model": "muscle", "A10": 6.43, "K": 5000,
         "fiber": [0, 0, 1]},
        {"name": "fat", "label": 2, "model": "polynomial", "K": 4000},
    ],
    "boundary": [{"set": "z0", "u_x": 0}, {"set": "z1", "traction": [0, 0, 2.5]}],
    "load": {"steps": 4, "activation": 0.5},
    "solver": {"linear": "auto", "weight_essential": "c4"},
    "probe": probes("mid cauchy_zz 0.5 0.5 1", "pull force z0"),
    "exact": [{"probe": "mid", "solution": "uniaxial", "amount": 1.5}],
    "reference": [
        {"probe": "mid", "activation": [0.125, 0.5], "value": [1, 2], "source": "nobody"}
    ],
})  # fmt: skip

Write = Callable[[str | bytes], Path]


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Write:
    """Write a deck and change to its folder, so that messages start with the short name."""
    monkeypatch.chdir(tmp_path)

    def write_deck(text: str | bytes) -> Path:
        path = Path("case.toml")
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return path

    return write_deck


def complaints(path: Path, *overrides: str) -> list[str]:
    return refuses(".", load_deck, path, overrides).splitlines()


@pytest.mark.parametrize("path", DECKS, ids=lambda path: path.stem)
def test_deck_in_inputs(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As a file, as its tables and as the text of these: compared with tomllib."""
    monkeypatch.chdir(path.parent)
    written = tomllib.loads(path.read_text(encoding="utf-8"))
    deck = load_deck(path, command="solve" if "geometry" in written else "")
    for table, content in written.items():
        ours, theirs = (x if isinstance(x, list) else [x] for x in (content, deck[table]))
        for one, other in zip(ours, theirs, strict=True):
            for key, value in one.items() if isinstance(one, dict) else ():
                # one value stands for an array of them, one number for all directions
                assert other[key] in (value, [value]) or {*other[key]} == {value}, (table, key)
    assert deck["title"] == written["title"]
    # files from which a scene is made are part of it
    alone = "labels" not in written.get("geometry", {})
    assert (deck["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()) == alone
    assert deck["folder"] == str(path.parent)
    assert tomllib.loads(deck_text(written)) == written
    own = load_deck(written, command="solve" if "geometry" in written else "")
    for key in ("path", "folder", "sha256"):
        del own[key], deck[key]
    assert own == deck


def test_defaults_and_absent_keys(write: Write) -> None:
    deck = load_deck(write(BLOCK))
    muscle, fat = deck["material"]
    assert muscle["sigma_max"] == 30.0 and muscle["curve"] == "smooth"
    assert "sigma_max" not in fat and "fiber" not in fat, "a key of another model"
    assert deck["image"]["channels"] == [] and "anatomy" not in deck["image"]
    assert deck["boundary"][0] == {"set": "z0", "u_x": 0.0} and deck["folder"] == "."
    path = write('title = "x"\nunits = {force = "N", length = "cm"}\n')
    without = load_deck(path)
    assert without["probe"] == [] and "geometry" not in without
    # tables that a command needs
    tables = ("scene", "geometry", "material", "boundary")
    said = "\n".join(f"case.toml:1: {name}: missing, solve needs this table" for name in tables)
    refuses(f"^{said}$", load_deck, path, command="solve")


@pytest.mark.parametrize("text", [b"\xef\xbb\xbf" + BLOCK.encode(), BLOCK.replace("\n", "\r\n")])
def test_byte_order_mark_and_windows_lines(write: Write, text: str | bytes) -> None:
    assert load_deck(write(text))["load"]["steps"] == 4


@pytest.mark.parametrize(("name", "title"), [
    ("pulled strip.v2.toml", "pulled strip.v2"),
    ("Müller's", "Müller's"),
    (".toml", ".toml"),
    # names that no text of a deck can have
    (" .toml", "scene"),
    ("a\udce9.toml", "scene"),
    ("'''.toml", "scene"),
])  # fmt: skip
def test_a_deck_without_title_has_its_name(tmp_path: Path, name: str, title: str) -> None:
    path = tmp_path / name
    path.write_text(BLOCK.replace('title = "block"\n', ""))
    assert load_deck(path)["title"] == title
    assert load_deck(path, ["title=other"])["title"] == "other"
    path.write_text(BLOCK.replace('"block"', '""'))
    refuses("title: must not be empty", load_deck, path)


def test_texts_and_numbers_survive(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    title = 'Müller "2" \\ tab\t, newline\n, 筋肉'
    path = write(BLOCK.replace('"block"', json.dumps(title)))
    for number in (0.1, 1 / 3, 1e15, 9.999999999999999e15, 1e16, 123456789012345680.0, 1.2e-5,
                   4.5e-7, 1.7e308, 2.2250738585072014e-308, 0.30000000000000004):  # fmt: skip
        deck = load_deck(path, [f"boundary.z0.u_x=-{number!r}"])
        assert deck["title"] == title and deck["boundary"][0]["u_x"] == -number
    # long answers are complete
    whole = load_deck(path)
    monkeypatch.setattr(core_deck, "_CAPACITY", 10)
    assert load_deck(path) == whole


@pytest.mark.parametrize(("override", "place", "value"), [
    (" load.steps = 7 ", ("load", "steps"), 7),
    ("title=two words", ("title",), "two words"),
    ("title=2024", ("title",), "2024"),
    ('title="quoted"', ("title",), "quoted"),
    ("title=a=b", ("title",), "a=b"),
    ("solver.weight_essential=1e3", ("solver", "weight_essential"), 1000.0),
    ("solver.weight_essential=ns-c4", ("solver", "weight_essential"), "ns-c4"),
    ("geometry.source=[5,5,7]", ("geometry", "source"), [5, 5, 7]),
    ("approximation.support=4", ("approximation", "support"), [4.0, 4.0, 4.0]),
    ("material.2.K=1", ("material", 1, "K"), 1.0),
    ("probe.mid.point=[0,0,0]", ("probe", 0, "point"), [0.0, 0.0, 0.0]),
    ("probe.mid.point=[-.5,1.0,.25]", ("probe", 0, "point"), [-0.5, 1.0, 0.25]),
    ("rom.modes=[3]", ("rom", "modes"), [3]),
    ("material.fat.K=inf", ("material", 1, "K"), float("inf")),
])  # fmt: skip
def test_override(write: Write, override: str, place: tuple[Any, ...], value: object) -> None:
    item: Any = load_deck(write(BLOCK), [override])
    for step in place:
        item = item[step]
    assert item == value


@pytest.mark.parametrize(("key", "full"), [
    ("title", "title"),
    ("material.K", "material.muscle.K"),
    (" material.2.K ", "material.fat.K"),
    ("probe.point", "probe.mid.point"),
    # tables and keys that the deck does not yet have
    ("galerkin.gauss", "galerkin.gauss"),
    ("material.fat.activation", "material.fat.activation"),
])  # fmt: skip
def test_full_name_of_a_key(write: Write, key: str, full: str) -> None:
    # other faults of the deck are reported elsewhere
    assert deck_key(write(BLOCK.replace("steps = 4", "steps = -4")), key) == full
    assert deck_key("text", key, ["load.steps=2"], BLOCK) == full
    with pytest.raises(InputError, match="case.toml: laod: unknown table; did you mean 'load'"):
        deck_key(Path("case.toml"), "laod.steps")


def test_overrides_come_after_the_deck_in_order_and_are_hashed(write: Write) -> None:
    path = write(BLOCK.replace("steps = 4", "steps = -4"))
    assert load_deck(path, ["load.steps=2", "load.steps=3"])["load"]["steps"] == 3
    deck = load_deck(write(BLOCK), ["load.steps=2", "material.K=3"])
    hashed = BLOCK + "\n--set load.steps=2\n--set material.K=3"
    assert deck["sha256"] == hashlib.sha256(hashed.encode()).hexdigest()
    refuses("a single line", load_deck, path, ["title=a\nload.steps=3"])


@pytest.mark.parametrize(("override", "message"), [
    ("load.stepz=3", "load.stepz: unknown key; did you mean 'steps'?"),
    ("load.steps=0", "load.steps: must be at least 1 and at most 1000000, not 0"),
    ("load.steps=x", "load.steps: must be an integer, not the text 'x'"),
    ("material.fatt.K=3", "material.fatt.K: no [[material]] is named 'fatt'; did you mean"),
    ("exact.4.amount=3", "exact.4.amount: no [[exact]] is named '4'"),
    ("load.first.steps=3", "load.first.steps: [load] is a single table: write load.key=value"),
    ("geometry.source=[5,5", "geometry.source: must be an array of integers, not the text"),
    ("scene=3", "scene: is a table; write scene.key=value"),
    ("nothing", "nothing: write table.key=value"),
    ("=3", "key: write table.key=value"),
    ("material.fat.K=inf; scene.method=rkcm",
     "material.fat.K: inf is only for scene.method = rkcm-mixed or rkpm-scni or rkpm-gauss; here "
     "scene.method = rkcm: it needs the pressure as an unknown"),
])  # fmt: skip
def test_wrong_override(write: Write, override: str, message: str) -> None:
    """One error, of the first override if several are wrong."""
    first, *others = override.split("; ")
    (line,) = complaints(write(BLOCK), first, *others)
    assert line.startswith(f"--set {first}: {message}")


#: Replacements of lines of BLOCK, and the messages
WRONG = [
    # unknown keys and tables
    ("steps = 4", "stepz = 4", "load.stepz: unknown key; did you mean 'steps'?"),
    ("steps = 4", "order = 4", "load.order: unknown key; 'order' belongs to [approximation]"),
    ("K = 4000", "K = 1\nk_bulk = 1", "material.fat.k_bulk: unknown key; known keys are: name,"),
    ("[load]", "[loads]", "loads: unknown table; did you mean 'load'?"),
    ('title = "block"', 'title = "b"\nK = 1', "K: unknown key; 'K' belongs to [[material]]"),
    # texts and numbers that no type allows
    ('name = "fat"', 'name = " "', "material.2.name: must not be empty"),
    ("K = 5000", "K = nan", "material.muscle.K: must be a positive number or inf, not nan"),
    ("label = 2", "label = 3000000000", "material.fat.label: must be below 2147483648 in size"),
    # values whose validity depends on other keys
    ('set = "z1"', 'set = "z0"', "boundary.z0.set: the text 'z0' is already used by case.t"),
    ("label = 2", "label = 1", "material.fat.label: 1 is already used by case.toml:14"),
    ("u_x = 0", "u_x = 0\npull = 1", "boundary.z0.pull: needs tendon as well"),
    # missing entries
    ('[units]\nforce = "N"\nlength = "cm"', "", "units: missing: the table [units] is needed"),
    ("u_x = 0", "", "boundary.z0: needs one of the keys u_x, u_y, u_z, rad"),
    ('quantity = "force"\nset = "z0"', 'quantity = "force"', "probe.pull.set: missing: a text is "),
    ("activation = [0.125, 0.5]", "", "reference: needs one of the keys l"),
]


@pytest.mark.parametrize(("old", "new", "message"), WRONG)
def test_wrong_line(write: Write, old: str, new: str, message: str) -> None:
    """One error, at the wrong line or at the table that lacks one."""
    assert BLOCK.count(f"{old}\n") == 1
    text = BLOCK.replace(f"{old}\n", f"{new}\n" if new else "")
    lines = complaints(write(text))
    assert len(lines) == 1, lines
    before = BLOCK[: BLOCK.index(f"{old}\n")].splitlines()
    line = len(before) + 1 + new.count("\n")
    if old.startswith(new):
        headers = [number for number, own in enumerate(before, 1) if own.startswith("[")]
        line = headers[-1] if headers else 1
    assert lines[0].startswith(f"case.toml:{line}: {message}")


@pytest.mark.parametrize(("changes", "message"), [
    ({'[[exact]]\nprobe = "mid"': '[[exact]]\nprobe = "pull"'},
     "exact.probe: 'pull' is of force, which a homogeneous solution does not give"),
    ({'[[reference]]\nprobe = "mid"': '[[reference]]\nprobe = "pull"'},
     "reference.probe: 'pull' is of force, three numbers; choose a component"),
    ({'name = "mid"': "name = 3", '[[exact]]\nprobe = "mid"': "[[exact]]\nprobe = 4"},
     "exact.probe: must be a text, not 4"),
    ({'force = "N"\n': 'force = "N"\n[build]\nfile = "x"\n[dummy]\n'}, "dummy: unknown table"),
])  # fmt: skip
def test_keys_that_do_not_fit(write: Write, changes: dict[str, str], message: str) -> None:
    text = BLOCK
    for old, new in changes.items():
        assert text.count(old) == 1
        text = text.replace(old, new)
    assert any(message in line for line in complaints(write(text)))


def test_all_complaints_by_line(write: Write) -> None:
    text = BLOCK.replace("steps = 4", "steps = 0").replace("dimension = 3", "dimension = 5")
    text = text.replace("K = 5000", "K = -1").replace("[solver]", "[solvers]") + "zzz = 1\n"
    places = [line.split(": ")[0] for line in complaints(write(text), "load.max_halvings=-1")]
    lines = ("dimension = 3", "K = 5000", "steps = 4", "[solver]")
    numbers = [BLOCK.splitlines().index(line) + 1 for line in lines] + [BLOCK.count("\n") + 1]
    assert places == [*(f"case.toml:{k}" for k in numbers), "--set load.max_halvings=-1"]


def test_many_complaints_are_not_cut_off(write: Write) -> None:
    """Beyond the 2048 characters of a message of the core."""
    for count, most, end in (
        (100, 100, ": reference.key_99: unknown key"),
        (1000, 101, "case.toml: and 900 more"),
    ):
        lines = complaints(write(BLOCK + "".join(f"key_{i} = 1\n" for i in range(count))))
        assert len(lines) == most and end in lines[-1]
    # a wrong name is compared with existing ones, some of which are listed
    probes = "".join(f'[[probe]]\nname = "p{i}"\nquantity = "energy"\n' for i in range(200))
    wrong = BLOCK.replace('[[exact]]\nprobe = "mid"', '[[exact]]\nprobe = "nowhere"')
    (line,) = complaints(write(wrong + probes))
    assert "there are: mid, pull, p0, " in line and line.endswith("p97 and 102 more")


#: An entry that a deck may contain any number of times, by its table
ENTRY = {
    "boundary": 'set = "s{}"\nu_x = 0\n',
    "amplitude": 'name = "t{}"\ntime = [0]\nvalue = [1]\n',
    "probe": 'name = "p{}"\nquantity = "energy"\n',
    "reference": 'probe = "mid"\nload = [1]\nvalue = [2]\nsource = "{}"\n',
}


@pytest.mark.parametrize("table", ENTRY)
def test_counts_have_limits(write: Write, table: str) -> None:
    """The allowed number of entries is read in time proportional to it; more are refused."""
    most = 10_000 if table in ("probe", "reference") else 1000
    there = BLOCK.count(f"[[{table}]]")

    def deck_of(count: int) -> Path:
        more = (f"[[{table}]]\n" + ENTRY[table].format(i) for i in range(there, count))
        return write(BLOCK + "".join(more))

    found = load_deck(deck_of(most))[table]
    last = tomllib.loads(ENTRY[table].format(most - 1))
    assert len(found) == most and all(found[-1][key] == value for key, value in last.items())
    address = f"{table}.{last.get('name', last.get('set', most))}"
    with deck_of(most).open("a") as file:
        file.write("no = 1\n")
    assert f": {address}.no: unknown key" in complaints(Path("case.toml"))[0]
    lines = complaints(deck_of(most + 1))
    assert f": {table}: has {most + 1} entries, but at most {most} are allowed" in lines[0]


@pytest.mark.slow
def test_arrays_have_limits(write: Write) -> None:
    def deck_of(count: int) -> Path:
        numbers = ", ".join(str(k / count) for k in range(count))
        more = f'[[amplitude]]\nname = "push"\ntime = [{numbers}]\nvalue = [{numbers}]\n'
        return write(BLOCK + more)

    assert load_deck(deck_of(100_000))["amplitude"][0]["value"][-1] == 0.99999
    for line, key in zip(complaints(deck_of(100_001)), ("time", "value"), strict=True):
        assert line.endswith(f"amplitude.push.{key}: must have at most 100000 items, not 100001")


@pytest.mark.parametrize(("text", "message"), [
    (b"", "case.toml:1: the deck is empty"),
    (b'title = "a"\ntitle = "b"\n', "case.toml:2:9: not TOML: "),
    (b"\n\nsteps == 3\n", "case.toml:3:8: not TOML: "),
    (b"[load.\n", "case.toml:1:7: not TOML: "),
    (b'title = "a"\n# caf\xe9 \n', "case.toml:2:"),
    (b"PK\x03\x04\x00\x00", "case.toml:1:3: not TOML: "),
    (b"[[load]]\nsteps = 3\n", "case.toml:1: load: is a single table: write [load] instead of [[l"),
    (b"[material]\n", "case.toml:1: material: is an array of tables: write [[material]] inst"),
    (b"\nload = 3\n", "case.toml:2: load: must be a table [load], not an integer"),
    (b"[load.steps]\nx = 1\n", "case.toml:1: load.steps: must be an integer, not a table"),
    # remedies for typing errors
    (b"a = box\n", "case.toml:1:*a text needs quotes"),
    (b"a = 10,5\n", "case.toml:1:*decimals have a point"),
])  # fmt: skip
def test_wrong_files(write: Write, text: bytes, message: str) -> None:
    start, _, cure = message.partition("*")
    assert any(line.startswith(start) and cure in line for line in complaints(write(text)))


def test_files_that_cannot_be_read(write: Write, tmp_path: Path) -> None:
    write(BLOCK)
    for path, said in (
        ("nowhere/x.toml", "^nowhere/x.toml: the deck cannot be read: No such file"),
        (tmp_path, "is a folder; name the deck inside it"),
    ):
        refuses(said, load_deck, path, kind=FileError)


SCHEMA = ROOT / "fortran" / "deck" / "schema.toml"


@pytest.fixture(scope="module")
def pages() -> SimpleNamespace:
    """docs/reference.py, which reads the schema."""
    return SimpleNamespace(**run_path(str(ROOT / "docs" / "reference.py")))


def test_deck_reference_is_current(pages: SimpleNamespace) -> None:
    written = (ROOT / "docs" / "decks.md").read_text(encoding="utf-8")
    text = pages.reference(pages.read_schema(SCHEMA))
    assert written == text, "run python docs/reference.py"


#: A value in a deck for each kind of value in the schema
_WORDS = {"an expression": "x"}

#: Values of another type
OTHER_TYPE = {"text": True, "integer": "x", "number": True, "boolean": 3, "texts": 3,
              "integers": "x", "numbers": True}  # fmt: skip


def valid(key: dict[str, Any]) -> Any:
    """A value that a key may have on its own."""
    if "choices" in key:
        one = key["choices"][0]
    elif key["type"] in ("text", "texts", "boolean"):
        one = key["type"] == "boolean" or "x"
    else:
        one = next((key[end] for end in ("min", "max") if end in key), key.get("above", 0) + 1)
    length = key.get("length", 1)
    if key["type"][-1] != "s":
        return one
    return [one] * (length if isinstance(length, int) else 3)


def violations(schema: dict[str, Any], name: str) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Keys of a table, decks that violate one of their declarations each, and the message."""
    table = schema[name]
    keys = table["keys"]

    def deck(own: dict[str, Any], but: str = "", **entry: Any) -> dict[str, Any]:
        """A deck with an entry that satisfies all conditions of its table and a key except one."""
        tables = {"scene": {"dimension": 3, "method": "rkpm-gauss"}, name: {}}
        for place, allowed in (table.get("only_if", {}) | own.get("only_if", {})).items():
            there, _, last = place.rpartition(".")
            condition = schema[there or name]["keys"][last]
            value = allowed[0] if allowed else valid(condition)
            if place == but:
                # a set of another name, if the names depend on the body
                others = condition.get("choices", ["elsewhere"])
                others = [c for c in others if c not in [*allowed, "auto"]]
                value = others[0] if allowed and others else None
            # "none": there is no such table
            if value is not None and (place, value) != ("linear.problem", "none"):
                tables.setdefault(there or name, {})[last] = value
        entry = {key: v for key, v in (tables[name] | entry).items() if v is not None}
        if not table.get("many"):
            return tables | {name: entry}
        named = {table["named_by"]: "own"} if table.get("named_by", key) != key else {}
        return tables | {name: [named | entry]}

    for key, own in keys.items():
        right, many = valid(own), own["type"][-1] == "s"
        wrong = [(OTHER_TYPE[own["type"]], "must be")]
        ends = {"min": -1, "max": 1, "above": 0, "below": 0}
        wrong += [(own[end] + beyond, "must be") for end, beyond in ends.items() if end in own]
        if "choices" in own:
            wrong.append((97 if own["type"] == "integer" else "nonsense", "must be"))
        if "refers_to" in own:
            wrong.append(("nobody", r"no \[\[\w+\]\] is named 'nobody'"))
        for value, said in wrong:
            yield key, deck(own, **{key: [value] * len(right) if many else value}), said
        if "length" in own:
            yield key, deck(own, **{key: right * 2}), "must have"
        if "nonzero" in own:
            yield key, deck(own, **{key: [0] * len(right)}), "must not be zero"
        if "ascending" in own:
            yield key, deck(own, **{key: right * 2}), "must increase"
        if own.get("required"):
            yield key, deck(own, **{key: None}), "missing"
        for other in own.get("not_beside", []):
            both = {key: right, other: valid(keys[other])}
            yield (
                f"({key}|{other})",
                deck(own, **both),
                "cannot be combined with|only (for|without)",
            )
        for condition in own.get("only_if", {}):
            yield key, deck(own, condition, **{key: right}), "only (for|without)|needs"
        for restriction in own.get("value_if", []):
            conditions = own.get("only_if", {}) | restriction["when"]
            for value, condition in itertools.product(restriction["is"], restriction["when"]):
                there = deck({"only_if": conditions}, condition, **{key: _WORDS.get(value, value)})
                yield key, there, f"{value} is only (for|without)"


def test_every_declaration_is_enforced(pages: SimpleNamespace) -> None:
    """Types, ranges, choices, lengths and conditions of all keys: each is violated once."""
    schema = pages.read_schema(SCHEMA)
    count, wrong = 0, []
    for name in schema.keys() - {""}:
        for key, tables, said in violations(schema, name):
            count += 1
            try:
                load_deck(tables)
                text = ""
            except InputError as error:
                text = str(error)
            place = rf"^tables: {name}(\.[^.: ]+)?\.{key}"
            if not re.search(f"{place}: .*({said})", text, re.M):
                wrong.append((key, tables, said, text))
    assert count > 400 and not wrong


def test_every_table_has_an_example_with_known_keys(pages: SimpleNamespace) -> None:
    """Either a deck of inputs/ that the tests read, or lines of the schema."""
    for name, table in pages.read_schema(SCHEMA).items():
        if "example" in table:
            (found,) = tomllib.loads(table["example"]).items()
            entry = found[1][0] if table.get("many") else found[1]
            assert found[0] == name and set(entry) <= set(table["keys"]), name
        elif name:
            deck = ROOT / pages.example(name, table).split("`")[1]
            assert name in tomllib.loads(deck.read_text(encoding="utf-8")), name
