"""benchmarks/papers.py: continues where it stopped, and its verdicts follow from the numbers."""

import json
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.fixture
def papers(monkeypatch, tmp_path):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.setenv("MAPMEND_DATA", str(tmp_path / "data"))
    import papers

    return papers


def step(papers, name, code, **more):
    return papers.Step(name, ("-c", code), **more)


def test_a_run_goes_on_where_it_stopped(papers, tmp_path, capsys):
    note = f"open({str(tmp_path / 'log')!r}, 'a').write"
    steps = [
        step(papers, "one", f"{note}('1'); print('first')"),
        step(papers, "two", f"{note}('2'); import os, sys; sys.exit(not os.path.exists({str(tmp_path / 'now')!r}))"),
        step(papers, "three", f"{note}('3')", cores=2, after=("one", "two")),
        step(papers, "no", f"{note}('4'); import sys; sys.exit(1)", answers=(0, 1)),
    ]
    assert papers.Runner(steps, tmp_path, 1).run() == ["two", "three"]
    assert sorted((tmp_path / "log").read_text()) == ["1", "2", "4"]
    assert "two failed" in capsys.readouterr().err
    (tmp_path / "now").touch()
    (tmp_path / "log").unlink()
    assert papers.Runner(steps, tmp_path, 2).run() == []
    assert (tmp_path / "log").read_text() == "23"
    assert (tmp_path / "one.out").read_text() == "first\n"
    # Another command is another step.
    (tmp_path / "log").unlink()
    papers.Runner([step(papers, "one", f"{note}('5')")], tmp_path, 2).run()
    assert (tmp_path / "log").read_text() == "5"


def test_what_several_steps_measured_is_shown_together(papers, tmp_path):
    for name in ("a", "b"):
        (tmp_path / f"{name}.jsonl").write_text(f'{{"from": "{name}"}}\n')
    steps = [step(papers, "a", ""), step(papers, "b", ""), step(papers, "both", "", after=("a", "b"))]
    papers.Runner(steps, tmp_path, 2).run()
    assert [json.loads(line)["from"] for line in (tmp_path / "both.jsonl").read_text().splitlines()] == ["a", "b"]


def test_claims_say_what_the_numbers_say(papers, tmp_path):
    from _papers_claims import claims
    from _papers_results import Results

    assert {one.verdict for one in claims(Results(tmp_path))} == {"not measured"}
    errors = {"gmapping": (0.4, 0.5, 0.1), "go": (0.2, 0.3, 0.2), "igo": (0.3, 0.4, 0.1)}
    lines = [
        json.dumps({"method": method, "seed": seed, "error_m": value, "count": 30})
        for method, values in errors.items()
        for seed, value in enumerate(values)
    ]
    (tmp_path / "slip.jsonl").write_text("\n".join(lines) + "\n")
    first, second, *_ = claims(Results(tmp_path))
    assert first.verdict == "reproduced (by 3 seeds only)"
    assert "2 of 3" in first.ours
    assert second.verdict.startswith("not reached")
    assert "1.50" in second.verdict
