"""Tensors of torch are read as they were saved, and nothing in the file is ever run."""

import inspect
import os
import pickle
import zipfile
from collections import OrderedDict

import foreign
import numpy as np
import pytest

from gaussray.scene.formats import pth
from gaussray.scene.formats.pth import read_tensors


TABLE = {
    "a": np.arange(6, dtype=np.float32).reshape(2, 3),
    "b.weight": np.array([0.1, -2.5]),
    "half": np.float16([1.5]),
    "count": np.array(7),
    "mask": np.array([True, False]),
    "none": np.zeros((0, 4), np.float32),
}


def same(found, expected):
    assert list(found) == list(expected)
    for name, x in expected.items():
        assert found[name].dtype == x.dtype and found[name].flags.owndata
        np.testing.assert_array_equal(found[name], x)


def one(path, shape, strides, first=0, count=6, numbers=6, kind="f4", **how):
    """A file of a single tensor `x` of the numbers 0, 1, 2, ..."""
    tensor = foreign.described(foreign.storage("0", kind, count), shape, strides, first)
    data = np.arange(numbers, dtype=kind)
    order = how.get("order")
    data = data.astype(data.dtype.newbyteorder(">")) if order == "big" else data
    pickled = foreign.dictionary([foreign.text("x") + tensor])
    foreign.write_archive(path, pickled, {"0": data.tobytes()}, **how)
    return path


def test_every_tensor_is_what_was_saved(tmp_path):
    foreign.write_pth(tmp_path / "deformation.pth", TABLE)
    same(read_tensors(tmp_path / "deformation.pth"), TABLE)


@pytest.mark.parametrize(
    ("shape", "strides", "first", "expected"),
    [
        ((3, 2), (1, 3), 0, [[0, 3], [1, 4], [2, 5]]),
        ((2,), (2,), 1, [1, 3]),
        ((), (), 4, 4),
        ((2, 3), (0, 1), 3, [[3, 4, 5], [3, 4, 5]]),
        ((0, 3), (3, 1), 99, np.zeros((0, 3))),
    ],
)
def test_a_tensor_shows_its_storage_by_offset_and_strides(
    tmp_path, shape, strides, first, expected
):
    path = one(tmp_path / "a.pth", shape, strides, first)
    np.testing.assert_array_equal(read_tensors(path)["x"], expected)


@pytest.mark.parametrize("order", ["little", "big"])
def test_the_byte_order_is_the_files(tmp_path, order):
    found = read_tensors(one(tmp_path / "a.pth", (6,), (1,), order=order))["x"]
    np.testing.assert_array_equal(found, np.arange(6))
    assert found.dtype == np.dtype("f4")


@pytest.mark.parametrize(
    ("shape", "strides", "first", "counts"),
    [
        ((7,), (1,), 0, {}),
        ((6,), (1,), 1, {}),
        ((2, 2), (5, 2), 0, {}),
        ((10**6,), (0,), 0, {}),
        ((2**40, 2**40), (1, 1), 0, {}),
        ((6,), (1,), 0, {"numbers": 5}),
        ((6,), (1,), 0, {"count": 5}),
        ((2,), (1,), 2**62, {}),
    ],
)
def test_a_tensor_beyond_its_numbers_is_refused(tmp_path, shape, strides, first, counts):
    path = one(tmp_path / "a.pth", shape, strides, first, **counts)
    with pytest.raises(ValueError, match=r"'x' of shape .* must lie within its [56] numbers"):
        read_tensors(path)


@pytest.mark.parametrize(
    ("shape", "strides", "first"), [((-1,), (1,), 0), ((2,), (-1,), 1), ((2,), (1, 1), 0)]
)
def test_a_shape_that_is_none_is_refused(tmp_path, shape, strides, first):
    with pytest.raises(ValueError, match="'x' must have a shape and strides"):
        read_tensors(one(tmp_path / "a.pth", shape, strides, first))


def call(module, name, *arguments):
    return foreign.name_of(module, name) + foreign.series(*arguments) + pickle.REDUCE


