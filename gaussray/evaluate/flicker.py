"""Flicker: how much static pixels change over time."""

import numpy as np
from jaxtyping import Bool, UInt8


class Flicker:
    """Accumulates the flicker of each camera's pictures.

    Flicker is the root mean square difference of a camera's pictures from their mean over time,
    over pixels that never move, in 8-bit sRGB levels. The capture's own flicker comes from noise
    and small changes of light; a rendering is as steady as the capture if its flicker is no larger.
    Pictures may come in any order; a camera with one picture does not count.
    """

    def __init__(self):
        # Number, sum and sum of squares of the pictures by part and camera, truth before rendering.
        # 32 bits are exact up to 66,000 pictures.
        self._sums: dict[tuple[str, str], tuple[int, np.ndarray, np.ndarray]] = {}

    def add(
        self,
        part: str,
        camera: str,
        static: Bool[np.ndarray, "h w"],
        truth: UInt8[np.ndarray, "h w 3"],
        image: UInt8[np.ndarray, "h w 3"],
    ) -> None:
        """Add a picture of a camera.

        Args:
            part: group of the picture: training, held-out cameras or held-out times.
            camera: name of the camera.
            static: pixels in which nothing moves; the same for all pictures of a camera.
            truth: picture of the capture, in 8-bit levels.
            image: rendered picture, in 8-bit levels.
        """
        levels = np.stack([truth[static], image[static]]).astype(np.uint32)
        frames, total, square = self._sums.get(
            (part, camera), (0, *np.zeros_like([levels, levels]))
        )
        self._sums[part, camera] = frames + 1, total + levels, square + levels * levels

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
            frames = sum(one[0] for one in sums)
            if frames > 1:
                total = np.stack([x for _, x, _ in sums]).sum(axis=0, dtype=np.float64)
                squares = np.stack([x for _, _, x in sums]).sum(axis=0, dtype=np.float64)
                square += np.sum(squares - total * total / frames, axis=(1, 2))
                weight += frames * total[0].size
        if not weight:
            return {}
        truth, rendered = np.sqrt(np.maximum(square, 0) / weight)
        return {"flicker": round(float(rendered), 4), "flicker_truth": round(float(truth), 4)}
