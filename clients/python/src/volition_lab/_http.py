"""Requests with Python's own library: JSON both ways, problems as exceptions, retries that make nothing twice."""

from __future__ import annotations

import gzip
import http.client
import json
import time
import urllib.error
import urllib.parse
import urllib.request
import uuid
from typing import Any, Iterator, Mapping, Optional

from ._problem import Problem

# How often a request is sent, and how long is waited in between.
ATTEMPTS = 4
PAUSE_S = 0.5

Json = Any


class Http:
    """A server at an address."""

    def __init__(self, url: str, timeout_s: float) -> None:
        self.url = url.rstrip("/")
        self.timeout_s = timeout_s

    def get(self, path: str, query: Optional[Mapping[str, Any]] = None, **headers: str) -> Json:
        return json.loads(self.send("GET", path, query, None, headers))

    def post(self, path: str, body: Json, **headers: str) -> Json:
        return json.loads(self.send("POST", path, None, json.dumps(body, allow_nan=False).encode(), headers))

    def patch(self, path: str, body: Json) -> Json:
        return json.loads(self.send("PATCH", path, None, json.dumps(body, allow_nan=False).encode(), {}))

    def every(self, path: str, query: Optional[Mapping[str, Any]] = None) -> Iterator[Json]:
        """Every row of a list."""
        lines = self.send("GET", path, query, None, {"Accept": "application/x-ndjson"})
        return (json.loads(line) for line in lines.splitlines())

    def send(
        self,
        method: str,
        path: str,
        query: Optional[Mapping[str, Any]],
        body: Optional[bytes],
        headers: Mapping[str, str],
        media_type: str = "application/json",
    ) -> bytes:
        asked = {name: value for name, value in (query or {}).items() if value is not None}
        url = self.url + path + ("?" + urllib.parse.urlencode(asked) if asked else "")
        request = urllib.request.Request(url, data=body, method=method)
        request.add_header("Accept", "application/json")
        request.add_header("Accept-Encoding", "gzip")
        if body is not None:
            request.add_header("Content-Type", media_type)
        if method == "POST":
            # One key for all attempts: what an answer that was lost has made is not made again.
            request.add_header("Idempotency-Key", str(uuid.uuid4()))
        for name, value in headers.items():
            request.add_header(name.replace("_", "-"), value)
        for attempt in range(1, ATTEMPTS + 1):
            try:
                with urllib.request.urlopen(request, timeout=self.timeout_s) as answer:
                    text: bytes = answer.read()
                    return gzip.decompress(text) if answer.headers.get("Content-Encoding") == "gzip" else text
            except urllib.error.HTTPError as error:
                problem = _problem(error)
                if problem.code != "busy" or attempt == ATTEMPTS:
                    raise problem from None
            except (urllib.error.URLError, http.client.HTTPException, ConnectionError, TimeoutError) as error:
                if attempt == ATTEMPTS:
                    mend = f"Is the server running, and is {self.url} its address? `volition serve` prints it."
                    raise Problem(
                        {"code": "unreachable", "title": "the server does not answer", "detail": str(error), "mend": mend}
                    ) from error
            time.sleep(PAUSE_S * attempt)
        raise AssertionError("every attempt returns or raises")


def _problem(error: urllib.error.HTTPError) -> Problem:
    text = error.read()
    if error.headers.get("Content-Encoding") == "gzip":
        text = gzip.decompress(text)
    try:
        document = json.loads(text)
    except ValueError:
        document = {"title": f"status {error.code}", "detail": text[:200].decode(errors="replace")}
    document.setdefault("status", error.code)
    return Problem(document)
