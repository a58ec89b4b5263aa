"""Models of reports as systems of python-control, their time base said and not guessed."""

from __future__ import annotations

from typing import Any, List, Mapping, Optional, Union

from ._documents import Plant, Report
from ._problem import Problem


def model(source: Union[Report, Plant, Mapping[str, Any]], name: str = "feedback", pade: Optional[int] = None) -> Any:
    """A model as a `TransferFunction` or `StateSpace` of python-control, with `dt` 0 in continuous time.

    `source` is a report (then `name` says which model of its result: `feedback`, `feedforward`, `plant`, or a path such
    as `refined.feedback`), a plant, or the document of a model. A sampled model's delay becomes whole samples. A delay
    in continuous time is no rational function: `pade` is the order of the approximation that is to be made of it.
    """
    import control

    document = _document(source, name)
    sample_time_s = document.get("sample_time_s")
    dt = 0 if sample_time_s is None else sample_time_s
    if "num" in document:
        system: Any = control.TransferFunction(document["num"], document["den"], dt)
    elif "a" in document:
        system = control.StateSpace(document["a"], document["b"], document["c"], document["d"], dt)
    else:
        raise _no_model(name, document)
    delay_s = document.get("delay_s")
    if not delay_s:
        return system
    if sample_time_s is not None:
        samples = round(delay_s / sample_time_s)
        return system * control.TransferFunction([1.0], [1.0] + samples * [0.0], dt)
    if pade is None:
        raise Problem(
            {
                "code": "delay",
                "title": "a delay is no rational function",
                "detail": f"{name} has a delay of {delay_s} s in continuous time",
                "mend": "Say pade=N for an approximation of order N.",
            }
        )
    numerator, denominator = control.pade(delay_s, pade)
    return system * control.TransferFunction(numerator, denominator, 0)


def _document(source: Union[Report, Plant, Mapping[str, Any]], name: str) -> Mapping[str, Any]:
    if isinstance(source, Plant):
        found: Any = source.document["model"]
    elif isinstance(source, Report):
        found = source.result
        for member in name.split("."):
            found = found.get(member) if isinstance(found, Mapping) else None
    else:
        found = source
    if not isinstance(found, Mapping):
        raise _no_model(name, source.result if isinstance(source, Report) else {})
    return found


def _no_model(name: str, members: Mapping[str, Any]) -> Problem:
    models: List[str] = [key for key, value in members.items() if isinstance(value, Mapping) and "num" in value]
    return Problem(
        {
            "code": "no_model",
            "title": "no such model",
            "detail": f"the report has no model {name}",
            "mend": f"It has: {', '.join(models) or 'none'}.",
        }
    )
