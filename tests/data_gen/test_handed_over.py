"""Blocks of bakes that are handed over come back with the bytes of what is computed here."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path

import pytest

import data_gen.cube_visibility
import data_gen.transport
from data_gen.all_frequency import ground
from data_gen.bake import BakeConfig, bake_mesh, bake_patch, bake_wrinkle
from data_gen.cube_visibility import cube_visibility
from data_gen.reliefs import relief
from prtnet import lobe_fit, zh_fit
from prtnet.brdf import GGX
from prtnet.exchange import through
from prtnet.executor import Local
from prtnet.glossy import brdf_rows
from prtnet.lobe_fit import lobe_field
from prtnet.transfer import TransferField
from prtnet.wrinkle import Wrinkle
from tests.data_gen.test_bake import two_balls
from tests.data_gen.test_cube_visibility import pair

QUICK = BakeConfig(order=3, rays=128, bounces=2)


class Counting(Local):
    """Threads that know what they did."""

    def __init__(self) -> None:
        super().__init__(2)
        self.done: list[int] = []

    def run(self, task, numbers: Sequence[int], ahead: int = 1):  # type: ignore[no-untyped-def]
        for number in super().run(task, numbers, ahead):
            self.done.append(number)
            yield number


def tiled() -> TransferField:
    return bake_patch(0.02 * relief("bumps", (9, 5), 0), (0.9, 0.5), (True, False), QUICK)


def glossy() -> TransferField:
    rows = brdf_rows(GGX(roughness=0.3), 2, 3)
    return bake_mesh(two_balls(), dataclasses.replace(QUICK, glossy=rows))


# What to bake, and in how many blocks: of eight points four times, of 32 rows of lobes.
BAKES: dict[str, tuple[Callable[[], TransferField], int]] = {
    "tiled": (tiled, 2 + 2),
    "glossy": (glossy, 3 + 6),
    "wrinkle": (lambda: bake_wrinkle(Wrinkle(0.1, 0.1, 5, 3), QUICK), 3 + 1),
}


@pytest.mark.parametrize("name", BAKES)
def test_transfer_and_lobes(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(data_gen.transport, "BATCH", 128 * 8)  # eight points a part
    for module, name_there in ((lobe_fit, "FUNCTIONS"), (zh_fit, "BLOCK")):
        monkeypatch.setattr(module, name_there, 32)
    bake, blocks = BAKES[name]
    told: list[tuple[str, int, int]] = []

    def made(path: Path) -> bytes:
        told.clear()
        lobe_field(bake(), 2, report=lambda *words: told.append(words[:3])).save(path)  # type: ignore
        return path.read_bytes()

    here = made(tmp_path / "here")
    tasks = Counting()
    with through(tasks, tmp_path / "blocks"):
        assert made(tmp_path / "far") == here
    assert len(tasks.done) == blocks
    assert told[-1][1] == told[-1][2]
    with through(tasks, tmp_path / "blocks"):
        assert made(tmp_path / "far") == here


def test_what_vertices_see(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(data_gen.cube_visibility, "BATCH", 6 * 16 * 16)  # two vertices a part
    surface = pair()
    below = ground(surface, 8)
    for own in (surface, below):
        here = cube_visibility(own, [surface, below], 16)
        tasks = Counting()
        with through(tasks, tmp_path / "blocks"):
            far = cube_visibility(own, [surface, below], 16)
        assert far.bits.dtype == here.bits.dtype
        assert far.bits.tobytes() == here.bits.tobytes()
        assert len(tasks.done) == -(-len(own) // 32) > 1
