"""With ``--exchange`` a command that was ended goes on with what it had finished."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest
import trimesh

from data_gen.generate import GenerateConfig, generate
from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from data_gen.readers import read_scene
from prtnet.cli import run
from prtnet.errors import PrtnetError
from prtnet.executor import Local, Task

COMMANDS = [  # and how many pieces of each of them are done in the first run
    ("bake {0}/ball.ply --rays 16 --order 3 --lobes 1", 1),
    ("bake-all-frequency {0}/ball.ply --texels 8 --points-per-cluster 40 --terms 3 --seed 3", 9),
    ("train {0}/a.zarr --preset small --alpha 0.01 --iterations 3", 3),
    ("train {0}/a.zarr --preset small --clusters 6 --iterations 2", 3),  # with cross-validation
]


pytestmark = pytest.mark.usefixtures("torch_threads")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("inputs")
    write_glb(arm(segments=6), folder / "arm.glb")
    config = GenerateConfig(count=5, rays=32, order=3, threads=1)
    generate(read_scene(folder / "arm.glb"), config, folder / "a.zarr")
    trimesh.creation.icosphere(subdivisions=1, radius=0.5).export(folder / "ball.ply")
    return folder


@pytest.mark.parametrize(("words", "first"), COMMANDS)
@pytest.mark.parametrize("threads", [1, 3])
def test_a_command_that_was_ended_goes_on(
    words: str, first: int, threads: int, folder: Path, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    plain, out, kept = (tmp_path / name for name in ("plain", "out", "kept"))
    for each in (plain, out, kept):
        each.mkdir()
    argv = [*words.format(folder).split(), "--quiet", "--threads", str(threads), "--out"]
    assert run([*argv, str(plain / "a.safetensors")]) == 0
    argv += [str(out / "a.safetensors"), "--exchange", str(kept)]
    done: list[int] = []
    real = Local.run

    def counted(self: Local, task: Task, numbers: Sequence[int], ahead: int = 1) -> Iterator[int]:
        assert (self.threads, ahead) == (threads, threads)
        for number in real(self, task, numbers, ahead):
            done.append(number)
            yield number

    def ended(*given: Any) -> Iterator[int]:
        for number in counted(*given):
            if len(done) > first:
                raise PrtnetError("here", "ends")
            yield number

    with monkeypatch.context() as patch:
        patch.setattr(Local, "run", ended)
        assert run(argv) == 2
    assert list(out.iterdir()) == []
    assert [path.name for path in kept.glob(".a.safetensors.*.blocks")] != []
    before, done[:] = len(done), []
    monkeypatch.setattr(Local, "run", counted)
    assert run(argv) == 0
    again = len(done)
    assert (out / "a.safetensors").read_bytes() == (plain / "a.safetensors").read_bytes()
    assert list(kept.iterdir()) == []
    done.clear()
    assert run(argv) == 0  # nothing is left: all is done anew
    assert 0 < again <= len(done) - before


def test_a_folder_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    argv = ["bake", "bumps", "--size", "4x4", "--out", str(tmp_path / "a.safetensors")]
    assert run([*argv, "--exchange", str(tmp_path / "none")]) == 2
    assert "cannot be made (No such file or directory); give another" in capsys.readouterr().err
