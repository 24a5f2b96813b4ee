"""Point caches: ``.npz`` with ``positions (F, V, 3)``, ``faces (T, 3)`` and ``fps``."""

from __future__ import annotations

import math
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from prtnet.animation import Clip
from prtnet.errors import PrtnetError
from prtnet.files import file_sha256
from prtnet.scene import PointCacheScene

__all__ = ["read_point_cache"]

SLOWEST, FASTEST = 1e-3, 1e6  # frames a second that somebody may mean
# A few kilobytes can unpack to any size: beyond the first bound the second one must hold.
LARGE_BYTES, LARGEST_RATIO = 2**26, 100


def read_point_cache(path: Path) -> PointCacheScene:
    """Read a point cache; its one clip has the file's name and all frames.

    Raises:
        PrtnetError: an array is missing, damaged or of the wrong shape.
    """
    positions, faces, fps = (read_array(path, name) for name in ("positions", "faces", "fps"))
    if positions.dtype.kind != "f" or positions.ndim != 3 or positions.shape[2] != 3:
        raise PrtnetError(path, "'positions' must be float32 of shape (frames, vertices, 3)")
    if positions.size == 0:
        raise PrtnetError(path, "'positions' is empty; give one frame or more")
    if faces.dtype.kind not in "iu" or faces.ndim != 2 or faces.shape[1] != 3:
        raise PrtnetError(path, "'faces' must be int32 of shape (triangles, 3)")
    if len(faces) == 0:
        raise PrtnetError(path, "has no triangles; 'faces' is empty")
    count = positions.shape[1]
    if faces.min() < 0 or faces.max() >= count:
        raise PrtnetError(path, f"'faces' must name vertices 0 to {count - 1}")
    if not (np.abs(positions) <= np.finfo(np.float32).max).all():
        raise PrtnetError(path, "'positions' holds numbers that are not finite; repair the cache")
    rate = float(fps.item()) if fps.size == 1 and fps.dtype.kind in "iuf" else math.nan
    if not SLOWEST <= rate <= FASTEST:
        raise PrtnetError(path, f"'fps' must be one number from {SLOWEST:g} to {FASTEST:g}")
    return PointCacheScene(
        name=path.stem,
        path=path,
        sha256=file_sha256(path),
        faces=faces.astype(np.int32),
        clips=(Clip(path.stem, 0.0, (len(positions) - 1) / rate),),
        frames=positions.astype(np.float32, copy=False),
        fps=rate,
    )


def read_array(path: Path, name: str) -> NDArray[Any]:
    """One array of an ``.npz``, its size checked before it is unpacked."""
    try:
        with zipfile.ZipFile(path) as archive:
            entry = archive.getinfo(f"{name}.npy")
            large = entry.file_size > LARGE_BYTES
            if large and entry.file_size > LARGEST_RATIO * entry.compress_size:
                raise PrtnetError(
                    path, f"'{name}' unpacks to {entry.file_size} bytes; save it anew"
                )
            with archive.open(entry) as file:
                check_header(file, entry.file_size)
            with archive.open(entry) as file:
                return np.lib.format.read_array(file, allow_pickle=False)
    except KeyError as error:
        raise PrtnetError(
            path, f"has no array '{name}'; a point cache has positions, faces and fps"
        ) from error
    except FileNotFoundError as error:
        raise PrtnetError(path, "does not exist; check the path") from error
    except PrtnetError:
        raise
    except Exception as error:  # a damaged header can break NumPy's parser in any way
        reason = " ".join(str(error).split())[:120]
        raise PrtnetError(path, f"'{name}' cannot be read ({reason}); save it anew") from error


def check_header(file: Any, size: int) -> None:
    """Refuse an array whose header promises more numbers than its ``size`` bytes hold."""
    version = np.lib.format.read_magic(file)
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }.get(version)
    if read is None:
        raise ValueError(f"unknown .npy version {version}")
    shape, _, dtype = read(file)
    if dtype.hasobject or min(shape, default=0) < 0 or math.prod(shape) * dtype.itemsize > size:
        raise ValueError("its header does not fit its size")
