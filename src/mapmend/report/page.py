"""The page: template, style, program and data of a report in one HTML text."""

from __future__ import annotations

from html import escape
from importlib.resources import files

from mapmend.report.embedding import safe_json, source_hash
from mapmend.report.run_data import Run, run_values
from mapmend.version import VERSION

SCRIPTS = ("numbers.js", "model.js", "layers.js", "view.js", "panels.js", "facts.js", "results.js", "main.js")
"""In the order of their dependencies; they share one scope, as one script."""


def report_page(runs: list[Run]) -> str:
    """The report of the first of ``runs`` beside the others: HTML that needs no other file and no network.

    A content security policy allows only the page's own script, by its hash, and no fetch.
    """
    style = _source("report.css")
    script = '"use strict";\n{\n' + "\n".join(_source(name) for name in SCRIPTS) + "}\n"
    values = {
        "title": escape("mapmend: " + " beside ".join(run.name for run in runs)),
        "version": escape(VERSION),
        "style": style,
        "script": script,
        "style_hash": source_hash(style),
        "script_hash": source_hash(script),
        "data": safe_json({"runs": [run_values(run) for run in runs]}),
    }
    # One pass over the template: inserted text is never searched for placeholders again.
    first, *parts = _source("report.html").split("{")
    text = [first]
    for part in parts:
        name, _, rest = part.partition("}")
        text += [values[name], rest]
    return "".join(text)


def _source(name: str) -> str:
    return (files("mapmend.report") / name).read_text(encoding="utf-8")
