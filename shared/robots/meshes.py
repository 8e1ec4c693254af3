"""The mesh files of a URDF, found as Pinocchio finds them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

from shared.robots.urdf import read_xml


def mesh_files(
    urdf: Path, packages: Sequence[Path], *, kind: str, what: str
) -> Iterator[tuple[str, str, Path | None]]:
    """Yield the link, the name and the path of each mesh, with None for a file that is missing.

    `kind` is `visual` or `collision`. Raise `ConfigError`, which begins with `what`, if the URDF
    cannot be read.
    """
    for link in read_xml(urdf, what=what).iterfind("link"):
        for mesh in link.iterfind(f"{kind}/geometry/mesh"):
            name = mesh.get("filename", "")
            scheme, _, inside = name.rpartition("://")
            folders = [Path("/")] if scheme == "file" else packages
            paths = (folder / inside for folder in folders)
            yield link.get("name", ""), name, next(filter(Path.is_file, paths), None)
