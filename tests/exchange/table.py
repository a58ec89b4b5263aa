"""Reads the tidy table of a study as analysts do: right types, and a mixed model."""
import json
import sys

import numpy
import pandas

frame = pandas.read_csv(sys.argv[1], float_precision="round_trip")
expected = {
    "study": "O", "subject": "O", "group": "O", "number": "i", "sample_time_s": "f", "samples": "i", "divergent": "b",
    "mean_abs_error": "f", "kind": "O", "norm_feedback": "f", "norm_feedback_low": "f", "trust_norm_feedback": "O",
    "feedback_num_0": "f", "trials_combined": "i", "spec_sha256": "O",
}
for name, kind in expected.items():
    found = frame[name].dtype
    found = "O" if pandas.api.types.is_string_dtype(found) else found.kind
    assert found == kind, (name, frame[name].dtype)
assert len(frame) == 12 and frame["trial"].nunique() == 6
assert set(frame["kind"]) == {"ssid", "prediction_error"}
lines = pandas.DataFrame([json.loads(line) for line in open(sys.argv[2], encoding="utf-8")])
assert list(lines.columns) == list(frame.columns)
same = lines["mean_abs_error"].to_numpy() == frame["mean_abs_error"].to_numpy()
assert same.all() and numpy.isfinite(frame["mean_abs_error"]).all()
print("pandas: 12 rows with", len(frame.columns), "columns")
