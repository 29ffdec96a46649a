"""Ten changes of an open scene against ten fresh scenes: times of both, and equal states.

Run: python tests/bench/open_scene.py
"""

import time

import numpy as np

from myork import Scene

TABLES = {
    "scene": {"dimension": 3},
    "geometry": {
        "kind": "box",
        "size": [1, 1, 2],
        "source": [9, 9, 17],
        "collocation": [9, 9, 17],
    },
    "material": [{"name": "muscle", "model": "muscle", "A10": 10, "K": 1000, "fiber_angle": 30}],
    "boundary": [
        {"set": "z0", "u_x": 0, "u_y": 0, "u_z": 0},
        {"set": "z1", "u_x": 0, "u_y": 0, "u_z": 0},
    ],
    "load": {"activation": 0.1},
}


def main() -> None:
    """Print the seconds of opening or changing, and of solving."""
    changes = [
        {"load.activation": 0.02 * k, "material.muscle.K": 900.0 + 20 * k} for k in range(1, 11)
    ]
    clock = time.perf_counter
    seconds = np.zeros((2, 2))
    with Scene.from_tables(TABLES, threads=1) as scene:
        for change in changes:
            begun = clock()
            scene.update(change)
            ready = clock()
            found = scene.solve(error=False)
            seconds[0] += ready - begun, clock() - ready
            begun = clock()
            overrides = [f"{key}={value}" for key, value in change.items()]
            with Scene.from_tables(TABLES, overrides=overrides, threads=1) as fresh:
                ready = clock()
                expected = fresh.solve(error=False)
                seconds[1] += ready - begun, clock() - ready
            assert np.array_equal(found.x, expected.x)
    print(f"{scene.dofs} unknowns, ten changes, states equal to the last bit")
    for name, (make, solve) in zip(("changed", "opened anew"), seconds, strict=True):
        print(f"{name:12s} {make:7.2f} s, solved {solve:7.2f} s")


if __name__ == "__main__":
    main()
