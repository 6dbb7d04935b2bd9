"""Pictures that lie elsewhere than a JSON file says, or are spelt otherwise: the folder was moved,
written on another computer, or its pictures were converted."""

import dataclasses
import glob
import itertools
import re
from collections.abc import Iterable, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from gaussray.capture.formats.json_keys import Keys
from gaussray.capture.picture_file import picture_exists
from gaussray.io.safe.files import file_of_same_name


# Suffixes that are tried, in this order, where `file_path` has none.
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
_OTHERS = (".exr", ".tif", ".tiff", ".bmp", ".webp", ".pgm", ".ppm", ".pnm")
KNOWN_SUFFIXES = {*PICTURE_SUFFIXES, *_OTHERS}
# Folders between that of the JSON file and a picture's path, at most.
_PLACES = ("", "*/", "*/*/")
# Absent pictures that are looked for elsewhere, for a message.
_LOOKED_FOR = 100
# Folders of a path, and bytes of one's name, at most.
_DEEP, _LONG = 40, 250
# Share of the pictures that must be found in another place; of fewer, at least so many, if nothing
# else is there.
_MOST, _FEWEST = 0.5, 2
_NAMED = ("file_path", "mask_path", "depth_file_path")
# nerfstudio's lists of paths, which tell the split of each.
_LISTS = ("train_filenames", "val_filenames", "test_filenames")
# Folders whose pictures often have the same names, but are others.
_SPLITS = {"train", "test", "val"}
# Folders beside undistorted pictures, which have another lens (COLMAP's reconstructors).
_MODELS = ("sparse", "stereo")


class _Move(NamedTuple):
    """Another folder for paths that begin with the folder `before`: the places, relative to the
    JSON file, in which most pictures are found, and their number."""

    before: tuple[str, ...]
    places: list[tuple[str, ...]]
    count: int


def with_found_pictures(frames: list[Keys]) -> list[Keys]:
    """The frames, with the paths at which their pictures are where none is where `file_path` says.

    Names that differ from those of files by case or suffix alone are replaced. Otherwise a folder
    at the beginning of all paths is left out, or replaced by one in the folder of the JSON file: of
    the places where most pictures are found, the one that keeps most of the paths. Fewer than half
    of the pictures count only where all that are there have the names of some. Nothing is changed
    where several keep as much, and pictures of one split are not taken for those of another. A
    warning tells what was changed.

    Args:
        frames: the frames of one JSON file.
    """
    named = [frame for frame in frames if isinstance(frame.values.get("file_path"), str)]
    names = [_parts(frame.values["file_path"]) for frame in named]
    if not any(names) or any(map(_is_where_it_says, named)):
        return frames
    first, folder = named[0], named[0].file.parent
    spelt = other_spellings(folder, [frame.values["file_path"] for frame in named])
    if spelt:
        old, new = next(iter(spelt.items()))
        first.warn(
            f"no picture is where the path says. {len(spelt)} of {len(names)} are found if their "
            f"names are spelt otherwise ({new} for {old}), and are read there."
        )
        return [_with_spellings(frame, spelt) for frame in frames]
    move = _find_move(folder, names) or _find_full_move(folder, names)
    if move is None:
        # Both moved and converted to another kind of picture.
        bare = [_without_suffix(frame) for frame in frames]
        moved = with_found_pictures(bare) if bare != frames else bare
        return frames if moved is bare else moved
    if len(move.places) > 1:
        return frames
    before, place = move.before, move.places[0]
    first.warn(
        f"no picture is where the path says. {move.count} of {len(names)} are found if "
        f"{_change(before, place)}, and are read there."
    )
    lists = {
        key: [_text(name, before, place) for name in first.values[key]]
        for key in _LISTS
        if isinstance(first.values.get(key), list)
    }
    return [_with_paths(frame, before, place, lists) for frame in frames]


def _find_move(folder: Path, names: Sequence[tuple[str, ...]]) -> _Move | None:
    """The move that keeps most of the first path and finds at least half of the pictures; None if
    there is none.

    Args:
        folder: the folder of the JSON file.
        names: the paths of the pictures; one that no file system has is empty.
    """
    first = next(filter(None, names))
    for kept in range(len(first), 0, -1):
        before = first[: len(first) - kept]
        counts = {}
        for place in _places_of(folder, first[-kept:]):
            if _may_replace(folder, before, place):
                moved = (_moved(name, before, place) for name in names)
                counts[place] = sum(_is_picture(folder.joinpath(*path)) for path in moved if path)
        most = max(counts.values(), default=0)
        if most >= max(_MOST * len(names), 1):
            return _Move(before, [place for place, n in counts.items() if n == most], most)
    return None


