from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import safetensors
import safetensors.numpy

from prtnet.array_file import LOBES, untimed
from prtnet.errors import PrtnetError
from prtnet.lobe_field import LobeField, halved
from prtnet.lobe_fit import between, lobe_field
from prtnet.sh import evaluate
from prtnet.transfer import Patch, Surface, TransferField
from prtnet.zh import Lobes, LobesApart, linear_axis
from prtnet.zh_surface import interpolated

ORDER = 4


def numbers(*shape: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def clamped(axes: np.ndarray) -> np.ndarray:
    """Transfer of cosines about axes (…, 3), and of a part of one about another: (…, n²)."""
    unit = axes / np.linalg.norm(axes, axis=-1, keepdims=True)
    basis = evaluate(unit, ORDER) * np.repeat([1.0, 0.7, 0.3, 0.1], [1, 3, 5, 7])
    other = evaluate(np.roll(unit, 1, axis=-1), ORDER) * np.repeat(
        [0.2, 0.1, 0.2, 0.1], [1, 3, 5, 7]
    )
    return (basis + other).astype(np.float32)


def patch(rows: int = 1, tiles: tuple[bool, bool] = (True, False)) -> TransferField:
    """Texels whose axes turn with their place."""
    turn = 2.0 * np.pi * np.arange(8) / 8
    axes = np.stack([0.3 * np.cos(turn), 0.3 * np.sin(turn), np.ones(8)], axis=-1)
    axes = axes + 0.1 * np.arange(6)[:, None, None] * [0.0, 1.0, 0.0]
    transfer = np.stack([clamped(axes.reshape(48, 3)) * (row + 1) for row in range(rows)], axis=1)
    layout = Patch(numbers(6, 8), numbers(6, 8, 3), (0.3, 0.2), tiles)
    view = numbers(rows, 16, 3) if rows > 1 else None
    return TransferField(transfer, layout, view, {"source": "made", "rays": 7})


def mesh() -> TransferField:
    faces = np.array([[0, 1, 2], [2, 1, 3]], dtype=np.int32)
    axes = numbers(4, 3) * 0.2 + np.array([0, 0, 1], dtype=np.float32)
    layout = Surface(numbers(4, 3), numbers(4, 3), numbers(4, 3), faces)
    return TransferField(clamped(axes)[:, None], layout)


@pytest.mark.parametrize("coherent", [False, True])
@pytest.mark.parametrize("field", [patch(), patch(3), mesh()], ids=["patch", "glossy", "mesh"])
def test_a_file_is_what_was_fitted(field: TransferField, coherent: bool, tmp_path: Path) -> None:
    lobes = lobe_field(field, 3, coherent)
    path = tmp_path / "a.safetensors"
    lobes.save(path)
    again = LobeField.load(path)
    for name in ("low", "axes", "coefficients"):
        got, want = getattr(again, name), getattr(lobes, name)
        assert got.dtype == np.float32
        np.testing.assert_allclose(got, want, atol=5e-4, rtol=1e-3)
    for one in dataclasses.fields(field.layout):
        np.testing.assert_array_equal(
            getattr(again.layout, one.name), getattr(field.layout, one.name)
        )
    assert (again.coherent, again.count, again.rows) == (coherent, 3, field.rows)
    assert (again.view is None) == (field.view is None)
    assert again.metadata == untimed(lobes.metadata)
    assert json.loads(json.dumps(again.facts())) == untimed(lobes.facts())


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_the_error_told_is_the_error(count: int) -> None:
    field = patch(3)
    lobes = lobe_field(field, count)
    missed = lobes.lobes.harmonics() - field.transfer
    told = lobes.metadata["fit"]
    error = np.linalg.norm(missed) / np.linalg.norm(field.transfer)
    assert told["error"] == pytest.approx(error, rel=1e-3)
    assert told["error"] < (0.3 if count == 1 else 0.01)
    assert told["error"] <= told["p99"] * 1.01
    assert told["seconds"] > 0


def test_a_linear_band_out_of_the_plane_of_all_axes() -> None:
    """It is stored apart, and costs the other bands nothing."""
    angle = np.radians([[10.0], [80.0], [155.0]])
    axes = np.concatenate([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    target = (evaluate(axes, ORDER) * np.repeat([0.0, 0.0, 1.0, 0.7], [1, 3, 5, 7])).sum(axis=0)
    target[2] = 3.0
    field = dataclasses.replace(patch(), transfer=np.tile(target.astype(np.float32), (48, 1, 1)))
    assert lobe_field(field, 3).metadata["fit"]["error"] < 1e-3


def test_samples_lie_between_texels() -> None:
    """A texture that repeats across has some behind its last column; rows end with their last."""
    layout = patch(tiles=(True, False)).layout
    weights = between(layout).toarray().reshape(11, 16, 6, 8)
    corners = np.zeros((6, 8))
    corners[2, 7] = corners[2, 0] = 0.5
    np.testing.assert_array_equal(weights[4, 15], corners)
    assert weights[10, 0, 5, 0] == 1.0
    assert weights[9, 2, 4, 1] == weights[9, 2, 5, 1] == 0.5


def test_coherent_lobes_hold_between_texels() -> None:
    """Their interpolant is near the transfer's; that of fits by themselves need not be."""
    field = patch()
    weights = between(field.layout)
    assert weights.shape == (11 * 16, 48)
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)
    target = weights @ field.vectors
    errors = {}
    for coherent in (False, True):
        found = lobe_field(field, 3, coherent).lobes
        lobes = LobesApart(found.low[:, 0], found.lobes[:, 0])
        missed = interpolated(lobes, weights).harmonics() - target
        errors[coherent] = np.linalg.norm(missed) / np.linalg.norm(target)
    assert errors[True] < 0.02
    assert errors[True] < errors[False]


def test_half_precision_is_not_left() -> None:
    lobes = LobesApart(
        np.full((1, 4), 1e5), Lobes(np.array([[[0.0, 0.0, 1.0]]]), np.zeros((1, 1, 3)))
    )
    with pytest.raises(PrtnetError, match="too bright"):
        halved("a", lobes)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"low": numbers(48, 1, 3)}, "low has shape"),
        ({"axes": numbers(48, 3, 3)}, "axes has shape"),
        ({"axes": numbers(48, 1, 3, 3)}, "unit vectors"),
        ({"coefficients": numbers(48, 1, 3, 4)}, "stored apart"),
        ({"coefficients": numbers(48, 1, 2, 4)}, "coefficients has shape"),
        ({"low": np.full((48, 1, 4), np.nan, dtype=np.float32)}, "not finite"),
        ({"low": np.zeros((48, 1, 4))}, "float64"),
        ({"low": numbers(47, 1, 4)}, "different numbers of points"),
        ({"view": numbers(1, 15, 3)}, "view factors"),
    ],
)
def test_arrays_that_do_not_fit(change: dict[str, Any], why: str) -> None:
    with pytest.raises(ValueError, match=why):
        dataclasses.replace(lobe_field(patch(), 3), **change)


