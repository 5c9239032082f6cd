"""Texts that are not YAML: where, and why."""

from __future__ import annotations

from modaltouch.protocol.source import Problem


def syntax_problem(text: str, error: Exception) -> Problem:
    """Convert a parser error to a problem."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    if (position := getattr(error, "position", None)) is not None:
        before = text[:position]
        line, column = before.count("\n") + 1, len(before) - before.rfind("\n")
        return Problem(
            "",
            line,
            column,
            "",
            f"the character U+{ord(text[position]):04X}, which YAML does not allow",
            "printable text",
            "remove it",
        )
    line, column = (mark.line + 1, mark.column + 1) if mark is not None else (1, 1)
    written = text.split("\n")[line - 1] if line <= text.count("\n") + 1 else ""
    if "\t" in written[: max(column, len(written) - len(written.lstrip()))]:
        return Problem("", line, column, "", "a tab, but YAML needs spaces", "spaces", "indent only with spaces")
    detail = " ".join(str(getattr(error, "problem", None) or error).split())
    context = getattr(error, "context", None)
    return Problem(
        "",
        line,
        column,
        "",
        f"text that is not YAML ({detail}{f' {context}' if context else ''})",
        "YAML 1.2",
        "check indentation, brackets, quotes and colons here and in the line above",
    )
