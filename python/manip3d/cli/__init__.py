"""The command ``manip3d``: each verb parses its arguments, calls a public function and prints."""

from __future__ import annotations

from manip3d.cli._app import app, main

__all__ = ["app", "main"]
