"""From a study to a report with the client that openapi-python-client generates, typed from end to end.

Usage: round_trip.py URL, with the generated package `volition_client` on the path.
"""

import math
import sys
import time
from typing import TypeVar

from volition_client import Client
from volition_client.api.analyses import create_analysis, list_kinds, read_analysis, read_report
from volition_client.api.plants import create_plant
from volition_client.api.studies import create_study
from volition_client.api.subjects import create_subject
from volition_client.api.trials import upload_trials
from volition_client.models.analysis import Analysis
from volition_client.models.frequency_response_report import FrequencyResponseReport
from volition_client.models.frequency_response_request import FrequencyResponseRequest
from volition_client.models.inverse_lqr_inputs import InverseLqrInputs
from volition_client.models.inverse_lqr_report import InverseLqrReport
from volition_client.models.inverse_lqr_request import InverseLqrRequest
from volition_client.models.kind_list import KindList
from volition_client.models.new_plant import NewPlant
from volition_client.models.new_study import NewStudy
from volition_client.models.new_subject import NewSubject
from volition_client.models.new_trial import NewTrial
from volition_client.models.plant import Plant
from volition_client.models.study import Study
from volition_client.models.subject import Subject
from volition_client.models.transfer_function_model import TransferFunctionModel
from volition_client.models.trial_inputs import TrialInputs
from volition_client.models.uploaded_trial import UploadedTrial

SAMPLE_TIME_S = 0.5
SAMPLES = 64
T = TypeVar("T")


def expect(kind: type[T], answer: object) -> T:
    """The answer, where it is of this type."""
    if not isinstance(answer, kind):
        raise SystemExit(f"expected {kind.__name__}, got {answer!r}")
    return answer


def finished(client: Client, analysis: Analysis) -> Analysis:
    """Polls until the analysis came to its end."""
    for _ in range(600):
        state = expect(Analysis, read_analysis.sync(analysis.id, client=client))
        if state.status.value in ("succeeded", "failed", "cancelled"):
            return state
        time.sleep(0.05)
    raise SystemExit("the analysis did not end within 30 s")


def main(url: str) -> None:
    client = Client(base_url=url)
    kinds = expect(KindList, list_kinds.sync(client=client))
    names = [kind.name.value for kind in kinds.items]
    assert "ssid" in names and "ssid_mimo" in names, names

    study = expect(Study, create_study.sync(client=client, body=NewStudy(name="A generated client")))
    model = TransferFunctionModel(num=[1.0], den=[1.0, 1.0])
    plant = expect(Plant, create_plant.sync(study.id, client=client, body=NewPlant(name="lag", model=model)))
    subject = expect(Subject, create_subject.sync(study.id, client=client, body=NewSubject(code="s01")))

    # The output is the command, a sample later: e^{-j omega T}.
    r = [math.sin(math.pi * i / 4) + 1.0 for i in range(SAMPLES)]
    y = [r[i - 1] for i in range(SAMPLES)]
    recording = NewTrial(r=r, u=[0.1 * value for value in y], y=y, sample_time_s=SAMPLE_TIME_S)
    trial = expect(UploadedTrial, upload_trials.sync(subject.id, client=client, body=recording, plant=plant.id, number=1))

    request = FrequencyResponseRequest(inputs=TrialInputs(trial=trial.id), kind="frequency_response")
    analysis = expect(Analysis, create_analysis.sync(client=client, body=request))
    state = finished(client, analysis)
    assert state.status.value == "succeeded", state.problem
    report = expect(FrequencyResponseReport, read_report.sync(analysis.id, client=client))
    line = report.result.frequency_hz.index(0.25)
    phase = report.result.phase_deg[line]
    assert phase is not None and abs(phase + 45.0) < 1e-9, phase

    gains = InverseLqrInputs(a=[[0.0, 1.0], [2.0, 0.0]], b=[[0.0], [1.0]], k=[[5.0, 4.0]])
    analysis = expect(Analysis, create_analysis.sync(client=client, body=InverseLqrRequest(inputs=gains, kind="inverse_lqr")))
    assert finished(client, analysis).status.value == "succeeded"
    answer = expect(InverseLqrReport, read_report.sync(analysis.id, client=client))
    assert answer.result.verdict.value == "feasible", answer.result.verdict
    print("python: a study, a trial and two reports, typed")


if __name__ == "__main__":
    main(sys.argv[1])
