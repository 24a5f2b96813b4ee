"""The same command on the same machine writes the same bytes; with more threads, models nearly."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import torch

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet.cli import run
from prtnet.dataset import Dataset
from prtnet.model import VisibilityModel
from tests.hard_cases.measured import close

ROUNDING = 1e-5  # of visibility, whose largest coefficient is √4π; docs/conventions.md


@pytest.fixture(autouse=True)
def _threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "arm.glb"
    write_glb(arm(segments=6), path)
    return path


def command(words: str, *paths: Path) -> None:
    assert run([*(word.format(*paths) for word in words.split()), "--quiet"]) == 0


def everything(scene: Path, folder: Path, threads: int = 1) -> Path:
    folder.mkdir()
    count, files = f"--threads {threads}", (scene, folder)
    command("generate {0} --out {1}/arm.zarr --count 9 --rays 32 --block 4 --sample 3 " + count,
            *files)  # fmt: skip
    command("train {1}/arm.zarr --out {1}/arm.safetensors --preset small --iterations 60 "
            "--storage int8 " + count, *files)  # fmt: skip
    command("export {1}/arm.safetensors --out {1}/export", *files)
    command("render {1}/arm.safetensors {0} --out {1}/arm.png --size 64x64 --renderer cpu "
            + count, *files)  # fmt: skip
    command("bake bumps --out {1}/bumps.safetensors --size 8x8 --rays 32 --lobes 1 " + count,
            *files)  # fmt: skip
    command("bake-all-frequency {0} --out {1}/light.safetensors --texels 8 --terms 3 --rows 2 "
            "--points-per-cluster 40 --brdf ggx:roughness=0.3 " + count, *files)  # fmt: skip
    return folder


def elsewhere(scene: Path, folder: Path, seed: int) -> Path:
    """Everything by another process, whose sets have another order and BLAS by itself another
    number of threads.
    """
    words = f"from {__name__} import Path, everything; everything(Path({str(scene)!r}), "
    command = [sys.executable, "-c", f"{words}Path({str(folder)!r}))"]
    environment = os.environ | {
        "PYTHONHASHSEED": str(seed), "PYTHONPATH": os.pathsep.join(sys.path),
        "OPENBLAS_NUM_THREADS": "3", "MKL_NUM_THREADS": "3",
    }  # fmt: skip
    subprocess.run(command, env=environment, check=True)
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def test_the_same_commands_write_the_same_bytes(scene: Path, tmp_path: Path) -> None:
    one = everything(scene, tmp_path / "one")
    two = elsewhere(scene, tmp_path / "two", seed=1)
    first, second = contents(one), contents(two)
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []

    more = everything(scene, tmp_path / "more", threads=4)
    other = contents(more)
    data = [name for name in first if name.startswith(("arm.zarr", "bumps", "light"))]
    assert len(data) > 10
    assert [name for name in data if first[name] != other[name]] == []
    poses = Dataset.open(one / "arm.zarr").read("pose")
    models = [VisibilityModel.load(at / "arm.safetensors") for at in (one, more)]
    assert [model.metadata["made_with"]["threads"] for model in models] == [1, 4]
    a, b = (model(poses) for model in models)
    close(a, b, atol=ROUNDING)
