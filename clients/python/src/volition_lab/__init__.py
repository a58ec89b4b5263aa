"""Talk to a Volition server: ten functions, with nothing but Python's own library.

    import volition_lab as volition

    lab = volition.connect("http://127.0.0.1:8080")
    study = lab.study("tracking", display_limit=8)
    plant = lab.plant(study, "integrator", num=[1], den=[1, 0])
    subject = lab.subject(study, "s01", group="practice")
    trial = lab.upload(subject, plant, frame, number=1, session=1)
    analysis = lab.wait(lab.run("ssid", trial, spec={...}))
    report = lab.report(analysis)
    feedback = volition.model(report, "feedback")  # a system of python-control
    curves = lab.curves(study)  # a DataFrame, a row a trial
"""

from ._documents import Analysis, Plant, Quantity, Report, Run, Study, Subject, Trial, Warning
from ._lab import Lab, connect
from ._problem import Problem
from ._systems import model

__all__ = [
    "Analysis",
    "Lab",
    "Plant",
    "Problem",
    "Quantity",
    "Report",
    "Run",
    "Study",
    "Subject",
    "Trial",
    "Warning",
    "connect",
    "model",
]
