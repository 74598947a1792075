"""Scenes as arguments say them, in the keys of scene files."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from .errors import UsageError


class Parts(NamedTuple):
    """What is shown of a model."""

    #: A point and a normal, six numbers, for each plane that cuts away what lies behind it.
    sections: Any = None
    #: Names of materials, or one name.
    hide: Iterable[str] | str | None = None
    only: Iterable[str] | str | None = None

    def keys(self) -> dict[str, Any]:
        """The keys of ``[parts]`` of scene files.

        Raises ``TypeError`` for what is no list.
        """

        def names(given: Iterable[str] | str | None) -> list[str] | None:
            return None if given is None else [given] if isinstance(given, str) else list(given)

        sections = None if self.sections is None else [list(section) for section in self.sections]
        return {"section": sections, "hide": names(self.hide), "only": names(self.only)}


def scene_text(
    camera: Mapping[str, Any] | None,
    lights: Iterable[Mapping[str, Any]] | None,
    materials: Mapping[str, Mapping[str, Any]] | None,
    parts: Parts,
    render: Mapping[str, Any],
) -> str:
    """A scene as JSON text, without the keys of which nothing is said."""

    def said(keys: Mapping[str, Any] | None) -> dict[str, Any]:
        return {name: value for name, value in dict(keys or {}).items() if value is not None}

    def plain(value: Any) -> Any:
        if isinstance(value, (np.ndarray, np.generic)):
            return value.tolist()
        raise TypeError(f"{value!r} is neither number, text nor list")

    try:
        scene = {
            "model": "",
            "camera": said(camera),
            "light": [said(light) for light in lights or ()],
            "material": {name: said(edit) for name, edit in dict(materials or {}).items()},
            "parts": said(parts.keys()),
            "render": said(render),
        }
        return json.dumps(scene, default=plain, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise UsageError(
            "this is no scene", "the arguments of the picture", str(error), "give finite numbers, texts and lists"
        ) from None
