"""Builds a lens from the intrinsics and the `lens` block of a capture's JSON."""

from jaxtyping import DTypeLike

from gaussray.camera.lens import AbstractLens, check_lens
from gaussray.camera.lens.registry import lens_models, models_by_block, models_by_camera_model
from gaussray.capture.formats.json_keys import Keys


# Keys of a frame from which its lens is built, beside the `lens` block.
INTRINSICS = (
    *("w", "h", "fl_x", "fl_y", "cx", "cy", "camera_model"),
    *dict.fromkeys(key for model in lens_models() for key in model.frame_keys),
)
# camera_model -> effect of a frame that has neither a lens block nor an "effect".
LENS_LABELS = {
    name: model.label for name, model in models_by_camera_model().items() if not model.perspective
}
# Of the pixels of a picture, so many may have no viewing direction because distortion turns back
# before its corners, as that of OpenCV's calibrations does where no board was seen, or that of one
# radial coefficient (Anipose's).
LARGEST_DARK_SHARE = 0.5
# Width of a pixel as a share of its height, outside of which hardly any camera has pixels.
_PIXEL_SHAPES = (0.9, 1.1)
# Keys of a `lens` block, of all models.
_BLOCK_KEYS = ("model", *dict.fromkeys(key for model in lens_models() for key in model.block_keys))


def unusual_pixels(fl_x: float, fl_y: float) -> str:
    """What is unusual in the shape of a lens's pixels; empty if nothing is.

    Args:
        fl_x: focal length in widths of a pixel.
        fl_y: focal length in heights of a pixel.
    """
    low, high = _PIXEL_SHAPES
    shape = fl_y / fl_x
    return "" if low <= shape <= high else f"pixels that are {shape:.3g} times as wide as high"


def lens_of(keys: Keys, dtype: DTypeLike) -> AbstractLens:
    """The lens of a frame: that of its `lens` block if there is one, else that of `camera_model`.

    Args:
        keys: keys of the frame, with those of the top level that it does not have.
        dtype: type of the lens's numbers.

    Raises:
        CaptureError: a key is missing or breaks its rule.
        ValueError: the numbers are no valid lens for the picture; the message names the key.
    """
    block = keys.block("lens", _BLOCK_KEYS)
    if block is not None:
        model = models_by_block()[block.choice("model", tuple(models_by_block()))]
    else:
        name = keys.choice("camera_model", tuple(models_by_camera_model()), "PINHOLE")
        model = models_by_camera_model()[name]
        block = Keys(keys.file, {}, keys.frame, "lens.")
    lens = model.from_keys(keys, block, dtype)
    if not lens.check_is_complete:
        lacking = check_lens(lens, keys.count("w"), keys.count("h"), dark=LARGEST_DARK_SHARE)
        if lacking and lens.fills_picture:
            keys.warn(
                f"{lens.fold_message[0]} turns back within the picture: about "
                f"{max(round(100 * lacking), 1)} % of its pixels, at the corners, have no viewing "
                "direction and do not count."
            )
    return lens
