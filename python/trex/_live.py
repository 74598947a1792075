"""A picture that is made in frames while it changes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np

from ._scene import Parts, scene_text

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from . import _trex


class Frame(NamedTuple):
    """What is on show after a frame."""

    #: Float32 (H, W, 3), linear.
    picture: NDArray[np.float32]
    #: How far it is since the last change: a preview of some pixels; part of a block of exact tiles; a block; a sample
    #: in every pixel (``"complete"``); all that was asked for.
    progress: Literal["preview", "part", "block", "complete", "done"]


class Live:
    """A picture in frames, of :meth:`Model.live`. It keeps what it needs of its model; use ``with`` or :meth:`close`.

    >>> with model.live(resolution=(640, 480)) as live:
    ...     for frame in live.frames(spp=4):
    ...         show(frame.picture)
    """

    def __init__(self, native: _trex.NativeLive) -> None:
        self._native = native
        self.resolution: tuple[int, int] = tuple(native.resolution)

    def frame(self, spp: int = 16) -> Frame:
        """Makes one frame, towards ``spp`` samples a pixel: it takes about the time that frames may take."""
        width, height = self.resolution
        picture = np.empty((height, width, 3), np.float32)
        return Frame(picture, self._native.frame(spp, picture))

    def frames(self, spp: int = 16) -> Iterator[Frame]:
        """Frames until the picture is done, which is the last."""
        while True:
            frame = self.frame(spp)
            yield frame
            if frame.progress == "done":
                return

    def apply(
        self,
        *,
        camera: Mapping[str, Any] | None = None,
        lights: Iterable[Mapping[str, Any]] | None = None,
        materials: Mapping[str, Mapping[str, Any]] | None = None,
        sections: Iterable[Iterable[float]] | None = None,
        hide: Iterable[str] | str | None = None,
        only: Iterable[str] | str | None = None,
    ) -> None:
        """Changes what is given, in the keys of scene files: the next frames show it. ``lights`` are all of them.

        Any of ``sections``, ``hide`` and ``only`` says what is shown from then on, with the others as they are given
        here: ``sections=[]`` shows the whole model.
        """
        parts = Parts(sections, hide, only)
        given = (("camera", camera), ("light", lights), ("parts", next((x for x in parts if x is not None), None)))
        named = [name for name, value in given if value is not None]
        self._native.apply(scene_text(camera, lights, materials, parts, {}), named)

    def close(self) -> None:
        """Gives its memory back."""
        self._native.close()

    def __enter__(self) -> Live:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
