"""How page files at addresses of the web are read: certificates, object stores, what is kept on disk."""

from __future__ import annotations

import os
from typing import Any

from . import _trex
from ._arguments import Path, bytes_of

_settings: dict[str, Any] = {"ca_file": None, "s3_endpoint": None, "cache_dir": None, "cache_limit": 10 << 30}


def network(
    *,
    ca_file: Path | None = None,
    s3_endpoint: str | None = None,
    cache_dir: Path | None = None,
    cache_limit: int | str = "10GiB",
) -> None:
    """Says how ``http(s)://`` and ``s3://`` addresses are read that are opened from now on, in this process.

    ``ca_file``: a PEM file of the certificates that vouch for servers, in place of Mozilla's list. ``s3_endpoint``:
    where ``s3://`` is, unless it is AWS or what ``AWS_ENDPOINT_URL`` says; credentials are those of the environment.
    ``cache_dir``: a folder that keeps what is read, up to ``cache_limit`` of disk; nothing is kept without.
    """
    _settings["ca_file"] = None if ca_file is None else os.fspath(ca_file)
    _settings["s3_endpoint"] = s3_endpoint
    _settings["cache_dir"] = None if cache_dir is None else os.fspath(cache_dir)
    _settings["cache_limit"] = bytes_of(cache_limit, "cache_limit")
    apply()


def apply(*, is_cached: bool = True) -> None:
    """Tells the compiled part, which takes credentials from the environment as it is now."""
    _trex.set_network(**(_settings if is_cached else {**_settings, "cache_dir": None}))
