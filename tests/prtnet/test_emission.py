from __future__ import annotations

import math

import numpy as np
import pytest

from prtnet import sh
from prtnet.emission import Cap, Dome, Emitter, Panorama, SoftLobe, Turned, emitters
from prtnet.environment import Environment, about_up
from prtnet.equirectangular import Picture
from prtnet.luminance import REC709
from prtnet.presets import PRESETS, Disc, Preset
from prtnet.sampling import lattice

BLACK = (0.0, 0.0, 0.0)


def texels(peak: float = 0.0) -> np.ndarray:
    rng = np.random.default_rng(5)
    found = rng.random((12, 24, 3)) ** 3
    found[3:5, 2:9] = 0.0
    found[8, 23] = peak
    return found


TILT = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
TILT *= np.linalg.det(TILT)
EMITTERS: dict[str, Emitter] = {
    "lobe": SoftLobe(7.0, 2.0),
    "wide lobe": SoftLobe(1e-3, 1.0),
    "cap": Turned(Cap(0.4, 3.0), TILT),  # no edge along a ring of the quadrature
    "dome": Dome(0.2, 0.0, 1.3),
    "sky": Dome(0.0, 0.4, 0.0),
    "picture": Panorama((texels() @ REC709)[..., None]),
    "picture with a sun": Panorama((texels(500.0) @ REC709)[..., None]),
    "turned": Turned(SoftLobe(20.0, 1.0), TILT),
}


@pytest.mark.parametrize("name", EMITTERS)
def test_draws_follow_the_density(name):
    """The density integrates to 1, and harmonics' means over draws are its integrals."""
    emitter = EMITTERS[name]
    directions, weights = sh.quadrature(700)
    share = weights * emitter.density(directions)
    assert share.sum() == pytest.approx(1.0, abs=3e-3)
    drawn = emitter.draw(lattice(1 << 14))
    assert np.linalg.norm(drawn, axis=1) == pytest.approx(np.ones(len(drawn)))
    assert (emitter.density(drawn) > 0.0).all()
    expected = share @ sh.evaluate(directions, 8)
    assert sh.evaluate(drawn, 8).mean(axis=0) == pytest.approx(expected, abs=6e-3)


@pytest.mark.parametrize("sharpness", [1e-3, 7.0, 2000.0, 1e6])
def test_a_lobe_of_any_sharpness_is_drawn_from(sharpness):
    """The mean of 1 − cos is that of an exponential, cut at 2: 1/κ − 2/(e^(2κ) − 1)."""
    drop = 1.0 - SoftLobe(sharpness, 1.0).draw(lattice(4096))[:, 2]
    mean = 1.0 / sharpness - (2.0 / math.expm1(2.0 * sharpness) if sharpness < 300 else 0.0)
    assert drop.mean() == pytest.approx(mean, rel=1e-3)


@pytest.mark.parametrize("name", PRESETS)
def test_parts_of_a_preset_are_as_bright_as_it_is(name):
    """Luminance is Σ power · density, where no disc has a soft rim."""
    light = Environment(PRESETS[name]).turned(70.0).rotated(TILT)
    directions = np.concatenate([sh.fibonacci_sphere(500), *(
        one.draw(lattice(20)) for one in emitters(light)
    )])  # fmt: skip
    total = sum(one.power * one.density(directions) for one in emitters(light))
    luminance = light.radiance(directions) @ REC709
    if any(isinstance(lamp, Disc) for lamp in PRESETS[name].lamps):
        assert (total >= luminance - 1e-9).all()
    else:
        assert total == pytest.approx(luminance, rel=1e-6)


@pytest.mark.parametrize("peak", [0.0, 7e4])
def test_a_picture_is_drawn_as_its_radiance_says(peak):
    """Radiance over density is its power, but for the height of a row of texels."""
    light = Environment(Picture(texels(peak))).rotated(about_up(33.0))
    (panorama,) = emitters(light)
    drawn = panorama.draw(lattice(5000))
    ratio = light.radiance(drawn) @ REC709 / panorama.density(drawn)
    # The mean is the power itself; single ones differ by sin θ within a row.
    directions, weights = sh.quadrature(900)
    power = weights @ light.radiance(directions) @ REC709
    assert ratio.mean() == pytest.approx(power, rel=3e-3)
    assert ratio.max() < 2.1 * power
    assert panorama.power == pytest.approx(power, rel=0.02)


def test_nothing_is_drawn_of_what_is_dark_or_unknown():
    class Unknown:
        def radiance(self, directions: np.ndarray) -> np.ndarray:
            return np.ones_like(directions)

        def harmonics(self, order: int) -> np.ndarray:
            return np.zeros((order**2, 3))

    assert emitters(Environment(Unknown())) == []
    assert emitters(Environment(Picture(np.zeros((2, 4, 3))))) == []
    black = Preset((Disc(0.0, 90.0, 5.0, 6.0, BLACK),), BLACK, BLACK, BLACK)
    assert emitters(Environment(black)) == []


def test_light_that_is_less_than_nothing_is_drawn_too():
    picture = texels()
    picture[6, 6] = -40.0
    (panorama,) = emitters(Environment(Picture(picture)))
    drawn = panorama.draw(lattice(2000))
    assert (Picture(picture).radiance(drawn) @ REC709 < -10.0).any()