BAD = [
    (call("os", "mkdir", foreign.text("owned")), r"os\.mkdir"),
    (call("builtins", "eval", foreign.text("1")), r"builtins\.eval"),
    (foreign.name_of("numpy", "ndarray"), r"numpy\.ndarray"),
    (foreign.name_of("collections", "deque"), r"collections\.deque"),
    (foreign.name_of("torch", "load"), r"torch\.load"),
    (foreign.name_of("torch.hub", "load"), r"torch\.hub\.load"),
    (foreign.text("plain"), "'x', a str"),
    (foreign.number(3), "'x', a int"),
    (foreign.ordered_dict(), "'x', a dict"),
]


@pytest.mark.parametrize(("value", "named"), BAD)
def test_all_but_tensors_is_refused_by_name_and_never_run(tmp_path, monkeypatch, value, named):
    monkeypatch.chdir(tmp_path)
    pickled = foreign.dictionary([foreign.text("x") + value])
    foreign.write_archive(tmp_path / "a.pth", pickled, {})
    with pytest.raises(ValueError, match=f"a.pth: must hold a dictionary of tensors .* {named}"):
        read_tensors(tmp_path / "a.pth")
    assert os.listdir(tmp_path) == ["a.pth"]


def test_a_pickled_object_with_code_is_refused(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "owned"),))

    for value in (Bomb(), {"x": Bomb()}, [Bomb()]):
        foreign.write_archive(tmp_path / "a.pth", pickle.dumps(value), {})
        with pytest.raises(ValueError, match="which is refused: it could run a program"):
            read_tensors(tmp_path / "a.pth")
    assert os.listdir(tmp_path) == ["a.pth"]


def test_nothing_that_a_name_gives_outlives_the_file(tmp_path):
    """BUILD sets attributes, of functions and classes too."""
    good, path = tmp_path / "good.pth", tmp_path / "a.pth"
    foreign.write_pth(good, TABLE)
    key = foreign.text("__defaults__")
    note = pickle.EMPTY_DICT + key + foreign.series(foreign.text("owned")) + pickle.SETITEM
    values = [
        foreign.name_of("torch._utils", "_rebuild_tensor_v2"),
        foreign.name_of("torch._utils", "_rebuild_parameter"),
        foreign.name_of("torch", "FloatStorage"),
        foreign.name_of("collections", "OrderedDict"),
        foreign.storage("0", "f4", 1),
        foreign.described(foreign.storage("0", "f4", 1), (1,), (1,)),
    ]
    for value in values:
        for state in (note, foreign.series(pickle.NONE, note)):
            pickled = foreign.dictionary([foreign.text("x") + value + state + pickle.BUILD])
            foreign.write_archive(path, pickled, {"0": b"1234"})
            with pytest.raises(ValueError, match="a.pth: (the pickle is damaged|must hold a dict)"):
                read_tensors(path)
    own = [x for x in vars(pth).values() if inspect.isfunction(x) or inspect.isclass(x)]
    functions = [*own, *vars(pth._Reader).values(), OrderedDict]
    assert len(functions) > 5
    assert all("owned" not in str(getattr(x, "__defaults__", "")) for x in functions)
    same(read_tensors(good), TABLE)


def test_a_storage_that_is_missing_is_named(tmp_path):
    tensor = foreign.described(foreign.storage("5", "f4", 1), (1,), (1,))
    pickled = foreign.dictionary([foreign.text("x") + tensor])
    foreign.write_archive(tmp_path / "a.pth", pickled, {"0": b"1234"})
    with pytest.raises(ValueError, match="the numbers of 'x' are missing"):
        read_tensors(tmp_path / "a.pth")


def test_a_pickle_that_is_cut_off_anywhere_is_refused(tmp_path):
    tensor = foreign.described(foreign.storage("0", "f4", 1), (1,), (1,))
    pickled = foreign.dictionary([foreign.text("x") + tensor])
    for end in range(len(pickled)):
        foreign.write_archive(tmp_path / "a.pth", pickled[:end], {"0": b"1234"})
        with pytest.raises(ValueError, match="a.pth: the pickle is damaged"):
            read_tensors(tmp_path / "a.pth")


