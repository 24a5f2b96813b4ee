"""The commands one after another on a small character, as a user runs them."""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import json
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import onnx
import pytest
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from data_gen.readers import read_scene
from data_gen.visibility import Tracer, trace_pose
from prtnet import cli, cli_demo, sh
from prtnet.console import Console, Report
from prtnet.dataset import Dataset
from prtnet.model import VisibilityModel
from prtnet.modelled_scene import ModelledScene
from prtnet.seams import JumpSum, cluster_of_receiver, receiver_edges


def prtnet(*argv: str | Path) -> None:
    assert cli.run([str(word) for word in argv]) == 0


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a scene, its dataset and a linear model."""
    folder = tmp_path_factory.mktemp("pipeline")
    write_glb(arm(segments=10), folder / "arm.glb")
    effort = ("--count", "24", "--rays", "256", "--threads", "2", "--quiet")
    prtnet("generate", folder / "arm.glb", "--out", folder / "arm.zarr", *effort)
    fit = ("--kind", "linear", "--clusters", "6", "--alpha", "0.001", "--quiet")
    prtnet("train", folder / "arm.zarr", "--out", folder / "arm.safetensors", *fit)
    return folder


def failure(capsys: pytest.CaptureFixture[str], *argv: str | Path) -> str:
    """The one line that a command fails with."""
    assert cli.run([str(word) for word in argv]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("prtnet: error: ")
    assert err.count("\n") == 1
    return err


def test_options_reach_the_dataset(work: Path) -> None:
    dataset = Dataset.open(work / "arm.zarr")
    assert (len(dataset), dataset.rays, dataset.order) == (24, 256, 4)


def test_options_reach_the_model(work: Path) -> None:
    model = VisibilityModel.load(work / "arm.safetensors")
    assert model.kind == "linear"
    assert len(model.latents) == 6
    assert model.metadata["config"]["alpha"] == 0.001


def test_preset_is_where_options_start_from(work: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.safetensors"
    options = ("--preset", "paper", "--kind", "linear", "--clusters", "5", "--quiet")
    prtnet("train", work / "arm.zarr", "--out", out, *options)
    config = VisibilityModel.load(out).metadata["config"]
    assert config["features"] == "joint_angles"
    assert (config["kind"], config["clusters"]) == ("linear", 5)


def test_evaluation_of_a_dataset(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    report = work / "errors.json"
    prtnet("evaluate", work / "arm.safetensors", work / "arm.zarr", "--json", report)
    results = json.loads(report.read_text())
    contract = {"clips", "rms", "signal", "nearest", "pca_floor", "ms_per_pose", "model_bytes"}
    assert contract <= set(results)
    beside = {"coherence", "distance", "nearest_distance"}
    assert set(results["clips"]["bend"]) == {"rms", "p99", "max", "held_out"} | beside
    assert 0 < results["coherence"] < 1
    assert results["distance"]["max"] < 1e-4  # every pose is a training pose
    assert results["nearest_distance"]["max"] < 0.05
    assert [pose["clip"] for pose in results["poses"]] == 24 * ["bend"]
    assert results["poses"][-1]["time"] == 4.0
    assert results["pca_floor"] <= results["rms"] < results["signal"]
    assert results["nearest"] == 0  # every pose is a training pose
    assert results["model_bytes"] == (work / "arm.safetensors").stat().st_size
    text = capsys.readouterr().out
    assert f"{100 * results['rms']:.2f} %" in text
    worst = max(results["poses"], key=lambda pose: pose["rms"])
    assert f"bend at {worst['time']:.2f} s" in text


def test_evaluation_of_a_scene_agrees(work: Path) -> None:
    one, two = work / "dataset.json", work / "scene.json"
    model = work / "arm.safetensors"
    prtnet("evaluate", model, work / "arm.zarr", "--json", one, "--quiet")
    again = ("--fps", "5.75", "--rays", "256", "--clips", "bend", "--quiet")  # the same 24 poses
    prtnet("evaluate", model, work / "arm.glb", "--json", two, *again)
    expected, results = json.loads(one.read_text()), json.loads(two.read_text())
    assert results["rms"] == pytest.approx(expected["rms"], rel=1e-4)
    assert results["signal"] == pytest.approx(expected["signal"], rel=1e-4)
    assert results["nearest"] is None
    assert [pose["time"] for pose in results["poses"]] == pytest.approx(
        [pose["time"] for pose in expected["poses"]], abs=1e-4
    )
    assert results["poses"][3]["nearest_distance"] is None
    assert results["clips"]["bend"]["held_out"] is False


def require_no_seams(work: Path, model: VisibilityModel) -> None:
    """The error jumps less across borders than visibility itself varies inside clusters."""
    data = Dataset.open(work / "arm.zarr")
    edges = receiver_edges(data.faces, data.receiver_of_vertex)
    owner = cluster_of_receiver(model.receivers)
    truth = data.read("visibility")
    errors, truths = JumpSum(edges), JumpSum(edges)
    errors.add(model(data.read("pose")) - truth)
    truths.add(truth)
    assert 0.0 < errors.rms(owner)[0] < 0.5 * truths.rms(owner)[1]


def test_borders_of_clusters_do_not_show(work: Path) -> None:
    require_no_seams(work, VisibilityModel.load(work / "arm.safetensors"))


def test_a_limit_on_the_error_finds_a_model(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "found.safetensors"
    prtnet("train", work / "arm.zarr", "--out", out, "--max-error", "15%", "--clusters", "6")
    text = capsys.readouterr().out
    assert "expected error" in text
    assert "neural, large" in text
    told = VisibilityModel.load(out).metadata["search"]
    assert told["budget"] == {"max_error": 0.15, "max_ms": None, "max_mb": None}
    assert told["chosen"]["error"] <= 0.15


def test_clip_that_training_did_not_see_counts_as_held_out(work: Path, tmp_path: Path) -> None:
    """The mesh is the same, so the model takes it; the clip is not one of its own."""
    scene, report = tmp_path / "again.glb", tmp_path / "errors.json"
    limb = arm(segments=10)
    clip = dataclasses.replace(limb.clips[0], name="later")
    write_glb(dataclasses.replace(limb, clips=(clip,)), scene)
    options = ("--fps", "0.5", "--rays", "16", "--json", report, "--quiet")
    prtnet("evaluate", work / "arm.safetensors", scene, *options)
    assert json.loads(report.read_text())["clips"]["later"]["held_out"] is True


def test_dump_is_what_the_model_says_in_the_world(work: Path, tmp_path: Path) -> None:
    """With the truth in place of a prediction, a tracer that knows only the dump agrees."""
    model = VisibilityModel.load(work / "arm.safetensors")
    actor = ModelledScene(model, read_scene(work / "arm.glb"))

    def truth(poses: np.ndarray) -> np.ndarray:
        return trace_pose(actor.scene, actor.receivers, actor.frame_field, poses, rays=2048)

    path = tmp_path / "dump.npz"
    assert actor.dump(path, ["bend"], 0.5, truth) == 3  # 0, 2 and 4 s
    with np.load(path, allow_pickle=False) as dump:
        positions, normals, faces = (dump[n] for n in ("positions", "normals", "faces"))
        visibility = dump["visibility"]
    directions = sh.fibonacci_sphere(4096).astype(np.float32)
    tracer = Tracer(positions[1], faces)
    origins = tracer.origins(positions[1], normals[1])
    rays = np.tile(directions, (len(origins), 1)), np.repeat(origins, len(directions), axis=0)
    hit = tracer.occluded(rays[1].astype(np.float32), rays[0]).reshape(len(origins), -1)
    above = normals[1] @ directions.T >= 0
    own = 1.0 - (hit & above)
    expected = own @ sh.evaluate(directions.astype(np.float64), 4) * (4 * math.pi / 4096)
    difference = np.linalg.norm(visibility[1] - expected) / np.linalg.norm(expected)
    assert difference < 0.01  # the two sets of rays
    assert np.abs(expected[:, 0] - math.sqrt(4 * math.pi)).max() > 0.5  # the pose is shadowed


def test_dump_of_a_prediction(work: Path, tmp_path: Path) -> None:
    path = tmp_path / "dump.npz"
    options = ("--fps", "1", "--rays", "16", "--dump", path, "--quiet")
    prtnet("evaluate", work / "arm.safetensors", work / "arm.glb", *options)
    with np.load(path, allow_pickle=False) as dump:
        poses, receivers = dump["positions"].shape[:2]
        assert poses == 5
        assert dump["visibility"].shape == (poses, receivers, 16)
        assert dump["normals"].shape == (poses, receivers, 3)
        assert dump["faces"].max() < receivers
        assert np.linalg.norm(dump["normals"], axis=-1) == pytest.approx(1.0, abs=1e-5)


def test_export(work: Path, tmp_path: Path) -> None:
    folder = tmp_path / "export"
    for _ in range(2):  # an earlier export is replaced
        prtnet("export", work / "arm.safetensors", "--out", folder, "--quiet")
    files = {"model.onnx", "model.json", "README.md"}
    files |= {"latent.onnx", "gpu.bin", "gpu.json", "prtnet.glsl"}
    assert {file.name for file in folder.iterdir()} == files
    for graph in ("model.onnx", "latent.onnx"):
        onnx.checker.check_model(str(folder / graph))
    size = (folder / "gpu.bin").stat().st_size
    facts = json.loads((folder / "model.json").read_text())
    receivers = facts["receivers"]
    assert np.shape(facts["rest_tangents"]) == (receivers, 3)
    text = (folder / "README.md").read_text()
    assert f"(poses, {receivers}, 16)" in text
    assert f"(poses, {facts['latents']})" in text
    options = ("--storage", "int8", "--quiet")
    prtnet("export", work / "arm.safetensors", "--out", folder, *options)
    assert (folder / "gpu.bin").stat().st_size < 0.6 * size
    assert json.loads((folder / "model.json").read_text())["storage"] == "int8"


@pytest.mark.parametrize("kind", ["hybrid", "shared"])
def test_models_that_look_around_every_receiver(kind: str, work: Path, tmp_path: Path) -> None:
    out, report = tmp_path / "m.safetensors", tmp_path / "errors.json"
    effort = ("--steps", "200", "--samples", "20000", "--latents", "2", "--clusters", "5")
    options = ("--kind", kind, "--storage", "int8", "--alpha", "0.01", *effort, "--quiet")
    prtnet("train", work / "arm.zarr", "--out", out, *options)
    prtnet("evaluate", out, work / "arm.zarr", "--json", report, "--quiet")
    errors = json.loads(report.read_text())
    assert errors["rms"] < errors["signal"]
    assert errors["pca_floor"] <= errors["rms"]
    require_no_seams(work, VisibilityModel.load(out))
    folder = tmp_path / "export"
    prtnet("export", out, "--out", folder, "--quiet")
    files = {"model.onnx", "model.json", "README.md", "occluders.onnx"}
    files |= {"latent.onnx", "gpu.bin", "gpu.json", "prtnet.glsl"}
    assert {file.name for file in folder.iterdir()} == files
    assert "`occluders.onnx` turns the pose" in (folder / "README.md").read_text()
    picture = ("--out", tmp_path / "frame.png", "--size", "40x40", "--renderer", "cpu", "--quiet")
    prtnet("render", out, work / "arm.glb", *picture)


def test_export_of_a_point_cache_model_says_so(work: Path, tmp_path: Path) -> None:
    from training.export import export_folder

    model = VisibilityModel.load(work / "arm.safetensors")
    model.metadata["scene_kind"] = "point_cache"
    export_folder(model, tmp_path / "export")
    assert "vertices' positions" in (tmp_path / "export" / "README.md").read_text()


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def test_render_beside_the_truth(work: Path, tmp_path: Path, renderer: str) -> None:
    out, report = tmp_path / "frame.png", tmp_path / "frame.json"
    options = ("--time", "2", "--size", "80x60", "--compare", "truth", "--rays", "64")
    scene = work / "arm.safetensors", work / "arm.glb"
    prtnet("render", *scene, "--out", out, "--json", report, "--renderer", renderer, *options)
    with Image.open(out) as picture:
        assert picture.width > 3 * 80
        assert picture.height > 60
    error = json.loads(report.read_text())["error_in_per_cent_of_white"]
    assert 0 < error["rms"] < 10


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def test_render_of_a_material_beside_its_truth(work: Path, tmp_path: Path, renderer: str) -> None:
    report = tmp_path / "frame.json"
    options = ("--time", "2", "--size", "80x60", "--rays", "64", "--quiet", "--renderer", renderer)
    look = ("--brdf", "phong:exponent=4", "--light", "sky", "--light-turn", "90", "--lobes", "3")
    scene = work / "arm.safetensors", work / "arm.glb"
    errors = {}
    for kind in ("truth", "visibility"):
        out = ("--out", tmp_path / f"{kind}.png", "--json", report, "--compare", kind)
        prtnet("render", *scene, *out, *look, *options)
        facts = json.loads(report.read_text())
        assert (facts["brdf"], facts["lobes"]) == ("phong:exponent=4", 3)
        errors[kind] = facts["error_in_per_cent_of_white"]["rms"]
    assert 0 < errors["visibility"] < errors["truth"] < 15


@pytest.mark.parametrize("renderer", ["cpu", pytest.param("gl", marks=pytest.mark.gl)])
def test_lobes_have_an_exponent_of_their_own(work: Path, tmp_path: Path, renderer: str) -> None:
    """A model of lobes, its material beside what rays say of it; not of light through a body."""
    model, report = tmp_path / "lobes.safetensors", tmp_path / "frame.json"
    fit = ("--kind", "lobes", "--lobes", "2", "--clusters", "6", "--threads", "1", "--quiet")
    prtnet("train", work / "arm.zarr", "--out", model, *fit)
    options = ("--time", "2", "--size", "80x60", "--rays", "64", "--quiet", "--renderer", renderer)
    look = ("--brdf", "lobe:exponent=4.5", "--light", "sky", "--light-turn", "90")
    for kind in ("truth", "visibility"):
        out = ("--out", tmp_path / f"{kind}.png", "--json", report, "--compare", kind)
        prtnet("render", model, work / "arm.glb", *out, *look, *options)
        facts = json.loads(report.read_text())
        assert facts["brdf"] == "lobe:exponent=4.5"
        assert 0 < facts["error_in_per_cent_of_white"]["rms"] < 12
    through = ("--out", tmp_path / "x.png", "--compare", "truth", "--brdf", "lobe:transmitted=0.2")
    words = ("render", model, work / "arm.glb", *through, *options)
    assert cli.run([str(word) for word in words]) == 2


@pytest.mark.parametrize(
    ("option", "value", "told"),
    [
        ("--brdf", "gild", "did you mean 'gold'"),
        ("--brdf", "ggx:roughness=7", "at most 1"),
        ("--brdf", "lobe", "of models that --kind lobes trained"),
        ("--light", "moon", "neither a file nor a preset"),
        ("--lobes", "-1", "from 0 to 11"),
        ("--lobes", "12", "from 0 to 11"),
        ("--factors", "99", "64"),
        ("--order", "0", "at least 1"),
        ("--order", "9", "has 4 bands"),
        ("--vertex", "99999", "counted from 0"),
        ("--vertex", "-1", "at least 0"),
        ("--blend", "bend", "CLIP:SECONDS:SHARE"),
        ("--blend", "bend:1:2", "from 0 to 1"),
        ("--blend", "bend:9:0.5", "0 to 4 s"),
        ("--blend", "bnd:1:0.5", "has no clip"),
        ("--split", "1.5", "from 0 to 1"),
        ("--elevation", "90", "89"),
        ("--zoom", "0", "from 0.1 to 100"),
        ("--fps", "0", "from 1 to 240"),
        ("--fps", "12", "is of movies"),
        ("--split", "0.3", "add --beside"),
        ("--rays", "8", "add --compare truth"),
        ("--show", "shadow", "prediction"),
    ],
)
def test_looks_that_there_are_none_of(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], option, value, told
) -> None:
    scene = work / "arm.safetensors", work / "arm.glb"
    message = failure(capsys, "render", *scene, "--out", tmp_path / "x.png", option, value)
    assert told in message
    assert not list(tmp_path.iterdir())


def test_render_alone_has_the_size_asked_for(work: Path, tmp_path: Path) -> None:
    out = tmp_path / "frame.png"
    options = ("--size", "80x60", "--renderer", "cpu", "--light", "sky", "--quiet")
    prtnet("render", work / "arm.safetensors", work / "arm.glb", "--out", out, *options)
    with Image.open(out) as picture:
        assert picture.size == (80, 60)
        assert np.ptp(np.asarray(picture)) > 100  # something is drawn


def test_pictures_all_around(work: Path, tmp_path: Path) -> None:
    options = (
        "--size",
        "40x30",
        "--renderer",
        "cpu",
        "--spin",
        "11",
        "--dering",
        "0.05",
        "--quiet",
    )
    out = tmp_path / "turn.png"
    prtnet("render", work / "arm.safetensors", work / "arm.glb", "--out", out, *options)
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == [f"turn_{number:02d}.png" for number in range(11)]
    pictures = [np.asarray(Image.open(tmp_path / name)) for name in names]
    assert not np.array_equal(pictures[0], pictures[5])


def test_a_picture_of_everything_a_viewer_shows(work: Path, tmp_path: Path) -> None:
    scene = work / "arm.safetensors", work / "arm.glb"
    options = ("--size", "80x60", "--renderer", "cpu", "--quiet", "--time", "2")
    options += ("--brdf", "phong:exponent=9")
    rays = "--rays", "32"
    looks: dict[str, tuple[str, ...]] = {
        mode: ("--show", mode) for mode in ("prediction", "open", "ambient")
    } | {mode: ("--show", mode, *rays) for mode in ("truth", "visibility", "error")}
    looks |= {
        "blend": ("--blend", "bend:0:0.5"),
        "order": ("--order", "1"),
        "vertex": ("--vertex", "30"),
        "traced": ("--vertex", "30", "--show", "visibility", *rays),
        "camera": ("--azimuth", "120", "--elevation", "40"),
        "zoom": ("--zoom", "1.5"),
        "exposure": ("--exposure", "-2"),
        "split": ("--beside", "error", "--split", "0.25", *rays),
    }
    pictures = {}
    for name, look in looks.items():
        prtnet("render", *scene, "--out", tmp_path / f"{name}.png", *look, *options)
        pictures[name] = np.asarray(Image.open(tmp_path / f"{name}.png")).astype(int)
        assert pictures[name].shape == (60, 80, 3)
    for one, other in itertools.combinations(pictures, 2):
        assert np.abs(pictures[one] - pictures[other]).max() > 8, (one, other)
    assert np.array_equal(pictures["split"][:, :20], pictures["prediction"][:, :20])
    assert np.array_equal(pictures["split"][:, 20:], pictures["error"][:, 20:])


def test_movies_play_the_clip_or_turn(work: Path, tmp_path: Path) -> None:
    av = pytest.importorskip("av")
    scene = work / "arm.safetensors", work / "arm.glb"
    options = ("--size", "41x30", "--renderer", "cpu", "--quiet", "--fps", "2")
    report = tmp_path / "clip.json"
    prtnet("render", *scene, "--out", tmp_path / "clip.mp4", *options, "--json", report)
    assert json.loads(report.read_text())["pictures"] == 9  # four seconds, both ends
    prtnet("render", *scene, "--out", tmp_path / "turn.mp4", *options, "--spin", "5")
    for name, count in (("clip", 9), ("turn", 5)):
        with av.open(str(tmp_path / f"{name}.mp4")) as file:
            frames = [frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)]
        assert len(frames) == count
        assert frames[0].shape == (30, 42, 3)
        assert np.abs(frames[0].astype(int) - frames[2]).max() > 30


@pytest.mark.parametrize("name", ["arm.glb", "arm.zarr", "arm.safetensors"])
def test_info(work: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    prtnet("info", work / name)
    assert "bend" in capsys.readouterr().out


def test_another_scene_is_refused(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other, model = tmp_path / "other.glb", work / "arm.safetensors"
    limb = arm(segments=10)
    write_glb(dataclasses.replace(limb, positions=1.1 * limb.positions), other)
    assert "not the mesh" in failure(capsys, "evaluate", model, other)
    out = ("--out", tmp_path / "frame.png")
    assert "not the mesh" in failure(capsys, "render", model, other, *out)
    assert list(tmp_path.iterdir()) == [other]


def test_two_sided_data_is_refused_by_a_model_of_one_side(
    work: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    both = tmp_path / "both.zarr"
    effort = ("--count", "2", "--rays", "8", "--threads", "1", "--two-sided", "--quiet")
    prtnet("generate", work / "arm.glb", "--out", both, *effort)
    told = failure(capsys, "evaluate", work / "arm.safetensors", both)
    assert "number of receivers" in told


def test_clip_that_is_named_twice_counts_once(work: Path, tmp_path: Path) -> None:
    path = tmp_path / "dump.npz"
    options = ("--clips", "bend,bend", "--fps", "1", "--rays", "16", "--dump", path, "--quiet")
    prtnet("evaluate", work / "arm.safetensors", work / "arm.glb", *options)
    with np.load(path, allow_pickle=False) as dump:
        assert len(dump["positions"]) == 5


def test_dump_tells_how_far_it_is(work: Path, tmp_path: Path) -> None:
    model = VisibilityModel.load(work / "arm.safetensors")
    actor = ModelledScene(model, read_scene(work / "arm.glb"))
    told: list[tuple[int, int]] = []
    actor.dump(
        tmp_path / "dump.npz", ["bend"], 0.5, model, lambda done, total: told.append((done, total))
    )
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_slow_steps_report(work: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[str] = []

    @contextlib.contextmanager
    def progress(console: Console) -> Iterator[Report]:
        del console
        yield lambda what, *_: told.append(what)

    monkeypatch.setattr(Console, "progress", progress)
    scene = work / "arm.safetensors", work / "arm.glb"
    picture = ("--out", tmp_path / "x.png", "--size", "40x30", "--renderer", "cpu", "--rays", "8")
    prtnet("render", *scene, *picture, "--compare", "truth", "--quiet")
    prtnet("evaluate", *scene, "--dump", tmp_path / "x.npz", "--fps", "1", "--rays", "8", "--quiet")
    assert list(dict.fromkeys(told)) == ["material", "pictures", "dumped poses", "poses"]


def test_demonstration(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "demo"
    prtnet("demo", "--quick", "--out", folder, "--json", tmp_path / "paths.json")
    paths = json.loads((tmp_path / "paths.json").read_text())
    assert paths == {
        "onnx": str(folder / "export" / "model.onnx"),
        "picture": str(folder / "frame.png"),
        "errors": str(folder / "errors.json"),
    }
    onnx.checker.check_model(paths["onnx"])
    with Image.open(paths["picture"]) as picture:
        assert picture.format == "PNG"
        assert np.ptp(np.asarray(picture)) > 100
    errors = json.loads(Path(paths["errors"]).read_text())
    assert errors["clips"]["dance"]["held_out"] is True
    out, err = capsys.readouterr()
    table = [line.split() for line in out.splitlines()]
    assert ["clips", "rms", "p99", "max", "held", "out"] in [line[:6] for line in table]
    assert f"{100 * errors['clips']['dance']['rms']:.2f}" in out
    assert [line for line in out.splitlines() if line.split()[-1:] == [paths["onnx"]]]
    assert paths["picture"] in out
    assert paths["errors"] in out
    assert err.count("\n$ prtnet ") == len(cli_demo.demo_steps(folder, ["dance"]))


BAD: list[tuple[Sequence[str], str]] = [
    (("generate", "arm.zarr", "--out", "x.zarr"), "is a folder where a file is wanted"),
    (("generate", "arm.glb", "--out", "."), "other files, not replaced"),
    (("generate", "arm.glb", "--out", "x.zarr", "--holdout", "bnd"), "did you mean 'bend'"),
    (("generate", "arm.glb", "--out", "x.zarr", "--rays", "0"), "--rays: must be at least 1"),
    (("train", "arm.glb", "--out", "x.safetensors"), "is not a dataset"),
    (("train", "arm.zarr", "--out", "x.safetensors", "--preset", "papre"), "'paper'"),
    (("train", "arm.zarr", "--out", "x.safetensors", "--max-error", "5"), "5% or 0.05"),
    (("train", "arm.zarr", "--out", "x.safetensors", "--max-error", "five"), "--max-error"),
    (("train", "arm.zarr", "--out", "x.safetensors", "--max-mb", "0"), "above 0"),
    (("train", "arm.zarr", "--out", "x.safetensors", "--device", "abacus"), "--device"),
    (("train", "arm.zarr", "--out", "no/x.safetensors"), "there is no folder"),
    (("evaluate", "arm.glb", "arm.zarr"), "arm.glb: "),
    (("evaluate", "arm.safetensors", "arm.zarr", "--clips", "bnd"), "did you mean 'bend'"),
    (("evaluate", "arm.safetensors", "arm.zarr", "--dump", "x.npz"), "needs a scene"),
    (("evaluate", "arm.safetensors", "arm.glb", "--fps", "0"), "--fps: is 0"),
    (("render", "arm.safetensors", "arm.glb", "--out", "x.png", "--clip", "bnd"), "'bend'"),
    (("render", "arm.safetensors", "arm.glb", "--out", "x.png", "--time", "9"), "0 to 4 s"),
    (
        ("render", "arm.safetensors", "arm.glb", "--out", "x.png", "--light", "suno"),
        "did you mean 'sun'",
    ),
    (("generate", "arm.glb", "--out", "arm.glb"), "is also an input"),
    (("generate", "arm.glb", "--out", "x.zarr", "--seed", "-1"), "--seed: must be at least 0"),
    (("evaluate", "arm.safetensors", "arm.glb", "--fps", "inf"), "--fps: is inf"),
    (("evaluate", "arm.safetensors", "arm.glb", "--fps", "nan"), "--fps: is nan"),
    (("evaluate", "arm.safetensors", "arm.zarr", "--json", "arm.zarr/zarr.json"), "an input"),
    (("evaluate", "arm.safetensors", "arm.glb", "--dump", "x", "--json", "./x"), "is named twice"),
    (("info", "arm.glb", "--json", "arm.glb"), "is named twice"),
    (("render", "arm.safetensors", "arm.glb", "--out", "x.png", "--time", "nan"), "0 to 4 s"),
    (("render", "arm.safetensors", "arm.glb", "--out", "x.jpg"), "end it in .png"),
    (("render", "arm.safetensors", "arm.glb", "--out", "x.mp4", "--time", "1"), "add --spin"),
    (
        (
            "render",
            "arm.safetensors",
            "arm.glb",
            "--out",
            "x.png",
            "--compare",
            "truth",
            "--show",
            "open",
        ),
        "leave out --show",
    ),
    (
        (
            "render",
            "arm.safetensors",
            "arm.glb",
            "--out",
            "x.png",
            "--light",
            "arm.glb",
            "--json",
            "arm.glb",
        ),
        "is named twice",
    ),
    (("export", "arm.safetensors", "--out", "."), "other files, not replaced"),
    (("info", "arm.png"), "does not exist"),
]


@pytest.mark.parametrize(("argv", "told"), BAD, ids=[" ".join(argv) for argv, _ in BAD])
def test_misuse_is_one_line(
    argv: Sequence[str],
    told: str,
    work: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(work)
    before = sorted(work.iterdir())
    assert told in failure(capsys, *argv)
    assert sorted(work.iterdir()) == before  # nothing is left behind


@pytest.mark.parametrize("step", cli_demo.demo_steps(Path("demo"), ["dance"]), ids=str)
def test_steps_of_the_demonstration_parse(
    step: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    (tmp_path / "demo").mkdir()
    assert "does not exist" in failure(capsys, *step)
