"""Arrays of NumPy in every class, order and version, and their bits: python3 tests/exchange/arrays.py OUT

Beside each file stands NAME.json: {name: {"rows", "columns", "bits": [..]}}, bits as hexadecimal big-endian doubles,
column by column. Needs numpy (here 2.4.6).
"""

import json
import os
import struct
import sys

import numpy as np


def bits(value):
    value = np.atleast_1d(value)
    rows = value.shape[0]
    flat = value.reshape(rows, -1).flatten(order="F") if value.size else value.flatten()
    return {"rows": rows, "columns": value.size // rows if rows else 0,
            "bits": [struct.pack(">d", float(x)).hex() for x in flat]}


def main():
    out = sys.argv[1]
    os.makedirs(out, exist_ok=True)
    n = 40
    t = np.arange(n) * 0.02
    r, u, y = np.sin(t), np.cos(3 * t) - 0.5, t * t / 7
    files = {
        "plain.npz": {"t": t, "r": r, "u": u, "y": y},
        "packed.npz": {"t": t, "r": r, "u": u, "y": y, "fs": np.array(50.0)},
        "classes.npz": {kind: np.array([0, 1, 100, 7]).astype(kind) for kind in
                        ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f4", "f8", ">f8", ">i2", "?"]},
        "orders.npz": {"c": np.arange(6.0).reshape(2, 3), "f": np.asfortranarray(np.arange(6.0).reshape(2, 3)),
                       "cube": np.arange(24.0).reshape(2, 3, 4)},
    }
    for name, arrays in files.items():
        (np.savez_compressed if name == "packed.npz" else np.savez)(f"{out}/{name}", **arrays)
        with open(f"{out}/{name}.json", "w") as file:
            json.dump({key: bits(value) for key, value in arrays.items()}, file)
    matrix = np.column_stack([t, r, u, y])
    np.save(f"{out}/matrix.npy", matrix)
    with open(f"{out}/matrix.npy.json", "w") as file:
        json.dump({"array": bits(matrix)}, file)
    np.save(f"{out}/objects.npy", np.array([{"r": 1}], dtype=object), allow_pickle=True)


main()