def test_spoiled_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    good = lobe_field(patch(), 3)
    for header, drop, said in (
        ({"format_version": 2}, None, "format version 2"),
        ({"order": 5}, None, "coefficients have shape"),
        ({"order": "many"}, None, "not a whole prtnet field of lobes"),
        ({"layout": "torus"}, None, "torus"),
        ({}, "axes", "axes"),
        ({}, "heights", "heights"),
    ):
        good.save(path)
        with safetensors.safe_open(path, framework="numpy") as file:
            old = json.loads(file.metadata()[LOBES])
        arrays = safetensors.numpy.load_file(path)
        arrays.pop(drop or "", None)
        path.write_bytes(safetensors.numpy.save(arrays, {LOBES: json.dumps(old | header)}))
        with pytest.raises(PrtnetError) as caught:
            LobeField.load(path)
        assert said in str(caught.value)
        assert "\n" not in str(caught.value)
    patch().save(path)
    with pytest.raises(PrtnetError, match="is a prtnet transfer field, not a field of lobes"):
        LobeField.load(path)


def test_turned_lobes_are_lobes_of_the_turned_frame() -> None:
    lobes = lobe_field(patch(), 3).lobes
    turn = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turned = lobes.rotated(turn)
    np.testing.assert_allclose(
        linear_axis(turned.low)[..., [1, 0]],
        linear_axis(lobes.low)[..., [0, 1]] * [1.0, -1.0],
        atol=1e-6,
    )
