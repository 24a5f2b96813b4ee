from __future__ import annotations

import dataclasses

import numpy as np
import onnx
import pytest

from prtnet.errors import PrtnetError
from prtnet.model import VisibilityModel
from runtime.onnx_model import OnnxModel
from tests.training.data import memory_dataset
from tests.training.test_train import Recorder
from training import families
from training import search as module
from training.budget import Budget
from training.config import TrainConfig
from training.graph_cost import operations
from training.onnx_export import build_onnx
from training.search import search
from training.train import Fitting, train

SMALL = TrainConfig(
    clusters=3, iterations=30, near_spheres=5, patches=9, near_patches=5, width=8, steps=200,
    codes=4, samples=2000,
)  # fmt: skip
FEW = {"neurons": 6, "points": 2, "near": 6, "spheres": 12}


@pytest.fixture(autouse=True)
def small_families(monkeypatch, request):
    """The same kinds in the size of these scenes; priors where a test is about them."""
    families = {
        name: {**options, **FEW, "networks": 1}
        for name, options in module.FAMILIES.items()
        if "priors" in request.node.name or options["kind"] not in ("hybrid", "shared")
    }
    monkeypatch.setattr(module, "FAMILIES", families)


def by_size(proto: bytes) -> float:
    """Milliseconds that do not depend on the machine."""
    return len(proto) / 1e5


def found(data, **limits):
    return search(data, SMALL, Budget(**limits), by_size)


def onnx_bytes(model):
    return len(build_onnx(model).SerializeToString())


def scene(**options):
    return memory_dataset(clips=5, per_clip=12, **options)


def test_fewer_megabytes_cost_error_and_are_kept_to():
    data = scene()
    whole = found(data, max_mb=10.0)
    least = min(each["model_bytes"] for each in whole.metadata["search"]["compared"])
    limit = 0.5e-6 * (least + onnx_bytes(whole)) if least < onnx_bytes(whole) else 0.9e-6 * least
    model = found(data, max_mb=limit)
    assert onnx_bytes(model) <= 1e6 * limit
    chosen = (each.metadata["search"]["chosen"]["error"] for each in (model, whole))
    assert next(chosen) >= next(chosen)


def test_the_expected_error_is_met_on_clips_nobody_saw():
    data = scene()
    reached = found(data, max_mb=10.0).metadata["search"]["chosen"]["error"]
    loose = search(data, SMALL, Budget(max_error=3 * reached), by_size)
    tight = search(data, SMALL, Budget(max_error=1.05 * reached), by_size)
    assert loose.metadata["search"]["chosen"]["error"] <= 3 * reached
    assert tight.metadata["search"]["chosen"]["error"] <= 1.05 * reached
    assert onnx_bytes(loose) < onnx_bytes(tight)
    assert loose.metadata["held_out_error"]["rms"] <= 3 * reached


def test_priors_are_for_what_nothing_else_meets(monkeypatch):
    data = scene()
    easy = found(data, max_error=0.5).metadata["search"]
    assert {each["family"] for each in easy["compared"]} == {
        "linear", "neural, small", "neural", "neural, large"
    }  # fmt: skip
    small = found(data, max_mb=10.0).metadata["search"]
    assert {each["family"] for each in small["compared"]} == set(module.FAMILIES) - {*module.QUICK}


def tried(model):
    return {each["family"] for each in model.metadata["search"]["compared"]}


def test_milliseconds_are_kept_to():
    data = scene()
    model = search(data, SMALL, Budget(max_ms=0.5), by_size)
    chosen = model.metadata["search"]["chosen"]
    assert chosen["ms"] <= 0.5
    assert chosen["ms"] == pytest.approx(by_size(build_onnx(model).SerializeToString()), rel=0.1)


def by_work(proto):
    """Milliseconds that are arithmetic, a million operations each."""
    return operations(onnx.load_from_string(proto)) / 1e6


def test_fewer_clusters_are_tried_where_milliseconds_hold_others_back():
    data, quick = scene(), set(module.QUICK)
    free = search(data, SMALL, Budget(max_ms=1e3), by_work)
    assert not tried(free) & quick
    times = {each["family"]: each["ms"] for each in free.metadata["search"]["compared"]}
    model = search(data, SMALL, Budget(max_ms=0.9 * min(times.values())), by_work)
    assert tried(model) >= quick
    compared = model.metadata["search"]["compared"]
    assert model.metadata["search"]["chosen"] == min(
        (each for each in compared if each["meets"]), key=lambda each: each["error"]
    )
    loose = search(data, SMALL, Budget(max_ms=1e3, max_error=0.9), by_work)
    assert not tried(loose) & quick