def test_bytes_by_chance_are_read_or_refused_and_nothing_else(tmp_path):
    """A byte of the pickle changed to any other: no exception but ours."""
    draw = np.random.default_rng(0)
    tensor = foreign.described(foreign.storage("0", "f4", 1), (1,), (1,))
    good = foreign.dictionary([foreign.text("x") + tensor])
    refused = 0
    for _ in range(300):
        bad = bytearray(good)
        bad[draw.integers(len(bad))] = draw.integers(256)
        foreign.write_archive(tmp_path / "a.pth", bytes(bad), {"0": b"1234"})
        try:
            read_tensors(tmp_path / "a.pth")
        except ValueError as error:
            refused += 1
            assert str(error).startswith(str(tmp_path / "a.pth"))
    assert refused > 150


def test_other_files_are_refused(tmp_path):
    path = tmp_path / "a.pth"
    with pytest.raises(FileNotFoundError, match="a.pth: no such file"):
        read_tensors(path)
    foreign.write_pth(path, TABLE)
    whole = path.read_bytes()
    with zipfile.ZipFile(tmp_path / "b.pth", "w") as archive:
        archive.writestr("a text", "b")
    damaged = bytearray(whole)
    damaged[whole.index(TABLE["a"].tobytes()) + 5] ^= 1
    tensor = {"x": np.zeros(100_000, np.float32)}
    foreign.write_pth(tmp_path / "c.pth", tensor)
    with zipfile.ZipFile(tmp_path / "c.pth") as plain:
        with zipfile.ZipFile(tmp_path / "d.pth", "w", zipfile.ZIP_DEFLATED) as packed:
            for name in plain.namelist():
                packed.writestr(name, plain.read(name))
    others = [b"", b"a text", whole[: len(whole) // 2], bytes(damaged), pickle.dumps({})]
    others += [(tmp_path / name).read_bytes() for name in ("b.pth", "d.pth")]
    for content in others:
        path.write_bytes(content)
        with pytest.raises(ValueError, match=r"a.pth: must be a file of torch.save \(torch 1.6"):
            read_tensors(path)


def test_what_torch_saves_is_read(tmp_path):
    """The real thing, with views, a parameter and every kind of number."""
    torch = pytest.importorskip("torch", reason="an extra")

    grown = torch.arange(24, dtype=torch.float32).reshape(2, 3, 4)
    tensors = {
        "view": grown[:, 1:, ::2].transpose(0, 2),
        "expanded": torch.ones(2, 1).expand(2, 1),
        "parameter": torch.nn.Parameter(torch.ones(3)),
        **{str(kind): torch.ones(2).to(kind) for kind in (
            torch.float64, torch.float16, torch.int64, torch.int32, torch.int16, torch.int8,
            torch.uint8, torch.bool)},
    }  # fmt: skip
    torch.save(tensors, tmp_path / "a.pth")
    same(read_tensors(tmp_path / "a.pth"), {k: x.detach().numpy() for k, x in tensors.items()})
    layers = torch.nn.Sequential(torch.nn.Linear(3, 2), torch.nn.ReLU(), torch.nn.Linear(2, 1))
    torch.save(layers.state_dict(), tmp_path / "b.pth")
    expected = {k: x.numpy() for k, x in layers.state_dict().items()}
    same(read_tensors(tmp_path / "b.pth"), expected)
    torch.save(layers, tmp_path / "c.pth")
    with pytest.raises(ValueError, match=r"torch\.nn\.modules\.container\.Sequential"):
        read_tensors(tmp_path / "c.pth")
    torch.save(tensors, tmp_path / "d.pth", _use_new_zipfile_serialization=False)
    with pytest.raises(ValueError, match="must be a file of torch.save"):
        read_tensors(tmp_path / "d.pth")
