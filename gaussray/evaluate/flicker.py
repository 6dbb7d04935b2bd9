"""Flicker: how much static pixels change over time."""

import numpy as np
from jaxtyping import Bool, UInt8


class Flicker:
    """Accumulates the flicker of each camera's pictures.

    Flicker is the root mean square difference of a camera's pictures from their mean over time,
    over pixels that never move, in 8-bit sRGB levels. The capture's own flicker comes from noise
    and small changes of light; a rendering is as steady as the capture if its flicker is no larger.
    Pictures may come in any order; a pixel that counts in one picture alone does not count.
    """

    def __init__(self):
        # Number, sum and sum of squares of the levels of each static pixel by part and camera,
        # truth before rendering. 16 and 32 bits are exact up to 65,535 pictures.
        self._sums: dict[tuple[str, str], tuple[np.ndarray, np.ndarray, np.ndarray]] = {}

    def add(
        self,
        part: str,
        camera: str,
        static: Bool[np.ndarray, "h w"],
        truth: UInt8[np.ndarray, "h w 3"],
        image: UInt8[np.ndarray, "h w 3"],
        shown: Bool[np.ndarray, "h w"] | None = None,
    ) -> None:
        """Add a picture of a camera.

        Args:
            part: group of the picture: training, held-out cameras or held-out times.
            camera: name of the camera.
            static: pixels in which nothing moves; the same for all pictures of a camera.
            truth: picture of the capture, in 8-bit levels.
            image: rendered picture, in 8-bit levels.
            shown: pixels that count in this picture; None: all.
        """
        levels = np.stack([truth[static], image[static]]).astype(np.uint32)
        counts = np.ones(levels.shape[1], np.uint16)
        if shown is not None:
            counts = shown[static].astype(np.uint16)
            levels *= counts[:, None]
        if (part, camera) not in self._sums:
            nothing = np.zeros_like(levels)
            self._sums[part, camera] = np.zeros_like(counts), nothing, nothing.copy()
        for sums, one in zip(self._sums[part, camera], (counts, levels, levels**2), strict=True):
            sums += one

    def figures(self, part: str | None = None) -> dict[str, float]:
        """`flicker` of the renderings and `flicker_truth` of the capture, for one part or for all.

        Cameras are weighted by their number of pictures and pixels. Empty without data.
        """
        square, weight = np.zeros(2), 0
        for camera in dict.fromkeys(camera for _, camera in self._sums):
            sums = [
                one
                for (name, owner), one in self._sums.items()
                if owner == camera and part in (None, name)
            ]
            if not sums:
                continue
            frames = np.sum([one[0] for one in sums], axis=0)
            several = frames > 1
            total, squares = (
                np.sum([one[k][:, several] for one in sums], axis=0, dtype=np.float64)
                for k in (1, 2)
            )
            seen = frames[several][:, None]
            square += np.sum(squares - total * total / seen, axis=(1, 2))
            weight += 3 * int(seen.sum())
        if not weight:
            return {}
        truth, rendered = np.sqrt(np.maximum(square, 0) / weight)
        return {"flicker": round(float(rendered), 4), "flicker_truth": round(float(truth), 4)}
