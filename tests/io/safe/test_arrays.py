"""Files of arrays give the arrays that NumPy wrote, and nothing else."""

import io
import pickle
import zipfile

import numpy as np
import pytest

from gaussray.io.safe.arrays import Damaged, read_npy, read_npz
from gaussray.io.safe.limits import Limits, limit, limits


ARRAYS = {
    "a": np.arange(6, dtype=np.float32).reshape(2, 3),
    "columns": np.asfortranarray(np.arange(6.0).reshape(3, 2)),
    "none": np.zeros((0, 4)),
    "one": np.array(7),
    "text": np.array("a text"),
}


def entry(descr, shape, data=b"", fortran=False):
    told = f"{{'descr': {descr!r}, 'fortran_order': {fortran}, 'shape': {shape}, }}".ljust(117)
    return (
        b"\x93NUMPY\x01\x00" + len(told + "\n").to_bytes(2, "little") + told.encode() + b"\n" + data
    )


def archive(path, **entries):
    with zipfile.ZipFile(path, "w") as file:
        for name, data in entries.items():
            file.writestr(f"{name}.npy", data)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_those_that_were_saved(tmp_path, save):
    save(tmp_path / "a.npz", **ARRAYS)
    found = read_npz(tmp_path / "a.npz")
    assert list(found) == list(ARRAYS)
    for name, x in ARRAYS.items():
        assert found[name].dtype == x.dtype and found[name].flags.writeable
        np.testing.assert_array_equal(found[name], x)
    np.save(tmp_path / "a.npy", ARRAYS["columns"])
    np.testing.assert_array_equal(read_npy(tmp_path / "a.npy"), ARRAYS["columns"])


def test_objects_are_never_unpickled(tmp_path):
    class Bomb:
        def __reduce__(self):
            return (exec, ("raise SystemExit",))

    data = io.BytesIO()
    np.save(data, np.array([Bomb()], object), allow_pickle=True)
    for content in (data.getvalue(), entry("|O", "(1,)", pickle.dumps([1]))):
        with pytest.raises(Damaged, match="a.npz: 'a.npy': no array of NumPy"):
            read_npz(archive(tmp_path / "a.npz", a=content))


@pytest.mark.parametrize(
    "content",
    [
        entry("<f8", "(10**12,)".replace("10**12", "1" + "0" * 12)),
        entry("<f8", "(-1,)"),
        entry("<f4", "(3,)", b"1234"),
        entry("<f4", "(0,)", b"1234"),
        entry("<U999999999", "(9,)"),
        entry([("a", "<f4")], "(1,)", b"1234"),
        entry("<f4", "(" + "1, " * 40 + ")", b"1234"),
        entry("<f4", "('a',)"),
        entry("<f16", "(1,)", b"1234" * 4),
        entry("<f4", "(" * 50),
        b"",
        b"text",
    ],
)
def test_a_header_that_lies_is_refused_before_memory_is_taken(tmp_path, content):
    with pytest.raises(Damaged, match="a.npz: 'a.npy': no array of NumPy"):
        read_npz(archive(tmp_path / "a.npz", a=content))
    (tmp_path / "a.npy").write_bytes(content)
    with pytest.raises(Damaged, match="a.npy: no array of NumPy"):
        read_npy(tmp_path / "a.npy")


def test_a_bomb_is_refused_by_what_it_would_take(tmp_path):
    """A thousandth of its size on disk."""
    path, before = tmp_path / "a.npz", limits()
    np.savez_compressed(path, a=np.zeros(1_000_000, np.uint8))
    assert path.stat().st_size < 5000
    limit(Limits(arrays=0.0005))
    try:
        with pytest.raises(
            ValueError, match=r"GB must be at most limits.arrays=0.0005, got 0.00100"
        ):
            read_npz(path)
    finally:
        limit(before)


def test_every_file_that_is_cut_off_is_refused(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.zeros(3))
    whole = (tmp_path / "a.npz").read_bytes()
    for end in range(0, len(whole), 3):
        (tmp_path / "b.npz").write_bytes(whole[:end])
        with pytest.raises(Damaged, match="b.npz: "):
            read_npz(tmp_path / "b.npz")


def test_two_arrays_of_one_name_are_refused(tmp_path):
    with pytest.warns(UserWarning), zipfile.ZipFile(tmp_path / "a.npz", "w") as file:
        for _ in range(2):
            file.writestr("a.npy", entry("<f4", "(1,)", b"1234"))
    with pytest.raises(Damaged, match="two arrays have one name"):
        read_npz(tmp_path / "a.npz")


def test_entries_that_would_lie_before_the_file_are_refused(tmp_path):
    """What seeking there raises is not of zipfile's kind."""
    path = tmp_path / "a.npz"
    np.savez(path, a=np.zeros(3))
    data = bytearray(path.read_bytes())
    end = data.rindex(b"PK\x05\x06")
    data[end + 16 : end + 20] = (2**31).to_bytes(4, "little")
    path.write_bytes(bytes(data))
    with pytest.raises(Damaged, match="a.npz: "):
        read_npz(path)


def test_numbers_are_in_the_byte_order_of_the_machine(tmp_path):
    """JAX takes no other."""
    np.savez(tmp_path / "a.npz", a=np.arange(3, dtype=">f4"))
    found = read_npz(tmp_path / "a.npz")["a"]
    assert found.dtype.isnative
    np.testing.assert_array_equal(found, [0, 1, 2])


@pytest.mark.parametrize("order", ["<", ">"])
def test_a_text_of_numbers_that_are_no_characters_is_refused(tmp_path, order):
    """NumPy makes a broken text of them, of which Python says that it is at fault itself."""
    for number, good in ((0x61, True), (0x10FFFF, True), (0x110000, False), (2**31, False)):
        data = np.array([0x62, number], f"{order}u4").tobytes()
        archive(tmp_path / "a.npz", x=entry(f"{order}U2", (), data))
        if good:
            assert str(read_npz(tmp_path / "a.npz")["x"]) == "b" + chr(number)
            continue
        with pytest.raises(Damaged, match="a.npz: 'x.npy': .* no characters"):
            read_npz(tmp_path / "a.npz")


def test_names_of_entries_that_are_no_text_are_refused(tmp_path):
    archive(tmp_path / "a.npz", **{"\u00e9": b"x"})
    content = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(content.replace("\u00e9".encode(), b"\xb3\xb3"))
    with pytest.raises(Damaged, match="a.npz: 'utf-8' codec"):
        read_npz(tmp_path / "a.npz")
