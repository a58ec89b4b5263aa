"""Loads exported models into python-control and MATLAB's format into scipy, and compares their responses."""
import json
import sys

import control
import numpy
import scipy.io

export = json.load(open(sys.argv[1]))
mat = scipy.io.loadmat(sys.argv[2], squeeze_me=True)
worst = 0.0


def points(m):
    omega = numpy.array(m["response"]["omega_rad_s"])
    return 1j * omega if m["time_base"] == "continuous" else numpy.exp(1j * omega * m["dt"])


def compare(system, m):
    """The largest deviation, relative to the largest entry of the response at that frequency."""
    global worst
    told = numpy.array(m["response"]["value"])
    told = told[..., 0] + 1j * told[..., 1]
    assert len(told) >= 5, m["pointer"]
    for x, value in zip(points(m), told):
        own = numpy.atleast_2d(system(x)) if numpy.ndim(value) == 2 else system(x)
        worst = max(worst, float(numpy.max(abs(own - value)) / numpy.max(abs(value))))


def same(own, m, fields):
    for field, key in fields:
        assert numpy.array_equal(numpy.ravel(own[field].item()), numpy.ravel(m[key])), (m["pointer"], field)
    assert str(own["time_base"]) == m["time_base"]


for name, m in export["models"].items():
    compare(control.tf(m["num"], m["den"], m["dt"]), m)
    same(mat[name], m, [("num", "num"), ("den", "den"), ("Ts", "dt"), ("delay_s", "delay_s")])
for name, m in export["state_space"].items():
    compare(control.ss(m["a"], m["b"], m["c"], m["d"], m["dt"]), m)
    same(mat[name], m, [("A", "a"), ("B", "b"), ("C", "c"), ("D", "d"), ("Ts", "dt")])
for name, m in export["transfer_matrices"].items():
    compare(control.tf(m["num"], m["den"], m["dt"]), m)
    for part in ("num", "den"):
        cells = numpy.atleast_2d(mat[name][part].item())
        assert cells.shape == numpy.shape(m["response"]["value"])[1:3], (name, cells.shape)
        for row, own in zip(m[part], cells):
            for coefficients, cell in zip(row, own):
                assert numpy.array_equal(numpy.ravel(cell), coefficients), (name, part)
assert worst < 1e-12, worst
if export["covariance"] is not None:
    own = numpy.atleast_2d(mat["volition"]["covariance"].item())
    assert numpy.array_equal(own, export["covariance"]) and len(own) == len(export["parameters"])
    for variance, parameter in zip(numpy.diag(own), export["parameters"]):
        assert abs(variance**0.5 / parameter["standard_error"] - 1) < 1e-9, parameter
counts = [len(export[kind]) for kind in ("models", "state_space", "transfer_matrices")]
print("control: {} models, {} in state space, {} matrices of transfer functions, responses to".format(*counts), worst)
