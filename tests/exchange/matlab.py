"""Files of MATLAB, levels 4 and 5, and what scipy reads in them.

    python3 tests/exchange/matlab.py OUT            files of every class, nesting, order and compression, into OUT
    python3 tests/exchange/matlab.py OUT --scipy    those that scipy ships for its own tests, too, where it ships them

It prints how many there are of each; the one of version 7.3 among scipy's has no document beside it.

Beside each file stands NAME.json: {path: {"rows", "columns", "bits": [..]}} of every real array of numbers and logicals,
bits as hexadecimal big-endian doubles, paths as MATLAB writes them; or {"refused": why} where scipy itself refuses it.
Needs numpy and scipy (here 2.4.6 and 1.17.1).
"""

import json
import os
import struct
import sys
import warnings

import numpy as np
import scipy.io
from scipy.io.matlab import MatlabFunction, MatlabObject, MatlabOpaque

warnings.simplefilter("ignore")


def leaves(path, value, into):
    if isinstance(value, (MatlabFunction, MatlabObject, MatlabOpaque)):
        return
    if scipy.sparse.issparse(value):
        return
    value = np.asarray(value)
    if value.dtype == object and value.ndim == 0:
        return
    if value.dtype.names is not None:
        flat = value.flatten(order="F")
        for at, element in enumerate(flat):
            own = path if flat.size == 1 else f"{path}({at + 1})"
            # scipy renames a field that is there twice to what MATLAB takes for no name.
            for name in (name for name in value.dtype.names if not name.startswith("_")):
                leaves(f"{own}.{name}", element[name], into)
    elif value.dtype == object:
        for at, item in enumerate(value.flatten(order="F")):
            leaves(f"{path}{{{at + 1}}}", item, into)
    elif value.dtype.kind in "fiub":
        rows = value.shape[0] if value.ndim else 1
        columns = value.size // rows if rows else 0
        bits = [struct.pack(">d", float(x)).hex() for x in value.flatten(order="F")]
        into[path] = {"rows": rows, "columns": columns, "bits": bits}


def oracle(path):
    try:
        variables = scipy.io.loadmat(path, chars_as_strings=True)
    except Exception as error:  # whatever scipy raises, it refuses the file
        return {"refused": f"{type(error).__name__}: {error}"}
    into = {}
    for name, value in variables.items():
        if not (name.startswith("__") and name.endswith("__")):
            leaves(name, value, into)
    return into


def made(out):
    n = 40
    t = np.arange(n) * 0.02
    r, u, y = np.sin(t), np.cos(3 * t) - 0.5, t * t / 7
    trial = {"t": t, "r": r, "u": u, "y": y}
    scipy.io.savemat(f"{out}/plain.mat", trial)
    scipy.io.savemat(f"{out}/packed.mat", trial, do_compression=True)
    scipy.io.savemat(f"{out}/columns.mat", trial, oned_as="column")
    scipy.io.savemat(f"{out}/level4.mat", trial, format="4")
    scipy.io.savemat(f"{out}/level4_types.mat", {"a": np.arange(5, dtype="i2"), "b": np.arange(4, dtype="f4") / 3,
                     "c": "text", "d": np.array([[1, 2], [3, 4]], "u1"), "z": np.array([1 + 2j])}, format="4")
    scipy.io.savemat(f"{out}/struct.mat", {"data": {"target": r, "stick": u, "cursor": y, "fs": 50.0}, "note": "rig 2"})
    runs = np.array([({"r": r + k, "u": u, "y": y},) for k in range(3)], dtype=[("signals", object)])
    scipy.io.savemat(f"{out}/runs.mat", {"runs": runs}, do_compression=True)
    cells = np.empty(3, dtype=object)
    cells[:] = [r, "between", {"u": u, "inner": {"y": y}}]
    scipy.io.savemat(f"{out}/cells.mat", {"c": cells})
    scipy.io.savemat(f"{out}/matrix.mat", {"M": np.column_stack([t, r, u, y])})
    integers = {f"x{kind}": np.array([0, 1, 100, 7]).astype(kind) for kind in
                ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8"]}
    scipy.io.savemat(f"{out}/classes.mat", {**integers, "yes": np.array([True, False]), "none": np.zeros((0, 3)),
                     "z": r[:3] + 1j, "big": np.array([2**60 + 1], "i8"), "cube": np.arange(24.0).reshape(2, 3, 4)})


def turned(out):
    """Level 5 from a machine with the other order of bytes, element by element as the format has it."""
    def element(kind, data):
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    def double(name, values):
        parts = element(6, struct.pack(">II", 6, 0)) + element(5, struct.pack(">ii", 1, len(values)))
        parts += element(1, name.encode()) + element(9, struct.pack(f">{len(values)}d", *values))
        return struct.pack(">II", 14, len(parts)) + parts

    n = 40
    t = np.arange(n) * 0.02
    with open(f"{out}/turned.mat", "wb") as file:
        file.write(b"MATLAB 5.0 MAT-file, of a big-endian machine".ljust(124) + b"\x01\x00MI")
        for name, values in {"t": t, "r": np.sin(t), "u": np.cos(3 * t) - 0.5, "y": t * t / 7}.items():
            file.write(double(name, list(values)))


def collected(out):
    """Copies scipy's own files, and says how many there are: some packages of scipy come without."""
    try:
        import scipy.io.matlab.tests as shipped
    except ImportError:
        return 0
    folder = os.path.join(os.path.dirname(shipped.__file__), "data")
    names = [name for name in sorted(os.listdir(folder)) if name.endswith(".mat")] if os.path.isdir(folder) else []
    for name in names:
        with open(os.path.join(folder, name), "rb") as file, open(f"{out}/scipy_{name}", "wb") as copy:
            copy.write(file.read())
    return len(names)


def main():
    out = sys.argv[1]
    os.makedirs(out, exist_ok=True)
    made(out)
    turned(out)
    own = len([name for name in os.listdir(out) if name.endswith(".mat")])
    shipped = collected(out) if "--scipy" in sys.argv else 0
    hierarchical = 0
    for name in sorted(os.listdir(out)):
        if not name.endswith(".mat"):
            continue
        with open(f"{out}/{name}", "rb") as file:
            is_hdf5 = b"\x89HDF" in file.read(1024)
        hierarchical += is_hdf5
        if not is_hdf5:
            with open(f"{out}/{name[:-4]}.json", "w") as file:
                json.dump(oracle(f"{out}/{name}"), file)
    print(f"{own} made here, {shipped} of scipy, {hierarchical} of them HDF5")


main()
