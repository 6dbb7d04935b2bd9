"""The mask of a photograph by its name: which file beside the pictures it is."""

from collections.abc import Callable, Collection
from pathlib import Path

from gaussray.capture.mask_folder import mask_in
from gaussray.prepare.input_files import files_in
from gaussray.prepare.photographs import PHOTOGRAPH_SUFFIXES
from gaussray.prepare.unused_inputs import MASK_MARK
from gaussray.prepare.video_masks import MASK_FOLDERS


# The masks of a folder by the names of their pictures without suffix, in small letters.
MarkedMasks = dict[str, Path]


def marked_masks(folder: Path) -> MarkedMasks:
    """The masks of a folder that are called as their picture and `_mask` or `.mask`, in letters of
    any case, by the picture's name without suffix in small letters.

    Args:
        folder: a folder of masks, which may not exist.
    """
    files = files_in(folder, PHOTOGRAPH_SUFFIXES) if folder.is_dir() else []
    found: MarkedMasks = {}
    # Of several of one picture a PNG counts first: a JPEG blurs the border.
    for path in sorted(files, key=lambda path: path.suffix.lower() != ".png"):
        stem = path.stem.lower()
        if MASK_MARK.search(stem):
            found.setdefault(MASK_MARK.sub("", stem), path)
    return found


def mask_of(
    picture: Path,
    *,
    alone: bool,
    marked: Callable[[Path], MarkedMasks] = marked_masks,
    ours: Collection[Path] = (),
) -> Path | None:
    """The mask of a picture, by its name; None if there is none.

    That of `images/a.jpg` is `masks/a.png`, `masks/a.jpg.png`, `masks/a.jpg`, `masks/a_mask.png`
    or `masks/a.mask.png`, beside the folder of the pictures; that of `cam01/a.jpg` is in
    `masks/cam01/`, beside the camera's folder or one further up. Or they are in a folder `masks/`
    within that of the pictures. `mask/` serves as well as `masks/`.

    Args:
        picture: a photograph.
        alone: whether all pictures are in one folder; masks without a folder of a camera are not
            those of one of several folders.
        marked: `marked_masks`, or the same with a memory, for many pictures of one folder.
        ours: masks that an earlier run has written, which are none of the input.
    """
    camera = picture.parent
    homes = [camera.parent / name / camera.name for name in MASK_FOLDERS]
    homes += [camera.parent.parent / name / camera.name for name in MASK_FOLDERS]
    homes += [camera / name for name in MASK_FOLDERS]
    homes += [camera.parent / name for name in MASK_FOLDERS if alone]
    names = picture.stem.lower(), picture.name.lower()
    for home in (home for home in homes if home != camera):
        # Ours is called a.jpg.png, and may hide one of the input that is a.png.
        called = picture.name, picture.with_suffix(".none").name
        found = [mask_in(home, name) for name in called]
        found += [marked(home)[name] for name in names if name in marked(home)]
        for mask in found:
            if mask is not None and mask.resolve() not in ours:
                return mask
    return None
