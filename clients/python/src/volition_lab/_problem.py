"""What the server refuses, in its own words."""

from __future__ import annotations

from typing import Any, Mapping, Optional


class Problem(Exception):
    """The server refused a request, or an analysis failed. Programs branch on `code`."""

    def __init__(self, document: Mapping[str, Any]) -> None:
        self.code: str = str(document.get("code", "unknown"))
        self.title: str = str(document.get("title", "the server refused"))
        self.detail: str = str(document.get("detail", ""))
        self.where: Optional[str] = document.get("where")
        self.mend: Optional[str] = document.get("mend")
        self.status: Optional[int] = document.get("status")
        parts = [f"{self.title}: {self.detail}"]
        if self.where:
            parts.append(f"at {self.where}")
        if self.mend:
            parts.append(self.mend)
        super().__init__(" | ".join(parts))
