"""What the server keeps, as dataclasses. `document` has everything that it said."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Dict, List, Optional, Tuple

Document = Dict[str, Any]


@dataclass(frozen=True)
class _Named:
    id: str
    name: str
    document: Document = field(repr=False)


class Study(_Named):
    """A lab's experiment."""


class Plant(_Named):
    """What subjects control."""


@dataclass(frozen=True)
class Subject:
    """Who controls it, by pseudonym."""

    id: str
    code: str
    group: Optional[str]
    document: Document = field(repr=False)


@dataclass(frozen=True)
class Warning:
    """What must be read first."""

    code: str
    message: str


@dataclass(frozen=True)
class Trial:
    """A recording."""

    id: str
    number: int
    session: Optional[int]
    mean_abs_error: float
    rms_error: float
    warnings: List[Warning]
    document: Document = field(repr=False)


@dataclass(frozen=True)
class Analysis:
    """Something that is computed, and where it stands."""

    id: str
    kind: str
    status: str
    fraction: float
    document: Document = field(repr=False)

    @property
    def finished(self) -> bool:
        """Whether it came to its end, whichever."""
        return self.status in ("succeeded", "failed", "cancelled")


@dataclass(frozen=True)
class Run:
    """One analysis for each trial of a study: those that were made, and those that were there."""

    kind: str
    created: int
    analyses: List[str]
    skipped: List[Tuple[str, str]]
    document: Document = field(repr=False)


@dataclass(frozen=True)
class Quantity:
    """A number of a report, with its 95 % interval and how far it may be used."""

    name: str
    estimator: Optional[str]
    value: Optional[float]
    interval_95: Optional[Tuple[float, float]]
    level: str
    because: str


@dataclass(frozen=True)
class Report:
    """What an analysis found."""

    kind: str
    schema: str
    result: Document = field(repr=False)
    warnings: List[Warning]
    quantities: List[Quantity]
    spec_sha256: str
    seed: Optional[int]
    document: Document = field(repr=False)


def warnings(listed: Any) -> List[Warning]:
    return [Warning(own["code"], own["message"]) for own in listed or []]


def study(own: Document) -> Study:
    return Study(own["id"], own["name"], own)


def plant(own: Document) -> Plant:
    return Plant(own["id"], own["name"], own)


def subject(own: Document) -> Subject:
    return Subject(own["id"], own["code"], own["group"], own)


def trial(own: Document) -> Trial:
    metrics = own["metrics"]
    said = own.get("warnings", own.get("recording_warnings"))
    return Trial(
        own["id"], own["number"], own["session"], metrics["mean_abs_error"], metrics["rms_error"], warnings(said), own
    )


def analysis(own: Document) -> Analysis:
    return Analysis(own["id"], own["kind"], own["status"], own["progress"]["fraction"], own)


def run(kind: str, own: Document) -> Run:
    every = [one["id"] for one in own["analyses"]] + [one["id"] for one in own["existing"]]
    return Run(kind, own["created"], every, [(one["trial"], one["reason"]) for one in own["skipped"]], own)


def quantity(own: Document) -> Quantity:
    interval = own["interval_95"]
    between = (interval[0], interval[1]) if interval else None
    return Quantity(own["quantity"], own["estimator"], own["value"], between, own["level"], own["because"])


def report(own: Document, trust: Document) -> Report:
    provenance = own["provenance"]
    return Report(
        own["kind"],
        own["schema"],
        own["result"],
        warnings(own["warnings"]),
        [quantity(one) for one in trust["trust"]],
        provenance["spec_sha256"],
        provenance["seed"],
        own,
    )
