from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
import pytest
from p2o import InputError
from p2o.files.array_file import read_npy, read_npz


def npy(array: Any) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def npz(**arrays: Any) -> bytes:
    file = io.BytesIO()
    np.savez_compressed(file, **arrays)
    return file.getvalue()


def header(text: str, body: bytes = b"") -> bytes:
    raw = text.encode()
    return b"\x93NUMPY\x01\x00" + len(raw).to_bytes(2, "little") + raw + body


@pytest.mark.parametrize(
    "array",
    [
        np.arange(12.0).reshape(3, 4),
        np.asfortranarray(np.arange(12, dtype=">i4").reshape(3, 4)),
        np.float16([1.5, np.nan]),
        np.array(7, np.uint8),
        np.zeros((0, 3)),
        np.array("a name"),
        np.zeros(3, [("axis", "i1"), ("line", "<f4")]),
        np.array([True, False]),
    ],
)
def test_arrays_come_back_as_numpy_wrote_them(array: Any) -> None:
    read, packed = read_npy(npy(array)), read_npz(npz(a=array))["a"]
    for found in (read, packed):
        assert found.dtype == array.dtype
        assert found.shape == array.shape
        assert found.tobytes() == array.tobytes()
    assert packed.flags.writeable


# Headers that promise more than the file holds, which is found out before memory is taken.
SHAPES = ["(1000000, 1000000)", "(1000000000000,)", f"({'9' * 5000},)", "(8,)", "(-1,)", "(2, -2, -2)"]


@pytest.mark.parametrize(
    "data",
    [
        *(header(f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}", bytes(40)) for shape in SHAPES),
        b"\x93NUMPY",
        header("{'descr': '<f8', 'shape': (1,), }", bytes(8)),
        header("{'descr': '|O', 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        header("{'descr': '<f9', 'fortran_order': False, 'shape': (1,), }", bytes(9)),
        header("{'descr': [('a', '|O')], 'fortran_order': False, 'shape': (1,), }", bytes(8)),
        header("{'descr': [('a', '<f4'), ('b', ('<f4', (9,)))], 'fortran_order': False, 'shape': (1,), }", bytes(99)),
        header("(" * 9000),
        b"no array",
    ],
)
def test_what_is_no_plain_array_is_refused(data: bytes) -> None:
    with pytest.raises(InputError, match=r"d\.npy: this is not an \.npy file of numbers"):
        read_npy(data, "d.npy")


def test_an_archive_that_unpacks_to_too_much_is_refused_before_it_is_unpacked() -> None:
    data = npz(a=np.zeros(1 << 20), b=np.zeros(1 << 20))
    with pytest.raises(InputError, match=r"d\.npz: the unpacked \.npz archive is too large; expected at most 8388608"):
        read_npz(data, "d.npz", most=1 << 23)
    assert set(read_npz(data, "d.npz", most=1 << 25)) == {"a", "b"}
    # One whose directory lies about sizes gives no more than it says.
    lying = bytearray(npz(a=np.zeros(1 << 20)))
    at = lying.rfind(b"PK\x01\x02")
    lying[at + 24 : at + 28] = (1 << 10).to_bytes(4, "little")
    with pytest.raises(InputError, match=r"not an \.npz archive, or it is damaged"):
        read_npz(bytes(lying), "d.npz", most=1 << 12)


def test_archives_with_objects_of_another_packing_or_cut_off_are_refused_and_headers_of_others_read() -> None:
    with pytest.raises(InputError, match=r"d\.npz: the \.npz archive holds pickled objects"):
        read_npz(npz(a=np.array([{}], dtype=object)), "d.npz")
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_LZMA) as packed:
        packed.writestr("a.npy", npy(np.zeros(3)))
    for data in (file.getvalue(), npz(a=np.zeros(9))[:-9], b"PK", npy(np.zeros(3))):
        with pytest.raises(InputError, match=r"d\.npz: this is not an \.npz archive, or it is damaged"):
            read_npz(data, "d.npz")
    body = np.arange(6, dtype="<f4").tobytes()
    compact = "{'fortran_order':False,'shape':(2,3),'descr':'<f4'}\n"
    python_2 = "{'descr': '<f4', 'fortran_order': False, 'shape': (2L, 3L), }"
    assert np.array_equal(read_npy(header(compact, body)), np.arange(6).reshape(2, 3))
    with pytest.warns(UserWarning, match="Python 2"):
        assert np.array_equal(read_npy(header(python_2, body)), np.arange(6).reshape(2, 3))
