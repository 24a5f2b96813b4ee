"""The papers' own comparisons, on our scenes: tables and plots of docs/papers.md.

python bench/papers.py [clusters|variance|joint|kinds|cosine|frames|convolved ...] [--write]

[1] "Shadowing Dynamic Scenes with Arbitrary BRDFs". [2] "Shadowed Relighting of Dynamic Geometry
with 1D BRDFs".
"""

from __future__ import annotations

import dataclasses
import functools
import sys

import charts
import numpy as np
import torch
from tables import HUMAN, OUT, ROBOT, ROOT, dataset, per_cent, publish

from data_gen.generate import GenerateConfig, generate
from data_gen.procedural import arm
from prtnet.arrays import FloatArray, IntArray
from prtnet.dataset import Dataset
from prtnet.evaluation import NearestPose, dataset_truth, evaluate
from prtnet.model import VisibilityModel
from prtnet.operators import cosine_matrix
from prtnet.output_space import OutputSpace
from training.config import PRESETS, TrainConfig
from training.quadratic import Products
from training.regression import fit_linear, fit_neural
from training.train import train

PAGE = ROOT / "docs" / "papers.md"
FIGURES = ROOT / "docs" / "figures"
KINDS = ("linear", "quadratic", "neural")
FEATURES = {"joint angles": "joint_angles", "local joints": "local_joints",
            "occluders": "occluders"}  # fmt: skip
SMOOTH = 0.1  # of the linear model with the prior
EVERY = 4  # pose of the human's training clips, and EVERY / 2 of the held-out one, is used
WRITE = "--write" in sys.argv


