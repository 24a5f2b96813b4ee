"""The commands' own options, apart from the configurations of the packages they drive."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

__all__ = ["Common", "GenerateFiles", "InfoFiles"]


@dataclass(frozen=True)
class Common:
    """What every command understands."""

    quiet: bool = False  # show nothing but errors
    json: Path | None = None  # write machine-readable results to this file
    debug: bool = False  # show the traceback of an error


@dataclass(frozen=True)
class GenerateFiles:
    """Files of ``prtnet generate``."""

    scene: Positional[Path]  # animated scene: .glb, .gltf, or a point cache .npz
    out: Path  # dataset to write, a .zarr folder


@dataclass(frozen=True)
class InfoFiles:
    """Files of ``prtnet info``."""

    file: Positional[Path]  # scene, dataset or model
