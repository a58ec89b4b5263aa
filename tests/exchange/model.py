"""Loads exported models into python-control and MATLAB's format into scipy, and compares their responses."""
import json
import sys

import control
import numpy
import scipy.io

export = json.load(open(sys.argv[1]))
mat = scipy.io.loadmat(sys.argv[2], squeeze_me=True)
worst = 0.0
for name, m in export["models"].items():
    system = control.tf(m["num"], m["den"], m["dt"])
    omega = numpy.array(m["response"]["omega_rad_s"])
    told = numpy.array([complex(*z) for z in m["response"]["value"]])
    at = 1j * omega if m["time_base"] == "continuous" else numpy.exp(1j * omega * m["dt"])
    worst = max(worst, float(numpy.max(abs(system(at) - told) / abs(told))))
    own = mat[name]
    for field, key in [("num", "num"), ("den", "den"), ("Ts", "dt"), ("delay_s", "delay_s")]:
        assert numpy.array_equal(numpy.ravel(own[field].item()), numpy.ravel(m[key])), (name, field)
    assert str(own["time_base"]) == m["time_base"]
assert len(export["models"]) >= 3, list(export["models"])
assert worst < 1e-12, worst
print("control:", len(export["models"]), "models, responses to", worst)
