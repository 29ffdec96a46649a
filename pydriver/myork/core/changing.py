"""A scene at other values of its keys: changed while open where that is possible."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from myork.core.scene import Scene
from myork.errors import InputError
from myork.tables import override_text


def scene_at(
    scene: Scene,
    known: Mapping[str, Any],
    wanted: Mapping[str, Any],
    open_scene: Callable[[Sequence[str]], Scene],
) -> Scene:
    """The scene with other values; another one in its place where fibers or points change.

    - `scene`: scene that may be changed; it is closed where another one takes its place
    - `known`, `wanted`: values by key that it has, and that it is to have
    - `open_scene`: opens the scene with overrides
    - raises InputError: a wrong value
    """
    changes = {key: value for key, value in wanted.items() if known.get(key) != value}
    try:
        if changes:
            scene.update(changes)
    except InputError:
        # where the value is wrong, the other scene says so
        other = open_scene([override_text(key, value) for key, value in wanted.items()])
        scene.close()
        return other
    return scene
