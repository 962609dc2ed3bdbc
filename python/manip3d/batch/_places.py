"""A folder, here or behind a URL: the names in it, whole files read and written."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path

from manip3d._util.paths import path_of
from manip3d.io._files import atomic_write
from manip3d.io._remote import filesystem, is_url, local_output, naming_remote


class Place:
    """A folder by its path or URL; absent ones are made by the first `write`."""

    def __init__(self, folder: str) -> None:
        self.folder = folder.rstrip("/") if is_url(folder) else str(path_of(folder, "folder"))

    def __str__(self) -> str:
        return self.folder

    def of(self, relative: str) -> str:
        """Return the path or URL of a file in it."""
        return f"{self.folder}/{relative}"

    def sizes(self) -> dict[str, int]:
        """Return the size of each file below it, by its relative name; hidden ones are included."""
        if not is_url(self.folder):
            root = Path(self.folder)
            found_here: dict[str, int] = {}
            for path in root.rglob("*"):
                with suppress(FileNotFoundError):  # removed by somebody else meanwhile
                    if path.is_file():
                        found_here[str(path.relative_to(root))] = path.stat().st_size
            return found_here
        system, root_name = filesystem(self.folder)
        with naming_remote(self.folder):
            found = system.find(root_name, detail=True)
        start = len(root_name.rstrip("/")) + 1
        return {str(name)[start:]: int(info["size"] or 0) for name, info in found.items()}

    def names(self) -> list[str]:
        """Return the names of all files below it."""
        return list(self.sizes())

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        if not is_url(self.folder):
            return (Path(self.folder) / name).read_bytes()
        system, root = filesystem(self.folder)
        with naming_remote(self.of(name)):
            content: bytes = system.cat_file(f"{root}/{name}")
            return content

    def write(self, name: str, content: str | bytes) -> None:
        """Write a file, whole or not at all."""
        with local_output(self.of(name)) as path:
            path.parent.mkdir(parents=True, exist_ok=True)
            atomic_write(path, content)

    def remove(self, names: list[str]) -> None:
        """Remove files."""
        if not names:
            return
        if not is_url(self.folder):
            for name in names:
                (Path(self.folder) / name).unlink(missing_ok=True)
            return
        system, root = filesystem(self.folder)
        with naming_remote(self.folder):
            system.rm([f"{root}/{name}" for name in names])