def _find_full_move(folder: Path, names: Sequence[tuple[str, ...]]) -> _Move | None:
    """The move that keeps most of the first path and finds the more of the pictures, to folders
    that hold no others; None if there is none.

    Args:
        folder: the folder of the JSON file.
        names: the paths of the pictures; one that no file system has is empty.
    """
    listed = (path for place in _PLACES for path in folder.glob(f"{place}*"))
    files = {p.relative_to(folder).parts for p in listed if p.suffix.lower() in KNOWN_SUFFIXES}
    first = next(filter(None, names))
    for kept in range(len(first), 0, -1):
        before = first[: len(first) - kept]
        tails = {name[len(before) :] for name in names if name[: len(before)] == before}
        found: dict[tuple[str, ...], set[tuple[str, ...]]] = {}
        for file in files:
            bare = *file[:-1], Path(file[-1]).stem
            for k in range(len(file)):
                if file[k:] in tails or bare[k:] in tails:
                    found.setdefault(file[:k], set()).add(file)
        counts = {
            place: len(pictures)
            for place, pictures in found.items()
            if len(pictures) >= _FEWEST
            and _may_replace(folder, before, place)
            and not {picture[:-1] for picture in pictures} & {f[:-1] for f in files - pictures}
        }
        if counts:
            most = max(counts.values())
            return _Move(before, [place for place, n in counts.items() if n == most], most)
    return None


def _may_replace(folder: Path, before: tuple[str, ...], place: tuple[str, ...]) -> bool:
    """Whether pictures of a place may be those of a folder: neither those of another split, nor
    those of another model."""
    split = _SPLITS.intersection(before[-1:]) and _SPLITS.intersection(place[-1:])
    return not split and _home_of_model(folder, place) is None


def _without_suffix(frame: Keys) -> Keys:
    """The frame without the suffix of its picture: one of PICTURE_SUFFIXES is found then."""
    name = frame.values.get("file_path")
    if not isinstance(name, str) or Path(name).suffix.lower() not in KNOWN_SUFFIXES:
        return frame
    short = name[: -len(Path(name).suffix)]
    return dataclasses.replace(frame, values={**frame.values, "file_path": short})


def other_spellings(folder: Path, names: Sequence[str]) -> dict[str, str]:
    """The names of absent pictures, with those of files beside where they would be that differ by
    letter case or suffix alone; nothing where several files do, or for fewer than half.

    Args:
        folder: the folder that the names are relative to.
        names: paths of pictures, of which none exists.
    """
    beside: dict[PurePosixPath, dict[str, list[str]]] = {}
    found = {}
    for name in names:
        parts = _parts(name)
        if not parts:
            continue
        path = PurePosixPath(*parts)
        if path.parent not in beside:
            beside[path.parent] = _pictures_by_stem(folder / path.parent)
        alike = beside[path.parent].get(_stem(path.name), [])
        if len(alike) == 1:
            found[name] = (path.parent / alike[0]).as_posix()
    return found if len(found) >= max(_MOST * len(names), 1) else {}


def _pictures_by_stem(folder: Path) -> dict[str, list[str]]:
    """The names of the pictures in a folder, by their stems in small letters."""
    names: dict[str, list[str]] = {}
    try:
        pictures = sorted(p for p in folder.iterdir() if p.suffix.lower() in KNOWN_SUFFIXES)
    except OSError:
        return {}
    for path in pictures:
        names.setdefault(_stem(path.name), []).append(path.name)
    return names


def _stem(name: str) -> str:
    path = PurePosixPath(name)
    return (path.stem if path.suffix.lower() in KNOWN_SUFFIXES else name).casefold()


def _with_spellings(frame: Keys, spelt: dict[str, str]) -> Keys:
    lists = {
        key: [spelt.get(name, name) if isinstance(name, str) else name for name in listed]
        for key in _LISTS
        if isinstance(listed := frame.values.get(key), list)
    }
    name = frame.values.get("file_path")
    path = {"file_path": spelt[name]} if isinstance(name, str) and name in spelt else {}
    return dataclasses.replace(frame, values={**frame.values, **lists, **path})


