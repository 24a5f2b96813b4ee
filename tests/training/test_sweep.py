from __future__ import annotations

import dataclasses
from typing import get_args, get_type_hints

import numpy as np
import pytest

from prtnet.errors import PrtnetError
from tests.training.data import memory_dataset
from tests.training.test_train import SMALL
from training import search, sweep
from training.config import TrainConfig
from training.onnx_export import build_onnx
from training.sweep import FAMILIES, SIZES, Candidate, candidates, fitted, rounded, searched
from training.train import train


def test_every_family_comes_in_every_size() -> None:
    made = candidates("skinned", 10_000)
    assert len(made) == sum(len(f.sizes) * (1 + len(f.storages)) for f in FAMILIES)
    assert len({each.name for each in made}) == len(made)
    for family in FAMILIES:
        own = [each.config for each in made if each.family == family.name]
        assert [config.latents for config in own] == sorted({config.latents for config in own})
        assert {(c.kind, c.features) for c in own} == {
            (family.options["kind"], family.options.get("features"))
        }


def test_every_kind_of_regressor_and_prior_is_a_family() -> None:
    """But the mean, which is a yardstick, and lobes, whose fits take a search a receiver."""
    kinds = set(get_args(get_type_hints(TrainConfig)["kind"])) - {"auto", "constant", "lobes"}
    assert {family.options["kind"] for family in FAMILIES} == kinds


def test_quick_is_the_smallest_of_each() -> None:
    quick = candidates("skinned", 10_000, quick=True)
    assert [each.family for each in quick if each.source is None] == [
        f.name for f in FAMILIES if not f.around
    ]
    assert {each.config.latents for each in quick} == {SIZES["small"].latents}


def test_point_caches_have_no_spheres() -> None:
    made = candidates("point_cache", 10_000)
    assert {each.family for each in made} == {
        "linear, dihedral angles", "quadratic, dihedral angles", "neural, dihedral angles",
        "hybrid", "shared", "shared, 4 bits",
    }  # fmt: skip
    assert all(each.config.features in ("joint_angles", None) for each in made)


@pytest.mark.parametrize(("receivers", "clusters"), [(30, 1), (450, 4), (100_000, 32)])
def test_small_meshes_get_few_clusters(receivers: int, clusters: int) -> None:
    (first, *_) = candidates("skinned", receivers, quick=True, device="cuda")
    assert first.config.clusters == clusters
    assert first.config.device == "cuda"


def test_known_weight_decay_is_taken_over() -> None:
    (first, *_) = candidates("skinned", 1000)
    assert first.config.alpha is None
    assert first.with_alpha(0.25).config.alpha == 0.25


def test_fewer_bytes_are_of_a_model_that_comes_before() -> None:
    made = candidates("skinned", 10_000)
    for index, each in enumerate(made):
        if each.source is None:
            continue
        (origin,) = (other for other in made[:index] if other.name == each.source)
        storage = each.config.storage
        assert storage in ("int8", "int4")
        assert dataclasses.replace(origin.config, storage=storage) == each.config
        assert each.name.startswith(each.family)
        assert each.family != origin.family


@pytest.mark.parametrize("storage", ["int8", "int4"])
def test_rounded_models_are_as_if_trained_so(storage) -> None:
    data = memory_dataset()
    model, expected = train(data, SMALL), train(data, dataclasses.replace(SMALL, storage=storage))
    told = rounded(model, data, storage)
    poses = data.read("pose")
    assert np.array_equal(told(poses), expected(poses))
    assert not np.array_equal(told(poses), model(poses))
    assert told.metadata["config"] == expected.metadata["config"]
    assert "training_error" not in told.metadata
    assert "training_error" in model.metadata


def test_a_family_chooses_weight_decay_once(monkeypatch) -> None:
    data, asked = memory_dataset(), []

    def spy(dataset, config):
        asked.append(config.alpha)
        return train(dataset, config)

    monkeypatch.setattr(sweep, "train", spy)
    larger = dataclasses.replace(SMALL, latents=5)
    chosen = [Candidate("a, small", "a", SMALL), Candidate("a, large", "a", larger)]
    chosen.append(sweep.in_fewer_bytes(chosen[0], "int8"))
    models = dict(fitted(data, chosen))
    first, second, third = models.values()
    assert asked == [None, first.metadata["alpha"]]
    assert second.metadata["alpha"] == third.metadata["alpha"] == first.metadata["alpha"]
    assert third.storage == "int8"
    assert list(models) == chosen


def test_searched_models_keep_to_limits_from_loose_to_strict(monkeypatch) -> None:
    data = memory_dataset(clips=5, per_clip=12)
    few = {"neurons": 6, "points": 2, "near": 6, "spheres": 12, "networks": 1}
    families = {name: {**own, **few} for name, own in search.FAMILIES.items()}
    monkeypatch.setattr(search, "FAMILIES", families)
    monkeypatch.setattr(sweep, "SEARCH_BASE", dataclasses.replace(SMALL, iterations=30))
    models = list(searched(data, "cpu", lambda _: 1.0))
    assert len(models) == sweep.SEARCHED
    limits = [model.metadata["search"]["budget"]["max_error"] for model in models]
    assert limits == sorted(limits, reverse=True)
    for model, limit in zip(models, limits, strict=True):
        told = model.metadata["search"]
        assert told["chosen"]["error"] <= limit
        assert {each["family"] for each in told["compared"]} == set(sweep.SEARCH_KINDS)
        assert model.metadata["seconds"]["total"] > 0
    sizes = [build_onnx(model).ByteSize() for model in models]
    assert sizes[0] < sizes[-1]
    with pytest.raises(PrtnetError, match="too few training poses"):
        list(searched(memory_dataset(clips=1, per_clip=2), "cpu", lambda _: 1.0))


def test_where_nothing_can_be_told_nothing_is_searched_for(monkeypatch) -> None:
    """A search for what is not there has no limits to keep to."""
    data = memory_dataset(clips=4)
    data.read("visibility")[:] = 1.0
    monkeypatch.setattr(sweep, "SEARCH_KINDS", ("linear",))
    monkeypatch.setattr(sweep, "SEARCH_BASE", SMALL)
    assert list(searched(data, "cpu", lambda _: 1.0)) == []
