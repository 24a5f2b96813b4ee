"""Point caches: what a good one gives, and one line of error for every bad one."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from data_gen import point_cache
from data_gen.readers import read_scene
from prtnet.errors import PrtnetError
from prtnet.files import file_sha256
from prtnet.scene import PointCacheScene

FRAMES = np.arange(2 * 4 * 3, dtype=np.float32).reshape(2, 4, 3) ** 2
FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
GOOD: dict[str, Any] = {"positions": FRAMES, "faces": FACES, "fps": np.float32(25)}


def write(path: Path, **changes: Any) -> Path:
    np.savez(path, **{k: v for k, v in (GOOD | changes).items() if v is not None})
    return path


def test_a_good_cache(tmp_path: Path) -> None:
    path = write(tmp_path / "wave.npz")
    scene = read_scene(path)
    assert isinstance(scene, PointCacheScene)
    np.testing.assert_array_equal(scene.frames, FRAMES)
    np.testing.assert_array_equal(scene.faces, FACES)
    assert scene.frames.dtype == np.float32
    assert scene.faces.dtype == np.int32
    assert scene.sha256 == file_sha256(path)
    (clip,) = scene.clips
    assert (clip.name, clip.start, clip.end) == ("wave", 0.0, 1 / 25)


def test_other_number_types_and_compression(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    np.savez_compressed(
        path, positions=FRAMES.astype(">f8"), faces=FACES.astype("u1"), fps=np.array([25])
    )
    scene = read_scene(path)
    assert isinstance(scene, PointCacheScene)
    np.testing.assert_array_equal(scene.frames, FRAMES)
    assert (scene.frames.dtype, scene.faces.dtype, scene.fps) == (np.float32, np.int32, 25.0)


def test_the_sample_cloth(shared_data: Path) -> None:
    scene = read_scene(shared_data / "cloth_train.npz")
    clip = scene.clips[0]
    assert clip.end == pytest.approx(359 / 30)
    poses = scene.poses(clip, clip.times(fps=30))
    assert poses.shape == (360, 3 * 4225)
    with np.load(shared_data / "cloth_train.npz") as arrays:
        np.testing.assert_array_equal(poses[17].reshape(-1, 3), arrays["positions"][17])


def changed(value: float) -> Any:
    frames = FRAMES.copy()
    frames[1, 2, 0] = value
    return frames


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"positions": None}, "no array 'positions'"),
        ({"fps": None}, "no array 'fps'"),
        ({"positions": FRAMES[0]}, "shape"),
        ({"positions": FRAMES.astype(int)}, "float32"),
        ({"positions": FRAMES[:0]}, "empty"),
        ({"positions": FRAMES[:, :0]}, "empty"),
        ({"positions": changed(np.nan)}, "not finite"),
        ({"positions": changed(-np.inf)}, "not finite"),
        ({"positions": FRAMES.astype(float) * 1e37}, "not finite"),
        ({"faces": FACES.astype(float)}, "int32"),
        ({"faces": FACES[:, :2]}, "shape"),
        ({"faces": FACES[:0]}, "no triangles"),
        ({"faces": FACES - 1}, "vertices 0 to 3"),
        ({"faces": FACES + 1}, "vertices 0 to 3"),
        ({"fps": 0.0}, "fps"),
        ({"fps": -30.0}, "fps"),
        ({"fps": np.nan}, "fps"),
        ({"fps": 1e-300}, "fps"),
        ({"fps": np.array([30, 30])}, "fps"),
        ({"fps": "thirty"}, "fps"),
        ({"faces": np.array([None, {}])}, "'faces' cannot be read"),
    ],
)
def test_bad_arrays(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    path = write(tmp_path / "x.npz", **changes)
    with pytest.raises(PrtnetError, match=message) as caught:
        read_scene(path)
    assert caught.value.subject == str(path)
    assert "\n" not in str(caught.value)


def test_every_truncation(tmp_path: Path) -> None:
    whole = write(tmp_path / "x.npz").read_bytes()
    path = tmp_path / "cut.npz"
    for length in range(0, len(whole), 7):
        path.write_bytes(whole[:length])
        with pytest.raises(PrtnetError):
            read_scene(path)


def test_every_damaged_byte(tmp_path: Path) -> None:
    whole = write(tmp_path / "x.npz").read_bytes()
    path = tmp_path / "hit.npz"
    refused = 0
    for place in range(0, len(whole), 3):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 0x55]) + whole[place + 1 :])
        try:
            read_scene(path)
        except PrtnetError:
            refused += 1
    assert refused > len(whole) / 6  # zip files have checksums; a few bytes mean nothing


def lying(path: Path, shape: str) -> Path:
    """A cache whose positions promise ``shape`` and hold 24 numbers."""
    with zipfile.ZipFile(write(path), "a") as archive:
        names = archive.namelist()
        arrays = {name: archive.read(name) for name in names}
    head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
    head = head.ljust(117) + "\n"
    body = b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode()
    arrays["positions.npy"] = body + FRAMES.tobytes()
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in arrays.items():
            archive.writestr(name, data)
    return path


@pytest.mark.parametrize("shape", ["(99999999, 99999, 3)", "(3, 4, 3)", "(-2, -4, 3)", "(2,"])
def test_headers_that_lie(tmp_path: Path, shape: str) -> None:
    with pytest.raises(PrtnetError, match="cannot be read"):
        read_scene(lying(tmp_path / "x.npz", shape))


def test_the_helper_above_writes_good_files_too(tmp_path: Path) -> None:
    assert read_scene(lying(tmp_path / "x.npz", "(2, 4, 3)")).vertex_count == 4


def test_bombs_are_not_unpacked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x.npz"
    np.savez_compressed(path, **(GOOD | {"positions": np.zeros((500, 400, 3), np.float32)}))
    assert read_scene(path).vertex_count == 400
    monkeypatch.setattr(point_cache, "LARGE_BYTES", 2**20)
    with pytest.raises(PrtnetError, match="unpacks to 2400128 bytes"):
        read_scene(path)


@pytest.mark.parametrize("content", [b"", b"hello", b"PK\x03\x04" + bytes(50), None])
def test_other_files(tmp_path: Path, content: bytes | None) -> None:
    path = tmp_path / "x.npz"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(PrtnetError):
        read_scene(path)


def test_a_lone_array_is_not_a_cache(tmp_path: Path) -> None:
    buffer = io.BytesIO()
    np.save(buffer, FRAMES)
    (tmp_path / "x.npz").write_bytes(buffer.getvalue())
    with pytest.raises(PrtnetError, match="cannot be read"):
        read_scene(tmp_path / "x.npz")
