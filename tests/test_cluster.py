"""Commands on workers of their own: real processes, one of which is killed now and then."""

from __future__ import annotations

import dataclasses
import os
import platform
import re
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pytest
import torch
import trimesh

from data_gen.generate import GenerateConfig, generate
from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from data_gen.readers import read_scene
from prtnet.cli import run
from prtnet.errors import PrtnetError
from prtnet.exchange import Exchange, through
from prtnet.executor import Cluster, Task
from tests import store as _store  # noqa: F401 - registers farm://
from tests.training.data import memory_dataset
from training.config import TrainConfig
from training.train import PACKAGES, train

distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
CONFIG = GenerateConfig(count=24, rays=64, order=3, threads=1, block=1)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=2, processes=True, dashboard_address=":0",
        preload=["tests.store"],
    ) as cluster:  # fmt: skip
        yield cluster


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "arm.glb"
    write_glb(arm(segments=10), path)
    return path


@pytest.fixture(autouse=True)
def _one_thread() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


def kill_a_worker(cluster: Any) -> None:
    os.kill(next(iter(cluster.workers.values())).pid, signal.SIGKILL)


CAN_KILL = pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")


@CAN_KILL
def test_a_worker_that_is_killed_changes_no_byte(cluster: Any, scene: Path, tmp_path: Path) -> None:
    told: list[int] = []

    def kill_one(_: str, done: int, total: int, __: str = "") -> None:
        told.append(done)
        if done == 4:
            kill_a_worker(cluster)

    address = cluster.scheduler_address
    summary = generate(
        read_scene(scene), CONFIG, tmp_path / "far.zarr", kill_one, cluster=address, source=scene
    )
    assert (summary.poses, summary.resumed) == (24, 0)
    assert told == list(range(25))
    here = generate(read_scene(scene), CONFIG, tmp_path / "here.zarr").path
    assert contents(summary.path) == contents(here)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["far.zarr", "here.zarr"]


def test_the_command(cluster: Any, scene: Path, tmp_path: Path) -> None:
    words = [str(scene), "--out", str(tmp_path / "a.zarr"), "--count", "3", "--rays", "16"]
    address = ["--cluster", cluster.scheduler_address, "--quiet"]
    assert run(["generate", *words, *address]) == 0
    assert (tmp_path / "a.zarr" / "zarr.json").is_file()
    assert run(["generate", *words, *address, "--repair"]) == 2


@CAN_KILL
@pytest.mark.filterwarnings("ignore:UPath 'farm' filesystem")
def test_a_dataset_in_a_store(cluster: Any, scene: Path, tmp_path: Path) -> None:
    """Workers and we see it by its URL alone; what train hands over lies beside it."""
    (tmp_path / "here").mkdir()
    url = f"farm://{tmp_path}/farm/a.zarr"
    where: Any = {"cluster": cluster.scheduler_address, "source": scene}

    def kill_one(_: str, done: int, total: int, __: str = "") -> None:
        if done == 4:
            kill_a_worker(cluster)

    generate(read_scene(scene), CONFIG, url, kill_one, **where)
    here = generate(read_scene(scene), CONFIG, tmp_path / "here" / "a.zarr").path
    assert contents(tmp_path / "farm" / "a.zarr") == contents(here)
    words = ["--preset", "small", "--alpha", "0.01", "--iterations", "9", "--threads", "1"]
    out = tmp_path / "here" / "a.safetensors"
    address = ["--cluster", cluster.scheduler_address, "--quiet"]
    assert run(["train", url, *words, *address, "--out", str(out)]) == 0
    far = out.read_bytes()
    assert run(["train", str(here), *words, "--quiet", "--out", str(out)]) == 0
    assert out.read_bytes() == far
    assert sorted(path.name for path in (tmp_path / "farm").iterdir()) == ["a.zarr"]


