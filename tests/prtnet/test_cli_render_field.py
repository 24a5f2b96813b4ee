from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation as shapes
from PIL import Image

from prtnet import cli

QUICK = ["--rays", "64", "--order", "3", "--threads", "1", "--quiet"]
SMALL = ["--size", "64x48", "--renderer", "cpu"]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of fields, matte, glossy and of a mesh, and of a mesh."""
    folder = tmp_path_factory.mktemp("fields")
    shapes.icosphere(2).export(folder / "ball.ply")
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
        ("lobes", ["--compare", "truth"], "truth is of meshes"),
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
        ("raw", ["--out", "a.mp4"], ".png"),
    ],
)
def test_what_cannot_be(files, tmp_path, capsys, name, argv, said) -> None:
    words = {"BALL": str(files / "ball.safetensors"), "MESH": str(files / "ball.ply")}
    base = ["render", str(files / f"{name}.safetensors"), "--out", str(tmp_path / "b.png")]
    assert cli.run([*base, *SMALL, *(words.get(word, word) for word in argv)]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not (tmp_path / "b.png").exists()


def test_help_of_a_field(files: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.run(["render", str(files / "raw.safetensors"), "--help"]) == 0
    assert "--repeat" in capsys.readouterr().out
