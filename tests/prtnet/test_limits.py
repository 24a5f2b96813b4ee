from __future__ import annotations

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest

from prtnet import cli, limits
from prtnet.cli_arguments import named_options
from prtnet.errors import PrtnetError
from prtnet.lobe_field import LobeField
from prtnet.lobe_fit import lobe_field
from prtnet.transfer import Patch, TransferField


def field(order: int, rows: int = 1, texels: tuple[int, int] = (1, 2)) -> TransferField:
    layout = Patch(np.zeros(texels, np.float32), np.ones((*texels, 3), np.float32), (1.0, 1.0))
    transfer = np.random.default_rng(0).normal(size=(texels[0] * texels[1], rows, order**2))
    view = None if rows == 1 else np.ones((rows, 4, 3), np.float32)
    return TransferField(transfer.astype(np.float32), layout, view)


def refusal(tmp_path: Path, made: TransferField | LobeField) -> str:
    """What is said of it when it is read."""
    path = tmp_path / "a.safetensors"
    made.save(path)
    with pytest.raises(PrtnetError) as caught:
        type(made).load(path)
    assert "\n" not in caught.value.message
    return caught.value.message


def many_lobes(count: int) -> LobeField:
    """Lobes of the same axis."""
    few = lobe_field(field(4), 3)
    shape = (2, 1, count)
    axes = np.broadcast_to(np.array([0, 0, 1], np.float32), (*shape, 3)).copy()
    return dataclasses.replace(few, axes=axes, coefficients=np.zeros((*shape, 4), np.float32))


def test_readers_refuse_what_no_command_makes(tmp_path: Path) -> None:
    assert "order 17, of at most 16" in refusal(tmp_path, field(17))
    assert "5 rows, of at most 4" in refusal(tmp_path, field(2, 5))
    assert "4097x1 texels, of at most 4096" in refusal(tmp_path, field(1, 1, (1, 4097)))
    assert "9 lobes a row, of at most 8" in refusal(tmp_path, many_lobes(9))
    assert "order 17" in refusal(tmp_path, lobe_field(field(17, 1, (1, 1)), 1))


def test_the_most_that_commands_make_is_read(tmp_path: Path) -> None:
    path = tmp_path / "a.safetensors"
    for made in (field(16), field(2, 4), field(1, 1, (1, 4096)), many_lobes(8)):
        made.save(path)
        assert len(type(made).load(path)) == len(made)


@pytest.mark.parametrize(("least", "most"), [(1.0, 8.0), (-2.0, math.inf)])
def test_numbers_within(least: float, most: float) -> None:
    for good in (None, least, 3.0, min(most, 1e9)):
        limits.check_within("--a", good, least, most)
    for bad in (least - 1.0, math.nan, most + 1.0 if most < 9 else -math.inf):
        with pytest.raises(PrtnetError, match=r"--a: is .*; it must be"):
            limits.check_within("--a", bad, least, most)


def test_sides() -> None:
    limits.check_side("--size", None, 4)
    limits.check_side("--size", (4, 1), 4)
    with pytest.raises(PrtnetError, match="at most 4x4"):
        limits.check_side("--size", (1, 5), 4)


def test_options_that_are_given() -> None:
    argv = ["waffle", "--rays", "32", "--light-turn=4", "--coherent", "-h"]
    found = {"rays": "--rays", "light_turn": "--light-turn", "coherent": "--coherent"}
    assert named_options(argv) == found


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["--kind", "linear", "--lobes", "2"], "--lobes: is of --kind lobes"),
        (["--lobes", "3"], "--lobes: is of --kind lobes"),
        (["--max-error", "5%", "--lobes", "3"], "--lobes: is of --kind lobes"),
        (["--kind", "lobes", "--lobes", "9"], "--lobes: is 9; it must be from 1 to 8"),
        (["--kind", "lobes", "--neurons", "8"], "--neurons: needs --regressor neural"),
        (["--kind", "lobes", "--iterations=9"], "--iterations: needs --regressor neural"),
        (["--kind", "lobes", "--leading", "8"], "--leading: needs --regressor quadratic"),
        (["--kind", "lobes", "--width", "8"], "--width: does nothing for --kind lobes"),
        (["--kind", "lobes", "--near-patches", "8"], "--near-patches: does nothing"),
        (
            ["--kind", "lobes", "--regressor", "neural", "--smoothness", "1"],
            "--smoothness: is of --regressor linear and quadratic",
        ),
    ],
)
def test_training_options_that_would_do_nothing_for_lobes(argv, said, tmp_path, capsys) -> None:
    out = str(tmp_path / "a.safetensors")
    assert cli.run(["train", "no.zarr", "--out", out, *argv]) == 2
    err = capsys.readouterr().err
    assert said in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    "argv",
    [
        ["--kind", "linear", "--neurons", "8"],
        ["--preset", "small", "--kind", "lobes", "--lobes", "1", "--latents", "4"],
        ["--kind", "lobes", "--regressor", "neural", "--neurons", "8"],
        ["--kind", "lobes", "--regressor", "quadratic", "--leading", "8", "--smoothness", "1"],
    ],
)
def test_other_training_options_are_not_in_the_way(argv, tmp_path, capsys) -> None:
    out = str(tmp_path / "a.safetensors")
    assert cli.run(["train", str(tmp_path / "no.zarr"), "--out", out, *argv]) == 2
    assert "no.zarr: does not exist" in capsys.readouterr().err
