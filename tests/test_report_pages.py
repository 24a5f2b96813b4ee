"""``prtnet report`` on small datasets: the page is whole, and says what the JSON says."""

from __future__ import annotations

import base64
import dataclasses
import io
import json
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from data_gen.gltf_writer import write_glb
from data_gen.procedural import arm
from prtnet import cli
from prtnet.dataset import Dataset
from prtnet.light import load_light
from runtime.draw import opened
from runtime.error_pictures import data_uri, draw_error
from runtime.report_page import page, per_cent
from training.config import PRESETS

VOID = {"meta", "img", "br", "link", "input"}
IMAGE = "data:image/png;base64,AAAA"
TINY = dataclasses.replace(
    PRESETS["small"], latents=3, neurons=4, points=2, iterations=20,
    patches=8, near_patches=4, near_spheres=4, width=4, codes=2, steps=20, samples=500,
)  # fmt: skip


class Page(HTMLParser):
    """Checks that tags nest; collects what tests ask for."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.attributes: list[tuple[str, str, str]] = []
        self.rows: list[list[str]] = []
        self.words: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.note(tag, attrs)
        if tag not in VOID:
            self.open.append(tag)
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert "svg" in self.open
        self.note(tag, attrs)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data
        if "style" not in self.open:
            self.words.append(data)

    def note(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.attributes += [(tag, name, value or "") for name, value in attrs]


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Reports of an arm that bends two ways: both seen and, in ``held``, one held out."""
    folder = tmp_path_factory.mktemp("report")
    limb = arm(segments=10)
    (bend,) = limb.clips[0].channels
    across = dataclasses.replace(bend, values=bend.values[:, [0, 2, 1, 3]])
    later = dataclasses.replace(limb.clips[0], name="later & <b>", channels=(across,))
    write_glb(dataclasses.replace(limb, clips=(*limb.clips, later)), folder / "arm.glb")
    effort = ["--count", "6", "--rays", "32", "--threads", "1", "--quiet"]
    for name, extra in (("seen", []), ("held", ["--holdout", "later & <b>"])):
        data, out = str(folder / f"{name}.zarr"), str(folder / f"{name}.html")
        assert cli.run(["generate", str(folder / "arm.glb"), "--out", data, *effort, *extra]) == 0
        with pytest.MonkeyPatch.context() as patch:
            for sizes in ("SIZES", "AROUND_SIZES"):
                patch.setattr(f"training.sweep.{sizes}", {"small": TINY, "medium": TINY})
            patch.setattr("training.sweep.SEARCH_BASE", TINY)
            argv = ["report", data, "--out", out, "--json", str(folder / f"{name}.json")]
            argv += ["--renderer", "cpu", "--threads", "1", "--quiet"]
            assert cli.run(argv + (["--quick"] if name == "seen" else [])) == 0
    return folder


