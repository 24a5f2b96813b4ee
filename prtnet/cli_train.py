"""The work of ``prtnet train`` that is more than a call: a search within a budget, or a cluster.

Beside ``prtnet.cli``, which it serves, it may import the other packages: a budget of milliseconds
is measured by the runtime.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from prtnet.cli_arguments import refuse
from prtnet.errors import PrtnetError
from prtnet.limits import MOST_LOBES, check_within

if TYPE_CHECKING:
    from prtnet.dataset import Dataset
    from prtnet.model import VisibilityModel
    from training.budget import Budget
    from training.config import TrainConfig
    from training.monitor import Monitor

__all__ = ["check_cluster", "check_lobe_options", "fitting", "summary"]

OF_PRIORS = ("near_spheres", "patches", "near_patches", "prior_order", "samples", "width", "depth",
             "codes", "steps")  # fmt: skip
OF_NETWORKS = ("neurons", "networks", "restarts", "iterations")


def check_lobe_options(config: TrainConfig, named: Mapping[str, str]) -> None:
    """Refuse options that do nothing for lobes, or for anything but lobes.

    Args:
        config: of the fit.
        named: options that are given, as ``prtnet.cli_arguments.named_options`` tells.

    Raises:
        PrtnetError: there is one.
    """
    if config.kind != "lobes":
        if "lobes" in named:
            raise PrtnetError("--lobes", "is of --kind lobes; add that, or leave this out")
        return
    check_within("--lobes", config.lobes, 1, MOST_LOBES)
    regression = config.regression
    whys = dict.fromkeys(OF_PRIORS, "does nothing for --kind lobes; leave it out")
    if regression != "neural":
        whys |= dict.fromkeys(OF_NETWORKS, "needs --regressor neural; add it, or leave this out")
    if regression != "quadratic":
        whys["leading"] = "needs --regressor quadratic; add it, or leave this out"
    if regression == "neural":
        whys["smoothness"] = "is of --regressor linear and quadratic; leave it out"
    refuse(named, whys)


def check_cluster(
    address: str | None,
    exchange: Path | None,
    config: TrainConfig,
    budget: Budget,
    tell: Callable[[str], None],
) -> None:
    """Refuse to hand over what is nothing, and tell what is not handed over.

    Args:
        address: of the cluster; None for none.
        exchange: where work is handed over; that alone hands it to threads of this process.
        config: of the fit.
        budget: of a search, which tries kinds of its own.
        tell: the user.

    Raises:
        PrtnetError: it would have nothing to do.
    """
    if address is None and exchange is None:
        return
    option = "--exchange" if address is None else "--cluster"
    if config.device != "cpu":
        told = f"has no say in fits that are handed over; leave it, or {option}, out"
        raise PrtnetError("--device", told)
    if budget or config.kind == "auto":
        return
    from training.train import NEURAL

    if config.regression not in NEURAL or config.latents < 1:
        what = f"a {config.regression} model without networks of clusters"
        raise PrtnetError(option, f"does nothing for {what}; leave it out")
    if config.kind in ("hybrid", "shared"):
        tell(f"{option} is for the networks of clusters; what all receivers of a {config.kind} "
             "model share is one fit, made here and anew")  # fmt: skip


def fitting(
    dataset: Dataset, config: TrainConfig, budget: Budget, threads: int
) -> Callable[[Monitor], VisibilityModel]:
    """How to fit a model: as configured, or the cheapest within a budget."""
    if not budget and config.kind != "auto":
        from training.train import train as fit

        return functools.partial(fit, dataset, config)
    from runtime.onnx_model import OnnxModel
    from training.search import search

    pose = dataset.read("pose", slice(1))

    def milliseconds(proto: bytes) -> float:
        return OnnxModel(proto, threads).milliseconds(pose)

    return functools.partial(search, dataset, config, budget, milliseconds)


def summary(results: Mapping[str, Any]) -> dict[str, Any]:
    """What people are shown of a model that was trained."""
    errors = {n: results[n] for n in ("training_error", "held_out_error") if n in results}
    shown = {"out": results["out"], "model_bytes": results["model_bytes"], "errors": errors}
    if "search" in results:
        shown |= {"chosen": results["search"]["why"], "compared": compared(results["search"])}
    return shown


def compared(search: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """What a search compared, as a table for people."""
    return {
        each["family"]: {
            "expected": f"{100 * each['error']:.2f} %",
            "MB": f"{each['model_bytes'] / 1e6:.2f}",
            "ms": "–" if each["ms"] is None else f"{each['ms']:.3f}",
            "meets": each["meets"],
        }
        for each in search["compared"]
    }
