"""docs/results.md: the claims of each paper, our results for them, tables and pictures of a run of papers.py."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from _measure import markdown
from _papers_claims import Claim, claims
from _papers_results import Results

PICTURES = {
    "compare-intel/compare.png": "results-intel.png",
    "compare-fr079/compare.png": "results-fr079.png",
    "slip-intel-maps.png": "results-slip-maps.png",
    "slip-intel-paths.png": "results-slip-paths.png",
    "corridor-maps.png": "results-corridor-maps.png",
    "corridor-paths.png": "results-corridor-paths.png",
    "tune/tune.png": "results-tune.png",
    "check-killian/check.png": "results-killian.png",
    "check-belgioioso-bent/check.png": "results-belgioioso.png",
}
COMPARED = ("method", "error [m]", "rotation [deg]", "seconds", "CPU [s]", "memory [MB]", "loops", "check")


def write_page(folder: Path, page: Path) -> None:
    """Writes the page, and the pictures beside it into ``images/``."""
    results = Results(folder)
    shown = _copy_pictures(folder, page.parent / "images")
    parts = [
        _head(),
        results.printed("notes"),
        _claims_table(claims(results)),
        _section("IGO, experiment I: wheels that slip (Figures 5, 6 left)", EXPERIMENT_1, results, "slip", shown),
        _section(
            "IGO, experiment II: corridors by the laser alone (Figures 6 right, 7)",
            EXPERIMENT_2,
            results,
            "corridor",
            shown,
        ),
        *(_comparison(name, results, shown) for name in ("intel", "fr079")),
        _section("MC, Figure 1: a map that is wrong in places", FIGURE_1, results, "", shown),
        _section("MC, Figure 3: recall and specificity", FIGURE_3, results, "power", shown),
        _section("MC, Figure 4: the choice of the DCS parameter", FIGURE_4, results, "tuning", shown),
        _section("MC, Figure 5: objects that stood elsewhere", FIGURE_5, results, "", shown),
        _section("MC, Table I: seconds", TABLE_1, results, "table1", shown),
        _missing(),
        _commands(results),
    ]
    page.write_text("\n\n".join(part.strip() for part in parts if part.strip()) + "\n")


EXPERIMENT_1 = """
The paper's log, USC SAL, is not among our data. intel takes its place, with stretches in which most of the reported
motion did not happen. The motion model of every method is widened to the paper's 1.6 and 0.8. The paper shows maps and
paths, without numbers.

![Maps](images/results-slip-maps.png)
![Paths](images/results-slip-paths.png)
"""
EXPERIMENT_2 = """
The paper's office of 17 m x 22 m, simulated. The paper shows maps and paths, without numbers.

![Maps](images/results-corridor-maps.png)
![Paths](images/results-corridor-paths.png)
"""
FIGURE_1 = """
Belgioioso castle with one wing rotated, and the regions that `check` marks.

![Belgioioso](images/results-belgioioso.png)
"""
FIGURE_3 = """
The paper's 53 labelled maps of 16 logs are not available. Ours are simulated and real ones, half of them corrupted in
six ways. The paper shows a picture, in which its test is near (1, 1) and Haehnel's below it everywhere.
"""
FIGURE_4 = """
Intel and fr079 with false loops, from odometry and from a corrupted guess. The picture is intel with 50 local false
loops.

![The measure over phi, and the maps](images/results-tune.png)
"""
FIGURE_5 = """
![Killian Court](images/results-killian.png)
"""
TABLE_1 = """
The paper: i7-3770K of 2012, 8 threads. Here: 2 threads of a newer processor, which explains a part of the factor. The
graphs are other ones of the same logs, so seconds are compared for each pair. N: scans; R: scans that each overlaps
with; K: beams.
"""


def _head() -> str:
    return """# Results: both papers, claim by claim

IGO is Zhang, Liu and Hou, "An Iterative Graph Optimization Approach for 2D SLAM"; MC is Mazuran et al., "A Statistical
Measure for Map Consistency in SLAM", ICRA 2014. `python benchmarks/papers.py` writes this page: tables and pictures
are those of its last run, with defaults except where the text says otherwise. Column "the paper": as published."""


def _claims_table(rows: Sequence[Claim]) -> str:
    cells = [(f"**{one.verdict}**", one.source, one.text, one.theirs, one.ours) for one in rows]
    table = markdown(("verdict", "where", "the paper's claim", "the paper", "here"), cells)
    return table.replace("| --- | ---: | ---: | ---: | ---: |", "| --- | --- | --- | --- | --- |")


def _section(title: str, text: str, results: Results, step: str, shown: set[str]) -> str:
    lines = [line for line in text.strip().splitlines() if not line.startswith("![") or _picture_of(line) in shown]
    table = results.printed(step) if step else ""
    if step and not table:
        table = "*Not measured yet.*"
    return f"## {title}\n" + "\n".join(lines) + f"\n\n{table}"


def _picture_of(line: str) -> str:
    return line.split("images/")[1].rstrip(")")


def _comparison(name: str, results: Results, shown: set[str]) -> str:
    methods = results.compared(name)
    if not methods:
        return ""
    rows = []
    for row in methods:
        if "failed" in row:
            rows.append((row["method"], *["-"] * (len(COMPARED) - 2), "failed"))
            continue
        verdict = {True: "consistent", False: "inconsistent", None: "-"}[row["consistent"]]
        error = f"{row['translation_mean_m']:.4f} ± {row['translation_std_m']:.4f}"
        spent = (f"{row['seconds']:.1f}", f"{row['cpu_seconds']:.1f}", f"{row['peak_memory_mb']:.0f}")
        rows.append((row["method"], error, f"{row['rotation_mean_deg']:.3f}", *spent, f"{row['loop_edges']}", verdict))
    picture = f"results-{name}.png"
    lines = [f"## All methods on {name}, as recorded", f"![{name}](images/{picture})" if picture in shown else ""]
    return "\n".join([*lines, "", markdown(COMPARED, rows)])


def _missing() -> str:
    return """## What cannot be reproduced here
- IGO's own logs (USC SAL, Lenovo B2): not public, or not among our data. Ours replace them, as described above.
- MC Figure 6 and the Bicocca column of Figure 4: the multi-session graph's scans are not among our data.
- MC's 16 logs, of which we have intel, fr079, killian, Belgioioso and Edmonton."""


def _commands(results: Results) -> str:
    steps = results.commands()
    if not steps:
        return ""
    rows = [(name, f"`python {' '.join(arguments)}`", f"{seconds:.0f}") for name, arguments, seconds in steps]
    table = markdown(("step", "command", "seconds"), rows).replace("| --- | ---: |", "| --- | --- |", 1)
    return f"## Commands\n`python benchmarks/papers.py` runs them all.\n\n{table}"


def _copy_pictures(folder: Path, images: Path) -> set[str]:
    """The pictures that the run left, in a palette of 256 colours (64 lose thin lines); their names."""
    from PIL import Image

    images.mkdir(exist_ok=True)
    shown = set()
    for source, name in PICTURES.items():
        if (folder / source).is_file():
            with Image.open(folder / source) as picture:
                small = picture.convert("RGB")
                small.thumbnail((1600, 1600))
                small.quantize(256).save(images / name, optimize=True)
            shown.add(name)
    return shown | {name for name in PICTURES.values() if (images / name).is_file()}
