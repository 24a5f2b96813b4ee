from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from prtnet.errors import PrtnetError
from runtime import movie as module
from runtime.movie import movie


def moving_bar(count: int, size: tuple[int, int]) -> list[np.ndarray]:
    pictures = []
    for k in range(count):
        picture = np.full((size[1], size[0], 3), 40, dtype=np.uint8)
        picture[:, 5 * k : 5 * k + 12] = (220, 160, 60)
        pictures.append(picture)
    return pictures


def played(path: Path) -> tuple[list[np.ndarray], float]:
    av = pytest.importorskip("av")
    with av.open(str(path)) as file:
        rate = float(file.streams.video[0].average_rate)
        return [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)], rate


@pytest.mark.parametrize("codec", ["libx264", "mpeg4"])
@pytest.mark.parametrize("size", [(64, 48), (65, 49)])
def test_what_is_played_is_what_was_added(tmp_path, monkeypatch, size, codec):
    pytest.importorskip("av")
    monkeypatch.setattr(module, "CODECS", {codec: module.CODECS[codec]})
    pictures = moving_bar(7, size)
    with movie(tmp_path / "bar.mp4", 25) as add:
        for picture in pictures:
            add(picture)
    frames, rate = played(tmp_path / "bar.mp4")
    assert rate == 25
    assert len(frames) == len(pictures)
    for frame, picture in zip(frames, pictures, strict=True):
        assert frame.shape == (48 + 2 * (size[1] % 2), 64 + 2 * (size[0] % 2), 3)
        difference = np.abs(frame[: size[1], : size[0]].astype(int) - picture)
        assert difference.mean() < 6  # lossy, and colour is coarse


def test_a_movie_appears_whole_or_not_at_all(tmp_path):
    pytest.importorskip("av")

    def fail() -> None:
        with movie(tmp_path / "bar.mp4", 25) as add:
            add(moving_bar(1, (64, 48))[0])
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        fail()
    assert not list(tmp_path.iterdir())
    pictures = moving_bar(1, (64, 48)) + moving_bar(1, (66, 48))
    with pytest.raises(PrtnetError, match="one size"), movie(tmp_path / "bar.mp4", 25) as add:
        list(map(add, pictures))
    assert not list(tmp_path.iterdir())
    with pytest.raises(PrtnetError, match="cannot be written"), movie(tmp_path / "a/b.mp4", 25):
        pass


def test_without_the_extra_it_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    told = pytest.raises(PrtnetError, match=r"pip install 'prtnet\[viewer\]'")
    with told, movie(tmp_path / "bar.mp4", 25):
        pass
