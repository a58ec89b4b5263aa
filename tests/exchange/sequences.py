"""Reads samples as MATLAB, NumPy and sound, and compares them with the CSV bit for bit."""
import csv
import sys

import numpy
import scipy.io
import scipy.io.wavfile

folder, scale = sys.argv[1], float(sys.argv[2])
rows = list(csv.reader(open(folder + "/s.csv")))
table = {name: numpy.array([float(row[i]) for row in rows[1:]]) for i, name in enumerate(rows[0])}
mat = scipy.io.loadmat(folder + "/s.mat")
npz = numpy.load(folder + "/s.npz")
for name, values in table.items():
    if name == "t" and "t" not in npz:
        continue
    for own in (mat[name], npz[name]):
        assert numpy.array_equal(numpy.ravel(own).view(numpy.uint64), values.view(numpy.uint64)), name
assert mat["sample_time_s"].item() == npz["sample_time_s"].item() == 0.05
rate, sound = scipy.io.wavfile.read(folder + "/s.wav")
assert rate == 20 and sound.dtype == numpy.float32
assert numpy.array_equal(sound, (table["r"] / scale).astype(numpy.float32))
assert b"a sample of 1 is" in open(folder + "/s.wav", "rb").read()
print("sequences:", len(sound), "samples, the same in four forms")
