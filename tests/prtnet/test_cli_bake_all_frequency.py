from __future__ import annotations

import json
from pathlib import Path

import pytest
import trimesh

from prtnet import cli
from prtnet.all_frequency_file import load_fields, sizes

QUICK = ["--texels", "8", "--points-per-cluster", "40", "--terms", "4", "--threads", "1"]


@pytest.fixture
def prop(tmp_path: Path) -> Path:
    """A ball on a plate of two triangles that nobody else shares, in a .ply file."""
    path = tmp_path / "ball.ply"
    trimesh.creation.icosphere(subdivisions=2, radius=0.5).export(path)
    return path


def bake(path: Path, *argv: str) -> Path:
    out = path.with_name("field.safetensors")
    assert cli.run(["bake-all-frequency", str(path), "--out", str(out), *QUICK, *argv]) == 0
    return out


def test_a_matte_object_on_the_ground(
    prop: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("data_gen.all_frequency.ground.__defaults__", (12, 4.0))
    told = tmp_path / "told.json"
    out = bake(prop, "--ground", "--json", str(told))
    shown = capsys.readouterr().out
    field, ground = load_fields(out)
    assert (len(field), field.rows, field.size) == (162, 1, 8)
    assert (len(ground), ground.rows, ground.metadata["source"]) == (144, 1, "ground")
    assert (ground.surface.normals == [0.0, 1.0, 0.0]).all()
    # Nothing comes to the ground from below: faces -y and lower halves of the sides.
    assert all(ground.segments[4 * 3 + k].clusters == 0 for k in range(4))
    assert field.metadata["brdf"] == "matte"
    assert field.metadata["squared_error"]["stored"] < 0.02
    assert "in all" in shown
    assert f"{100 * field.metadata['squared_error']['stored']:.3f} %" in shown
    results = json.loads(told.read_text())
    assert results["bytes"] == out.stat().st_size
    assert results["sizes"] == sizes(field)
    assert results["beside_1"]["points"] == 144
    assert cli.run(["info", str(out)]) == 0
    assert "ball.ply" in capsys.readouterr().out


def test_a_glossy_object_with_fewer_vertices(prop: Path) -> None:
    out = bake(prop, "--brdf", "ggx:roughness=0.3", "--rows", "3", "--vertices", "60", "--quiet")
    (field,) = load_fields(out)
    assert (len(field), field.rows) == (60, 3)
    assert field.view.shape == (3, 1024, 3)
    told = field.metadata
    assert told["brdf"] == "ggx:roughness=0.3"
    assert 0.0 < told["factor_error"] < 1.0
    assert "threads" not in told["made_with"]  # they decide nothing


def test_a_smaller_error_takes_more_bytes(prop: Path) -> None:
    totals = []
    for error in ("20%", "1%"):
        (field,) = load_fields(bake(prop, "--error", error, "--quiet"))
        totals.append(sizes(field)["representatives"])
        assert field.metadata["squared_error"]["stored"] <= float(error[:-1]) / 100
    assert totals[0] < totals[1]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--rows", "0"], "--rows: is 0; it must be from 1 to 64"),
        (["--rows", "3"], "--rows: does nothing for a matte material"),
        (["--terms", "0"], "--terms: is 0"),
        (["--points-per-cluster", "0"], "--points-per-cluster: is 0"),
        (["--vertices", "3"], "--vertices: is 3; it must be at least 4"),
        (["--threads", "0"], "--threads: is 0"),
        (["--texels", "12"], "--texels: is 12; give 8, 16, 32 or 64"),
        (["--error", "many"], "--error: 'many' is no number"),
        (["--error", "150%"], "--error: is 150%"),
        (["--brdf", "golf"], "golf"),
    ],
)
def test_bad_options(
    words: list[str], said: str, prop: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = prop.with_name("none.safetensors")
    assert cli.run(["bake-all-frequency", str(prop), "--out", str(out), *words]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert said in error
    assert not out.exists()


def test_files_that_cannot_be(prop: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for source, out, said in (
        (prop, prop.with_name("a.npz"), "end it in .safetensors"),
        (prop.with_name("none.ply"), prop.with_name("a.safetensors"), "does not exist"),
        (prop.with_name("a.txt"), prop.with_name("a.safetensors"), "a.txt"),
    ):
        prop.with_name("a.txt").write_text("no mesh")
        assert cli.run(["bake-all-frequency", str(source), "--out", str(out)]) == 2
        assert said in capsys.readouterr().err


def test_edges_of_three_triangles_and_stray_vertices(tmp_path: Path) -> None:
    path = tmp_path / "wing.off"
    places = ["0 0 0", "1 0 0", "0 1 0", "0 0 1", "0 -1 0.2", "9 9 9"]
    path.write_text("\n".join(["OFF", "6 3 0", *places, "3 0 1 2", "3 0 1 3", "3 0 1 4"]) + "\n")
    (field,) = load_fields(bake(path, "--quiet"))
    assert len(field) == 5
    assert field.metadata["dropped"] == [0, 1]
