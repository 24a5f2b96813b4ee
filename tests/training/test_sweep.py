from __future__ import annotations

import pytest

from training.sweep import FAMILIES, SIZES, candidates


def test_every_family_comes_in_every_size() -> None:
    made = candidates("skinned", 10_000)
    assert len(made) == sum(len(family.sizes) for family in FAMILIES)
    assert len({each.name for each in made}) == len(made)
    for family in FAMILIES:
        own = [each.config for each in made if each.family == family.name]
        assert [config.latents for config in own] == sorted({config.latents for config in own})
        assert {(c.kind, c.features) for c in own} == {
            (family.options["kind"], family.options.get("features"))
        }


def test_quick_is_the_smallest_of_each() -> None:
    quick = candidates("skinned", 10_000, quick=True)
    assert [each.family for each in quick] == [f.name for f in FAMILIES if not f.around]
    assert {each.config.latents for each in quick} == {SIZES["small"].latents}


def test_point_caches_have_no_spheres() -> None:
    made = candidates("point_cache", 10_000)
    assert {each.family for each in made} == {
        "linear, dihedral angles", "neural, dihedral angles", "hybrid", "shared"
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
