"""``prtnet render FIELD --compare truth``: what nothing bent is what was simulated."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh.creation as shapes

from prtnet import cli
from prtnet.lobe_fit import lobe_field
from prtnet.transfer import TransferField

QUICK = ["--rays", "64", "--order", "3", "--threads", "1", "--quiet"]
SCATTERS = ["--subsurface", "marble", "--metres", "0.03"]
BAKED = {
    "matte": ["bumps", "--size", "6x6", "--seed", "3"],
    "border": ["waffle", "--size", "6x6", "--edges", "clamp"],
    "glossy": ["bumps", "--size", "6x6", "--brdf", "gold", "--rows", "9"],
    "few rows": ["bumps", "--size", "6x6", "--brdf", "gold", "--rows", "2"],
    "thin": ["waffle", "--size", "6x6", *SCATTERS, "--thickness", "0.002"],
    "shiny milk": ["waffle", "--size", "4x4", *SCATTERS, "--brdf", "plastic", "--rows", "9"],
    "wrinkle": ["wrinkle", "--size", "5x3", "--bounces", "2"],
    "ball": ["BALL"],
    "ball of marble": ["BALL", *SCATTERS],
    "ball of gold": ["BALL", "--brdf", "gold", "--rows", "9"],
    "membrane": ["membrane"],
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where fields are made, and a mesh that hides some of itself."""
    made = tmp_path_factory.mktemp("truths")
    both = shapes.icosphere(1) + shapes.icosphere(1).apply_translation([1.6, 0.3, 0.2])
    both.export(made / "ball.ply")
    return made


def field(folder: Path, name: str) -> Path:
    path = folder / f"{name}.safetensors"
    if not path.exists():
        source = [str(folder / "ball.ply") if word == "BALL" else word for word in BAKED[name]]
        few = [*QUICK[2:]] if name == "membrane" else QUICK
        assert cli.run(["bake", *source, *few, "--out", str(path)]) == 0
    return path


def compared(path: Path, tmp_path: Path, *argv: str) -> dict[str, float]:
    """The picture's errors beside the truth."""
    out, facts = tmp_path / "a.png", tmp_path / "a.json"
    base = ["render", str(path), "--out", str(out), "--size", "40x40", "--quiet"]
    assert cli.run([*base, "--json", str(facts), "--compare", *argv]) == 0
    errors: dict[str, float] = json.loads(facts.read_text())["error_in_per_cent_of_white"]
    return errors


@pytest.mark.parametrize("name", [name for name in BAKED if name not in ("few rows", "membrane")])
def test_transfer_that_did_not_move_is_its_own_truth(name, folder, tmp_path) -> None:
    on = [] if name.startswith("ball") else ["--on", "plane"]
    assert compared(field(folder, name), tmp_path, "truth", *on)["rms"] < 0.01


@pytest.mark.parametrize("name", ["matte", "ball", "thin"])
def test_lobes_beside_truth_err_as_beside_the_transfer_they_were_fitted_to(
    name, folder, tmp_path
) -> None:
    raw, lobes = field(folder, name), tmp_path / "lobes.safetensors"
    lobe_field(TransferField.load(raw), 1).save(lobes)
    on = [] if name.startswith("ball") else ["--on", "plane"]
    traced = compared(lobes, tmp_path, "truth", "--renderer", "cpu", *on)
    beside = compared(lobes, tmp_path, str(raw), "--renderer", "cpu", *on)
    assert traced["rms"] == pytest.approx(beside["rms"], rel=1e-3)
    assert traced["rms"] > 0.02


def test_a_glossy_truth_has_the_rows_that_were_left_out(folder, tmp_path) -> None:
    few = compared(field(folder, "few rows"), tmp_path, "truth", "--on", "plane")
    assert few["rms"] > 1.0


@pytest.mark.parametrize("name", ["ball of marble", "ball of gold"])
def test_the_truth_is_of_what_is_posed(name, folder, tmp_path) -> None:
    """Twisted, two balls hide each other otherwise than they did."""
    turned = compared(field(folder, name), tmp_path, "truth", "--twist", "150")
    assert 0.3 < turned["rms"] < 30.0


def test_a_mesh_of_marble_remembers_its_size(folder, tmp_path) -> None:
    path = field(folder, "ball of marble")
    told = TransferField.load(path)
    assert told.metadata["longest"] == 0.03
    forgotten = {key: value for key, value in told.metadata.items() if key != "longest"}
    other = tmp_path / "old.safetensors"
    TransferField(told.transfer, told.layout, None, forgotten).save(other)
    assert compared(other, tmp_path, "truth")["rms"] > 0.5  # metres, not centimetres


@pytest.mark.parametrize(
    ("name", "argv", "said"),
    [
        ("matte", [], "truth of a patch is traced where it is flat; add --on plane"),
        ("matte", ["--on", "plane", "--twist", "20"], "traced where it is flat"),
        ("membrane", ["--on", "plane"], "a membrane is a formula"),
    ],
)
def test_what_has_no_truth(name, argv, said, folder, tmp_path, capsys) -> None:
    out = tmp_path / "b.png"
    base = ["render", str(field(folder, name)), "--out", str(out), "--compare", "truth", *argv]
    assert cli.run(base) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1
    assert not out.exists()


@pytest.mark.parametrize(
    "change",
    [
        {"rays": "many"}, {"rays": 1 << 30}, {"rays": None}, {"bounces": -1}, {"albedo": [1]},
        {"albedo": 7.0}, {"subsurface": {"scattering": 1.0}}, {"subsurface": 3},
        {"wrinkle": {"width": 1.0, "colour": 3}}, {"wrinkle": {"rows": 9}}, {"thickness": "thin"},
    ],
)  # fmt: skip
def test_fields_that_do_not_say_what_was_simulated(change, folder, tmp_path, capsys) -> None:
    told = TransferField.load(field(folder, "matte"))
    path = tmp_path / "odd.safetensors"
    TransferField(told.transfer, told.layout, None, {**told.metadata, **change}).save(path)
    out = str(tmp_path / "b.png")
    assert cli.run(["render", str(path), "--on", "plane", "--out", out, "--compare", "truth"]) == 2
    err = capsys.readouterr().err
    assert "--compare: truth needs what the field says of its simulation" in err
    assert err.count("\n") == 1


def test_a_glossy_field_without_its_material(folder, tmp_path, capsys) -> None:
    told = TransferField.load(field(folder, "few rows"))
    path = tmp_path / "odd.safetensors"
    for brdf in (None, "golf", "gone.binary"):
        facts = {**told.metadata, "brdf": brdf}
        TransferField(told.transfer, told.layout, told.view, facts).save(path)
        argv = ["--on", "plane", "--out", str(tmp_path / "b.png"), "--compare", "truth"]
        assert cli.run(["render", str(path), *argv]) == 2
        assert capsys.readouterr().err.count("\n") == 1
    assert np.isfinite(told.transfer).all()
