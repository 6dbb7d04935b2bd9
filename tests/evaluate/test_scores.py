"""Reports of scores against values worked out by hand."""

import math

from gaussray.evaluate.scores import scores_text, summary


def row(psnr, part, moving=None, seconds=0.5, **more):
    own = {"psnr": psnr, "ssim": 0.5, "part": part, "seconds": seconds, **more}
    return own | ({"moving": moving} if moving else {})


def test_means_over_pictures_and_over_moving_pixels():
    rows = [row(20.0, "train", (1.0, 10)), row(30.0, "train", (0.0, 90), seconds=None)]
    found = summary(rows, 4)
    assert found["psnr"] == 25 and found["samples"] == 4 and found["frames"] == 2
    # One squared unit over a hundred values: 1e-2, whatever picture it is in.
    assert found["psnr_moving"] == 20
    assert found["fps"] == 2
    assert "parts" not in found


def test_parts_are_the_same_means_of_their_own_rows():
    rows = [row(20.0, "held_out_cameras"), row(30.0, "held_out_times"), row(40.0, "held_out_times")]
    found = summary(rows, 1)
    assert found["psnr"] == 30
    assert {n: (p["psnr"], p["frames"]) for n, p in found["parts"].items()} == {
        "held_out_cameras": (20, 1),
        "held_out_times": (35, 2),
    }


def test_equal_pictures_are_infinite_and_what_is_not_measured_is_a_dash():
    found = summary([row(math.inf, "train", (0.0, 90), seconds=None)], 1)
    assert found["psnr"] is None and found["psnr_moving"] is None and found["fps"] is None
    assert "psnr_masked" not in found
    heads, cells = scores_text({"effects": {"pinhole": found}}).splitlines()
    names = ["effect", "PSNR", "SSIM", "masked PSNR", "masked SSIM", "moving PSNR", "FPS", "frames"]
    assert heads.split() == " ".join(names).split()
    shown = dict(zip(names, cells.split(), strict=True))
    assert shown["PSNR"] == shown["moving PSNR"] == "inf"
    assert shown["masked PSNR"] == shown["FPS"] == "-"


def test_a_table_shows_parts_below_their_effect_and_only_metrics_that_were_measured():
    rows = [row(20.0, "train", flip=0.125), row(30.0, "held_out_times", flip=0.375)]
    text = scores_text({"effects": {"fisheye": summary(rows, 1)}}).splitlines()
    assert "FLIP" in text[0] and "LPIPS" not in text[0]
    assert [line.split("  ")[0] or line.strip().split("  ")[0] for line in text[1:]] == [
        "fisheye",
        "held out times",
        "train",
    ]
    assert "0.250" in text[1] and "0.375" in text[2] and "0.125" in text[3]


def test_exposure_matched_scores_are_shown_only_where_exposures_differ():
    def rows(*stops):
        known = {"psnr_matched": 26.0, "part": "train"}
        return [row(20.0 + k, exposure_stops=x, **known) for k, x in enumerate(stops)]

    same = summary(rows(0.09, -0.09), 1)
    assert "psnr_matched" not in same and "exposure_stops" not in same
    assert "exposure" not in scores_text({"effects": {"pinhole": same}})
    # sqrt((0.5^2 + 0.1^2) / 2)
    found = summary(rows(0.5, -0.1), 1)
    assert found["psnr_matched"] == 26 and found["exposure_stops"] == round(math.sqrt(0.13), 4)
    assert "exposure-matched PSNR" in scores_text({"effects": {"pinhole": found}})


def test_all_parts_have_exposure_matched_scores_or_none():
    rows = [
        row(20.0, "train", psnr_matched=20.0, exposure_stops=0.0),
        row(20.0, "held_out_cameras", psnr_matched=24.0, exposure_stops=0.4),
    ]
    parts = summary(rows, 1)["parts"]
    assert {n: p.get("psnr_matched") for n, p in parts.items()} == {
        "held_out_cameras": 24,
        "train": 20,
    }
