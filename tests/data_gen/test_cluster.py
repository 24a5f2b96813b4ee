"""prtnet generate on workers of their own: real processes, one of which is killed."""

from __future__ import annotations

import dataclasses
import os
import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from data_gen.generate import GenerateConfig, generate
from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from data_gen.readers import read_scene
from prtnet.cli import run
from prtnet.errors import PrtnetError

distributed = pytest.importorskip("distributed", reason="needs the extra 'cluster'")
CONFIG = GenerateConfig(count=24, rays=64, order=3, threads=1, block=1)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    ) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "arm.glb"
    write_glb(arm(segments=10), path)
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}


@pytest.mark.skipif(not hasattr(signal, "SIGKILL"), reason="there is no SIGKILL here")
def test_a_worker_that_is_killed_changes_no_byte(cluster: Any, scene: Path, tmp_path: Path) -> None:
    told: list[int] = []

    def kill_one(done: int, total: int) -> None:
        told.append(done)
        if done == 4:
            pid = next(iter(cluster.workers.values())).pid
            os.kill(pid, signal.SIGKILL)

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
