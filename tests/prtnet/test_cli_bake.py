from __future__ import annotations

import json
import stat
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation as shapes
from PIL import Image

from prtnet import cli
from prtnet.cli_bake import warnings_of
from prtnet.lobe_field import LobeField
from prtnet.transfer import Patch, Surface, TransferField

QUICK = ["--rays", "32", "--order", "3", "--threads", "1"]


def quick(source: str, *given: str) -> list[str]:
    """Few rays and bands where they are not given, and where the source has any."""
    pairs = zip(QUICK[::2], QUICK[1::2], strict=True)
    none = {"membrane": ("--rays",)}.get(source, ())
    none = ("--rays", "--order") if source.endswith(".safetensors") else none
    return [word for pair in pairs if pair[0] not in (*none, *given) for word in pair]


def baked(tmp_path: Path, *argv: str) -> TransferField:
    out = tmp_path / "field.safetensors"
    assert cli.run(["bake", *argv, "--out", str(out), *quick(*argv), "--quiet"]) == 0
    assert stat.S_IMODE(out.stat().st_mode) & 0o444
    return TransferField.load(out)


def complaint(capsys: pytest.CaptureFixture[str], tmp_path: Path, *argv: str) -> str:
    out = tmp_path / "none.safetensors"
    assert cli.run(["bake", *argv, "--out", str(out), *quick(*argv)]) == 2
    assert not out.exists()
    err = capsys.readouterr().err
    assert err.startswith("prtnet: error: ")
    assert err.count("\n") == 1
    return err


@pytest.mark.parametrize("name", ["weave", "swirl", "bumps", "waffle"])
def test_patterns(name: str, tmp_path: Path) -> None:
    field = baked(tmp_path, name, "--size", "16x12", "--metres", "0.04")
    assert isinstance(field.layout, Patch)
    assert field.layout.heights.shape == (12, 16)
    assert field.layout.size == pytest.approx((0.04, 0.03))
    assert field.layout.heights.max() <= 0.004 + 1e-9
    assert field.metadata["source"] == name
    assert field.facts()["tiles"] == [True, True]


def test_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "ramp.png"
    Image.fromarray(np.tile(np.arange(0, 240, 10, dtype=np.uint8), (8, 1))).save(path)
    field = baked(tmp_path, str(path), "--depth", "0.02")
    assert isinstance(field.layout, Patch)
    assert field.layout.heights.shape == (8, 24)
    assert field.layout.tiles == (False, True)
    assert field.layout.heights.max() == pytest.approx(0.02 * 230 / 255, rel=1e-5)
    assert baked(tmp_path, str(path), "--edges", "wrap").facts()["tiles"] == [True, True]
    ended = baked(tmp_path, "waffle", "--size", "6x6", "--edges", "clamp")
    assert ended.facts()["tiles"] == [False, False]
    out = str(tmp_path / "field.safetensors")
    assert cli.run(["bake", str(path), "--out", out, *QUICK]) == 0
    assert "does not tile" in capsys.readouterr().err


def test_mesh_and_its_json(tmp_path: Path) -> None:
    path, report = tmp_path / "ball.ply", tmp_path / "r.json"
    shapes.icosphere(1).export(path)
    field = baked(tmp_path, str(path), "--json", str(report))
    assert isinstance(field.layout, Surface)
    told = json.loads(report.read_text())
    assert told["points"] == 42
    assert told["layout"] == "mesh"
    assert told["bytes"] == (tmp_path / "field.safetensors").stat().st_size


def test_parametric_models(tmp_path: Path) -> None:
    flat = baked(tmp_path, "membrane", "--translucency", "0.25")
    assert flat.metadata["transparency"] == [0.25, 0.25]
    path = tmp_path / "map.png"
    Image.fromarray(np.array([[0, 255], [51, 51]], dtype=np.uint8)).save(path)
    field = baked(tmp_path, "membrane", "--translucency", str(path), "--albedo", "1")
    white = field.vectors[:, 0] * np.sqrt(4 * np.pi)
    np.testing.assert_allclose(white, [1.2, 1.2, 1, 2], rtol=1e-6)  # bottom row first
    groove = baked(tmp_path, "wrinkle", "--size", "4x3", "--depth", "0.02")
    assert groove.metadata["wrinkle"]["deepest"] == 0.02
    assert len(groove) == 12


