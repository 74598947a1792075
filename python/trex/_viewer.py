"""The viewer, in a notebook's cell or a browser of its own."""

from __future__ import annotations

import html
import ipaddress
from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from ._arguments import Path
from ._model import Model, open
from ._scene import Parts, scene_text
from .errors import UsageError

if TYPE_CHECKING:
    from . import _trex

#: Whose pages may have the viewer in a frame: notebooks on this machine, and those that a proxy shows as their own.
_EMBEDDERS = ("'self'", "http://localhost:*", "http://127.0.0.1:*")
#: The token in addresses that are printed into notebooks has to stay out of logs: it stands behind the ``#``.
_FRAME = '<iframe src="{src}" width="100%" height="{height}" style="border: 0" allow="clipboard-write"></iframe>'


class Viewer:
    """A model on show, of :func:`view`, until :meth:`close`; in a notebook it is a frame with the viewer in it.

    It ends with the process, or when nothing refers to it any more.
    """

    def __init__(self, native: _trex.NativeViewer, base: str, height: int, owned: Model | None) -> None:
        self._native = native
        self._base = base
        self._height = height
        self._owned = owned

    @property
    def url(self) -> str:
        """Where a browser finds it. Who knows this address sees the model: it ends in the secret token."""
        return f"{self._base}/#token={self._native.token}"

    @property
    def port(self) -> int:
        """The port that it listens on."""
        return self._native.port

    @property
    def closed(self) -> bool:
        """True once it shows nothing more."""
        return self._native.closed

    def close(self) -> None:
        """Ends it within a second, and gives its memory back. Raises what ended it before, if anything did."""
        try:
            self._native.close()
        finally:
            if self._owned is not None:
                self._owned.close()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"<trex.Viewer{', closed' if self.closed else ' at ' + self.url}>"

    def _repr_html_(self) -> str:
        if self.closed:
            return "<p>The viewer is closed.</p>"
        url = html.escape(self.url)
        return _FRAME.format(src=url, height=self._height) + f'<p><a href="{url}" target="_blank">{url}</a></p>'


def view(
    model: Model | Path,
    *,
    camera: Mapping[str, Any] | None = None,
    resolution: tuple[int, int] | None = None,
    lights: Iterable[Mapping[str, Any]] | None = None,
    materials: Mapping[str, Mapping[str, Any]] | None = None,
    sections: Iterable[Iterable[float]] | None = None,
    hide: Iterable[str] | str | None = None,
    only: Iterable[str] | str | None = None,
    memory_limit: int | str = "512MiB",
    height: int = 540,
    bind: str = "127.0.0.1",
    port: int = 0,
    hosts: Iterable[str] = (),
    url_prefix: str | None = None,
    embedders: Iterable[str] = _EMBEDDERS,
    **settings: Any,
) -> Viewer:
    """Shows a model, or a page file, with its light, while the camera, lights and materials are changed in the page.

    >>> trex.view("plant.trex")         # as the last value of a notebook's cell: the viewer, ``height`` pixels high
    >>> print(trex.view(model).url)     # for any browser on this machine

    Further arguments as of :meth:`Model.live`; without a ``resolution`` the picture follows the page. The server works
    in a thread of its own; a model that is given stays open and can be asked meanwhile, within its own limit, and
    ``memory_limit`` is that of a file which is opened here.

    Where the browser is on another machine: ``bind`` an address that it can reach (nothing is encrypted) and name in
    ``hosts`` what the server is called there; or leave it as it is and give ``url_prefix``, the address at which a
    proxy shows the port, ``"/user/me/proxy/{port}"`` or ``"https://hub.example/user/me/proxy/{port}"``, with the host
    that the proxy asks by in ``hosts``. ``embedders`` are the sites whose pages may have the viewer in a frame.
    """
    try:
        address = ipaddress.ip_address(bind)
    except ValueError as error:
        raise UsageError("this is no address to listen on", "bind", str(error), "give one like '127.0.0.1'") from None
    if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port < 1 << 16:
        raise UsageError("this is no port", "port", repr(port), "give a number in 0..=65535, 0 for any that is free")
    names = [hosts] if isinstance(hosts, str) else list(hosts)
    sites = [embedders] if isinstance(embedders, str) else list(embedders)
    place = {"bind": str(address), "port": port, "hosts": names, "embedders": sites}
    parts = Parts(sections, hide, only)
    scene = scene_text(camera, lights, materials, parts, {"resolution": resolution, **settings})
    owned = None if isinstance(model, Model) else open(model, memory_limit)
    try:
        native = (model if owned is None else owned)._native.view(scene, place)
    except BaseException:
        if owned is not None:
            owned.close()
        raise
    if url_prefix is not None:
        base = url_prefix.replace("{port}", str(native.port)).rstrip("/")
    else:
        literal = f"[{address}]" if address.version == 6 else str(address)
        name = literal if not address.is_unspecified else next(iter(names), "localhost")
        base = f"http://{name}:{native.port}"
    return Viewer(native, base, height, owned)
