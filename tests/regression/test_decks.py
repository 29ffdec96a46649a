"""Decks of inputs/ against stored answers.

A reference holds value, tolerance and origin of each number. Values of other programs and closed
forms stay as they are; `--update-reference` rewrites those whose origin is this program, and the
test that did so fails, so that nobody updates without seeing it.
"""

import json
from pathlib import Path

import pytest

from myork.core.scene import Scene

REFERENCES = Path(__file__).parent / "references"
OWN = "this program"
DECKS = sorted(path.stem for path in REFERENCES.glob("*.json"))


def answers(path, overrides):
    """Last value of every probe by name and component, and the iterations of all steps."""
    with Scene(path, overrides, threads=1) as scene:
        states = scene.solve()
        values = scene.probes(states.x, states.load)[-1]
        found = {"iterations": float(states.iterations.sum())}
        for probe, value in zip(scene.deck["probe"], values, strict=True):
            if probe["quantity"] in ("u", "force"):
                found |= {f"{probe['name']}.{c}": v for c, v in zip("xyz", value, strict=True)}
            else:
                found[probe["name"]] = value[0]
    return {name: float(value) for name, value in found.items()}


def test_there_are_references():
    assert len(DECKS) >= 5


@pytest.mark.slow
@pytest.mark.parametrize("deck", DECKS)
def test_deck(deck, inputs, pytestconfig):
    file = REFERENCES / f"{deck}.json"
    reference = json.loads(file.read_text(encoding="utf-8"))
    found = answers(inputs / f"{deck}.toml", reference["overrides"])
    wrong = {
        name: (found[name], entry)
        for name, entry in reference["values"].items()
        if not abs(found[name] - entry["value"]) <= entry["tolerance"]
    }
    own = [name for name in wrong if reference["values"][name]["origin"].startswith(OWN)]
    if own and pytestconfig.getoption("--update-reference"):
        for name in own:
            reference["values"][name]["value"] = found[name]
        file.write_text(json.dumps(reference, indent=2) + "\n", encoding="utf-8")
        pytest.fail(f"{file.name}: {own} rewritten; look at the difference, then run again")
    assert not wrong
