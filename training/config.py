"""How a model is fitted: one typed configuration, saved whole in the model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from prtnet.errors import PrtnetError
from prtnet.features import Occluders
from prtnet.model import INT4_OF_LOBES
from prtnet.skin_surroundings import SkinSurroundings
from prtnet.storage import Storage

__all__ = ["PRESETS", "TrainConfig"]


@dataclass(frozen=True)
class TrainConfig:
    """Options of `prtnet train`."""

    kind: Literal[
        "constant", "linear", "quadratic", "neural", "hybrid", "shared", "lobes", "auto"
    ] = "neural"
    """The regressor: none at all, ridge regression on the inputs or also on the products of the
    leading ones, or one hidden layer of tanh. Or two that see what surrounds every receiver:
    hybrid maps it by a matrix a cluster, shared by one network for all receivers; a tanh layer
    a cluster then corrects what is left, in so many latents. Or lobes, which a regressor of the
    first kinds predicts in place of visibility: a few zonal lobes a receiver, quick to turn.
    With auto a search decides, as with --max-error: the smallest model within a tenth of the
    least error that quick kinds are expected to reach, or all kinds for point caches."""
    features: Literal["joint_angles", "local_joints", "occluders"] | None = None
    """What it sees: the papers' joint angles (dihedral angles for point caches), or what is around
    each cluster, joints or occluders; when not given, occluders for skinned scenes."""
    lobes: int = 2
    """Zonal lobes of each receiver's visibility; only of kind lobes."""
    regressor: Literal["linear", "quadratic", "neural"] | None = None
    """What predicts them; linear, as in the paper, when not given. Only of kind lobes."""
    clusters: int = 64
    """Clusters of receivers, equally large."""
    clustering: Literal["position", "weights", "rigid", "signal"] = "position"
    """What they are made of: position and skin weights; segments of like skin weights; segments
    that turn alike; or receivers whose visibility varies alike."""
    parts: int = 1
    """Groups of receivers in each cluster: each has output components of its own, and all are
    driven by the cluster's one hidden layer."""
    frame: Literal["local", "global"] = "local"
    """Frame of the output; models in the global one can only be evaluated on their dataset."""
    target: Literal["visibility", "cosine"] = "visibility"
    """What is fitted; models of cosine-weighted visibility can only be evaluated likewise."""
    neurons: int | Literal["auto"] = 32
    """Neurons in each cluster's hidden layer; auto cross-validates 8, 16, 32 and 64, with α, and is
    16 for hybrid and shared."""
    leading: int = 12
    """So many leading inputs are multiplied with each other in a quadratic model."""
    smoothness: float = 0.0
    """Linear and quadratic: weight of the prior that what moves little changes little."""
    networks: int = 1
    """Networks fitted from different starts and averaged into one of networks × neurons."""
    restarts: int = 1
    """Starts of each network, of which every cluster keeps the best after a few iterations."""
    output_variance: float = 0.99
    """Fraction of the visibility's variance that the output components keep."""
    latents: float = 10.0
    """At most so many output components a cluster, on average; with parts, its groups' in all."""
    step: int = 4
    """Groups have multiples of so many output components: few different sizes are fast."""
    input_variance: float = 0.999
    """Fraction of the features' variance that the input components keep."""
    inputs: int = 48
    """At most so many input components a cluster."""
    spheres: int = 160
    """About how many occluding spheres are fitted to the skin."""
    points: int = 6
    """Reference points in each cluster that look at the spheres."""
    near: int = 48
    """Spheres that the reference points of a cluster look at."""
    feature_order: int = 3
    """Bands of the spherical harmonics of what a reference point sees, at most 3."""
    near_spheres: int = 40
    """Spheres that the receivers of a cluster look at: hybrid and shared."""
    patches: int = 768
    """About how many pieces the skin is cut into, which receivers look at: hybrid and shared."""
    near_patches: int = 64
    """Pieces of the skin that the receivers of a cluster look at: hybrid and shared."""
    prior_order: int = 4
    """Bands of the spherical harmonics of what receivers see, at most 4: hybrid and shared."""
    samples: int = 2_000_000
    """Pairs of a pose and a receiver that a prior is fitted to: hybrid and shared."""
    width: int = 64
    """Neurons in each layer of the shared network."""
    depth: int = 2
    """Layers of neurons of the shared network."""
    codes: int = 16
    """Learned numbers of each receiver that the shared network sees."""
    steps: int = 5000
    """Of the shared network's training."""
    alpha: float | None = None
    """Weight decay. When not given: 0.003 for hybrid and shared, whose prior has seen every clip;
    else chosen by cross-validation, over whole clips or over quarters of the only one."""
    iterations: int = 200
    """Of L-BFGS, at most."""
    seed: int = 0
    """Of clusters, spheres and starting weights."""
    storage: Storage = "float32"
    """How the model's large arrays are stored: int8 is a quarter of the bytes; int4 has components
    that explain little in half of that. Errors are of the rounded model."""
    device: str = "cpu"
    """Where torch fits: cpu, or cuda."""

    def __post_init__(self) -> None:
        """Refuse values that cannot work."""
        least = {"clusters": 1, "neurons": 1, "networks": 1, "inputs": 1, "iterations": 1}
        least["restarts"] = 1
        least |= {"spheres": 1, "points": 1, "near": 1, "feature_order": 1, "latents": 0}
        least |= {"parts": 1, "step": 1, "leading": 1}
        least |= {"near_spheres": 1, "patches": 1, "near_patches": 1, "prior_order": 1}
        least |= {"lobes": 1, "samples": 1, "width": 1, "depth": 1, "codes": 0, "steps": 1}
        for name, bound in least.items():
            value = getattr(self, name)
            if value != "auto" and not value >= bound:  # so that NaN fails
                raise PrtnetError(f"--{name.replace('_', '-')}", f"must be at least {bound}")
        if self.kind in ("hybrid", "shared") and (self.frame, self.target) != (
            "local",
            "visibility",
        ):
            raise PrtnetError("--kind", f"{self.kind} predicts visibility in local frames only")
        if self.kind == "lobes":
            if self.storage == "int4":
                raise PrtnetError("--storage", INT4_OF_LOBES)
            if self.frame != "local":
                raise PrtnetError("--frame", "lobes are fitted in local frames; leave it out")
        elif self.regressor is not None:
            raise PrtnetError("--regressor", "is that of --kind lobes; other kinds are regressors")
        if self.prior_order > SkinSurroundings.MOST_ORDER:
            raise PrtnetError("--prior-order", f"must be at most {SkinSurroundings.MOST_ORDER}")
        if self.feature_order > Occluders.MOST_ORDER:
            raise PrtnetError("--feature-order", f"must be at most {Occluders.MOST_ORDER}")
        for name in ("output_variance", "input_variance"):
            if not 0.0 < getattr(self, name) <= 1.0:
                raise PrtnetError(f"--{name.replace('_', '-')}", "must be above 0 and at most 1")
        for name in ("alpha", "smoothness"):
            value = getattr(self, name)
            if value is not None and not 0 <= value < float("inf"):
                raise PrtnetError(f"--{name}", "must be a finite number, at least 0")
        if not 0 <= self.seed < 2**32:
            raise PrtnetError("--seed", "must be at least 0 and below 2^32")

    @property
    def regression(self) -> str:
        """The kind of regressor: that of the lobes, or the model's own kind."""
        return self.regressor or "linear" if self.kind == "lobes" else self.kind


PRESETS: dict[str, TrainConfig] = {
    "default": TrainConfig(),
    "small": TrainConfig(clusters=32, neurons=16, latents=6, points=3, near=24, spheres=64),
    "fast": TrainConfig(parts=8, latents=32),
    "large": TrainConfig(
        parts=8, latents=96, neurons=64, inputs=64, points=12, near=96, spheres=240
    ),
    "best": TrainConfig(
        kind="shared",
        width=256,
        steps=8000,
        samples=3_000_000,
        latents=20,
        neurons=64,
        networks=2,
        points=12,
        near=96,
        inputs=64,
    ),
    "tiny": TrainConfig(kind="hybrid", latents=0, storage="int8"),
    "paper": TrainConfig(
        features="joint_angles", latents=1e9, output_variance=0.95, input_variance=0.9
    ),
}
"""Named starting points: the papers' own choices among them."""
