"""A scene at other values of its keys: changed while open where that is possible."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from myork.core.scene import Scene
from myork.errors import InputError
from myork.tables import override_text


class ChangingScene:
    """A scene that takes values of keys; another one in its place where fibers or points change.

    - `open_scene`: opens the scene with overrides
    - `first`: values by key that it opens with
    """

    def __init__(
        self, open_scene: Callable[[Sequence[str]], Scene], first: Mapping[str, Any] | None = None
    ) -> None:
        self._open, self._has = open_scene, dict(first or {})
        self.scene = open_scene([override_text(*pair) for pair in self._has.items()])

    def at(self, wanted: Mapping[str, Any]) -> Scene:
        """The scene at values by key, all that are to differ from the deck.

        - raises InputError: a wrong value
        """
        changes = {key: value for key, value in wanted.items() if self._has.get(key) != value}
        try:
            if changes:
                self.scene.update(changes)
        except InputError:
            # where the value is wrong, the other scene says so
            other = self._open([override_text(key, value) for key, value in wanted.items()])
            self.scene.close()
            self.scene = other
        self._has = dict(wanted)
        return self.scene