class FewerPoses(Dataset):
    """A dataset of which only some poses are used."""

    def training_poses(self) -> IntArray:
        return np.setdiff1d(np.arange(len(self)), super().held_out_poses())[::EVERY]

    def held_out_poses(self) -> IntArray:
        return super().held_out_poses()[:: EVERY // 2]

    def poses_of(self, clip: str) -> IntArray:
        used = np.concatenate([self.training_poses(), self.held_out_poses()])
        return np.intersect1d(super().poses_of(clip), used)


@functools.cache
def scene(name: str) -> Dataset:
    """The robot, or some poses of the human."""
    if name == "robot":
        return dataset("robot", "robot.glb", ROBOT)
    return FewerPoses.open(dataset("human", "human.glb", HUMAN).path)


def base(name: str, **options: object) -> TrainConfig:
    """Default options; with joint angles the papers' input variance."""
    config = dataclasses.replace(
        PRESETS["default"], clusters=16 if name == "robot" else 64, latents=14.0
    )
    config = dataclasses.replace(config, **options)
    if config.features == "joint_angles":
        config = dataclasses.replace(config, input_variance=0.9)
    return config


@functools.cache
def fitted(name: str, config: TrainConfig) -> VisibilityModel:
    """A trained model. α is chosen once for a kind and its features, in the plain space."""
    plain = dataclasses.replace(config, frame="local", target="visibility")
    if config != plain:
        config = dataclasses.replace(config, alpha=fitted(name, plain).metadata["alpha"])
    model = train(scene(name), config)
    errors = [model.metadata[f"{kind}_error"]["rms"] for kind in ("training", "held_out")]
    shown = {f.name: getattr(config, f.name) for f in dataclasses.fields(config)
             if getattr(config, f.name) != getattr(PRESETS["default"], f.name)}  # fmt: skip
    print(name, shown, f"α {model.metadata['alpha']:g}", *map(per_cent, errors), flush=True)
    return model


def held_out(model: VisibilityModel) -> float:
    """Relative RMS on clips that the fit has not seen."""
    return float(model.metadata["held_out_error"]["rms"])


def yardsticks(name: str, model: VisibilityModel) -> dict[str, float]:
    """Signal, nearest pose and floor on the held-out clips."""
    data = scene(name)
    space = OutputSpace.of(model.metadata)
    blocks = dataset_truth(model, data, data.held_out)
    return evaluate(model, model, blocks, NearestPose(data, space))


def hundred(values: list[float]) -> list[float]:
    return [100.0 * value for value in values]


def table(name: str, columns: tuple[str, ...], rows: list[list[str]], note: str = "") -> None:
    """A table of the page, and its figure under it."""
    publish(name, columns, rows, note, PAGE, f"![{name}](figures/{name}.svg)")


def clusters() -> None:
    """[1] figure 4: how the number of clusters affects the error."""
    counts = (1, 2, 4, 8, 16, 32, 64, 128)
    rows, curves = [], {"PCA floor": [], "linear": [], "neural": []}
    for count in counts:
        options = {"clusters": count, "latents": 1e9, "output_variance": 0.95}
        linear = fitted("robot", base("robot", kind="linear", alpha=0.1, **options))
        neural = fitted("robot", base("robot", kind="neural", alpha=3e-3, **options))
        errors = [yardsticks("robot", linear)["pca_floor"], held_out(linear), held_out(neural)]
        for curve, error in zip(curves.values(), errors, strict=True):
            curve.append(100 * error)
        rows.append([str(count), f"{neural.latents.mean():.1f}",
                     f"{neural.basis.nbytes / 1e6:.1f}", *map(per_cent, errors)])  # fmt: skip
    columns = ("clusters", "latents a cluster", "basis, MB", "floor", "linear", "neural")
    table("clusters", columns, rows)
    draw(charts.lines, "clusters", "Robot: clusters against error", "clusters",
         "held-out error, %", counts, curves, True)  # fmt: skip


def variance() -> None:
    """[1] figure 5: how the retained output variance affects the error."""
    kept = (0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.999)
    rows, curves = [], {"PCA floor": [], "linear": [], "neural": []}
    for fraction in kept:
        options = {"latents": 1e9, "output_variance": fraction}
        linear = fitted("robot", base("robot", kind="linear", alpha=0.1, **options))
        neural = fitted("robot", base("robot", kind="neural", alpha=3e-3, **options))
        errors = [yardsticks("robot", linear)["pca_floor"], held_out(linear), held_out(neural)]
        for curve, error in zip(curves.values(), errors, strict=True):
            curve.append(100 * error)
        rows.append([f"{100 * fraction:g} %", f"{neural.latents.mean():.1f}",
                     *map(per_cent, errors)])  # fmt: skip
    table("variance", ("variance kept", "latents a cluster", "floor", "linear", "neural"), rows)
    draw(charts.lines, "variance", "Robot: output variance against error", "variance kept, %",
         "held-out error, %", hundred(list(kept)), curves, True)  # fmt: skip


def joint() -> None:
    """[1] figure 6: one joint, the visibility of its vertices, and what fits it."""
    path = OUT / "arm.zarr"
    config = GenerateConfig(count=81)
    if not path.exists():
        generate(arm(16), config, path)
    data = Dataset.open(path)
    rows = np.arange(41)  # 0 to 140 degrees; the way back is the same
    visibility: FloatArray = data.read("visibility", rows)
    forearm = data.read("pose", rows).reshape(len(rows), 2, 3, 4)[:, 1]
    angle = np.degrees(np.arctan2(forearm[:, 1, 0], forearm[:, 0, 0]))
    train_rows, test_rows = rows[::2], rows[1::2]
    # Every receiver its own model of the one angle.
    scaled = torch.tensor((angle - angle.mean()) / angle.std())[None, :, None]
    x = scaled.expand(visibility.shape[1], -1, 1).double()
    y = torch.tensor(np.swapaxes(visibility, 0, 1)).double()
    products = Products(x[:, train_rows], 1)
    fits = {
        "linear": fit_linear(x[:, train_rows], y[:, train_rows], 1e-4)(x),
        "quadratic": fit_linear(products(x[:, train_rows]), y[:, train_rows], 1e-4)(products(x)),
        "2 neurons": fit_neural(x[:, train_rows], y[:, train_rows], 2, 1e-4)(x),
        "4 neurons": fit_neural(x[:, train_rows], y[:, train_rows], 4, 1e-4)(x),
    }
    dc = visibility[..., 0]
    vertex = int(np.argmax(dc.var(axis=0)))
    rows_out, curves = [], {"ray-traced": list(dc[:, vertex] / np.sqrt(4 * np.pi))}
    for name, fit in fits.items():
        guess = np.swapaxes(fit.numpy(), 0, 1)
        difference = (guess - visibility)[test_rows]
        own = np.sqrt(np.square(difference[:, vertex]).sum() /
                      np.square(visibility[test_rows, vertex]).sum())  # fmt: skip
        moving = visibility.var(axis=0).sum(axis=-1) > 1e-3
        every = np.sqrt(np.square(difference[:, moving]).sum() /
                        np.square(visibility[test_rows][:, moving]).sum())  # fmt: skip
        rows_out.append([name, per_cent(own), per_cent(every)])
        curves[name] = list(guess[:, vertex, 0] / np.sqrt(4 * np.pi))
    table("joint", ("fit", "this vertex", f"all {int(moving.sum())} vertices that change"),
          rows_out, "Fitted to every second of 41 angles, tested on the others.")  # fmt: skip
    draw(charts.lines, "joint", "Arm: a vertex inside the elbow", "angle of the joint, degrees",
         "mean visibility", list(angle), curves, False, ("ray-traced",))  # fmt: skip


def kinds() -> None:
    """[1] figure 7: the error of each model on novel poses."""
    rows, groups = [], []
    series: dict[str, list[float]] = {
        name: [] for name in ("linear", "linear, smooth", "quadratic", "neural")
    }
    for name in ("robot", "human"):
        for words, features in FEATURES.items():
            errors, training = [], []
            for kind in series:
                smooth = SMOOTH if kind == "linear, smooth" else 0.0
                config = base(name, kind=kind.partition(",")[0], features=features,
                              smoothness=smooth)  # fmt: skip
                model = fitted(name, config)
                errors.append(held_out(model))
                training.append(float(model.metadata["training_error"]["rms"]))
                series[kind].append(100 * errors[-1])
            marks = yardsticks(name, model)
            groups.append(f"{name},\n{words}")
            cells = [f"{per_cent(e)[:-2]} ({per_cent(t)[:-2]})"
                     for e, t in zip(errors, training, strict=True)]  # fmt: skip
            rows.append([f"{name}, {words}", per_cent(marks["signal"]),
                         per_cent(marks["nearest"]), *cells])  # fmt: skip
    table("kinds", ("scene, features", "signal", "nearest", *series), rows,
          "Per cent on held-out clips; in brackets on the training poses.")  # fmt: skip
    draw(charts.bars, "kinds", "Kinds of models on novel poses", "held-out error, %",
         groups, series)  # fmt: skip


def compare(table_name: str, field: str, values: tuple[str, str], words: tuple[str, str]) -> None:
    """Held-out error of every kind in two output spaces, of robot and human."""
    rows, groups = [], []
    series: dict[str, list[float]] = {word: [] for word in words}
    for name in ("robot", "human"):
        for features in ("joint_angles", "occluders"):
            for kind in KINDS if name == "robot" else ("linear",):
                cells, signals = [], []
                for value, word in zip(values, words, strict=True):
                    config = base(name, kind=kind, features=features)
                    model = fitted(name, dataclasses.replace(config, **{field: value}))
                    signals.append(signal(name, model))
                    cells.append(held_out(model))
                    series[word].append(100 * cells[-1])
                label = f"{name}, {features.replace('_', ' ')}, {kind}"
                rows.append([label, *map(per_cent, (*signals, *cells))])
                groups.append(f"{name},\n{features.replace('_', ' ')},\n{kind}")
    columns = ("model", *(f"signal, {w}" for w in words), *words)
    table(table_name, columns, rows)
    draw(charts.bars, table_name, f"{words[0]} and {words[1]}", "held-out error, %", groups, series)


def signal(name: str, model: VisibilityModel) -> float:
    """Relative error of the model's mean on the held-out clips, in the model's space."""
    data, space = scene(name), OutputSpace.of(model.metadata)
    mean = model.decode(np.zeros((1, len(model.latents), int(model.latents.max(initial=0)))))
    truth = space.read(data, data.held_out_poses())
    return float(np.sqrt(np.square(truth - mean).sum() / np.square(truth).sum()))


def cosine() -> None:
    """[1] figure 8: fitting with and without the cosine."""
    compare("cosine", "target", ("visibility", "cosine"), ("visibility", "cosine-weighted"))


def frames() -> None:
    """[1] figure 9: local and global frames."""
    compare("frames", "frame", ("local", "global"), ("local frames", "global frame"))


def convolved() -> None:
    """[2] figure 3: plain, cosine-weighted, and plain with the cosine put back; mean ± std."""
    rows, groups = [], []
    series: dict[str, list[float]] = {"plain": [], "cosine-weighted": [], "plain, then cosine": []}
    spread: dict[str, list[float]] = {name: [] for name in series}
    for name in ("robot", "human"):
        data = scene(name)
        held = data.held_out_poses()
        poses = data.read("pose", held)
        matrix = cosine_matrix(data.order).astype(np.float32)
        for features in ("joint_angles", "occluders"):
            config = base(name, kind="linear", features=features)
            plain = fitted(name, config)(poses)
            weighted = fitted(name, dataclasses.replace(config, target="cosine"))(poses)
            truth = data.read("visibility", held)
            pairs = ((plain, truth), (weighted, truth @ matrix), (plain @ matrix, truth @ matrix))
            cells = []
            for word, (guess, exact) in zip(series, pairs, strict=True):
                axes = (1, 2)
                each = np.sqrt(
                    np.square(guess - exact).sum(axis=axes) / np.square(exact).sum(axis=axes)
                )
                cells.append(f"{100 * each.mean():.2f} ± {100 * each.std():.2f}")
                series[word].append(100 * float(each.mean()))
                spread[word].append(100 * float(each.std()))
            rows.append([f"{name}, {features.replace('_', ' ')}", *cells])
            groups.append(f"{name},\n{features.replace('_', ' ')}")
    note = "Relative error of each held-out pose in per cent, mean ± standard deviation."
    table("convolved", ("linear model", *series), rows, note)
    draw(charts.bars, "convolved", "Linear models: the cosine fitted, or put back",
         "error of a pose, %", groups, series, spread)  # fmt: skip


def draw(chart: object, name: str, *arguments: object) -> None:
    """A figure of the page; only with ``--write``."""
    if WRITE:
        chart(FIGURES / f"{name}.svg", *arguments)  # type: ignore[operator]


SECTIONS = {f.__name__: f for f in (clusters, variance, joint, kinds, cosine, frames, convolved)}

if __name__ == "__main__":
    torch.set_num_threads(2)
    for section in [name for name in SECTIONS if name in sys.argv] or list(SECTIONS):
        SECTIONS[section]()