def read(work: Path, name: str) -> tuple[str, dict[str, Any]]:
    text = (work / f"{name}.html").read_text(encoding="utf-8")
    return text, json.loads((work / f"{name}.json").read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", ["seen", "held"])
def test_page_is_well_formed_and_alone(work: Path, name: str) -> None:
    text, _ = read(work, name)
    parsed = Page(text)
    for tag, attribute, value in parsed.attributes:
        assert tag not in ("script", "link", "iframe")
        assert not attribute.startswith("on")
        if attribute in ("src", "href"):
            assert value.startswith("data:image/png;base64,")
    assert not re.search(r"https?:|url\(|@import", text)
    assert ("meta", "content", "width=device-width, initial-scale=1") in parsed.attributes
    assert "prefers-color-scheme: dark" in text


@pytest.mark.parametrize(("name", "count"), [("seen", 2), ("held", 4)])
def test_charts_hold_finite_numbers(work: Path, name: str, count: int) -> None:
    text, _ = read(work, name)
    charts = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len([chart for chart in charts if "aria-label" in chart]) == count
    for chart in charts:
        for value in re.findall(
            r' (?:points|cx|cy|r|x|y|x1|y1|x2|y2|width|height)="([^"]*)"', chart
        ):
            assert np.isfinite([float(part) for part in re.split(r"[ ,]", value)]).all()


@pytest.mark.parametrize("name", ["seen", "held"])
def test_page_says_what_the_json_says(work: Path, name: str) -> None:
    text, told = read(work, name)
    images = re.findall(r'<img src="([^"]*)"', text)
    threes = [tuple(images[k : k + 3]) for k in range(0, len(images), 3)]
    assert page(told, threes) == text  # nothing on it but the JSON and the pictures
    rows = Page(text).rows
    for model in told["models"]:
        (row,) = [row for row in rows if row[0] == model["name"]]
        assert row[1] == f"{100 * model['rms']:.2f} %"
        assert f"{model['ms_per_pose']:.3f} ms" in row or f"{model['ms_per_pose']:.2f} ms" in row
    for clip, figures in told["clips"].items():
        (row,) = [row for row in rows if row[0] == clip and len(row) == 7]
        assert row[1] == per_cent(figures["rms"])
    worst = told["poses"][told["worst"][0]]
    assert worst["rms"] == max(pose["rms"] for pose in told["poses"])
    assert any(row[0] == worst["clip"] and row[2] == per_cent(worst["rms"]) for row in rows)


SAID = {
    "receivers": "Receivers are where", "order": "order² numbers", "rays": "rays are those",
    "dataset": "The dataset is", "judged poses": "Errors are of", "held-out error": "The error is",
    "99 % of vertices below": "99 of 100 vertices", "training error": "that the fit saw",
    "floor": "The floor is", "variance kept": "variance kept says", "inputs": "Inputs and latents",
    "latents": "Inputs and latents", "size": "MB are", "one pose": "Times are", "fit": "Fit is",
    "training in all": "training in all has", "coherence": "Coherence is", "error": "The error is",
    "outside the range, half diagonals": "outside the range of its poses, in half diagonals",
    "to the nearest pose, spacings": "in spacings", "worst vertex": "The worst vertex is",
}  # fmt: skip
PLAIN = {"scene", "vertices", "triangles", "training poses", "model", "clip", "time in it"}


def test_every_figure_has_a_sentence(work: Path) -> None:
    parsed = Page(read(work, "held")[0])
    text = " ".join(parsed.words)
    heads = [row for row in parsed.rows if row[0] in ("scene", "model", "clip")]
    assert len(heads) == 4
    for column in {column for row in heads for column in row} - PLAIN:
        assert SAID[column] in text


def test_held_out_clips_are_told_apart_from_training(work: Path) -> None:
    (seen, seen_told), (held, held_told) = read(work, "seen"), read(work, "held")
    assert seen_told["dataset"]["held_out"] is False
    assert "holds out no clip" in seen
    for text, title in ((seen, "training error"), (held, "held-out error")):
        (columns,) = [row for row in Page(text).rows if row[0] == "model"]
        assert columns[1] == title
        assert columns.count("training error") == 1
    assert "Error against distance" not in seen  # training poses are at none
    assert "Error against distance" in held
    assert held_told["dataset"]["clips"] == ["later & <b>"]
    assert "holds out no clip" not in held
    assert "later &amp; &lt;b&gt;" in held
    assert len(seen_told["models"]) == 8
    assert len(held_told["models"]) == 16 + 6 + 3


def test_models_in_fewer_bits_and_searched_ones_are_on_the_page(work: Path) -> None:
    text, told = read(work, "held")
    models = {model["name"]: model for model in told["models"]}
    whole, eight, four = (
        models[f"neural, occluders{bits}, small"] for bits in ("", ", 8 bits", ", 4 bits")
    )
    assert whole["model_bytes"] > eight["model_bytes"] > four["model_bytes"]
    assert eight["rms"] == pytest.approx(whole["rms"], rel=0.05)
    assert eight["training_rms"] is None
    assert [model["on_size_front"] for model in (whole, eight)] == [False, True]
    (row,) = [row for row in Page(text).rows if row[0] == "neural, occluders, 8 bits, small"]
    assert row[3] == "–"  # its training error
    found = [model for name, model in models.items() if name.startswith("searched, ")]
    assert len(found) == 3
    assert all(model["config"]["storage"] == "int4" for model in found)
    assert "earched" in text
    assert "earched" not in read(work, "seen")[0]


def test_larger_models_take_over_the_weight_decay(work: Path) -> None:
    _, told = read(work, "held")
    models = [model for model in told["models"] if model["family"] != "searched"]
    for small, medium in zip(models[::2], models[1::2], strict=True):
        if small["config"]["storage"] == "float32":
            assert medium["config"]["alpha"] == small["alpha"]
        assert small["family"] == medium["family"]


def test_pictures_are_on_the_page(work: Path) -> None:
    text, told = read(work, "held")
    images = re.findall(r'src="data:image/png;base64,([^"]*)"', text)
    assert len(images) == 6
    assert [picture["pose"] for picture in told["pictures"]] == [told["worst"][0], told["median"]]
    for image in images:
        with Image.open(io.BytesIO(base64.b64decode(image))) as picture:
            assert picture.size == (480, 480)
            assert np.ptp(np.asarray(picture)) > 20
    dataset = Dataset.open(work / "held.zarr")
    row = int(dataset.poses_of("later & <b>")[told["worst"][0]])
    truth = dataset.read("visibility", row)
    with opened("cpu") as renderer:
        right = draw_error(renderer, dataset, row, truth, load_light("studio"), 1.0).truth
    assert f"data:image/png;base64,{images[1]}" == data_uri(right)


def test_figures_are_those_of_evaluate(work: Path) -> None:
    """The best model that was fitted, fitted again as its configuration says, errs the same."""
    _, told = read(work, "held")
    whole = [m for m in told["models"] if m["config"]["storage"] == "float32"]
    best = min(whole, key=lambda model: model["rms"])
    chosen = {name: best["config"][name] for name in ("kind", "features", "clusters", "latents",
              "neurons", "points", "near", "spheres", "iterations")}  # fmt: skip
    options = [word for n, v in chosen.items() for word in (f"--{n}", str(v))]
    model, out = work / "best.safetensors", work / "best.json"
    fit = ["--alpha", str(best["alpha"]), "--threads", "1", "--quiet"]
    data = str(work / "held.zarr")
    assert cli.run(["train", data, "--out", str(model), *options, *fit]) == 0
    judge = ["--clips", "later & <b>", "--json", str(out), "--quiet"]
    assert cli.run(["evaluate", str(model), data, *judge]) == 0
    again = json.loads(out.read_text())
    assert again["rms"] == pytest.approx(best["rms"], rel=1e-3)
    assert again["nearest"] == pytest.approx(told["baselines"]["nearest"]["rms"])
    assert again["poses"][3]["nearest_distance"] == pytest.approx(
        told["poses"][3]["nearest_distance"]
    )


def test_unknown_numbers_are_dashes(work: Path) -> None:
    _, told = read(work, "held")
    for pose in told["poses"]:
        pose.update(time=None, distance=None, nearest_distance=None)
    for clip in told["clips"].values():
        clip.update(coherence=None, distance=None, nearest_distance=None)
    told["baselines"]["nearest"]["rms"] = None
    text = page(told, [(IMAGE, IMAGE, IMAGE)] * 2)
    assert "Error against distance" not in text
    assert any("–" in row for row in Page(text).rows)
    assert "None" not in text
    assert "nan" not in " ".join(Page(text).words)


def test_misuse_is_one_line(work: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = str(work / "held.zarr")
    for out, told in (("x.pdf", "end it in .html"), (str(work / "no" / "x.html"), "no folder")):
        assert cli.run(["report", data, "--out", out]) == 2
        err = capsys.readouterr().err
        assert told in err
        assert err.count("\n") == 1
