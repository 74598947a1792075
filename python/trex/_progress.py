"""What hears of progress: a function of the caller, or a bar of tqdm where that is installed."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Union

#: Called with phase, units done, units in all (0 while not known) and what a unit is, some times a second.
Receiver = Callable[[str, int, int, str], Any]
#: ``True`` for a bar of tqdm; without tqdm it shows nothing.
ProgressArgument = Union[Receiver, bool, None]


class _Bars:
    """One bar a phase, one after the other."""

    def __init__(self, tqdm: Any) -> None:
        self._tqdm = tqdm
        self._bar: Any = None

    def __call__(self, phase: str, done: int, total: int, unit: str) -> None:
        if self._bar is None or self._bar.desc != phase:
            self.close()
            self._bar = self._tqdm(desc=phase, unit=f" {unit}", unit_scale=True, leave=False)
        self._bar.total = total or None
        self._bar.n = done
        self._bar.refresh()

    def close(self) -> None:
        if self._bar is not None:
            self._bar.close()
            self._bar = None


@contextmanager
def receiver(progress: ProgressArgument) -> Iterator[Receiver | None]:
    """What the library is to call, for as long as the work goes."""
    if not isinstance(progress, bool):
        yield progress
        return
    try:
        from tqdm.auto import tqdm
    except ImportError:
        tqdm = None
    if not progress or tqdm is None:
        yield None
        return
    bars = _Bars(tqdm)
    try:
        yield bars
    finally:
        bars.close()
