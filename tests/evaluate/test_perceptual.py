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
    assert flip(truth, truth) == 0
    assert 0 < flip(truth, ours) < flip(truth, 255 - truth) <= 1
    # Black against white is the largest error there is.
    assert flip(np.zeros_like(truth), np.full_like(truth, 255)) > 0.9


def test_lpips_without_weights_is_left_out_with_a_warning(monkeypatch):
    hide(monkeypatch, "flip_evaluator")

    def absent(**_):
        raise OSError("no network")

    monkeypatch.setattr(importlib.util, "find_spec", lambda n: n == "lpips" or None)
    monkeypatch.setitem(sys.modules, "lpips", types.SimpleNamespace(LPIPS=absent))
    monkeypatch.setitem(sys.modules, "torch", types.SimpleNamespace())
    with pytest.warns(UserWarning, match="no network"):
        assert perceptual_metrics() == {}
