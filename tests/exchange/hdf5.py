"""HDF5 as MATLAB 7.3, h5py and Octave write it: python3 tests/exchange/hdf5.py OUT

Needs h5py, hdf5storage and numpy. hdf5storage writes what MATLAB reads; arrays of structs and Octave's own layout are laid
out here by h5py as those programs do. Truth is in arrays.py's formula: t = 0.02 i, sin t, cos 3t - 1/2, t^2/7.
"""

import os
import sys

import h5py
import hdf5storage
import numpy as np


def main():
    out = sys.argv[1]
    os.makedirs(out, exist_ok=True)
    n = 40
    t = np.arange(n) * 0.02
    r, u, y = np.sin(t), np.cos(3 * t) - 0.5, t * t / 7

    def save(name, variables):
        path = f"{out}/{name}"
        if os.path.exists(path):
            os.remove(path)
        hdf5storage.savemat(path, variables, format="7.3", oned_as="row", store_python_metadata=False)

    save("plain.mat", {"t": t, "r": r, "u": u, "y": y})
    save("struct.mat", {"data": {"target": r, "stick": u, "cursor": y, "fs": 50.0}, "note": "rig 2 am Prüfstand",
                        "none": np.zeros((0, 3)), "z": r[:5] + 1j, "yes": np.array([True, False]),
                        "single": r.astype("f4"), "short": np.arange(5, dtype="i2"), "big": np.array([2**60 + 1])})
    cells = np.empty(3, dtype=object)
    cells[:] = [r, "between", u]
    save("cells.mat", {"c": cells, "M": np.column_stack([t, r, u, y])})
    with h5py.File(f"{out}/runs.mat", "w", userblock_size=512) as file:
        refs, runs = file.create_group("#refs#"), file.create_group("runs")
        runs.attrs["MATLAB_class"] = np.bytes_("struct")
        for name, values in (("r", r), ("u", u), ("y", y)):
            targets = []
            for k in range(3):
                data = refs.create_dataset(f"{name}{k}", data=(values + k * (name == "r")).reshape(-1, 1),
                                           compression="gzip", shuffle=True, fletcher32=True)
                data.attrs["MATLAB_class"] = np.bytes_("double")
                targets.append(data.ref)
            runs.create_dataset(name, data=np.array(targets, dtype=h5py.ref_dtype).reshape(3, 1), dtype=h5py.ref_dtype)
    with h5py.File(f"{out}/plain.h5", "w") as file:
        group = file.create_group("trial")
        for name, values in (("t", t), ("r", r), ("u", u), ("y", y)):
            group.create_dataset(name, data=values)
        file.create_dataset("M", data=np.column_stack([t, r, u, y]))
    with h5py.File(f"{out}/octave.h5", "w") as file:
        group = file.create_group("r")
        group.attrs["OCTAVE_NEW_FORMAT"] = np.uint8(1)
        group.create_dataset("type", data=np.bytes_("matrix"))
        group.create_dataset("value", data=r)


main()
