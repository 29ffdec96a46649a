"""Decks of inputs/ against stored answers.

A reference holds value, tolerance and origin of each number. Those whose origin is this program are
changed by hand where a change of the method moves them; the failure has the values found.
"""

import json
from pathlib import Path

import pytest

from myork.core.scene import Scene

REFERENCES = Path(__file__).parent / "references"
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


@pytest.mark.slow
@pytest.mark.parametrize("deck", DECKS)
def test_deck(deck, inputs):
    reference = json.loads((REFERENCES / f"{deck}.json").read_text(encoding="utf-8"))
    found = answers(inputs / f"{deck}.toml", reference["overrides"])
    wrong = {
        name: (found[name], entry)
        for name, entry in reference["values"].items()
        if not abs(found[name] - entry["value"]) <= entry["tolerance"]
    }
    assert not wrong
