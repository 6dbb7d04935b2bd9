"""Optional metrics: found where their packages are, right where they are, silent where not."""

import importlib.util
import sys
import types

import numpy as np
import pytest

from gaussray.evaluate.perceptual import perceptual_metrics


def pictures():
    truth = np.random.default_rng(0).integers(0, 255, (64, 64, 3), np.uint8)
    return truth, np.clip(truth.astype(int) + 40, 0, 255).astype(np.uint8)


def hide(monkeypatch, *names):
    real = importlib.util.find_spec
    monkeypatch.setattr(importlib.util, "find_spec", lambda n: None if n in names else real(n))


def test_packages_that_are_absent_are_left_out(monkeypatch):
    hide(monkeypatch, "flip_evaluator", "lpips")
    assert perceptual_metrics() == {}


def test_flip_is_zero_for_equal_pictures_and_grows_with_the_difference(monkeypatch):
    pytest.importorskip("flip_evaluator")
    hide(monkeypatch, "lpips")
    flip = perceptual_metrics()["flip"]
    truth, ours = pictures()
    assert flip(truth, truth, None) == 0
    assert 0 < flip(truth, ours, None) < flip(truth, 255 - truth, None) <= 1
    # Black against white is the largest error there is.
    assert flip(np.zeros_like(truth), np.full_like(truth, 255), None) > 0.9
    whole = np.ones(truth.shape[:2], bool)
    assert flip(truth, ours, whole) == pytest.approx(flip(truth, ours, None), rel=1e-4)


def test_flip_of_what_is_shown_leaves_out_what_spreads_to_the_rest(monkeypatch):
    package = pytest.importorskip("flip_evaluator")
    hide(monkeypatch, "lpips")
    shown = np.zeros((64, 64), bool)
    shown[30:38, 30:38] = True
    black = np.zeros((64, 64, 3), np.uint8)
    white = np.where(shown[..., None], 255, black).astype(np.uint8)
    errors = package.evaluate(
        black / np.float32(255), white / np.float32(255), "LDR", False, False
    )[0]
    assert errors[~shown].sum() > 0.2 * errors.sum()
    found = perceptual_metrics()["flip"](black, white, shown)
    assert found == pytest.approx(errors[shown].mean(), rel=1e-5) and found <= 1


def test_lpips_of_what_is_shown_is_the_mean_of_its_map(monkeypatch):
    torch = pytest.importorskip("torch")

    class Network:
        """As that of the package: a mean, or with `spatial` the map of which it is."""

        spatial = False

        def __init__(self, **_):
            pass

        def __call__(self, truth, image):
            errors = (truth - image).abs().mean(dim=1, keepdim=True)
            return errors if self.spatial else errors.mean(dim=(2, 3), keepdim=True)

    monkeypatch.setattr(importlib.util, "find_spec", lambda n: n == "lpips" or None)
    monkeypatch.setitem(sys.modules, "lpips", types.SimpleNamespace(LPIPS=Network))
    monkeypatch.setitem(sys.modules, "torch", torch)
    lpips = perceptual_metrics()["lpips"]
    truth, ours = pictures()
    errors = np.abs(truth.astype(float) - ours).mean(axis=-1) / 127.5
    shown = np.random.default_rng(1).random((64, 64)) < 0.3
    assert lpips(truth, ours, shown) == pytest.approx(errors[shown].mean(), rel=1e-4)
    assert lpips(truth, ours, None) == pytest.approx(errors.mean(), rel=1e-4)


def test_lpips_without_weights_is_left_out_with_a_warning(monkeypatch):
    hide(monkeypatch, "flip_evaluator")

    def absent(**_):
        raise OSError("no network")

    monkeypatch.setattr(importlib.util, "find_spec", lambda n: n == "lpips" or None)
    monkeypatch.setitem(sys.modules, "lpips", types.SimpleNamespace(LPIPS=absent))
    monkeypatch.setitem(sys.modules, "torch", types.SimpleNamespace())
    with pytest.warns(UserWarning, match="no network"):
        assert perceptual_metrics() == {}