def test_fewer_clusters_are_a_share_of_those_asked_for():
    data = scene()
    for asked, expected in ((2, [2, 1]), (1000, [3, 2]), (1, [1, 1])):
        base = dataclasses.replace(SMALL, clusters=asked)
        configs = [
            families.rich_config(data, base, families.FAMILIES[name]) for name in module.QUICK
        ]
        most = min(asked, len(data.rest_tangents) // families.FEWEST)
        assert [config.clusters for config in configs] == expected
        assert configs[0].clusters == most
        assert {config.parts for config in configs} == {1}
    model = module.Candidates(data, SMALL)[module.QUICK[-1]].models[0]
    assert len(model.receivers) == 2


@pytest.mark.parametrize(
    ("limits", "option"),
    [({"max_error": 1e-6}, "--max-error"), ({"max_mb": 1e-5}, "--max-mb"),
     ({"max_ms": 1e-5}, "--max-ms")],
)  # fmt: skip
def test_limits_that_nothing_meets_are_refused(limits, option):
    with pytest.raises(PrtnetError, match="no model is expected to meet") as caught:
        found(scene(), **limits)
    assert caught.value.subject == option


def test_a_clock_that_wavers_refuses_nothing_that_it_allowed():
    seen = set()

    def slower_the_second_time(proto):
        again = len(proto) in seen
        seen.add(len(proto))
        return by_size(proto) * (3.0 if again else 1.0)

    candidate = module.Candidates(scene(), SMALL)["neural"]
    best = int(np.argmin(candidate.errors))
    proto = build_onnx(candidate.cut(best - 1)).SerializeToString()
    budget = Budget(max_ms=by_size(proto))
    choice = module.sized(candidate, budget, slower_the_second_time)
    assert choice.meets
    assert 0 < choice.size < best


def test_what_the_search_chooses_is_not_asked_for():
    for asked in ({"storage": "int8"}, {"kind": "linear"}, {"target": "cosine"}):
        with pytest.raises(PrtnetError, match="is chosen by") as caught:
            search(scene(), dataclasses.replace(SMALL, **asked), Budget(max_mb=1.0), by_size)
        assert caught.value.subject == f"--{next(iter(asked))}"


def test_folds_have_as_many_neurons_as_the_model(monkeypatch):
    seen = []
    model = Fitting.model

    def spy(self, neurons, alpha, watch):
        seen.append((neurons, alpha))
        return model(self, neurons, alpha, watch)

    monkeypatch.setattr(Fitting, "model", spy)
    options = {k: v for k, v in families.FAMILIES["neural"].items() if k != "neurons"}
    monkeypatch.setattr(module, "FAMILIES", {"neural": options})
    search(scene(), dataclasses.replace(SMALL, neurons="auto"), Budget(max_mb=1.0), by_size)
    assert len(seen) == 2 * 5  # numbers of neurons, times the whole and four folds
    numbers = [number for number, _ in seen]
    assert numbers[:2] == numbers[2:4] == numbers[8:]
    alphas = {alpha for _, alpha in seen}  # a fold's is as strong against fewer poses
    assert max(alphas) == pytest.approx(seen[0][1] / 0.75, rel=0.2)
    assert {alpha for _, alpha in seen[:2]} == {min(alphas)}


def test_what_there_is_to_predict_is_reduced_once_for_kinds_without_a_prior(monkeypatch):
    reduced, fitted = [], []
    reduced_outputs = families.reduced_outputs

    def spy(dataset, rows, config, watch, layout):
        reduced.append((config.kind, len(rows), layout is None))
        return reduced_outputs(dataset, rows, config, watch, layout)

    candidates = module.Candidates(scene(), SMALL)
    monkeypatch.setattr(families, "reduced_outputs", spy)
    for family in ("linear", "neural, small", "neural"):
        fitted.append(candidates[family])
    assert [kind for kind, *_ in reduced] == ["linear"] * 5  # the whole and four folds
    assert [first for *_, first in reduced] == [True] + [False] * 4
    alone = module.Candidates(scene(), SMALL)["neural"]
    assert np.array_equal(alone.models[0].basis, fitted[2].models[0].basis)


def test_a_folds_weight_decay_is_as_strong_whoever_chose_it(monkeypatch):
    seen = []
    model = Fitting.model

    def spy(self, neurons, alpha, watch):
        seen.append(alpha)
        return model(self, neurons, alpha, watch)

    monkeypatch.setattr(Fitting, "model", spy)
    given = dataclasses.replace(SMALL, alpha=0.01)
    candidates = module.Candidates(scene(), given)
    candidates["linear"]
    shares = [float(fold.train.mean()) for fold in candidates.parts.folds]
    assert seen == pytest.approx([0.01, *(0.01 / share for share in shares)])


def test_rounding_of_components_is_not_counted_twice():
    candidate = module.Candidates(scene(), SMALL)["neural"]
    model = candidate.models[-1]
    poses = scene().read("pose", slice(8))
    whole = np.mean((model.stored_as("int8")(poses) - model(poses)) ** 2) / np.mean(
        model(poses) ** 2
    )
    assert 0.0 < families.rounded_off(model, poses) < whole


def test_the_model_found_is_whole(tmp_path):
    data = scene()
    model = found(data, max_error=0.2)
    assert model.storage == model.metadata["config"]["storage"] == "int4"
    model.save(tmp_path / "m.safetensors")
    again = VisibilityModel.load(tmp_path / "m.safetensors")
    poses = data.read("pose", data.training_poses())
    assert np.array_equal(again(poses), model(poses))
    graph = OnnxModel(build_onnx(again).SerializeToString(), threads=1)
    answer = model(poses)
    assert np.linalg.norm(graph(poses) - answer) <= 1e-5 * np.linalg.norm(answer)
    assert model.novelty(poses).max() <= 1e-5
    assert "expected error" in again.metadata["search"]["why"]


def test_how_the_fits_of_the_model_found_ended_can_be_plotted():
    watch = Recorder()
    model = search(scene(), SMALL, Budget(max_error=0.2), by_size, watch)
    for network, told in enumerate(model.metadata["fits"]):
        for text in told["clusters"]:
            assert f"fit/{text.replace(' ', '_')}_{network}_by_cluster" in watch.scalars
    assert any(name.startswith("search/") for name in watch.scalars)


def test_groups_that_never_change_keep_their_mean_alone(monkeypatch):
    monkeypatch.setattr(families, "FEWEST", 15)
    data = scene()
    visibility = data.read("visibility").copy()
    visibility[:, :45] = visibility[:1, :45]  # three of four joints
    still = memory_dataset(poses=data.read("pose"), visibility=visibility, clips=5)
    config = dataclasses.replace(SMALL, clusters=4)
    model = search(still, config, Budget(max_mb=10.0), by_size)
    quiet = [bool((own[own >= 0] < 45).all()) for own in model.receivers]
    assert any(quiet)
    assert (model.latents[quiet] == 0).all()
    assert (model.latents[np.logical_not(quiet)] > 0).all()
    assert "their mean alone" in model.metadata["search"]["why"]


def test_auto_stops_where_more_buys_little():
    data = scene()
    model = search(data, dataclasses.replace(SMALL, kind="auto"), Budget(), by_size)
    facts = model.metadata["search"]
    rich = found(data, max_mb=10.0).metadata["search"]["compared"]
    least = min(each["error"] for each in rich)
    assert facts["budget"]["max_error"] == pytest.approx(1.1 * least)
    assert least < facts["chosen"]["error"] <= 1.1 * least
    assert onnx_bytes(model) < min(e["model_bytes"] for e in rich if e["error"] == least)
    with pytest.raises(PrtnetError, match="auto is for"):
        train(data, dataclasses.replace(SMALL, kind="auto"))


def test_too_few_clips_cannot_judge():
    with pytest.raises(PrtnetError, match="too few training poses"):
        found(memory_dataset(clips=1, per_clip=2), max_error=0.1)


def test_a_search_says_what_train_does_with_as_many_components():
    data = scene()
    model = found(data, max_mb=10.0)
    config = model.metadata["config"]
    plain = train(data, TrainConfig(**{**config, "storage": "float32"}))
    assert model.metadata["held_out_error"]["rms"] < 1.5 * plain.metadata["held_out_error"]["rms"]


@pytest.mark.parametrize(
    ("limits", "message"),
    [({"max_error": 5.0}, "5% or 0.05"), ({"max_error": 0.0}, "above 0"),
     ({"max_ms": float("nan")}, "above 0"), ({"max_mb": -1.0}, "above 0")],
)  # fmt: skip
def test_limits_that_make_no_sense(limits, message):
    with pytest.raises(PrtnetError, match=message):
        Budget(**limits)
    assert not Budget()
    assert Budget(max_mb=1.0)
    assert dataclasses.replace(Budget(), max_error=0.05).text() == "an error of 5 %"