def test_glossy_and_scattering(tmp_path: Path) -> None:
    field = baked(tmp_path, "bumps", "--size", "8x8", "--brdf", "gold", "--rows", "2")
    assert (field.rows, field.metadata["brdf"]) == (2, "gold")
    coloured = "ggx:roughness=0.5,diffuse=0.1/0.2/0.5"  # slashes that are no folders
    field = baked(tmp_path, "bumps", "--size", "4x4", "--brdf", coloured, "--rows", "1")
    assert field.metadata["brdf"] == coloured
    assert field.view is not None
    options = ("--subsurface", "marble", "--metres", "0.03", "--thickness", "0.002")
    field = baked(tmp_path, "waffle", "--size", "8x8", *options)
    assert field.metadata["thickness"] == 0.002
    assert field.metadata["subsurface"]["index"] == 1.5


def test_one_band_needs_no_rows(tmp_path: Path) -> None:
    out = tmp_path / "a.safetensors"
    argv = ["waffle", "--size", "4x4", "--order", "1", "--rays", "16", "--out", str(out), "--quiet"]
    assert cli.run(["bake", *argv]) == 0
    assert TransferField.load(out).order == 1
    assert cli.run(["bake", *argv, "--threads", "0"]) == 2


def test_seed_scatters(tmp_path: Path) -> None:
    one = baked(tmp_path, "bumps", "--size", "8x8", "--seed", "1")
    again = baked(tmp_path, "bumps", "--size", "8x8", "--seed", "1")
    other = baked(tmp_path, "bumps", "--size", "8x8", "--seed", "2")
    np.testing.assert_array_equal(one.transfer, again.transfer)
    assert np.abs(one.transfer - other.transfer).max() > 0.01