def test_a_worker_that_sees_another_scene_says_so(
    cluster: Any, scene: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.glb"
    write_glb(arm(segments=8), other)
    config = dataclasses.replace(CONFIG, count=2)
    where = {"cluster": cluster.scheduler_address, "source": other}
    with pytest.raises(PrtnetError, match=r"other.glb: is another file on a worker"):
        generate(read_scene(scene), config, tmp_path / "a.zarr", **where)
    where["source"] = tmp_path / "none.glb"
    with pytest.raises(PrtnetError, match=r"none.glb"):
        generate(read_scene(scene), config, tmp_path / "a.zarr", **where)


class Deadly(Cluster):
    """Kills a worker after three pieces."""

    def __init__(self, cluster: Any) -> None:
        super().__init__(cluster.scheduler_address, PACKAGES)
        self.cluster, self.done = cluster, 0

    def run(self, task: Task, numbers: Sequence[int], ahead: int = 1) -> Iterator[int]:
        for number in super().run(task, numbers, ahead):
            self.done += 1
            if self.done == 3:
                kill_a_worker(self.cluster)
            yield number


@CAN_KILL
def test_networks_of_a_model_lose_nothing_with_a_worker(cluster: Any, tmp_path: Path) -> None:
    data: Any = memory_dataset(per_clip=6)
    config = TrainConfig(
        clusters=16, latents=3, neurons=6, features="joint_angles", iterations=20, alpha=1e-2,
        networks=3,
    )  # fmt: skip
    tasks = Deadly(cluster)
    with through(tasks, tmp_path / "fits"):
        train(data, config).save(tmp_path / "far")
    train(data, config).save(tmp_path / "here")
    assert (tmp_path / "far").read_bytes() == (tmp_path / "here").read_bytes()
    assert tasks.done == 3 * 4  # four blocks of every network


def test_train_on_a_cluster(cluster: Any, scene: Path, tmp_path: Path) -> None:
    data, out = tmp_path / "a.zarr", tmp_path / "a.safetensors"
    generate(read_scene(scene), dataclasses.replace(CONFIG, count=5), data)
    words = ["train", str(data), "--preset", "small", "--alpha", "0.01", "--iterations", "9"]
    words += ["--threads", "3"]
    address = ["--cluster", cluster.scheduler_address, "--quiet"]
    assert run([*words, *address, "--out", str(out)]) == 0
    assert run([*words, "--quiet", "--out", str(tmp_path / "b.safetensors")]) == 0
    assert out.read_bytes() == (tmp_path / "b.safetensors").read_bytes()
    assert len(list(tmp_path.iterdir())) == 3
    assert run([*words, *address, "--kind", "linear", "--out", str(out)]) == 2


@dataclass(frozen=True)
class Nothing:
    def __call__(self, number: int, pool: Executor) -> None:
        pass


def test_workers_with_other_versions_are_told(cluster: Any) -> None:
    tasks = Cluster(cluster.scheduler_address, ["numpy"])
    assert list(tasks.run(Nothing(), [3])) == [3]
    for name, here in (("numpy", version("numpy")), ("no-such-package", "not there")):
        tasks.made = (("python", platform.python_version()), (name, "0.1"))
        wanted = f"--cluster: {name} is {here} on a worker and 0.1 here; make them the same"
        with pytest.raises(PrtnetError, match=re.escape(wanted)):
            list(tasks.run(Nothing(), [3]))


@pytest.mark.parametrize(
    "words",
    [
        "bake bumps --size 8x8 --rays 32 --lobes 1",
        "bake-all-frequency {0} --texels 8 --points-per-cluster 40 --terms 3 --rows 2 "
        "--brdf ggx:roughness=0.3 --ground",
    ],
)
def test_bake_on_a_cluster(
    words: str, cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("data_gen.all_frequency.ground.__defaults__", (6, 4.0))
    mesh, out = tmp_path / "ball.ply", tmp_path / "far.safetensors"
    trimesh.creation.icosphere(subdivisions=2, radius=0.5).export(mesh)
    argv = [*(word.format(mesh) for word in words.split()), "--quiet", "--out"]
    address = ["--cluster", cluster.scheduler_address]
    assert run([*argv, str(tmp_path / "here.safetensors"), "--threads", "2"]) == 0
    assert run([*argv, str(out), *address]) == 0
    assert out.read_bytes() == (tmp_path / "here.safetensors").read_bytes()
    assert len(list(tmp_path.iterdir())) == 3


@pytest.mark.filterwarnings("ignore:UPath 'farm' filesystem")
@pytest.mark.parametrize(
    "words",
    [
        "bake {0}/ball.ply --rays 16 --order 3 --lobes 1",
        "bake-all-frequency {0}/ball.ply --texels 8 --points-per-cluster 40 --terms 3",
        "train {0}/a.zarr --preset small --alpha 0.01 --iterations 3",
    ],
)
def test_workers_that_share_a_store_alone(
    words: str, cluster: Any, scene: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they exchange goes there, and nothing is written beside the output meanwhile."""
    trimesh.creation.icosphere(subdivisions=1, radius=0.5).export(tmp_path / "ball.ply")
    generate(read_scene(scene), dataclasses.replace(CONFIG, count=3), tmp_path / "a.zarr")
    argv = [*words.format(tmp_path).split(), "--quiet", "--threads", "1", "--out"]
    assert run([*argv, str(tmp_path / "here.safetensors")]) == 0
    seen: list[set[str]] = []
    put = Exchange.put

    def spy(self: Exchange, arrays: Any) -> Any:
        given = put(self, arrays)
        seen.append({path.name for path in (tmp_path / "farm").rglob("*") if path.is_file()})
        return given

    monkeypatch.setattr(Exchange, "put", spy)
    (tmp_path / "farm").mkdir()
    place = ["--cluster", cluster.scheduler_address, "--exchange", f"farm://{tmp_path}/farm"]
    before = sorted(path.name for path in tmp_path.iterdir())
    assert run([*argv, str(tmp_path / "far.safetensors"), *place]) == 0
    assert any(seen)
    assert all(own for own in seen)
    assert list((tmp_path / "farm").rglob("*.blocks")) == []
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([*before, "far.safetensors"])
    far, here = (tmp_path / f"{name}.safetensors" for name in ("far", "here"))
    assert far.read_bytes() == here.read_bytes()
