"""The server as a lab uses it."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any, Dict, List, Mapping, Optional, Sequence, Tuple, Union, overload

from . import _documents as documents
from ._documents import Analysis, Plant, Report, Run, Study, Subject, Trial
from ._http import Http
from ._problem import Problem

# How long one request waits for an analysis: well within the time that connections live.
WAIT_S = 20

# What files are sent as; the server looks at what is in them.
MEDIA_TYPES = {
    ".json": "application/json",
    ".mat": "application/octet-stream",
    ".npz": "application/octet-stream",
    ".xlsx": "application/octet-stream",
    ".tsv": "text/tab-separated-values",
}

Source = Union[str, "os.PathLike[str]", bytes, Mapping[str, Any], Any]


def connect(url: str = "http://127.0.0.1:8080", timeout_s: float = 120.0) -> Lab:
    """The server at `url`; it is asked at once, so that a wrong address is told here."""
    lab = Lab(Http(url, timeout_s))
    lab.version = lab.http.get("/v1")["version"]
    return lab


class Lab:
    """A server, as `connect` gives it."""

    def __init__(self, http: Http) -> None:
        self.http = http
        self.version = ""

    def study(
        self,
        name: str,
        description: str = "",
        display_limit: Optional[float] = None,
        reading: Optional[Mapping[str, Any]] = None,
    ) -> Study:
        """The study of this name; made where there is none. `reading` says once what its files do not say themselves,
        such as `{"columns": "r:Target,u:Stick,y:Cursor", "time_unit": "ms"}`."""
        for own in self.http.every("/v1/studies"):
            if own["name"] == name:
                return documents.study(own)
        body: Dict[str, Any] = {"name": name, "description": description, "display_limit": display_limit}
        body["reading"] = dict(reading or {})
        return documents.study(self.http.post("/v1/studies", body))

    def plant(
        self,
        study: Study,
        name: str,
        num: Optional[Sequence[float]] = None,
        den: Optional[Sequence[float]] = None,
        sample_time_s: Optional[float] = None,
        model: Optional[Mapping[str, Any]] = None,
    ) -> Plant:
        """The plant of this name; made where there is none, from `num` and `den` in descending powers or from a model
        as the server writes it. `sample_time_s` is None in continuous time."""
        for own in self.http.every(f"/v1/studies/{study.id}/plants"):
            if own["name"] == name:
                return documents.plant(own)
        if model is None:
            if num is None or den is None:
                raise ValueError(f"there is no plant '{name}' yet: give num and den, or a model")
            model = {"num": list(num), "den": list(den), "sample_time_s": sample_time_s}
        return documents.plant(self.http.post(f"/v1/studies/{study.id}/plants", {"name": name, "model": model}))

    def subject(
        self, study: Study, code: str, group: Optional[str] = None, attributes: Optional[Mapping[str, Any]] = None
    ) -> Subject:
        """The subject with this code; made where there is none."""
        for own in self.http.every(f"/v1/studies/{study.id}/subjects"):
            if own["code"] == code:
                return documents.subject(own)
        body: Dict[str, Any] = {"code": code, "group": group, "attributes": dict(attributes or {})}
        return documents.subject(self.http.post(f"/v1/studies/{study.id}/subjects", body))

    def upload(
        self,
        subject: Subject,
        plant: Plant,
        source: Source,
        number: Optional[int] = None,
        session: Optional[int] = None,
        **options: Any,
    ) -> Trial:
        """Uploads a recording: the path of a file, bytes of one, a DataFrame, or columns `r`, `u`, `y` (and `t`, `d`) by
        name. `options` are those of the route: `columns`, `sample_time_s`, `time_unit`, `resample`. A recording that is
        there already is found and not stored twice."""
        query = {"plant": plant.id, "number": number, "session": session, **options}
        body, media_type = _body(source)
        path = f"/v1/subjects/{subject.id}/trials"
        answer = self.http.send("POST", path, query, body, {}, media_type)
        return documents.trial(_single(answer))

    @overload
    def run(self, kind: str, of: Study, spec: Optional[Mapping[str, Any]] = None, **more: Any) -> Run: ...

    @overload
    def run(
        self,
        kind: str,
        of: Union[Trial, Subject, Sequence[Trial], Mapping[str, Any]],
        spec: Optional[Mapping[str, Any]] = None,
        **more: Any,
    ) -> Analysis: ...

    def run(self, kind: str, of: Any, spec: Optional[Mapping[str, Any]] = None, **more: Any) -> Union[Analysis, Run]:
        """Asks for an analysis of a trial, of several trials together, or of inputs as the kind has them. Of a study, for
        one of each trial that has none yet: `filter` says which trials, `only="all"` asks for all once more."""
        if isinstance(of, Study):
            body = {"kind": kind, "spec": dict(spec or {}), **more}
            return documents.run(kind, self.http.post(f"/v1/studies/{of.id}/analyses", body))
        inputs: Mapping[str, Any]
        if isinstance(of, Trial):
            inputs = {"trial": of.id, **more}
        elif isinstance(of, Mapping):
            inputs = {**of, **more}
        else:
            inputs = {"trials": [trial.id for trial in of], **more}
        body = {"kind": kind, "inputs": inputs, "spec": dict(spec or {})}
        return documents.analysis(self.http.post("/v1/analyses", body))

    @overload
    def wait(self, work: Analysis, timeout_s: Optional[float] = None) -> Analysis: ...

    @overload
    def wait(self, work: Run, timeout_s: Optional[float] = None) -> List[Analysis]: ...

    def wait(self, work: Any, timeout_s: Optional[float] = None) -> Any:
        """Waits until it is finished. Raises `Problem` where a single analysis failed or was cancelled; of a run, all are
        given, whatever became of them. `TimeoutError` after `timeout_s`."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        if isinstance(work, Run):
            return [self._finished(one, until) for one in work.analyses]
        done = self._finished(work.id, until)
        if done.status != "succeeded":
            reason = {"code": done.status, "title": f"the analysis was {done.status}", "detail": f"analysis {done.id}"}
            raise Problem(done.document.get("problem") or reason)
        return done

    def _finished(self, analysis: str, until: Optional[float]) -> Analysis:
        while True:
            left = WAIT_S if until is None else min(WAIT_S, until - time.monotonic())
            found = documents.analysis(
                self.http.get(f"/v1/analyses/{analysis}", Prefer=f"wait={max(0, int(left + 0.999))}")
            )
            if found.finished:
                return found
            if until is not None and time.monotonic() >= until:
                raise TimeoutError(f"analysis {analysis} is {found.status}, {100 * found.fraction:.0f} % done")

    def report(self, analysis: Union[Analysis, str]) -> Report:
        """The report, with every quantity and how far it may be used."""
        name = analysis if isinstance(analysis, str) else analysis.id
        trust = self.http.get(f"/v1/analyses/{name}/trust")
        return documents.report(self.http.get(f"/v1/analyses/{name}/report"), trust)

    def curves(self, study: Study, frame: bool = True, **query: Any) -> Any:
        """Learning curves as a DataFrame of pandas (or a list of dicts with `frame=False`): a row a trial, with metrics,
        ends of intervals, and for each quantity how far it may be used. `query` is that of the route: `estimator`,
        `group`, `session`, `include_divergent`, `include_excluded`."""
        found = self.http.get(f"/v1/studies/{study.id}/learning-curves", _written(query))
        rows = [row for group in found["groups"] for row in _rows(group)]
        if not frame:
            return rows
        import pandas

        return pandas.DataFrame(rows)


