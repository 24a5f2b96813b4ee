from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation as shapes
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet import cli
from prtnet.cli_render_field import worn_by
from prtnet.lobe_field import LobeField
from runtime.worn import swung

QUICK = ["--rays", "64", "--order", "3", "--threads", "1", "--quiet"]
SMALL = ["--size", "64x48", "--renderer", "cpu"]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of fields, matte, glossy and of a mesh, and of a mesh."""
    folder = tmp_path_factory.mktemp("fields")
    shapes.icosphere(2).export(folder / "ball.ply")
    write_glb(arm(segments=4), folder / "arm.glb")
    patch = ["bake", "waffle", "--size", "8x8", *QUICK]
    for argv in (
        [*patch, "--out", str(folder / "raw.safetensors")],
        ["bake", str(folder / "raw.safetensors"), "--lobes", "3", "--quiet",
         "--out", str(folder / "lobes.safetensors")],
        [*patch, "--brdf", "gold", "--lobes", "2", "--out", str(folder / "shiny.safetensors")],
        ["bake", str(folder / "ball.ply"), *QUICK, "--out", str(folder / "ball.safetensors")],
    ):  # fmt: skip
        assert cli.run(argv) == 0
    return folder


def rendered(files: Path, tmp_path: Path, name: str, *argv: str) -> tuple[np.ndarray, dict]:
    out, facts = tmp_path / "a.png", tmp_path / "a.json"
    base = ["render", str(files / f"{name}.safetensors"), "--out", str(out), *SMALL]
    assert cli.run([*base, "--json", str(facts), "--quiet", *argv]) == 0
    return np.asarray(Image.open(out)), json.loads(facts.read_text())


@pytest.mark.parametrize(
    ("name", "argv"),
    [
        ("lobes", []),
        ("raw", ["--on", "plane"]),
        ("raw", ["--lobes", "3", "--form", "direct"]),
        ("shiny", ["--twist", "40"]),
        ("ball", ["--lobes", "1"]),
        ("ball", ["--twist", "90"]),
    ],
)
def test_pictures(files: Path, tmp_path: Path, name: str, argv: list[str]) -> None:
    picture, facts = rendered(files, tmp_path, name, *argv)
    assert picture.shape == (48, 64, 3)
    assert picture.max() > 150
    assert facts["order"] == 3


def test_lobes_beside_harmonics(files: Path, tmp_path: Path) -> None:
    _, fitted = rendered(files, tmp_path, "raw", "--lobes", "3", "--compare", "sh")
    picture, read = rendered(files, tmp_path, "lobes", "--compare", str(files / "raw.safetensors"))
    assert picture.shape[1] > 3 * 64
    assert 0 < fitted["error_in_per_cent_of_white"]["rms"] < 10
    for name, error in fitted["error_in_per_cent_of_white"].items():
        assert read["error_in_per_cent_of_white"][name] == pytest.approx(error, rel=1e-4)


def test_a_mesh_beside_the_truth(files: Path, tmp_path: Path) -> None:
    """A ball that is twisted is a ball: what it was is what it is."""
    _, facts = rendered(files, tmp_path, "ball", "--compare", "truth", "--twist", "30")
    assert facts["error_in_per_cent_of_white"]["rms"] < 2.0


def test_on_a_mesh(files: Path, tmp_path: Path) -> None:
    picture, _ = rendered(files, tmp_path, "lobes", "--on", str(files / "ball.ply"))
    assert picture.std() > 10
    same, _ = rendered(files, tmp_path, "ball", "--on", str(files / "ball.ply"))
    own, _ = rendered(files, tmp_path, "ball")
    assert np.abs(same.astype(int) - own).max() <= 1


def test_a_row_all_around(files: Path, tmp_path: Path) -> None:
    """The first is the picture without --spin; each error is told."""
    alone, _ = rendered(files, tmp_path, "ball", "--twist", "30")
    _, facts = rendered(files, tmp_path, "ball", "--twist", "30", "--spin", "3")
    around = [np.asarray(Image.open(name)) for name in facts["out"]]
    assert [Path(name).name for name in facts["out"]] == ["a_0.png", "a_1.png", "a_2.png"]
    assert facts["pictures"] == 3
    # One exposure for all.
    assert np.array_equal(around[0], alone)
    assert np.abs(around[1].astype(int) - alone).max() > 20
    _, facts = rendered(files, tmp_path, "raw", "--lobes", "1", "--compare", "sh", "--spin", "2")
    assert len(facts["error_in_per_cent_of_white"]) == 2


@pytest.mark.parametrize(
    ("argv", "count"),
    [
        (["--on", "ARM", "--fps", "1"], 5),  # four seconds, both ends
        (["--twist", "70", "--fps", "2"], 8),
        (["--twist", "70", "--spin", "3"], 3),
        (["--on", "ARM", "--twist", "50", "--clip", "bend", "--fps", "1"], 5),
    ],
)
def test_movies(files: Path, tmp_path: Path, argv: list[str], count: int) -> None:
    av = pytest.importorskip("av")
    out = tmp_path / "a.mp4"
    words = [str(files / "arm.glb") if word == "ARM" else word for word in argv]
    _run = ["render", str(files / "lobes.safetensors"), "--out", str(out), *SMALL, "--quiet"]
    assert cli.run([*_run, *words]) == 0
    with av.open(str(out)) as file:
        frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
    assert len(frames) == count
    assert np.abs(frames[1].astype(int) - frames[0]).max() > 20


def test_a_movie_of_a_clip_is_its_pictures(files: Path, tmp_path: Path) -> None:
    """Twisted as given at the start, the other way two seconds later; seen from one place."""
    av = pytest.importorskip("av")
    out, base = tmp_path / "a.mp4", ["--on", str(files / "arm.glb"), "--twist", "60"]
    command = ["render", str(files / "lobes.safetensors"), *SMALL, "--quiet"]
    assert cli.run([*command, *base, "--fps", "1", "--out", str(out)]) == 0
    with av.open(str(out)) as file:
        frames = [frame.to_ndarray(format="rgb24").astype(int) for frame in file.decode(video=0)]
    first = worn_by(str(files / "arm.glb"), 6, LobeField.load(files / "lobes.safetensors").layout)
    clip = first.clip(None)
    turned = [first.at(clip, t, swung(math.radians(60), t)).positions for t in (0.0, 2.0)]
    apart = np.abs(turned[0] - first.at(clip, 0.0, math.radians(60)).positions).max()
    assert apart == 0.0
    opposite = first.at(clip, 2.0, -math.radians(60)).positions
    assert np.abs(turned[1] - opposite).max() < 1e-6
    # From the last picture to the first nothing jumps: the clip ends where it starts.
    assert np.abs(frames[4] - frames[0]).mean() < 0.3 * np.abs(frames[2] - frames[0]).mean()


def test_opengl_and_numpy_draw_alike(files: Path, tmp_path: Path) -> None:
    from runtime.gl import available

    if not available():
        pytest.skip("no OpenGL")
    one, _ = rendered(files, tmp_path, "lobes")
    other, _ = rendered(files, tmp_path, "lobes", "--renderer", "gl")
    assert (np.abs(one.astype(int) - other).max(axis=-1) <= 2).mean() >= 0.999


@pytest.mark.parametrize(
    ("name", "argv", "said"),
    [
        ("lobes", ["--compare", "sh"], "needs transfer"),
        ("lobes", ["--compare", "truth"], "traced where it is flat"),
        ("lobes", ["--lobes", "3"], "--lobes: are fitted already"),
        ("raw", ["--form", "table"], "--form: is of lobes"),
        ("raw", ["--compare", "sh"], "--compare: sh is what is drawn already"),
        ("raw", ["--renderer", "gl"], "--renderer: gl draws lobes"),
        ("raw", ["--clip", "Walk"], "--clip: is of a scene that moves"),
        ("raw", ["--on", "plane", "--time", "0"], "--time: is of a scene that moves"),
        ("ball", ["--repeat", "6"], "--repeat: is of patches"),
        ("lobes", ["--compare", "BALL"], "something else"),
        ("ball", ["--on", "vase"], "for patches"),
        ("raw", ["--on", "cup"], "cup: does not exist"),
        ("raw", ["--on", "MESH", "--clip", "Walk"], "does not move"),
        ("raw", ["--repeat", "0"], "--repeat: is 0"),
        ("raw", ["--lobes", "9"], "--lobes: is 9; it must be from 1 to 8"),
        ("raw", ["--size", "9000x10"], "--size: is too large"),
        ("raw", ["--twist", "nan"], "--twist"),
        ("raw", ["--light", "moon"], "moon"),
        ("raw", ["--out", "a.gif"], ".png or .mp4"),
        ("raw", ["--out", "a.mp4"], "vase: does not move; twist it"),
        ("raw", ["--out", "a.mp4", "--on", "ARM", "--time", "1"], "no place in a movie"),
        ("raw", ["--on", "ARM", "--time", "9"], "runs from 0 to 4 s"),
        ("raw", ["--on", "ARM", "--clip", "bnd"], "has no clip 'bnd'"),
        ("raw", ["--spin", "1000"], "--spin: is 1000"),
        ("raw", ["--fps", "0"], "--fps: is 0"),
    ],
)
def test_what_cannot_be(files, tmp_path, capsys, name, argv, said) -> None:
    words = {"BALL": str(files / "ball.safetensors"), "MESH": str(files / "ball.ply"),
             "ARM": str(files / "arm.glb"), "a.mp4": str(tmp_path / "a.mp4")}  # fmt: skip
    base = ["render", str(files / f"{name}.safetensors"), "--out", str(tmp_path / "b.png")]
    assert cli.run([*base, *SMALL, *(words.get(word, word) for word in argv)]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "b.png").exists()


def test_help_of_a_field(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["render", str(files / "raw.safetensors"), "--help"]) == 0
    assert "--repeat" in capsys.readouterr().out