def test_info_knows_a_field(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    baked(tmp_path, "waffle", "--size", "4x4")
    assert cli.run(["info", str(tmp_path / "field.safetensors")]) == 0
    assert "waffle" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("argv", "why"),
    [
        (["wafle"], "did you mean 'waffle'"),
        (["a.mov"], "is no mesh, picture or pattern"),
        (["a.png"], "a.png: cannot be read"),
        (["a.ply"], "a.ply: does not exist"),
        (["a.glb"], "a.glb: "),
        (["waffle", "--order", "0"], "--order"),
        (["waffle", "--order", "99"], "--order"),
        (["waffle", "--rays", "0"], "--rays"),
        (["waffle", "--bounces", "-1"], "--bounces"),
        (["waffle", "--depth", "1e30"], "too far from 0"),
        (["waffle", "--albedo", "1.5"], "--albedo"),
        (["waffle", "--albedo", "nan"], "--albedo"),
        (["waffle", "--metres", "0"], "--metres"),
        (["waffle", "--depth", "inf"], "--depth"),
        (["waffle", "--thickness", "0.1"], "--thickness: needs --subsurface"),
        (["waffle", "--rows", "2"], "--rows: needs --brdf"),
        (["waffle", "--seed", "2"], "--seed: does nothing for a pattern; leave it out"),
        (["waffle", "--translucency", "0.5"], "--translucency: does nothing for a pattern"),
        (["waffle", "--subsurface", "milk", "--albedo=0.8"], "--albedo: is what --subsurface"),
        (["bumps", "--coherent"], "--coherent: needs --lobes"),
        (["a.png", "--seed", "0"], "--seed: does nothing for a picture"),
        (["a.ply", "--size", "4x4"], "--size: does nothing for a mesh"),
        (["a.ply", "--depth", "0.1"], "--depth: does nothing for a mesh"),
        (["a.ply", "--edges", "wrap"], "--edges: does nothing for a mesh"),
        (["a.ply", "--metres", "0.1"], "--metres: needs --subsurface"),
        (["a.safetensors", "--order", "3", "--lobes", "2"], "--order: does nothing for a field"),
        (["a.safetensors", "--brdf", "gold"], "--brdf: does nothing for a field"),
        (["wrinkle", "--edges", "wrap"], "--edges: does nothing for a wrinkle"),
        (["membrane", "--cluster", "tcp://a:1"], "--cluster: does nothing for a membrane"),
        (
            ["a.safetensors", "--lobes", "2", "--coherent", "--cluster", "tcp://a:1"],
            "--cluster: does nothing for coherent lobes",
        ),
        (["membrane", "--rays", "32"], "--rays: does nothing for a membrane"),
        (["membrane", "--subsurface", "milk"], "--subsurface: does nothing for a membrane"),
        (["membrane", "--bounces", "1"], "--bounces: does nothing for a membrane"),
        (["waffle", "--subsurface", "marbel"], "did you mean 'marble'"),
        (["waffle", "--subsurface", "0/1"], "--subsurface"),
        (["waffle", "--brdf", "golf"], "--brdf"),
        (["waffle", "--brdf", "gold", "--rows", "10"], "--rows"),
        (["waffle", "--size", "9999x9999"], "--size"),
        (["waffle", "--size", "4096x4096"], "too much to trace"),
        (["waffle", "--edges", "bend"], "edges"),
        (["wrinkle", "--size", "1x5"], "at least two columns"),
        (["wrinkle", "--subsurface", "marble", "--thickness", "0.1"], "nothing for a wrinkle"),
        (["membrane", "--translucency", "1.5"], "--translucency"),
        (["membrane", "--translucency", "nan"], "--translucency"),
        (["membrane", "--translucency", "b.png"], "b.png: cannot be read"),
        (["membrane", "--brdf", "gold"], "--brdf: does nothing for a membrane"),
    ],
)
def test_mistakes_are_one_line(
    argv: list[str], why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert why in complaint(capsys, tmp_path, *argv)


def test_an_option_that_is_its_default_is_given_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "--rows: needs --brdf" in complaint(capsys, tmp_path, "waffle", "--rows", "3")
    assert "--rays" in complaint(capsys, tmp_path, "membrane", "--rays=1024")


def test_mesh_has_no_thickness(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "ball.ply"
    shapes.icosphere(0).export(path)
    argv = (str(path), "--subsurface", "marble", "--thickness", "0.1")
    assert "--thickness: does nothing for a mesh" in complaint(capsys, tmp_path, *argv)


def test_outputs_are_checked_before_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.run(["bake", "waffle", "--out", str(tmp_path / "a.png")]) == 2
    assert ".safetensors" in capsys.readouterr().err
    missing = tmp_path / "no" / "a.safetensors"
    assert cli.run(["bake", "waffle", "--out", str(missing)]) == 2
    assert "make it first" in capsys.readouterr().err


def test_nan_in_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.tif"
    Image.fromarray(np.array([[np.nan, 1]], dtype=np.float32)).save(path)
    assert "not numbers" in complaint(capsys, tmp_path, str(path))


def test_warnings_say_what_is_missing() -> None:
    assert warnings_of({"diverges": True})[0].startswith("inter-reflection does not end")
    assert "up to 3 %" in warnings_of({"bounces": 2, "left": 0.03})[0]
    assert "unknown share" in warnings_of({"bounces": 2, "left": None})[0]
    assert warnings_of({"bounces": 0, "left": 3.0}) == []
    assert warnings_of({"bounces": 2, "left": 1e-3, "tiles": [True, True]}) == []
    assert "border" in warnings_of({"tiles": [True, False]})[0]
    assert warnings_of({"tiles": [False, False], "wrinkle": {}}) == []


def test_lobes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw, out = tmp_path / "raw.safetensors", tmp_path / "lobes.safetensors"
    assert cli.run(["bake", "waffle", "--size", "8x8", "--out", str(raw), *QUICK, "--quiet"]) == 0
    facts = tmp_path / "facts.json"
    argv = ["bake", str(raw), "--lobes", "3", "--out", str(out), "--json", str(facts)]
    assert cli.run(argv) == 0
    told = json.loads(facts.read_text())
    assert (told["lobes"], told["coherent"], told["source"]) == (3, False, "waffle")
    assert 0.0 < told["fit"]["error"] < 0.1
    capsys.readouterr()
    assert cli.run(["info", str(out)]) == 0
    assert "coherent" in capsys.readouterr().out
    at_once = LobeField.load(out)
    direct = tmp_path / "direct.safetensors"
    argv = ["bake", "waffle", "--size", "8x8", "--lobes", "3", "--out", str(direct), *QUICK]
    assert cli.run(argv) == 0
    np.testing.assert_array_equal(LobeField.load(direct).axes, at_once.axes)
    assert cli.run([*argv, "--coherent"]) == 0
    assert LobeField.load(direct).coherent


def test_lobes_that_cannot_be(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    raw = tmp_path / "raw.safetensors"
    assert cli.run(["bake", "membrane", "--out", str(raw), *quick("membrane"), "--quiet"]) == 0
    assert "baked already" in complaint(capsys, tmp_path, str(raw))
    assert "from 1 to" in complaint(capsys, tmp_path, "waffle", "--lobes", "0")
    assert "--lobes" in complaint(capsys, tmp_path, "waffle", "--coherent")
