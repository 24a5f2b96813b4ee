from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from prtnet import cli
from prtnet.all_frequency_file import save_fields
from prtnet.array_file import ALL_FREQUENCY, kind_named
from tests.all_frequency import ball, random_field
from tests.runtime.test_all_frequency_shot import on_ground

SMALL = ["--size", "48x40", "--quiet", "--threads", "1"]


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of a field, and of one on a ground."""
    folder = tmp_path_factory.mktemp("all_frequency")
    save_fields(folder / "ball.safetensors", [random_field(3, ball(2))])
    save_fields(folder / "on ground.safetensors", on_ground())
    return folder


def rendered(files: Path, out: Path, name: str, *argv: str) -> dict:
    facts = out.with_suffix(".json")
    base = ["render", str(files / f"{name}.safetensors"), "--out", str(out), *SMALL]
    assert cli.run([*base, "--json", str(facts), *argv]) == 0
    return json.loads(facts.read_text())


def test_a_picture_and_facts_about_it(files, tmp_path):
    told = rendered(files, tmp_path / "a.png", "ball", "--renderer", "cpu")
    picture = np.asarray(Image.open(tmp_path / "a.png"))
    assert picture.shape == (40, 48, 3)
    assert picture.max() > 150
    assert told["points"] == 162
    assert told["rows"] == 3


@pytest.mark.gl
def test_opengl_draws_what_numpy_draws(files, tmp_path):
    for renderer in ("gl", "cpu"):
        out = tmp_path / f"{renderer}.png"
        rendered(files, out, "on ground", "--renderer", renderer, "--light", "sunset")
    got, want = (np.asarray(Image.open(tmp_path / f"{name}.png"), int) for name in ("gl", "cpu"))
    assert (np.abs(got - want).max(axis=-1) <= 2).mean() >= 0.999


def test_what_stands_beside_the_object_can_be_left_out(files, tmp_path):
    both = rendered(files, tmp_path / "a.png", "on ground", "--renderer", "cpu")
    alone = rendered(files, tmp_path / "b.png", "on ground", "--renderer", "cpu", "--alone")
    assert both["beside_1"]["points"] == 36
    assert "beside_1" not in alone
    assert (tmp_path / "a.png").read_bytes() != (tmp_path / "b.png").read_bytes()


@pytest.mark.parametrize("spins", ["camera", "light"])
def test_all_around(files, tmp_path, spins, monkeypatch):
    """Half way around, the light is as one that was turned by so much."""
    monkeypatch.setattr("runtime.picture.auto_exposure", lambda _: 0.1)
    argv = ["--renderer", "cpu", "--light", "window"]
    spun = rendered(files, tmp_path / "a.png", "ball", *argv, "--spin", "2", "--spins", spins)
    assert [Path(name).name for name in spun["out"]] == ["a_0.png", "a_1.png"]
    rendered(files, tmp_path / "b.png", "ball", *argv)
    rendered(files, tmp_path / "c.png", "ball", *argv, "--light-turn", "180")
    first, second, still, turned = (
        (tmp_path / f"{name}.png").read_bytes() for name in ("a_0", "a_1", "b", "c")
    )
    assert first == still != second
    assert (second == turned) == (spins == "light")


def test_a_truncated_light(files, tmp_path):
    """All 384 wavelets are the whole light; of a few, which they are says the order."""
    pictures = {}
    for name, argv in {
        "whole": [], "all": ["--keep", "384"], "few": ["--keep", "40"],
        "by area": ["--keep", "40", "--keep-by", "area"],
        "by transfer": ["--keep", "40", "--keep-by", "transfer"],
    }.items():  # fmt: skip
        out = tmp_path / f"{name}.png"
        rendered(files, out, "ball", "--renderer", "cpu", "--light", "sunset", *argv)
        pictures[name] = out.read_bytes()
    assert pictures["whole"] == pictures["all"]
    assert len(set(pictures.values())) == 4


def test_a_movie(files, tmp_path):
    av = pytest.importorskip("av")
    argv = ["--spin", "3", "--spins", "light", "--renderer", "cpu"]
    rendered(files, tmp_path / "a.mp4", "ball", *argv)
    with av.open(str(tmp_path / "a.mp4")) as movie:
        assert len(list(movie.decode(video=0))) == 3


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--out", "a.jpg"], "end it in .png or .mp4"),
        (["--out", "a.mp4"], "--spin: is missing"),
        (["--spins", "light"], "--spin: is missing"),
        (["--spin", "1000"], "--spin: is 1000; it must be from 1 to 999"),
        (["--zoom", "0"], "--zoom: is 0"),
        (["--keep", "0"], "--keep: is 0"),
        (["--keep-by", "area"], "--keep: is missing"),
        (["--light", "moonshine"], "is neither a file nor a preset"),
        (["--size", "9000x10"], "--size: is too large"),
    ],
)
def test_bad_options_end_in_one_line(files, tmp_path, monkeypatch, capsys, argv, said):
    monkeypatch.chdir(tmp_path)
    base = ["render", str(files / "ball.safetensors"), "--out", "a.png", *SMALL]
    assert cli.run([*base, *argv]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_the_kind_of_a_file_decides(files):
    field = str(files / "ball.safetensors")
    assert kind_named(["--light", "sky", "absent.safetensors", field]) == ALL_FREQUENCY
    assert kind_named(["--light", "sky"]) is None


def test_info_tells_of_all_that_stands_there(files, tmp_path):
    facts = tmp_path / "facts.json"
    argv = ["info", str(files / "on ground.safetensors"), "--json", str(facts), "--quiet"]
    assert cli.run(argv) == 0
    told = json.loads(facts.read_text())
    assert (told["points"], told["rows"], told["cube_map"]) == (162, 3, 8)
    assert told["beside_1"]["rows"] == 1