def _written(query: Mapping[str, Any]) -> Dict[str, Any]:
    return {name: str(value).lower() if isinstance(value, bool) else value for name, value in query.items()}


def _rows(group: Mapping[str, Any]) -> List[Dict[str, Any]]:
    rows = []
    for subject in group["subjects"]:
        for point in subject["curve"]["points"]:
            row: Dict[str, Any] = {
                "group": group["group"],
                "subject": subject["code"],
                "plant": group["plant"]["name"],
            }
            intervals = point["intervals_95"]
            for name, value in point.items():
                if name not in ("intervals_95", "trust"):
                    row[name] = value
            for name, interval in intervals.items():
                if name != "reason":
                    low, high = interval if interval else (None, None)
                    row[f"{name}_low"], row[f"{name}_high"] = low, high
            for trust in point["trust"]:
                row[f"{trust['quantity']}_trust"] = trust["level"]
            rows.append(row)
    return rows


def _single(answer: bytes) -> Dict[str, Any]:
    import json

    found = json.loads(answer)
    if "items" in found:
        (found,) = found["items"]
    return dict(found)


def _body(source: Source) -> Tuple[bytes, str]:
    """The bytes of a recording, and their media type."""
    if isinstance(source, bytes):
        return source, "text/csv"
    if isinstance(source, (str, os.PathLike)):
        path = Path(source)
        return path.read_bytes(), MEDIA_TYPES.get(path.suffix.lower(), "text/csv")
    columns: Dict[str, List[float]]
    if isinstance(source, Mapping):
        columns = {str(name): [float(value) for value in column] for name, column in source.items()}
    else:
        columns = {str(name): [float(value) for value in source[name]] for name in source.columns}
    lengths = {name: len(column) for name, column in columns.items()}
    if len(set(lengths.values())) != 1:
        raise ValueError(f"the columns are not equally long: {lengths}")
    # repr of a float reads back as the same double.
    lines = [",".join(columns)] + [",".join(map(repr, row)) for row in zip(*columns.values())]
    return ("\n".join(lines) + "\n").encode(), "text/csv"