def absent_picture_hint(folder: Path, names: Iterable[str], remedy: str = "") -> str:
    """A sentence that tells where a picture of the name of an absent one lies, and whether it is
    one of another model, which must not be copied; none if it lies nowhere.

    Args:
        folder: where to look, also in its folders and in theirs.
        names: paths that name no picture; the first of which there is a file elsewhere is told.
        remedy: a sentence about copying the pictures, which follows unless they must not be copied.
    """
    found = (file_of_same_name(folder, name) for name in itertools.islice(names, _LOOKED_FOR))
    path = next(filter(None, found), None)
    home = path and _home_of_model(folder, path.relative_to(folder).parts[:-1])
    if home:
        return (
            f" A file of this name is {path}, which belongs to a model of its own: name {home}, "
            "and do not copy it."
        )
    hint = f" A file of this name is {path}." if path else ""
    return f"{hint} {remedy}" if remedy else hint


def _home_of_model(folder: Path, place: tuple[str, ...]) -> Path | None:
    """The folder on the way to a place that holds a model of its own; None if there is none. The
    pictures there are others: undistorted ones have other lenses, and often the same names."""
    homes = (folder.joinpath(*place[:k]) for k in range(1, len(place) + 1))
    return next((h for h in homes if any((h / name).is_dir() for name in _MODELS)), None)


def _parts(name: str) -> tuple[str, ...]:
    """The folders and the name of a path of any system, without a drive and steps upwards; none if
    no file system has such a path."""
    path = PurePosixPath(re.sub(r"^[A-Za-z]:", "", name.replace("\\", "/")))
    parts = tuple(part for part in path.parts if part not in ("/", "//", ".."))
    longest = max((len(part.encode(errors="replace")) for part in parts), default=0)
    if len(parts) > _DEEP or longest > _LONG or re.search(r"[\x00-\x1f\x7f]", name):
        return ()
    return parts


def _is_where_it_says(frame: Keys) -> bool:
    try:
        return _is_picture(frame.file.parent / frame.values["file_path"].replace("\\", "/"))
    except (OSError, ValueError):
        return False


def _is_picture(path: Path) -> bool:
    """Whether there is a picture of this path, with or without one of the suffixes."""
    return any(picture_exists(Path(f"{path}{suffix}")) for suffix in ("", *PICTURE_SUFFIXES))


def _places_of(folder: Path, path: tuple[str, ...]) -> set[tuple[str, ...]]:
    """The folders, relative to this one, in which there is such a file."""
    name = glob.escape("/".join(path))
    return {
        file.relative_to(folder).parts[: -len(path)]
        for place in _PLACES
        for suffix in ("", *PICTURE_SUFFIXES)
        for file in folder.glob(f"{place}{name}{suffix}")
        if file.is_file()
    }


def _moved(
    name: tuple[str, ...], before: tuple[str, ...], place: tuple[str, ...]
) -> tuple[str, ...]:
    """A path with another folder in place of the one it begins with; none if it does not."""
    return (*place, *name[len(before) :]) if name[: len(before)] == before else ()


def _change(before: tuple[str, ...], place: tuple[str, ...]) -> str:
    """What must be done to a path that begins with one folder, for another."""
    old, new = ("/".join(parts) + "/" for parts in (before, place))
    if not before:
        return f"{new} is put before it"
    return f"it begins with {new} instead of {old}" if place else f"its beginning {old} is left out"


def _with_paths(
    frame: Keys, before: tuple[str, ...], place: tuple[str, ...], lists: dict[str, list[Any]]
) -> Keys:
    named = [key for key in _NAMED if frame.has(key)]
    paths = {key: _text(frame.values[key], before, place) for key in named}
    return dataclasses.replace(frame, values={**frame.values, **lists, **paths})


def _text(name: Any, before: tuple[str, ...], place: tuple[str, ...]) -> Any:
    """A path with another folder at its beginning; what is none, or begins otherwise, stays."""
    moved = _moved(_parts(name), before, place) if isinstance(name, str) else ()
    return "/".join(moved) if moved else name
