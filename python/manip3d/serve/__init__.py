"""A web server for this machine or, encrypted, its network: one page, one stream of frames, strict
about who asks."""

from __future__ import annotations

from manip3d.serve._bundles import bundled_pages
from manip3d.serve._certificate import Certificate, kept_certificate, make_certificate
from manip3d.serve._frames import encode_frame
from manip3d.serve._messages import Kind, read_message
from manip3d.serve._server import Limits, LocalServer, Page, StreamClient

__all__ = [
    "Certificate",
    "Kind",
    "Limits",
    "LocalServer",
    "Page",
    "StreamClient",
    "bundled_pages",
    "encode_frame",
    "kept_certificate",
    "make_certificate",
    "read_message",
]
