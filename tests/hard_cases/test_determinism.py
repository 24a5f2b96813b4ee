"""The same command on the same machine writes the same bytes, by any number of threads."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet.cli import run
from prtnet.dataset import Dataset
from prtnet.model import VisibilityModel
from tests.hard_cases.measured import equal
from training import regression

KINDS = {  # by the arguments of prtnet train
    "neural": "--preset small --alpha 0.001 --iterations 30 --storage int8",
    "linear": "--preset small --kind linear",
    "quadratic": "--preset small --kind quadratic",
    "lobes": "--preset small --kind lobes --regressor neural --alpha 0.001 --iterations 10",
    "hybrid": "--preset tiny --clusters 8 --samples 2000",
    "shared": "--preset best --clusters 8 --iterations 20 --samples 2000 --steps 100",
}


pytestmark = pytest.mark.usefixtures("torch_threads")


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
    for kind, words in KINDS.items():
        command("train {1}/arm.zarr --out {1}/" + f"{kind}.safetensors {words} {count}", *files)
    (folder / "neural.safetensors").rename(folder / "arm.safetensors")
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


def test_the_same_commands_write_the_same_bytes(
    scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    first = contents(everything(scene, tmp_path / "one"))
    second = contents(elsewhere(scene, tmp_path / "two", seed=1))
    assert first.keys() == second.keys()
    assert [name for name in first if first[name] != second[name]] == []

    with monkeypatch.context() as patch:  # so little work would be one thread's
        patch.setattr(regression, "RUN", 1)
        third = contents(everything(scene, tmp_path / "more", threads=4))
    told = re.compile(rb'(threads[\\]*": )4')  # the only thing that may be other
    assert [name for name in first if told.sub(rb"\g<1>1", third[name]) != first[name]] == []
    made = [name for name in first if first[name] != third[name]]
    assert {*KINDS} <= {name.partition(".")[0] for name in made} | {"neural"}
    poses = Dataset.open(tmp_path / "one" / "arm.zarr").read("pose")
    for name in (name for name in made if name.endswith(".safetensors")):
        one, more = (VisibilityModel.load(tmp_path / at / name) for at in ("one", "more"))
        equal(one(poses), more(poses))
