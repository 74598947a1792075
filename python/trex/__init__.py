"""Triangle meshes far larger than memory: exact rays and pictures, under a memory limit.

>>> import trex
>>> trex.build("plant.ply", "plant.trex")
>>> with trex.open("plant.trex", memory_limit="256MiB") as model:
...     hits = model.intersect(origins, directions)
...     picture = model.render(resolution=(640, 480))
"""

from ._files import build, info, verify
from ._live import Frame, Live
from ._model import AllHits, Hits, Model, Triangles, open
from ._network import network
from ._viewer import Viewer, view
from .errors import TrexError

__all__ = [
    "AllHits",
    "Frame",
    "Hits",
    "Live",
    "Model",
    "TrexError",
    "Triangles",
    "Viewer",
    "build",
    "info",
    "network",
    "open",
    "verify",
    "view",
]
