"""The ten functions of clients/python against a real server. Usage: ten_functions.py URL, with clients/python/src on the
path. With pandas and python-control the frame and the systems are tested too; without them it says that they were not.
"""

import math
import os
import sys
import tempfile
from typing import Dict, List

import volition_lab as volition

LINES = (2, 3, 5, 7, 11, 13, 17, 19, 23, 29)
AXIS = [{"from": 0.5, "to": 10, "step": 0.5}]
SPEC = {
    "pool": {"grid": {"feedforward_denominator": AXIS, "feedback_numerator": AXIS, "feedback_denominator": AXIS}},
    "feedforward_numerator_degree": 1,
    "frequency": {
        "lines": {"frequency_hz": [k / 60 for k in LINES]},
        "segments": [{"start_s": 0, "end_s": 60}],
    },
}


def recording(gain: float) -> Dict[str, List[float]]:
    """A person with delay and lag on an integrator, sixty seconds of a sum of sines."""
    step, delay = 0.02, 10
    y = lag = 0.0
    past = [0.0] * (delay + 1)
    columns: Dict[str, List[float]] = {"t": [], "r": [], "u": [], "y": []}
    for i in range(3001):
        t = i * step
        r = sum(math.sin(2 * math.pi * k * t / 60 + k * k) for k in LINES) / 5
        past.append(r - y)
        lag += step / 0.2 * (gain * past[-delay - 1] - lag)
        for name, value in zip(("t", "r", "u", "y"), (round(t, 2), r, lag, y)):
            columns[name].append(value)
        y += step * lag
    return columns


def installed(name: str) -> bool:
    try:
        __import__(name)
    except ImportError:
        print(f"LEFT OUT: {name} is not installed")
        return False
    return True


def main(url: str) -> None:
    lab = volition.connect(url)
    assert lab.version
    study = lab.study("Tracking & more", display_limit=8)
    assert lab.study("Tracking & more").id == study.id, "found, not made anew"
    plant = lab.plant(study, "1/s", num=[1], den=[1, 0])
    assert lab.plant(study, "1/s") == plant
    subject = lab.subject(study, "s01", group="practice")
    assert lab.subject(study, "s01").group == "practice"

    trials = [lab.upload(subject, plant, recording(gain), number=number, session=1) for number, gain in enumerate((1.0, 1.4), 1)]
    assert [trial.number for trial in trials] == [1, 2]
    assert trials[0].mean_abs_error > 0 and trials[0].mean_abs_error != trials[1].mean_abs_error
    assert lab.upload(subject, plant, recording(1.0)).id == trials[0].id, "stored once"
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "third.csv")
        columns = recording(1.8)
        with open(path, "w", encoding="utf-8") as file:
            file.write("Zeit;Soll;Stick;Ist\n")
            for row in zip(*columns.values()):
                file.write(";".join(repr(value).replace(".", ",") for value in row) + "\n")
        third = lab.upload(subject, plant, path, number=3, session=1, columns="t:Zeit,r:Soll,u:Stick,y:Ist")
    assert third.number == 3

    done = lab.wait(lab.run("ssid", trials[1], SPEC), timeout_s=120)
    assert done.status == "succeeded" and done.document["trial"]["number"] == 2
    report = lab.report(done)
    assert report.kind == "ssid" and len(report.spec_sha256) == 64
    names = {quantity.name for quantity in report.quantities}
    assert "norm_feedback" in names and all(quantity.level for quantity in report.quantities), names

    run = lab.run("ssid", study, SPEC)
    assert run.created == 2 and len(run.analyses) == 3, run
    assert all(one.status == "succeeded" for one in lab.wait(run, timeout_s=120))
    assert lab.run("ssid", study, SPEC).created == 0

    rows = lab.curves(study, frame=False)
    assert [row["number"] for row in rows] == [1, 2, 3] and rows[0]["subject"] == "s01", rows
    assert rows[1]["analysis"] == done.id and rows[1]["norm_feedback_trust"] in ("ok", "read", "do_not_use")

    try:
        lab.run("ssid", trials[0], {"pool": "no such pool"})
        raise AssertionError("refused")
    except volition.Problem as problem:
        assert problem.code == "invalid" and problem.status == 422 and problem.where, problem
    try:
        volition.connect("http://127.0.0.1:1")
        raise AssertionError("nobody listens there")
    except volition.Problem as problem:
        assert problem.code == "unreachable", problem

    if installed("pandas"):
        import pandas

        frame = lab.curves(study, include_excluded=True)
        assert list(frame["number"]) == [1, 2, 3] and frame["mean_abs_error"].dtype == float
        fourth = lab.upload(subject, plant, pandas.DataFrame(recording(2.2)), number=4, session=1)
        assert fourth.number == 4
    if installed("control"):
        import numpy

        system = volition.model(report, "feedback")
        omega = numpy.array([0.5, 1.0, 3.0])
        found = report.result["feedback"]
        dt = found["sample_time_s"]
        x = 1j * omega if dt is None else numpy.exp(1j * omega * dt)
        expected = numpy.polyval(found["num"], x) / numpy.polyval(found["den"], x)
        response = numpy.squeeze(system(x))
        assert numpy.max(abs(response - expected) / abs(expected)) < 1e-12, (response, expected)
        assert system.dt == (0 if dt is None else dt), "the time base is said"
        assert volition.model(plant).dt == 0
        try:
            volition.model(report, "feedbak")
            raise AssertionError("there is no such model")
        except volition.Problem as problem:
            assert "feedback" in str(problem), problem
    print("python: ten functions, a study, four trials, three reports")


if __name__ == "__main__":
    main(sys.argv[1])
